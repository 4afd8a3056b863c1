"""Aims at the lens are one mixture: every direction is drawn with the density that the mixture states."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.aims.ghost_aim import aim_at_ghosts
from lfmesh.transport.aims.mixture import aimed, aimed_density
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.tables import LensAim

LEVEL = 1e-3
DRAWS = 6000


@pytest.fixture(scope="module")
def world() -> lf.World:
    return lf.build(lf.load(asset_path("scenes/conventional.toml")))


def aims_of(world: lf.World) -> dict[str, tuple[LensAim, float]]:
    """Return aims, and z of points that see the lens, camera frame."""
    behind = float(world.tables.frames[SENSOR_FRAME, CAMERA_FRAME][2, 3])
    at_ghosts = aim_at_ghosts(world.aimed_tables, world.ghosts).exit
    return {
        "opening": (world.aim.exit, behind),
        "ghosts": (at_ghosts, behind),
        "entrance": (world.aim.entrance, -300.0),
    }


@pytest.mark.parametrize("name", ["opening", "ghosts", "entrance"])
def test_weights_bring_the_area_of_any_part_of_the_wide_disk(name: str, world: lf.World) -> None:
    """One over the density, as area, summed over the rays that cross a ring, is its area: t-tests of eight rings."""
    aim, z = aims_of(world)[name]
    p, draw = (0.4, -0.3, z), np.random.default_rng(6)
    numbers = stats.qmc.LatinHypercube(3, rng=draw).random(DRAWS)
    rays = np.array([aimed(aim, p, tuple(number)) for number in numbers])
    assert aimed_density(aim, p, tuple(rays[0, :3])) == pytest.approx(rays[0, 3], rel=1e-12)
    way = (aim.opening.plane_z - z) / rays[:, 2]
    across = np.hypot(*(np.array(p[:2]) + way[:, None] * rays[:, :2]).T)
    area = way**2 / np.abs(rays[:, 2]) / rays[:, 3]
    edges = aim.wide_radius * np.sqrt(np.linspace(0.0, 1.0, 9))
    found = [np.where((across >= a) & (across < b), area, 0.0) for a, b in pairwise(edges)]
    p_values = [stats.ttest_1samp(each, np.pi * aim.wide_radius**2 / 8.0).pvalue for each in found]
    assert min(p_values) * len(p_values) > LEVEL
