"""Surfaces with different x–z and y–z sections: biconics and toroids, including cylinders.

Each is a `Form` and a field of `Surface`. The surface's own keys (`radius_mm`, `conic`, and `asphere_mm` for a toroid)
describe the y–z section. OpticStudio calls them biconic and toroidal.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from lfmesh.optics.bounds import (
    ACROSS,
    SAG,
    Array,
    Range,
    least,
    meridian_ranges,
    plus,
    profile_range,
    quotient,
    scaled,
    squared,
    times,
)
from lfmesh.optics.section_bounds import BiconicParts, biconic_parts, toroid_height, toroid_seconds
from lfmesh.scene.camera.forms import Form, Heights, SurfaceShape, reach_of_conic_mm
from lfmesh.scene.quantities import Number, Radius

END_WITHIN = 1e-6
"""Largest relative distance between a toroid's end and the height that it is proven to reach."""


class Biconic(Form):
    """The x–z section of a biconic."""

    symmetric = True
    radius_x_mm: Radius
    """Radius of curvature at the vertex in the section x–z, in mm; inf is flat."""
    conic_x: Number = 0.0
    """Conic constant in the section x–z."""

    def sag_at_mm(self, surface: SurfaceShape, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point.

        Parameters
        ----------
        surface, x_mm, y_mm
            As in `Form`.

        Returns
        -------
        float or array
            mm.
        """
        c_x, c_y = curvature(self.radius_x_mm), surface.curvature_per_mm
        return biconic_sag_mm(c_x, self.conic_x, c_y, surface.conic, x_mm, y_mm)

    def ranges_in(self, surface: SurfaceShape, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range, Range]:
        """Return bounds of the sag and its derivatives.

        See `BiconicParts`.

        Parameters
        ----------
        surface, square, sine, cosine
            As in `Form`.

        Returns
        -------
        tuple of three Range
            mm, 1/mm and mm.
        """
        parts, (c, a) = self._parts_in(surface, times(square, squared(sine)), times(square, squared(cosine)))
        by_x2, by_y2 = (parts.by_square(*each) for each in zip(c, a, strict=True))
        return parts.height, *_polar(by_x2, by_y2, square, sine, cosine)

    def bends_in(self, surface: SurfaceShape, x: Range, y: Range) -> list[Range]:
        """Return bounds of the sag and its derivatives.

        See `BiconicParts`.

        Parameters
        ----------
        surface, x, y
            As in `Form`.

        Returns
        -------
        list of six Range
            mm, 1, 1, 1/mm, 1/mm and 1/mm.
        """
        x2, y2 = squared(x), squared(y)
        parts, (c, a) = self._parts_in(surface, x2, y2)
        by_x, by_y = (times(at, scaled(2.0, parts.by_square(*each))) for at, *each in zip((x, y), c, a, strict=True))
        xx, yy = (
            parts.second(of, e, at2, plus(scaled(4.0 * of, at2), parts.bulge))
            for at2, of, e in zip((x2, y2), c, a, strict=True)
        )
        return [parts.height, by_x, by_y, xx, times(x, y, parts.mixed(c, a)), yy]

    def _parts_in(
        self, surface: SurfaceShape, x2: Range, y2: Range
    ) -> tuple[BiconicParts, tuple[tuple[float, float], tuple[float, float]]]:
        """Return the parts in cells, and c and a for x and y."""
        c = curvature(self.radius_x_mm), surface.curvature_per_mm
        a = (1.0 + self.conic_x) * c[0] * c[0], (1.0 + surface.conic) * c[1] * c[1]
        bulge, dip = (plus(scaled(of[0], x2), scaled(of[1], y2)) for of in (c, a))
        return biconic_parts(bulge, dip), (c, a)

    def reach_mm(self, surface: SurfaceShape) -> float:
        """Return the smaller reach of its two conics.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            mm; infinite if neither ends.
        """
        return min(super().reach_mm(surface), reach_of_conic_mm(self.radius_x_mm, self.conic_x))

    def curvature_x_per_mm(self, surface: SurfaceShape) -> float:
        """Return the curvature of the x–z section.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            1/mm.
        """
        return curvature(self.radius_x_mm)


class Toroid(Form):
    """The x–z section of a toroid."""

    symmetric = True
    without = ("odd_asphere_mm", "qcon", "qbfs", "mesh")
    radius_x_mm: Radius
    """Radius of the circle in the section x–z, in mm: positive towards the sensor; inf is a cylinder's. It is the
    distance from the vertex to the line, parallel to y, about which the y–z section is rotated."""

    def sag_at_mm(self, surface: SurfaceShape, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z above the vertex plane at a point.

        Parameters
        ----------
        surface, x_mm, y_mm
            As in `Form`.

        Returns
        -------
        float or array
            mm.
        """
        return toroid_sag_mm(curvature(self.radius_x_mm), surface.sag_mm(y_mm), x_mm)

    def ranges_in(self, surface: SurfaceShape, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range, Range]:
        """Return bounds of the sag and its derivatives.

        With the y–z section f(y), u = 1 − c_x f and v² = u² − c_x² x², the sag is f + c_x x² / (u + v). Its derivatives
        by x² and y² are c_x / (2 v) and f′ u / (2 y v).

        Parameters
        ----------
        surface, square, sine, cosine
            As in `Form`.

        Returns
        -------
        tuple of three Range
            mm, 1/mm and mm.
        """
        c_x = curvature(self.radius_x_mm)
        x2, y2 = (times(square, squared(each)) for each in (sine, cosine))
        f, across = surface.profile_ranges((np.sqrt(y2[0]), np.sqrt(y2[1])))
        u = _clipped(plus(_ones(f), scaled(-c_x, f)))
        v2 = plus(times(u, u), scaled(-c_x * c_x, x2))
        v = np.sqrt(np.maximum(v2[0], 0.0)), np.sqrt(np.maximum(v2[1], 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            over = 0.5 / v[1], 0.5 / v[0]
            return toroid_height(c_x, f, x2, u, v), *_polar(
                scaled(c_x, over), times(across, u, over), square, sine, cosine
            )

    def bends_in(self, surface: SurfaceShape, x: Range, y: Range) -> list[Range]:
        """Return bounds of the sag and its derivatives.

        In the notation of `ranges_in`, with e = f′ c_x x / v, the derivatives are c_x x / v, f′ u / v, c_x u² / v³,
        c_x e u / v² and c_x e² / v + f″ u / v.

        Parameters
        ----------
        surface, x, y
            As in `Form`.

        Returns
        -------
        list of six Range
            mm, 1, 1, 1/mm, 1/mm and 1/mm.
        """
        c_x = curvature(self.radius_x_mm)
        f, rise, bend = meridian_ranges(surface.curvature_per_mm, surface.vertex_conic, surface.powers_mm, y)
        x2 = squared(x)
        u = _clipped(plus(_ones(f), scaled(-c_x, f)))
        v2 = plus(squared(u), scaled(-c_x * c_x, x2))
        v = np.sqrt(np.maximum(v2[0], 0.0)), np.sqrt(np.maximum(v2[1], 0.0))
        along, over = quotient(u, v), quotient(_ones(v), v)
        by_x = scaled(c_x, times(x, over))
        e = times(rise, by_x)
        in_x, turned, bent = toroid_seconds(c_x, along, over, squared(e), bend)
        both = scaled(c_x, times(e, along, over))
        return [toroid_height(c_x, f, x2, u, v), by_x, times(rise, along), in_x, both, plus(turned, bent)]

    def reach_mm(self, surface: SurfaceShape) -> float:
        """Return the largest height reached at every azimuth.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            mm; infinite if it does not end.
        """
        return _toroid_reach_mm(surface)

    def curvature_x_per_mm(self, surface: SurfaceShape) -> float:
        """Return the curvature of the circle.

        Parameters
        ----------
        surface : Surface

        Returns
        -------
        float
            1/mm.
        """
        return curvature(self.radius_x_mm)


@lru_cache(maxsize=256)
def _toroid_reach_mm(surface: SurfaceShape) -> float:
    most = reach_of_conic_mm(surface.vertex_radius_mm, surface.vertex_conic)
    conic = surface.curvature_per_mm, surface.vertex_conic
    return toroid_reach_mm(surface.curvature_x_per_mm, *conic, surface.powers_mm, most)


def _polar(by_x2: Range, by_y2: Range, square: Range, sine: Range, cosine: Range) -> tuple[Range, Range]:
    """Convert ranges of derivatives by x² and y² to derivatives by r² and azimuth."""
    out = plus(times(squared(sine), by_x2), times(squared(cosine), by_y2))
    return out, scaled(2.0, times(square, sine, cosine, plus(by_x2, scaled(-1.0, by_y2))))


def _ones(like: Range) -> Range:
    one = np.ones_like(like[0])
    return one, one


def _clipped(each: Range) -> Range:
    """Return ranges with negative ends replaced by 0."""
    return np.maximum(each[0], 0.0), np.maximum(each[1], 0.0)


def curvature(radius_mm: float) -> float:
    """Return 1/radius, 0 for a flat section."""
    return 0.0 if math.isinf(radius_mm) else 1.0 / radius_mm


def biconic_sag_mm(c_x: float, conic_x: float, c_y: float, conic_y: float, x: Heights, y: Heights) -> Heights:
    """Return (c_x x² + c_y y²) / (1 + √(1 − (1 + k_x) c_x² x² − (1 + k_y) c_y² y²)), with the root clipped at 0.

    Parameters
    ----------
    c_x, conic_x, c_y, conic_y : float
        Curvatures, 1/mm, and conic constants.
    x, y : float or array, mm
    """
    square = (1.0 + conic_x) * (c_x * x) ** 2 + (1.0 + conic_y) * (c_y * y) ** 2
    return (c_x * x * x + c_y * y * y) / (1.0 + np.sqrt(np.maximum(0.0, 1.0 - square)))


def toroid_sag_mm(c_x: float, along_y_mm: Heights, x: Heights) -> Heights:
    """Return the sag of a toroid at a distance x from its y–z section.

    From (1/c_x − z)² + x² = (1/c_x − f)²: z = f + c_x x² / (1 − c_x f + √((1 − c_x f)² − c_x² x²)).

    Parameters
    ----------
    c_x : float, 1/mm
    along_y_mm : float or array
        Sag f of the y–z section.
    x : float or array, mm
    """
    rest = 1.0 - c_x * along_y_mm
    below = rest + np.sqrt(np.maximum(0.0, rest * rest - (c_x * x) ** 2))
    divisor: Any = np.where(below > 0.0, below, np.inf)
    return along_y_mm + c_x * x * x / divisor


def toroid_reach_mm(
    c_x: float, c_y: float, conic: float, powers_mm: Sequence[tuple[int, float]], most_mm: float
) -> float:
    """Return a height that a toroid is proven to reach at every azimuth.

    From c_x² x² < (1 − c_x f(y))², its squared reach is the minimum of y² + (1/c_x − f(y))².

    Parameters
    ----------
    c_x, c_y : float, 1/mm
        Curvatures.
    conic : float
    powers_mm : sequence of (int, float)
        Exponents of y and their coefficients.
    most_mm : float
        Reach of the y–z section.
    """
    if c_x == 0.0:
        return most_mm
    end = min(most_mm, 1.0 / abs(c_x))

    def ranges_of(low: Array, high: Array) -> tuple[Range, Range]:
        """Return bounds of the squared reach, times c_x², and of its derivative by y²."""
        y2 = low[:, 0], high[:, 0]
        y, curved = (np.sqrt(y2[0]), np.sqrt(y2[1])), (np.full(len(low), c_y),) * 2
        f, across = (profile_range(curved, conic, powers_mm, y, order) for order in (SAG, ACROSS))
        u = _clipped(plus(_ones(f), scaled(-c_x, f)))
        square = plus(scaled(c_x * c_x, y2), times(u, u))
        return square, plus(scaled(c_x * c_x, _ones(f)), scaled(-c_x, times(u, across)))

    enough = (c_x * end) ** 2
    # Sags beyond float64 end the surface at 0.
    with np.errstate(over="ignore", invalid="ignore"):
        found, _ = least(ranges_of, [0.0], [end * end], enough, 0.25 * END_WITHIN * enough)
    if found >= enough:
        return end
    reach = end * math.sqrt(found / enough) * (1.0 - END_WITHIN)
    # If the reach is far inside the searched range, search again for the same relative accuracy.
    return reach if reach > 0.5 * end else toroid_reach_mm(c_x, c_y, conic, powers_mm, 1.5 * reach)
