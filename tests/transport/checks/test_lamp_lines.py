"""What a check says of lamps' profiles and spectra."""

from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.scene.light.spectra import curve_of
from lfmesh.transport.checks.lamp_lines import lamp_lines
from tests.cameras import as_text, camera_without_array

DOWNLIGHT = "IESNA:LM-63-1995\nTILT=NONE\n1 1000 2 2 1 1 2 0 0 0\n0.5 1 40\n0 90\n0\n7 7\n"
"""7 cd below the horizon, multiplier 2, ballast factor 0.5."""

PLANE = {"shape": {"kind": "plane", "width_mm": 10.0, "height_mm": 10.0}, "position_mm": [0.0, 0.0, -150.0],
         "material": {"reflectance": 0.5}}  # fmt: skip


def scene(folder: Path, height_mm: float, **sensor: object) -> lf.Scene:
    (folder / "down.ies").write_text(DOWNLIGHT)
    camera = camera_without_array()
    camera["sensor"] |= sensor
    light = {"kind": "point", "position_mm": [0.0, height_mm, -150.0], "power_w": 3.0, "profile": "down.ies"}
    return lf.Scene(camera=camera, targets=[PLANE], lights=[light]).in_folder(folder)


def lines_of(scene: lf.Scene) -> list[str]:
    return lamp_lines(scene, lf.build(scene).targets)


def test_a_profile_is_described_in_watts_and_in_the_units_of_its_file(tmp_path: Path) -> None:
    """7 cd over the lower half space: 14π lm; of 3 W, 3 / 2π W/sr."""
    (line,) = lines_of(scene(tmp_path, 100.0))
    assert "lit from 0 to 90 degrees" in line
    assert f"{3.0 / (2.0 * np.pi):.4g} W/sr of 3 W" in line
    assert f"7 cd of {14.0 * np.pi:.4g} lm" in line


@pytest.mark.parametrize(("height_mm", "warned"), [(100.0, False), (-100.0, True)])
def test_a_lamp_that_shines_past_all_targets_is_warned_of(tmp_path: Path, height_mm: float, warned: bool) -> None:
    """The lamp shines downwards only: a target above it gets nothing."""
    assert any("no light towards" in line for line in lines_of(scene(tmp_path, height_mm))) == warned


@pytest.mark.parametrize("spectrum", [None, {"name": "A"}, {"wavelengths_nm": [300, 555, 900], "values": [0, 3, 1]}])
def test_bands_take_the_integral_of_response_and_spectrum(tmp_path: Path, spectrum: dict[str, object] | None) -> None:
    bands = [{"name": "blue", "center_nm": 450, "fwhm_nm": 60}, {"name": "red", "center_nm": 620, "fwhm_nm": 30}]
    lit = scene(tmp_path, 100.0, bands=bands)
    if spectrum is not None:
        lit = lit.changed({"lights[0].spectrum": spectrum})
    (line,) = [line for line in lines_of(lit) if "spectrum" in line]
    first, last = lit.reach_nm
    given = lit.lights[0].spectrum
    shape = None if given is None else curve_of(given, lit.reach_nm, lit, "")

    def power(w: np.ndarray) -> np.ndarray:
        return np.ones_like(w) if shape is None else shape.at(w)

    w = np.linspace(first, last, 1_000_001)
    whole = np.trapezoid(power(w), w)
    for band in lit.passbands:
        begin, end = band.response.ends_nm
        w = np.linspace(begin, end, 1_000_001)
        taken = np.trapezoid(power(w) * band.response.at(w), w)
        assert f"{band.name} {100.0 * taken / whole:.3g} %" in line


def test_check_prints_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    dark = scene(tmp_path, -100.0)
    Path("scene.toml").write_text(as_text(camera=dark.camera, targets=dark.targets, lights=dark.lights))
    assert main(["check", "scene.toml"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "lights[0] profile: down.ies, lit from 0 to 90 degrees" in out
    assert "Note: lights[0]: its profile sends no light" in out
