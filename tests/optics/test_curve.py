"""Curves over the wavelength: integrals, quantiles, and tables that are refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from lfmesh.errors import FileError
from lfmesh.optics.curve import Curve, gaussian, read_curve

UNEVEN = Curve(np.array([400.0, 420.0, 500.0, 510.0, 700.0]), np.array([0.0, 2.0, 2.0, 0.0, 5.0]))


def test_integral_and_centroid_are_those_of_quadrature() -> None:
    breaks = UNEVEN.wavelengths_nm[1:-1]
    area = quad(UNEVEN.at, 400.0, 700.0, points=breaks)[0]
    moment = quad(lambda w: w * UNEVEN.at(w), 400.0, 700.0, points=breaks)[0]
    np.testing.assert_allclose(UNEVEN.area_nm, area, rtol=1e-12)
    np.testing.assert_allclose(UNEVEN.centroid_nm, moment / area, rtol=1e-12)
    np.testing.assert_allclose(
        UNEVEN.integral(405.0, 503.0), quad(UNEVEN.at, 405.0, 503.0, points=breaks)[0], rtol=1e-12
    )


def test_quantiles_invert_the_integral() -> None:
    shares = np.linspace(0.0, 1.0, 1001)
    found = UNEVEN.quantile_nm(shares)
    assert (np.diff(found) > 0.0).all()
    np.testing.assert_allclose([UNEVEN.integral(400.0, w) / UNEVEN.area_nm for w in found], shares, atol=1e-13)


def test_a_tabulated_gaussian_is_one() -> None:
    curve = gaussian(550.0, 40.0, 490.0, 610.0)
    w = np.random.default_rng(0).uniform(490.0, 610.0, 10_000)
    np.testing.assert_allclose(curve.at(w), np.exp(-4.0 * np.log(2.0) * ((w - 550.0) / 40.0) ** 2), atol=2e-6)
    # Over one and a half full widths to each side, all but 0.04 % of its area.
    np.testing.assert_allclose(curve.area_nm / (40.0 * np.sqrt(np.pi / np.log(16.0))), 0.99959, atol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("wavelength,value\n500,1\n600,1\n", "first line must name the columns wavelength_nm and value"),
        ("", "first line must name"),
        ("wavelength_nm,value\n500,1\n", "two wavelengths or more"),
        ("wavelength_nm,value\n500,1\n500,1\n", "500 nm after 500 nm: wavelengths must increase"),
        ("wavelength_nm,value\n600,1\n500,1\n", "must increase"),
        ("wavelength_nm,value\n500,1\n600,x\n", "value nan at 600 nm: it must be a number from 0 to 1"),
        ("wavelength_nm,value\n500,1\n600,-0.1\n", "value -0.1 at 600 nm"),
        ("wavelength_nm,value\n500,1\n600,1.1\n", "value 1.1 at 600 nm"),
        ("wavelength_nm,value\n500,1\n600\n", "row 3 has 1 values; it must have 2"),
        ("wavelength_nm,value\n50,1\n600,1\n", "50 nm: wavelengths must lie between 100 and 20000 nm"),
        ("wavelength_nm,value\n500,inf\n600,1\n", "value inf at 500 nm"),
    ],
)
def test_what_is_no_curve_is_refused_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "curve.csv").write_text(text)
    with pytest.raises(FileError, match=message):
        read_curve(tmp_path / "curve.csv", "value", 1.0)
