"""Distances on a line by the light that lamps send there: their law, and the light that is scattered there."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

from lfmesh.geometry.ray import Ray
from lfmesh.transport.events.scattering_point import scattered_at, scattering_point
from lfmesh.transport.events.volume import Passage, pass_through
from lfmesh.transport.lights.lamps_on_line import (
    density_by_angle,
    distance_by_angle,
    lamps_on_line,
    lit_part,
    passes_lamp,
)
from lfmesh.transport.packets.random import descendant
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, LIGHT, POINT, SPOT
from tests.transport.events.test_volume import line, slab, volumes_of


def lamps(*rows: tuple[int, list[float], float, float]) -> Any:
    """Return a table of lamps, by kind, place, power and radius, and their spectra."""
    table = np.zeros(len(rows), LIGHT)
    for row, (kind, place, power, radius) in zip(table, rows, strict=True):
        row["kind"], row["position"], row["power"], row["radius"] = kind, place, power, radius
        row["peak"], row["direction"] = power / (4.0 * np.pi), (0.0, 0.6, 0.8)
    return table, np.ones((len(rows), 1))


@pytest.mark.parametrize("last", [60.0, np.inf])
def test_distances_follow_the_light_that_arrives_on_a_line(last: float) -> None:
    """Kolmogorov's test over random lamps and lines, 12 at a level of 0.001 together."""
    random = np.random.default_rng(7)
    for _ in range(6):
        kinds = [POINT, DISK, DIRECTIONAL, POINT]
        table, spectra = lamps(
            *((kind, random.normal(0.0, 20.0, 3).tolist(), random.uniform(0.1, 3.0), 2.0) for kind in kinds)
        )
        d = random.normal(size=3)
        way = Ray(*random.normal(0.0, 5.0, 3).tolist(), *(d / np.linalg.norm(d)).tolist())
        whole = lamps_on_line(table, spectra, 0, way, 3.0, last)
        points = [distance_by_angle(table, spectra, 0, way, 3.0, last, whole * u) for u in random.random(3000)]
        assert min(points) >= 3.0
        assert max(points) <= last

        def density(t: float, table: Any = table, spectra: Any = spectra, way: Any = way) -> float:
            return float(density_by_angle(table, spectra, 0, way, t))

        # The light of the disk begins or ends where the line crosses its plane.
        ends = [end for end in lit_part(table[1], way, 3.0, last) if 3.0 < end < last]
        grid = np.sort([*(3.0 + np.geomspace(1e-3, min(last, 1e5) - 3.0, 1500)), *ends])
        pieces = [0.0] + [quad(density, a, b, epsrel=1e-8)[0] for a, b in zip([3.0, *grid[:-1]], grid, strict=True)]
        cdf = np.cumsum(pieces)
        np.testing.assert_allclose(cdf[-1], whole, rtol=2e-3 if last == np.inf else 1e-6)
        assert kstest(points, lambda t, g=grid, c=cdf: np.interp(t, [3.0, *g], c / c[-1])).pvalue > 0.001 / 12


def test_a_lamp_is_near_where_the_part_of_the_line_is_near_it() -> None:
    table, spectra = lamps((POINT, [3.0, 0.0, 10.0], 1.0, 0.0), (DIRECTIONAL, [0.0, 0.0, 0.0], 1.0, 0.0))
    way = Ray(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert passes_lamp(table, spectra, 0, way, 0.0, np.inf, 3.1)
    assert not passes_lamp(table, spectra, 0, way, 0.0, np.inf, 2.9)
    assert not passes_lamp(table, spectra, 0, way, 0.0, 6.0, 4.9)
    assert passes_lamp(table, spectra, 0, way, 14.0, np.inf, 5.1)


def test_disks_and_narrow_spots_light_their_own_side_only() -> None:
    table, _ = lamps(*((kind, [0.0, 0.0, 10.0], 1.0, 2.0) for kind in (POINT, DISK, SPOT, SPOT)))
    table["direction"] = 0.0, 0.0, 1.0
    table["outer"] = 0.5, 0.5, 0.5, 1.5
    up, down = (Ray(3.0, 0.0, 0.0, 0.6, 0.0, dz) for dz in (0.8, -0.8))
    assert [lit_part(light, up, 1.0, 90.0)[0] for light in table] == [1.0, 12.5, 12.5, 1.0]
    assert all(lit_part(light, up, 1.0, 90.0)[1] == 90.0 for light in table)
    assert [np.subtract(*lit_part(light, down, 1.0, 90.0)) < 0.0 for light in table] == [True, False, False, True]
    flat = [lit_part(table[1], Ray(0.0, 0.0, z, 1.0, 0.0, 0.0), 1.0, 90.0) for z in (9.0, 10.0, 11.0)]
    assert [first < last for first, last in flat] == [False, False, True]


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0], [1e-300, 0.0, 0.0]])
def test_a_lamp_on_the_line_itself_gives_finite_distances(start: list[float]) -> None:
    table, spectra = lamps((POINT, [0.0, 0.0, 20.0], 1.0, 0.0), (POINT, start, 1.0, 0.0))
    way = Ray(*start, 0.0, 0.0, 1.0)
    whole = lamps_on_line(table, spectra, 0, way, 0.0, np.inf)
    points = [distance_by_angle(table, spectra, 0, way, 0.0, np.inf, whole * u) for u in (0.0, 0.3, 0.5, 0.9, 1.0)]
    assert np.isfinite(whole)
    assert whole > 0.0
    assert np.isfinite(points[:-1]).all()


def test_light_scattered_at_a_distance_is_the_same_however_the_point_is_drawn(tmp_path: Any) -> None:
    axis = np.linspace(-10.0, 10.0, 9)
    ks = 0.15 * np.exp(-(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2) / 30.0)
    np.savez(tmp_path / "g.npz", scattering_per_mm=ks, spacing_mm=axis[1] - axis[0])
    volumes = volumes_of(
        {"grid": "g.npz", "position_mm": [0.0, 0.0, -100.0], "absorption_per_mm": 0.04},
        slab(12.0, scattering_per_mm=0.03, absorption_per_mm=0.01),
        folder=tmp_path,
    )
    d = np.array([0.2, 0.1, -1.0]) / np.linalg.norm([0.2, 0.1, -1.0])
    way, book = (-15.0, -8.0, -60.0, *d.tolist()), np.zeros(2)
    for i in range(200):
        key = descendant(5, i)
        found = Passage(*pass_through(volumes, line(*way), np.inf, book, 0.0, key))
        t, share, density, which = scattering_point(volumes, line(*way), found, key)
        assert found.first <= t <= found.last
        assert share > 0.0
        again, medium = scattered_at(volumes, line(*way), t, book, key)
        np.testing.assert_allclose(again, density, rtol=1e-11)
        assert medium == which
    assert (book == 0.0).all()
