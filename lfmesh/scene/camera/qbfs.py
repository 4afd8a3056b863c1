"""Forbes' mild aspheres, "Q-bfs": a deviation along the normal of a conic, in terms with orthogonal slopes.

G. W. Forbes, "Shape specification for axially symmetric optical surfaces", Opt. Express 15 (2007) 5218-5226: with
u = r / ρ, the sag beyond a sphere of curvature c is u² (1 − u²) / √(1 − c² r²) Σ a_m Q_m(u²). The root is the cosine of
the sphere's normal; for a conic it is √(1 − (1 + k) c² r²) / √(1 − k c² r²). The recurrence of the Q_m is from "Robust,
efficient computational methods for axially symmetric optical aspheres", Opt. Express 18 (2010) 19700-19712. The surface
is traced as an even asphere of the same vertex curvature.
"""

import math
from dataclasses import dataclass
from decimal import Decimal, localcontext
from functools import lru_cache

from pydantic import Field

from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS, within_floats
from lfmesh.scene.model import Model
from lfmesh.scene.quantities import Coefficient, Positive

_LARGEST_ERROR = 1e-9
"""Largest error of the even asphere, in mm or in units of ρ if that is less than 1 mm; worse fits are refused."""

_WANTED = 0.01
"""Fraction of the largest error at which no further terms are added."""

_DIGITS = 50
_CHECKED = 64


class Qbfs(Model):
    """Deviation from the sphere or conic by Forbes' coefficients."""

    norm_radius_mm: Positive
    """Normalisation radius, in mm, at which the surface meets its conic again: the clear aperture, or slightly more."""
    coefficients_mm: tuple[Coefficient, ...] = Field(min_length=1, max_length=MOST_ASPHERE_TERMS)
    """Forbes' coefficients, from a₀ up, in mm."""

    @property
    def largest_error_mm(self) -> float:
        """Error limit on the sag of the even form against the formula."""
        return _LARGEST_ERROR * min(1.0, self.norm_radius_mm)

    def even_form(
        self, curvature_per_mm: float, conic: float = 0.0, semi_diameter_mm: float | None = None
    ) -> "EvenForm | None":
        """Return the deviation from a conic as an even asphere, or None if a conic ends inside the aperture.

        Parameters
        ----------
        curvature_per_mm : float
            Vertex curvature of the conic.
        conic : float
            Conic constant.
        semi_diameter_mm : float, optional
            Radius of the clear aperture. Default: the normalisation radius.

        Returns
        -------
        EvenForm or None
        """
        reach = min(semi_diameter_mm or self.norm_radius_mm, self.norm_radius_mm)
        wanted = _WANTED * self.largest_error_mm
        return _even_form((curvature_per_mm, conic), self.norm_radius_mm, self.coefficients_mm, reach, wanted)


@dataclass(frozen=True)
class EvenForm:
    """A conic with even terms, and the error of its sag against Forbes' formula."""

    radius_mm: float
    conic: float
    asphere_mm: tuple[float, ...]
    error_mm: float


def _q(x: Decimal, coefficients: tuple[Decimal, ...]) -> Decimal:
    """Return Σ a_m Q_m(x)."""
    p_before, p = Decimal(2), 6 - 8 * x
    f, g, q_before, q = Decimal(19).sqrt() / 2, Decimal("-0.5"), Decimal(0), Decimal(1)
    f_before, total = Decimal(2), coefficients[0]
    h = Decimal(0)
    for m, a in enumerate(coefficients[1:], start=1):
        if m > 1:
            h = -Decimal(m * (m - 1)) / (2 * f_before)
            g_next = -(1 + g * h) / f
            f_before, f = f, (m * (m + 1) + 3 - g_next * g_next - h * h).sqrt()
            g = g_next
            p_before, p = p, (2 - 4 * x) * p - p_before
        q_before, q = q, (p - g * q - h * q_before) / f
        total += a * q
    return total


def _conic(curvature: Decimal, conic: Decimal, r2: Decimal) -> Decimal:
    return curvature * r2 / (1 + (1 - (1 + conic) * curvature * curvature * r2).sqrt())


@lru_cache(maxsize=256)
def _even_form(
    base: tuple[float, float], norm_radius: float, coefficients: tuple[float, ...], reach: float, wanted_mm: float
) -> EvenForm | None:
    """Return the even form with the fewest terms that meet the wanted error, or the one with the least error."""
    with localcontext() as context:
        context.prec = _DIGITS
        c, k, rho, rim = *map(Decimal, base), Decimal(norm_radius), Decimal(reach)
        outside = (rim / rho) ** 2
        a = tuple(Decimal(value) for value in coefficients)
        at_vertex = c + 2 * _q(Decimal(0), a) / rho**2
        radius = float(1 / at_vertex) if at_vertex else math.inf
        if radius == 0.0 or (1 + k) * (max(abs(c), abs(at_vertex)) * rim) ** 2 >= 1:
            return None
        vertex, of_form = (Decimal(0) if math.isinf(radius) else 1 / Decimal(radius)), (k if c else Decimal(-1))

        def beyond(x: Decimal) -> Decimal:
            r2 = x * rho * rho
            cosine = ((1 - (1 + k) * c * c * r2) / (1 - k * c * c * r2)).sqrt()
            forbes = x * (1 - x) / cosine * _q(x, a)
            return _conic(c, k, r2) + forbes - _conic(vertex, of_form, r2)

        places = [outside * i / _CHECKED for i in range(1, _CHECKED + 1)]
        true = [float(beyond(x)) for x in places]
        best: EvenForm | None = None
        for count in range(1, MOST_ASPHERE_TERMS + 1):
            nodes = [outside * Decimal(0.5 - 0.5 * math.cos((i + 0.5) * math.pi / count)) for i in range(count)]
            terms = _interpolated(nodes, [beyond(x) / x**2 for x in nodes])
            found = tuple(float(term / rho ** (2 * i + 4)) for i, term in enumerate(terms))
            error = max(abs(_float_sum(terms, x) - z) for x, z in zip(places, true, strict=True))
            if not within_floats(found, norm_radius):
                error = math.inf
            if best is None or not error >= best.error_mm:
                best = EvenForm(radius, float(of_form), found, error)
            if error <= wanted_mm:
                break
        return best


def _float_sum(terms: list[Decimal], x: Decimal) -> float:
    """Return the sag of the terms at u² = x as the tracer rounds it."""
    power = place = float(x)
    total = 0.0
    for term in terms:
        power *= place
        total += float(term) * power
    return total


def _interpolated(nodes: list[Decimal], values: list[Decimal]) -> list[Decimal]:
    """Return the coefficients, from x⁰ up, of the interpolating polynomial, by Newton's divided differences."""
    divided = list(values)
    for level in range(1, len(nodes)):
        for i in range(len(nodes) - 1, level - 1, -1):
            divided[i] = (divided[i] - divided[i - 1]) / (nodes[i] - nodes[i - level])
    terms = [divided[-1]]
    for node, constant in zip(reversed(nodes[:-1]), reversed(divided[:-1]), strict=True):
        shifted = [Decimal(0), *terms]
        terms = [s - node * t for s, t in zip(shifted, [*terms, Decimal(0)], strict=True)]
        terms[0] += constant
    return terms
