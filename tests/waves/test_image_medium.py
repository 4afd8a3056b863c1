"""Optical paths and waves behind a lens that ends in a medium, as behind an ellipsoid without aberration."""

import math

import numpy as np
import pytest

import lfmesh as lf

OIL, IMAGE_MM = 1.4, 40.0


def ellipsoid(conic: float, semi_diameter_mm: float = 5.0) -> lf.Scene:
    """Air before a single surface, oil behind it.

    By Fermat z + n' √(h² + (f' − z)²) = n' f', which is a conic of the radius f' (1 − 1/n') and the constant −1/n'².
    """
    surface = {
        "radius_mm": IMAGE_MM * (1.0 - 1.0 / OIL), "conic": conic, "semi_diameter_mm": semi_diameter_mm, "stop": True,
    }  # fmt: skip
    return lf.Scene(
        camera={
            "focus_mm": math.inf,
            "image_medium": {"index": OIL},
            "lens": {"surfaces": [surface]},
            "sensor": {"pixels": [21, 21], "pixel_mm": 0.004},
        }
    )


def test_an_ellipsoid_images_far_points_into_oil_without_aberration() -> None:
    perfect = lf.wavefront(ellipsoid(-1.0 / OIL**2))
    assert perfect.image_mm[2] == pytest.approx(IMAGE_MM, rel=1e-12)
    assert np.ptp(perfect.opd_waves) < 1e-6
    assert np.ptp(lf.wavefront(ellipsoid(-1.0 / OIL**2 + 0.01)).opd_waves) > 1e-2


def test_the_spread_of_a_far_point_in_oil_is_airys_of_its_wavelength_there() -> None:
    """Watts of the point's solid angle pass Fresnel's face, into the disk of λ/n' and f'/D."""
    found = lf.point_spread(ellipsoid(-1.0 / OIL**2, 0.5), (0.0, 0.0, -1e5), 550.0)
    passed = 1.0 - ((OIL - 1.0) / (OIL + 1.0)) ** 2
    assert found.entered_w == pytest.approx(passed * math.pi * 0.5**2 / 1e5**2, rel=1e-4)
    assert found.airy_radius_mm == pytest.approx(1.22 * 550e-6 / OIL * IMAGE_MM, rel=1e-3)
    assert found.strehl is not None
    assert found.strehl > 0.995
    # The middle pixel and its neighbours hold what Airy's disk has there: 83.8 % within the first dark ring.
    x, y = np.meshgrid(found.x_mm, found.y_mm)
    inside = np.hypot(x, y) < found.airy_radius_mm
    assert found.mean[inside].sum() / found.power_w == pytest.approx(0.84, abs=0.03)


def test_only_ratios_of_indices_count_for_waves() -> None:
    """With every index and the wavelength times n the picture of a point is the same, lenslets and cover included.

    The waves through the lenslets take other grids, which change the picture by less than the change that it states.
    """
    n = 1.25
    camera = {
        "focus_mm": 300.0,
        "lens": {"surfaces": [
            {"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 1.5, "stop": True},
            {"radius_mm": -40.0, "semi_diameter_mm": 3.0},
        ]},
        "mla": {"count": [5, 5], "pitch_mm": 0.1, "radius_mm": 0.6, "index": 1.5, "thickness_mm": 0.1},
        "sensor": {"pixels": [50, 50], "pixel_mm": 0.01, "distance_mm": 1.0,
                   "cover": {"thickness_mm": 0.3, "gap_mm": 0.1, "index": 1.6}},
    }  # fmt: skip
    air = lf.Scene(camera=camera)
    times = {
        "camera.object_medium": {"index": n}, "camera.image_medium": {"index": n}, "camera.mla.index": 1.5 * n,
        "camera.lens.surfaces[0].index": 1.5 * n, "camera.sensor.cover.index": 1.6 * n,
    }  # fmt: skip
    point = (0.0, 0.0, -300.0)
    dry = lf.point_spread(air, point, 500.0, tolerance=0.05)
    wet = lf.point_spread(air.changed(times), point, 500.0 * n, tolerance=0.05)
    assert max(dry.change, wet.change) < 2e-3
    np.testing.assert_allclose(wet.mean, dry.mean, rtol=0.0, atol=max(dry.change, wet.change) * dry.mean.max())
    assert wet.airy_radius_mm == pytest.approx(dry.airy_radius_mm, rel=1e-9)


def test_without_lenslets_only_ratios_of_indices_count_to_rounding() -> None:
    n = 1.25
    surfaces = [{"radius_mm": 40.0, "thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 1.5, "stop": True},
                {"radius_mm": -40.0, "semi_diameter_mm": 3.0}]  # fmt: skip
    air = lf.Scene(camera={"focus_mm": 300.0, "lens": {"surfaces": surfaces}, "sensor": {"pixels": [50, 50],
                           "pixel_mm": 0.01}})  # fmt: skip
    times = {"camera.object_medium": {"index": n}, "camera.image_medium": {"index": n},
             "camera.lens.surfaces[0].index": 1.5 * n}  # fmt: skip
    dry = lf.point_spread(air, (0.0, 0.0, -300.0), 500.0)
    wet = lf.point_spread(air.changed(times), (0.0, 0.0, -300.0), 500.0 * n)
    np.testing.assert_allclose(wet.mean, dry.mean, rtol=0.0, atol=1e-9 * dry.mean.max())
