"""Warnings about diffractive faces with periods of few wavelengths."""

import math

import pytest

import lfmesh as lf

WAVE_NM = 500.0


def camera(period_mm: float) -> lf.Scene:
    grating = {"kind": "grating", "lines_per_mm": 1.0 / period_mm}
    front = {"stop": True, "thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 2.0}
    lens = {"surfaces": [front, {"radius_mm": -30.0, "semi_diameter_mm": 3.0, "phase": grating}]}
    sensor = {"pixels": [8, 8], "pixel_mm": 0.01, "distance_mm": 60.0}
    return lf.Scene(camera={"lens": lens, "sensor": sensor}, transport={"wavelengths_nm": [WAVE_NM]})


@pytest.mark.parametrize("waves", [1.2, 1.9, 2.1, 20.0])
def test_periods_below_two_wavelengths_are_told(waves: float) -> None:
    said = [each for each in lf.first_order(camera(waves * WAVE_NM * 1e-6)).warnings if "smallest period" in each]
    assert bool(said) == (waves < 2.0)
    assert all(
        f"camera.lens.surfaces[1].phase: its smallest period is {waves:.3g} wavelengths" in each for each in said
    )


def test_the_rim_of_a_metalens_is_its_finest_part() -> None:
    """d = λ / sin u; at the corner of a cell, with a focal length of its half width, sin u = √(2/3)."""
    metalens = {"kind": "metalens", "focal_length_mm": 0.05, "design_nm": WAVE_NM}
    mla = {"count": [8, 8], "pitch_mm": 0.1, "index": 1.5, "thickness_mm": 0.02, "curved_phase": metalens}
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "stop": True, "semi_diameter_mm": 25.0}]}
    sensor = {"pixels": [80, 80], "pixel_mm": 0.01}
    given = {"focus_mm": 500.0, "lens": lens, "mla": mla, "sensor": sensor}
    facts = lf.first_order(lf.Scene(camera=given, transport={"wavelengths_nm": [WAVE_NM]}))
    words = f"camera.mla.curved_phase: its smallest period is {math.sqrt(1.5):.3g} wavelengths"
    assert any(words in each for each in facts.warnings)
