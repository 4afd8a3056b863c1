"""Warnings about gradient-index glass beyond the blank that its formula describes."""

from collections.abc import Iterator

from lfmesh.optics.gradient_range import GlassRegion, InBox
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.model import Location, format_path
from lfmesh.scene.objects.shapes import Box
from lfmesh.scene.scene import Scene


def gradient_warnings(scene: Scene) -> Iterator[str]:
    """Yield the warnings about a solved scene.

    Parameters
    ----------
    scene : Scene
    """
    glasses: list[tuple[Location, Gradient, GlassRegion]] = list(scene.gradient_regions())
    for i, medium in enumerate(scene.media):
        if isinstance(medium.index, Gradient) and isinstance(medium.bounds, Box):
            x, y, z = (0.5 * side for side in medium.bounds.size_mm)
            glasses.append((("media", i, "index"), medium.index, InBox((-x, -y, -z), (x, y, z))))
    # Types of lenslets may have the same fault.
    said = dict.fromkeys(f"{format_path(at)}: {why}" for at, each, region in glasses if (why := each.beyond(region)))
    yield from said
