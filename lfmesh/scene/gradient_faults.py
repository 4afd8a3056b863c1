"""Faults of gradient-index glass beside the settings of a render, and beside the scene's coatings."""

from collections.abc import Iterator, Sequence

from lfmesh.errors import GlassError
from lfmesh.scene.first_order.paraxial import gradient_gap
from lfmesh.scene.model import Fault, Location
from lfmesh.scene.scene_parts import SceneParts


def index_faults(scene: SceneParts, wavelengths_nm: Sequence[float]) -> Iterator[Fault]:
    """Yield gradient-index glass whose index leaves the valid range within it, or changes too fast.

    Parameters
    ----------
    scene : SceneParts
    wavelengths_nm : sequence of float
    """
    faulty: set[Location] = set()
    lengths = {where: length for where, _, length in scene.gradients()}
    for where, gradient, region in scene.gradient_regions():
        if where in faulty:
            continue
        try:
            gradient.check_region(region)
            for wavelength in wavelengths_nm:
                gradient.check_within(wavelength, region)
                gradient_gap(gradient, wavelength, lengths[where])
        except GlassError as error:
            faulty.add(where)
            yield Fault(where, None, str(error))


def gradient_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield the faults of gradient-index glass that concern other parts of a scene.

    Parameters
    ----------
    scene : SceneParts
    """
    gradients = [where for where, _, _ in scene.gradients()]
    if not gradients:
        return
    if why := _excluded_by(scene):
        for where in gradients:
            yield Fault(where, None, why)
    yield from _coating_faults(scene)
    yield from _diffraction_faults(scene)


def _excluded_by(scene: SceneParts) -> str:
    """Return why settings of the render exclude gradient-index glass, or ""."""
    if scene.transport.polarisation:
        return "omit it: transport.polarisation does not follow the field along curved rays"
    if scene.transport.surface != "exact":
        return 'needs transport.surface = "exact": curved rays end on exact faces, not on facets'
    if scene.transport.engine == "mesh":
        return 'needs transport.engine = "auto" or "sequential": Embree finds facets along straight rays only'
    return ""


def _faces(scene: SceneParts) -> set[Location]:
    """Return the locations of the coatings of faces that touch gradient-index glass."""
    faces: set[Location] = set()
    for where, _, _ in scene.gradients():
        if where[1] == "mla":
            faces |= {("camera", "mla", "curved_coating"), ("camera", "mla", "flat_coating")}
        else:
            number = int(where[3])
            faces |= {("camera", "lens", "surfaces", k, "coating") for k in (number, number + 1)}
    return faces


def _coating_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield coatings whose reflectance depends on the index of the glass."""
    faces = _faces(scene)
    for where, name in scene.coating_uses():
        coating = scene.all_coatings.get(name)
        if where in faces and coating is not None and coating.reflectance is None:
            yield Fault(
                where, name,
                f"its {coating.kind} depend on the index, which differs from place to place on gradient glass; give a "
                "coating with reflectance",
            )  # fmt: skip


def _diffraction_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield a diffraction that needs one index beside the diffracting aperture."""
    where, chosen, mla = ("transport", "diffraction"), scene.transport.diffraction, scene.camera.mla
    if chosen == "lenslets" and mla is not None and mla.gradient is not None:
        why = 'is not traced behind lenslets of gradient glass; give "none", or a homogeneous plate'
        yield Fault(where, chosen, why)
    number = scene.camera.lens.stop_index
    beside: Location = ("camera", "lens", "surfaces", number if number is not None else -1, "coating")
    if chosen == "stop" and beside in _faces(scene):
        why = 'needs a homogeneous medium on both sides of the stop; give "none", or put the stop beside the glass'
        yield Fault(where, chosen, why)
