"""Lamps that a point asks: all where they are few, else drawn ones, whose light is that of all on the average."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.lights.lamps import illuminate
from lfmesh.transport.lights.many_lamps import (
    ASKED,
    MOST_NODES,
    OF_MANY,
    chance_passed,
    estimate,
    lamps_to_ask,
    passed_lamp,
)
from lfmesh.transport.packets.packet import PACKET, Options
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.settings import options_of
from lfmesh.transport.tables.lamp_tree import MOST_ASKED
from lfmesh.transport.tables.lights import Lamps, light_tables
from lfmesh.transport.tables.lines import Lines
from tests.cameras import camera_without_array

Array = NDArray[np.float64]

PROFILE = """IESNA:LM-63-2002
[TEST] made for tests
TILT=NONE
1 1000 1 5 3 1 2 0 0 0
1 1 40
0 20 50 60 65
0 30 90
200 180 90 20 0
200 170 70 10 0
200 90 30 5 0
"""


def mixed(count: int, random: np.random.Generator) -> list[dict[str, Any]]:
    """Return lamps of all kinds, of very different powers, some of them in one place, and parallel light."""
    found: list[dict[str, Any]] = []
    for number in range(count):
        place, way = random.normal(0.0, 30.0, 3).tolist(), random.normal(size=3).tolist()
        if number % 9 == 8:
            place = found[-8].get("position_mm", place)
        own = {"position_mm": place, "power_w": float(10.0 ** random.uniform(-6.0, 1.0)), "direction": way}
        match number % 8:
            case 0:
                del own["direction"]
                own["kind"] = "point"
            case 1:
                own |= {"kind": "spot", "half_angle_deg": float(random.uniform(1.0, 80.0))}
            case 2:
                own |= {"kind": "disk", "radius_mm": float(random.uniform(0.1, 5.0))}
            case 3:
                own |= {"kind": "rectangle", "width_mm": 6.0, "height_mm": float(random.uniform(0.5, 6.0))}
            case 4:
                own = {"kind": "line", "start_mm": place, "end_mm": (np.array(place) + 9.0 * np.array(way)).tolist(),
                       "power_w": own["power_w"]}  # fmt: skip
            case 5:
                own = {"kind": "directional", "direction": way, "irradiance_w_m2": own["power_w"]}
            case 6:
                own |= {"kind": "spot", "half_angle_deg": 30.0, "edge_deg": 25.0}
            case _:
                own |= {"kind": "spot", "profile": "led.ies"}
        found.append(own)
    return found


def lamps_of(lights: list[dict[str, Any]], folder: Any = ".") -> Lamps:
    scene = lf.Scene(camera=camera_without_array(), lights=lights).in_folder(folder)
    return light_tables(scene, np.eye(3, 4), Lines.of(scene))


@pytest.fixture(scope="module")
def options() -> Options:
    scene = lf.Scene(camera=camera_without_array())
    return options_of(lf.build(scene, aimed=False))


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Lamps:
    folder = tmp_path_factory.mktemp("profiles")
    (folder / "led.ies").write_text(PROFILE)
    return lamps_of(mixed(120, np.random.default_rng(5)), folder)


@kernel
def shine(lamps: Lamps, places: Array, normals: Array, key: np.uint64, brought: Array) -> None:
    """Write the irradiance that each lamp brings to points, from one of its points."""
    for i in range(len(places)):
        place = places[i, 0], places[i, 1], places[i, 2]
        for number in range(len(lamps.rows)):
            own = derived(derived(key, i), number)
            ux, uy, uz, _, irradiance = illuminate(
                lamps.profiles, lamps.rows[number], place, uniform(own, 0), uniform(own, 1), False
            )
            facing = normals[i, 0] != 0.0 or normals[i, 1] != 0.0 or normals[i, 2] != 0.0
            cosine = normals[i, 0] * ux + normals[i, 1] * uy + normals[i, 2] * uz if facing else 1.0
            brought[i, number] = max(irradiance * cosine * lamps.spectra[number, 0], 0.0)


@kernel
def least_estimates(lamps: Lamps, places: Array, normals: Array, least: Array) -> None:
    """Write the least estimate of the nodes that hold each lamp."""
    least[:] = np.inf
    for i in range(len(places)):
        place, normal = (places[i, 0], places[i, 1], places[i, 2]), (normals[i, 0], normals[i, 1], normals[i, 2])
        for node in range(len(lamps.nodes)):
            light, doubt = estimate(lamps, node, 0, place, normal)
            for lamp in range(len(lamps.rows)):
                if node <= lamps.leaf[lamp] < lamps.nodes[node].skip:
                    least[i, lamp] = min(least[i, lamp], light if doubt >= 0.0 else -1.0)


@kernel
def ask(
    options: Options, lamps: Lamps, packets: NDArray[np.void], place: Any, normal: Any, brought: Array,
    asked: NDArray[np.void], found: Array,
) -> None:  # fmt: skip
    """Write what the lamps that packets ask bring, weighted, and their number."""
    for i in range(len(packets)):
        count = lamps_to_ask(options, lamps, packets[i], place, normal, asked, None)
        found[i, 0], found[i, 1] = 0.0, count
        for k in range(count):
            found[i, 0] += asked[k].share * brought[asked[k].lamp]


@kernel
def draw_past(lamps: Lamps, place: Any, key: np.uint64, counts: Array) -> None:
    for i in range(100_000):
        counts[passed_lamp(lamps, 0, place, uniform(key, i))] += 1.0


@kernel
def chances_past(lamps: Lamps, places: Array, chances: Array) -> None:
    for i in range(len(places)):
        for lamp in range(len(lamps.rows)):
            chances[i, lamp] = chance_passed(lamps, lamp, 0, (places[i, 0], places[i, 1], places[i, 2]))


def places_and_normals(count: int, seed: int) -> tuple[Array, Array]:
    """Return points among the lamps; every fourth has no normal."""
    random = np.random.default_rng(seed)
    places, normals = random.normal(0.0, 40.0, (count, 3)), random.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[::4] = 0.0
    return places, normals


def test_no_lamp_that_lights_a_point_is_without_a_chance(many: Lamps) -> None:
    places, normals = places_and_normals(200, 3)
    # Points in the planes of lamps and on their axes, where light begins or ends.
    places[:60] = many.rows["position"][:60] + 7.0 * many.rows["across"][:60, 0]
    places[60:120] = many.rows["position"][:60] + 3.0 * many.rows["direction"][:60]
    least = np.empty((len(places), len(many.rows)))
    least_estimates(many, places, normals, least)
    seen = np.zeros(least.shape, np.bool_)
    for key in range(4):
        brought = np.empty_like(least)
        shine(many, places, normals, run_key(key), brought)
        seen |= brought > 0.0
    assert 0.1 < seen.mean() < 0.9
    assert (least[seen] > 0.0).all()
    assert (least >= 0.0).all()
    # The bounds leave out what surely brings nothing.
    assert (least[~seen] == 0.0).mean() > 0.1


def test_the_lamps_that_are_asked_bring_the_light_of_all(many: Lamps, options: Options) -> None:
    """At each point by a t-test, 30 at a level of 0.001 together; sized lamps shine from one of their points."""
    places, normals = places_and_normals(30, 8)
    brought = np.empty((len(places), len(many.rows)))
    shine(many, places, normals, run_key(2), brought)
    packets, asked = np.zeros(20_000, PACKET), np.zeros(MOST_NODES, ASKED)
    packets["key"] = [run_key(i) for i in range(len(packets))]
    found = np.empty((len(packets), 2))
    for place, normal, light in zip(places, normals, brought, strict=True):
        ask(options, many, packets, tuple(place.tolist()), tuple(normal.tolist()), light, asked, found)
        assert found[:, 1].max() <= OF_MANY
        error = stats.sem(found[:, 0])
        assert error < 0.1 * light.sum()
        # Where all that light the point are asked, sums differ by rounding.
        slack = stats.norm.isf(5e-4 / 30) * error + 1e-12 * light.sum()
        assert abs(found[:, 0].mean() - light.sum()) <= slack


def test_few_lamps_are_all_asked(options: Options) -> None:
    packets, asked, found = np.zeros(1, PACKET), np.zeros(MOST_NODES, ASKED), np.empty((1, 2))
    for count in range(MOST_ASKED + 1):
        lights = [{"kind": "point", "position_mm": [i, 0.0, -9.0], "power_w": 1.0} for i in range(count)]
        ask(options, lamps_of(lights), packets, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), np.ones(count), asked, found)
        assert asked["lamp"][:count].tolist() == list(range(count))
        assert found.tolist() == [[count, count]]


def test_a_bright_lamp_among_many_is_surely_asked(options: Options) -> None:
    random = np.random.default_rng(2)
    lights = [{"kind": "point", "position_mm": p.tolist(), "power_w": 1e-3} for p in random.normal(0.0, 50.0, (999, 3))]
    lamps = lamps_of([*lights, {"kind": "point", "position_mm": [5.0, 8.0, 9.0], "power_w": 100.0}])
    packets, asked = np.zeros(500, PACKET), np.zeros(MOST_NODES, ASKED)
    packets["key"] = [run_key(i) for i in range(len(packets))]
    found, only = np.empty((len(packets), 2)), np.zeros(1000)
    only[-1] = 1.0
    ask(options, lamps, packets, (0.0, 0.0, -50.0), (0.0, 0.0, 1.0), only, asked, found)
    assert (found[:, 0] == 1.0).all()


def test_lamps_beside_an_extremely_bright_one_keep_their_light(options: Options) -> None:
    """Of nine lamps round a point one brings 10¹⁸ times the light of the others, and a wall hides it: a z-test."""
    turns = np.arange(9) * 2.0 * np.pi / 9.0
    ring = 10.0 * np.column_stack([np.cos(turns), np.sin(turns), np.full(9, 0.5)])
    lights = [{"kind": "point", "position_mm": place, "power_w": 1e-3} for place in ring.tolist()]
    lights[3]["power_w"] = 1e15
    packets, asked, brought = np.zeros(20_000, PACKET), np.zeros(MOST_NODES, ASKED), np.ones(9)
    packets["key"] = [run_key(i) for i in range(len(packets))]
    brought[3], found = 0.0, np.empty((len(packets), 2))
    ask(options, lamps_of(lights), packets, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), brought, asked, found)
    assert abs(found[:, 0].mean() - 8.0) <= 3.9 * stats.sem(found[:, 0]) + 1e-9


def test_lamps_are_passed_as_often_as_their_chance_says(many: Lamps) -> None:
    place, counts, chances = np.array([[3.0, -8.0, 5.0]]), np.zeros(len(many.rows)), np.empty((1, len(many.rows)))
    draw_past(many, tuple(place[0].tolist()), run_key(1), counts)
    chances_past(many, place, chances)
    (chance,) = chances
    assert chance.sum() == pytest.approx(1.0, rel=1e-12)
    assert (chance[~many.rows["placed"]] == 0.0).all()
    often = chance > 1e-3
    assert counts[chance == 0.0].sum() == 0.0
    expected = np.append(chance[often], 1.0 - chance[often].sum()) * 1e5
    assert stats.chisquare(np.append(counts[often], counts[~often].sum()), expected).pvalue > 1e-3


def test_a_lamp_close_to_a_point_is_passed_as_its_light_asks() -> None:
    """The second moment of the light of one draw, over its squared mean, however near one of a thousand lamps is."""
    random = np.random.default_rng(1)
    cube = random.uniform(-50.0, 50.0, (1000, 3))
    lamps = lamps_of([{"kind": "point", "position_mm": place, "power_w": 1.0} for place in cube.tolist()])
    for near in (10.0, 1.0, 0.05):
        places, chances = cube[:20] + near * random.normal(size=(20, 3)), np.empty((20, 1000))
        chances_past(lamps, places, chances)
        light = 1.0 / np.linalg.norm(cube - places[:, None], axis=2)
        assert ((light**2 / chances).sum(axis=1) < 1.2 * light.sum(axis=1) ** 2).all()


def test_a_node_bounds_its_lamps_and_has_their_power(many: Lamps) -> None:
    assert len(many.nodes) == 2 * len(many.rows) - 2
    assert sorted(many.nodes["lamp"][many.leaf]) == list(range(len(many.rows)))
    for number, node in enumerate(many.nodes):
        below = np.flatnonzero((many.leaf >= number) & (many.leaf < node["skip"]))
        rows = many.rows[below]
        assert (rows["placed"] == node["placed"]).all()
        np.testing.assert_allclose(many.power[number, 0], many.power[many.leaf[below], 0].sum(), rtol=1e-12)
        far = np.linalg.norm(rows["position"] - node["middle"], axis=1) + rows["size"]
        assert far.max() <= node["radius"]
        assert (rows["direction"] @ node["axis"] >= node["cos_spread"]).all()
