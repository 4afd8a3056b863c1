"""Diffractive faces with several orders, for optics that follows one ray: each face reduced to its main order."""

from lfmesh.errors import DiffractionWarning, LfmeshError
from lfmesh.scene import Scene
from lfmesh.scene.camera.base_phase import Phase
from lfmesh.scene.model import format_path

Phases = dict[str, Phase]
"""Phases of diffractive faces by their path in the scene."""


def phases_of(scene: Scene) -> Phases:
    """Return the phases of lens and array, in that order.

    Parameters
    ----------
    scene : Scene
        Solved.
    """
    return {format_path(where): phase for where, phase, _, _ in scene.phases()}


def lens_phases(scene: Scene) -> Phases:
    """Return the phases of the lens alone.

    Parameters
    ----------
    scene : Scene
        Solved.
    """
    return {format_path(where): phase for where, phase, _, _ in scene.phases() if where[1] == "lens"}


def has_several_orders(phase: Phase) -> bool:
    """Tell whether a phase has several transmitted orders."""
    return len(phase.listed) > 1


def with_main_orders(scene: Scene) -> Scene:
    """Return a scene with light in the main order of each diffractive face alone; the scene itself if nothing changes.

    Transmitted light keeps its share in that order, so the light of all other orders is missing. Reflected light stays
    in the zeroth order.

    Parameters
    ----------
    scene : Scene
        Solved.
    """
    changes: dict[str, tuple[object, ...]] = {}
    for path, phase in phases_of(scene).items():
        if has_several_orders(phase):
            changes[f"{path}.orders"] = tuple(each for each in phase.orders if each.order == phase.main_order)
        if phase.reflected_orders:
            changes[f"{path}.reflected_orders"] = ()
    return scene.changed(changes) if changes else scene


def orders_in_words(phases: Phases) -> list[str]:
    """Describe the order that rays follow at each diffractive face.

    Parameters
    ----------
    phases : dict
        By path.
    """
    words = []
    for path, phase in phases.items():
        others = ", without the light of its other orders" if has_several_orders(phase) else ""
        words.append(f"{path}: followed in order {phase.main_order}{others}")
    return words


def left_out(phases: Phases) -> list[DiffractionWarning]:
    """Return a warning for each diffractive face that loses orders by `with_main_orders`.

    Parameters
    ----------
    phases : dict
        By path.
    """
    return [
        DiffractionWarning(
            f"{path} has several orders, and the result is that of order {phase.main_order} alone: the light of the "
            "others is missing"
        )
        for path, phase in phases.items()
        if has_several_orders(phase)
    ]


def refuse_several_orders(phases: Phases) -> None:
    """Refuse diffractive faces with several orders.

    Parameters
    ----------
    phases : dict
        By path.

    Raises
    ------
    LfmeshError
        The message names the first such face.
    """
    for path, phase in phases.items():
        if has_several_orders(phase):
            raise LfmeshError(f"{path} has several orders, and these rays follow one; give order in place of orders")
