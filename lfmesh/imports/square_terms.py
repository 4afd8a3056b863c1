"""Elimination of a term in r² from a surface's sag."""

import math
from dataclasses import dataclass

from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS


def without_square(
    curvature: float, conic: float, terms: list[float], square: float
) -> tuple[float, float, list[float]]:
    """Return curvature, conic constant and coefficients of r⁴, r⁶, ... of a surface plus a term a r².

    The conic's sag is Σ b_m ((1 + k) c²)^(m−1) c r^(2m), with b_m = C_(m−1) / 2^(2m−1) and Catalan's numbers C. The new
    curvature is c + 2a, and the new conic constant keeps (1 + k) c², which leaves the terms −2 a b_m ((1 + k) c²)^(m−1)
    of r⁴ and up. Exact for a flat surface and a parabola; else see `SquareTerm.error_at`.

    Parameters
    ----------
    curvature : float
        In any unit of length, shared by the other arguments.
    conic : float
    terms : list of float
        Coefficients of r⁴, r⁶, ...
    square : float
        Coefficient of r².
    """
    new = curvature + 2.0 * square
    bend = (1.0 + conic) * curvature**2
    made = terms + [0.0] * (MOST_ASPHERE_TERMS - len(terms))
    if new == 0.0:
        left = curvature
        new_conic = 0.0
    else:
        left = -2.0 * square
        new_conic = bend / new**2 - 1.0
    for place in range(MOST_ASPHERE_TERMS):
        made[place] += _share(place + 2) * bend ** (place + 1) * left
    return new, new_conic, made


@dataclass(frozen=True)
class SquareTerm:
    """Surface before its r² term was rewritten, lengths in any one unit.

    Attributes
    ----------
    curvature, conic : float
    square : float
        Coefficient of r².
    """

    curvature: float
    conic: float
    square: float

    def error_at(self, radius: float) -> float:
        """Return the deviation of the rewritten surface at a height: the omitted terms of the series.

        Parameters
        ----------
        radius : float
        """
        bend = (1.0 + self.conic) * self.curvature**2 * radius**2
        if not abs(bend) < 1.0:
            return math.inf
        left = self.curvature if self.curvature + 2.0 * self.square == 0.0 else -2.0 * self.square
        return abs(sum(_share(m) * bend ** (m - 1) * left * radius**2 for m in range(MOST_ASPHERE_TERMS + 2, 400)))


def _share(m: int) -> float:
    """Return b_m."""
    return math.exp(math.lgamma(2 * m - 1) - math.lgamma(m) - math.lgamma(m + 1) - (2 * m - 1) * math.log(2.0))
