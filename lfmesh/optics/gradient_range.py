"""Smallest and largest index of gradient-index glass over all of a region, by exact ranges in cells that are halved.

The polynomials of a profile are sums of functions of one variable, whose extremes over an interval are those at its
ends and at the zeros of the derivative. Over a cell of the plane across the axis, and all depths of the glass there,
the sum of the ranges of its terms bounds the value. `bounds.least` divides cells until no other one can hold a smaller
value.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import copysign, hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import GlassError
from lfmesh.optics.bounds import Range, least, plus, quotient, scaled, squared, times
from lfmesh.optics.gradient_shapes import (
    FOLDED,
    INDEX,
    INDEX_SQUARED,
    MATERIAL_HEADER,
    REVOLVED,
    SPHERICAL,
    GradientProfile,
    radial_and_axial_profile,
)

Array = NDArray[np.float64]
Place = tuple[float, float, float]
"""A value, and the distance from the axis and depth, mm, at which it is taken."""

WITHIN = 1e-8
"""Distance from the smallest value at which a search over cells ends."""

LARGEST_TERM = 1e100
"""Largest magnitude of a polynomial's terms; sums of such terms and their squares do not overflow."""

VANISHING = 1e-30
"""Coefficient of a derivative, relative to the largest one, that does not move its zeros."""

BISECTIONS = 60
"""Number of halvings of a straight line between the places of two values."""


class GlassRegion(ABC):
    """A region of glass: an area across the axis, and an interval of depths at each distance from the axis."""

    @property
    @abstractmethod
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y."""

    @property
    @abstractmethod
    def radii_mm(self) -> tuple[float, float]:
        """Smallest and largest distance from the axis."""

    @abstractmethod
    def depths(self, radii: Range) -> Range:
        """Return the smallest and largest depth z of the glass between distances from the axis.

        Parameters
        ----------
        radii : (n,) float64 each, mm

        Returns
        -------
        (n,) float64 each, mm
        """


@dataclass(frozen=True)
class OnAxis(GlassRegion):
    """The axis between two vertices.

    Attributes
    ----------
    length_mm : float
    """

    length_mm: float

    @property
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y: 0."""
        return (0.0, 0.0), (0.0, 0.0)

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Smallest and largest distance from the axis: 0."""
        return 0.0, 0.0

    def depths(self, radii: Range) -> Range:
        """Return the depths of both vertices.

        Parameters
        ----------
        radii : (n,) float64 each, mm

        Returns
        -------
        (n,) float64 each, mm
        """
        return np.zeros_like(radii[0]), np.full_like(radii[0], self.length_mm)


@dataclass(frozen=True)
class InBox(GlassRegion):
    """A box.

    Attributes
    ----------
    low_mm, high_mm : (3,) float
        Lowest and highest corner.
    """

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]

    @classmethod
    def of(cls, low_mm: Array, high_mm: Array) -> "InBox":
        """Return a box by its lowest and highest corner.

        Parameters
        ----------
        low_mm, high_mm : (3,) float64
        """
        (x, y, z), (x1, y1, z1) = low_mm.tolist(), high_mm.tolist()
        return cls((x, y, z), (x1, y1, z1))

    @property
    def corners_mm(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Lowest and highest x and y."""
        return self.low_mm[:2], self.high_mm[:2]

    @property
    def radii_mm(self) -> tuple[float, float]:
        """Smallest and largest distance from the axis."""
        sides = list(zip(*self.corners_mm, strict=True))
        nearest = (max(low, -high, 0.0) for low, high in sides)
        return hypot(*nearest), hypot(*(max(-low, high) for low, high in sides))

    def depths(self, radii: Range) -> Range:
        """Return the depths of the box.

        Parameters
        ----------
        radii : (n,) float64 each, mm

        Returns
        -------
        (n,) float64 each, mm
        """
        return np.full_like(radii[0], self.low_mm[2]), np.full_like(radii[0], self.high_mm[2])


class IndexExtreme(NamedTuple):
    """The smallest or largest index of a region.

    Attributes
    ----------
    square : float
        n²; negative without a real index.
    value : float
        The index, which is negative where the formula gives a negative one; NaN without a real one.
    radius_mm, z_mm : float
        Distance from the axis, and from the vertex along it.
    """

    square: float
    value: float
    radius_mm: float
    z_mm: float

    def in_words(self) -> str:
        """Return the index and its place."""
        value = f"n² = {self.square:.6g}" if np.isnan(self.value) else f"index {self.value:.6g}"
        aside = f"at {self.radius_mm:.4g} mm from the axis," if self.radius_mm > 0.0 else "on the axis at"
        return f"{value} {aside} z = {self.z_mm:.4g} mm"


class IndexRange(NamedTuple):
    """Smallest and largest index of a region."""

    least: IndexExtreme
    most: IndexExtreme


def index_range(profile: GradientProfile, region: GlassRegion) -> IndexRange:
    """Return the smallest and largest index of a profile over all of a region.

    Parameters
    ----------
    profile : GradientProfile
        Without products of r² and z.
    region : GlassRegion

    Raises
    ------
    GlassError
        A term of the formula is too large to be evaluated.
    """
    with np.errstate(all="ignore"):
        value = _Value(profile, region)
        low, high = value.extreme(1.0), value.extreme(-1.0)
        if profile.quantity in (INDEX, INDEX_SQUARED):
            return IndexRange(*(_extreme(profile, *each) for each in (low, high)))
        dispersed = _Dispersed(profile, low[0], high[0])
        found = (value.between(low, high, dispersed.extreme(sense)) for sense in (1.0, -1.0))
        return IndexRange(*(_extreme(profile, dispersed.squared(each[0]), *each[1:]) for each in found))


def depth_range(region: GlassRegion) -> tuple[float, float]:
    """Return the smallest and largest depth of a region, mm."""
    found = index_range(radial_and_axial_profile(0.0, (), (1.0,)), region)
    return found.least.z_mm, found.most.z_mm


def _extreme(profile: GradientProfile, value: float, radius_mm: float, z_mm: float) -> IndexExtreme:
    if profile.quantity == INDEX:
        return IndexExtreme(value * value, value, radius_mm, z_mm)
    return IndexExtreme(value, sqrt(value) if value >= 0.0 else np.nan, radius_mm, z_mm)


class _Polynomial:
    """A polynomial with its stationary points."""

    def __init__(self, coefficients: ArrayLike, reach: float) -> None:
        """Prepare a polynomial, lowest power first, for arguments up to a magnitude."""
        self.coefficients = np.append(np.asarray(coefficients, np.float64), 0.0)
        powers = np.arange(len(self.coefficients))
        terms = np.where(self.coefficients == 0.0, 0.0, self.coefficients * np.float64(reach) ** powers)
        if not (np.abs(terms) <= LARGEST_TERM).all():
            largest = np.abs(terms[1:]).max() if np.isfinite(terms).all() else np.inf
            raise GlassError(f"a term of the formula of the index reaches {largest:.3g} within the glass")
        slope = polynomial.polyder(terms)
        slope = np.where(np.abs(slope) <= VANISHING * np.abs(slope).max(), 0.0, slope)
        slope = np.trim_zeros(slope, "b")
        # The real parts of all zeros: further points of an interval do not change its exact range.
        self.stationary = reach * polynomial.polyroots(slope).real if len(slope) > 1 else np.zeros(0)

    def __call__(self, x: ArrayLike) -> Array:
        return np.asarray(polynomial.polyval(np.asarray(x, np.float64), self.coefficients), np.float64)

    def range_in(self, each: Range) -> Range:
        """Return the exact range over intervals."""
        low, high = each
        within = np.clip(self.stationary[:, None], low, high)
        values = self(np.concatenate([[low, high], within]))
        return values.min(axis=0), values.max(axis=0)


class _Value:
    """The value of a profile's polynomials over a region."""

    def __init__(self, profile: GradientProfile, region: GlassRegion) -> None:
        self.region, self.revolved = region, profile.kind in (REVOLVED, SPHERICAL)
        self.radius, self.outer = None, None
        low, high = (np.array([each]) for each in region.radii_mm)
        (z_low,), (z_high,) = region.depths((low, high))
        deep, wide = max(abs(z_low), abs(z_high)), region.radii_mm[1]
        first, second, _ = profile.counts
        self.folded = profile.kind == FOLDED
        if profile.kind == SPHERICAL:
            self.radius = float(profile.numbers[0])
            self.outer = _Polynomial(profile.numbers[1:], abs(self.radius) + hypot(wide, deep + abs(self.radius)))
            self.across: tuple[_Polynomial, ...] = (_Polynomial([0.0, 1.0], wide * wide),)
            self.along = _Polynomial([self.radius**2, -2.0 * self.radius, 1.0], deep)
        elif profile.kind == REVOLVED:
            table = profile.numbers.reshape(first, second)
            assert not table[1:, 1:].any(), "products of r² and z"
            self.across = (_Polynomial(table[:, 0], wide * wide),)
            self.along = _Polynomial([0.0, *table[0, 1:]], deep)
        else:
            of_x, of_y, of_z = np.split(profile.numbers, [first, first + second])
            (x0, y0), (x1, y1) = region.corners_mm
            self.across = tuple(
                _Polynomial(of, max(abs(a), abs(b))) for of, a, b in ((of_x, x0, x1), (of_y, y0, y1))
            )  # fmt: skip
            self.along = _Polynomial(of_z, deep)

    def extreme(self, sense: float) -> Place:
        """Return the smallest value for a sense of 1, or the largest for −1; its distance from the axis and depth."""
        corners, (inner, outer) = self.region.corners_mm, self.region.radii_mm
        low, high = ([inner], [outer]) if self.revolved else map(list, corners)

        def ranges_of(low: Array, high: Array) -> list[Range]:
            value = scaled(sense, self._ranges(low, high))[0]
            at_point = (low == high).all(axis=1)
            unknown = np.full(len(low), -np.inf), np.full(len(low), np.inf)
            return [(value, np.where(at_point, value, np.inf)), *[unknown] * low.shape[1]]

        _, place = least(ranges_of, low, high, np.inf, WITHIN)
        nearest = np.clip(0.0, low, high)
        beside, near = (self._extreme_at(sense, *map(float, at)) for at in (place, nearest))
        # Of equal values the one nearest the axis.
        return near if sense * near[0] <= sense * beside[0] + WITHIN else beside

    def _extreme_at(self, sense: float, x: float, y: float = 0.0) -> Place:
        """Return the smallest or largest value at a point across the axis, as `extreme` does."""
        depths = self._depths_at(x, y)
        values = sense * self.at(x, y, depths)
        k = int(np.argmin(values))
        return sense * float(values[k]), hypot(x, y), float(depths[k])

    def _ranges(self, low: Array, high: Array) -> Range:
        """Return the ranges of the value in cells across the axis, over all depths of the glass there."""
        if self.revolved:
            radii, terms = (low[:, 0], high[:, 0]), [squared((low[:, 0], high[:, 0]))]
        else:
            terms = [(low[:, k], high[:, k]) for k in (0, 1)]
            squares = [squared(each) for each in terms]
            radii = np.sqrt(squares[0][0] + squares[1][0]), np.sqrt(squares[0][1] + squares[1][1])
            if self.folded:
                terms[1] = np.sqrt(squares[1][0]), np.sqrt(squares[1][1])
        inner, outer = self.region.radii_mm
        inside = np.clip(radii[0], inner, outer), np.clip(radii[1], inner, outer)
        parts = [of.range_in(each) for of, each in zip(self.across, terms, strict=True)]
        parts.append(self.along.range_in(self.region.depths(inside)))
        value = np.sum([each[0] for each in parts], axis=0), np.sum([each[1] for each in parts], axis=0)
        if self.outer is not None:
            value = self.outer.range_in(self._t(value))
        beside = (radii[0] > outer) | (radii[1] < inner)
        return np.where(beside, np.inf, value[0]), np.where(beside, -np.inf, value[1])

    def _t(self, squares: Range) -> Range:
        """Return t = R − sgn(R) d for ranges of the squared distance d² from the centre."""
        assert self.radius is not None
        sign = copysign(1.0, self.radius)
        ends = [self.radius - sign * np.sqrt(np.maximum(each, 0.0)) for each in squares]
        return (ends[1], ends[0]) if sign > 0.0 else (ends[0], ends[1])

    def _depths_at(self, x: float, y: float) -> Array:
        """Return the depths at a point across the axis between which the value has no extreme."""
        at = np.array([hypot(x, y)])
        (low,), (high,) = self.region.depths((at, at))
        between = [self.along.stationary]
        if self.outer is not None and self.radius is not None:
            half = np.sqrt(np.maximum((self.radius - self.outer.stationary) ** 2 - at * at, 0.0))
            between += [self.radius + half, self.radius - half]
        return np.concatenate([[low, high], np.clip(np.concatenate(between), low, high)])

    def at(self, x: float, y: float, z: Array) -> Array:
        """Return the value at points."""
        places = (x * x + y * y,) if self.revolved else (x, abs(y) if self.folded else y)
        value = sum(of(place) for of, place in zip(self.across, places, strict=True)) + self.along(z)
        if self.outer is not None:
            value = self.outer(self._t((value, value))[0])
        return np.asarray(value)

    def between(self, low: Place, high: Place, value: float) -> Place:
        """Return a value, and its place on the straight line between the places of a smaller and a larger one."""
        ends = np.array(low[1:]), np.array(high[1:])
        if not self.revolved or not low[0] < value < high[0]:
            nearest = low if abs(value - low[0]) <= abs(value - high[0]) else high
            return value, *nearest[1:]
        share, step = 0.0, 1.0
        for _ in range(BISECTIONS):
            step *= 0.5
            r, z = ends[0] + (share + step) * (ends[1] - ends[0])
            share += step if self.at(r, 0.0, np.array([z]))[0] < value else 0.0
        r, z = ends[0] + share * (ends[1] - ends[0])
        return value, float(r), float(z)


class _Dispersed:
    """n² as a function of the reference index, see `GradientMaterial`."""

    def __init__(self, profile: GradientProfile, low: float, high: float) -> None:
        self.low, self.high = low, high
        self.factor, self.square = profile.material[:2]
        terms, of_strength, of_resonance = (int(count) for count in profile.material[2:MATERIAL_HEADER])
        numbers, reach = profile.material[MATERIAL_HEADER:], max(abs(low), abs(high))
        rows = np.split(numbers, [terms * of_strength])
        self.strengths, self.resonances = (
            [_Polynomial(row, reach) for row in each.reshape(terms, count)]
            for each, count in zip(rows, (of_strength, of_resonance), strict=True)
        )

    def ranges(self, value: Range) -> Range:
        """Return the ranges of n² over ranges of the reference index."""
        terms = [squared(value)]
        for strength, resonance in zip(self.strengths, self.resonances, strict=True):
            below = scaled(-1.0, resonance.range_in(value))
            divisor = self.square + below[0], self.square + below[1]
            terms.append(times(quotient(strength.range_in(value), divisor), (np.full_like(value[0], self.factor),) * 2))
        return plus(*terms)

    def squared(self, value: float) -> float:
        """Return n² at a reference index."""
        found = value * value
        for strength, resonance in zip(self.strengths, self.resonances, strict=True):
            found += self.factor * float(strength(value)) / (self.square - float(resonance(value)))
        return found

    def extreme(self, sense: float) -> float:
        """Return the reference index of the smallest n² for a sense of 1, or of the largest for −1."""

        def ranges_of(low: Array, high: Array) -> list[Range]:
            value = scaled(sense, self.ranges((low[:, 0], high[:, 0])))
            unknown = np.full(len(low), -np.inf), np.full(len(low), np.inf)
            return [value, unknown]

        return float(least(ranges_of, [self.low], [self.high], np.inf, WITHIN)[1][0])
