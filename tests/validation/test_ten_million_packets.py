"""Ten million packets of lenses, one by one: surfaces found by their order against those of the meshes.

Where the two differ by more than they should, 40 digits say what is true (`exact_packet`). Some packets are so
conditioned that the last digits of their own numbers move the truth farther than the limits are: those that
run along the plane of the stop and meet it kilometres aside, or that graze a surface. They are counted apart, and have
to be as near to the truth as those digits allow.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.transport.checks.order_check import LARGEST_MM, outcomes
from lfmesh.transport.settings import with_thinning
from tests.validation.exact_packet import first_hit, judge
from tests.validation.test_order_of_surfaces import (
    OF_WEIGHTS,
    conics_as_prescribed,
    drawn_worlds,
    posed_aspheres,
    waiting_packets,
    with_aspheres,
    with_poses,
    world_of,
)

PER_LENS, DRAWN, ALL = 200_000, 13, 10_000_000
ROUNDINGS = 16.0
"""By how many times what the packet's last digits move the truth an outcome may be off it."""

CONDITIONED, MISSED_BY_A_MESH = 1e-5, 2e-7
"""Shares of packets that may be so conditioned, or pass a mesh between its chords and the surface."""


def worlds() -> Iterator[lf.World]:
    """Yield the lenses of the assets, and drawn ones of conics and aspheres, in their places and off them."""
    for path in sorted(asset_path("lenses").rglob("*.toml")):
        yield world_of(load_lens(path))
    for changed in (conics_as_prescribed, with_aspheres, with_poses, posed_aspheres):
        yield from drawn_worlds(DRAWN, changed)


def entered(world: lf.World, packets: NDArray[np.void]) -> NDArray[np.void]:
    """Let packets on their way in start their queries at the lens's box, as those from object space do."""
    lens = world.tables.lens
    coming = np.flatnonzero(packets["last"] < 0)
    p, d = (np.stack([packets[coming][a] for a in axes], axis=1) for axes in (("x", "y", "z"), ("dx", "dy", "dz")))
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.fmin((lens.box_low - p) / d, (lens.box_high - p) / d)
    packets["query_from"][coming] = np.fmax(np.nanmax(near, axis=1), 0.0)
    return packets


def is_right(world: lf.World, packet: NDArray[np.void], outcome: NDArray[np.void]) -> bool:
    found = judge(world, packet, outcome["position"], outcome["weight"] / packet["weight"])
    in_place = found.off_mm <= max(LARGEST_MM, ROUNDINGS * found.moves_mm)
    return in_place and found.off_share <= max(OF_WEIGHTS, ROUNDINGS * found.moves_share)


@pytest.mark.long
def test_ten_million_packets_meet_the_same_surface_at_the_same_place_in_order_and_by_meshes() -> None:
    compared = conditioned = missed = 0
    for seed, world in enumerate(worlds()):
        packets, options = waiting_packets(world, PER_LENS, seed=1000 + seed)
        found = outcomes(world, with_thinning(options, cutoff=0.0), world.tables, entered(world, packets))
        compared += len(packets) - len(found.undecided)
        weights = np.abs(found.by_order["weight"] - found.by_mesh["weight"])
        weights /= packets["weight"][found.by_order["source"]]
        apart = np.flatnonzero((found.deviation_mm > LARGEST_MM) | (weights > OF_WEIGHTS))
        conditioned += len(apart)
        for i in apart:
            for row in (found.by_order[i], found.by_mesh[i]):
                assert is_right(world, packets[row["source"]], row), (seed, row)
        missed += len(found.differing)
        for row in found.only_by_order:
            # A mesh may let a grazing ray pass; the order may not.
            assert is_right(world, packets[row["source"]], row), (seed, row)
        assert set(found.differing) <= set(found.only_by_order["source"])
    print(f"{compared} packets, {conditioned} conditioned, {missed} missed by a mesh")
    assert compared >= ALL
    assert conditioned <= CONDITIONED * compared
    assert missed <= MISSED_BY_A_MESH * compared


def test_the_exact_trace_finds_a_moved_hit_and_a_wrong_share() -> None:
    """Each hit is right, and what is 1e-8 mm or 1e-9 of the weight beside it is not."""
    world = drawn_worlds(1, posed_aspheres)[0]
    packets, options = waiting_packets(world, 2000, seed=5)
    found = outcomes(world, with_thinning(options, cutoff=0.0), world.tables, entered(world, packets))
    hits = found.by_order[found.by_order["name"] >= 0][:8]
    assert len(hits) == 8
    for row in hits:
        packet = packets[row["source"]]
        assert first_hit(world, packet) is not None
        assert is_right(world, packet, row)
        moved, heavier = row.copy(), row.copy()
        moved["position"][0] += 1e-8
        heavier["weight"] += 1e-9 * packet["weight"]
        assert not is_right(world, packet, moved)
        assert not is_right(world, packet, heavier)
