"""The light round lamps by its angle: integrals of phase functions, and what is drawn by them."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from lfmesh.transport.tables.lights import LIGHT
from lfmesh.transport.tables.single_scatter import (
    EVEN,
    angle_beyond,
    drawn_angle,
    light_beyond,
    phase_at,
    single_scatter_tables,
)
from lfmesh.transport.tables.tables import NOTHING_NEAR_LAMPS, SingleScatter
from tests.transport.events.test_volume import slab, volumes_of


def lamp(placed: bool) -> np.ndarray:
    table = np.zeros(1, LIGHT)
    table["placed"], table["power"] = placed, 1.0
    return table


def near_lamps_of(g: float) -> SingleScatter:
    phase = {"kind": "henyey_greenstein", "g": g}
    found = single_scatter_tables(volumes_of(slab(10.0, scattering_per_mm=0.03, phase=phase)), lamp(placed=True), 100.0)
    assert found is not NOTHING_NEAR_LAMPS
    return found


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.6, 0.99])
def test_light_beyond_an_angle_is_the_integral_of_the_phase_function(g: float) -> None:
    near_lamps = near_lamps_of(g)

    def phase(angle: float) -> float:
        p = (1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * np.cos(angle)) ** 1.5)
        return EVEN * 0.25 / np.pi + (1.0 - EVEN) * float(p)

    for angle in (0.0, 1e-3, 0.02, 0.3, 1.5, 3.0, 3.1415):
        points = sorted({min(angle + step, np.pi) for step in (0.0, 1e-3, 0.01, 0.1, 1.0, 4.0)})
        expected = sum(quad(phase, a, b)[0] for a, b in pairwise(points))
        # Between its nodes the table is linear.
        assert light_beyond(near_lamps, 0, angle) == pytest.approx(expected, rel=1e-2)
        assert phase_at(near_lamps, 0, angle) == pytest.approx(phase(angle), rel=0.1)


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.95])
def test_angles_are_drawn_by_the_light_beyond_them(g: float) -> None:
    """Kolmogorov's test of 4000 angles, three at a level of 0.001 together; the density is the function itself."""
    near_lamps = near_lamps_of(g)
    grid = np.union1d(np.linspace(0.0, np.pi, 4001), np.geomspace(1e-6, 1.0, 2000))
    middle = 0.5 * (grid[1:] + grid[:-1])
    cdf = np.cumsum([0.0, *(np.diff(grid) * [light_beyond(near_lamps, 0, a) for a in middle])])
    assert cdf[-1] == pytest.approx(near_lamps.below[0, -1], rel=1e-5)
    drawn = [drawn_angle(near_lamps, 0, u) for u in np.random.default_rng(3).random(4000)]
    assert kstest(drawn, lambda a: np.interp(a, grid, cdf / cdf[-1])).pvalue > 0.001 / 3


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.95])
def test_an_angle_is_found_again_by_the_light_beyond_it(g: float) -> None:
    near_lamps = near_lamps_of(g)
    for angle in (0.0, 1e-4, 0.01, 0.5, 2.0, 3.1):
        assert angle_beyond(near_lamps, 0, light_beyond(near_lamps, 0, angle)) == pytest.approx(
            angle, rel=1e-9, abs=1e-12
        )


def test_there_is_none_without_lamps_that_stand_somewhere_or_without_scattering() -> None:
    volumes = volumes_of(slab(10.0, scattering_per_mm=0.03))
    assert single_scatter_tables(volumes, lamp(placed=False), 100.0) is NOTHING_NEAR_LAMPS
    assert single_scatter_tables(volumes, lamp(placed=True)[:0], 100.0) is NOTHING_NEAR_LAMPS
    clear = volumes_of(slab(10.0, absorption_per_mm=0.03))
    assert single_scatter_tables(clear, lamp(placed=True), 100.0) is NOTHING_NEAR_LAMPS


def test_where_next_to_no_point_would_send_a_packet_none_does() -> None:
    """Some scattering at 3 % of the depth from which on all do; the slab is 10 mm thick, and wide."""
    thin, dense = (volumes_of(slab(10.0, scattering_per_mm=scattering)) for scattering in (3e-5, 3e-3))
    assert single_scatter_tables(thin, lamp(placed=True), 100.0) is NOTHING_NEAR_LAMPS
    assert single_scatter_tables(dense, lamp(placed=True), 100.0) is not NOTHING_NEAR_LAMPS
