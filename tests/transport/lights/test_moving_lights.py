"""Lights that move: at each moment they light points as still lights do that stand there then."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.rigid_motion import SEGMENT, steady
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.events.moving import mover_of, point_between
from lfmesh.transport.events.volume import Line
from lfmesh.transport.lights.emitting_facets import density_at, emitting_point
from lfmesh.transport.lights.lamps import sample
from lfmesh.transport.lights.lamps_on_line import density_by_angle, lamps_on_line, passes_lamp
from lfmesh.transport.lights.many_emitters import chance_of_leaf, chance_of_tree
from lfmesh.transport.lights.many_lamps import ASKED, MOST_NODES, NO_NORMAL, lamps_to_ask
from lfmesh.transport.lights.media_emitters import density, point_of_media
from lfmesh.transport.packets.packet import MOVING_FRAME, OBJECT_FRAME, PACKET, Options
from lfmesh.transport.packets.random import derived, run_key, uniform
from lfmesh.transport.settings import options_of
from lfmesh.transport.tables import emitting_facets
from lfmesh.transport.tables.emitting_facets import emitter_table
from lfmesh.transport.tables.forward_sources import aimed_at_glass
from lfmesh.transport.tables.lights import Lamps, with_movers
from lfmesh.transport.tables.motions import Motions, Moving, moving
from lfmesh.transport.tables.tables import ObjectTables
from lfmesh.transport.tables.volumes import Volumes
from tests.cameras import camera_without_array
from tests.movers import pose_of_mover
from tests.transport.events.test_volume import volumes_of
from tests.transport.lights.test_emitting_facets import SCREEN, SHINING, scene
from tests.transport.lights.test_many_lamps import lamps_of, mixed

Array = NDArray[np.float64]

MOVERS, SECONDS = 4, 0.2
"""Number of movers, one of them at rest, and the present time."""


def screws(movers: int, seed: int, *, camera: bool = True) -> list[NDArray[np.void]]:
    """Return motions, mostly of the camera first: screws about axes of their own, of about half a turn in a second."""
    random = np.random.default_rng(seed)
    motions = [
        steady(random.normal(0.0, 30.0, 3), random.normal(0.0, 90.0, 3), random.normal(0.0, 9.0, 3))
        for _ in range(movers)
    ]
    return motions if camera else [steady((0, 0, 0), (0, 0, 0), (0, 0, 0)), *motions[1:]]


def motions_with(segments: list[NDArray[np.void]], targets: Any = (), lamps: Any = (), media: Any = ()) -> Motions:
    """Return tables of the motions of movers, for an exposure of one second."""
    first = np.cumsum([0, *map(len, segments)])
    rows = np.concatenate(segments).astype(SEGMENT)
    still = np.broadcast_to(np.eye(3, 4), (6, 6, 3, 4)).copy()
    numbers = [np.array(each, np.int64) for each in ([*targets, 0], lamps, media)]
    return Motions(
        rows, first, *numbers, resting=0, bounds=np.full((len(segments), 4), -1.0), begin_s=np.zeros(1),
        duration_s=1.0, end_s=1.0, shutter=np.array([[0.0, 1.0], [1.0, 1.0], [0.0, 1.0]]), camera_moves=True,
        frames=still,
    )  # fmt: skip


def at_moment(motions: Motions, time_s: float = SECONDS) -> Moving:
    """Return the working memory of a thread at a time."""
    found: Moving = moving(motions, 1)
    found.time_s[0] = time_s
    for mover in range(1, len(motions.first) - 1):
        found.back[mover] = pose_of_mover(motions, mover, time_s)
        found.to[mover] = frame.inverse(found.back[mover])
    return found


def placed_then(lamps: Lamps, movers: Any, now: Moving) -> Lamps:
    """Return lamps without movers, where those of movers are at a moment."""
    rows = lamps.rows.copy()
    for row, mover in zip(rows, movers, strict=True):
        row["position"] = frame.points(now.back[mover], [row["position"]])[0]
        row["across"] = frame.directions(now.back[mover], row["across"])
        for name in ("direction", "spine"):
            row[name] = frame.directions(now.back[mover], row[name])
    return with_movers(lamps._replace(rows=rows), np.zeros(len(rows), np.int64))


def packets_in(mover: int, count: int) -> NDArray[np.void]:
    packets = np.zeros(count, PACKET)
    packets["frame"] = OBJECT_FRAME if mover == 0 else MOVING_FRAME + mover
    packets["key"] = [run_key(i) for i in range(count)]
    return packets


@pytest.fixture(scope="module")
def objects() -> ObjectTables:
    return lf.build(lf.Scene(camera=camera_without_array()), aimed=False).tables.objects


@pytest.fixture(scope="module")
def options() -> Options:
    return options_of(lf.build(lf.Scene(camera=camera_without_array()), aimed=False))


@kernel
def shine(options: Options, objects: Any, now: Any, packet: Any, places: Array, found: Array) -> None:
    """Write what `sample` draws from each place towards each lamp: value, distance, direction."""
    for i in range(len(places)):
        for number in range(len(objects.lamps.rows)):
            place = places[i, 0], places[i, 1], places[i, 2]
            way = sample(options, objects, packet[0], number, place, False, now)
            row = found[i, number]
            row[0], row[1], row[2], row[3], row[4] = way.value, way.reach, way.ray.dx, way.ray.dy, way.ray.dz


@pytest.mark.parametrize("here", range(MOVERS))
def test_a_lamp_of_another_mover_lights_a_point_as_a_still_lamp_there(
    here: int, objects: ObjectTables, options: Options
) -> None:
    movers = np.arange(24) % MOVERS
    # Without profiles, which need files.
    lamps = lamps_of([each for each in mixed(28, np.random.default_rng(3)) if "profile" not in each][:24])
    motions = motions_with(screws(MOVERS, 1), lamps=movers)
    now = at_moment(motions)
    places = np.random.default_rng(2).normal(0.0, 30.0, (9, 3))
    still, moved = np.empty((2, 9, 24, 5))
    shine(options, objects._replace(lamps=placed_then(lamps, movers, now)), None, packets_in(0, 1), places, still)
    seen = frame.points(now.to[here], places)
    shine(options, objects._replace(lamps=with_movers(lamps, movers)), now, packets_in(here, 1), seen, moved)
    assert (still[..., 0] > 0.0).mean() > 0.3
    np.testing.assert_allclose(moved[..., :2], still[..., :2], rtol=1e-8, atol=1e-9 * still[..., 0].max())
    for lamp in range(24):
        back = frame.directions(now.back[here], moved[:, lamp, 2:])
        np.testing.assert_allclose(back, still[:, lamp, 2:], atol=1e-10)


@kernel
def ask(
    options: Options, lamps: Lamps, now: Any, packets: NDArray[np.void], place: Any, normal: Any, brought: Array,
    asked: NDArray[np.void], found: Array,
) -> None:  # fmt: skip
    """Write what the lamps that packets ask bring, weighted."""
    for i in range(len(packets)):
        found[i] = 0.0
        for k in range(lamps_to_ask(options, lamps, packets[i], place, normal, asked, now)):
            found[i] += asked[k].share * brought[asked[k].lamp]


def test_many_lamps_that_are_asked_bring_the_light_of_all_movers(objects: ObjectTables, options: Options) -> None:
    """At each point by a z-test, 8 at a level of 0.001 together; lamps without a size, whose light is one number."""
    random = np.random.default_rng(8)
    lamps = lamps_of([each for each in mixed(400, random) if each["kind"] in ("point", "spot", "directional")
                      and "profile" not in each])  # fmt: skip
    movers = random.integers(0, MOVERS, len(lamps.rows))
    now = at_moment(motions_with(screws(MOVERS, 6), lamps=movers))
    own, still = with_movers(lamps, movers), placed_then(lamps, movers, now)
    assert len(own.nodes) == 2 * len(own.rows) - 2 * MOVERS
    asked, found = np.zeros(MOST_NODES, ASKED), np.empty(20_000)
    for trial in range(8):
        here = trial % MOVERS
        place, normal = random.normal(0.0, 30.0, (1, 3)), random.normal(size=3)
        normal *= (trial > 3) / np.linalg.norm(normal)
        light = np.empty((1, len(lamps.rows), 5))
        shine(options, objects._replace(lamps=still), None, packets_in(0, 1), place, light)
        cosine = light[0, :, 2:] @ normal if trial > 3 else np.ones(len(lamps.rows))
        brought = light[0, :, 0] * np.maximum(cosine, 0.0)
        seen, facing = frame.points(now.to[here], place)[0], frame.directions(now.to[here], normal)
        ask(options, own, now, packets_in(here, len(found)), tuple(seen.tolist()), tuple(facing.tolist()), brought,
            asked, found)  # fmt: skip
        error = stats.sem(found)
        assert error < 0.1 * brought.sum()
        assert abs(found.mean() - brought.sum()) <= stats.norm.isf(5e-4 / 8) * error + 1e-9 * brought.sum()


def test_a_line_passes_moving_lamps_as_still_ones() -> None:
    random = np.random.default_rng(4)
    lamps = lamps_of([each for each in mixed(8, random) if "profile" not in each])
    movers = np.arange(len(lamps.rows)) % MOVERS
    now = at_moment(motions_with(screws(MOVERS, 2), lamps=movers))
    own, still = with_movers(lamps, movers), placed_then(lamps, movers, now)
    for here in range(MOVERS):
        p, d = random.normal(0.0, 30.0, 3), random.normal(size=3)
        d /= np.linalg.norm(d)
        there = Line(Ray(*p.tolist(), *d.tolist()), 0, 0, None, 0)
        q, e = frame.points(now.to[here], p[None])[0], frame.directions(now.to[here], d)
        line = Line(Ray(*q.tolist(), *e.tolist()), 0, 0, now, here)
        whole = lamps_on_line(still, there, 2.0, 90.0)
        assert whole > 0.0
        np.testing.assert_allclose(lamps_on_line(own, line, 2.0, 90.0), whole, rtol=1e-9)
        for t in random.uniform(2.0, 90.0, 5):
            np.testing.assert_allclose(density_by_angle(own, line, t), density_by_angle(still, there, t), rtol=1e-8)
        for within in (1.0, 5.0, 20.0, 60.0):
            assert passes_lamp(own, line, 2.0, 90.0, within) == passes_lamp(still, there, 2.0, 90.0, within)


@kernel
def draw_facets(
    objects: ObjectTables, now: Any, here: int, place: Any, normal: Any, numbers: Array, found: Array
) -> None:
    """Write the facet and the density of points, as drawn for a place and as stated for them."""
    for i in range(len(numbers)):
        prim, x, y, z, chance = emitting_point(objects, place, normal, numbers[i, 0], numbers[i, 1], now, here)
        found[i, 0], found[i, 1] = prim, chance
        found[i, 2] = density_at(objects, place, normal, prim, (x, y, z), now, here) if prim >= 0 else 0.0


@kernel
def fill_chances(objects: ObjectTables, now: Any, here: int, place: Any, normal: Any, chances: Array) -> None:
    """Write the chance of the leaf of each piece, among all trees."""
    emitters = objects.emitters
    for piece in range(len(chances)):
        own = mover_of(now, objects.facets[emitters.facet[piece]].body)
        at = point_between(now, here, own, place[0], place[1], place[2])
        root, chance = chance_of_tree(emitters.trees, emitters, place, normal, piece, now, here)
        chances[piece] = chance * chance_of_leaf(emitters, root, at, normal, piece)


def test_points_of_facets_of_all_movers_are_drawn_with_the_stated_density(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean of one over the density is the area of all pieces that may light the point, by a t-test."""
    monkeypatch.setattr(emitting_facets, "FEW", 1)
    found = lf.build(scene([SCREEN, *SHINING], []), aimed=False).tables.objects
    motions = motions_with(screws(3, 5), targets=(0, 1, 2))
    objects, now = found._replace(emitters=emitter_table(found, motions.of_target)), at_moment(motions)
    emitters = objects.emitters
    assert emitters.trees[:, 1].tolist() == [1, 2]
    assert emitters.nodes["power"][emitters.trees[:, 0]].sum() == pytest.approx(1.0, rel=1e-12)
    numbers, drawn = np.random.default_rng(1).random((100_000, 2)), np.empty((100_000, 3))
    place = tuple(frame.points(now.to[2], [[3.0, 40.0, -20.0]])[0].tolist())
    draw_facets(objects, now, 2, place, NO_NORMAL, numbers, drawn)
    assert set(objects.facets["body"][drawn[:, 0].astype(np.int64)]) == {1, 2}
    assert np.isclose(drawn[:, 1], drawn[:, 2], rtol=1e-9).mean() > 0.9999
    chances, begins = np.empty(len(emitters.facet)), emitters.nodes["begin"][emitters.nodes["right"] == 0]
    fill_chances(objects, now, 2, place, NO_NORMAL, chances)
    assert chances[begins].sum() == pytest.approx(1.0, rel=1e-12)
    shares = np.diff(emitters.until, prepend=0.0)
    shares[begins] = emitters.until[begins]
    given = (shares > 0.0) & (chances > 0.0)
    area = (shares[given] / emitters.density[given]).sum()
    assert stats.ttest_1samp(1.0 / drawn[:, 1], area).pvalue > 1e-3


@kernel
def draw_media(volumes: Any, line: Any, key: np.uint64, found: Array) -> None:
    """Write random points of media for the start of a line."""
    for i in range(len(found)):
        own = derived(key, i)
        numbers = uniform(own, 0), uniform(own, 1), uniform(own, 2), uniform(own, 3)
        _, found[i, 0], found[i, 1], found[i, 2] = point_of_media(volumes, line, numbers)


def test_a_moving_flame_is_asked_as_a_still_one_there() -> None:
    ball = {"bounds": {"kind": "sphere", "radius_mm": 3.0}, "emission_w_mm3_sr": 0.4}
    volumes: Volumes = volumes_of(ball | {"position_mm": [14.0, 0.0, -60.0]}, ball | {"position_mm": [0.0, 9.0, -50.0]})
    now = at_moment(motions_with(screws(3, 9), media=(1, 2)))
    rows = volumes.rows.copy()
    for row, mover in zip(rows, (1, 2), strict=True):
        row["to_own"] = frame.compose(row["to_own"], now.to[mover])
    still, random = volumes._replace(rows=rows), np.random.default_rng(3)
    for here in range(3):
        p = random.normal((0.0, 0.0, -40.0), 10.0)
        line = Line(Ray(*frame.points(now.to[here], p[None])[0].tolist(), 0.0, 0.0, 1.0), 0, 0, now, here)
        moved, expected = np.empty((2, 200, 3))
        draw_media(volumes, line, run_key(1), moved)
        draw_media(still, Line(Ray(*p.tolist(), 0.0, 0.0, 1.0), 0, 0, None, 0), run_key(1), expected)
        np.testing.assert_allclose(frame.points(now.back[here], moved), expected, atol=1e-9)
        for point in expected[:9]:
            d = (point - p) / np.linalg.norm(point - p)
            e = frame.directions(now.to[here], d)
            there = density(still, Line(Ray(*p.tolist(), *d.tolist()), 0, 0, None, 0))
            assert there > 0.0
            own = density(volumes, Line(Ray(*line.ray[:3], *e.tolist()), 0, 0, now, here))
            np.testing.assert_allclose(own, there, rtol=1e-8)


def test_lamps_are_aimed_at_a_sphere_that_holds_moving_glass_at_all_times() -> None:
    glass = {"position_mm": [5.0, 3.0, -60.0], "refractor": {"box_mm": [6.0, 4.0, 2.0], "index": 1.5}}
    ball = {
        "position_mm": [-9.0, 0.0, -70.0],
        "refractor": {"shape": {"kind": "sphere", "radius_mm": 2.0}, "index": 1.4},
    }
    lamp = {"kind": "point", "position_mm": [30.0, 10.0, -20.0], "power_w": 1.0}
    world = lf.build(scene([SCREEN, glass, ball], [lamp]), aimed=False)
    motions = motions_with(screws(3, 4), targets=(0, 1, 2), lamps=(2,))
    found = world.tables.objects
    aimed = aimed_at_glass(found._replace(lamps=with_movers(found.lamps, motions.of_lamp)), motions)
    assert aimed is not None
    corners = found.facets["corners"][found.facets["body"] == 1].reshape(-1, 3)
    far = 0.0
    for time in np.linspace(0.0, 1.0, 101):
        box = frame.points(pose_of_mover(motions, 1, time), corners)
        centre = frame.points(pose_of_mover(motions, 2, time), found.rounds.faces["centre"])
        far = max(far, np.linalg.norm(box - aimed.lit_middle, axis=1).max(),
                  np.linalg.norm(centre - aimed.lit_middle, axis=1).max() + 2.0)  # fmt: skip
    assert 0.6 * aimed.lit_radius < far <= aimed.lit_radius
