"""Relief of the lenslets over a plane: height and slope at points, averaged over a small box at the borders of cells.

Cells may meet in a step. The mean height then says nothing about the wave, so the mean of the wave is kept too. The
phase of a diffractive face is treated like a height.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import cell_of, centre, is_inside
from lfmesh.geometry.array.lenslets import Lenslets, face_normal, face_sag, shape_of
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase_profiles import Phases, phase_at

Array = NDArray[np.float64]

POINTS, TURN = 89, 55
"""Points of a box that a border crosses: a Fibonacci lattice, with no two points in a row or column."""

CELLS = 4
"""Number of cells that a box may touch, as at the corner of squares. Points in further cells count towards the last."""

SUMS = 11
"""Quantities that are summed for each cell."""


@by_address
class FacePhase(NamedTuple):
    """Phase of one order of a diffractive face, the same about the apex of each lenslet.

    Attributes
    ----------
    phases : Phases
    number : int
        Number of the phase in the table.
    order : float
        Factor of the phase.
    """

    phases: Phases
    number: int
    order: float


@kernel
def fill_relief(
    mla: Lenslets, places: Array, box: float, per_mm: float, phase: Any, parts: Array, relief: Array
) -> None:  # fmt: skip
    """Write the relief of the lenslets at points in the array's frame.

    Parameters
    ----------
    mla : Lenslets
    places : (2, n) float64, mm
        x and y.
    box : float, mm
        Side of the square about each point that is averaged over, unless it lies in one cell.
    per_mm : float, rad/mm
        Phase that a wave gains per mm of height.
    phase : FacePhase or None
    parts : (CELLS, SUMS) float64
        Workspace for sums over the parts of a box in different cells.
    relief : (6, n) float64, or (9, n) with a phase
        For the clear part of the box (on the array, not on a mask): sag in mm; dz/dx and dz/dy; real and imaginary part
        of the transmitted wave over that of a whole box with this sag and phase; clear fraction; phase in rad and its
        derivatives by x and y, rad/mm. Sag and phase are means, moved along the slopes to the point. All are 0 if no
        part is clear.
    """
    half = 0.5 * box
    x, y = places[0], places[1]
    for i in range(len(x)):
        column, row = cell_of(mla.lattice, x[i], y[i])
        whole = True
        for corner in range(4):
            sx, sy = half if corner & 1 else -half, half if corner & 2 else -half
            other_column, other_row = cell_of(mla.lattice, x[i] + sx, y[i] + sy)
            whole = whole and other_column == column and other_row == row
        whole = whole and not _near_mask(mla, column, row, x[i], y[i], box)
        points = 1 if whole else POINTS
        parts[:] = 0.0
        for point in range(points):
            dx = box * ((point + 0.5) / points - 0.5)
            dy = box * ((point * TURN % points + 0.5) / points - 0.5)
            _add(mla, x[i], y[i], dx, dy, phase, parts)
        relief[:, i] = 0.0
        clear = parts[:, 0].sum()
        if clear == 0.0:
            continue
        sag, slope_x, slope_y = parts[:, 1].sum() / clear, parts[:, 2].sum() / clear, parts[:, 3].sum() / clear
        relief[0, i] = sag - (slope_x * parts[:, 4].sum() + slope_y * parts[:, 5].sum()) / clear
        relief[1, i], relief[2, i], relief[5, i] = slope_x, slope_y, clear / points
        gained = _mean_phase(phase, i, parts, clear, relief)
        for part in range(CELLS):
            share = parts[part, 0]
            if share > 0.0:
                ahead = per_mm * (parts[part, 1] / share - sag) + (parts[part, 8] / share - gained)
                relief[3, i] += share / points * np.cos(ahead)
                relief[4, i] += share / points * np.sin(ahead)


@inlined
def _mean_phase(phase: Any, i: int, parts: Array, clear: float, relief: Array) -> float:
    """Write the phase of a point and its derivatives; return its mean over the clear part of the box, rad."""
    if phase is None:
        return 0.0
    mean, by_x, by_y = parts[:, 8].sum() / clear, parts[:, 9].sum() / clear, parts[:, 10].sum() / clear
    relief[6, i] = mean - (by_x * parts[:, 4].sum() + by_y * parts[:, 5].sum()) / clear
    relief[7, i], relief[8, i] = by_x, by_y
    return mean


@inlined
def _add(mla: Lenslets, x: float, y: float, dx: float, dy: float, phase: Any, parts: Array) -> None:
    """Add a point of a box, if it is clear, to the sums of its cell.

    Parameters
    ----------
    mla : Lenslets
    x, y : float, mm
        Middle of the box.
    dx, dy : float, mm
        Vector from there to the point.
    phase : FacePhase or None
    parts : (CELLS, SUMS) float64
        For each cell: number of points; sums of sag, slopes, `dx` and `dy`; column and row; sums of phase and its
        derivatives.
    """
    column, row = cell_of(mla.lattice, x + dx, y + dy)
    if not is_inside(mla.lattice, column, row):
        return
    cx, cy = centre(mla.lattice, column, row)
    if not _is_clear(mla, x + dx - cx, y + dy - cy):
        return
    curvature, ex, ey = shape_of(mla, column, row)
    own_x, own_y = x + dx - cx - ex, y + dy - cy - ey
    sag = face_sag(mla, column, row, curvature, own_x, own_y)
    nx, ny, nz = face_normal(mla, column, row, curvature, own_x, own_y, sag)
    part = 0
    while part < CELLS - 1 and parts[part, 0] > 0.0 and (parts[part, 6] != column or parts[part, 7] != row):
        part += 1
    parts[part, 0] += 1.0
    parts[part, 1] += sag
    parts[part, 2] -= nx / nz
    parts[part, 3] -= ny / nz
    parts[part, 4] += dx
    parts[part, 5] += dy
    parts[part, 6], parts[part, 7] = column, row
    _add_phase(phase, own_x, own_y, part, parts)


@inlined
def _add_phase(phase: Any, x: float, y: float, part: int, parts: Array) -> None:
    """Add the phase at a point, given from the lenslet's apex, to the sums of its cell."""
    if phase is not None:
        value, by_x, by_y = phase_at(phase.phases, phase.number, x, y)
        parts[part, 8] += phase.order * value
        parts[part, 9] += phase.order * by_x
        parts[part, 10] += phase.order * by_y


@inlined
def _near_mask(mla: Lenslets, column: int, row: int, x: float, y: float, box: float) -> bool:
    """Tell whether the edge of a cell's clear aperture may cross the box about a point."""
    if mla.clear_radius == np.inf:
        return False
    cx, cy = centre(mla.lattice, column, row)
    return bool(abs(np.hypot(x - cx, y - cy) - mla.clear_radius) < box)


@inlined
def _is_clear(mla: Lenslets, x: float, y: float) -> bool:
    """Tell whether a lenslet is clear at a point, given from the centre of its cell."""
    return bool(x * x + y * y <= mla.clear_radius * mla.clear_radius)
