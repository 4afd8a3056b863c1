"""Integrals over a square of functions that are smooth within a region and zero outside it, to a stated error.

A ghost's light over the pupil is such a function: apertures and the sensor's edges cut it off. Cells within the region
are integrated by points; cells that its edge crosses are divided again and again, so that the edge is followed.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

CELLS = 64
"""Cells along a side of the square at first. A region narrower than one of them may be missed."""

HALVINGS = 4
"""How often cells at an edge are divided."""

SHIFT = (0.37, 0.61)
"""Of the cells against the square, in cells: what is symmetric must not make the same error everywhere."""

SMOOTH = 0.1
"""Cells whose values differ by more than this share of the largest are divided like those at an edge."""


class Integral(NamedTuple):
    """An integral, and how far it may be off."""

    value: float
    error: float


def integral(function: Callable[[Array], Array], half_width: float) -> Integral:
    """Integrate a function that is not negative over the square from −half_width to half_width.

    The error that is stated is the sum of two: inside the region a third of the difference between the trapezoidal rule
    and the midpoint rule, whose mean weighted 1 : 2 is the result; along the edge the standard deviation of as many
    independent cells of the smallest size as it crosses, each filled to a share unknown from 0 to 1.

    Parameters
    ----------
    function : callable
        Maps points (n, 2) to values (n,).
    half_width : float
    """
    cells = np.stack(np.meshgrid(np.arange(CELLS), np.arange(CELLS), indexing="ij"), axis=-1).reshape(-1, 2)
    value, within, edge = 0.0, 0.0, 0.0
    first = 2.0 * half_width / (CELLS - 1)
    origin = -half_width - first * np.array(SHIFT)
    for halving in range(HALVINGS + 1):
        side = first / (1 << halving)
        corners = _at_corners(function, cells, side, origin)
        lit = (corners > 0.0).sum(axis=1)
        least, most = corners.min(axis=1), corners.max(axis=1)
        rough = (lit > 0) & ((lit < 4) | (most - least > SMOOTH * most))
        smooth = (lit == 4) & ~rough
        middles = function((cells[smooth] + 0.5) * side + origin)
        # A hole within the cell is an edge, too.
        holes = np.flatnonzero(smooth)[middles == 0.0]
        rough[holes], smooth[holes] = True, False
        middle, mean = middles[middles > 0.0], corners[smooth].mean(axis=1)
        value += side * side * float((2.0 * middle + mean).sum()) / 3.0
        within += side * side * float(np.abs(middle - mean).sum()) / 3.0
        if halving == HALVINGS:
            value += side * side * float(corners[rough].mean(axis=1).sum())
            edge = side * side * float(np.sqrt((most[rough] ** 2).sum() / 12.0))
            break
        cells = (2 * cells[rough][:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]).reshape(-1, 2)
    return Integral(value, within + edge)


def _at_corners(function: Callable[[Array], Array], cells: Cells, side: float, origin: Array) -> Array:
    """Return the values at the four corners of each cell, (n, 4); corners that cells share are evaluated once."""
    corners = cells[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]
    width = int(corners.max(initial=0)) + 1
    nodes, place = np.unique(corners[..., 0] * width + corners[..., 1], return_inverse=True)
    values = function(np.stack(np.divmod(nodes, width), axis=-1) * side + origin)
    return np.asarray(values[place.reshape(-1, 4)])
