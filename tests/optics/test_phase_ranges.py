"""Bounds of the derivatives of phases hold at every point of a cell, and are narrow for small cells."""

import numpy as np
import pytest

from lfmesh.optics.phase_profiles import phase_bends_at, phase_table, phases_at
from lfmesh.optics.phase_ranges import meridian_phase, phase_bends
from lfmesh.optics.phase_shapes import (
    GRID,
    PhaseProfile,
    grating_profile,
    grid_profile,
    hologram_profile,
    metalens_profile,
    radial_profile,
    xy_profile,
    zones_profile,
)
from lfmesh.optics.zones import Zone

RNG = np.random.default_rng(11)
PROFILES: dict[str, PhaseProfile] = {
    "radial": radial_profile((-40.0, 3.0, -0.2), 2.0),
    "xy": xy_profile([(1, 0, 2.0), (2, 0, 3.0), (1, 1, 0.7), (0, 2, -4.0), (3, 2, 1.1), (0, 5, 0.3)], 1.3),
    "grating": grating_profile(10.0, 30.0),
    "metalens": metalens_profile(5.0, 1e4),
    "diverging metalens": metalens_profile(-5.0, 1e4),
    "grid": grid_profile(RNG.normal(size=(12, 9)), (0.5, 0.7)),
    "hologram": hologram_profile(((0.4, -1.0, -30.0), (-0.2, 0.3, 25.0)), (True, False), 20.0),
    "hologram on axis": hologram_profile(((0.0, 0.0, -30.0), (0.0, 0.0, -25.0)), (True, True), 20.0),
    "zones": zones_profile([
        Zone(0.0, 0.8, 0.3, 0.0, 0.0, ((2, -40.0), (4, 3.0)), 0.5),
        Zone(0.8, 1.4, -7.0, 0.0, 0.0, ((2, 5.0),), 0.4),
        Zone(1.4, np.inf, 0.0, 0.0, 0.0, ((2, 0.0), (4, -2.0), (6, 0.5)), 0.7),
    ]),
}  # fmt: skip
CELLS = 200


@pytest.mark.parametrize("kind", PROFILES)
def test_no_derivative_in_a_cell_leaves_its_bounds(kind: str) -> None:
    profile = PROFILES[kind]
    table = phase_table([profile])
    low = RNG.uniform(-2.0, 1.5, (2, CELLS))
    high = low + 10.0 ** RNG.uniform(-5.0, -0.5, (2, CELLS))
    ranges = phase_bends(profile, (low[0], high[0]), (low[1], high[1]))
    for _ in range(10):
        x, y = low + RNG.uniform(size=(2, CELLS)) * (high - low)
        first = phases_at(table, 0, x, y)[:, 1:].T
        second = np.array([phase_bends_at(table, 0, *point) for point in zip(x, y, strict=True)]).T
        for value, (least, most) in zip((*first, *second), ranges, strict=True):
            slack = 1e-9 * np.abs(value).max()
            assert (value >= least - slack).all()
            assert (value <= most + slack).all()


@pytest.mark.parametrize("kind", PROFILES)
def test_bounds_close_in_on_small_cells(kind: str) -> None:
    """Those of a grid hold for the whole grid alone."""
    profile = PROFILES[kind]
    x, y = RNG.uniform(-1.5, 1.5, (2, CELLS))
    ranges = phase_bends(profile, (x, x + 1e-6), (y, y + 1e-6))
    for least, most in ranges:
        size = max(1.0, np.abs(least).max())
        assert (most - least).max() < (np.inf if profile.kind == GRID else 1e-4 * size)


def test_beyond_a_grid_nothing_is_known() -> None:
    end = 2.75
    inside, beyond = (
        phase_bends(PROFILES["grid"], (x, x), (x * 0.0, x * 0.0))
        for x in (np.array([end - 0.1]), np.array([end + 0.1]))
    )
    assert all(np.isfinite(each[0]).all() for each in inside)
    assert all(np.isinf(each[0]).all() for each in beyond)


@pytest.mark.parametrize("kind", ["radial", "metalens", "diverging metalens", "hologram on axis", "zones"])
def test_along_a_meridian_bounds_hold_at_heights_of_either_sign(kind: str) -> None:
    profile = PROFILES[kind]
    table = phase_table([profile])
    low = RNG.uniform(-2.0, 1.5, CELLS)
    high = low + 10.0 ** RNG.uniform(-5.0, -0.5, CELLS)
    slope, bend = meridian_phase(profile, (low, high))
    for _ in range(10):
        y = low + RNG.uniform(size=CELLS) * (high - low)
        by_y = phases_at(table, 0, np.zeros(CELLS), y)[:, 2]
        by_yy = np.array([phase_bends_at(table, 0, 0.0, at)[2] for at in y])
        for value, (least, most) in ((by_y, slope), (by_yy, bend)):
            slack = 1e-9 * np.abs(value).max()
            assert (value >= least - slack).all()
            assert (value <= most + slack).all()
    assert (slope[1] - slope[0])[high - low < 1e-4].max() < 1e-3 * np.abs(slope[0]).max()
