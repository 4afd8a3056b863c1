"""Contacts of moving surfaces against closed forms and dense times."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from lfmesh.geometry import frame, rigid_motion
from lfmesh.geometry.motion_contacts import facets_apart, first_contact, moving_surface, swept_box
from lfmesh.geometry.objects.primitives import primitive
from lfmesh.scene import Box, Sphere

NEAR_MM = 1e-4
REST = rigid_motion.resting()


def facets(shape: Box | Sphere, place_mm: tuple[float, float, float]) -> np.ndarray:
    mesh = primitive(shape).mesh
    return mesh.vertices[mesh.faces] + np.array(place_mm)


def box(size_mm: float, place_mm: tuple[float, float, float]) -> np.ndarray:
    return facets(Box(size_mm=(size_mm, size_mm, size_mm)), place_mm)


def slide(*velocity_mm_s: float) -> np.ndarray:
    return rigid_motion.steady(velocity_mm_s, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def distance_by_search(one: np.ndarray, other: np.ndarray) -> float:
    """Return the distance of two triangles by quadratic optimisation over barycentric coordinates."""

    def square(w: np.ndarray) -> float:
        return float(((w[:3] @ one - w[3:] @ other) ** 2).sum())

    ones = [{"type": "eq", "fun": lambda w, k=k: w[3 * k : 3 * k + 3].sum() - 1.0} for k in (0, 1)]
    options = {"bounds": [(0.0, 1.0)] * 6, "constraints": ones, "options": {"ftol": 1e-14, "maxiter": 500}}
    return float(np.sqrt(minimize(square, np.full(6, 1.0 / 3.0), method="SLSQP", **options).fun))


def test_the_distance_of_triangles_is_the_least_of_all_their_points() -> None:
    draw = np.random.default_rng(1)
    for number in range(60):
        one, other = draw.normal(0.0, 1.0, (2, 3, 3))
        if number % 3 == 1:
            other[1:] = other[0]
        elif number % 3 == 2:
            other[2] = other[1]
        assert facets_apart(one, other) == pytest.approx(distance_by_search(one, other), abs=2e-5)


def test_triangles_that_cut_have_no_distance() -> None:
    one = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 2.0, 0.0]])
    other = np.array([[0.0, 0.0, -1.0], [0.1, 0.0, 1.0], [0.0, 0.1, 1.0]])
    assert facets_apart(one, other) == facets_apart(other, one) == 0.0


def test_a_ball_meets_a_wall_at_the_time_of_its_gap_over_its_speed() -> None:
    ball, wall = facets(Sphere(radius_mm=5.0), (0.0, 0.0, 0.0)), box(20.0, (25.0, 0.0, 0.0))
    reach = ball[..., 0].max()
    found = first_contact(moving_surface(ball, slide(100.0, 0.0, 0.0)), moving_surface(wall, REST), 0.0, 1.0, NEAR_MM)
    assert found == pytest.approx((15.0 - reach) / 100.0, abs=2.0 * NEAR_MM / 100.0)


def test_a_turning_bar_meets_a_wall_at_its_angle() -> None:
    bar = np.array([[[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 0.0, 0.0]]])
    wall = np.array([[[-50.0, 6.0, -50.0], [50.0, 6.0, -50.0], [0.0, 6.0, 50.0]]])
    spin = rigid_motion.steady((0.0, 0.0, 0.0), (0.0, 0.0, 90.0), (0.0, 0.0, 0.0))
    found = first_contact(moving_surface(bar, spin), moving_surface(wall, REST), 0.0, 1.0, NEAR_MM)
    assert found == pytest.approx(np.arcsin(0.6) / (0.5 * np.pi), abs=1e-4)


@pytest.mark.parametrize("gap_mm", [1.0, 0.01, 3.0 * NEAR_MM])
def test_bodies_that_slide_along_each_other_stay_apart_at_any_gap(gap_mm: float) -> None:
    lower = moving_surface(box(20.0, (0.0, 0.0, 0.0)), REST)
    upper = moving_surface(box(20.0, (-6.0, 20.0 + gap_mm, 3.0)), slide(12.0, 0.0, 0.0))
    assert first_contact(lower, upper, 0.0, 1.0, NEAR_MM) == np.inf
    sinking = moving_surface(box(20.0, (-6.0, 20.0 + gap_mm, 3.0)), slide(12.0, -2.0 * gap_mm, 0.0))
    # It is near from twice to once the least distance.
    near = 0.5 * (1.0 - np.array([2.0, 1.0]) * NEAR_MM / gap_mm)
    assert near[0] - 1e-3 < first_contact(lower, sinking, 0.0, 1.0, NEAR_MM) < near[1] + 1e-3


def test_a_body_may_turn_on_a_table_without_steps_in_time() -> None:
    table = moving_surface(box(200.0, (0.0, -110.0 - 2.5 * NEAR_MM, 0.0)), REST)
    spin = rigid_motion.steady((500.0, 0.0, 0.0), (0.0, 36000.0, 0.0), (-50.0, 0.0, 0.0))
    assert first_contact(moving_surface(box(20.0, (0.0, 0.0, 0.0)), spin), table, 0.0, 0.1, NEAR_MM) == np.inf
    tilted = rigid_motion.steady((500.0, 0.0, 0.0), (0.0, 36000.0, 10.0), (-50.0, 0.0, 0.0))
    assert first_contact(moving_surface(box(20.0, (0.0, 0.0, 0.0)), tilted), table, 0.0, 0.1, NEAR_MM) < 0.1


def test_bodies_that_move_as_one_stay_apart() -> None:
    spin = rigid_motion.steady((5.0, 0.0, 0.0), (0.0, 40.0, 100.0), (3.0, 0.0, 0.0))
    one, other = (moving_surface(box(10.0, (11.0 * k, 0.0, 0.0)), spin) for k in range(2))
    assert first_contact(one, other, 0.0, 2.0, NEAR_MM) == np.inf


def test_a_body_inside_another_touches_it_at_its_walls_alone() -> None:
    shell = moving_surface(box(40.0, (0.0, 0.0, 0.0)), REST)
    ball = facets(Sphere(radius_mm=5.0), (0.0, 0.0, 0.0))
    assert first_contact(shell, moving_surface(ball, slide(0.0, 14.0, 0.0)), 0.0, 1.0, NEAR_MM) == np.inf
    assert first_contact(shell, moving_surface(ball, slide(0.0, 16.0, 0.0)), 0.0, 1.0, NEAR_MM) < 1.0


@pytest.mark.parametrize("seed", range(6))
def test_contacts_are_those_of_dense_times(seed: int) -> None:
    draw = np.random.default_rng(seed)

    def drawn_motion() -> np.ndarray:
        turns = Rotation.from_rotvec(draw.normal(0.0, 0.7, (3, 3))).as_matrix()
        poses = np.array([np.column_stack([turn, draw.normal(0.0, 12.0, 3)]) for turn in turns])
        poses[0] = frame.IDENTITY
        return rigid_motion.through_poses([0.0, 0.4, 1.0], poses)

    corners = box(8.0, (-10.0, 0.0, 0.0)), facets(Sphere(radius_mm=4.0), (8.0, 0.0, 0.0))
    motions = drawn_motion(), drawn_motion()
    found = first_contact(*map(moving_surface, corners, motions), 0.0, 1.0, 1e-3)

    def apart(time: float) -> bool:
        """Tell whether the ball's vertices are outside the box, and the box's corners outside the ball."""
        to_box = frame.compose(
            frame.inverse(rigid_motion.pose_at(motions[0], time)), rigid_motion.pose_at(motions[1], time)
        )
        middle = np.array([-10.0, 0.0, 0.0])
        ball = frame.points(to_box, corners[1].reshape(-1, 3)) - middle
        centre = frame.points(to_box, np.array([[8.0, 0.0, 0.0]]))[0] - middle
        nearest = np.clip(centre, -4.0, 4.0)
        return bool((np.abs(ball).max(axis=1) > 4.0).all() and np.linalg.norm(centre - nearest) > 3.9)

    free = [apart(t) for t in np.linspace(0.0, 1.0, 201)]
    first = 1.0 if all(free) else free.index(False) / 200.0
    if found == np.inf:
        assert all(free)
    else:
        assert found <= first + 5e-3
        assert not all(free) or found < 1.0
        assert first - found < 0.1


def test_a_swept_box_holds_the_body_at_all_times() -> None:
    spin = rigid_motion.steady((30.0, 0.0, 0.0), (0.0, 0.0, 500.0), (0.0, 0.0, 0.0))
    corners = box(10.0, (20.0, 0.0, 0.0))
    low, high = swept_box(corners, spin, 0.0, 1.0)
    for time in np.linspace(0.0, 1.0, 101):
        places = frame.points(rigid_motion.pose_at(spin, float(time)), corners.reshape(-1, 3))
        assert (places >= low).all()
        assert (places <= high).all()
