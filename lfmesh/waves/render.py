"""Rendering, with particles by point spreads if the scene asks for diffraction."""

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
        Called a few times a second in the calling thread. True shows a bar (on standard error, or below a notebook's
        cell), False nothing. Default: a bar in notebooks only.
    saved : dict of arrays, optional
        State of an interrupted render of this scene, from `lfmesh.transport.render.tally.arrays_of`, to continue from
        with the same bits.
    keep : Keeper, optional
        Called with the state after every replicate.
    world : World, optional
        The scene's world, from `lf.build`; only the seed may differ (default: built, or reused in this process).

    Returns
    -------
    Image
        After Ctrl-C, of the finished replicates.

    Warns
    -----
    PictureWarning
        The picture is or may be wrong; subclasses say how, and `Image.warnings` keeps them. Known problems are reported
        before the first ray.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built, `saved` or `world` belongs to another scene, or waves cannot picture its particles.
    """
    return transport.render(scene, progress, saved=saved, keep=keep, untraced=particle_film, world=world)
