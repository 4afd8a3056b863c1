"""Faults of gradient-index glass beside another medium, and on its faces in lens and array."""

from collections.abc import Iterator

from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.model import Fault, Location

BESIDE_GRADIENT = "omit it: a phase is not traced on a face of gradient glass, whose index depends on the place"
ZONES_BESIDE_GRADIENT = "omit it: a curved path through gradient glass must end on a face without a kink"


def gradient_beside(gradient: Gradient | None, index: float | None, glass: object | None) -> Iterator[Fault]:
    """Yield the fault of a gradient that is given together with another medium.

    Parameters
    ----------
    gradient : Gradient or None
    index : float or None
    glass : object
        Or None.
    """
    if gradient is not None and (index is not None or glass is not None):
        other = f"index = {index:g}" if index is not None else "glass"
        yield Fault(("gradient",), None, f"{other} is given too; give one of them")


def rough_beside_gradient(finish: Finish, where: Location) -> Iterator[Fault]:
    """Yield the fault of a rough face of gradient glass.

    Parameters
    ----------
    finish : Finish
    where : tuple of str and int
        Location of the finish.
    """
    if finish.is_rough:
        yield Fault(
            where, finish.kind, "must be polished: the face touches gradient glass, whose index depends on the place"
        )
