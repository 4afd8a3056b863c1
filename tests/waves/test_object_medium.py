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


def test_the_spread_of_a_far_point_in_water_is_airys_of_the_image_side() -> None:
    """The watts of its solid angle in water pass Fresnel's face, into the disk of λ in air and f'/D."""
    camera = hyperboloid(-(WATER**2)).camera.model_dump()
    camera["lens"]["surfaces"][0]["semi_diameter_mm"] = 0.5
    camera["sensor"] |= {"pixels": [21, 21], "pixel_mm": 0.004}
    found = lf.point_spread(lf.Scene(camera=camera), (0.0, 0.0, -1e5), 550.0)
    passed = 1.0 - ((WATER - 1.0) / (WATER + 1.0)) ** 2
    assert found.entered_w == pytest.approx(passed * math.pi * 0.5**2 / 1e5**2, rel=1e-4)
    assert found.airy_radius_mm == pytest.approx(1.22 * 550e-6 * FOCAL_MM, rel=1e-3)
    assert found.strehl is not None
    assert found.strehl > 0.995
