"""Integrals over a disk of functions that are smooth within a region and zero outside it, to a stated error.

A ghost's light over the pupil is such a function: apertures and the sensor's edges cut it off. Cells within the region
are integrated by points; cells that its edge crosses are divided again and again. In the smallest ones the edge is a
line between the points at which it crosses their sides, which are found by bisection.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]
Function = Callable[[Array], Array]

CELLS = 64
"""Cells along a side of the square round the disk at first. A region narrower than one of them may be missed."""

HALVINGS = 4
"""How often cells at an edge are divided."""

BISECTIONS = 10
"""Of the side of a cell, to find where an edge crosses it."""

BEYOND = 0.75
"""From a corner of a cell to the corner that the edge has if it is square: that it is is tested here."""

SHIFT = (0.37, 0.61)
"""Of the cells against the square, in cells: what is symmetric must not make the same error everywhere."""

SMOOTH = 0.1
"""Cells whose values differ by more than this share of the largest are divided like those at an edge."""

_CORNERS = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
"""Of a cell, in their order round it."""


class Integral(NamedTuple):
    """An integral, and how far it may be off."""

    value: float
    error: float


def integral(function: Function, radius: float) -> Integral:
    """Integrate a function that is not negative and zero outside a disk about the origin.

    The error that is stated is the sum of two: inside the region a third of the difference between the trapezoidal rule
    and the midpoint rule, whose mean weighted 1 : 2 is the result; along the edge what the last halving of the cells
    there changes, in all, and the root of the sum of squares of what it changes in each, and what bisection leaves
    open.

    Parameters
    ----------
    function : callable
        Maps points (n, 2) to values (n,).
    radius : float
        Of the disk.
    """
    cells = np.stack(np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"), axis=-1).reshape(-1, 2)
    value, within = 0.0, 0.0
    parts_before = np.zeros(0)
    first = 2.0 * radius / (CELLS - 1)
    origin = -radius - first * np.array(SHIFT)
    for halving in range(HALVINGS + 1):
        side = first / (1 << halving)
        corners = _at_corners(function, cells, side, origin)
        lit = (corners > 0.0).sum(axis=1)
        least, most = corners.min(axis=1), corners.max(axis=1)
        rough = (lit > 0) & ((lit < 4) | (most - least > SMOOTH * most))
        smooth = np.flatnonzero((lit == 4) & ~rough)
        middles = function((cells[smooth] + 0.5) * side + origin)
        # A hole within the cell is an edge, too.
        rough[smooth[middles == 0.0]] = True
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
            return Integral(value + float(parts[rough].sum()), within + edge + blur)
        divided = rough | _beside_lit(cells, lit)
        parts_before = parts[divided]
        cells = (2 * cells[divided][:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
    raise AssertionError


def _beside_lit(cells: Cells, lit: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which cells without a lit corner have a neighbour with one: the lit region may reach into them."""
    size = int(cells.max(initial=0)) + 3
    seen = np.zeros((size, size), bool)
    seen[tuple((cells[lit > 0] + 1).T)] = True
    around = np.zeros(len(cells), bool)
    for step in ((0, 1), (1, 0), (1, 2), (2, 1)):
        around |= seen[tuple((cells + step).T)]
    return around & (lit == 0)


def _at_corners(function: Function, cells: Cells, side: float, origin: Array) -> Array:
    """Return the values at the four corners of each cell, (n, 4); corners that cells share are evaluated once."""
    corners = cells[:, None] + _CORNERS
    width = int(corners.max(initial=0)) + 1
    nodes, place = np.unique(corners[..., 0] * width + corners[..., 1], return_inverse=True)
    values = function(np.stack(np.divmod(nodes, width), axis=-1) * side + origin)
    return np.asarray(values[place.reshape(-1, 4)])


def _along_edge(function: Function, cells: Cells, corners: Array, side: float, origin: Array) -> Array:
    """Return the lit area of cells that an edge crosses, in cells, times the mean of their lit corners, (n,).

    Parameters
    ----------
    cells : (n, 2) int64
    corners : (n, 4) float64
        Values at their corners, in order round the cell.
    """
    lit = corners > 0.0
    follows = np.roll(lit, -1, axis=1)
    crossed = lit != follows
    # The slots of a polygon: each corner, and after it the place where the edge crosses the side to the next.
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
    # A slot that is not there repeats the one before it, which adds no area.
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
    """Return the area, in cells, that a corner of the region adds to a line across the corner of each cell, (n,).

    Where one corner of a cell differs from the three others, the edge may run straight on from both crossings, as at
    the corner of a sensor, and not from one to the other.
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
