"""Blocks of rays in a gradient-index microlens array: from face to face of their lenslets, and divided there."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.gradient_cell import REACHED, cross_cells, index_in_cell, normal_in_cell
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DX,
    DY,
    DZ,
    ENDED_ON,
    FATE,
    INDEX_BEFORE,
    INDEX_BEHIND,
    SCRATCH,
    X,
    Y,
    Z,
    set_fate,
    set_normal,
)
from lfmesh.transport.sequences.division import divide_by_place
from lfmesh.transport.tables.tables import AIR, CellGradients, MlaTables

Array = NDArray[np.float64]

COLUMN, ROW = SCRATCH, SCRATCH + BLOCK
"""Working rows: the cell of a ray at its last face of the array."""


@inlined
def meet_along_curves(gradient: Any, bundle: Array, mla: MlaTables, colour: int) -> None:
    """Follow rays in a gradient-index plate to the face of their lenslet, or to a wall of its cell.

    They become the straight rays that arrive as the curves do.

    Parameters
    ----------
    gradient : CellGradients or None
        Gradient of `mla`.
    bundle : (ROWS · BLOCK,) float64
        In the frame of `mla`.
    mla : MlaTables
        Tables of the face that the rays go to.
    colour : int
        Wavelength number.
    """
    if gradient is None:
        return
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0:
            column, row = int(bundle[COLUMN + i]), int(bundle[ROW + i])
            ray = Ray(
                bundle[X + i], bundle[Y + i], bundle[Z + i], bundle[DX + i], bundle[DY + i], bundle[DZ + i]
            )  # fmt: skip
            end = cross_cells(gradient, mla, colour, column, row, ray)
            bundle[X + i], bundle[Y + i], bundle[Z + i] = end.x, end.y, end.z
            bundle[DX + i], bundle[DY + i], bundle[DZ + i] = end.dx, end.dy, end.dz
            bundle[COLUMN + i], bundle[ROW + i] = end.column, end.row
            # REACHED is −1, and so the fate 0.
            set_fate(bundle, i, end.distance, end.slot + 1.0)
            if end.slot == REACHED:
                at = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
                nx, ny, nz = normal_in_cell(mla.lenslets, end.column, end.row, at)
                set_normal(bundle, i, -nx, -ny, -nz)


@inlined
def divide_in_cells(
    gradient: CellGradients, bundle: Array, mla: MlaTables, inward: bool, mirrors: bool, colour: int, book: Array
) -> None:
    """Divide rays at their lenslets' faces, each with the index of the glass at its point.

    Parameters
    ----------
    gradient, bundle, mla, colour
        As for `meet_along_curves`.
    inward : bool
        The rays come from the air.
    mirrors : bool
        Reflect the rays; else refract them.
    book : (slots,) float64
        Receives light absorbed by a coating.
    """
    outside = mla.media.indices[AIR, colour]
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            column, row = int(bundle[COLUMN + i]), int(bundle[ROW + i])
            at = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
            glass = index_in_cell(gradient, mla, colour, column, row, at)
            bundle[INDEX_BEFORE + i], bundle[INDEX_BEHIND + i] = (outside, glass) if inward else (glass, outside)
    divide_by_place(gradient, bundle, mla.interfaces, mla.row, colour, not inward, mirrors, book)
