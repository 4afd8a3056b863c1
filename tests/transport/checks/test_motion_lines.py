"""The motions that `check` states: ways in mm, and blur on the sensor by the magnification."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.transport.checks.found import _black
from lfmesh.transport.checks.motion_lines import motion_lines
from tests.cameras import camera_without_array, close_up_camera

SHEET = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -150.0]}
"""In the plane in focus."""
WIDE = SHEET | {"shape": {"kind": "plane", "width_mm": 900.0, "height_mm": 900.0}}
RIGHT = {"velocity_mm_s": [500.0, 0.0, 0.0]}
LEFT = {"velocity_mm_s": [-500.0, 0.0, 0.0]}
SHORT = {"duration_s": 0.01}


def told(exposure: Any = SHORT, camera: Any = None, **parts: Any) -> list[str]:
    table = camera_without_array(pixels=60, pixel_mm=0.15) | (camera or {})
    return motion_lines(lf.build(lf.Scene(camera=table, exposure=exposure, **parts)))


def pixels(line: str) -> float:
    found = re.search(r"by up to ([0-9.]+) pixels", line)
    assert found, line
    return float(found[1])


def expected_pixels(way_mm: float) -> float:
    facts = lf.first_order(lf.Scene(camera=camera_without_array(pixels=60, pixel_mm=0.15)))
    return abs(facts.magnification) * way_mm / 0.15


@pytest.mark.parametrize("target", [SHEET, WIDE])
def test_the_blur_is_the_way_times_the_magnification(target: dict[str, Any]) -> None:
    _, line = told(targets=(target | {"motion": RIGHT},))
    assert line.startswith("targets[0]: moves by up to 5 mm; its picture moves")
    assert pixels(line) == pytest.approx(expected_pixels(5.0), rel=6e-3)


def test_a_rolling_shutter_blurs_for_the_window_of_a_row_alone() -> None:
    exposure, line = told({"duration_s": 0.001, "row_time_s": 0.0001}, targets=(SHEET | {"motion": RIGHT},))
    assert "60 rows begin 100 µs apart, from the top of the picture, and end after 6.9 ms" in exposure
    assert "moves by up to 3.45 mm" in line
    assert pixels(line) == pytest.approx(expected_pixels(0.5), rel=0.02)


def test_a_camera_that_moves_blurs_what_stands_still_and_not_what_goes_along() -> None:
    _, still, along = told(camera={"motion": LEFT}, targets=(SHEET, SHEET | {"motion": LEFT}))
    assert still.startswith("what stands still: moves by up to 5 mm relative to the camera")
    assert pixels(still) == pytest.approx(expected_pixels(5.0), rel=6e-3)
    assert pixels(along) == 0.0


def test_parts_that_share_a_motion_are_one_line() -> None:
    spin = {"spin_deg_s": [0.0, 0.0, 3000.0], "center_mm": [0.0, 0.0, -150.0]}
    lamp = {"kind": "point", "position_mm": [0.0, 20.0, -150.0], "power_w": 1.0, "motion": spin}
    _, line = told(targets=(SHEET | {"motion": spin}, SHEET | {"motion": spin}), lights=(lamp,))
    assert line.startswith("targets[0], targets[1], lights[0] (point): moves by up to 10.47 mm and turns by 30°")


def test_blur_in_lenslets_streaks_and_what_is_out_of_the_field() -> None:
    dust = {
        "count": 1, "bounds": {"kind": "sphere", "radius_mm": 1e-6}, "position_mm": [0.0, 0.0, -60.0],
        "intensity_w_sr": 1.0, "displacement": {"kind": "uniform", "vector_mm": [0.2, 0.0, 0.0]}, "frame_time_s": 0.002,
    }  # fmt: skip
    far = SHEET | {"position_mm": [900.0, 0.0, -60.0], "motion": RIGHT}
    camera = close_up_camera()
    world = lf.build(lf.Scene(camera=camera, exposure=SHORT, particles=(dust,), targets=(far,)))
    _, line, streak = motion_lines(world)
    assert line.endswith("moves by up to 5 mm; out of the field")
    shift = abs(world.facts.magnification)
    found = re.search(r"move by up to 1 mm; streaks of up to ([0-9.]+) pixels, ([0-9.]+) lenslets", streak)
    assert found, streak
    np.testing.assert_allclose([float(found[1]), float(found[2])], [shift / 0.1, shift / 0.5], rtol=0.02)


def test_an_exposure_without_motion_is_said_to_change_nothing() -> None:
    assert told(targets=(SHEET,))[1] == "Note: nothing moves, so the exposure does not change the picture"
    assert told(None, targets=(SHEET,)) == []


def test_check_prints_motions_and_dates_its_notes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = SHEET | {"position_mm": [900.0, 0.0, -150.0], "motion": RIGHT}
    scene = lf.Scene(camera=camera_without_array(), exposure=SHORT, targets=(out,))
    path = tmp_path / "scene.toml"
    path.write_text(scene.dump_toml())
    assert main(["check", str(path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "exposure 10 ms for each row of pixels" in shown
    assert "mm around the axis, at t = 0" in shown


def test_a_black_picture_names_the_motion() -> None:
    scene = lf.Scene(camera=camera_without_array(), exposure=SHORT, targets=(SHEET | {"motion": RIGHT},))
    black = SimpleNamespace(scene=scene, mean=np.zeros((6, 6, 1)))
    (warning,) = _black(black)  # type: ignore[arg-type]
    assert "the scene moves until t = 0.01 s" in str(warning)
