"""The exposure and motions of a scene: windows of rows, the shutter, and what is refused."""

from typing import Any

import numpy as np
import pytest

from lfmesh.errors import SceneError
from lfmesh.scene import Exposure, Motion, Scene, loads
from lfmesh.scene.particle_frames import displaced
from tests.cameras import camera_without_array

BALL = {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -150.0]}
POINT = {"kind": "point", "position_mm": [0.0, 50.0, -100.0], "power_w": 1.0}
SUN = {"kind": "directional", "direction": [0.0, -1.0, -1.0], "irradiance_w_m2": 1.0}
SPOT = {"kind": "spot", "position_mm": [0.0, 0.0, 0.0], "direction": [0, 0, -1], "half_angle_deg": 9.0, "power_w": 1.0}
TUBE = {"kind": "line", "start_mm": [0.0, 0.0, -50.0], "end_mm": [20.0, 0.0, -50.0], "power_w": 1.0}
SMOKE = {"absorption_per_mm": 0.01, "bounds": {"kind": "sphere", "radius_mm": 9.0}, "position_mm": [0.0, 0.0, -90.0]}
TANK = {"size_mm": [50, 50, 50], "wall_mm": 2, "wall": {"index": 1.5}, "liquid": {"index": 1.33}}
DUST = {
    "count": 3, "bounds": {"kind": "sphere", "radius_mm": 9.0}, "intensity_w_sr": 1.0,
    "displacement": {"kind": "uniform", "vector_mm": [1.0, 0.0, 0.0]},
}  # fmt: skip
SHORT = {"duration_s": 0.01}
RIGHT = {"velocity_mm_s": [3.0, 0.0, 0.0]}


def scene(exposure: Any = SHORT, camera: Any = None, **parts: Any) -> Scene:
    return Scene(camera=camera_without_array() | (camera or {}), exposure=exposure, **parts)


def with_motion(thing: dict[str, Any], motion: Any) -> dict[str, Any]:
    return thing | {"motion": motion}


def poses(*given: dict[str, Any], end_s: float = 0.01) -> dict[str, Any]:
    """Poses at times evenly up to the end."""
    return {"poses": [{"time_s": float(t)} | pose for t, pose in zip(np.linspace(0.0, end_s, len(given)), given)]}  # noqa: B905


def test_windows_of_a_rolling_shutter_follow_the_upright_picture() -> None:
    exposure = Exposure(duration_s=0.01, row_time_s=0.002)
    begin, duration, end = exposure.windows(4)
    np.testing.assert_allclose(begin, [0.0, 0.002, 0.004, 0.006], rtol=1e-15)
    assert (duration, end) == (0.01, pytest.approx(0.016))
    up = Exposure(duration_s=0.01, row_time_s=0.002, row_direction="up")
    np.testing.assert_array_equal(up.windows(4)[0], begin[::-1])
    # A lens that does not invert has the top of the picture in its sensor's last row.
    np.testing.assert_array_equal(exposure.windows(4, inverts=False)[0], begin[::-1])
    np.testing.assert_array_equal(up.windows(4, inverts=False)[0], begin)
    assert not Exposure(duration_s=0.01).windows(4)[0].any()


def test_a_shutter_can_be_omitted_again() -> None:
    curved = scene({"duration_s": 0.1, "shutter": [[0.0, 0.0], [0.1, 1.0]]})
    assert curved.changed({"exposure.shutter": None}).exposure == Exposure(duration_s=0.1)


def test_the_shutter_is_open_for_the_integral_of_its_curve() -> None:
    assert Exposure(duration_s=0.3).open_s == 0.3
    table = Exposure(duration_s=0.4, shutter=((0.0, 0.0), (0.1, 1.0), (0.3, 0.5), (0.4, 0.0))).shutter_table()
    np.testing.assert_allclose(table[2], [0.0, 0.05, 0.2, 0.225], rtol=1e-15)


@pytest.mark.parametrize(
    ("exposure", "message"),
    [
        ({}, "exposure.duration_s: missing"),
        ({"duration_s": 0.0}, "exposure.duration_s = 0.0: must be above 0"),
        ({"duration_s": float("inf")}, "exposure.duration_s"),
        ({"duration_s": 0.1, "row_time_s": -1e-5}, "exposure.row_time_s = -1e-05: must be 0 or more"),
        ({"duration_s": 0.1, "row_direction": "left"}, "exposure.row_direction"),
        ({"duration_s": 0.1, "shutter": []}, "must run from 0 to duration_s = 0.1"),
        ({"duration_s": 0.1, "shutter": [[0.0, 1.0]]}, "must run from 0 to duration_s = 0.1"),
        ({"duration_s": 0.1, "shutter": [[0.0, 1.0], [0.2, 1.0]]}, "must run from 0 to duration_s = 0.1"),
        ({"duration_s": 0.1, "shutter": [[0.01, 1.0], [0.1, 1.0]]}, "must run from 0 to duration_s = 0.1"),
        ({"duration_s": 0.1, "shutter": [[0, 1], [0.05, 1], [0.05, 0], [0.1, 0]]}, "its times must increase"),
        ({"duration_s": 0.1, "shutter": [[0.0, 0.0], [0.1, 0.0]]}, "never opens"),
        ({"duration_s": 0.1, "shutter": [[0.0, 1.5], [0.1, 1.0]]}, "must be 1 or less"),
        ({"duration_s": 0.1, "exposure_s": 1.0}, "unknown key"),
    ],
)
def test_exposures_without_a_window_or_light_are_refused(exposure: Any, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        scene(exposure)


MOVING = {
    "targets": (with_motion(BALL, RIGHT),),
    "tanks": (with_motion(TANK, {"spin_deg_s": [0.0, 9.0, 0.0], "center_mm": [1.0, 2.0, 3.0]}),),
    "lights": (
        with_motion(SUN, {"spin_deg_s": [9.0, 0.0, 0.0]}),
        with_motion(SPOT, poses({}, {"direction": [1, 0, -1]})),
    ),
    "media": (with_motion(SMOKE, poses({"position_mm": [0.0, 0.0, -90.0]}, {"rotation_deg": [0.0, 90.0, 0.0]})),),
}  # fmt: skip


def test_a_moving_scene_survives_its_file() -> None:
    moving = scene(
        {"duration_s": 0.01, "shutter": [[0.0, 0.0], [0.01, 1.0]]},
        {"motion": poses({}, {"shift_mm": [1.0, 0.0, 0.0]}, {"tilt_deg": [0.0, 1.0, 0.0]})},
        **MOVING,
        particles=(DUST | {"frame_time_s": 0.1},),
    )
    assert moving.moves
    assert loads(moving.dump_toml()) == moving
    assert loads(moving.dump_toml()).digest == moving.digest


@pytest.mark.parametrize("part", [*MOVING, "camera", "particles"])
def test_each_kind_of_object_makes_a_scene_move(part: str) -> None:
    assert not scene(targets=(BALL,), lights=(POINT,), media=(SMOKE,), particles=(DUST,)).moves
    if part == "camera":
        assert scene(camera={"motion": RIGHT}).moves
    elif part == "particles":
        assert scene(particles=(DUST | {"frame_time_s": 0.1},)).moves
    else:
        assert scene(**{part: MOVING[part]}).moves


@pytest.mark.parametrize(
    "motion",
    [{"velocity_mm_s": [0, 0, 0]}, {"spin_deg_s": [0, 0, 0]}, poses({}, {}), poses({}, {"position_mm": [0, 0, -150]})],
)
def test_a_motion_at_rest_does_not_make_a_scene_move(motion: Any) -> None:
    assert not scene(targets=(with_motion(BALL, motion),)).moves


@pytest.mark.parametrize(
    ("thing", "motion", "message"),
    [
        (BALL, {}, r"targets\[0\].motion: missing: give velocity_mm_s, spin_deg_s or poses"),
        (BALL, {"velocity_mm_s": [1.0, 0.0]}, r"targets\[0\].motion.velocity_mm_s"),
        (BALL, RIGHT | {"center_mm": [0.0, 0.0, 0.0]}, "center_mm.*needs spin_deg_s"),
        (BALL, RIGHT | poses({}, {}), r"velocity_mm_s = \[3.0, 0.0, 0.0\]: poses are given too"),
        (BALL, {"poses": [{"time_s": 0.1}]}, r"poses\[0\].time_s = 0.1: must be 0"),
        (BALL, {"poses": [{"time_s": 0}, {"time_s": 1}, {"time_s": 1}]}, r"poses\[2\].time_s = 1.0: must be above 1"),
        (BALL, poses({}, {}, end_s=0.009), r"poses\[1\].time_s = 0.009: must be 0.01 or more, the end"),
        (
            BALL,
            poses({"position_mm": [0, 0, -151]}, {}),
            r"= \[0.0, 0.0, -151.0\]: must be position_mm = \[0.0, 0.0, -150",
        ),
        (BALL, poses({}, {"shift_mm": [0, 0, 1]}), r"poses\[1\].shift_mm.*valid are position_mm, rotation_deg"),
        (BALL, poses({}, {"rotation_deg": [0, 180, 0]}), r"poses\[1\]: is half a turn from the pose before"),
        (SPOT, poses({}, {"direction": [0, 0, 1]}), r"poses\[1\]: is half a turn"),
        (SPOT, poses({}, {"direction": [0, 0, 0]}), r"poses\[1\].direction.*zero vector"),
        (SPOT, poses({}, {"turn_deg": 9.0}), r"poses\[1\].turn_deg = 9.0: turns a profile, but none is given"),
        (POINT, poses({}, {"direction": [0, 0, 1]}), "valid are position_mm, rotation_deg"),
        (SUN, RIGHT, "velocity_mm_s.*parallel light has no position"),
        (SUN, {"spin_deg_s": [1, 0, 0], "center_mm": [0, 0, 0]}, "center_mm.*parallel light has no position"),
        (TUBE, poses({}, {"end_mm": [21.0, 0.0, -50.0]}), r"end_mm.*makes the lamp 21 mm long.*20 mm"),
        (TUBE, poses({}, {}) | {"center_mm": [0, 0, 0]}, "center_mm.*has no effect beside poses with start_mm"),
        (BALL, poses({"position_mm": [0, 0, -150]}, {}) | {"center_mm": [0, 0, 0]}, r"must be center_mm = \[0.0"),
        (TUBE, poses({}, {"end_mm": [0.0, 0.0, -50.0]}), "makes the lamp 0 mm long"),
        ({"absorption_per_mm": 0.01}, RIGHT, r"media\[0\].motion: the medium fills all space"),
    ],
)
def test_motions_that_are_unclear_are_refused(thing: dict[str, Any], motion: Any, message: str) -> None:
    part = "targets" if "shape" in thing else "media" if "absorption_per_mm" in thing else "lights"
    with pytest.raises(SceneError, match=message):
        scene(**{part: (with_motion(thing, motion),)})


def test_motion_needs_an_exposure() -> None:
    for parts in ({"targets": (with_motion(BALL, RIGHT),)}, {"camera": {"motion": RIGHT}}):
        with pytest.raises(SceneError, match=r"motion: needs \[exposure\] with duration_s"):
            scene(None, **parts)
    with pytest.raises(SceneError, match=r"particles\[0\].frame_time_s = 0.1: needs \[exposure\] with duration_s"):
        scene(None, particles=(DUST | {"frame_time_s": 0.1},))
    still = {key: value for key, value in DUST.items() if key != "displacement"}
    with pytest.raises(SceneError, match=r"frame_time_s = 0\.1: needs displacement"):
        scene(particles=(still | {"frame_time_s": 0.1},))


def test_poses_cover_the_window_of_the_last_row() -> None:
    rolling = SHORT | {"row_time_s": 0.002}
    with pytest.raises(SceneError, match=r"must be 0\.02 or more, the end of the last row's window"):
        scene(rolling, targets=(with_motion(BALL, poses({}, {}, end_s=0.0199)),))
    scene(rolling, targets=(with_motion(BALL, poses({}, {}, end_s=0.02)),))


def test_a_camera_alone_stands_still() -> None:
    moving = scene(camera={"pose": {"shift_mm": [1.0, 0.0, 0.0]}, "motion": poses({}, {"shift_mm": [2.0, 0.0, 0.0]})})
    alone = moving.camera_alone({"camera.pose": {}})
    assert alone.exposure is None
    assert alone.camera.motion is None


def test_paths_of_studies_reach_into_motions() -> None:
    moving = scene(targets=(with_motion(BALL, RIGHT),))
    faster = moving.changed({"targets[0].motion.velocity_mm_s[0]": 9.0, "exposure.row_time_s": 1e-4})
    assert faster.targets[0].motion == Motion(velocity_mm_s=(9.0, 0.0, 0.0))
    assert not faster.changed({"targets[0].motion": None}).moves
    assert faster.digest != moving.digest
    with pytest.raises(SceneError, match=r"targets\[0\].motion: needs \[exposure\]"):
        faster.changed({"exposure": None})


def test_frames_refuse_what_moves_beside_the_particles() -> None:
    group = DUST | {"frame_time_s": 0.1}
    assert displaced(scene(particles=(group,))).particles[0].frame == 1
    with pytest.raises(SceneError, match=r"targets\[0\].motion: frames move particles alone"):
        displaced(scene(particles=(group,), targets=(with_motion(BALL, RIGHT),)))
