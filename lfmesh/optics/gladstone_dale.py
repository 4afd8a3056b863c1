"""The index of gases by density, temperature and pressure: Gladstone and Dale's law, n − 1 = K ρ.

The law is linear in the density, so the index relative to the air around is n = a + b ρ with two numbers for each
wavelength: a grid of densities, interpolated once, serves all of them. J. H. Gladstone and T. P. Dale, Phil. Trans. R.
Soc. 153, 317 (1863); W. Merzkirch, Flow Visualization, Academic Press 1987, chapter 3.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.optics.air import REFERENCE_C, REFERENCE_KPA, air_index

Array = NDArray[np.float64]

AIR_J_KG_K = 287.05287
"""Specific gas constant of dry air (ISO 2533:1975, Standard Atmosphere)."""

ZERO_C_K = 273.15
"""0 °C in K."""


def air_density(temperature_k: ArrayLike, pressure_kpa: ArrayLike) -> Array:
    """Return the density of dry air as an ideal gas, kg/m³.

    It differs from that of the real gas by less than 0.1 % from 250 to 1000 K at 100 kPa (compressibility factors of
    Perry's Chemical Engineers' Handbook).

    Parameters
    ----------
    temperature_k, pressure_kpa : array_like
    """
    temperature = np.asarray(temperature_k, np.float64)
    return np.asarray(1e3 * np.asarray(pressure_kpa, np.float64) / (AIR_J_KG_K * temperature), np.float64)


def gladstone_dale_of_air(wavelength_nm: float) -> float:
    """Return K of dry air, m³/kg: n − 1 over the density at 20 °C and 101.325 kPa.

    Parameters
    ----------
    wavelength_nm : float
    """
    density = float(air_density(REFERENCE_C + ZERO_C_K, REFERENCE_KPA))
    return (air_index(wavelength_nm, REFERENCE_C, REFERENCE_KPA) - 1.0) / density


def index_by_density(
    wavelengths_nm: ArrayLike,
    air_c: float = REFERENCE_C,
    air_kpa: float = REFERENCE_KPA,
    gladstone_dale_m3_kg: ArrayLike | None = None,
) -> tuple[Array, Array]:
    """Return a and b of the index n = a + b ρ of a gas, relative to the air around it.

    The air around is an ideal gas too, so dry air of its temperature and pressure has the index 1. Its absolute index
    then differs from `air_index` by up to 6e-8 from 0 to 50 °C, and 2e-7 at -40 °C, both at 101.325 kPa.

    Parameters
    ----------
    wavelengths_nm : (wavelengths,) array_like
    air_c, air_kpa : float
        Temperature and pressure of the air around.
    gladstone_dale_m3_kg : float or (wavelengths,) array_like, optional
        K of the gas. Default: that of dry air at each wavelength.

    Returns
    -------
    offsets, scales : (wavelengths,) float64
        a, and b in m³/kg.
    """
    of_air = np.array([gladstone_dale_of_air(float(each)) for each in np.atleast_1d(np.asarray(wavelengths_nm))])
    around = 1.0 + of_air * air_density(air_c + ZERO_C_K, air_kpa)
    constants = of_air if gladstone_dale_m3_kg is None else np.asarray(gladstone_dale_m3_kg, np.float64)
    return 1.0 / around, np.broadcast_to(constants, around.shape) / around
