"""The grids of a scene's phases, read from their files."""

import math
from collections.abc import Sequence
from typing import TypeVar

from lfmesh.errors import SceneError
from lfmesh.scene.model import Model, format_path
from lfmesh.scene.scene import Scene

M = TypeVar("M", bound=Model)

ROUNDED = 1e-9
"""Relative excess of an aperture over the grid of its phase that rounding explains."""


def with_phase_grids(scene: Scene) -> Scene:
    """Return a scene with its phases read from their files; the scene itself if that changes nothing.

    Raises
    ------
    FileError
        A file cannot be used.
    """
    camera = scene.camera
    surfaces = tuple(_read(each, ("phase",), scene) for each in camera.lens.surfaces)
    mla = _read(camera.mla, ("curved_phase", "flat_phase"), scene) if camera.mla is not None else None
    parts = (*surfaces, mla), (*camera.lens.surfaces, camera.mla)
    if all(new is old for new, old in zip(*parts, strict=True)):
        return scene
    lens = camera.lens.model_copy(update={"surfaces": surfaces})
    return scene.model_copy(update={"camera": camera.model_copy(update={"lens": lens, "mla": mla})})


def _read(model: M, keys: Sequence[str], scene: Scene) -> M:
    """Return a surface or array with the phases under some keys read."""
    given = {key: phase for key in keys if (phase := getattr(model, key)) is not None}
    read = {key: phase.read_in(scene) for key, phase in given.items()}
    changed = {key: phase for key, phase in read.items() if phase is not given[key]}
    return model.model_copy(update=changed) if changed else model


def refuse_small_grids(scene: Scene) -> None:
    """Refuse grids that end inside a clear aperture of a solved scene.

    Raises
    ------
    SceneError
    """
    mla, surfaces = scene.camera.mla, scene.camera.lens.surfaces
    for where, phase, _, _ in scene.phases():
        number = where[-2]
        if isinstance(number, int):
            needed = surfaces[number].semi_diameter_mm or 0.0
            what = "the clear aperture has a radius of"
        else:
            assert mla is not None
            needed = mla.pitch_mm / (math.sqrt(3.0) if mla.layout == "hexagonal" else 2.0)
            what = "the cell of a lenslet reaches"
        if needed > phase.reach_mm * (1.0 + ROUNDED):
            raise SceneError(
                f"{format_path(where)}: its grid ends {phase.reach_mm:.6g} mm from the vertex, but {what} "
                f"{needed:.6g} mm; give a larger grid or a smaller aperture"
            )
