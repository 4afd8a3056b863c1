"""Rays through index fields in closed form: errors of the steps alone, without those of interpolation."""

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.index_field_path import (
    INSIDE,
    MOST_CHORDS,
    chords,
    deflections,
    entries,
    traced,
    unit_directions,
)
from lfmesh.optics.index_fields import LEAPFROG, RUNGE_KUTTA, IndexFields, field_table, index_field, indices_at
from tests.optics.closed_fields import (
    BALL,
    HARMONIC,
    LAYER,
    LINEAR,
    ball_deflection,
    ball_path,
    box,
    field,
    followed,
    in_duct,
    in_linear_index,
    over_hot_plate,
    start,
)

Array = NDArray[np.float64]

WIDTH = 8.0
IMPACTS = np.array([1.0, 4.0, 5.6, 8.0, 12.0])
WEAK, STRONG = 2e-4, 0.1
BACK = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 0.0, 0.0])
SCHEMES = [LEAPFROG, RUNGE_KUTTA]
ORDER = {LEAPFROG: 2.0, RUNGE_KUTTA: 4.0}


def past_ball(delta: float) -> tuple[Array, Array]:
    """Return the field of a ball, and rays along z at the impact parameters."""
    ball, zero = field(BALL, delta, WIDTH), 0.0 * IMPACTS
    return ball, start(ball, np.column_stack([IMPACTS, zero, zero - 48.0]), np.tile([0.0, 0.0, 1.0], (len(IMPACTS), 1)))


def deflection_error(delta: float, scheme: int, step: float) -> float:
    """Return the largest error of the deflection by a ball, over the largest deflection."""
    ball, rays = past_ball(delta)
    faces, ends = followed(ball, box(96.0, step, scheme), rays)
    assert (faces == 5).all()
    truth = np.array([ball_deflection(delta, WIDTH, impact) for impact in IMPACTS])
    return float(np.abs(deflections(rays, ends) - truth).max() / truth.max())


def test_the_weak_deflection_is_borns_integral() -> None:
    """The truth of the tests: 2 δ b √π/w exp(−b²/w²) but for a relative error of order δ."""
    for impact in IMPACTS:
        born = 2.0 * impact * math.sqrt(math.pi) / WIDTH * math.exp(-((impact / WIDTH) ** 2))
        errors = [ball_deflection(delta, WIDTH, impact) / (delta * born) - 1.0 for delta in (1e-4, 1e-6)]
        assert abs(errors[1]) < 2e-6
        assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.01)


def test_leapfrog_steps_of_four_voxels_suffice_in_a_weak_field() -> None:
    """Steps of half the ball's width: the relative error is 0.021 δ, of order two, and below that of the grid."""
    coarse, fine = (deflection_error(WEAK, LEAPFROG, step) for step in (4.0, 2.0))
    assert coarse < 5e-6
    assert coarse / fine == pytest.approx(4.0, rel=0.1)
    assert deflection_error(0.1 * WEAK, LEAPFROG, 4.0) == pytest.approx(0.1 * coarse, rel=0.01)


def test_runge_kutta_steps_of_two_voxels_suffice_in_a_strong_field() -> None:
    errors = [deflection_error(STRONG, RUNGE_KUTTA, step) for step in (2.0, 1.0, 0.5)]
    assert errors[0] < 5e-6
    assert np.log2(np.divide(errors[:2], errors[1:])) == pytest.approx(ORDER[RUNGE_KUTTA], abs=0.3)
    assert deflection_error(STRONG, LEAPFROG, 2.0) > 100.0 * errors[0]


@pytest.mark.parametrize(
    ("delta", "scheme", "step", "within"),
    [(WEAK, LEAPFROG, 4.0, 1e-8), (WEAK, RUNGE_KUTTA, 2.0, 2e-10), (STRONG, RUNGE_KUTTA, 0.5, 2e-7)],
)
def test_the_optical_path_past_a_ball_is_bouguers_integral(
    delta: float, scheme: int, step: float, within: float
) -> None:
    ball, rays = past_ball(delta)
    _, ends = followed(ball, box(96.0, step, scheme), rays[2:3])
    impact = IMPACTS[2]
    radius = math.hypot(impact, 48.0)
    along, point = unit_directions(ends)[0], ends[0, :3]
    to_radius = math.sqrt((point @ along) ** 2 + radius**2 - point @ point) - point @ along
    assert abs(ends[0, 6] + to_radius - ball_path(delta, WIDTH, impact, radius)) < within


@pytest.mark.parametrize(("scheme", "step", "within"), [(LEAPFROG, 4.0, 3e-14), (RUNGE_KUTTA, 0.5, 3e-9)])
def test_bouguers_law_holds(scheme: int, step: float, within: float) -> None:
    """The moment r × T about the centre: to rounding in leapfrog steps of any length."""
    ball, rays = past_ball(STRONG)
    _, ends = followed(ball, box(96.0, step, scheme), rays)
    change = np.cross(ends[:, :3], ends[:, 3:6]) - np.cross(rays[:, :3], rays[:, 3:6])
    assert np.abs(change).max() < within * 48.0


@pytest.mark.parametrize(("scheme", "orders"), [(LEAPFROG, 2.0), (RUNGE_KUTTA, 4.0)])
def test_the_ray_vector_has_the_length_of_the_index(scheme: int, orders: float) -> None:
    ball, rays = past_ball(STRONG)
    errors = []
    for step in (2.0, 1.0):
        _, ends = followed(ball, box(96.0, step, scheme), rays)
        errors.append(np.abs((ends[:, 3:6] ** 2).sum(axis=1) - 1.0).max())
    assert errors[1] < 4e-6
    assert math.log2(errors[0] / errors[1]) > orders - 0.3


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_etendue_is_conserved_but_for_the_error_of_integration(scheme: int) -> None:
    """The determinant of the Jacobian of (x, y, T_x, T_y) from the plane of the entry to that of the exit."""
    ball, change = field(BALL, STRONG, WIDTH), 1e-5
    centre = np.array([4.0, -3.0, 0.05, 0.02])
    states = np.array([centre + sign * change * row for row in np.eye(4) for sign in (1.0, -1.0)])
    rays = np.zeros((8, 8))
    rays[:, :2], rays[:, 2], rays[:, 3:5] = states[:, :2], -48.0, states[:, 2:]
    rays[:, 5] = np.sqrt(1.0 - (states[:, 2:] ** 2).sum(axis=1))
    errors = []
    for step in (2.0, 1.0):
        faces, ends = followed(ball, box(96.0, step, scheme), rays)
        assert (faces == 5).all()
        columns = (ends[0::2] - ends[1::2])[:, [0, 1, 3, 4]] / (2.0 * change)
        errors.append(abs(np.linalg.det(columns) - 1.0))
    assert errors[1] < {LEAPFROG: 1e-4, RUNGE_KUTTA: 1e-6}[scheme]
    assert errors[1] < 0.4 * errors[0]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_parabolic_duct_is_harmonic(scheme: int) -> None:
    rates = np.array([0.02, 0.03, 0.0])
    duct = field(HARMONIC, 1.3, *rates)
    rays = start(duct, [(3.0, -2.0, -100.0)], [(0.1, 0.05, 1.0)])
    truth = in_duct(rays[0], rates, 200.0 / mp.mpf(rays[0, 5]))
    errors = []
    for step in (4.0, 2.0, 1.0):
        faces, ends = followed(duct, box((100.0, 100.0, 200.0), step, scheme), rays)
        assert faces[0] == 5
        errors.append(np.abs(ends[0, :6] - truth).max())
    assert np.log2(np.divide(errors[:2], errors[1:])) == pytest.approx(ORDER[scheme], abs=0.15)
    assert errors[1] < {LEAPFROG: 2e-3, RUNGE_KUTTA: 3e-7}[scheme]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_mirage_over_a_hot_plate_turns_rays_upwards(scheme: int) -> None:
    strength, height = 6e-4, 5.0
    layer = field(LAYER, 1.0, strength, height)
    rays = start(layer, [(0.0, 10.0, 0.0)], [(0.0, -0.01, 1.0)])
    y, rise = over_hot_plate(rays[0], strength, height, 2000.0 / mp.mpf(rays[0, 5]))
    assert rise > 0.012
    errors = []
    for step in (40.0, 20.0, 10.0):
        faces, ends = followed(layer, box((10.0, 40.0, 2000.0), step, scheme, low=[-5.0, -5.0, 0.0]), rays)
        assert faces[0] == 5
        errors.append(max(abs(ends[0, 1] - y), 1e3 * abs(ends[0, 4] - rise)))
    assert np.log2(np.divide(errors[:2], errors[1:])) == pytest.approx(ORDER[scheme], abs=0.15)
    assert errors[1] < {LEAPFROG: 1e-3, RUNGE_KUTTA: 1e-7}[scheme]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("direction", "face"), [((0.1, 1.0, 0.3), 2), ((0.5, 0.15, 0.1), 2), ((0.05, 0.3, 1.0), 5)])
def test_rays_in_a_linear_field_are_parabolas(scheme: int, direction: Any, face: int) -> None:
    """n² = n₀² + 2 a y: exact in both schemes, also where the ray turns and leaves by the face that it entered by."""
    slope = -0.2
    linear = field(LINEAR, 1.5, slope)
    rays = start(linear, [(-15.0, -20.0, -18.0)], [direction])
    if face == 5:
        rays[0, 2] = -3.0
    sigma = -2.0 * rays[0, 4] / slope if face == 2 else (20.0 - rays[0, 2]) / rays[0, 5]
    faces, ends = followed(linear, box(40.0, 2.0, scheme), rays)
    assert faces[0] == face
    at = rays[0, :3] + sigma * rays[0, 3:6] + [0.0, 0.5 * slope * sigma**2, 0.0]
    along = rays[0, 3:6] + [0.0, slope * sigma, 0.0]
    np.testing.assert_allclose(ends[0, :6], [*at, *along], rtol=0.0, atol=1e-12)


def test_a_linear_index_is_a_catenary() -> None:
    """n = n₀ + a y, exact on a grid: n₀ + a y = C cosh(a z/C + k), with C the constant T along z."""
    n0, slope = 1.2, 0.004
    heights = np.arange(41.0) - 20.0
    values = np.broadcast_to((n0 + slope * heights)[:, None], (5, 41, 61))
    table = field_table([index_field(values, 1.0)])
    table.rows["scheme"], table.rows["step"] = RUNGE_KUTTA, 0.5
    rays = entries(table, 0, [(0.0, -10.0, -40.0)], [(0.0, 0.0, 1.0)])
    faces, ends = traced(table, 0, rays)
    truth, _ = in_linear_index(rays[0], n0, slope, 61.0)
    assert faces[0] == 5
    np.testing.assert_allclose(ends[0, :3], truth[:3], rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(ends[0, 3:6], truth[3:], rtol=0.0, atol=1e-11)


def blobs(amplitude: float, seed: int = 0) -> IndexFields:
    """Return a random smooth field on a grid of uneven voxels."""
    draw = np.random.default_rng(seed)
    shape, spacing = (30, 24, 40), np.array([1.0, 1.5, 0.8])
    at = (np.moveaxis(np.indices(shape), 0, -1) - 0.5 * (np.array(shape) - 1)) * spacing
    centres, widths = draw.uniform(-9.0, 9.0, (6, 3)), draw.uniform(4.0, 7.0, 6)
    values = sum(
        sign * np.exp(-((at - c) ** 2).sum(axis=-1) / w**2)
        for sign, c, w in zip([1, -1] * 3, centres, widths, strict=True)
    )
    return field_table([index_field(1.0003 + amplitude * values, spacing)])


def random_rays(table: IndexFields, count: int = 300) -> Array:
    draw = np.random.default_rng(1)
    directions = draw.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    rays = entries(table, 0, draw.uniform(-10.0, 10.0, (count, 3)) - 200.0 * directions, directions)
    assert not np.isnan(rays).any()
    return rays


def leading(rays: Array, table: IndexFields) -> NDArray[np.int64]:
    return np.argmax(np.abs(rays[:, 3:6]) * table.rows["per_mm"][0], axis=1)


def test_a_leapfrog_ray_that_is_sent_back_returns_to_its_start() -> None:
    """To rounding, with its path and length, though its steps are wrong by much more."""
    table = blobs(3e-3)
    rays = random_rays(table)
    faces, ends = traced(table, 0, rays)
    assert set(faces.tolist()) == set(range(6))
    returned, starts = traced(table, 0, ends * BACK)
    same = leading(rays, table) == leading(ends, table)
    assert same.mean() > 0.98
    starts, ends, rays = starts[same], ends[same], rays[same]
    assert (returned[same] >= 0).all()
    np.testing.assert_allclose(starts[:, :6] * BACK[:6], rays[:, :6], rtol=0.0, atol=2e-13)
    np.testing.assert_allclose(starts[:, 6:], ends[:, 6:], rtol=2e-14)


@pytest.mark.parametrize(
    ("scheme", "step", "within"), [(LEAPFROG, 4.0, 1e-4), (RUNGE_KUTTA, 2.0, 2e-5), (RUNGE_KUTTA, 0.5, 2e-7)]
)
def test_any_ray_returns_but_for_the_error_of_integration(scheme: int, step: float, within: float) -> None:
    table = blobs(3e-3)
    table.rows["scheme"], table.rows["step"] = scheme, step
    rays = random_rays(table)
    _, ends = traced(table, 0, rays)
    _, starts = traced(table, 0, ends * BACK)
    assert deflections(starts * BACK, rays).max() < within


@pytest.mark.parametrize("scheme", SCHEMES)
def test_rays_leave_by_the_faces_of_the_box(scheme: int) -> None:
    """On the face to the last bit, inside the others, outwards."""
    table = blobs(3e-3)
    table.rows["scheme"], table.rows["step"] = scheme, 2.0
    faces, ends = traced(table, 0, random_rays(table))
    box_low, box_high = table.rows["low"][0], table.rows["high"][0]
    axes, upper = faces >> 1, faces & 1
    row = np.arange(len(ends))
    assert np.array_equal(ends[row, axes], np.where(upper, box_high[axes], box_low[axes]))
    assert (ends[row, 3 + axes] * np.where(upper, 1.0, -1.0) > 0.0).all()
    slack = 1e-13 * (box_high - box_low)
    assert (ends[:, :3] >= box_low - slack).all()
    assert (ends[:, :3] <= box_high + slack).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_in_a_uniform_field_rays_are_straight(scheme: int) -> None:
    table = field_table([index_field(np.full((30, 24, 40), 1.25), [1.0, 1.5, 0.8])])
    table.rows["scheme"], table.rows["step"] = scheme, 2.0
    rays = random_rays(table)
    _, ends = traced(table, 0, rays)
    assert np.array_equal(ends[:, 3:6], rays[:, 3:6])
    span = ends[:, :3] - rays[:, :3]
    length = np.linalg.norm(span, axis=1)
    np.testing.assert_allclose(np.cross(span, unit_directions(rays)), 0.0, atol=3e-13)
    np.testing.assert_allclose(ends[:, 7], length, rtol=1e-14)
    np.testing.assert_allclose(ends[:, 6], 1.25 * length, rtol=1e-14)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_chords_lead_from_the_entry_to_the_exit(scheme: int) -> None:
    table = blobs(3e-3)
    table.rows["scheme"], table.rows["step"] = scheme, 2.0
    rays = random_rays(table, 50)
    _, ends = traced(table, 0, rays)
    nodes = chords(table, 0, rays, 200)
    last = (~np.isnan(nodes[:, :, 0])).sum(axis=1) - 1
    assert last.min() >= 1
    assert np.array_equal(nodes[:, 0], rays)
    assert np.array_equal(nodes[np.arange(50), last], ends)
    for row, end in zip(nodes, last, strict=True):
        spans = np.diff(row[: end + 1, :3], axis=0)
        assert (np.diff(row[: end + 1, 6]) > 0.0).all()
        voxels = np.abs(spans) * table.rows["per_mm"][0]
        assert voxels.max() < {LEAPFROG: 4.3, RUNGE_KUTTA: 2.1}[scheme]
        if scheme == LEAPFROG:
            np.testing.assert_allclose(np.linalg.norm(spans, axis=1), np.diff(row[: end + 1, 7]), rtol=0.0, atol=1e-13)


def test_chords_that_do_not_fit_are_left_out() -> None:
    table = blobs(3e-3)
    rays = random_rays(table, 20)
    whole, short = chords(table, 0, rays, 100), chords(table, 0, rays, 3)
    assert np.array_equal(short, whole[:, :3], equal_nan=True)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_block_gives_the_bits_of_single_rays(scheme: int) -> None:
    table = blobs(3e-3)
    table.rows["scheme"], table.rows["step"] = scheme, 2.0
    rays = random_rays(table, 40)
    _, together = traced(table, 0, rays)
    assert np.array_equal(together, np.vstack([traced(table, 0, ray)[1] for ray in rays]))


def test_entries_are_those_of_the_box() -> None:
    """Among them rays along an axis, beside the box, behind it, inside it, and in the plane of a face."""
    table = field_table([index_field(np.full((4, 4, 4), 1.5), 1.0)])
    points = [
        (0.5, 0.0, -9.0),
        (2.5, 0.0, -9.0),
        (0.0, 0.0, 9.0),
        (0.3, 0.2, 0.1),
        (2.0, 0.0, -9.0),
        (-4.0, -4.0, -4.0),
    ]
    directions = [(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, -1), (0, 0, 1), np.full(3, 3**-0.5)]
    found = entries(table, 0, points, directions)
    wanted = [(0.5, 0, -2), None, None, (0.3, 0.2, 0.1), (2, 0, -2), (-2, -2, -2)]
    for row, point, along in zip(found, wanted, directions, strict=True):
        if point is None:
            assert np.isnan(row).all()
        else:
            np.testing.assert_allclose(row, [*point, *np.multiply(1.5, along), 0.0, 0.0], atol=1e-15)


def test_a_ray_that_never_leaves_is_trapped() -> None:
    """A circle in n² = n₀² − g² r² at n₀²/2: |T| and the index are constant on it."""
    duct = field(HARMONIC, 1.3, 0.1, 0.1, 0.1)
    rays = start(duct, [(1.3 / math.sqrt(0.02), 0.0, 0.0)], [(0.0, 0.6, 0.8)])
    faces, ends = followed(duct, box(40.0, 2.0, RUNGE_KUTTA), rays)
    assert faces[0] == INSIDE
    assert ends[0, 7] > MOST_CHORDS


def test_an_index_field_agrees_with_its_values_at_the_entry() -> None:
    table = blobs(3e-3)
    rays = random_rays(table)
    index = indices_at(table, 0, rays[:, :3])[:, 0]
    np.testing.assert_allclose(np.linalg.norm(rays[:, 3:6], axis=1), index, rtol=1e-15)
