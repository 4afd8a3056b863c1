"""Zernike polynomials on the unit circle, in Noll's order and the Fringe order.

Noll's are orthonormal: squared coefficients, without the first, add up to the wavefront's variance (R. J. Noll,
"Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66 (1976) 207). Fringe polynomials, printed by CODE V
and OpticStudio, are 1 at the rim (J. C. Wyant, K. Creath, "Basic wavefront aberration theory for optical metrology",
1992).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = tuple[int, int]
"""Radial order n, and azimuthal order m: cosines for m >= 0, sines for m < 0."""

FRINGE_TERMS = 37
"""Number of terms of the Fringe order."""


def noll_index(j: int) -> Index:
    """Return n and m of a term of Noll's order, from 1 on: even terms are cosines, odd ones sines."""
    n = (math.isqrt(8 * j - 7) - 1) // 2
    place = j - n * (n + 1) // 2 - 1
    m = n % 2 + 2 * ((place + (n + 1) % 2) // 2)
    return n, m if j % 2 == 0 else -m


def fringe_index(j: int) -> Index:
    """Return n and m of a term of the Fringe order, from 1 to 37: by n + |m|, then falling |m|, cosines first."""
    if j == FRINGE_TERMS:
        return 12, 0
    half = math.isqrt(j - 1)  # (n + |m|) / 2
    place = j - 1 - half * half
    m = half - place // 2
    return 2 * half - m, m if place % 2 == 0 else -m


ORDERS: dict[str, Callable[[int], Index]] = {"noll": noll_index, "fringe": fringe_index}


def zernike(index: Index, x: Array, y: Array, *, orthonormal: bool) -> Array:
    """Return a Zernike polynomial at points of the unit circle.

    Parameters
    ----------
    index : (n, m)
    x, y : (points,) float64
        Angles are measured from x towards y.
    orthonormal : bool
        Scale to mean square 1; else to 1 at the rim at angle 0 (or where the sine is 1).
    """
    n, m = index
    order = abs(m)
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    radial = np.zeros_like(r)
    for k in range((n - order) // 2 + 1):
        factor = (-1) ** k * math.comb(n - k, k) * math.comb(n - 2 * k, (n - order) // 2 - k)
        radial += factor * r ** (n - 2 * k)
    scale = math.sqrt((n + 1) * (1 if m == 0 else 2)) if orthonormal else 1.0
    return np.asarray(scale * radial * (np.cos(order * angle) if m >= 0 else np.sin(order * angle)))


def fitted(points: Array, values: Array, terms: int, order: str) -> Array:
    """Return the coefficients of an order's first terms, by least squares over points, (terms,).

    Parameters
    ----------
    points : (n, 2) float64
        Within the unit circle.
    values : (n,) float64
    terms : int
    order : {"noll", "fringe"}
    """
    columns = [zernike(ORDERS[order](j), *points.T, orthonormal=order == "noll") for j in range(1, terms + 1)]
    return np.asarray(np.linalg.lstsq(np.column_stack(columns), values, rcond=None)[0])
