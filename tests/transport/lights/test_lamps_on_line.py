"""Distances on a line by the light that lamps send there: their law, and the light that is scattered there."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import kstest

import lfmesh as lf
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
from lfmesh.transport.tables.lights import Lamps, light_tables
from lfmesh.transport.tables.lines import Lines
from tests.cameras import camera_without_array
from tests.transport.events.test_volume import line, slab, volumes_of

UP = (0.0, 0.6, 0.8)


def lamps(*lights: dict[str, Any]) -> Lamps:
    """Return the tables of lamps, in the world frame."""
    scene = lf.Scene(camera=camera_without_array(), lights=lights)  # type: ignore[arg-type]
    return light_tables(scene, np.eye(3, 4), Lines.of(scene))


def point(place: list[float], power: float = 1.0) -> dict[str, Any]:
    return {"kind": "point", "position_mm": place, "power_w": power}


def disk(place: list[float], power: float = 1.0, direction: Any = UP) -> dict[str, Any]:
    return {"kind": "disk", "position_mm": place, "power_w": power, "direction": direction, "radius_mm": 2.0}


def panel(place: list[float], width: float, power: float = 1.0, direction: Any = UP) -> dict[str, Any]:
    return {"kind": "rectangle", "position_mm": place, "power_w": power, "direction": direction, "width_mm": width,
            "height_mm": 0.5}  # fmt: skip


def tube(start: list[float], end: list[float], power: float = 1.0) -> dict[str, Any]:
    return {"kind": "line", "start_mm": start, "end_mm": end, "power_w": power}


def spot(place: list[float], half_angle_deg: float, direction: Any = UP) -> dict[str, Any]:
    return {"kind": "spot", "position_mm": place, "power_w": 1.0, "direction": direction,
            "half_angle_deg": half_angle_deg}  # fmt: skip


SUN = {"kind": "directional", "direction": UP, "irradiance_w_m2": 1.0}


@pytest.mark.parametrize("last", [60.0, np.inf])
def test_distances_follow_the_light_that_arrives_on_a_line(last: float) -> None:
    """Kolmogorov's test over random lamps and lines, 12 at a level of 0.001 together."""
    random = np.random.default_rng(7)
    for _ in range(6):
        places, powers = random.normal(0.0, 20.0, (6, 3)).tolist(), random.uniform(0.1, 3.0, 5)
        table = lamps(
            point(places[0], powers[0]), disk(places[1], powers[1]), SUN, tube(places[2], places[3], powers[2]),
            panel(places[4], 12.0, powers[3]), point(places[5], powers[4]),
        )  # fmt: skip
        d = random.normal(size=3)
        way = Ray(*random.normal(0.0, 5.0, 3).tolist(), *(d / np.linalg.norm(d)).tolist())
        whole = lamps_on_line(table, line(*way), 3.0, last)
        points = [distance_by_angle(table, line(*way), 3.0, last, whole * u) for u in random.random(3000)]
        assert min(points) >= 3.0
        assert max(points) <= last

        def density(t: float, table: Any = table, way: Any = way) -> float:
            return float(density_by_angle(table, line(*way), t))

        # The light of flat lamps begins or ends where the line crosses their planes, that of spines two sizes away.
        ends = [*lit_part(table.rows[1], way, 3.0, last), *lit_part(table.rows[4], way, 3.0, last)]
        for lamp in table.rows[3:5]:
            off = lamp["position"] - way[:3]
            s = float(off @ way[3:])
            half = np.sqrt(max(4.0 * lamp["size"] ** 2 - off @ off + s * s, 0.0))
            ends += [s - half, s + half]
            ends += [s + x for x in np.geomspace(1e-4, 30.0, 60)] + [s - x for x in np.geomspace(1e-4, 30.0, 60)]
        ends = [end for end in ends if 3.0 < end < last]
        grid = np.sort([*(3.0 + np.geomspace(1e-3, min(last, 1e5) - 3.0, 1500)), *ends])
        pieces = [0.0] + [quad(density, a, b, epsrel=1e-8)[0] for a, b in zip([3.0, *grid[:-1]], grid, strict=True)]
        cdf = np.cumsum(pieces)
        np.testing.assert_allclose(cdf[-1], whole, rtol=2e-3 if last == np.inf else 1e-6)
        assert kstest(points, lambda t, g=grid, c=cdf: np.interp(t, [3.0, *g], c / c[-1])).pvalue > 0.001 / 12


def test_a_lamp_is_near_where_the_part_of_the_line_is_near_it() -> None:
    table = lamps(point([3.0, 0.0, 10.0]), SUN)
    way = Ray(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert passes_lamp(table, line(*way), 0.0, np.inf, 3.1)
    assert not passes_lamp(table, line(*way), 0.0, np.inf, 2.9)
    assert not passes_lamp(table, line(*way), 0.0, 6.0, 4.9)
    assert passes_lamp(table, line(*way), 14.0, np.inf, 5.1)


def test_disks_and_narrow_spots_light_their_own_side_only() -> None:
    at, axis = [0.0, 0.0, 10.0], (0.0, 0.0, 1.0)
    table = lamps(point(at), disk(at, 1.0, axis), spot(at, 60.0, axis), spot(at, 120.0, axis))
    up, down = (Ray(3.0, 0.0, 0.0, 0.6, 0.0, dz) for dz in (0.8, -0.8))
    assert [lit_part(light, up, 1.0, 90.0)[0] for light in table.rows] == [1.0, 12.5, 12.5, 1.0]
    assert all(lit_part(light, up, 1.0, 90.0)[1] == 90.0 for light in table.rows)
    assert [np.subtract(*lit_part(light, down, 1.0, 90.0)) < 0.0 for light in table.rows] == [True, False, False, True]
    flat = [lit_part(table.rows[1], Ray(0.0, 0.0, z, 1.0, 0.0, 0.0), 1.0, 90.0) for z in (9.0, 10.0, 11.0)]
    assert [first < last for first, last in flat] == [False, False, True]


def test_a_long_lamp_is_near_where_the_line_is_near_its_spine() -> None:
    table = lamps(tube([3.0, -90.0, 10.0], [3.0, 110.0, 10.0]))
    for y in (-88.0, 0.0, 108.0):
        way = Ray(0.0, y, 0.0, 0.0, 0.0, 1.0)
        assert passes_lamp(table, line(*way), 0.0, np.inf, 3.1)
        assert not passes_lamp(table, line(*way), 0.0, np.inf, 2.9)
        assert not passes_lamp(table, line(*way), 0.0, 5.0, 5.7)
    assert not passes_lamp(table, line(0.0, 113.0, 0.0, 0.0, 0.0, 1.0), 0.0, np.inf, 4.1)


def test_the_density_stays_in_proportion_to_the_light_of_a_tube() -> None:
    """On lines as near to the tube as may be: its light, in closed form, is at most 4 times the density."""
    random = np.random.default_rng(5)
    table = lamps(tube([0.0, 0.0, -20.0], [0.0, 0.0, 20.0]))
    z = np.array([0.0, 0.0, 1.0])
    for off in np.geomspace(1e-9, 5.0, 12):
        d = random.normal(size=3)
        d /= np.linalg.norm(d)
        across = np.cross(d, z) / np.linalg.norm(np.cross(d, z))
        start = random.uniform(-19.0, 19.0) * z + off * across - 30.0 * d
        way = Ray(*start.tolist(), *d.tolist())
        for t in 30.0 + np.concatenate([-np.geomspace(60.0, 1e-9, 40), np.geomspace(1e-9, 60.0, 40)]):
            place = start + t * d
            h, s = np.hypot(place[0], place[1]), place[2]
            sines = (20.0 - s) / np.hypot(20.0 - s, h) + (20.0 + s) / np.hypot(20.0 + s, h)
            assert table.rows[0]["peak"] / (40.0 * h) * sines <= 4.0 * density_by_angle(table, line(*way), t)


def crowd(count: int, random: np.random.Generator) -> Lamps:
    """Return many lamps that shine all round or to one side, in two clusters."""
    places = random.normal(0.0, 4.0, (count, 3)) + 60.0 * random.integers(0, 2, (count, 1))
    powers = random.uniform(0.1, 3.0, count)
    return lamps(*(
        point(place, power) if number % 2 else disk(place, power)
        for number, (place, power) in enumerate(zip(places.tolist(), powers.tolist(), strict=True))
    ))  # fmt: skip


def test_many_lamps_count_about_as_each_of_them() -> None:
    """Those of a node as one: their sum differs from that of lamps one by one by bounded factors where they shine."""
    random = np.random.default_rng(4)
    table = crowd(60, random)
    for _ in range(20):
        d = random.normal(size=3)
        way = Ray(*random.normal(20.0, 30.0, 3).tolist(), *(d / np.linalg.norm(d)).tolist())
        for t in random.uniform(-100.0, 100.0, 20):
            to = np.array(way[:3]) + t * np.array(way[3:]) - table.rows["position"]
            lit = (table.rows["outer"] > 1.0) | (np.einsum("ij,ij->i", to, table.rows["direction"]) > 0.0)
            single = (table.rows["peak"] / ((to**2).sum(axis=1) + table.rows["size"] ** 2))[lit].sum()
            assert 0.2 * single < density_by_angle(table, line(*way), t)


def test_distances_follow_the_light_of_many_lamps() -> None:
    """Kolmogorov's test over random lines, 6 at a level of 0.001 together."""
    random = np.random.default_rng(11)
    table = crowd(60, random)
    for _ in range(6):
        d = random.normal(size=3)
        way = Ray(*random.normal(20.0, 20.0, 3).tolist(), *(d / np.linalg.norm(d)).tolist())
        whole = lamps_on_line(table, line(*way), 3.0, 90.0)
        points = [distance_by_angle(table, line(*way), 3.0, 90.0, whole * u) for u in random.random(3000)]
        grid = np.linspace(3.0, 90.0, 20_001)
        cdf = np.cumsum([density_by_angle(table, line(*way), t) for t in 0.5 * (grid[1:] + grid[:-1])]) * (
            grid[1] - grid[0]
        )
        np.testing.assert_allclose(cdf[-1], whole, rtol=1e-2)
        assert kstest(points, lambda t, g=grid, c=cdf: np.interp(t, g, [0.0, *c / c[-1]])).pvalue > 0.001 / 6


def test_a_line_comes_near_one_of_many_lamps_where_it_comes_near_any() -> None:
    random = np.random.default_rng(9)
    table = crowd(60, random)
    found = []
    for _ in range(300):
        start = random.normal(20.0, 30.0, 3)
        d = random.choice(table.rows["position"]) + random.normal(0.0, 3.0, 3) - start
        way = Ray(*start.tolist(), *(d / np.linalg.norm(d)).tolist())
        last, within = random.uniform(5.0, 90.0), random.uniform(0.1, 4.0)
        leaves = [
            table._replace(nodes=table.nodes[leaf : leaf + 1], power=table.power[leaf : leaf + 1])
            for leaf in table.leaf
        ]
        single = [passes_lamp(each, line(*way), 1.0, last, within) for each in leaves]
        assert passes_lamp(table, line(*way), 1.0, last, within) == any(single)
        found.append(any(single))
    assert 0.1 < np.mean(found) < 0.9


@pytest.mark.parametrize("start", [[0.0, 0.0, 0.0], [1e-300, 0.0, 0.0]])
def test_a_lamp_on_the_line_itself_gives_finite_distances(start: list[float]) -> None:
    table = lamps(point([0.0, 0.0, 20.0]), point(start))
    way = Ray(*start, 0.0, 0.0, 1.0)
    whole = lamps_on_line(table, line(*way), 0.0, np.inf)
    points = [distance_by_angle(table, line(*way), 0.0, np.inf, whole * u) for u in (0.0, 0.3, 0.5, 0.9, 1.0)]
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
