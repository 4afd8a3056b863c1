"""Renders of one scene with many seeds, for tests of what holds on average."""

from collections.abc import Iterable, Iterator

import lfmesh as lf
from lfmesh.transport.render.render import Renderer


def by_seed(scene: lf.Scene, seeds: Iterable[int]) -> Iterator[lf.Image]:
    """Yield the image of every seed, as `lf.render` makes it; the scene is built once for all of them."""
    world = lf.build(scene)
    for seed in seeds:
        yield Renderer(world.reseeded(seed)).image()
