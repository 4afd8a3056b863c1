"""Faults of gradient-index glass between the surfaces of a lens."""

from collections.abc import Callable, Iterator, Sequence

from lfmesh.scene.camera.gradient_faults import BESIDE_GRADIENT, ZONES_BESIDE_GRADIENT, rough_beside_gradient
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.model import Fault, Location


def gap_faults(surfaces: Sequence[Surface], element_of: Callable[[int], int | None]) -> Iterator[Fault]:
    """Yield the faults of gradient-index glass between the surfaces of a lens.

    Parameters
    ----------
    surfaces : sequence of Surface
    element_of : callable
        Returns the index of the element that contains a surface, or None.
    """
    for i, front in enumerate(surfaces):
        if front.gradient is None or front.refractor is not None or front.paraxial:
            continue
        where: Location = ("surfaces", i, "gradient")
        if i + 1 == len(surfaces):
            yield Fault(where, None, "omit it: the last surface looks into a homogeneous medium, up to the sensor")
            continue
        back = surfaces[i + 1]
        if back.mesh is not None or back.refractor is not None:
            what = "mesh" if back.refractor is None else "refractor"
            why = f"omit it: surfaces[{i + 1}] is a {what}, and rays through gradient glass end on an exact surface"
            yield Fault(where, None, why)
            continue
        if back.stop and back.is_flat and back.gradient == front.gradient:
            why = f"omit it: the stop would lie within gradient glass, from surfaces[{i}] on; mark a face of the glass"
            yield Fault(("surfaces", i + 1, "stop"), True, why)
        if element_of(i) != element_of(i + 1):
            yield Fault(
                where, None,
                f"surfaces {i} and {i + 1} must belong to one element: gradient glass moves with both of its faces",
            )  # fmt: skip
        for k in (i, i + 1):
            yield from rough_beside_gradient(surfaces[k].finish, ("surfaces", k, "finish"))
            if surfaces[k].phase is not None:
                yield Fault(("surfaces", k, "phase"), None, BESIDE_GRADIENT)
            if surfaces[k].outer_zone is not None:
                yield Fault(("surfaces", k, "outer_zone"), None, ZONES_BESIDE_GRADIENT)
