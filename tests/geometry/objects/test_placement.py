"""Where targets stand: figures against those of the scene, and a warning for each way to see nothing of them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from lfmesh.cli import main
from lfmesh.geometry.objects.placement import Placement, placements
from lfmesh.scene import Scene, loads
from tests.cameras import camera_without_array

LAMP = {"kind": "point", "position_mm": [20.0, 20.0, -50.0], "power_w": 1.0}
PLANE = {"shape": {"kind": "plane", "width_mm": 10.0, "height_mm": 4.0}, "position_mm": [0.0, 0.0, -150.0]}


def placed(target: dict[str, Any], folder: Path = Path(), lights: list[Any] | None = None, **camera: Any) -> Placement:
    scene = Scene(
        camera=camera_without_array(pixels=20) | camera, targets=[target], lights=[LAMP] if lights is None else lights
    )
    (placement,) = placements(scene.in_folder(folder))
    return placement


def file_of(tmp_path: Path, mesh: trimesh.Trimesh) -> str:
    mesh.export(tmp_path / "part.stl")
    return "part.stl"


def test_the_box_and_distance_of_a_turned_and_moved_target() -> None:
    placement = placed(PLANE | {"rotation_deg": [0.0, 0.0, 90.0], "position_mm": [1.0, 2.0, -150.0]})
    np.testing.assert_allclose(placement.low, [-1.0, -3.0, -150.0], atol=1e-12)
    np.testing.assert_allclose(placement.high, [3.0, 7.0, -150.0], atol=1e-12)
    assert placement.nearest_mm == pytest.approx(150.0)
    assert placement.warnings == ()


def test_the_share_of_the_field_is_that_of_areas_on_the_plane_in_focus() -> None:
    scene = Scene(camera=camera_without_array(pixels=20), targets=[PLANE], lights=[LAMP])
    from lfmesh.scene import first_order

    width, height = first_order(scene).field_of_view_mm
    assert placements(scene)[0].share == pytest.approx(10.0 * 4.0 / (width * height), rel=1e-9)


def test_a_camera_elsewhere_sees_what_stands_before_it() -> None:
    """Turned by 180 degrees about y and moved, it looks along +z."""
    pose = {"shift_mm": [0.0, 0.0, -300.0], "tilt_deg": [0.0, 180.0, 0.0]}
    lamp = LAMP | {"position_mm": [0.0, 0.0, -250.0]}
    placement = placed(PLANE | {"position_mm": [0.0, 0.0, -200.0]}, lights=[lamp], pose=pose)
    assert placement.nearest_mm == pytest.approx(100.0)
    assert placement.warnings == ()
    behind = placed(PLANE | {"position_mm": [0.0, 0.0, -400.0]}, lights=[lamp], pose=pose)
    assert "behind the sensor" in behind.warnings[0]


def test_a_part_in_metres_is_suspected(tmp_path: Path) -> None:
    file = file_of(tmp_path, trimesh.creation.box(extents=(40.0, 30.0, 20.0)))
    part = {"file": file, "units": "mm", "position_mm": [0.0, 0.0, -150.0]}
    assert placed(part, tmp_path).warnings == ()
    large = placed(part | {"units": "m"}, tmp_path)
    assert "40 m wide with units = 'm'" in large.warnings[0]
    assert "encloses the camera" in large.warnings[1]
    small = placed(part | {"units": "um"}, tmp_path)
    assert "less than a sample" in small.warnings[0]


def test_the_unit_that_is_suspected_is_the_files(tmp_path: Path) -> None:
    trimesh.creation.box(extents=(40.0, 30.0, 20.0)).export(tmp_path / "part.glb")
    metres = placed({"file": "part.glb", "position_mm": [0.0, 0.0, -150.0]}, tmp_path)
    assert "is 40 m wide by the unit of its format, m, but the camera sees" in metres.warnings[0]
    # A body of millimetres in a file that gives them as kilometres.
    text = (Path(__file__).parents[2] / "solids" / "doublet.step").read_text()
    (tmp_path / "part.step").write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT(.KILO.,.METRE.)"))
    step = placed({"file": "part.step", "position_mm": [0.0, 0.0, -150.0]}, tmp_path)
    assert " m wide by the unit of its file, but the camera sees" in step.warnings[0]


PANEL = {"kind": "rectangle", "position_mm": LAMP["position_mm"], "width_mm": 20.0, "height_mm": 10.0, "power_w": 1.0}
TUBE = {"kind": "line", "start_mm": [0.0, 0.0, -1000.0], "end_mm": [0.0, 40.0, -100.0], "power_w": 1.0}


@pytest.mark.parametrize(
    ("target", "lights", "words"),
    [
        ({"position_mm": [0.0, 0.0, 400.0]}, None, "behind the sensor"),
        (
            {"shape": {"kind": "sphere", "radius_mm": 200.0}, "position_mm": [0.0, 0.0, -50.0]},
            None,
            "encloses the camera",
        ),
        ({"rotation_deg": [0.0, 180.0, 0.0], "material": {"sides": "front"}}, None, "black side"),
        ({"position_mm": [0.0, 0.0, -40.0]}, None, "lit by no lamp"),
        ({"material": {"reflectance": 0.0}}, None, "its reflectance is 0"),
        ({}, [{"kind": "directional", "direction": [0.0, 0.0, 1.0], "irradiance_w_m2": 1.0}], "lit by no lamp"),
        ({}, [{"kind": "spot", "direction": [0.0, 0.0, 1.0], "half_angle_deg": 20.0} | LAMP | {"kind": "spot"}], "lit"),
        ({}, [{"kind": "disk", "direction": [0.0, 0.0, 1.0], "radius_mm": 5.0} | LAMP | {"kind": "disk"}], "lit by no"),
        ({}, [PANEL | {"direction": [0.0, 0.0, 1.0]}], "lit by no"),
        ({}, [TUBE | {"end_mm": [0.0, 0.0, -2000.0]}], "lit by no"),
    ],
)
def test_a_target_of_which_nothing_is_seen_is_warned_of(
    target: dict[str, Any], lights: list[Any] | None, words: str
) -> None:
    (warning,) = placed(PLANE | target, lights=lights).warnings
    assert words in warning


@pytest.mark.parametrize(
    ("target", "lights"),
    [
        ({"rotation_deg": [0.0, 180.0, 0.0]}, None),
        ({"position_mm": [0.0, 0.0, -40.0], "material": {"radiance_w_m2_sr": 1.0}}, None),
        ({"position_mm": [0.0, 0.0, -40.0]}, []),
        # A panel whose centre is behind the plane, and a tube with an end before it.
        ({}, [PANEL | {"direction": [-1.0, 0.0, -1.0], "width_mm": 4000.0, "position_mm": [900.0, 0.0, -900.0]}]),
        ({}, [TUBE]),
        # A cone that meets a wide plane far from the centres of its two facets.
        (
            {"shape": {"kind": "plane", "width_mm": 90.0, "height_mm": 90.0}},
            [LAMP | {"kind": "spot", "direction": [0.0, 0.0, -1.0], "half_angle_deg": 1.0}],
        ),
    ],
)
def test_what_can_be_seen_is_not_warned_of(target: dict[str, Any], lights: list[Any] | None) -> None:
    assert placed(PLANE | target, lights=lights).warnings == ()


def test_the_lamps_that_shine_on_what_the_camera_sees_are_told() -> None:
    behind = LAMP | {"position_mm": [0.0, 0.0, -300.0]}
    sun = {"kind": "directional", "direction": [0.0, 0.0, -1.0], "irradiance_w_m2": 1.0}
    placement = placed(PLANE, lights=[behind, LAMP, sun])
    assert placement.lit_by == ("lights[1] (point)", "lights[2] (directional)")
    assert "  lit by               lights[1] (point), lights[2] (directional)" in placement.lines()
    assert "  lit by               no lamp" in placed(PLANE, lights=[behind]).lines()
    away = PLANE | {"rotation_deg": [0.0, 180.0, 0.0], "material": {"sides": "front"}}
    assert placed(away, lights=[behind, LAMP]).lit_by is None


def test_check_prints_where_targets_stand_and_refuses_a_broken_mesh(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = file_of(tmp_path, trimesh.creation.box(extents=(4.0, 3.0, 2.0)))
    target = {"file": file, "units": "mm", "position_mm": [900.0, 0.0, -150.0], "name": "part"}
    scene = Scene(camera=camera_without_array(), targets=[target], lights=[LAMP])
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert loads(scene.dump_toml(), tmp_path)
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    said = capsys.readouterr().out
    assert "targets[0] (part): 12 facets" in said
    assert "Note: targets[0] (part) is out of the field" in said
    (tmp_path / file).write_bytes(b"solid nothing")
    assert main(["check", str(tmp_path / "scene.toml")]) == 2
    assert "part.stl" in capsys.readouterr().err


def test_a_facet_with_one_corner_before_the_camera_is_seen() -> None:
    """A floor that reaches 600 mm before the camera and 4 m behind it: both centres of its facets are behind."""
    floor = {"shape": {"kind": "plane", "width_mm": 800.0, "height_mm": 4600.0}}
    floor |= {"position_mm": [0.0, -20.0, 1700.0], "rotation_deg": [90.0, 0.0, 0.0]}
    placement = placed(floor)
    assert placement.share > 0.0
    assert placement.lit_by == ("lights[0] (point)",)
    assert placement.warnings == ()
