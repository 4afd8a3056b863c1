"""lfmesh expose: its counts read back, and belong to the run."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.cli import main


@pytest.fixture
def folder(image_of: Callable[..., lf.Image], tmp_path: Path) -> Path:
    return lf.save(image_of(), tmp_path / "run")


def test_counts_read_back_as_they_were_exposed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = (folder / "raw.exr").read_bytes()
    assert main(["expose", str(folder), "--exposure-s", "0.002", "--bayer", "GRBG", "--bits", "14", "--seed", "5"]) == 0
    assert "0.002 s: up to" in capsys.readouterr().out
    detector = lf.Detector(exposure_s=0.002, bayer="GRBG", bits=14, seed=5)
    with PIL.Image.open(folder / "exposed.png") as picture:
        counts = np.asarray(picture)
    # The picture is upright, and the lens of this camera inverts; the array lies as on the sensor.
    np.testing.assert_array_equal(counts, detector.expose(lf.open_run(folder)).counts[:, ::-1])
    facts = json.loads((folder / "exposed.json").read_text())
    assert facts["orientation"] == "upright"
    assert (facts["bayer"], facts["white_level"]) == ("GRBG", 2**14 - 1)
    assert (folder / "raw.exr").read_bytes() == raw


def test_without_a_time_the_bright_pixels_fill_most_of_their_wells(folder: Path) -> None:
    assert main(["expose", str(folder), "--full-well-e", "5000"]) == 0
    facts = json.loads((folder / "exposed.json").read_text())
    detector = lf.Detector(exposure_s=facts["exposure_s"], full_well_e=5000.0)
    expected = detector.expected_e(lf.open_run(folder))
    assert np.percentile(expected, 99.5) == pytest.approx(4000.0)


def test_rendering_anew_takes_the_old_exposure_away(folder: Path, image_of: Callable[..., lf.Image]) -> None:
    assert main(["expose", str(folder)]) == 0
    lf.save(image_of(seconds=8.0), folder)
    assert not list(folder.glob("exposed.*"))


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["--exposure-s", "0"], "exposure_s = 0.0: must be above 0"),
        (["--bits", "20"], "bits = 20: must be from 1 to 16"),
        (["--bayer", "RGBG"], "RGBG"),
        (["--quantum-efficiency", "2"], "quantum_efficiency = 2.0: must be in (0, 1]"),
    ],
)
def test_wrong_options_are_told_and_nothing_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], fault: str
) -> None:
    assert main(["expose", str(folder), *words]) == 2
    assert fault in " ".join(capsys.readouterr().err.split())
    assert not list(folder.glob("exposed.*"))
