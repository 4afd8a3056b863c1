"""The CIE's standard observer and illuminants, and Planck's law.

Tables are from CIE 15:2018 (Colorimetry, 4th edition), in the files beside this one.
"""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

PLANCK_J_S = 6.62607015e-34
SPEED_OF_LIGHT_M_S = 299792458.0
BOLTZMANN_J_K = 1.380649e-23
"""Exact SI values."""

_HERE = Path(__file__).parent

_A_RANGE_NM = np.arange(300.0, 831.0)
_A_SECOND_CONSTANT_NM = 1.435e7 / 2848.0
"""c₂ / T in the definition of illuminant A, which keeps the radiation constant of 1931."""

_E_RANGE_NM = (100.0, 20000.0)
"""All wavelengths that a scene may have."""

NAMED = (
    "A", "D50", "D55", "D65", "D75", "E", "FL2", "FL7", "FL11",
    "LED-B1", "LED-B2", "LED-B3", "LED-B4", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2",
)  # fmt: skip
"""Names of the illuminants."""


def observer(wavelength_nm: ArrayLike) -> Array:
    """Return the CIE 1931 colour-matching functions (2°), linear between whole nanometres.

    Parameters
    ----------
    wavelength_nm : (...) array_like, nm

    Returns
    -------
    (3, ...) float64
        x, y and z; 0 outside 360 to 830 nm.
    """
    table, w = _read("cie_1931.csv"), np.asarray(wavelength_nm, dtype=np.float64)
    return np.array([np.interp(w, table[:, 0], each, left=0.0, right=0.0) for each in table[:, 1:].T])


def named_spectrum(name: str) -> tuple[Array, Array]:
    """Return the relative spectral power of an illuminant.

    Parameters
    ----------
    name : str
        One of `NAMED`.

    Returns
    -------
    wavelengths_nm, values : (n,) float64
        For linear interpolation; unknown outside.

    Raises
    ------
    KeyError
        No such illuminant.
    """
    if name == "E":
        return np.array(_E_RANGE_NM), np.full(2, 100.0)
    if name == "A":
        w = _A_RANGE_NM
        at_560 = np.expm1(_A_SECOND_CONSTANT_NM / 560.0)
        return w, 100.0 * (560.0 / w) ** 5 * at_560 / np.expm1(_A_SECOND_CONSTANT_NM / w)
    if name not in NAMED:
        raise KeyError(name)
    columns = (_HERE / "illuminants.csv").read_text().splitlines()[1].split(",")
    table = _read("illuminants.csv")
    wavelengths_nm, values = table[:, 0], table[:, columns.index(name)]
    known = ~np.isnan(values)
    return wavelengths_nm[known], values[known]


def planck_radiance(wavelength_nm: ArrayLike, temperature_k: float) -> Array:
    """Return the spectral radiance of a black body in vacuum, W/(m² sr nm), by Planck's law.

    Parameters
    ----------
    wavelength_nm : (...) array_like, nm
    temperature_k : float, K
        Above 0.
    """
    w = 1e-9 * np.asarray(wavelength_nm, dtype=np.float64)
    exponent = PLANCK_J_S * SPEED_OF_LIGHT_M_S / (w * BOLTZMANN_J_K * temperature_k)
    with np.errstate(over="ignore"):
        per_metre = 2.0 * PLANCK_J_S * SPEED_OF_LIGHT_M_S**2 / (w**5 * np.expm1(exponent))
    return np.asarray(1e-9 * per_metre)


def planck_constants(wavelength_nm: ArrayLike) -> tuple[Array, Array]:
    """Return c₁ in W/(m² sr nm) and c₂ in K of Planck's law, c₁ / (exp(c₂ / T) − 1), at given wavelengths.

    Parameters
    ----------
    wavelength_nm : (...) array_like, nm
    """
    w = 1e-9 * np.asarray(wavelength_nm, dtype=np.float64)
    first = 2e-9 * PLANCK_J_S * SPEED_OF_LIGHT_M_S**2 / w**5
    return np.asarray(first), np.asarray(PLANCK_J_S * SPEED_OF_LIGHT_M_S / (w * BOLTZMANN_J_K))


@cache
def _read(name: str) -> Array:
    """Return a table in this folder; NaN for empty cells."""
    table = np.genfromtxt(_HERE / name, delimiter=",", skip_header=2, dtype=np.float64)
    table.setflags(write=False)
    return table
