"""A ray crosses gradient-index glass along its curve: its end, its fate, its absorption and its reflections."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.transport import trace as tracing
from lfmesh.transport.checks.order_check import compare
from lfmesh.transport.choice import engine_of
from lfmesh.transport.events.gradient import AT_EDGE, ON_OTHER_FACE, REACHED, index_at
from lfmesh.transport.packets.packet import BY_ORDER_OR_MESH, CAMERA_FRAME, PACKET
from lfmesh.transport.settings import options_of
from lfmesh.transport.tables.gradient_spaces import fills_space
from lfmesh.transport.tables.tables import Absorption
from tests.transport.gradient_lenses import (
    ALPHA,
    INDEX,
    NM,
    ROD,
    LinearRay,
    back_in_linear_index,
    built,
    camera,
    crossed,
    index_in_rod,
    passed,
    point_of,
    rod,
    rod_ray,
    unit,
)

Array = NDArray[np.float64]

CLOSED = 1e-12
"""Of the emitted power: rounding."""

AXIAL = {"kind": "axial", "index": 1.7, "coefficients": [-0.02, 0.0005]}
SPHERICAL = {"kind": "spherical", "index": 1.5, "coefficients": [0.01], "radius_mm": 30.0}
ASIDE = {"kind": "xyz", "index": 1.6, "x_coefficients": [0.002, -0.004], "y_coefficients": [0.0, -0.002],
         "z_coefficients": [0.001]}  # fmt: skip


def test_a_ray_through_a_rod_ends_where_the_closed_form_does() -> None:
    """Skew rays, in both directions, on point, direction, optical path and length."""
    lens = built(rod(25.0)).tables.lens
    draw = np.random.default_rng(1)
    for _ in range(100):
        start, d = np.append(draw.uniform(-1.2, 1.2, 2), 0.0), unit(*draw.uniform(-0.15, 0.15, 2), 1.0)
        truth = rod_ray(start[:2], index_in_rod(start) * d, 25.0)
        end = crossed(lens, 1, 1, start, d)
        assert end.fate == REACHED
        point, out = point_of(end)
        np.testing.assert_allclose(point, [*truth.place, 25.0], atol=2e-9)
        np.testing.assert_allclose(out, truth.vector / np.linalg.norm(truth.vector), atol=2e-9)
        assert end.path == pytest.approx(truth.path, abs=1e-9)
        mirrored = crossed(lens, 1, 0, np.add(start, [0.0, 0.0, 25.0]), d * [1.0, 1.0, -1.0])
        np.testing.assert_allclose(point_of(mirrored)[0], [*truth.place, 0.0], atol=2e-9)


FACES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "planes": ({}, {}),
    "spheres": ({"radius_mm": 12.0}, {"radius_mm": -15.0}),
    "concave": ({"radius_mm": -12.0}, {"radius_mm": 9.0}),
    "conics": ({"radius_mm": 8.0, "conic": -1.0}, {"radius_mm": -9.0, "conic": -3.0}),
    "aspheres": (
        {"radius_mm": 14.0, "asphere_mm": [2e-4, -3e-6]}, {"radius_mm": -20.0, "odd_asphere_mm": [1e-3, -1e-5]}
    ),
    "biconic and toroid": (
        {"radius_mm": 12.0, "biconic": {"radius_x_mm": 20.0}}, {"radius_mm": -14.0, "toroid": {"radius_x_mm": -25.0}}
    ),
}  # fmt: skip


@pytest.mark.parametrize("gradient", [ROD, AXIAL, SPHERICAL, ASIDE], ids=["rod", "axial", "spherical", "aside"])
@pytest.mark.parametrize("faces", FACES)
def test_a_reversed_ray_returns_to_its_start(faces: str, gradient: dict[str, Any]) -> None:
    """To rounding: point, direction and length. Both ends lie on their faces."""
    front, back = FACES[faces]
    surfaces = [front | {"thickness_mm": 9.0, "gradient": gradient, "semi_diameter_mm": 3.0},
                back | {"semi_diameter_mm": 3.0}]  # fmt: skip
    lens = built(surfaces).tables.lens
    draw, found = np.random.default_rng(2), 0
    while found < 40:
        start, d = np.append(draw.uniform(-1.5, 1.5, 2), 4.0), unit(*draw.uniform(-0.25, 0.25, 2), 1.0)
        first = crossed(lens, 1, 0, start, -d)
        if first.fate != REACHED:
            continue
        begin, way = point_of(first)
        end = crossed(lens, 1, 1, begin, -way)
        assert end.fate in (REACHED, AT_EDGE)
        if end.fate == AT_EDGE:
            continue
        found += 1
        point, out = point_of(end)
        back_again = crossed(lens, 1, 0, point, -out)
        assert back_again.fate == REACHED
        home, direction = point_of(back_again)
        np.testing.assert_allclose(home, begin, atol=1e-13)
        np.testing.assert_allclose(direction, way, atol=1e-13)
        assert back_again.distance == pytest.approx(end.distance, abs=1e-12)
        assert back_again.path == pytest.approx(end.path, abs=1e-12)


def test_the_index_at_a_point_is_that_of_its_space() -> None:
    lens = built(rod()).tables.lens
    assert index_at(lens, 0, 0, 0.0, 1.0, -1.0) == 1.0
    assert index_at(lens, 1, 0, 1.2, -0.9, 3.0) == pytest.approx(INDEX * np.sqrt(1.0 - ALPHA**2 * 2.25), rel=1e-15)


@pytest.mark.parametrize("beyond", [False, True])
def test_the_edge_is_met_within_a_step(beyond: bool) -> None:
    """A ray whose greatest height is a millionth below the rim, or above, between points of which none is there."""
    lens = built(rod(12.0)).tables.lens
    rim = lens.gradients.edge[1, 1]
    assert lens.gradients.steps[1, 0] < 12
    start, w = np.array([2.9, 0.0, 0.0]), INDEX * ALPHA
    highest = rim * (1.0 + (1e-6 if beyond else -1e-6))
    tx = w * np.sqrt(highest**2 - start[0] ** 2)
    n = index_in_rod(start)
    end = crossed(lens, 1, 1, start, np.array([tx, 0.0, np.sqrt(n * n - tx * tx)]) / n)
    assert end.fate == (AT_EDGE if beyond else REACHED)
    if beyond:
        point, _ = point_of(end)
        assert point[0] == pytest.approx(rim, rel=1e-9)
        assert 0.0 < point[2] < 12.0


def test_a_second_crossing_of_the_face_just_left_is_found_on_the_curve() -> None:
    """From the middle of a hollow, close along it: the ray comes back to it bent by the axial gradient."""
    front = {"radius_mm": 5.0, "thickness_mm": 20.0, "semi_diameter_mm": 4.0}
    surfaces = [front | {"gradient": AXIAL}, {"semi_diameter_mm": 4.0}]
    lens = built(surfaces).tables.lens
    start, d = np.array([0.0, -1.0, 5.0 - np.sqrt(24.0)]), unit(0.0, 1.0, 0.05)
    end = crossed(lens, 1, 1, start, d)
    assert end.fate == ON_OTHER_FACE
    point, out = point_of(end)
    assert point[1] > 0.5
    assert np.hypot(point[1], 5.0 - point[2]) == pytest.approx(5.0, abs=1e-12)
    home, _ = point_of(crossed(lens, 1, 1, point, -out))
    np.testing.assert_allclose(home, start, atol=1e-12)


TURNING: dict[str, tuple[dict[str, Any], list[float]]] = {
    "axial": ({"kind": "axial", "index": 1.8, "coefficients": [-0.2]}, [0.0, 0.0, -0.2]),
    "xyz": (
        {"kind": "xyz", "index": 1.8, "x_coefficients": [0.008], "y_coefficients": [-0.005], "z_coefficients": [-0.2]},
        [0.008, -0.005, -0.2],
    ),
}
"""Gradients with a linear index, and its slopes. In `turning`, n falls from 1.8 to 1.32 at the rear face, so that light
of a larger momentum across the axis turns back."""

OUTSIDE = 1.75


def turning(kind: str, **others: Any) -> lf.World:
    """Return the world of a plate behind a liquid, in which steep light turns back."""
    given = {"object_medium": {"index": OUTSIDE}, "distance_mm": 20.0} | others
    return built(rod(2.4, 30.0, TURNING[kind][0]), **given)


class Turning(NamedTuple):
    """A ray that turns: its direction in the liquid, point on the front face, ray vector there, and its end."""

    way: Array
    point: Array
    vector: Array
    end: LinearRay

    @property
    def weight(self) -> float:
        """Power that leaves the glass, with Fresnel's losses at both passages of the front face."""
        first, second = (float(np.hypot(*vector[:2])) for vector in (self.vector, self.end.vector))
        n_in, n_out = (float(np.linalg.norm(vector)) for vector in (self.vector, self.end.vector))
        return passed(OUTSIDE, n_in, first) * passed(n_out, OUTSIDE, second)


def turning_rays(kind: str, count: int) -> list[Turning]:
    """Return rays of `turning` that turn, and come back to its front face by closed form."""
    gradient, slope = TURNING[kind]
    draw, found = np.random.default_rng(8), []
    for _ in range(count):
        turn, momentum = draw.uniform(0.0, 2.0 * np.pi), draw.uniform(1.45, 1.6)
        across = momentum * np.array([np.cos(turn), np.sin(turn)])
        point = np.append(draw.uniform(-3.0, 3.0, 2), 0.0)
        n = gradient["index"] + float(point @ slope)
        way = np.append(across, np.sqrt(OUTSIDE**2 - momentum**2)) / OUTSIDE
        vector = np.append(across, np.sqrt(n * n - momentum**2))
        found.append(Turning(way, point, vector, back_in_linear_index(point, vector, np.array(slope))))
    return found


@pytest.mark.parametrize("kind", TURNING)
def test_a_ray_that_turns_back_ends_on_the_face_where_it_entered(kind: str) -> None:
    """By the closed form: place, direction, length, optical path. Sent back, it returns to its start, to rounding."""
    lens = turning(kind).tables.lens
    for ray in turning_rays(kind, 40):
        way = ray.vector / np.linalg.norm(ray.vector)
        end = crossed(lens, 1, 1, ray.point, way)
        assert end.fate == ON_OTHER_FACE
        place, out = point_of(end)
        np.testing.assert_allclose(place, ray.end.point, atol=2e-9)
        np.testing.assert_allclose(out, ray.end.vector / np.linalg.norm(ray.end.vector), atol=2e-9)
        assert end.distance == pytest.approx(ray.end.length, abs=2e-9)
        assert end.path == pytest.approx(ray.end.path, abs=2e-9)
        home, back = point_of(crossed(lens, 1, 1, place, -out))
        np.testing.assert_allclose(home, ray.point, atol=1e-12)
        np.testing.assert_allclose(back, -way, atol=1e-12)


@pytest.mark.parametrize("kind", TURNING)
def test_a_packet_that_turns_back_leaves_the_lens_by_the_face_where_it_entered(kind: str) -> None:
    """With the power, and in the direction, that the closed form and Fresnel's equations give."""
    rays = turning_rays(kind, 40)
    starts = np.array([ray.point - ray.way for ray in rays])
    paths = lf.trace(turning(kind), starts, [ray.way for ray in rays], split="transmit", record=True)
    assert set(paths.status) == {lf.Status.ESCAPED}
    assert paths.ledger.escaped == pytest.approx(sum(ray.weight for ray in rays), rel=1e-8)
    assert abs(paths.ledger.imbalance) < CLOSED
    for row, source in enumerate(paths.source):
        ray, met = rays[source], [v for v in paths.vertices(row) if v.surface == "lens surface 0"]
        assert [v.event for v in met] == [lf.Event.TRANSMITTED] * 2
        np.testing.assert_allclose([v.position for v in met], [ray.point, ray.end.point], atol=2e-9)
        across = ray.end.vector[:2] / OUTSIDE
        np.testing.assert_allclose(paths.direction[row], [*across, -np.sqrt(1.0 - across @ across)], atol=3e-9)
        assert paths.weight[row] == pytest.approx(ray.weight, rel=1e-8)


def test_blocks_have_a_line_in_the_ledger_for_rays_that_turn_back() -> None:
    """They follow the image path alone. A ray of less momentum passes."""
    ray, goes = turning_rays("axial", 1)[0], unit(0.3, 0.0, 1.0)
    starts = [ray.point - ray.way, -goes]
    paths = lf.trace(turning("axial"), starts, [ray.way, goes], split="transmit", engine="sequential")
    first = passed(OUTSIDE, 1.8, float(np.hypot(*ray.vector[:2])))
    assert paths.ledger.absorbed["turned back in gradient-index glass"] == pytest.approx(first, rel=1e-12)
    assert paths.ledger.sensor > 0.5
    assert abs(paths.ledger.imbalance) < CLOSED


@pytest.mark.parametrize("split", ["both", "roulette"])
def test_energy_closes_where_light_turns_back_again_and_again(split: str) -> None:
    """Half of it is reflected at the front face, and turns again, until it meets the edge."""
    surfaces = rod(2.4, 30.0, TURNING["xyz"][0])
    surfaces[0]["coating"] = "half"
    world = built(surfaces, object_medium={"index": OUTSIDE}, coatings={"half": {"reflectance": 0.5}})
    rays = turning_rays("xyz", 100)
    starts = np.array([ray.point - ray.way for ray in rays])
    paths = lf.trace(world, starts, [ray.way for ray in rays], split=split, weight_cutoff=1e-3)
    assert abs(paths.ledger.imbalance) < CLOSED
    assert sum(paths.ledger.lost.values()) == 0.0
    assert paths.ledger.escaped > 70.0
    assert paths.ledger.absorbed["lens[0] edge"] > 1.0
    assert not [name for name in paths.ledger.absorbed if "gradient-index glass" in name]


def test_light_that_runs_along_a_wide_plate_reaches_its_edge() -> None:
    """The index is largest half way between the faces, and holds light between them for 25 times the thickness."""
    guide = {"kind": "axial", "index": 1.5, "coefficients": [0.4, -0.1]}
    lens = built(rod(4.0, 100.0, guide)).tables.lens
    n, angle = 1.9, 0.4
    end = crossed(lens, 1, 1, np.array([0.0, 0.0, 2.0]), np.array([np.cos(angle), 0.0, np.sin(angle)]))
    assert n * np.cos(angle) > 1.5
    assert end.fate == AT_EDGE
    point, _ = point_of(end)
    assert point[0] == pytest.approx(lens.gradients.edge[1, 1], rel=1e-9)
    assert 0.0 < point[2] < 4.0


def test_light_on_a_circle_in_the_glass_is_trapped() -> None:
    """About the largest index, 2.4 − 0.128 ρ², a ray at the ρ where n ρ is largest runs in a circle."""
    well = {"kind": "xyz", "index": 1.248, "x_coefficients": [0.0, -0.128], "y_coefficients": [0.0, -0.128],
            "z_coefficients": [0.768, -0.128]}  # fmt: skip
    ball = [face | {"radius_mm": radius} for face, radius in zip(rod(6.0, 2.8, well), (3.0, -3.0), strict=True)]
    paths = lf.trace(built(ball), [[2.5, 0.0, 3.0]], [[0.0, 0.0, 1.0]])
    assert paths.ledger.absorbed == {"trapped in gradient-index glass": 1.0}


def test_a_packet_beyond_the_critical_angle_stays_in_the_rod() -> None:
    """It starts in the glass, is reflected at the rear face as a mirror would, and leaves through the front."""
    world = built(rod(10.0, 3.0))
    n, tx = INDEX, 1.15
    assert tx > 1.0
    start, d = np.array([0.0, 0.0, 9.5]), np.array([tx, 0.0, np.sqrt(n * n - tx * tx)]) / n
    at_rear = rod_ray(np.zeros(2), n * d, 0.5)
    assert at_rear.vector[0] > 1.0
    paths = lf.trace(world, [start], [d], split="both", weight_cutoff=0.0, record=True, max_events=2)
    vertices = [v for v in paths.vertices(0) if v.event.name in ("REFLECTED", "TRANSMITTED")]
    assert vertices[0].event.name == "REFLECTED"
    assert vertices[0].weight == 1.0
    np.testing.assert_allclose(vertices[0].position, [*at_rear.place, 10.0], atol=1e-9)
    at_front = rod_ray(at_rear.place, at_rear.vector, 10.0)
    if abs(at_front.place[0]) < 3.0:
        np.testing.assert_allclose(vertices[1].position, [*at_front.place, 0.0], atol=1e-8)
    assert abs(paths.ledger.imbalance) < CLOSED


LENSES: dict[str, list[dict[str, Any]]] = {
    "rod": rod(),
    "biconvex, axial": [
        {"radius_mm": 12.0, "thickness_mm": 5.0, "gradient": AXIAL, "semi_diameter_mm": 4.0},
        {"radius_mm": -12.0, "semi_diameter_mm": 4.0},
    ],
    "cemented gradients": [
        {"radius_mm": 14.0, "thickness_mm": 4.0, "gradient": SPHERICAL, "semi_diameter_mm": 4.0},
        {"radius_mm": -9.0, "thickness_mm": 3.0, "gradient": ASIDE, "semi_diameter_mm": 4.0, "coating": "half"},
        {"radius_mm": 40.0, "thickness_mm": 2.0, "index": 1.6, "semi_diameter_mm": 4.0},
        {"radius_mm": -30.0, "semi_diameter_mm": 4.0},
    ],
}
HALF = {"half": {"reflectance": 0.3}}


def into(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Return rays towards the front of a lens from all sides."""
    draw = np.random.default_rng(seed)
    to = np.column_stack([draw.uniform(-3.0, 3.0, (count, 2)), np.zeros(count)])
    d = np.column_stack([draw.uniform(-0.5, 0.5, (count, 2)), np.ones(count)])
    d /= np.linalg.norm(d, axis=1)[:, None]
    return to - 3.0 * d, d


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("split", ["both", "roulette", "transmit"])
def test_energy_closes(lens: str, split: str) -> None:
    world = built(LENSES[lens], coatings=HALF)
    paths = lf.trace(world, *into(400), split=split, weight_cutoff=1e-3)
    assert abs(paths.ledger.imbalance) < CLOSED
    assert sum(paths.ledger.lost.values()) == 0.0
    assert paths.ledger.sensor > 10.0


@pytest.mark.parametrize("lens", LENSES)
def test_packets_and_blocks_end_alike(lens: str) -> None:
    """Along the image path in both directions, with and without a pose of the lens."""
    count = len(LENSES[lens])
    for pose in ({}, {"tilt_deg": [3.0, -2.0, 1.0], "shift_mm": [0.2, -0.1, 0.05]}):
        elements = [{"surfaces": list(range(count)), "pose": pose}] if pose else []
        world = built(LENSES[lens], coatings=HALF, elements=elements, distance_mm=8.0)
        p, d = into(300, 3)
        behind = p * [1.0, 1.0, -1.0] + [0.0, 0.0, world.tables.lens.box_high[2] + 0.5]
        for rays in ((p, d), (behind, d * [1.0, 1.0, -1.0])):
            packets, blocks = (
                lf.trace(world, *rays, split="transmit", engine=engine) for engine in ("mesh", "sequential")
            )
            on = packets.status != lf.Status.ABSORBED
            packets_on = {int(s): i for i, s in enumerate(packets.source) if on[i]}
            blocks_on = {int(s): i for i, s in enumerate(blocks.source) if blocks.status[i] != lf.Status.ABSORBED}
            common = sorted(packets_on.keys() & blocks_on.keys())
            assert len(common) > 50
            assert blocks_on.keys() <= packets_on.keys()
            a, b = [packets_on[s] for s in common], [blocks_on[s] for s in common]
            np.testing.assert_allclose(packets.position[a], blocks.position[b], atol=1e-11, rtol=1e-13)
            np.testing.assert_allclose(packets.direction[a], blocks.direction[b], atol=1e-12)
            np.testing.assert_allclose(packets.weight[a], blocks.weight[b], rtol=1e-12)
            assert abs(blocks.ledger.imbalance) < CLOSED


def test_a_lens_may_be_turned_about_any_point() -> None:
    """The gradient moves with its faces: a posed lens bends rays as the unposed one bends rays posed the other way."""
    pose = {"tilt_deg": [4.0, -3.0, 20.0], "shift_mm": [0.3, 0.2, -0.4]}
    lens = LENSES["cemented gradients"]
    still = built(lens, coatings=HALF).tables.lens
    moved = built(lens, coatings=HALF, elements=[{"surfaces": [0, 1, 2, 3], "pose": pose}]).tables.lens
    move = moved.surfaces[0]["pose"]
    for start, d in zip(*into(20, 4), strict=True):
        start = np.array([*start[:2] * 0.3, 2.0])
        for k in (0, 1):
            one = crossed(still, 1, k, start, d if k else -d)
            other = crossed(moved, 1, k, move[:, :3] @ start + move[:, 3], move[:, :3] @ (d if k else -d))
            assert one.fate == other.fate
            (p, out), (q, turned) = point_of(one), point_of(other)
            np.testing.assert_allclose(move[:, :3] @ p + move[:, 3], q, atol=1e-12)
            np.testing.assert_allclose(move[:, :3] @ out, turned, atol=1e-12)


PLAIN: dict[str, list[dict[str, Any]]] = {
    "rod": [{"thickness_mm": 10.0, "semi_diameter_mm": 3.0}, {"semi_diameter_mm": 3.0}],
    "meniscus": [
        {"radius_mm": 6.0, "thickness_mm": 3.0, "semi_diameter_mm": 4.0}, {"radius_mm": 9.0, "semi_diameter_mm": 4.0}
    ],
    "asphere": [
        {"radius_mm": 9.0, "asphere_mm": [1e-4], "thickness_mm": 4.0, "semi_diameter_mm": 3.5},
        {"radius_mm": -12.0, "semi_diameter_mm": 3.5},
    ],
}  # fmt: skip


@pytest.mark.parametrize("lens", PLAIN)
@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_a_gradient_of_zero_is_plain_glass(lens: str, engine: str) -> None:
    """With reflections by packets: every end of every ray, to rounding."""
    front, back = PLAIN[lens]
    flat = {"kind": "radial_n", "index": 1.6, "coefficients": [0.0]}
    plain, graded = built([front | {"index": 1.6}, back]), built([front | {"gradient": flat}, back])
    assert graded.tables.lens.gradients is not None
    split = "transmit" if engine == "sequential" else "both"
    rays = into(300, 5)
    given = {"split": split, "engine": engine} | ({"weight_cutoff": 0.0, "max_events": 5} if split == "both" else {})
    one, other = lf.trace(plain, *rays, **given), lf.trace(graded, *rays, **given)
    assert len(one.source) == len(other.source)

    def ordered(paths: lf.Paths) -> Array:
        edge = np.isin(paths.body, ["lens[0] edge", "mount", "stop"])
        table = np.column_stack([paths.source, paths.events, np.where(edge, 0.0, 1.0), paths.weight])
        # Edges are polygons for a mesh, and circles for curves, so some rays end on the mount instead.
        places = np.where(edge[:, None], 0.0, np.hstack([paths.position, paths.direction]))
        rows = np.hstack([table, places])
        return rows[np.lexsort(np.round(rows, 9).T[::-1])]

    np.testing.assert_allclose(ordered(one), ordered(other), atol=2e-12, rtol=1e-12)


@pytest.mark.parametrize("engine", ["mesh", "sequential"])
def test_absorption_follows_the_length_of_the_curve(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A ray on a helix about the axis keeps its index, so its length is known: n σ, with σ = z / T_z."""
    world, per_mm = built(rod(20.0)), 0.03
    r = 1.5
    n, around = index_in_rod(np.array([r, 0.0])), INDEX * ALPHA * r
    along = np.sqrt(n * n - around**2)
    length = n * 20.0 / along
    plain = tracing.at_wavelength(world, NM)
    media = plain.lens.media
    slot = np.where(np.arange(len(media.indices)) == plain.lens.medium[1], 0, -1) + 1
    dyed = Absorption(np.where(slot[:, None] > 0, per_mm, 0.0) * np.ones_like(media.indices),
                      np.where(slot > 0, world.slots.index("housing"), 0))  # fmt: skip
    tables = plain._replace(lens=plain.lens._replace(media=media._replace(absorption=dyed)))
    d = np.array([0.0, around, np.sqrt(1.0 - around**2)])
    rays = [[r, 0.0, 0.0] - 1e-3 * d], [d]
    weights = []
    for each in (plain, tables):
        monkeypatch.setattr(tracing, "at_wavelength", lambda *_, each=each: each)
        paths = lf.trace(world, *rays, split="transmit", engine=engine)
        weights.append(float(paths.weight[paths.status == lf.Status.SENSOR].sum()))
    assert weights[0] > 0.8
    # The ray starts a thousandth of a millimetre before the face, off the helix by that.
    assert weights[1] / weights[0] == pytest.approx(np.exp(-per_mm * length), rel=1e-6)
    assert weights[1] / weights[0] != pytest.approx(np.exp(-per_mm * 20.0), rel=1e-3)


def test_a_scene_without_gradients_has_no_table() -> None:
    front, back = PLAIN["meniscus"]
    lens = built([front | {"index": 1.6}, back]).tables.lens
    assert lens.gradients is None
    assert not fills_space(lens.gradients, 1)


def test_a_trace_refuses_facets() -> None:
    with pytest.raises(lf.LfmeshError, match="gradient-index glass end on exact surfaces"):
        lf.trace(built(rod()), [[0, 0, -9]], [[0, 0, 1]], surface="flat")


def test_an_index_that_is_not_real_is_refused() -> None:
    steep = {"kind": "radial_n2", "index": 1.6, "coefficients": [-0.15]}
    with pytest.raises(SceneError, match=r"surfaces\[0\]\.gradient: .*n² = -0.896 at 3 mm from the axis"):
        built(rod(10.0, 3.0, steep))


def test_auto_never_takes_the_mesh_through_a_gap() -> None:
    """Of packets in the glass, none is compared with a mesh, nor asks for one."""
    world = built(rod())
    assert [engine_of(camera(rod(), transport=each))[0] for each in ({}, {"split": "transmit"})] == [
        "both", "sequential",
    ]  # fmt: skip
    options = options_of(world)
    assert options.faces == BY_ORDER_OR_MESH
    packets = np.zeros(2, PACKET)
    packets["frame"], packets["space"], packets["dz"] = CAMERA_FRAME, 1, 1.0
    assert compare(world, options, world.tables, packets).compared == 0
