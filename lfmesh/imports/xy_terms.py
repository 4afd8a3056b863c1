"""Terms x^i y^j: their numbering in Zemax and CODE V files, and fringe Zernike polynomials in these terms."""

import math
from collections.abc import Iterator, Sequence

MOST_FRINGE_TERMS = 37
"""Number of fringe Zernike polynomials."""


def powers_of(number: int) -> tuple[int, int]:
    """Return the powers (i, j) of a term, numbered from 1: x, y, x², x y, y², x³, ...

    Zemax's extended polynomials ("x, then y, then x*x, x*y, y*y": Zemax's article 255; checked with its sample
    sc_diffract3) and CODE V's phase polynomials (j = ((m + n)² + m + 3 n) / 2 for x^m y^n) have the same order.

    Parameters
    ----------
    number : int
        From 1.
    """
    degree = (math.isqrt(8 * number + 1) - 1) // 2
    j = number - degree * (degree + 1) // 2
    return degree - j, j


def number_of(i: int, j: int) -> int:
    """Return the number of the term x^i y^j, from 1; the inverse of `powers_of`."""
    degree = i + j
    return degree * (degree + 1) // 2 + j


def fringe_terms(coefficients: Sequence[float]) -> dict[tuple[int, int], float]:
    """Return a sum of fringe Zernike polynomials as coefficients of x^i y^j, by (i, j), without the constant.

    The polynomials are R_n^m(ρ) cos mθ and R_n^m(ρ) sin mθ with x = ρ cos θ and y = ρ sin θ, not normalised: 1,
    ρ cos θ, ρ sin θ, 2ρ² − 1, ... (Wyant and Creath, Applied Optics and Optical Engineering XI, 28, 1992).

    Parameters
    ----------
    coefficients : sequence of float
        Of the polynomials 1 to 37 in fringe order.
    """
    sums: dict[tuple[int, int], list[float]] = {}
    for value, (n, m, sine) in zip(coefficients, _fringe_order(), strict=False):
        if value:
            for powers, whole in _polynomial(n, m, sine).items():
                sums.setdefault(powers, []).append(value * whole)
    sums.pop((0, 0), None)
    return {powers: total for powers, values in sums.items() if (total := math.fsum(values))}


def _fringe_order() -> Iterator[tuple[int, int, bool]]:
    """Yield n, m, and whether the polynomial has the sine, in fringe order."""
    for half in range(6):
        for m in range(half, -1, -1):
            yield 2 * half - m, m, False
            if m:
                yield 2 * half - m, m, True
    yield 12, 0, False


def _polynomial(n: int, m: int, sine: bool) -> dict[tuple[int, int], int]:
    """Return the whole coefficients of a Zernike polynomial in x^i y^j, by (i, j)."""
    # r^m cos mθ and r^m sin mθ are the real and the imaginary part of (x + iy)^m.
    around = {k: math.comb(m, k) * (1, 1, -1, -1)[k % 4] for k in range(int(sine), m + 1, 2)}
    terms: dict[tuple[int, int], int] = {}
    for s in range((n - m) // 2 + 1):
        radial = (-1) ** s * math.factorial(n - s)
        radial //= math.factorial(s) * math.factorial((n + m) // 2 - s) * math.factorial((n - m) // 2 - s)
        squares = (n - m) // 2 - s
        for t in range(squares + 1):
            for k, part in around.items():
                powers = m - k + 2 * (squares - t), k + 2 * t
                terms[powers] = terms.get(powers, 0) + radial * math.comb(squares, t) * part
    return {powers: value for powers, value in terms.items() if value}
