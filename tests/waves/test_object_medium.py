"""Optical paths before the lens are those in its object medium: a surface that images far water without aberration."""

import math

import numpy as np
import pytest

import lfmesh as lf

WATER = 1.333
FOCAL_MM = 40.0


def hyperboloid(conic: float) -> lf.Scene:
    """Water before a single surface, air behind it.

    By Fermat n z + √(h² + (f − z)²) = f, which is a conic of the radius f (1 − n) and the constant −n².
    """
    surface = {"radius_mm": FOCAL_MM * (1.0 - WATER), "conic": conic, "semi_diameter_mm": 5.0, "stop": True}
    return lf.Scene(
        camera={
            "focus_mm": math.inf,
            "object_medium": {"index": WATER},
            "lens": {"surfaces": [surface]},
            "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
        }
    )


def test_a_hyperboloid_images_far_water_without_aberration() -> None:
    perfect = lf.wavefront(hyperboloid(-(WATER**2)))
    assert perfect.image_mm[2] == pytest.approx(FOCAL_MM, rel=1e-12)
    assert np.ptp(perfect.opd_waves) < 1e-6
    assert np.ptp(lf.wavefront(hyperboloid(-(WATER**2) + 0.01)).opd_waves) > 1e-2
