"""Integrals over a disk of functions that are smooth inside a region and zero outside it, with an error estimate.

An example is a ghost's light over the pupil, cut off by apertures and the sensor's edges. Cells at the edge are
subdivided; in the smallest ones the edge is a straight line between its crossings with their sides, found by bisection.
"""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Function = Callable[[Array], Array]

CELLS = 64
"""Cells along each side of the initial square grid round the disk."""

HALVINGS = 4
"""Number of divisions of a cell at an edge."""

SEARCHES = 5
"""Halvings of a dark cell's side in the search for light between two kinds of darkness."""

BISECTIONS = 10
"""Bisections that locate the crossing of an edge with a cell's side."""

BEYOND = 0.75
"""Place of the test for a square corner of the edge: fraction of the way to it from the cell's corner."""

SHIFT = (0.37, 0.61)
"""Offset of the cells from the square, in cells: keeps a symmetric function from repeating one error everywhere."""

SMOOTH = 0.1
"""Largest relative spread of a cell's values; cells with more are subdivided like those at an edge."""

HIDDEN = -1e9
"""Value where a shade hides light; it differs from all other negative values."""

_CORNERS = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
"""Corners of a cell, in order round it."""


class Integral(NamedTuple):
    """Value of an integral, with its estimated error."""

    value: float
    error: float


class Shade(Protocol):
    """Region with a known sharp outline where a function is zero.

    Attributes
    ----------
    edges : (k, 2, 2) float64
        Segments that cover the outline.
    """

    @property
    def edges(self) -> Array:
        """(k, 2, 2) float64: segments that cover the outline."""

    def hides(self, at_mm: Array) -> NDArray[np.bool_]:
        """Tell which points (n, 2) are in the region."""


def integral(function: Function, radius: float, shade: Shade | None = None) -> Integral:
    """Integrate over a disk about the origin a function that is positive in part of it.

    Elsewhere its value is a negative number that names the kind of darkness, such as the edge where rays end. A lit
    region narrower than the first cells is found if these numbers differ on its two sides and it is wider than 1/32 of
    a cell; otherwise it may be missed. Light found between the points of the smallest cells counts as error.

    Cells inside the region combine the trapezoidal and midpoint rules, weighted 1 : 2; a third of their difference
    counts as error. At the edge the error is the total change in the last subdivision, plus the root of the sum of
    squares of the changes per cell, plus the remainder of bisection.

    Parameters
    ----------
    function : callable
        Maps points (n, 2) to values (n,), as above.
    radius : float
        Radius of the disk.
    shade : Shade, optional
        Region where the function counts as zero. Cells at its outline are subdivided. If all corners of a smallest one
        are alike, the light at its middle counts as error.
    """
    whole = function
    if shade is not None:
        function = _shaded(function, shade)
    cells = np.stack(np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"), axis=-1).reshape(-1, 2)
    value, within = 0.0, 0.0
    parts_before = np.zeros(0)
    first = 2.0 * radius / (CELLS - 1)
    origin = -radius - first * np.array(SHIFT)
    searched = followed = np.ones(len(cells), bool)
    there: list[NDArray[np.int64]] = []
    asleep: list[NDArray[np.int64]] = []
    for halving in range(HALVINGS + 1):
        side = first / (1 << halving)
        seen = _look(function, cells, searched, side, origin)
        while len(woken := _woken(seen, there, asleep)) > 0:
            more = _halved(woken)
            seen = _joined(seen, _look(function, more, np.ones(len(more), bool), side, origin))
            followed = np.append(followed, np.zeros(len(more), bool))
            parts_before = np.append(parts_before, np.zeros(len(woken)))
        cells, corners, kinds, between = seen
        lit = (corners > 0.0).sum(axis=1)
        least, most = corners.min(axis=1), corners.max(axis=1)
        outlined = _crossed(cells, shade.edges, side, origin) if shade is not None else np.zeros(len(cells), bool)
        rough = outlined | (between > 0.0) | ((lit > 0) & ((lit < 4) | (most - least > SMOOTH * most)))
        smooth = np.flatnonzero((lit == 4) & ~rough)
        middles = function((cells[smooth] + 0.5) * side + origin)
        # A hole inside the cell is an edge, too.
        rough[smooth[middles <= 0.0]] = True
        smooth, middles = smooth[middles > 0.0], middles[middles > 0.0]
        mean = corners[smooth].mean(axis=1)
        parts = np.zeros(len(cells))
        parts[smooth] = side * side * (2.0 * middles + mean) / 3.0
        value += float(parts.sum())
        within += side * side * float(np.abs(middles - mean).sum()) / 3.0
        if halving >= HALVINGS - 1:
            parts[rough] = side * side * _along_edge(function, cells[rough], corners[rough], side, origin)
        if halving == HALVINGS:
            off = parts.reshape(-1, 4).sum(axis=1) - parts_before
            edge = abs(float(off.sum())) + float(np.sqrt((off * off).sum()))
            blur = side * side * float(most[rough].sum()) / (1 << BISECTIONS)
            alike = cells[outlined & ((lit == 0) | (lit == 4))]
            inside = np.maximum(whole((alike + 0.5) * side + origin), 0.0) if len(alike) else np.zeros(0)
            unseen = side * side * float(between.sum() + inside.sum())
            return Integral(value + float(parts[rough].sum()), within + edge + blur + unseen)
        # Where three kinds of darkness meet, there may be light that no side of the cell crosses.
        knots = followed & (kinds > 2)
        divided = rough | knots | _beside_lit(cells, lit)
        there.append(np.sort(_names(cells)))
        asleep.append(np.sort(_names(cells[(lit == 0) & ~divided])))
        parts_before = parts[divided]
        searched, followed = np.repeat(rough[divided], 4), np.repeat(knots[divided], 4)
        cells = _halved(cells[divided])
    raise AssertionError


def _shaded(function: Function, shade: Shade) -> Function:
    """Return the function with the light that a shade hides set to `HIDDEN`."""

    def shaded(at: Array) -> Array:
        values = function(at)
        lit = np.flatnonzero(values > 0.0)
        values[lit[shade.hides(at[lit])]] = HIDDEN
        return values

    return shaded


def _crossed(cells: Cells, segments: Array, side: float, origin: Array) -> NDArray[np.bool_]:
    """Tell which cells a segment (k, 2, 2) crosses."""
    # A piece no longer than a cell lies in the four cells given by the rows and columns of its ends.
    ends = (segments - origin) / side
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pieces = np.ceil(length).astype(np.int64).clip(min=1)
    which = np.repeat(np.arange(len(ends)), pieces)
    number = np.arange(len(which)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    half = 0.5 * (ends[which, 1] - ends[which, 0]) / pieces[which, None]
    middle = ends[which, 0] + (2 * number + 1)[:, None] * half
    places = np.stack([np.floor(middle - half), np.floor(middle + half)], axis=1)
    found = []
    for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
        cell = np.column_stack([places[:, row, 0], places[:, column, 1]])
        off = middle - cell - 0.5
        # Separating axes: the two sides of the cell, and the normal of the piece.
        meets = (np.abs(off) <= 0.5 + np.abs(half)).all(axis=1)
        meets &= np.abs(off[:, 0] * half[:, 1] - off[:, 1] * half[:, 0]) <= 0.5 * np.abs(half).sum(axis=1)
        inside = meets & (cell >= 0).all(axis=1) & (cell < 1 << 30).all(axis=1)
        found.append(_names(cell[inside].astype(np.int64)))
    return _among(_names(cells), np.unique(np.concatenate(found)))


class _Seen(NamedTuple):
    """Cells of one size, with their values."""

    cells: Cells  # (n, 2) row and column; except at the largest size, the four quarters of a cell are consecutive
    corners: Array  # (n, 4) values at their corners, in order round the cell; 0 where dark
    kinds: NDArray[np.int64]  # (n,) number of kinds of darkness at the corners of a dark cell; 0: not dark
    between: Array  # (n,) largest value found on the sides of a dark cell; 0: none


def _look(function: Function, cells: Cells, searched: NDArray[np.bool_], side: float, origin: Array) -> _Seen:
    """Evaluate a function at the corners of cells, and search the sides of the marked cells with mixed darkness."""
    corners = _at_corners(function, cells, side, origin)
    kinds = np.where((corners <= 0.0).all(axis=1), _kinds(corners), 0)
    between = _between_dark(function, cells, corners, searched & (kinds > 1), side, origin)
    return _Seen(cells, np.maximum(corners, 0.0), kinds, between)


def _joined(one: _Seen, other: _Seen) -> _Seen:
    return _Seen(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def _halved(cells: Cells) -> Cells:
    """Return the four quarters of each cell, cell by cell."""
    return np.asarray((2 * cells[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2))


def _names(cells: Cells) -> NDArray[np.int64]:
    """Return a unique number for each cell, from its row and column."""
    return np.asarray(((cells[:, 0] + 1) << 32) + cells[:, 1] + 1)


def _among(names: NDArray[np.int64], known: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which names occur in an ascending array."""
    if len(known) == 0:
        return np.zeros(len(names), bool)
    return np.asarray(known[np.searchsorted(known, names).clip(max=len(known) - 1)] == names)


def _woken(seen: _Seen, there: list[NDArray[np.int64]], asleep: list[NDArray[np.int64]]) -> Cells:
    """Return the cells of twice the size that were left as dark but that the lit region reaches after all.

    Parameters
    ----------
    seen : _Seen
    there, asleep : list of (m,) int64
        Names, ascending, of all cells and of those left as dark, for each size from the largest to twice that of
        `seen`.
    """
    if not there:
        return np.zeros((0, 2), np.int64)
    lit = seen.cells[(seen.kinds == 0) | (seen.between > 0.0)]
    # Of a cell's eight neighbours, the diagonal ones lie in all cells of twice the size that it touches.
    touched = (lit[:, None] + [[-1, -1], [-1, 1], [1, -1], [1, 1]]).reshape(-1, 2) >> 1
    names = np.setdiff1d(np.unique(_names(touched)), _names(seen.cells[::4] >> 1), assume_unique=True)
    parents = np.stack([(names >> 32) - 1, (names & 0xFFFFFFFF) - 1], axis=-1)
    wakes, open_ = np.zeros(len(parents), bool), np.ones(len(parents), bool)
    for up, (all_of_them, dark) in enumerate(zip(reversed(there), reversed(asleep), strict=True)):
        # The smallest cell that contained it has its latest state.
        names = _names(parents >> up)
        held = open_ & _among(names, all_of_them)
        wakes |= held & _among(names, dark)
        open_ &= ~held
    return np.asarray(parents[wakes])


def _kinds(corners: Array) -> NDArray[np.int64]:
    """Return the number of different corner values of each cell, (n,)."""
    ranked = np.sort(corners, axis=1)
    return np.asarray(1 + (ranked[:, 1:] != ranked[:, :-1]).sum(axis=1))


def _between_dark(
    function: Function, cells: Cells, corners: Array, searched: NDArray[np.bool_], side: float, origin: Array
) -> Array:
    """Search for light on the sides of dark cells with several kinds of darkness.

    Parameters
    ----------
    cells : (n, 2) int64
    corners : (n, 4) float64
        Values at their corners, in order round the cell.
    searched : (n,) bool
        Cells to search.

    Returns
    -------
    value : (n,) float64
        Largest value found on the sides of each cell; 0: none, or not searched.
    """
    value, mixed = np.zeros(len(cells)), np.flatnonzero(searched)
    if len(mixed) == 0:
        return value
    ends = cells[mixed][:, None] + _CORNERS
    # Shared sides are searched once: each is named by its lower end and its direction.
    low, high = np.minimum(ends, np.roll(ends, -1, axis=1)), np.maximum(ends, np.roll(ends, -1, axis=1))
    width = int(high.max()) + 1
    name = 2 * (low[..., 0] * width + low[..., 1]) + (high[..., 0] > low[..., 0])
    differ = corners[mixed] != np.roll(corners[mixed], -1, axis=1)
    _, first, place = np.unique(name[differ], return_index=True, return_inverse=True)
    a, b = ends[differ][first].astype(float), np.roll(ends, -1, axis=1)[differ][first].astype(float)
    at_a, found = corners[mixed][differ][first], np.zeros(len(first))
    for _ in range(SEARCHES):
        middle = 0.5 * (a + b)
        here = function(middle * side + origin)
        found = np.maximum(found, here)
        same = (here == at_a)[:, None]
        a, b = np.where(same, middle, a), np.where(same, b, middle)
    of_sides = np.zeros(differ.shape)
    of_sides[differ] = found[place]
    value[mixed] = of_sides.max(axis=1)
    return value


def _beside_lit(cells: Cells, lit: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which cells without a lit corner adjoin a cell with one: the lit region may reach into them."""
    size = int(cells.max(initial=0)) + 3
    seen = np.zeros((size, size), bool)
    seen[tuple((cells[lit > 0] + 1).T)] = True
    around = np.zeros(len(cells), bool)
    for step in ((0, 1), (1, 0), (1, 2), (2, 1)):
        around |= seen[tuple((cells + step).T)]
    return around & (lit == 0)


def _at_corners(function: Function, cells: Cells, side: float, origin: Array) -> Array:
    """Return the values at the four corners of each cell, (n, 4); shared corners are evaluated once."""
    corners = cells[:, None] + _CORNERS
    width = int(corners.max(initial=0)) + 1
    nodes, place = np.unique(corners[..., 0] * width + corners[..., 1], return_inverse=True)
    values = function(np.stack(np.divmod(nodes, width), axis=-1) * side + origin)
    return np.asarray(values[place.reshape(-1, 4)])


def _along_edge(function: Function, cells: Cells, corners: Array, side: float, origin: Array) -> Array:
    """Return the lit area of cells at an edge, in cells, times the mean of their lit corners, (n,).

    Parameters
    ----------
    cells : (n, 2) int64
    corners : (n, 4) float64
        Values at their corners, in order round the cell.
    """
    lit = corners > 0.0
    follows = np.roll(lit, -1, axis=1)
    crossed = lit != follows
    # Slots of a polygon: each corner, followed by the edge's crossing with the side to the next corner.
    slots = np.zeros((len(cells), 8, 2))
    slots[:, 0::2] = _CORNERS
    valid = np.zeros((len(cells), 8), bool)
    valid[:, 0::2], valid[:, 1::2] = lit, crossed
    cell, number = np.nonzero(crossed)
    inner, outer = _CORNERS[number].astype(float), _CORNERS[(number + 1) % 4].astype(float)
    inner, outer = np.where(lit[cell, number][:, None], (inner, outer), (outer, inner))
    for _ in range(BISECTIONS):
        between = 0.5 * (inner + outer)
        inside = (function((cells[cell] + between) * side + origin) > 0.0)[:, None]
        inner, outer = np.where(inside, between, inner), np.where(inside, outer, between)
    slots[cell, 2 * number + 1] = 0.5 * (inner + outer)
    bulge = _square_corners(function, cells, lit, slots, side, origin)
    # A missing slot repeats the one before it, which adds no area.
    for slot in range(15):
        gone = ~valid[:, (slot + 1) % 8] & valid[:, slot % 8]
        slots[gone, (slot + 1) % 8] = slots[gone, slot % 8]
        valid[gone, (slot + 1) % 8] = True
    x, y = slots[..., 0], slots[..., 1]
    area = 0.5 * np.abs((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))
    area += bulge
    return np.asarray(area * corners.sum(axis=1) / np.maximum(lit.sum(axis=1), 1))


def _square_corners(
    function: Function, cells: Cells, lit: NDArray[np.bool_], slots: Array, side: float, origin: Array
) -> Array:
    """Return the area, in cells, that a square corner of the region adds to a straight edge across each cell, (n,).

    If one corner differs from the three others, the edge may run straight on from both crossings, as at the corner of a
    sensor.
    """
    bulge = np.zeros(len(cells))
    odd_is_lit = lit.sum(axis=1) == 1
    single = np.flatnonzero(odd_is_lit | (lit.sum(axis=1) == 3))
    corner = np.argmax(lit[single] == odd_is_lit[single, None], axis=1)
    at = _CORNERS[corner]
    one, other = slots[single, 2 * corner + 1] - at, slots[single, (2 * corner - 1) % 8] - at
    between = at + BEYOND * (one + other)
    fills = (function((cells[single] + between) * side + origin) > 0.0) == odd_is_lit[single]
    triangle = 0.5 * np.abs(one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0])
    bulge[single] = np.where(odd_is_lit[single], 1.0, -1.0) * np.where(fills, triangle, 0.0)
    return bulge
