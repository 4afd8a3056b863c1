"""Poses of lens elements in a scene: what is accepted, kept, reported and refused."""

from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.geometry.lens.solved_camera import first_order
from lfmesh.scene import Scene, load, loads
from tests.cameras import close_up_camera

TILTED = {"surfaces": [0, 1], "pose": {"tilt_deg": [0.1, 0.0, 0.0], "shift_mm": [0.0, 0.01, 0.0]}}


def scene(*elements: Any) -> Scene:
    camera = close_up_camera()
    return Scene(camera=camera | {"lens": camera["lens"] | {"elements": list(elements)}})


def test_elements_survive_being_written_and_read() -> None:
    posed = scene(TILTED, {"surfaces": [2], "pose": {"shift_mm": [0.2, 0.0, 0.0]}})
    assert loads(posed.dump_toml()) == posed
    assert "surfaces = [0, 1]" in posed.dump_toml()
    assert Scene.model_validate_json(posed.to_json()) == posed


def test_one_number_of_a_pose_can_be_changed() -> None:
    for path in ("camera.lens.elements.0.pose.tilt_deg", "camera.lens.elements[0].pose.tilt_deg"):
        turned = scene(TILTED).changed({path: [0.0, 0.3, 0.0]})
        assert turned.camera.lens.elements[0].pose.tilt_deg == (0.0, 0.3, 0.0)
        assert turned.camera.lens.elements[0].pose.shift_mm == (0.0, 0.01, 0.0)


def test_check_says_that_array_and_sensor_are_out_of_place() -> None:
    array = {"count": [9, 9], "pitch_mm": 0.1, "focal_length_mm": 0.5, "index": 1.5, "thickness_mm": 0.1}
    placed = scene().changed({"camera.mla": array, "camera.sensor.distance_mm": None})
    shifted = placed.changed({"camera.mla.pose.shift_mm": (0.0, 0.0, 0.2), "camera.sensor.pose.tilt_deg": (1.0, 0, 0)})
    assert not first_order(placed).poses
    lines = [line for line in first_order(shifted).lines() if "about its centre" in line]
    assert "the array: shift 0 0 0.2 mm, tilt 0 0 0 degrees" in lines[0]
    assert "the sensor: shift 0 0 0 mm, tilt 1 0 0 degrees" in lines[1]


def test_first_order_optics_are_those_of_the_lens_without_poses() -> None:
    plain, posed = first_order(scene()), first_order(scene(TILTED))
    assert posed.poses
    assert not plain.poses
    said = {"poses", "warnings"}
    kept = {key: value for key, value in posed.as_dict().items() if key not in said}
    assert kept == {key: value for key, value in plain.as_dict().items() if key not in said}
    of_poses, *others = posed.warnings
    assert of_poses.startswith("the lens has posed elements: clear apertures were compared with")
    assert tuple(others) == plain.warnings
    line = next(line for line in posed.lines() if line.startswith("posed element"))
    assert "surfaces 0 to 1" in line
    assert "shift 0 0.01 0 mm" in line
    assert "tilt 0.1 0 0 degrees" in line


def test_a_scene_poses_elements_of_a_lens_file(tmp_path: Path) -> None:
    lens = "".join(
        f"[[surfaces]]\n{line}\n"
        for line in (
            "radius_mm = 20.0\nthickness_mm = 3.0\nindex = 1.5\nsemi_diameter_mm = 4.0\nstop = true",
            "radius_mm = -20.0\nsemi_diameter_mm = 4.0",
        )
    )
    (tmp_path / "lens.toml").write_text(lens, encoding="utf-8")
    text = """
schema_version = 1
[camera]
focus_mm = 100.0
[camera.lens]
file = "lens.toml"
[[camera.lens.elements]]
surfaces = [0, 1]
pose = { tilt_deg = [1.0, 0.0, 0.0] }
[camera.sensor]
pixels = [10, 10]
pixel_mm = 0.1
"""
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    read = load(tmp_path / "scene.toml")
    assert len(read.camera.lens.surfaces) == 2
    assert read.camera.lens.elements[0].pose.tilt_deg == (1.0, 0.0, 0.0)
    given = Scene(
        camera={
            "focus_mm": 100.0,
            "lens": {"file": "lens.toml", "elements": [TILTED]},
            "sensor": {"pixels": [10, 10], "pixel_mm": 0.1},
        }
    ).in_folder(tmp_path)
    assert lf.solved(given).camera.lens.elements[0].pose.tilt_deg == (0.1, 0.0, 0.0)


@pytest.mark.parametrize(
    ("elements", "message"),
    [
        ([{"surfaces": [2, 3]}], r"elements\[0\].surfaces = \[2, 3\]: there is no surface 3; the lens has surfaces"),
        ([{"surfaces": [-1]}], r"elements\[0\].surfaces\[0\] = -1: must be 0 or more"),
        ([TILTED, {"surfaces": [1, 2]}], r"elements\[1\].surfaces = .*: surface 1 already belongs to elements\[0\]"),
        ([{"surfaces": []}], r"elements\[0\].surfaces = \[\]: must name at least one surface"),
        ([{"surfaces": [0, 2]}], r"elements\[0\].surfaces = \[0, 2\]: must be adjacent surfaces in order"),
        ([{"surfaces": [1, 0]}], r"elements\[0\].surfaces = \[1, 0\]: must be adjacent surfaces in order"),
        ([{"surfaces": [1, 1]}], r"elements\[0\].surfaces = \[1, 1\]: must be adjacent surfaces in order"),
        ([{"surfaces": [0], "pose": {"tilt_deg": [0.0, float("nan"), 0.0]}}], r"tilt_deg\[1\] = nan: must be a finite"),
        ([{"surfaces": [0], "pose": {"shift_mm": [0.0, float("inf"), 0.0]}}], r"shift_mm\[1\] = inf: must be a finite"),
        ([{"surfaces": [0], "pose": {"tilt_deg": [45.0, 0.0, 0.0]}}],
         r"elements\[0\].pose.tilt_deg = \[45.0, 0.0, 0.0\]: tilts the axis by 45 degrees; it must stay below 45"),
        ([{"surfaces": [0], "pose": {"tilt_deg": [180.0, 0.0, 0.0]}}], "by 180 degrees; it must stay below 45"),
        ([{"surfaces": [0], "pose": {"tilt": [1.0, 0.0, 0.0]}}], r"elements\[0\].pose.tilt: unknown key"),
        ([{"surfaces": [0], "tilt_deg": [1.0, 0.0, 0.0]}], r"elements\[0\].tilt_deg: unknown key"),
        ([{"pose": {}}], r"elements\[0\].surfaces: missing"),
    ],
)  # fmt: skip
def test_a_wrong_element_is_refused_in_one_line(elements: list[Any], message: str) -> None:
    with pytest.raises(lf.SceneError, match=message) as refusal:
        scene(*elements)
    assert len(str(refusal.value).splitlines()) == 1
