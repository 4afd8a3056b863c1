"""Rays from the stop, which prove the aim: drawn by landing points or by slopes, they measure the same light."""

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.sequences.stop_rays import (
    ENOUGH,
    CameraTables,
    Rays,
    Reach,
    rays_from_stop,
    reach_of,
)
from tests.transport.gradient_lenses import ALPHA, camera, rod

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds."""


def through(world: lf.World) -> CameraTables:
    """Return the camera's tables as the proof of the aim takes them."""
    tables = world.tables
    return CameraTables(tables.lens, tables.mla, tables.sensor, tables.frames)


def moments(rays: Rays) -> tuple[Array, Array]:
    """Return means over the light, and their standard errors: squares of place and slope on both sides of the lens."""
    places, ahead, away = rays.sensor[:, :2], rays.sensor[:, 2:4], rays.objects[:, 3:5]
    values = np.column_stack([(part**2).sum(axis=1) for part in (places, ahead, away)])
    share = rays.throughput / rays.throughput.sum()
    mean = share @ values
    return mean, np.sqrt((share**2) @ (values - mean) ** 2)


def test_both_discs_measure_the_same_light() -> None:
    """A disc of slopes that holds all rays gives the same moments of the light as one of landing points."""
    tables = through(lf.build(lf.load(asset_path("scenes/conventional.toml")), aimed=False))
    places = reach_of(tables, np.random.default_rng(1))
    assert places is not None
    assert not places.of_slopes
    one = rays_from_stop(tables, places, np.random.default_rng(2))
    other = rays_from_stop(tables, Reach(1.0, of_slopes=True), np.random.default_rng(3))
    (first, error), (second, error_of_second) = moments(one), moments(other)
    away = np.abs(first - second) / np.hypot(error, error_of_second)
    assert (away < stats.norm.ppf(1.0 - 0.5 * LEVEL / 3)).all()


def test_a_stop_imaged_on_the_sensor_costs_few_rays() -> None:
    """Landing points say nothing of slopes there: drawn by them, 0.03 % of the rays came through."""
    world = lf.build(camera(rod(0.75 * np.pi / ALPHA, 2.0), distance_mm=6.0), aimed=False)
    tables = through(world)
    draw = np.random.default_rng(4)
    reach = reach_of(tables, draw)
    assert reach is not None
    assert reach.of_slopes
    rays = rays_from_stop(tables, reach, draw)
    assert len(rays.throughput) > ENOUGH
