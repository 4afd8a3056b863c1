"""Reflectance spectra of RGB colours.

A linear sRGB colour is a sum of three smooth spectra, one per primary, that lie between 0 and 1 and sum to 1 at every
wavelength. Any colour in the gamut is a possible reflectance, grey is spectrally flat, and the CIE 1931 observer sees
the intended colour under D65. Spectra: I. Mallett, C. Yuksel, "Spectral Primary Decomposition for Rendering with sRGB
Reflectance", EGSR 2019.
"""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def primary_reflectances(wavelength_nm: float) -> Array:
    """Return the reflectances of red, green and blue at a wavelength, (3,); they sum to 1.

    Parameters
    ----------
    wavelength_nm : float, nm
        Outside 380 to 780 nm the values at the nearer end, which are nearly equal, are returned.
    """
    table = _basis()
    each = np.array([np.interp(wavelength_nm, table[:, 0], spectrum) for spectrum in table[:, 1:].T])
    return np.asarray(each / each.sum())


@cache
def _basis() -> Array:
    table = np.loadtxt(Path(__file__).with_name("rgb_basis.csv"), delimiter=",", skiprows=2)
    table.setflags(write=False)
    return table
