"""Decoders that nobody here wrote find our micro-images and see our views; and what compares them measures right."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image as Picture

import lfmesh as lf
from lfmesh.lightfield.rays.ray_model import RayModel

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("interop")


@pytest.mark.long
def test_independent_decoders_find_our_centres_and_see_our_view(tmp_path: Path) -> None:
    ran = subprocess.run(
        [sys.executable, str(ROOT / "tools" / "interop.py"), "--samples", "24", "--json", str(tmp_path / "figures")],
        capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=3000,
    )  # fmt: skip
    if ran.returncode == 3:
        pytest.skip(ran.stderr.strip().splitlines()[-1])
    assert ran.returncode == 0, ran.stderr
    square, hexagonal = json.loads((tmp_path / "figures").read_text())
    assert square["found"] == square["lenslets"] >= 60 * 60
    assert square["mean_error_px"] < 0.25
    assert square["view_correlation"] > 0.99
    # Its refocused pictures are 1/9 of a lenslet apart, about 30 mm here.
    assert abs(square["sharpest_mm"] - square["target_mm"]) < 30.0
    assert hexagonal["found"] == hexagonal["lenslets"]
    assert hexagonal["mean_error_px"] < 0.5
    assert hexagonal["view_correlation"] > 0.8


def test_the_error_of_centres_is_their_distance_in_the_upright_picture(tool: ModuleType) -> None:
    calibration = lf.calibrate(tool.camera("square", 2))
    column, row = calibration.centres_px.reshape(-1, 2).T
    upright = np.column_stack([row, 655.0 - column])
    np.testing.assert_allclose(tool.centre_errors(upright + np.array([0.3, -0.4]), calibration), 0.5, rtol=1e-9)
    np.testing.assert_allclose(tool.centre_errors(upright[10:], calibration), 0.0, atol=1e-9)
    assert len(tool.centre_errors(upright[10:], calibration)) == len(upright) - 10


def test_the_sharpest_plane_lies_where_the_pattern_is_least_blurred(tool: ModuleType) -> None:
    model = RayModel.of(tool.camera("square", 2))
    shifts = np.arange(-9, 9) / 9.0
    waves = 1.0 + np.sin(np.arange(64.0)) * np.ones((64, 1))
    stack = np.array([1.0 + (waves - 1.0) * np.exp(-20.0 * (shift - 0.28) ** 2) for shift in shifts])
    expected = model.distance_mm(0.28 * model.lenslet_pitch_mm)
    assert tool.sharpest_mm(shifts, stack, model) == pytest.approx(expected, rel=1e-6)


def test_a_mirrored_view_does_not_correlate(tool: ModuleType) -> None:
    with Picture.open(ROOT / "assets/charts/chart.png") as picture:
        view = np.asarray(picture.convert("L").resize((64, 64)), dtype=np.float64)
    assert tool.correlation(view, 3.0 * view + 1.0) == pytest.approx(1.0)
    assert tool.correlation(view, view[:, ::-1]) < 0.8


def test_a_machine_without_the_old_python_is_told_so(
    tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tool.shutil, "which", lambda name: None)
    with pytest.raises(tool.NoEnvironmentError, match=r"python3\.11 is not on the PATH; plenpy needs it"):
        tool.environment("plenpy", tmp_path)
