"""Forbes' strong aspheres, "Q-con": a departure from the conic in terms that are orthogonal over the aperture.

G. W. Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15 (2007) 5218-5226: with
u = r / ρ, the sag beyond the conic is u⁴ Σ a_m Q_m(u²), where Q_m(x) is the Jacobi polynomial P_m^(0,4)(2x − 1). The
surface is traced as an even asphere.
"""

import math
import sys
from functools import cache, lru_cache

from pydantic import Field

from lfmesh.scene.model import Model
from lfmesh.scene.quantities import Coefficient, Positive

MOST_ASPHERE_TERMS = 14
"""Maximum number of terms of an asphere, up to r³⁰."""


class Qcon(Model):
    """Deviation from the conic by Forbes' coefficients."""

    norm_radius_mm: Positive
    """Normalisation radius, in mm, at which every polynomial is 1: about the clear aperture. Beyond it they grow."""
    coefficients_mm: tuple[Coefficient, ...] = Field(min_length=1, max_length=MOST_ASPHERE_TERMS)
    """Forbes' coefficients, from a₀ up, in mm."""

    @property
    def asphere_mm(self) -> tuple[float, ...]:
        """Coefficients of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ...

        Up to ρ, rounding changes the sag by less than 1e-8 of the largest a_m with ten terms, 1e-13 with four.
        """
        return _even_terms(self.norm_radius_mm, self.coefficients_mm)

    def growth(self, height_mm: float) -> float:
        """Return the largest u⁴ Q_m(u²) at a height among the terms in use; it is 1 at the norm radius.

        Parameters
        ----------
        height_mm : float

        Returns
        -------
        float
        """
        used = [m for m, coefficient in enumerate(self.coefficients_mm) if coefficient]
        try:
            u = height_mm / self.norm_radius_mm
            return max(
                (abs(math.fsum(a * u ** (2 * k + 4) for k, a in enumerate(_powers(m)))) for m in used), default=0.0
            )
        except OverflowError:
            return math.inf


def within_floats(asphere_mm: tuple[float, ...], norm_radius_mm: float) -> bool:
    """Return whether all coefficients and powers up to the rim are within the range of floats."""
    try:
        highest = norm_radius_mm ** (2 * len(asphere_mm) + 2)
    except OverflowError:
        return False
    return all(map(math.isfinite, asphere_mm)) and sys.float_info.min <= highest


@lru_cache(maxsize=256)
def _even_terms(norm_radius: float, coefficients: tuple[float, ...]) -> tuple[float, ...]:
    count = len(coefficients)
    terms = []
    for k in range(count):
        parts = (_powers(m)[k] * coefficients[m] for m in range(k, count))
        try:
            terms.append(math.fsum(parts) / norm_radius ** (2 * k + 4))
        except (OverflowError, ZeroDivisionError):
            terms.append(math.inf)
    return tuple(terms)


@cache
def _powers(m: int) -> tuple[int, ...]:
    """Return the coefficients of 1, x, x², ... in Q_m, exactly."""
    return tuple((-1) ** (m + k) * math.comb(m, k) * math.comb(m + k + 4, m) for k in range(m + 1))
