"""The lattice of a microlens array: cell of a point, exit of a ray from its cell, and the cell it enters.

Cells are squares, or hexagons with two sides parallel to y and odd rows shifted by half a pitch towards +x. Both are
Voronoi cells of their centres. The lattice is centred on the origin of the array's frame.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel, pasted

ROW_SPACING = np.sqrt(0.75)
"""Distance between neighbouring rows of a hexagonal lattice, in pitches."""


@by_address
class Lattice(NamedTuple):
    """Layout and size; `pitch` is the distance between neighbouring centres, mm."""

    hexagonal: bool
    pitch: float
    columns: int
    rows: int

    @property
    def cell_area(self) -> float:
        """Area of a cell in mm²."""
        return self.pitch**2 * (ROW_SPACING if self.hexagonal else 1.0)

    @property
    def circumradius(self) -> float:
        """Distance from a cell's centre to its corners, mm."""
        return self.pitch / np.sqrt(3.0) if self.hexagonal else self.pitch / np.sqrt(2.0)

    @property
    def half_extent(self) -> tuple[float, float]:
        """Half width and half height of the bounding box of all cells, mm."""
        if not self.hexagonal:
            return 0.5 * self.columns * self.pitch, 0.5 * self.rows * self.pitch
        width = 0.5 * self.columns * self.pitch + (0.25 * self.pitch if self.rows > 1 else 0.0)
        return width, (0.5 * (self.rows - 1) * ROW_SPACING + 1.0 / np.sqrt(3.0)) * self.pitch

    def corners(self) -> NDArray[np.float64]:
        """Return the corners (4 or 6, 2) of the cell at the origin, counter-clockwise, mm."""
        turn = np.deg2rad(np.arange(30, 390, 60) if self.hexagonal else np.arange(45, 405, 90))
        return np.asarray(self.circumradius * np.column_stack([np.cos(turn), np.sin(turn)]))

    def centres(self) -> NDArray[np.float64]:
        """Return the centres of the cells, (rows, columns, 2) mm."""
        row, column = np.indices((self.rows, self.columns))
        if not self.hexagonal:
            x, y = column - 0.5 * (self.columns - 1), row - 0.5 * (self.rows - 1)
        else:
            x = column - 0.5 * (self.columns - 1) + 0.5 * (row % 2) - (0.25 if self.rows > 1 else 0.0)
            y = (row - 0.5 * (self.rows - 1)) * ROW_SPACING
        return np.stack([x, y], axis=-1) * self.pitch


@kernel
def centre(lattice: Lattice, column: int, row: int) -> tuple[float, float]:
    """Return the centre of a cell, which may lie outside the array.

    Parameters
    ----------
    lattice : Lattice
    column, row : int
    """
    p = lattice.pitch
    if not lattice.hexagonal:
        return (column - 0.5 * (lattice.columns - 1)) * p, (row - 0.5 * (lattice.rows - 1)) * p
    shift = 0.5 * (row & 1) - (0.25 if lattice.rows > 1 else 0.0)
    return (column - 0.5 * (lattice.columns - 1) + shift) * p, (row - 0.5 * (lattice.rows - 1)) * (ROW_SPACING * p)


@kernel
def cell_of(lattice: Lattice, x: float, y: float) -> tuple[int, int]:
    """Return (column, row) of the cell a point lies in; it may lie outside the array.

    Parameters
    ----------
    lattice : Lattice
    x, y : float, mm
    """
    u, v = x / lattice.pitch, y / lattice.pitch
    if not lattice.hexagonal:
        column = int(np.floor(u + 0.5 * lattice.columns))
        return column, int(np.floor(v + 0.5 * lattice.rows))
    middle = int(np.floor(v / ROW_SPACING + 0.5 * lattice.rows))
    best = np.inf
    found_column, found_row = 0, middle
    for row in range(middle - 1, middle + 2):
        shift = 0.5 * (row & 1) - (0.25 if lattice.rows > 1 else 0.0)
        column = int(np.floor(u - shift + 0.5 * lattice.columns))
        a = u - (column - 0.5 * (lattice.columns - 1) + shift)
        b = v - (row - 0.5 * (lattice.rows - 1)) * ROW_SPACING
        if a * a + b * b < best:
            best = a * a + b * b
            found_column, found_row = column, row
    return found_column, found_row


@pasted
def half_hexagon(x: float, y: float) -> float:
    """Return half the width along x of the hexagon about the origin, two sides along y, with a point on its border."""
    a, b = 0.5 * x, ROW_SPACING * y
    return max(abs(x), abs(a + b), abs(a - b))


@inlined
def rows_near(lattice: Lattice, y: float, distance: float) -> tuple[int, int]:
    """Return the first row, and one past the last, with centres at most a distance from y.

    Parameters
    ----------
    lattice : Lattice
    y, distance : float, mm
    """
    rows, spacing = lattice.rows, lattice.pitch * (ROW_SPACING if lattice.hexagonal else 1.0)
    return _numbers_within(y / spacing + 0.5 * (rows - 1), distance / spacing, rows)


@inlined
def columns_near(lattice: Lattice, row: int, x: float, distance: float) -> tuple[int, int]:
    """Return the first column, and one past the last, with centres in a row at most a distance from x.

    Parameters
    ----------
    lattice : Lattice
    row : int
    x, distance : float, mm
    """
    middle, _ = centre(lattice, 0, row)
    return _numbers_within((x - middle) / lattice.pitch, distance / lattice.pitch, lattice.columns)


@inlined
def _numbers_within(middle: float, distance: float, count: int) -> tuple[int, int]:
    """Return the first, and one past the last, of the numbers 0 ... count − 1 within a distance of a middle."""
    last = min(max(middle + distance, -1.0), count - 1.0)
    return int(np.ceil(min(max(middle - distance, 0.0), float(count)))), int(np.floor(last)) + 1


@kernel
def is_inside(lattice: Lattice, column: int, row: int) -> bool:
    """Tell whether the array has this cell.

    Parameters
    ----------
    lattice : Lattice
    column, row : int
    """
    return 0 <= column < lattice.columns and 0 <= row < lattice.rows


@kernel
def leaves_at(lattice: Lattice, x: float, y: float, dx: float, dy: float) -> tuple[float, int]:
    """Return the distance to the exit of a ray from the cell at the origin, and the side of the exit.

    Sides are numbered counter-clockwise from the one that faces +x. The distance is slightly negative if the ray starts
    outside by a rounding error, and inf if the ray runs along z.

    Parameters
    ----------
    lattice : Lattice
    x, y : float, mm
        Start of the ray, from the cell's centre.
    dx, dy : float
        Direction; its length is the unit of the distance.
    """
    half = 0.5 * lattice.pitch
    nearest, side = np.inf, -1
    if not lattice.hexagonal:
        if dx != 0.0:
            nearest = (np.copysign(half, dx) - x) / dx
            side = 0 if dx > 0.0 else 2
        if dy != 0.0:
            t = (np.copysign(half, dy) - y) / dy
            if t < nearest:
                nearest = t
                side = 1 if dy > 0.0 else 3
        return nearest, side
    for s in range(3):
        nx = 1.0 if s == 0 else (0.5 if s == 1 else -0.5)
        ny = 0.0 if s == 0 else ROW_SPACING
        along = nx * dx + ny * dy
        if along != 0.0:
            t = (np.copysign(half, along) - (nx * x + ny * y)) / along
            if t < nearest:
                nearest = t
                side = s if along > 0.0 else s + 3
    return nearest, side


@kernel
def neighbour(lattice: Lattice, column: int, row: int, side: int) -> tuple[int, int]:
    """Return the cell behind a side.

    Parameters
    ----------
    lattice : Lattice
    column, row : int
    side : int
        As `leaves_at` numbers it.
    """
    if not lattice.hexagonal:
        if side == 0:
            return column + 1, row
        if side == 1:
            return column, row + 1
        if side == 2:
            return column - 1, row
        return column, row - 1
    odd = row & 1
    if side == 0:
        return column + 1, row
    if side == 1:
        return column + odd, row + 1
    if side == 2:
        return column - 1 + odd, row + 1
    if side == 3:
        return column - 1, row
    if side == 4:
        return column - 1 + odd, row - 1
    return column + odd, row - 1


@kernel
def stays_inside(lattice: Lattice, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Tell whether the line from a point over the array to another passes over its cells only.

    Parameters
    ----------
    lattice : Lattice
    x, y, to_x, to_y : float, mm
        Ends of the line.
    """
    to_column, to_row = cell_of(lattice, to_x, to_y)
    if not is_inside(lattice, to_column, to_row):
        return False
    if not lattice.hexagonal:
        return True
    # The outline is a zigzag, which a line can leave and enter again.
    column, row = cell_of(lattice, x, y)
    for _ in range(2 * (lattice.columns + lattice.rows)):
        if column == to_column and row == to_row:
            break
        cx, cy = centre(lattice, column, row)
        t, side = leaves_at(lattice, x - cx, y - cy, to_x - x, to_y - y)
        if t >= 1.0:
            break
        column, row = neighbour(lattice, column, row, side)
        if not is_inside(lattice, column, row):
            return False
    return True
