"""`lfmesh psf`: files and lines of a point spread, and wrong inputs in one line."""

import json
import os
import re
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.files import point_spread
from lfmesh.files.exr import read_map
from lfmesh.waves.angular_spectrum import Irradiance

SCENE = str(asset_path("scenes/conventional.toml"))


def test_files_hold_the_point_spread_of_the_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    point = ["--point-mm", "0", "0", "-500"]
    assert main(["psf", SCENE, *point, "--window", "8", "--oversample", "4", "-o", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "Strehl ratio" in said.out
    assert re.search(r"^waves of 587\.6 nm on (\d+) × \1 places: 0 %$", said.err, re.MULTILINE)
    wanted = lf.point_spread(lf.load(SCENE), (0.0, 0.0, -500.0), window=8, oversample=4)
    np.testing.assert_allclose(read_map(tmp_path / "spread.exr", ["W"]), wanted.mean, rtol=1e-6)
    facts = json.loads((tmp_path / "spread.json").read_text(encoding="utf-8"))
    assert facts["strehl"] == pytest.approx(wanted.strehl)
    assert (tmp_path / "spread.png").stat().st_size > 0


@pytest.mark.parametrize(
    ("point", "words"), [(["0", "0", "500"], "z below 0"), (["9000", "0", "-500"], "transmits none of its light")]
)
def test_points_that_cannot_be_are_refused_in_one_line(
    point: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["psf", SCENE, "--point-mm", *point, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in said
    assert not (tmp_path / "out").exists()


def test_what_is_wrong_with_the_folder_is_said_before_the_waves_are_followed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object, **__: object) -> None:
        pytest.fail("the waves were followed")

    monkeypatch.setattr("lfmesh.waves.point_spread.point_spread", never)
    (tmp_path / "file").write_text("mine")
    (tmp_path / "spread.png").write_text("mine")
    for folder, words in (
        (tmp_path / "file" / "out", "cannot be written: Not a directory"),
        # Its rights let the superuser write there, and still nothing can be made.
        (Path("/proc/none"), "cannot be written"),
        (tmp_path, "spread.png already exists"),
    ):
        assert main(["psf", SCENE, "--point-mm", "0", "0", "-500", "-o", str(folder)]) == 2
        assert words in " ".join(capsys.readouterr().err.split())
    assert (tmp_path / "spread.png").read_text() == "mine"


@pytest.mark.parametrize(
    ("owner", "name", "left"), [(Irradiance, "peak", []), (point_spread, "write_maps", sorted(point_spread.NAMES))]
)
def test_ctrl_c_leaves_all_files_or_none(
    owner: Any, name: str, left: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """While waves are followed, and while files are written."""
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    before = getattr(owner, name)

    def pressed(*given: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return before(*given)

    monkeypatch.setattr(owner, name, pressed)
    try:
        assert main(["psf", SCENE, "--point-mm", "0", "0", "-500", "--window", "8", "-o", str(tmp_path / "out")]) == 130
    finally:
        signal.signal(signal.SIGINT, usual)
    folder = tmp_path / "out"
    assert sorted(each.name for each in folder.glob("*")) == left
    said = capsys.readouterr()
    assert said.err.count("Stopped") == (not left)
    assert ("spread.exr" in said.out) == bool(left)


def test_a_band_is_taken_by_its_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    point = ["psf", SCENE, "--point-mm", "0", "0", "-500", "-o", str(tmp_path), "--band", "red"]
    assert main([*point, "--wavelengths-nm", "500"]) == 2
    assert "omit --wavelengths-nm" in " ".join(capsys.readouterr().err.split())
    assert main(point) == 2
    assert "--band red: the scene has no bands" in " ".join(capsys.readouterr().err.split())
