"""Renders of one scene with many seeds, for tests of what holds on average."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import lfmesh as lf
from lfmesh.transport.checks.order_check import OrderCheck
from lfmesh.transport.render.render import Renderer


@dataclass
class _Checked(Renderer):
    """A render of a world that another seed has compared with its meshes, which takes longer than a small picture."""

    found: OrderCheck | None = None

    def _check_order(self) -> OrderCheck | None:
        return self.found


def unchecked(scene: lf.Scene) -> lf.Image:
    """Return an image without the blind check, which takes as long as a small picture; else that of `lf.render`."""
    return Renderer(lf.build(scene), check=False).image()


def by_seed(scene: lf.Scene, seeds: Iterable[int]) -> Iterator[lf.Image]:
    """Yield the image of every seed, with the pixels and the ledger of `lf.render`; the scene is built once for all."""
    return of_world(lf.build(scene), seeds)


def of_world(world: lf.World, seeds: Iterable[int]) -> Iterator[lf.Image]:
    """Yield the image of every seed.

    The first alone compares the order of surfaces and the ghosts with the meshes, and none has `blind`.
    """
    found: list[OrderCheck | None] = []
    for seed in seeds:
        # Of the copy before, which has the sequences of ghosts already.
        world = world.reseeded(seed)
        renderer = _Checked(world, check=False, found=found[0]) if found else Renderer(world, check=False)
        found.append(renderer.order)
        yield renderer.image()
