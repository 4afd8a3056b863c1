"""Calibrations: what they say of the lattice as a whole, and how they continue it."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.lightfield.calibration.calibration import continued
from lfmesh.scene import Scene


def test_pitch_is_first_order_optics_for_a_perfect_camera(camera: Callable[..., Scene]) -> None:
    calibration = lf.calibrate(camera())
    assert calibration.pitch_px == pytest.approx(calibration.nominal_pitch_px, rel=1e-5)
    assert calibration.rotation_rad == pytest.approx(0.0, abs=1e-9)
    assert calibration.known.all()


def test_a_turned_array_has_turned_micro_images(camera: Callable[..., Scene]) -> None:
    """About z from x to y, which on the sensor is from columns to rows."""
    calibration = lf.calibrate(camera().changed({"camera.mla.pose.tilt_deg": [0.0, 0.0, 0.5]}))
    assert calibration.rotation_rad == pytest.approx(np.deg2rad(0.5), rel=1e-4)


def test_pitch_error_stretches_the_micro_images(camera: Callable[..., Scene]) -> None:
    perfect, stretched = (lf.calibrate(camera().changed({"camera.mla.form.pitch_error": e})) for e in (0.0, 0.01))
    assert stretched.pitch_px == pytest.approx(1.01 * perfect.pitch_px, rel=1e-6)
    assert stretched.lenslet_pitch_mm == pytest.approx(0.125 * 1.01)


def test_a_shifted_array_shifts_its_micro_images(camera: Callable[..., Scene]) -> None:
    """By a little more than itself: the shift is seen from the exit pupil."""
    here, there = (lf.calibrate(camera().changed({"camera.mla.pose.shift_mm": [x, 0.0, 0.0]})) for x in (0.0, 0.05))
    moved = (there.centres_px - here.centres_px) * here.pixel_mm / 0.05
    enlarged = 1.0 + here.lenslet_to_sensor_mm / here.pupil_to_array_mm
    np.testing.assert_allclose(moved[..., 0], enlarged, rtol=1e-4)
    np.testing.assert_allclose(moved[..., 1], 0.0, atol=1e-4)


def test_types_of_lenslets_are_those_of_the_array(camera: Callable[..., Scene]) -> None:
    """Three radii, so that no two neighbours are of one type."""
    scene = camera("hexagonal").changed({"camera.mla.radius_mm": [0.25, 0.225, 0.28]})
    kinds = lf.calibrate(scene).kinds
    assert set(np.unique(kinds)) == {0, 1, 2}
    # Neighbours along a row and across rows differ.
    assert (kinds[:, 1:] != kinds[:, :-1]).all()
    assert (kinds[1::2, :-1] != kinds[:-1:2, :-1]).all()


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_unknown_centres_continue_the_known_ones(camera: Callable[..., Scene], layout: str) -> None:
    """With the distortion of a real lens, from the middle of the array to its border."""
    truth = lf.calibrate(camera(layout)).centres_px
    known = np.ones(truth.shape[:2], np.bool_)
    known[[0, -1]], known[:, [0, -1]], known[4, 5] = False, False, False
    hidden = np.where(known[..., None], truth, np.nan)
    np.testing.assert_allclose(continued(hidden, known), truth, atol=1e-3)
    np.testing.assert_array_equal(continued(hidden, known)[known], truth[known])
