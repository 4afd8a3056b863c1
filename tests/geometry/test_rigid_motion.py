"""Rigid motions against rotation matrices, and screws through given poses."""

import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from lfmesh.geometry import frame, rigid_motion


def drawn_pose(draw: np.random.Generator) -> np.ndarray:
    return np.column_stack([Rotation.random(random_state=draw).as_matrix(), draw.normal(0.0, 100.0, 3)])


def square(pose: np.ndarray) -> np.ndarray:
    return np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])


def test_poses_are_joined_by_the_screw_of_the_matrix_logarithm() -> None:
    draw = np.random.default_rng(1)
    for _ in range(20):
        first, second = drawn_pose(draw), drawn_pose(draw)
        motion = rigid_motion.through_poses([2.0, 5.0], np.array([first, second]))
        twist = np.real(logm(square(second) @ np.linalg.inv(square(first))))
        for share in (0.0, 0.3, 1.0, 1.5):
            expected = np.real(expm(share * twist)) @ square(first)
            found = rigid_motion.pose_at(motion, 2.0 + 3.0 * share)
            np.testing.assert_allclose(found, expected[:3], rtol=0, atol=1e-9)


def test_each_pose_is_met_at_its_time() -> None:
    draw = np.random.default_rng(2)
    poses = np.array([drawn_pose(draw) for _ in range(5)])
    times = [-1.0, 0.0, 0.5, 3.0, 3.25]
    motion = rigid_motion.through_poses(times, poses)
    for time, pose in zip(times, poses, strict=True):
        np.testing.assert_allclose(rigid_motion.pose_at(motion, time), pose, rtol=0, atol=1e-10)


def test_a_slide_and_a_rest_are_no_turn() -> None:
    first = frame.frame((10, 20, 30), (1, 2, 3))
    second = first + np.array([[0, 0, 0, 4.0], [0, 0, 0, 5.0], [0, 0, 0, 6.0]])
    motion = rigid_motion.through_poses([0.0, 2.0], np.array([first, second]))
    np.testing.assert_allclose(rigid_motion.pose_at(motion, 1.0)[:, 3], [3.0, 4.5, 6.0], rtol=1e-14)
    assert motion["rate"][0] == 0.0
    rest = rigid_motion.through_poses([0.0], first[None])
    np.testing.assert_array_equal(rigid_motion.pose_at(rest, 7.0), first)


def test_a_steady_motion_turns_about_a_centre_that_moves_along() -> None:
    velocity, spin, centre = np.array([3.0, -2.0, 5.0]), np.array([90.0, 0.0, 120.0]), np.array([10.0, 20.0, -300.0])
    motion = rigid_motion.steady(velocity, spin, centre)
    turn = Rotation.from_rotvec(np.deg2rad(spin) * 0.7).as_matrix()
    p = np.array([11.0, 25.0, -290.0])
    expected = centre + 0.7 * velocity + turn @ (p - centre)
    np.testing.assert_allclose(frame.points(rigid_motion.pose_at(motion, 0.7), p[None])[0], expected, rtol=1e-13)


@pytest.mark.parametrize("seed", range(5))
def test_no_point_is_faster_than_the_bound(seed: int) -> None:
    draw = np.random.default_rng(seed)
    motion = rigid_motion.through_poses([0.0, 1.0, 1.5], np.array([drawn_pose(draw) for _ in range(3)]))
    p = draw.normal(0.0, 50.0, (10, 3))
    times = np.linspace(0.0, 1.5, 3001)
    places = np.array([frame.points(rigid_motion.pose_at(motion, float(t)), p) for t in times])
    fastest = np.linalg.norm(np.diff(places, axis=0), axis=2).max() / (times[1] - times[0])
    bound = rigid_motion.greatest_speed(motion, p)
    assert fastest <= bound * (1.0 + 1e-9)
    assert bound < 2.0 * fastest


def off_chords(places: np.ndarray, points: np.ndarray) -> float:
    """Return the largest distance of points (n, 3) from a path of straight pieces through places (k, 3)."""
    start, along = places[:-1], np.diff(places, axis=0)
    square_length = np.maximum((along**2).sum(axis=1), np.finfo(np.float64).tiny)
    share = np.einsum("nki,ki->nk", points[:, None] - start, along) / square_length
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return float(np.linalg.norm(points[:, None] - nearest, axis=2).min(axis=1).max())


@pytest.mark.parametrize("camera_moves", [False, True])
@pytest.mark.parametrize("seed", range(5))
def test_every_place_of_a_path_lies_within_the_margin_of_its_sweep(seed: int, camera_moves: bool) -> None:
    draw = np.random.default_rng(seed)
    motion, camera = (
        rigid_motion.through_poses([0.0, 1.0, 1.5], np.array([drawn_pose(draw) for _ in range(3)])) for _ in range(2)
    )
    points = draw.normal(0.0, 50.0, (4, 3))
    seen = camera if camera_moves else None
    places, margin = rigid_motion.sweep(motion, points, 0.2, 2.0, seen)
    frames = [rigid_motion.seen_from(seen, motion, float(t)) for t in np.linspace(0.2, 2.0, 1001)]
    path = np.array([frame.points(pose, points) for pose in frames])
    np.testing.assert_allclose(places[[0, -1]], path[[0, -1]], rtol=1e-12)
    off = max(off_chords(places[:, k], path[:, k]) for k in range(len(points)))
    assert 0.02 * margin < off <= margin
    assert margin < 0.02 * np.ptp(places, axis=(0, 1)).max()


def test_the_sweep_of_a_slide_is_its_two_ends() -> None:
    motion = rigid_motion.steady((10.0, 0.0, -5.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    places, margin = rigid_motion.sweep(motion, np.zeros((1, 3)), 0.0, 2.0)
    np.testing.assert_allclose(places[:, 0], [[0.0, 0.0, 0.0], [20.0, 0.0, -10.0]])
    assert margin == 0.0


def test_the_sweep_of_many_turns_about_one_axis_is_that_of_one() -> None:
    motion = rigid_motion.steady((0.0, 0.0, 0.0), (0.0, 0.0, 36e4), (0.0, 0.0, 0.0))
    point = np.array([[100.0, 0.0, 3.0]])
    places, margin = rigid_motion.sweep(motion, point, 0.0, 1.0005)
    assert len(places) < 70
    assert margin < 0.13
    np.testing.assert_allclose(places[-1, 0], [-100.0, 0.0, 3.0], atol=1e-8)
    path = np.array([frame.points(rigid_motion.pose_at(motion, t), point)[0] for t in np.linspace(0.0, 1.0005, 999)])
    assert off_chords(places[:, 0], path) <= margin
