"""calibration.json reads back as it was, and every field says what it is."""

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.files.calibration import DERIVED, MEANINGS, read_calibration, write_calibration
from lfmesh.scene import Scene


@pytest.fixture
def calibration(scene: Scene) -> lf.Calibration:
    return lf.calibrate(scene)


def test_a_calibration_reads_back_as_it_was(calibration: lf.Calibration, tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.json", calibration)
    again = read_calibration(tmp_path / "calibration.json")
    for field in fields(calibration):
        before, after = getattr(calibration, field.name), getattr(again, field.name)
        if isinstance(before, np.ndarray):
            np.testing.assert_array_equal(after, before)
            assert after.dtype == before.dtype
        else:
            assert after == before
    assert (again.pitch_px, again.rotation_rad) == (calibration.pitch_px, calibration.rotation_rad)


def test_a_telecentric_lens_has_its_pupil_at_infinity_there_and_back(
    calibration: lf.Calibration, tmp_path: Path
) -> None:
    infinite = dict.fromkeys(("exit_pupil_z_mm", "exit_pupil_diameter_mm", "pupil_to_array_mm"), math.inf)
    write_calibration(tmp_path / "calibration.json", replace(calibration, **infinite))
    again = read_calibration(tmp_path / "calibration.json")
    assert math.isinf(again.pupil_to_array_mm)
    assert again.nominal_pitch_px == pytest.approx(again.lenslet_pitch_mm / again.pixel_mm)


def test_every_field_has_a_unit_and_a_meaning(calibration: lf.Calibration, tmp_path: Path) -> None:
    write_calibration(tmp_path / "calibration.json", calibration)
    document = json.loads((tmp_path / "calibration.json").read_text())
    assert document["orientation"].startswith("as on the sensor")
    assert {field.name for field in fields(calibration)} == set(MEANINGS)
    assert set(document["fields"]) == {*MEANINGS, *DERIVED}
    for name, entry in document["fields"].items():
        assert len(entry["meaning"].split()) >= 4, name
        expected = next((unit for unit in ("mm", "px", "nm", "rad") if name.endswith(f"_{unit}")), None)
        assert entry["unit"] == {"px": "pixel", None: ""}.get(expected, expected), name


def broken(text: str, change: str) -> str:
    if change == "truncated":
        return text[: len(text) // 2]
    document = json.loads(text)
    if change == "foreign":
        document["format"] = 99
    elif change == "old":
        document["format"] = 1
    elif change == "incomplete":
        del document["fields"]["centres_px"]
    elif change == "ragged":
        document["fields"]["centres_px"]["value"][0].pop()
    elif change == "of another array":
        document["fields"]["kinds"]["value"].pop()
    return json.dumps(document)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("truncated", "damaged or not a calibration"),
        ("foreign", "calibration format 99; this lfmesh"),
        ("old", "calibration format 1; .* older ones do not state the order of their pixels"),
        ("incomplete", "damaged or incomplete"),
        ("ragged", "damaged or incomplete"),
        ("of another array", "damaged or incomplete"),
    ],
)
def test_a_bad_file_is_refused_in_one_line(
    calibration: lf.Calibration, tmp_path: Path, change: str, words: str
) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(path, calibration)
    path.write_text(broken(path.read_text(), change))
    with pytest.raises(lf.FileError, match=words) as caught:
        read_calibration(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("layout", "round"),
        ("origin", None),
        ("centres_px", math.nan),
        ("centres_px", math.inf),
        ("centres_px", 1e300),
        ("kinds", 7),
        ("kinds", -1),
        ("sensor_px", [80]),
        ("sensor_px", ["80", "64"]),
        ("sensor_px", [10**400, 64]),
        ("lenslet_pitch_mm", 0.0),
        ("pixel_mm", "0.01"),
        ("f_number", 0),
        ("f_number", {"a": 1}),
        ("microlens_f_number", None),
        ("focal_lengths_mm", [math.inf]),
        ("pupil_to_array_mm", 0.0),
        ("exit_pupil_z_mm", math.nan),
        ("wavelength_nm", 10**400),
    ],
)
def test_numbers_that_no_camera_has_are_refused(
    calibration: lf.Calibration, tmp_path: Path, name: str, value: object
) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(path, calibration)
    document = json.loads(path.read_text())
    entry = document["fields"][name]
    if name == "centres_px":
        entry["value"][0][0][0] = value
    elif name == "kinds":
        entry["value"][0][0] = value
    else:
        entry["value"] = value
    path.write_text(json.dumps(document))
    with pytest.raises(lf.FileError, match="damaged or incomplete"):
        read_calibration(path)


def test_a_missing_file_is_told(tmp_path: Path, image_of: Callable[..., lf.Image]) -> None:
    with pytest.raises(lf.FileError, match="cannot be read: No such file"):
        read_calibration(tmp_path / "calibration.json")
