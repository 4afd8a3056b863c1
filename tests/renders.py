"""Renders of one scene with many seeds, for tests of what holds on average."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import lfmesh as lf
from lfmesh.transport.render.order_check import OrderCheck
from lfmesh.transport.render.render import Renderer


@dataclass
class _Checked(Renderer):
    """A render of a world whose surfaces another seed has compared with the meshes, which takes longer than a picture."""

    found: OrderCheck | None = None

    def _check_order(self) -> OrderCheck | None:
        return self.found


def by_seed(scene: lf.Scene, seeds: Iterable[int]) -> Iterator[lf.Image]:
    """Yield the image of every seed, with the pixels and the ledger of `lf.render`.

    The scene is built once for all of them, the first alone compares the order of its surfaces and its ghosts with the
    meshes, and none has `blind`.
    """
    world = lf.build(scene)
    found: list[OrderCheck | None] = []
    for seed in seeds:
        one = world.reseeded(seed)
        renderer = _Checked(one, check=False, found=found[0]) if found else Renderer(one, check=False)
        found.append(renderer.order)
        yield renderer.image()
