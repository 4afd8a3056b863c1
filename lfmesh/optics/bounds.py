"""Proven bounds of heights, slopes and second derivatives, by ranges over cells that are halved until narrow.

A range is a pair of arrays with the smallest and largest value in each cell (R. E. Moore, R. B. Kearfott and
M. J. Cloud, Introduction to Interval Analysis, 2009).
"""

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Range = tuple[Array, Array]

SAG, SLOPE, ACROSS, ALONG, ACROSS_RATE, ALONG_RATE = range(6)
"""Quantities of a profile z(r): z, z′, the second derivatives across the meridian, z′/r, and along it, z″, and the
derivatives of these two."""

RATES = {SAG: SLOPE, SLOPE: ALONG, ACROSS: ACROSS_RATE, ALONG: ALONG_RATE}
"""Derivative of each quantity by r."""

FIRST_CELLS = 64
"""Number of cells that a box is divided into before any is discarded."""

MOST_CELLS = 1 << 11, 1 << 9
"""Number of cells, for one and for two variables, at which division stops: bounds stay valid but are wider than
requested."""

HALVINGS = 48
"""Maximum number of bisections of a cell's sides, which then reach the resolution of float64."""

NEGLIGIBLE = 0.1
"""Size of an extreme, relative to the other one, below which its bound may stay wide."""

MOST_OPEN = 1 << 13
"""Number of cells at which `least` and `first_below` stop dividing."""

ROUNDING = 1e-10
"""Relative margin of each term: above the rounding of float64, even close to the end of a surface."""


def extremes(ranges_in: Callable[[Array, Array], Range], low: Sequence[float], high: Sequence[float], within: float) \
        -> tuple[float, float]:  # fmt: skip
    """Return bounds of the minimum and maximum of a function in a box.

    Parameters
    ----------
    ranges_in : callable
        Returns bounds of the function, (n,) each, in boxes with two corners, (n, d) each; its values at a point.
    low, high : (d,) float
        Corners of the box.
    within : float
        Largest relative distance of a bound from the extreme.
    """

    def cells_in(lows: Array, highs: Array) -> tuple[Range, Range]:
        """Return the ranges in cells, and the smaller and larger value at two corners of each."""
        ranges = ranges_in(np.concatenate([lows, lows, highs]), np.concatenate([highs, lows, highs]))
        (least, *leasts), (most, *mosts) = (each.reshape(3, -1) for each in ranges)
        return (least, most), (np.minimum(*leasts), np.maximum(*mosts))

    return _extremes(cells_in, low, high, within)


def _extremes(
    cells_in: Callable[[Array, Array], tuple[Range, Range]], low: Sequence[float], high: Sequence[float], within: float
) -> tuple[float, float]:
    """Return bounds of a function's extremes, given its ranges in cells and attained values."""
    lows, highs = np.array([low], np.float64), np.array([high], np.float64)
    most_cells = MOST_CELLS[(lows < highs).sum() - 1]
    left_out, attained = np.array([np.inf, -np.inf]), np.array([np.inf, -np.inf])
    for _ in range(HALVINGS):
        lows, highs = _first_cells(lows, highs)
        (least, most), values = cells_in(lows, highs)
        attained = np.array([min(attained[0], values[0].min()), max(attained[1], values[1].max())])
        size = np.abs(attained)
        slack = within * np.maximum(size, NEGLIGIBLE * size.max())
        divided = (least < attained[0] - slack[0]) | (most > attained[1] + slack[1])
        divided &= (lows < highs).any(axis=1)
        enough = divided.sum() > most_cells and np.isfinite(least).all() and np.isfinite(most).all()
        ended = ~divided | enough
        left_out = np.array([
            np.min(least[ended], initial=left_out[0]), np.max(most[ended], initial=left_out[1]),
        ])  # fmt: skip
        lows, highs = _halved(lows[~ended], highs[~ended])
        if not len(lows):
            return float(left_out[0]), float(left_out[1])
    (least, most), _ = cells_in(lows, highs)
    return float(min(left_out[0], least.min())), float(max(left_out[1], most.max()))


def least(
    ranges_of: Callable[[Array, Array], Sequence[Range]], low: Sequence[float], high: Sequence[float], enough: float,
    within: float,
) -> tuple[float, Array]:  # fmt: skip
    """Return the minimum of a function in a box, and its position.

    Parameters
    ----------
    ranges_of : callable
        Returns bounds of the function, (n,) each, and of its partial derivatives, in boxes with two corners, (n, d)
        each.
    low, high : (d,) float
        Corners of the box.
    enough : float
        The search stops once no value is below this.
    within : float
        Largest error of a minimum below `enough`.
    """
    lows, highs, found, place = np.array([low], np.float64), np.array([high], np.float64), np.inf, np.array(high)
    for _ in range(HALVINGS * len(low)):
        lows, highs = _first_cells(lows, highs)
        bounds, (_, values), places, sides = _least_in(ranges_of, lows, highs)
        # The outermost of several.
        k = np.lexsort((-places[:, 0], values))[0]
        if values[k] < found:
            found, place = float(values[k]), places[k]
        left = (bounds < min(enough, found - within)) & (lows < highs).any(axis=1)
        if not left.any() or left.sum() > MOST_OPEN:
            break
        lows, highs = _halved_along(sides[left], lows[left], highs[left])
    return found, place


def first_below(
    ranges_of: Callable[[Array, Array], Sequence[Range]], low: Sequence[float], high: Sequence[float], level: float,
    within: float,
) -> float:  # fmt: skip
    """Return the smallest first coordinate of a box where a function is below a level, or the box's end.

    Parameters
    ----------
    ranges_of, low, high
        As in `least`.
    level : float
    within : float
        Largest relative error of the coordinate.
    """
    lows, highs, first, end = np.array([low], np.float64), np.array([high], np.float64), float(low[0]), float(high[0])
    for _ in range(HALVINGS * len(low)):
        lows, highs = _first_cells(lows, highs)
        bounds, (values, _), places, sides = _least_in(ranges_of, lows, highs, narrows=True)
        # Within rounding, smaller cells would not help.
        end = float(np.min(places[values < level, 0], initial=end))
        left = (bounds < level) & (lows[:, 0] < end)
        if not left.any():
            return end
        lows, highs, sides = lows[left], highs[left], sides[left]
        first = float(lows[:, 0].min())
        if first >= end * (1.0 - within):
            break
        inmost = np.argsort(lows[:, 0], kind="stable")
        end = min(end, float(np.min(lows[inmost[MOST_OPEN:], 0], initial=end)))
        inmost = inmost[:MOST_OPEN]
        lows, highs = _halved_along(sides[inmost], lows[inmost], highs[inmost])
    return first


def _least_in(
    ranges_of: Callable[[Array, Array], Sequence[Range]], lows: Array, highs: Array, narrows: bool = False
) -> tuple[Array, Range, Array, NDArray[np.intp]]:
    """Return lower bounds of a function in cells, ranges of its values at points, the points, and the sides to halve.

    Along a monotonic coordinate, the point lies on the cell's side with the smaller value. Otherwise the function falls
    from the middle by at most half the side times its largest derivative (mean value form).

    Parameters
    ----------
    ranges_of
        As in `least`.
    lows, highs : (n, d) float64
    narrows : bool
        Shorten the first side even if the function is monotonic along it.
    """
    values, *rates = ranges_of(lows, highs)
    least_rate, most_rate = (np.stack([rate[end] for rate in rates], axis=-1) for end in (0, 1))
    rises, falls = least_rate >= 0.0, most_rate <= 0.0
    places = np.where(rises, lows, np.where(falls, highs, 0.5 * (lows + highs)))
    (low, high), *_ = ranges_of(places, places)
    with np.errstate(invalid="ignore"):
        changes = 0.5 * (highs - lows) * np.maximum(-least_rate, most_rate)
        off = np.where(rises | falls, 0.0, changes)
        # NaN if a derivative is unbounded.
        bounds = np.fmax(values[0], low - off.sum(axis=-1))
    if narrows:
        off[:, 0] = changes[:, 0]
    known = np.isfinite(off).all(axis=-1, keepdims=True)
    sides = np.where(lows < highs, np.where(known, off, highs - lows), -1.0).argmax(axis=-1)
    return bounds, (low, high), places, sides


def _first_cells(low: Array, high: Array) -> tuple[Array, Array]:
    """Halve boxes until there are at least `FIRST_CELLS`."""
    while len(low) < FIRST_CELLS and (low < high).any():
        low, high = _halved(low, high)
    return low, high


def _halved(low: Array, high: Array) -> tuple[Array, Array]:
    """Halve boxes along all sides of nonzero length."""
    for side in np.flatnonzero((low < high).any(axis=0)):
        middle = 0.5 * (low[:, side] + high[:, side])
        low, high = np.concatenate([low, low]), np.concatenate([high, high])
        low[len(middle) :, side] = high[: len(middle), side] = middle
    return low, high


def _halved_along(sides: NDArray[np.intp], low: Array, high: Array) -> tuple[Array, Array]:
    """Halve each box along one side."""
    rows = np.arange(len(low))
    middle = 0.5 * (low + high)[rows, sides]
    low, high = np.concatenate([low, low]), np.concatenate([high, high])
    low[len(rows) + rows, sides] = high[rows, sides] = middle
    return low, high


def times(*factors: Range) -> Range:
    """Return the ranges of products of independent factors."""
    low, high = factors[0]
    for other in factors[1:]:
        with np.errstate(invalid="ignore"):
            corners = np.stack(np.broadcast_arrays(*(a * b for a, b in product((low, high), other))))
        # A factor that may vanish times an unbounded one.
        corners[np.isnan(corners)] = 0.0
        low, high = corners.min(axis=0), corners.max(axis=0)
    return low, high


def plus(*terms: Range) -> Range:
    """Return the ranges of sums of independent terms, with a margin for rounding; unbounded where unknown."""
    with np.errstate(invalid="ignore"):
        low, high = (
            np.asarray(sum(term[end] + sense * ROUNDING * np.abs(term[end]) for term in terms))
            for end, sense in ((0, -1.0), (1, 1.0))
        )
    # Terms unbounded on the side concerned.
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)


def scaled(factor: float, each: Range) -> Range:
    """Return ranges multiplied by a constant."""
    return (factor * each[0], factor * each[1]) if factor >= 0.0 else (factor * each[1], factor * each[0])


def squared(each: Range) -> Range:
    """Return the ranges of squares."""
    one, other = each[0] * each[0], each[1] * each[1]
    return np.where((each[0] < 0.0) & (each[1] > 0.0), 0.0, np.minimum(one, other)), np.maximum(one, other)


def quotient(each: Range, divisor: Range) -> Range:
    """Return the ranges of quotients; unbounded where the divisor may vanish."""
    divides = (divisor[0] > 0.0) | (divisor[1] < 0.0)
    low, high = times(each, (1.0 / np.where(divides, divisor[1], 1.0), 1.0 / np.where(divides, divisor[0], 1.0)))
    return np.where(divides, low, -np.inf), np.where(divides, high, np.inf)


def overlap(one: Range, other: Range) -> Range:
    """Return the intersection of two ranges of the same quantity; NaN is no bound."""
    return np.fmax(one[0], other[0]), np.fmin(one[1], other[1])


def known_where(known: NDArray[np.bool_], each: Sequence[Array]) -> Range:
    """Return ranges, unbounded where they are unknown."""
    return np.where(known, each[0], -np.inf), np.where(known, each[1], np.inf)


def profile_range(curvature: Range, conic: float, powers: Sequence[tuple[int, float]], r: Range, order: int) -> Range:
    """Return the ranges of a profile's sag, or of one of its derivatives, over intervals of the radius.

    Each term is monotonic in the radius. The sag and slope of the conic also grow with its curvature.

    Parameters
    ----------
    curvature : (n,) float64 each, 1/mm
        Of one sign.
    conic : float
    powers : sequence of (int, float)
        Exponents of the radius and their coefficients.
    r : (n,) float64 each, mm
    order : int
        SAG, SLOPE, ACROSS, ALONG, or a rate of the last two.
    """
    q = 1.0 + conic
    with np.errstate(divide="ignore"):
        if order in (SAG, SLOPE):
            corners = []
            for c, at in product(curvature[:1] if curvature[0] is curvature[1] else curvature, r):
                root = np.sqrt(np.maximum(1.0 - q * (c * at) ** 2, 0.0))
                corners.append(
                    c * at * at / (1.0 + root) if order == SAG else times((c * at,) * 2, (1.0 / root,) * 2)[0]
                )
            terms = [(np.min(corners, axis=0), np.max(corners, axis=0))]
        else:
            inner = np.minimum(np.abs(curvature[0]), np.abs(curvature[1])) * r[0]
            outer = np.maximum(np.abs(curvature[0]), np.abs(curvature[1])) * r[1]
            root_power, of_rate = {ACROSS: (1, 0), ALONG: (3, 0), ACROSS_RATE: (3, 1), ALONG_RATE: (5, 3)}[order]
            one, other = (np.sqrt(np.maximum(1.0 - q * at * at, 0.0)) ** root_power for at in (inner, outer))
            parts: list[Range] = [curvature, (1.0 / np.maximum(one, other), 1.0 / np.minimum(one, other))]
            if of_rate:
                # c² r, as |c| times |c| r.
                least_size, most_size = np.sort(np.abs(curvature), axis=0)
                parts.append(scaled(of_rate * q, times((least_size, most_size), (inner, outer))))
            terms = [times(*parts)]
    if not powers:
        return plus(*terms)
    exponents, coefficients = np.array(powers).T
    across = exponents * (exponents - 2.0)
    factors = coefficients * (
        np.ones_like(exponents), exponents, exponents, exponents * (exponents - 1.0),
        across, across * (exponents - 1.0),
    )[order]  # fmt: skip
    inner, outer = (at[:, None] ** (exponents - (0.0, 1.0, 2.0, 2.0, 3.0, 3.0)[order]) for at in r)
    slack = ROUNDING * (outer @ np.abs(factors))
    rising, falling = np.maximum(factors, 0.0), np.minimum(factors, 0.0)
    return plus(*terms, (inner @ rising + outer @ falling - slack, outer @ rising + inner @ falling + slack))


def meridian_ranges(
    curvature: float, conic: float, powers: Sequence[tuple[int, float]], height: Range
) -> tuple[Range, Range, Range]:
    """Return bounds of a profile's sag at heights of either sign, and of its first and second derivative.

    Parameters
    ----------
    curvature : float, 1/mm
    conic, powers
        As in `profile_range`.
    height : (n,) float64 each, mm
        Unbounded heights give unbounded results.
    """

    def range_of(r: Range, order: int) -> Range:
        return profile_range((np.full_like(r[0], curvature),) * 2, conic, powers, r, order)

    return on_meridian(range_of, height)


def on_meridian(range_of: Callable[[Range, int], Range], height: Range) -> tuple[Range, Range, Range]:
    """Return bounds of a profile at heights of either sign, and of its first and second derivative.

    Parameters
    ----------
    range_of : callable
        Returns the ranges of SAG, SLOPE or ALONG over intervals of the radius.
    height : (n,) float64 each, mm
        Unbounded heights give unbounded results.
    """
    known = np.isfinite(height[0]) & np.isfinite(height[1])
    crosses = (height[0] < 0.0) & (height[1] > 0.0)
    ends = np.abs(np.where(known, height, 0.0))
    r = np.where(crosses, 0.0, ends.min(axis=0)), ends.max(axis=0)
    sag, slope, bend = (range_of(r, order) for order in (SAG, SLOPE, ALONG))
    # The slope is odd.
    mirrored = scaled(-1.0, slope)
    rise = (
        np.where(crosses, np.minimum(slope[0], mirrored[0]), np.where(height[1] > 0.0, slope[0], mirrored[0])),
        np.where(crosses, np.maximum(slope[1], mirrored[1]), np.where(height[1] > 0.0, slope[1], mirrored[1])),
    )
    return known_where(known, sag), known_where(known, rise), known_where(known, bend)


def revolved_bends(
    curvature: float, conic: float, powers: Sequence[tuple[int, float]], x: Range, y: Range
) -> list[Range]:  # fmt: skip
    """Return bounds of a surface of revolution z(r) and of its derivatives by x, by y, by x twice, by both, by y twice.

    Parameters
    ----------
    curvature : float, 1/mm
    conic, powers
        As in `profile_range`.
    x, y : (n,) float64 each, mm
        Finite.
    """

    def range_of(r: Range, order: int) -> Range:
        return profile_range((np.full_like(r[0], curvature),) * 2, conic, powers, r, order)

    return in_plane(range_of, x, y)


def in_plane(range_of: Callable[[Range, int], Range], x: Range, y: Range) -> list[Range]:
    """Return bounds of a profile of revolution and of its derivatives by x, by y, by x twice, by both, by y twice.

    Parameters
    ----------
    range_of : callable
        Returns the ranges of SAG, ACROSS or ALONG over intervals of the radius.
    x, y : (n,) float64 each, mm
        Finite.
    """
    x2, y2 = squared(x), squared(y)
    r2 = plus(x2, y2)
    r = np.sqrt(np.maximum(r2[0], 0.0)), np.sqrt(r2[1])
    sag, across, along = (range_of(r, order) for order in (SAG, ACROSS, ALONG))
    more = plus(along, scaled(-1.0, across))
    with np.errstate(invalid="ignore"):
        # Fractions of x² and y² in r².
        in_x, in_y = (
            (np.nan_to_num(one[0] / (one[0] + other[1]), nan=0.0), np.nan_to_num(one[1] / (one[1] + other[0]), nan=1.0))
            for one, other in ((x2, y2), (y2, x2))
        )
    both = overlap(quotient(times(x, y), r2), (np.full_like(r[0], -0.5), np.full_like(r[0], 0.5)))
    return [sag, times(x, across), times(y, across), plus(across, times(more, in_x)), times(more, both),
            plus(across, times(more, in_y))]  # fmt: skip


def profile_extremes(
    curvatures: Sequence[float], conic: float, powers: Sequence[tuple[int, float]], radius: float,
    orders: Sequence[int], within: float,
) -> tuple[float, float]:  # fmt: skip
    """Return bounds of the minimum and maximum, inside a radius, of a profile's sag or of its derivatives.

    Parameters
    ----------
    curvatures : (2,) float, 1/mm
        Limits of a range of curvatures of one sign.
    conic, powers
        As in `profile_range`.
    radius : float, mm
        The profile must reach it.
    orders : sequence of int
        Of SAG, SLOPE, ACROSS and ALONG.
    within : float
        As in `extremes`.
    """

    def cells_in(low: Array, high: Array) -> tuple[Range, Range]:
        """Return the ranges in cells, narrowed by their derivatives, and the smaller and larger value at the ends."""
        (inner, outer), curvature = (low[:, 0], high[:, 0]), (low[:, 1], high[:, 1])
        cells, values = [], []
        for order in orders:
            lows, highs = (each.reshape(3, -1) for each in profile_range(
                (np.tile(curvature[0], 3), np.tile(curvature[1], 3)), conic, powers,
                (np.concatenate([inner, inner, outer]), np.concatenate([outer, inner, outer])), order,
            ))  # fmt: skip
            least_rate, most_rate = profile_range(curvature, conic, powers, (inner, outer), RATES[order])
            cells.append((
                np.fmax(lows[0], _between_ends(lows[1], lows[2], least_rate, most_rate, outer - inner)),
                np.fmin(highs[0], -_between_ends(-highs[1], -highs[2], -most_rate, -least_rate, outer - inner)),
            ))  # fmt: skip
            values.append((highs[1:].min(axis=0), lows[1:].max(axis=0)))
        (cells_low, cells_high), (least, most) = (zip(*each, strict=True) for each in (cells, values))
        return (
            (np.min(cells_low, axis=0), np.max(cells_high, axis=0)), (np.min(least, axis=0), np.max(most, axis=0)),
        )  # fmt: skip

    return _extremes(cells_in, [0.0, min(curvatures)], [radius, max(curvatures)], within)


def _between_ends(at_inner: Array, at_outer: Array, least_rate: Array, most_rate: Array, length: Array) -> Array:
    """Return lower bounds of a function between two points, from its values there and its derivative's range.

    It lies above the lines through its ends with the extreme slopes. NaN if unbounded.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        cross = (at_inner - at_outer + most_rate * length) / (most_rate - least_rate)
        place = np.where((least_rate < 0.0) & (most_rate > 0.0), cross, np.where(least_rate >= 0.0, 0.0, length))
        place = np.clip(place, 0.0, length)
        return np.maximum(at_inner + least_rate * place, at_outer - most_rate * (length - place))
