"""The lens sheet by waves: MTF and point spread of perfect lenses by closed forms, Strehl ratio, ideal lenses."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.special import j1

import lfmesh as lf
from lfmesh.analysis.analysis import analyse
from lfmesh.analysis.diffraction import FieldWaves, diffraction_limit
from lfmesh.assets import asset_path

WAVES_NM = (486.1, 587.6, 656.3)


def scene(surfaces: list[dict[str, Any]], sensor_mm: float, **lens: Any) -> lf.Scene:
    sensor = {"pixels": [100, 100], "pixel_mm": 0.01, "distance_mm": sensor_mm}
    camera = {"lens": {"surfaces": surfaces, **lens}, "sensor": sensor}
    return lf.Scene.model_validate({"schema_version": 1, "camera": camera})


def hyperbola() -> lf.Scene:
    """A lens at f/10 of index 1.5 with conic −1.5², which has no aberration for collimated light on the axis."""
    flat = {"radius_mm": math.inf, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True}
    surfaces = [flat, {"radius_mm": -25.0, "conic": -2.25, "semi_diameter_mm": 4.0}]
    return scene(surfaces, 50.0, stop_semi_diameter_mm=2.5)


def waves_of(found: lf.LensAnalysis, field: int = 0) -> FieldWaves:
    waves = found.waves[field]
    assert not isinstance(waves, str)
    return waves


@pytest.fixture(scope="module")
def perfect() -> lf.LensAnalysis:
    return analyse(hyperbola(), object_mm=math.inf, height_mm=1.0, wavelengths_nm=WAVES_NM, across=24)


def test_the_mtf_of_a_perfect_lens_is_the_diffraction_limit(perfect: lf.LensAnalysis) -> None:
    """At f/10, all wavelengths together, up to the highest frequency of the shortest one."""
    frequencies = np.linspace(0.0, 1e6 / WAVES_NM[0] / 10.0, 40)
    limit = diffraction_limit(frequencies, WAVES_NM, 10.0)
    for tangential in (True, False):
        found = waves_of(perfect).mtf(frequencies, tangential=tangential)
        np.testing.assert_allclose(found, limit, rtol=0, atol=3e-3)
    np.testing.assert_allclose(perfect.diffraction_limit, diffraction_limit(perfect.frequencies_per_mm, WAVES_NM, 10.0))


def test_the_point_spread_of_a_perfect_lens_is_airys(perfect: lf.LensAnalysis) -> None:
    """The weights of wavelengths at the peak are those of 1/λ², as their light is spread by λ² over the plane."""
    at = 0.25e-3 * np.arange(-40, 41)
    found = waves_of(perfect).point_spread(40.5 * 0.25e-3, 81)
    fine = np.hypot(*np.meshgrid(at, at)) + 1e-12
    wanted = np.zeros_like(fine)
    for nm in WAVES_NM:
        v = np.pi * fine / (nm * 1e-6 * 10.0)
        wanted += (2.0 * j1(v) / v) ** 2 / nm**2
    wanted /= sum(nm**-2 for nm in WAVES_NM)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=3e-3)


@pytest.mark.parametrize("f_number", [4.0, 8.0])
def test_strehls_ratio_on_the_sheet_is_that_of_the_wavefront_and_of_the_point_spread(f_number: float) -> None:
    camera = {
        "focus_mm": 2000.0,
        "lens": {"file": "lib:double_gauss_50mm", "f_number": f_number},
        "sensor": {"pixels": [500, 500], "pixel_mm": 0.01},
    }
    given = lf.Scene.model_validate({"schema_version": 1, "camera": camera}).in_folder(asset_path("scenes"))
    found = analyse(given, wavelengths_nm=(550.0,), height_mm=3.0, across=24)
    distance = lf.first_order(given).object_distance_mm
    for field, spot in enumerate(found.spots):
        waves = waves_of(found, field)
        wanted = lf.wavefront(given, spot.slope_y * distance, 550.0)
        assert waves.wavefront.strehl == pytest.approx(wanted.strehl, rel=1e-9)
        assert float(waves.point_spread(1e-6, 1)[0, 0]) == pytest.approx(wanted.strehl, abs=0.01)
        middle = len(waves.fans[0].pupil) // 2
        assert waves.fans[0].tangential_waves[middle] == pytest.approx(0.0, abs=1e-9)
        assert found.as_dict()["fields"][field]["strehl"] == waves.wavefront.strehl


def test_an_ideal_lens_reaches_the_limit_all_over_the_field() -> None:
    thin = scene([{"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 2.5, "stop": True}], 50.0)
    found = analyse(thin, object_mm=math.inf, height_mm=2.0, wavelengths_nm=(550.0,), across=24)
    for field in range(3):
        assert waves_of(found, field).wavefront.strehl == pytest.approx(1.0, abs=1e-9)
        made = waves_of(found, field).mtf(found.frequencies_per_mm, tangential=False)
        np.testing.assert_allclose(made, found.diffraction_limit, atol=2e-3)


def test_fields_that_waves_cannot_be_followed_for_say_why() -> None:
    """A plane wave through a hole, far out of focus: nothing converges, and the sheet still has its spots."""
    flat = {"radius_mm": math.inf, "semi_diameter_mm": 9.0}
    hole = scene([{"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 2.0}, flat], 100.0)
    found = analyse(hole, object_mm=math.inf, height_mm=10.0, wavelengths_nm=(550.0,), across=24)
    assert all(isinstance(each, str) and "collimated" in each for each in found.waves)
    assert any("no waves: " in line for line in found.lines())
    assert found.as_dict()["fields"][0]["strehl"] is None


def test_waves_are_followed_only_where_they_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def followed(*_: object) -> str:
        asked.append(1)
        return "not here"

    monkeypatch.setattr("lfmesh.analysis.analysis._waves", followed)
    found = lf.analyse(lf.load(asset_path("scenes/conventional.toml")))
    assert found.spots
    assert not asked
    assert found.waves == ["not here"] * len(found.spots)
