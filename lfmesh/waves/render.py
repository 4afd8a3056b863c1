"""Rendering, with the light of particles by point spreads where a scene asks for diffraction."""

from collections.abc import Callable, Mapping
from typing import Any

from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.render import render as transport
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.world import World
from lfmesh.waves.particles import particle_film


def render(
    scene: Scene,
    progress: Callable[[Progress], None] | bool | None = None,
    *,
    saved: Mapping[str, NDArray[Any]] | None = None,
    keep: transport.Keeper | None = None,
    world: World | None = None,
) -> Image:
    """Trace a scene's raw sensor image; with diffraction, particles are added by their point spreads.

    Parameters
    ----------
    scene : Scene
    progress : callable or bool, optional
        Called a few times a second, in the calling thread. True shows a bar (on standard error, or below a notebook's
        cell), False nothing; left out, there is a bar in a notebook alone.
    saved : dict of arrays, optional
        State of an interrupted render of this scene, from `lfmesh.transport.render.tally.arrays_of`. The render
        continues from there, and its image is bitwise that of an uninterrupted one.
    keep : Keeper, optional
        Called with the state after every replicate.
    world : World, optional
        The scene's, from `lf.build`, of the same scene but for its seed. Omitted, the scene is built, unless this
        process has its world already.

    Returns
    -------
    Image
        After Ctrl-C, of the finished replicates.

    Warns
    -----
    PictureWarning
        The picture is or may be wrong; its classes say how, and `Image.warnings` keeps them. What is known beforehand
        is warned of before the first ray.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built, `saved` or `world` is of another one, or particles cannot be pictured by waves.
    """
    return transport.render(scene, progress, saved=saved, keep=keep, untraced=particle_film, world=world)
