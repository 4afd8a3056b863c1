"""Exposures and motions of random keys are refused in few lines, or are rigid motions that begin at the given poses."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import LfmeshError
from lfmesh.geometry.motions import motions_of
from lfmesh.geometry.rigid_motion import pose_at
from lfmesh.scene import Scene, loads
from tests.cameras import as_text, camera_without_array
from tests.fuzz.test_media import HARSH, in_one_line


def rarely(harsh: Any, mild: Any) -> Any:
    """Return a strategy that draws a harsh value now and then, so that most scenes are sound but for one."""
    return st.integers(0, 29).flatmap(lambda k: harsh if k == 0 else mild)


def vectors(reach: float) -> Any:
    mild = st.tuples(*[st.floats(-reach, reach)] * 3).map(list)
    return rarely(st.one_of(st.lists(st.sampled_from(HARSH), min_size=3, max_size=3), st.just([0.0] * 3)), mild)


def numbers(low: float, high: float) -> Any:
    return rarely(st.sampled_from(HARSH), st.floats(low, high))


exposures = st.fixed_dictionaries(
    {"duration_s": numbers(1e-4, 1.0)},
    optional={
        "row_time_s": numbers(0.0, 1e-2),
        "row_direction": rarely(st.just("left"), st.sampled_from(["down", "up"])),
        "shutter": st.lists(st.tuples(numbers(0.0, 1.0), numbers(0.0, 1.0)).map(list), max_size=4),
    },
)
"""With a shutter few are sound."""

whole = st.builds(
    lambda exposure, opening: exposure | ({"shutter": shutter(exposure, opening)} if opening else {}),
    exposures.map(lambda exposure: {key: value for key, value in exposure.items() if key != "shutter"}),
    st.lists(numbers(0.0, 1.0), max_size=5).filter(lambda opening: len(opening) != 1),
)


def shutter(exposure: dict[str, Any], opening: list[Any]) -> list[list[Any]]:
    """Return a shutter's curve over the whole window, where that is a number."""
    duration = exposure["duration_s"]
    if not isinstance(duration, float) or not 0.0 < duration < 1e3:
        return [[0.0, 1.0]]
    times = np.linspace(0.0, 1.0, len(opening)) * duration
    return [[float(time), share] for time, share in zip(times, opening, strict=True)]


keys = {
    "position_mm": vectors(50.0), "rotation_deg": vectors(400.0), "shift_mm": vectors(5.0), "tilt_deg": vectors(80.0),
    "direction": vectors(1.0), "turn_deg": numbers(-400.0, 400.0), "start_mm": vectors(50.0), "end_mm": vectors(50.0),
}  # fmt: skip


def poses(own: tuple[str, ...]) -> Any:
    """Return a strategy for poses in an object's keys, and now and then in others."""
    given = st.fixed_dictionaries({}, optional={key: keys[key] for key in own})
    later = rarely(st.fixed_dictionaries({}, optional=keys), given)
    times = st.lists(st.floats(1e-4, 3.0), max_size=3).map(lambda steps: [0.0, *np.cumsum(steps).tolist(), 12.0])
    return st.builds(
        lambda first, times, others: [
            {"time_s": time} | pose for time, pose in zip(times, [first, *others], strict=False)
        ],
        rarely(given, st.just({})), rarely(st.just([0.1, 0.1]), times), st.lists(later, min_size=4, max_size=4),
    )  # fmt: skip


def motions(own: tuple[str, ...], *, has_place: bool = True) -> Any:
    centre = {"center_mm": vectors(100.0)} if has_place else {}
    spin = st.fixed_dictionaries({"spin_deg_s": vectors(1e4)}, optional=centre)
    speed = st.fixed_dictionaries({"velocity_mm_s": vectors(1e4)}) if has_place else spin
    both = st.builds(lambda one, other: one | other, spin, speed)
    by_poses = st.fixed_dictionaries({"poses": poses(own)}, optional={} if own == ("start_mm", "end_mm") else centre)
    wrong = st.fixed_dictionaries(
        {}, optional={"velocity_mm_s": vectors(9.0), "poses": poses(own), "speed": vectors(1.0)}
    )
    return rarely(wrong, st.one_of(speed, spin, both, by_poses))


BODY = ("position_mm", "rotation_deg")
BALL = {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -150.0]}
TANK = {
    "size_mm": [9, 9, 9],
    "wall_mm": 1,
    "wall": {"index": 1.5},
    "liquid": {"index": 1.3},
    "position_mm": [0, 0, -99.0],
}
SMOKE = {"bounds": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.0, 0.0, -50.0], "absorption_per_mm": 0.1}
POINT = {"kind": "point", "position_mm": [0.0, 50.0, -100.0], "power_w": 1.0}
SUN = {"kind": "directional", "direction": [0.0, -1.0, -1.0], "irradiance_w_m2": 1.0}
PANEL = {
    "kind": "rectangle", "position_mm": [9.0, 0.0, 0.0], "direction": [0.0, 0.3, -1.0], "width_mm": 2.0,
    "height_mm": 1.0, "power_w": 1.0,
}  # fmt: skip
TUBE = {"kind": "line", "start_mm": [0.0, 0.0, -50.0], "end_mm": [20.0, 0.0, -50.0], "power_w": 1.0}
THINGS: list[tuple[str, dict[str, Any], Any]] = [
    ("targets", BALL, motions(BODY)),
    ("tanks", TANK, motions(BODY)),
    ("media", SMOKE, motions(BODY)),
    ("lights", POINT, motions(("position_mm",))),
    ("lights", SUN, motions(("direction",), has_place=False)),
    ("lights", PANEL, motions(("position_mm", "direction", "turn_deg"))),
    ("lights", TUBE, motions(("start_mm", "end_mm"))),
    ("camera", {}, motions(("shift_mm", "tilt_deg"))),
]
drawn = st.sampled_from(range(len(THINGS))).flatmap(lambda k: st.tuples(st.just(k), THINGS[k][2]))


def is_rigid_or_refused(exposure: dict[str, Any], moving: list[tuple[int, dict[str, Any]]]) -> bool:
    """Insist on one refusal, or on rigid motions that begin with the identity; return True for motions."""
    tables: dict[str, Any] = {"camera": camera_without_array()}
    for k, motion in moving:
        kind, thing, _ = THINGS[k]
        if kind == "camera":
            tables["camera"] = tables["camera"] | {"motion": motion}
        else:
            tables.setdefault(kind, []).append(thing | {"motion": motion})
    try:
        scene = Scene(exposure=exposure, **tables)  # type: ignore[arg-type]
    except LfmeshError as error:
        in_one_line(error)
        return False
    assert loads(scene.dump_toml()) == scene
    found = motions_of(scene)
    rows = scene.camera.sensor.pixels[1]
    assert scene.exposure is not None
    begin, _, end_s = scene.exposure.windows(rows)
    assert 0.0 < scene.exposure.open_s <= scene.exposure.duration_s
    assert begin.min() == 0.0
    every = [found.camera, *found.bodies, *found.lights, *found.media]
    assert scene.moves == any(motion is not None for motion in every)
    for motion in every:
        if motion is None:
            continue
        np.testing.assert_array_equal(pose_at(motion, 0.0)[:, :3], np.eye(3))
        for time in np.linspace(0.0, end_s, 5):
            pose = pose_at(motion, float(time))
            assert np.isfinite(pose).all()
            np.testing.assert_allclose(pose[:, :3] @ pose[:, :3].T, np.eye(3), atol=1e-9)
    return scene.moves


SOME = st.lists(drawn, min_size=1, max_size=2)


@settings(max_examples=200, deadline=None, derandomize=True, database=None)
@given(whole, SOME)
def test_random_motions_are_rigid_or_refused(exposure: dict[str, Any], moving: list[tuple[int, Any]]) -> None:
    is_rigid_or_refused(exposure, moving)


@pytest.mark.long
@settings(max_examples=20_000, deadline=None, derandomize=True, database=None)
@given(rarely(exposures, whole), SOME)
def test_many_random_motions_are_rigid_or_refused(exposure: dict[str, Any], moving: list[tuple[int, Any]]) -> None:
    is_rigid_or_refused(exposure, moving)


@pytest.mark.parametrize("k", range(len(THINGS)))
def test_the_objects_that_are_moved_at_random_can_move(k: int) -> None:
    assert is_rigid_or_refused({"duration_s": 0.1}, [(k, {"spin_deg_s": [0.0, 9.0, 0.0]})])


@pytest.mark.parametrize("value", ["true", '"1.0"', "nan", "inf", "[]", "[1.0]", "[[]]", "{ }", "1e400", "2020-01-01"])
@pytest.mark.parametrize("key", ["velocity_mm_s", "spin_deg_s", "center_mm", "poses"])
def test_a_value_of_another_kind_is_refused_by_its_key(key: str, value: str) -> None:
    text = (
        as_text(camera=camera_without_array()) + f"\n[exposure]\nduration_s = 0.1\n[camera.motion]\n{key} = {value}\n"
    )
    with pytest.raises(LfmeshError) as raised:
        loads(text)
    assert "camera.motion" in str(raised.value) or "line" in str(raised.value)
