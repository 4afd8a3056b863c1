"""Motions of a scene's objects in the world, against poses by their keys."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lfmesh.geometry import frame
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.motions import motion_of, motions_of
from lfmesh.geometry.rigid_motion import pose_at
from lfmesh.scene import Scene
from tests.cameras import camera_without_array

TIMES = (0.0, 0.004, 0.01)
END = 0.01


def scene(camera: Any = None, **parts: Any) -> Scene:
    table = camera_without_array() | (camera or {})
    return Scene(camera=table, exposure={"duration_s": END}, **parts)


def lamp(motion: Any, **keys: Any) -> Any:
    table = {"power_w": 1.0, "motion": motion} | keys
    return scene(lights=(table,)).lights[0]


def test_poses_go_through_the_poses_of_the_keys() -> None:
    rng = np.random.default_rng(1)
    places, turns = rng.uniform(-50.0, 50.0, (3, 3)), rng.uniform(-40.0, 40.0, (3, 3))
    keys = [{"position_mm": p, "rotation_deg": r} for p, r in zip(places.tolist(), turns.tolist(), strict=True)]
    timed = [{"time_s": t} | pose for t, pose in zip(TIMES, keys, strict=True)]
    body = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "motion": {"poses": timed}} | keys[0]
    made = scene(
        {"pose": {"shift_mm": places[0], "tilt_deg": turns[0]}, "motion": {"poses": [
            {"time_s": t, "shift_mm": p, "tilt_deg": r} for t, p, r in zip(TIMES, places.tolist(), turns.tolist(),
                                                                             strict=True)]}},
        targets=(body,),
    )  # fmt: skip
    for thing in (made.targets[0], made.camera):
        motion = motion_of(thing)
        assert motion is not None
        for time, place, turn in zip(TIMES, places, turns, strict=True):
            first = frame.frame(turns[0], places[0])
            moved = frame.compose(pose_at(motion, time), first)
            np.testing.assert_allclose(moved, frame.frame(turn, place), atol=1e-12 * 50.0)


def test_a_spin_turns_about_the_position_or_the_centre_that_is_given() -> None:
    table = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "position_mm": [1.0, 2.0, -150.0]}
    spin, velocity, time = np.array([10.0, -20.0, 400.0]), np.array([3.0, 0.0, 70.0]), 0.007
    turn = Rotation.from_rotvec(np.deg2rad(spin) * time).as_matrix()
    for centre, keys in (([1.0, 2.0, -150.0], {}), ([5.0, 0.0, -1.0], {"center_mm": [5.0, 0.0, -1.0]})):
        motion = {"velocity_mm_s": velocity.tolist(), "spin_deg_s": spin.tolist()} | keys
        segments = motion_of(scene(targets=(table | {"motion": motion},)).targets[0])
        assert segments is not None
        pose, point = pose_at(segments, time), np.array([4.0, -3.0, -140.0])
        wanted = turn @ (point - centre) + centre + velocity * time
        np.testing.assert_allclose(frame.points(pose, [point])[0], wanted, rtol=1e-13)


def test_shared_motions_have_the_same_bits() -> None:
    """One mover for each motion: a turntable, and two bodies carried by equal shifts from different places."""
    ball = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "rotation_deg": [10.0, 20.0, 30.0]}
    turntable = {"spin_deg_s": [0.0, 90.0, 0.0], "center_mm": [0.0, 0.0, -100.0]}
    parts = []
    for x in (0.0, 8.0):
        place = [x, 0.0, -100.0]
        shifted = {"poses": [{"time_s": 0.0}, {"time_s": END, "position_mm": [x + 4.0, 0.0, -100.0]}]}
        parts += [ball | {"position_mm": place, "motion": motion} for motion in (turntable, shifted)]
    table, carried, table_2, carried_2 = motions_of(scene(targets=tuple(parts))).bodies
    assert table is not None
    assert carried is not None
    assert table.tobytes() == table_2.tobytes()  # type: ignore[union-attr]
    assert carried.tobytes() == carried_2.tobytes()  # type: ignore[union-attr]


def test_a_spot_swings_by_the_shortest_way_through_any_direction() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        one, other = rng.normal(size=(2, 3))
        poses = [{"time_s": 0.0}, {"time_s": END, "direction": other.tolist()}]
        motion = motion_of(
            lamp({"poses": poses}, kind="spot", half_angle_deg=5.0, direction=one, position_mm=(1, 2, 3))
        )
        assert motion is not None
        pose = pose_at(motion, END)
        unit = [v / np.linalg.norm(v) for v in (one, other)]
        np.testing.assert_allclose(pose[:, :3] @ unit[0], unit[1], atol=1e-13)
        np.testing.assert_allclose(frame.points(pose, [[1.0, 2.0, 3.0]])[0], [1.0, 2.0, 3.0], atol=1e-12)
        angle = float(np.arccos(np.clip(unit[0] @ unit[1], -1.0, 1.0)))
        assert Rotation.from_matrix(pose[:, :3]).magnitude() == pytest.approx(angle, rel=1e-9)


def test_a_rectangle_turns_with_its_sides() -> None:
    keys = {"kind": "rectangle", "width_mm": 3.0, "height_mm": 1.0, "position_mm": [0, 0, 0], "direction": [0, 0, -1]}
    motion = motion_of(lamp({"poses": [{"time_s": 0.0}, {"time_s": END, "turn_deg": 30.0}]}, **keys))
    assert motion is not None
    turned = scene(lights=({"power_w": 1.0, "turn_deg": 30.0} | keys,)).lights[0].axes
    still = scene(lights=({"power_w": 1.0} | keys,)).lights[0].axes
    np.testing.assert_allclose(pose_at(motion, END)[:, :3] @ still.T, turned.T, atol=1e-14)


def test_a_tube_moves_with_both_ends() -> None:
    ends = [[0.0, 0.0, -50.0], [20.0, 0.0, -50.0]], [[5.0, 1.0, -60.0], [5.0, 1.0, -40.0]]
    timed = {"time_s": END, "start_mm": ends[1][0], "end_mm": ends[1][1]}
    tube = lamp({"poses": [{"time_s": 0.0}, timed]}, kind="line", start_mm=ends[0][0], end_mm=ends[0][1])
    motion = motion_of(tube)
    assert motion is not None
    np.testing.assert_allclose(frame.points(pose_at(motion, END), ends[0]), ends[1], atol=1e-12)


@pytest.mark.parametrize(
    "motion",
    [
        {"spin_deg_s": [0.0, 9.0, 0.0]},
        {
            "poses": [
                {"time_s": 0.0},
                {"time_s": END, "position_mm": [3.0, 0.1, -150.0], "rotation_deg": [0.1, 7.0, 9.0]},
            ]
        },
    ],
)
def test_all_of_a_tank_moves_as_one(motion: Any) -> None:
    """Wall, liquid and what is inside, as listed for the scene and as bodies of a solved one, to the bit."""
    tank = {"size_mm": [50, 50, 50], "wall_mm": 2, "wall": {"index": 1.5}, "liquid": {"index": 1.33}, "open": "top"}
    tank |= {"position_mm": [0.0, 0.1, -150.0], "rotation_deg": [0.0, 7.0, 9.0], "motion": motion}
    dye = {"inside": "tanks[0] liquid", "absorption_per_mm": 0.01}
    made = scene(tanks=(tank,), media=(dye,))
    motions, solved = motions_of(made), motions_of(solved_camera(made).scene.changed({"transport.seed": 3}))
    bits = motion_of(made.tanks[0]).tobytes()  # type: ignore[union-attr]
    for each in (*motions.bodies, *motions.media, *solved.bodies, *solved.media):
        assert each is not None
        assert each.tobytes() == bits


def test_bodies_on_a_carriage_share_poses_about_its_centre() -> None:
    carriage = [0.0, 0.0, -100.0]
    timed = [{"time_s": 0.0}, {"time_s": END, "position_mm": [9.0, 0.0, -100.0], "rotation_deg": [0.0, 30.0, 0.0]}]
    ball = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "motion": {"center_mm": carriage, "poses": timed}}
    one, other = scene(targets=(ball, ball | {"position_mm": [4.0, 2.0, -100.0]})).targets
    motion, same = motion_of(one), motion_of(other)
    assert motion is not None
    assert motion.tobytes() == same.tobytes()  # type: ignore[union-attr]
    wanted = frame.frame((0.0, 30.0, 0.0), (9.0, 0.0, -100.0))
    np.testing.assert_allclose(
        frame.points(pose_at(motion, END), [[4.0, 2.0, -100.0]]), frame.points(wanted, [[4.0, 2.0, 0.0]]), atol=1e-12
    )


def test_rest_has_no_motion() -> None:
    ball = {"shape": {"kind": "sphere", "radius_mm": 1.0}, "motion": {"velocity_mm_s": [0.0, 0.0, 0.0]}}
    assert motions_of(scene(targets=(ball,))) == (None, (None,), (), ())
