"""Fraunhofer diffraction at an aperture, as a random change of direction.

Behind an aperture of area A, light of wavelength λ (in the medium) changes its direction cosines by k with the density
|∫ exp(−2πi k·r/λ) d²r|² / (λ² A), the power spectrum of the aperture (Goodman, Introduction to Fourier Optics, 4.2, in
direction cosines as in Harvey, Appl. Opt. 18, 1979). It depends only on the difference of the two directions, so it is
reciprocal. In q = k/λ, cycles per mm:

- Rectangle: the product over its sides of w sinc²(w q), with sinc x = sin πx / πx.
- Circle of diameter D: Airy's pattern, with 1 − J₀²(πx) − J₁²(πx) of the light within x = D |q| (Rayleigh).
- Hexagon: three rhombi. Its spectrum is at most three times the sum of theirs (Cauchy-Schwarz inequality), each a
  product of sinc² along the sides, so rejection from that sum is exact.

Distances with the densities sinc² and Airy's come from a table up to `_BODY`, a hexagon's frequencies from a table of
cells up to `_HALF_SIDE`, and all beyond from rejection.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.quadrature import gauss_legendre

RECTANGLE, HEXAGON, ROUND = range(3)
"""Shapes of apertures."""

PARTS = 4096
"""Number of equal parts of the cumulative probability of a distance; see `sinc2_quantiles`."""

_BODY = 4.0
"""Distance up to which samples come from the table."""

_HALF_SIDE, _CELLS = 6, 192
"""Half side of the square of a hexagon's tabulated frequencies, and number of cells along it."""

NEAR_SHARE = 0.925
"""Lower bound on the fraction of light within a quarter of `_HALF_SIDE`. A hexagon's frequency has three products with
the sides, which sum to 0. Beyond the table of cells one product is at least half of `_HALF_SIDE`, so of any two of
them, one is at least a quarter."""

_SIDE_X, _SIDE_Y = (0.0, -0.5, 0.5), (1.0 / np.sqrt(3.0), -0.5 / np.sqrt(3.0), -0.5 / np.sqrt(3.0))
"""Every second corner of a hexagon with opposite sides 1 apart, two of them across x: the sides of its rhombi."""


@cache
def sinc2_quantiles() -> NDArray[np.float64]:
    """Return the quantiles 0, 1/N, 2/N, ... of a distance of density sinc² with N = `PARTS`, up to the last in `_BODY`.

    The fraction within x is 2/π (Si(2πx) − sin²(πx) / πx). Constant density between quantiles makes it wrong by at most
    1.2·10⁻⁴, except at the zeros.
    """
    from scipy.special import sici

    x = _distances()
    return _quantiles(2.0 / np.pi * (sici(2.0 * np.pi * x)[0] - np.sinc(x) ** 2 * np.pi * x))


@cache
def airy_quantiles() -> NDArray[np.float64]:
    """Return the same quantiles for the radius in Airy's pattern, in λ over the diameter."""
    from scipy.special import j0, j1

    x = np.pi * _distances()
    return _quantiles(1.0 - j0(x) ** 2 - j1(x) ** 2)


@cache
def hexagon_cells() -> NDArray[np.float32]:
    """Return an alias table that samples cells of a quarter of the unit hexagon's spectrum; its last row is the rest.

    A random number in part i of as many equal parts as rows yields i within the first fraction of the part, else row
    i's other number (Walker, ACM Trans. Math. Softw. 3, 1977; Vose, IEEE Trans. Softw. Eng. 17, 1991). With constant
    density per cell, the share of light within any distance along or across the sides is wrong by at most 3.5·10⁻⁴.

    Returns
    -------
    (`_CELLS`² + 1, 2) float32
        That fraction, and the other number; compact for random access.
    """
    chances = np.zeros(_CELLS * _CELLS + 1)
    nodes, weights = gauss_legendre(3)
    _add_cells(nodes, weights, chances)
    chances[-1] = 1.0 - chances.sum()
    parts, others = chances * len(chances), np.arange(len(chances))
    short, long = [list(np.nonzero(of)[0]) for of in (parts < 1.0, parts >= 1.0)]
    while short and long:
        few, many = short.pop(), long[-1]
        others[few] = many
        parts[many] -= 1.0 - parts[few]
        if parts[many] < 1.0:
            short.append(long.pop())
    # The remaining ones have 1, within rounding.
    parts[short + long] = 1.0
    return np.stack([parts, others], axis=1).astype(np.float32)


@kernel
def _add_cells(nodes: NDArray[np.float64], weights: NDArray[np.float64], chances: NDArray[np.float64]) -> None:
    """Add the integral of a hexagon's density over each cell and its mirror images, by Gaussian quadrature."""
    # The spectrum is 1 at the centre; the hexagon's area is √3/2.
    side = _HALF_SIDE / _CELLS
    scale = 4.0 * 0.5 * np.sqrt(3.0) * 0.25 * side * side
    for row in range(_CELLS):
        for column in range(_CELLS):
            for x, at_x in zip(nodes, weights):  # noqa: B905, numba's zip is not strict
                for y, at_y in zip(nodes, weights):  # noqa: B905
                    density, _ = hexagon_spectrum(side * (column + 0.5 + 0.5 * x), side * (row + 0.5 + 0.5 * y))
                    chances[_CELLS * row + column] += scale * at_x * at_y * density


def _distances() -> NDArray[np.float64]:
    return np.linspace(0.0, _BODY, 100 * PARTS + 1)


def _quantiles(within: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the quantiles of a distance from the fractions within `_distances`."""
    return np.interp(np.arange(int(PARTS * within[-1]) + 1) / PARTS, within, _distances())


@inlined
def distance_in_body(quantiles: NDArray[np.float64], share: float) -> tuple[bool, float]:
    """Return whether a quantile is in the table, and its distance; else the table's end.

    The density is constant between quantiles.

    Parameters
    ----------
    quantiles : (n,) float64
        From `sinc2_quantiles` or `airy_quantiles`.
    share : float
        Uniform in [0, 1).
    """
    place, last = PARTS * share, len(quantiles) - 1
    part = int(place)
    if part < last:
        return True, quantiles[part] + (place - part) * (quantiles[part + 1] - quantiles[part])
    return False, quantiles[last]


@kernel
def proposed_in_tail(shape: int, end: float, u: float, v: float) -> tuple[bool, float]:
    """Propose a distance beyond the table; return whether it is accepted, and the distance.

    Proposals have the density 1/x². Acceptance for sinc² is sin²(πx); for Airy's radial density, 2 J₁²(πx) / x, it is
    J₁² over its envelope, by Hankel's expansion of modulus and phase (Abramowitz & Stegun, 9.2.28 and 9.2.29), right to
    10⁻⁶ there.

    Parameters
    ----------
    shape : int
        Shape of the aperture.
    end : float
        Beginning of the tail.
    u, v : float
        Uniform in [0, 1).
    """
    x = end / (1.0 - u)
    if shape != ROUND:
        wave = np.sin(np.pi * x)
        return bool(v < wave * wave), x
    over = 1.0 / (np.pi * x)
    wave = np.cos(np.pi * (x - 0.75) + over * (0.375 - 0.1640625 * over * over))
    most = 1.0 + 0.375 / (np.pi * end) ** 2
    return bool(v * most < wave * wave * (1.0 + 0.375 * over * over)), x


@inlined
def frequency_in_cells(cells: NDArray[np.float32], share: float, u: float, v: float) -> tuple[bool, float, float]:
    """Return whether a sampled frequency of the unit hexagon is in the table, and its value.

    Parameters
    ----------
    cells : (n, 2) float32
        From `hexagon_cells`.
    share, u, v : float
        Uniform in [0, 1).
    """
    place = len(cells) * share
    # The largest random number may round up.
    part = min(int(place), len(cells) - 1)
    number = part if place - part < cells[part, 0] else int(cells[part, 1])
    return number < _CELLS * _CELLS, _along(number % _CELLS, u), _along(number // _CELLS, v)


@inlined
def _along(cell: int, u: float) -> float:
    """Return a random position in a cell, on either side of the centre."""
    side = 2.0 * u - 1.0
    place = (cell + abs(side)) * (_HALF_SIDE / _CELLS)
    return place if side > 0.0 else -place


@inlined
def is_beyond_cells(qx: float, qy: float) -> bool:
    """Tell whether a frequency of the unit hexagon lies beyond the table of cells."""
    return abs(qx) >= _HALF_SIDE or abs(qy) >= _HALF_SIDE


@inlined
def rhombus_frequency(number: int, a: float, b: float) -> tuple[float, float]:
    """Return the frequency q with products a and b with the two sides of a rhombus of the unit hexagon.

    Parameters
    ----------
    number : int
        Rhombus: 0, 1 or 2.
    a, b : float
        q·side and q·next side, distributed as sinc².
    """
    after = (number + 1) % 3
    ax, ay, bx, by = _SIDE_X[number], _SIDE_Y[number], _SIDE_X[after], _SIDE_Y[after]
    over = 1.0 / (ax * by - ay * bx)
    return (a * by - b * ay) * over, (b * ax - a * bx) * over


@kernel
def hexagon_spectrum(qx: float, qy: float) -> tuple[float, float]:
    """Return the power spectrum of the unit hexagon, and its rhombi's mean, which is no smaller; 1 at the centre.

    Parameters
    ----------
    qx, qy : float
        Frequency, in cycles over the distance of opposite sides, two of them across x.
    """
    # The products with the three sides sum to 0, which gives the last one's sine and cosine.
    a, b = qx * _SIDE_X[0] + qy * _SIDE_Y[0], qx * _SIDE_X[1] + qy * _SIDE_Y[1]
    cos_a, sin_a, cos_b, sin_b = np.cos(np.pi * a), np.sin(np.pi * a), np.cos(np.pi * b), np.sin(np.pi * b)
    cos_c, sin_c = cos_a * cos_b - sin_a * sin_b, -(sin_a * cos_b + cos_a * sin_b)
    of_a, of_b, of_c = _sinc(a, sin_a), _sinc(b, sin_b), _sinc(-a - b, sin_c)
    # Each rhombus is between two sides; its centre is half their sum, minus half the third.
    ab, bc, ca = of_a * of_b, of_b * of_c, of_c * of_a
    real, imaginary = ab * cos_c + bc * cos_a + ca * cos_b, ab * sin_c + bc * sin_a + ca * sin_b
    return (real * real + imaginary * imaginary) / 9.0, (ab * ab + bc * bc + ca * ca) / 3.0


@inlined
def _sinc(x: float, sine: float) -> float:
    """Return sinc x, given sin πx."""
    return sine / (np.pi * x) if x != 0.0 else 1.0
