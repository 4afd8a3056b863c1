"""Rays through gradient-index media: order, energy, reversal, faces, and the number of steps."""

import math
from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import (
    DRIFTS,
    KICKS,
    STAGES,
    ConicFace,
    GradientRay,
    advance,
    conic_height_at,
    starting_rays,
    steps_needed,
    traced,
    tracer,
)
from lfmesh.optics.gradient_shapes import (
    INDEX_SQUARED,
    GradientProfile,
    radial_and_axial_profile,
    radial_square_profile,
    revolved_profile,
    separable_profile,
    spherical_profile,
)
from lfmesh.optics.gradients import Gradients, field_at, gradient_table

Array = NDArray[np.float64]
Traced = tuple[NDArray[np.bool_], Array]

INDEX, RATE = 1.6, 0.3
"""Of the rod n² = n₀² (1 − g² r²)."""

ROD = gradient_table([radial_square_profile(INDEX, [-(RATE**2)])])
REVERSED = np.array([1.0, 1.0, 1.0, -1.0, -1.0, -1.0, 1.0, 1.0])


def direction(angle_deg: float, azimuth_deg: float) -> tuple[float, float, float]:
    angle, azimuth = math.radians(angle_deg), math.radians(azimuth_deg)
    return math.sin(angle) * math.cos(azimuth), math.sin(angle) * math.sin(azimuth), math.cos(angle)


def tracing(table: Gradients, rays: Array, face: ConicFace) -> Callable[[int], Traced]:
    return lambda steps: traced(table, 0, rays, face, steps)


SKEW = starting_rays(ROD, 0, [(0.4, -0.2, 0.0)], [direction(20.0, 50.0)])


def in_rod(ray: Array, length: float) -> Array:
    """Return a ray behind a length of the rod, in 30 digits: harmonic in σ."""
    with mp.workdps(30):
        x, y, z, tx, ty, tz, _, _ = (mp.mpf(float(c)) for c in ray)
        omega, end = mp.mpf(INDEX) * mp.mpf(RATE), mp.mpf(length) / tz
        cos, sin = mp.cos(omega * end), mp.sin(omega * end)

        def square(sigma: Any) -> Any:
            c, s = mp.cos(omega * sigma), mp.sin(omega * sigma)
            r2 = (x * c + tx * s / omega) ** 2 + (y * c + ty * s / omega) ** 2
            return mp.mpf(INDEX) ** 2 - omega**2 * r2

        parts = mp.linspace(0, end, 9)
        path, along = mp.quad(square, parts), mp.quad(lambda sigma: mp.sqrt(square(sigma)), parts)
        found = [x * cos + tx * sin / omega, y * cos + ty * sin / omega, z + length]
        return np.array([*found, tx * cos - omega * x * sin, ty * cos - omega * y * sin, tz, path, along], np.float64)


def test_the_composition_is_symmetric_and_complete() -> None:
    assert len(KICKS) == STAGES == 17
    assert np.array_equal(KICKS, KICKS[::-1])
    assert np.array_equal(DRIFTS, DRIFTS[::-1])
    assert math.fsum(KICKS) == pytest.approx(1.0, abs=3e-16)
    assert math.fsum(DRIFTS) == pytest.approx(1.0, abs=3e-16)


def test_kicks_lie_between_the_ends_of_a_step() -> None:
    places = np.cumsum(DRIFTS)[:-1]
    assert 0.0 < places.min() < places.max() < 1.0


def test_positions_directions_and_paths_converge_with_order_eight() -> None:
    truth = in_rod(SKEW[0], 40.0)
    errors = []
    for steps in (16, 32):
        change = np.abs(traced(ROD, 0, SKEW, ConicFace(0.0, 0.0, 40.0), steps)[1][0] - truth)
        errors.append([np.linalg.norm(change[:2]), np.linalg.norm(change[3:5]), change[6], change[7]])
    orders = np.log2(np.divide(*errors))
    assert (orders > 7.6).all(), orders
    assert orders.mean() < 9.5, orders


@pytest.mark.parametrize("steps_per_turn", [10, 20])
def test_the_square_of_the_ray_vector_stays_near_that_of_the_index(steps_per_turn: int) -> None:
    """Over 200 turns, without drift: the last differences are not larger than the first."""
    ray = GradientRay(*SKEW[0].tolist())
    step = 2.0 * math.pi / (INDEX * RATE) / steps_per_turn
    differences = []
    for _ in range(200 * steps_per_turn):
        ray = advance(ROD, 0, ray, step, 1)
        n2 = INDEX**2 * (1.0 - RATE**2 * (ray.x**2 + ray.y**2))
        differences.append(ray.tx**2 + ray.ty**2 + ray.tz**2 - n2)
    first, last = (np.abs(part).max() for part in np.split(np.array(differences), 10)[::9])
    assert first < 1e-8 * (10 / steps_per_turn) ** 8
    assert last < 1.05 * first + 1e-13


PROFILES: dict[str, GradientProfile] = {
    "rod": radial_square_profile(INDEX, [-(RATE**2), 0.003]),
    "axial": radial_and_axial_profile(1.5, (), (0.05, -0.004)),
    "eye": radial_and_axial_profile(1.368, [-0.001978], [0.049057, -0.015427]),
    "crossed": separable_profile((0.8, 0.01, -0.03), (0.8, -0.02, -0.01, 1e-3), (0.0, 0.03, -0.002)),
    "spherical": spherical_profile(7.0, (1.6, 0.05, -0.006)),
    "mixed": revolved_profile([[2.5, 0.1, -0.02], [-0.2, 0.01, 0.0], [0.002, 0.0, 0.0]], INDEX_SQUARED),
}
FRONT, BACK = ConicFace(1.0 / 9.0, -0.4, 0.0), ConicFace(-1.0 / 7.0, 0.3, 5.0)


def on_face(face: ConicFace, x: Array, y: Array) -> Array:
    r2 = x * x + y * y
    sag = face.curvature * r2 / (1.0 + np.sqrt(1.0 - (1.0 + face.conic) * face.curvature**2 * r2))
    return np.column_stack([x, y, face.vertex_z + sag])


def rays_at(table: Gradients, face: ConicFace, count: int = 40) -> Array:
    draw = np.random.default_rng(8)
    points = on_face(face, *draw.uniform(-1.0, 1.0, (2, count)))
    tilts = np.column_stack([draw.uniform(-0.35, 0.35, (count, 2)), np.ones(count)])
    return starting_rays(table, 0, points, tilts / np.linalg.norm(tilts, axis=1, keepdims=True))


@pytest.mark.parametrize("steps", [6, 16])
@pytest.mark.parametrize("name", PROFILES)
def test_a_ray_that_is_sent_back_returns_to_its_start(name: str, steps: int) -> None:
    """To rounding, though six steps are wrong by much more: its path is its own inverse."""
    table = gradient_table([PROFILES[name]])
    rays = rays_at(table, FRONT)
    reached, ends = traced(table, 0, rays, BACK, steps)
    assert reached.all()
    back = ends * REVERSED
    back[:, 6:] = 0.0
    returned, starts = traced(table, 0, back, FRONT, steps, -1.0)
    assert returned.all()
    np.testing.assert_allclose(starts[:, :6] * REVERSED[:6], rays[:, :6], rtol=0.0, atol=3e-13)
    np.testing.assert_allclose(starts[:, 6:], ends[:, 6:], rtol=0.0, atol=3e-13)


@pytest.mark.parametrize("name", PROFILES)
def test_rays_end_on_the_face(name: str) -> None:
    table = gradient_table([PROFILES[name]])
    reached, ends = traced(table, 0, rays_at(table, FRONT), BACK, 8)
    assert reached.all()
    np.testing.assert_allclose(ends[:, :3], on_face(BACK, *ends[:, :2].T), rtol=0.0, atol=3e-15)


def test_in_a_homogeneous_medium_a_ray_is_straight() -> None:
    table = gradient_table([revolved_profile([1.5])])
    rays = rays_at(table, FRONT)
    reached, ends = traced(table, 0, rays, BACK, 3)
    assert reached.all()
    assert np.array_equal(ends[:, 3:6], rays[:, 3:6])
    span = np.linalg.norm(ends[:, :3] - rays[:, :3], axis=1)
    np.testing.assert_allclose(ends[:, 7], span, rtol=3e-15)
    np.testing.assert_allclose(ends[:, 6], 1.5 * span, rtol=3e-15)
    np.testing.assert_allclose(np.cross(ends[:, :3] - rays[:, :3], rays[:, 3:6]), 0.0, atol=1e-14)


def test_a_block_gives_the_bits_of_single_rays() -> None:
    table = gradient_table([PROFILES["mixed"]])
    rays = rays_at(table, FRONT)
    _, together = traced(table, 0, rays, BACK, 10)
    alone = np.vstack([traced(table, 0, ray, BACK, 10)[1] for ray in rays])
    assert np.array_equal(together, alone)


@inlined
def counted_rod(field: Array, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """A rod that counts its evaluations in field[2]; field[3] is a gradient of n² along z."""
    field[2] += 1.0
    n2, g2, along = field[0] * field[0], field[1] * field[1], field[3]
    return n2 * (1.0 - g2 * (x * x + y * y)) + along * z, -n2 * g2 * x, -n2 * g2 * y, 0.5 * along


_reach_counted = tracer(counted_rod, conic_height_at)


@kernel
def reach_counted(field: Array, ray: GradientRay, face: ConicFace, steps: int) -> tuple[bool, GradientRay]:
    return _reach_counted(field, 0, ray, face, 1.0, steps)


def evaluations(face: ConicFace, along: float = 0.0) -> tuple[GradientRay, float]:
    field = np.array([INDEX, RATE, 0.0, along])
    reached, end = reach_counted(field, GradientRay(*SKEW[0].tolist()), face, 16)
    assert reached
    return end, float(field[2])


def test_a_rod_between_planes_takes_one_trial() -> None:
    end, count = evaluations(ConicFace(0.0, 0.0, 12.0))
    assert count == 16 * STAGES + 3
    np.testing.assert_allclose(end, traced(ROD, 0, SKEW, ConicFace(0.0, 0.0, 12.0), 16)[1][0], rtol=1e-14)


@pytest.mark.parametrize("along", [0.0, 0.05])
def test_a_curved_face_costs_half_as_much_again(along: float) -> None:
    _, count = evaluations(ConicFace(-0.1, 0.0, 12.0), along)
    assert count <= 1.55 * 16 * STAGES


@inlined
def sag_height_at(face: ConicFace, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The height over a sphere by its sag."""
    root = np.sqrt(1.0 - face.curvature * face.curvature * (x * x + y * y))
    sag = (1.0 - root) / face.curvature
    return z - face.vertex_z - sag, -face.curvature * x / root, -face.curvature * y / root, 1.0


_reach_by_sag = tracer(field_at, sag_height_at)


@kernel
def reach_by_sag(gradients: Gradients, ray: GradientRay, face: ConicFace, steps: int) -> tuple[bool, GradientRay]:
    return _reach_by_sag(gradients, 0, ray, face, 1.0, steps)


def test_a_face_may_have_any_function_that_is_zero_on_it() -> None:
    table, sphere = gradient_table([PROFILES["mixed"]]), ConicFace(-1.0 / 7.0, 0.0, 5.0)
    for ray, wanted in zip(rays := rays_at(table, FRONT), traced(table, 0, rays, sphere, 12)[1], strict=True):
        reached, end = reach_by_sag(table, GradientRay(*ray.tolist()), sphere, 12)
        assert reached
        np.testing.assert_allclose(end, wanted, rtol=0.0, atol=1e-12)


def test_rays_that_do_not_reach_a_face_stay_as_they_were() -> None:
    """One leaves the face behind, one passes beside a ball, one meets its far side, one is turned back by the index."""
    ball = ConicFace(1.0 / 2.0, 0.0, 5.0)
    behind = starting_rays(ROD, 0, [(0.1, 0.0, 6.0)], [(0.0, 0.0, 1.0)])
    falling = gradient_table([radial_and_axial_profile(1.8, (), [-0.08])])
    turned = starting_rays(falling, 0, [(0.0, 0.0, 0.0)], [direction(75.0, 10.0)])
    homogeneous = gradient_table([revolved_profile([1.5])])
    beside = starting_rays(homogeneous, 0, [(2.5, 0.0, 0.0)], [(0.0, 0.0, 1.0)])
    inside = starting_rays(homogeneous, 0, [(0.5, 0.0, 7.0)], [(0.0, 0.0, 1.0)])
    for table, rays, face in (
        (ROD, behind, ConicFace(0.0, 0.0, 5.0)),
        (homogeneous, beside, ball),
        (homogeneous, inside, ball),
        (falling, turned, ConicFace(0.0, 0.0, 4.0)),
    ):
        reached, ends = traced(table, 0, rays, face, 8)
        assert not reached.any()
        assert np.array_equal(ends, rays)


def test_a_ball_is_left_on_its_far_side() -> None:
    """Front and back are one sphere, and the ray starts on it. Chords that end in front of its middle do not count."""
    table = gradient_table([revolved_profile([1.5])])
    front, back, middle = ConicFace(1.0 / 3.0, 0.0, 0.0), ConicFace(-1.0 / 3.0, 0.0, 6.0), np.array([0.0, 0.0, 3.0])
    heights = np.array([0.0, 1.0, 2.0, 2.4, 2.7, 2.95])
    points = on_face(front, heights, np.zeros(6))
    for angle_deg in (0.0, 20.0, 40.0, -20.0, -40.0):
        along = np.array(direction(angle_deg, 180.0))
        chords = -2.0 * (points - middle) @ along
        truth = points + chords[:, None] * along
        reached, ends = traced(table, 0, starting_rays(table, 0, points, [along] * 6), back, 12)
        assert np.array_equal(reached, (chords > 0.0) & (truth[:, 2] > 3.0))
        np.testing.assert_allclose(ends[reached, :3], truth[reached], rtol=0.0, atol=3e-14)


def test_probe_rays_give_the_number_of_steps_of_a_tolerance() -> None:
    """It grows as the eighth root of the precision, and is the smallest but for the tolerance's own error."""
    face = ConicFace(0.0, 0.0, 12.0)
    truth = in_rod(SKEW[0], 12.0)
    numbers = []
    for tolerance in (1e-4, 1e-6, 1e-9, 1e-11):
        steps = steps_needed(tracing(ROD, SKEW, face), tolerance)
        errors = [np.abs(traced(ROD, 0, SKEW, face, number)[1][0] - truth) for number in (steps, steps - 1)]
        fine, coarse = (max(np.linalg.norm(error[:3]), 10.0 * error[6]) for error in errors)
        assert fine <= 1.02 * tolerance
        assert coarse > 0.98 * tolerance
        numbers.append(steps)
    assert numbers == sorted(numbers)
    assert numbers[3] / numbers[1] == pytest.approx(1e5**0.125, rel=0.25)


def test_a_homogeneous_medium_needs_one_step() -> None:
    table = gradient_table([revolved_profile([1.5])])
    assert steps_needed(tracing(table, rays_at(table, FRONT), BACK), 1e-9) == 1


def test_a_kink_of_the_index_that_no_number_of_steps_traces_is_refused() -> None:
    table = gradient_table([separable_profile((1.6,), (0.0, -0.05), (), folded=True)])
    starts = [(0.0, y, 0.0) for y in (0.37, 0.21, 0.53, 0.11)]
    rays = starting_rays(table, 0, starts, [direction(15.0, -90.0)] * 4)
    with pytest.raises(
        GlassError, match=r"rays in 4096 steps are wrong by \S+ mm, more than 1e-10 mm; the profile must"
    ):
        steps_needed(tracing(table, rays, ConicFace(0.0, 0.0, 10.0)), 1e-10)


def test_probes_that_all_miss_the_face_are_refused() -> None:
    rays = starting_rays(ROD, 0, [(0.1, 0.0, 6.0)], [(0.0, 0.0, 1.0)])
    with pytest.raises(GlassError, match="1 of 1 probe rays do not reach the next face"):
        steps_needed(tracing(ROD, rays, ConicFace(0.0, 0.0, 5.0)), 1e-9)
