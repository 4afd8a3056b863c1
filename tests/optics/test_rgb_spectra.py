"""Spectra of RGB colours, against the definition of sRGB."""

import numpy as np
import pytest

from lfmesh.optics.cie import named_spectrum, observer
from lfmesh.optics.rgb_spectra import primary_reflectances

XYZ_OF_SRGB = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""IEC 61966-2-1: columns are the primaries, white is D65."""


def test_a_grey_reflects_alike_at_every_wavelength() -> None:
    for wavelength in np.linspace(300.0, 1100.0, 161):
        reflectances = primary_reflectances(wavelength)
        assert reflectances.sum() == pytest.approx(1.0, abs=1e-15)
        assert (reflectances >= 0.0).all()


def test_primaries_under_d65_look_as_srgb_defines_them() -> None:
    """To 1e-3 of white: the spectra were fitted with tables of 5 nm."""
    wavelengths = np.arange(380.0, 781.0, 5.0)
    light = np.interp(wavelengths, *named_spectrum("D65"))
    seen = observer(wavelengths) * light
    basis = np.array([primary_reflectances(w) for w in wavelengths])
    np.testing.assert_allclose(seen @ basis / seen[1].sum(), XYZ_OF_SRGB, atol=1e-3)


@pytest.mark.parametrize(("wavelength", "primary"), [(640.0, 0), (540.0, 1), (450.0, 2)])
def test_each_primary_reflects_most_of_its_own_light(wavelength: float, primary: int) -> None:
    assert primary_reflectances(wavelength)[primary] > 0.9
