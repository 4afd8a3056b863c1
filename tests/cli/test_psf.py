"""`lfmesh psf`: files and lines of a point spread, and wrong inputs in one line."""

import json
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.files.exr import read_map

SCENE = str(asset_path("scenes/conventional.toml"))


def test_files_hold_the_point_spread_of_the_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    point = ["--point-mm", "0", "0", "-500"]
    assert main(["psf", SCENE, *point, "--window", "8", "--oversample", "4", "-o", str(tmp_path)]) == 0
    assert "Strehl ratio" in capsys.readouterr().out
    wanted = lf.point_spread(lf.load(SCENE), (0.0, 0.0, -500.0), window=8, oversample=4)
    np.testing.assert_allclose(read_map(tmp_path / "spread.exr", ["W"]), wanted.mean, rtol=1e-6)
    facts = json.loads((tmp_path / "spread.json").read_text(encoding="utf-8"))
    assert facts["strehl"] == pytest.approx(wanted.strehl)
    assert (tmp_path / "spread.png").stat().st_size > 0


@pytest.mark.parametrize(("point", "words"), [(["0", "0", "500"], "z below 0"), (["9000", "0", "-500"], "lets 0 of")])
def test_points_that_cannot_be_are_refused_in_one_line(
    point: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["psf", SCENE, "--point-mm", *point, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in said
    assert not (tmp_path / "out").exists()
