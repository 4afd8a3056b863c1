"""The relief of lenslets over a plane: height and slope at points; at the borders of cells means of a small box."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import cell_of, centre, is_inside
from lfmesh.geometry.array.lenslets import Lenslets, face_normal, face_sag, shape_of
from lfmesh.kernels.decorators import inlined, kernel

Array = NDArray[np.float64]

PARTS = 8
"""Points along each side of a box that a border crosses."""


@kernel
def fill_relief(mla: Lenslets, x: Array, y: Array, box: float, relief: Array) -> None:
    """Fill in the relief of lenslets at points of the array's frame.

    Parameters
    ----------
    mla : Lenslets
    x, y : (n,) float64, mm
    box : float, mm
        Side of the square about each point that is averaged over, where it is not all of one cell.
    relief : (4, n) float64
        Sag in mm, dz/dx and dz/dy, of the clear part of the box: on the array, on no mask; and its share. All are 0
        where no part is clear.
    """
    half = 0.5 * box
    for i in range(len(x)):
        column, row = cell_of(mla.lattice, x[i], y[i])
        whole = True
        for corner in range(4):
            sx, sy = half if corner & 1 else -half, half if corner & 2 else -half
            other_column, other_row = cell_of(mla.lattice, x[i] + sx, y[i] + sy)
            whole = whole and other_column == column and other_row == row
        whole = whole and not _near_mask(mla.clear_radius, mla, column, row, x[i], y[i], box)
        parts = 1 if whole else PARTS
        for part in range(parts * parts):
            px = x[i] + box * ((part % parts + 0.5) / parts - 0.5)
            py = y[i] + box * ((part // parts + 0.5) / parts - 0.5)
            _add(mla, px, py, 1.0 / (parts * parts), relief, i)
        if relief[3, i] > 0.0:
            for quantity in range(3):
                relief[quantity, i] /= relief[3, i]


@inlined
def _add(mla: Lenslets, x: float, y: float, share: float, relief: Array, i: int) -> None:
    """Add a share of the relief at a point, if it is clear."""
    column, row = cell_of(mla.lattice, x, y)
    if not is_inside(mla.lattice, column, row):
        return
    cx, cy = centre(mla.lattice, column, row)
    if not _is_clear(mla.clear_radius, x - cx, y - cy):
        return
    curvature, ex, ey = shape_of(mla, column, row)
    dx, dy = x - cx - ex, y - cy - ey
    sag = face_sag(mla, column, row, curvature, dx, dy)
    nx, ny, nz = face_normal(mla, column, row, curvature, dx, dy, sag)
    relief[0, i] += share * sag
    relief[1, i] -= share * nx / nz
    relief[2, i] -= share * ny / nz
    relief[3, i] += share


@inlined
def _near_mask(clear_radius: Any, mla: Lenslets, column: int, row: int, x: float, y: float, box: float) -> bool:
    """Tell whether the border of a cell's clear aperture may cross the box about a point."""
    if clear_radius is None:
        return False
    cx, cy = centre(mla.lattice, column, row)
    return bool(abs(np.hypot(x - cx, y - cy) - clear_radius) < box)


@inlined
def _is_clear(clear_radius: Any, x: float, y: float) -> bool:
    """Tell whether a lenslet is clear at a point, from the centre of its cell."""
    if clear_radius is None:
        return True
    return bool(x * x + y * y <= clear_radius * clear_radius)
