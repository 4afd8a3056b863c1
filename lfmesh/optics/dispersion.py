"""Dispersion formulas: the index of a glass by wavelength, from coefficients, from nd and Vd, or from a table."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.optics.glass import C_LINE_NM, D_LINE_NM, F_LINE_NM

G_LINE_NM, T_LINE_NM = 435.8343, 1013.98
"""Lines of mercury."""

Array = NDArray[np.float64]

NORMAL_G_F = (0.6438, -0.001682)
NORMAL_C_T = (0.5450, 0.004743)
"""Partial dispersions P(g, F) and P(C, t) of normal glasses: a constant, and the slope over the Abbe number. Lines
through K7 and F2, from SCHOTT, TIE-29, "Refractive index and dispersion"."""

MODEL_NM = (350.0, 1100.0)
"""Wavelength range of a glass given by nd and Vd: slightly beyond the mercury lines i and t."""

POLE_UM2 = 0.028
"""Square of the resonance wavelength that Herzberger's formula gives all glasses, µm²."""


def model_index(nd: float, vd: float, wavelength_nm: float) -> float:
    """Return the index of the normal glass with given nd and Vd.

    Herzberger's formula (Opt. Acta 6, 197, 1959), n = a + b L + c L² + d λ² with L = 1 / (λ² − 0.028 µm²), through nd,
    Vd and the partial dispersions P(g, F) and P(C, t) of the normal line. For SCHOTT and OHARA glasses with P(g, F)
    within 0.002 of that line, the error is at most 3e-5 from F to C, 1e-4 from g to 707 nm, and 5e-4 at 405 and 1014
    nm. Other glasses differ by up to 5e-4 at F and C, and more beyond.

    Parameters
    ----------
    nd : float
        Index at the d line, 587.5618 nm.
    vd : float
        Abbe number (nd − 1) / (nF − nC).
    wavelength_nm : float, nm

    Raises
    ------
    GlassError
        The wavelength is outside `MODEL_NM`.
    """
    first, last = MODEL_NM
    if not first <= wavelength_nm <= last:
        raise GlassError(
            f"glass of nd {nd:g} and Vd {vd:g} at {wavelength_nm:g} nm: nd and Vd determine the index only from "
            f"{first:g} to {last:g} nm; give a table or Sellmeier's coefficients"
        )
    terms = _herzberger(wavelength_nm)
    return nd + (nd - 1.0) / vd * float(np.dot(_normal_terms(vd), terms - _herzberger(D_LINE_NM)))


def _herzberger(wavelength_nm: float) -> Array:
    """Return the wavelength-dependent terms of Herzberger's formula, (3,)."""
    square = (wavelength_nm * 1e-3) ** 2
    pole = 1.0 / (square - POLE_UM2)
    return np.array([pole, pole * pole, square])


def _normal_terms(vd: float) -> Array:
    """Return the coefficients of a normal glass in units of nF − nC, (3,)."""
    g, f, c, t = (_herzberger(line) for line in (G_LINE_NM, F_LINE_NM, C_LINE_NM, T_LINE_NM))
    partial = [1.0, *(constant + slope * vd for constant, slope in (NORMAL_G_F, NORMAL_C_T))]
    return np.linalg.solve(np.array([f - c, g - f, c - t]), np.array(partial))


def sellmeier_index(b: Sequence[float], c_um2: Sequence[float], wavelength_nm: float) -> float:
    """Return the index by the Sellmeier formula, n² = 1 + Σ b λ² / (λ² − c).

    Parameters
    ----------
    b, c_um2 : sequences of float
        Coefficients; `c_um2` in µm².
    wavelength_nm : float, nm

    Raises
    ------
    GlassError
        The index is not at least 1 at this wavelength.
    """
    square = (wavelength_nm * 1e-3) ** 2
    try:
        n2 = 1.0 + sum(k * square / (square - c) for k, c in zip(b, c_um2, strict=True))
    except ZeroDivisionError:
        n2 = math.inf
    if not 1.0 <= n2 <= 100.0:
        raise GlassError(
            f"glass by Sellmeier's formula at {wavelength_nm:g} nm: n² = {n2:g}; an index must lie between 1 and 10, "
            "and wavelengths away from the resonances √c"
        )
    return math.sqrt(n2)


def table_index(wavelengths_nm: Sequence[float], values: Sequence[float], wavelength_nm: float) -> float:
    """Interpolate a table of indices by a cubic spline over 1/λ², in which glasses are nearly straight.

    The spline's second derivative is constant over the first two and the last two values. Two values give Cauchy's
    formula n = a + b/λ².

    Parameters
    ----------
    wavelengths_nm, values : sequences of float
        Increasing wavelengths, two or more, and the index at each.
    wavelength_nm : float, nm

    Raises
    ------
    GlassError
        The wavelength is outside the table.
    """
    first, last = wavelengths_nm[0], wavelengths_nm[-1]
    if not first * (1.0 - 1e-9) <= wavelength_nm <= last * (1.0 + 1e-9):
        raise GlassError(f"glass by a table at {wavelength_nm:g} nm: its table reaches from {first:g} to {last:g} nm")
    x = 1e4 / np.asarray(wavelengths_nm)[::-1] ** 2
    y = np.asarray(values)[::-1]
    at = min(max(1e4 / wavelength_nm**2, x[0]), x[-1])
    second = _second_derivatives(x, y)
    k = min(int(np.searchsorted(x, at, side="right")), len(x) - 1) - 1
    h = x[k + 1] - x[k]
    a, b = (x[k + 1] - at) / h, (at - x[k]) / h
    bend = (a**3 - a) * second[k] + (b**3 - b) * second[k + 1]
    return float(a * y[k] + b * y[k + 1] + bend * h * h / 6.0)


def _second_derivatives(x: Array, y: Array) -> Array:
    """Return the second derivatives of a cubic spline at its nodes, (n,)."""
    n = len(x)
    if n == 2:
        return np.zeros(2)
    h, slope = np.diff(x), np.diff(y) / np.diff(x)
    system, right = np.zeros((n, n)), np.zeros(n)
    for i in range(1, n - 1):
        system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
        right[i] = 6.0 * (slope[i] - slope[i - 1])
    system[0, :2] = system[-1, -2:] = 1.0, -1.0
    return np.asarray(np.linalg.solve(system, right), dtype=np.float64)
