"""Microlens array for drawing: every lenslet if they are few, else a plate with a patch of real lenslets.

Points are in the array's own frame, mm; z runs from the curved face into the glass.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.array_mesh import cell_pattern
from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice, cell_of
from lfmesh.geometry.array.lenslets import Lenslets, faces_at, shape_of, type_of

MOST_LENSLETS = 10_000
"""Larger arrays are drawn as a plate."""

PATCH = 31
"""Columns and rows of real lenslets on such a plate."""

FINEST, COARSEST = 12, 4
"""Limits on the subdivisions of a cell."""

SIDE_LINES = 4
"""Straight lines per side of a lenslet's border."""

CELL_PX = 32
"""Width of the picture of one lattice period."""
BORDER = 0.06
"""Width of the cell borders in it, relative to the pitch."""
BORDER_RGB, CELL_RGB = (160, 192, 206), (205, 232, 242)


class Detail(NamedTuple):
    """Fineness of a drawing.

    Attributes
    ----------
    most_lenslets : int
        Larger arrays are drawn as a plate with a patch of real lenslets.
    patch : int
        Columns and rows of that patch.
    triangles : int
        Approximate number of triangles in the curved face; fewer lenslets are drawn more finely.
    rings : int
        Most rings of triangles of a lens surface.
    picture_px : int
        Longest side of a picture on a target or sensor.
    is_single : bool
        Coordinates in single precision.
    """

    most_lenslets: int
    patch: int
    triangles: int
    rings: int
    picture_px: int
    is_single: bool


FINE = Detail(MOST_LENSLETS, PATCH, 150_000, 1000, 2**16, is_single=False)

SMALL = Detail(400, 15, 12_000, 12, 512, is_single=True)
"""For scenes in notebooks, whose cells hold all data."""


class Caps(NamedTuple):
    """Curved faces of lenslets: points (n, 3), normals (n, 3), triangles (m, 3), and lenslet of each triangle (m,)."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: NDArray[np.int64]
    cells: NDArray[np.int64]


def is_large(lattice: Lattice, detail: Detail = FINE) -> bool:
    """Tell whether an array has too many lenslets to draw."""
    return lattice.columns * lattice.rows > detail.most_lenslets


def all_cells(lattice: Lattice) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the columns and rows of all lenslets, row by row."""
    rows, columns = np.indices((lattice.rows, lattice.columns))
    return columns.ravel(), rows.ravel()


def cells_near(
    lattice: Lattice, near_mm: tuple[float, float], detail: Detail = FINE
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the columns and rows of the lenslets in a patch around a point of the array.

    Parameters
    ----------
    lattice : Lattice
    near_mm : (x, y), mm
    detail : Detail
    """
    column, row = (place - detail.patch // 2 for place in cell_of(lattice, *near_mm))
    columns = np.arange(max(column, 0), min(column + detail.patch, lattice.columns))
    rows = np.arange(max(row, 0), min(row + detail.patch, lattice.rows))
    grid = np.meshgrid(columns, rows)
    return grid[0].ravel(), grid[1].ravel()


def caps(mla: Lenslets, columns: NDArray[np.int64], rows: NDArray[np.int64], detail: Detail = FINE) -> Caps:
    """Return the curved faces of some lenslets.

    Parameters
    ----------
    mla : Lenslets
    columns, rows : (n,) int64
        Indices of the lenslets.
    detail : Detail
    """
    lattice = mla.lattice
    triangles = 6 if lattice.hexagonal else 1
    fineness = int(np.sqrt(detail.triangles / max(1, len(columns) * triangles)))
    pattern, faces = cell_pattern(lattice, int(np.clip(fineness, COARSEST, FINEST)))
    shapes = _shapes(mla, columns, rows)
    centres = lattice.centres()[rows, columns]
    z, normals = _faces(mla, columns, rows, shapes, pattern)
    points = np.dstack([pattern[None] + centres[:, None], z]).reshape(-1, 3)
    starts = len(pattern) * np.arange(len(columns))
    return Caps(
        points,
        -normals.reshape(-1, 3),
        (faces[None] + starts[:, None, None]).reshape(-1, 3),
        np.repeat(rows * lattice.columns + columns, len(faces)),
    )


def borders(mla: Lenslets, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the ends (n, 2, 3) of the border lines between some lenslets and their neighbours.

    Parameters
    ----------
    mla : Lenslets
    columns, rows : (n,) int64
        Indices of the lenslets.
    """
    corners = mla.lattice.corners()
    share = np.arange(SIDE_LINES)[:, None] / SIDE_LINES
    outline = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    shapes = _shapes(mla, columns, rows)
    z, _ = _faces(mla, columns, rows, shapes, outline)
    points = np.dstack([outline[None] + mla.lattice.centres()[rows, columns][:, None], z])
    return np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2, 3)


def _shapes(mla: Lenslets, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return curvature, and apex relative to the cell's centre, of n lenslets (n, 3)."""
    if mla.alike:
        return np.tile([mla.curvature[0], 0.0, 0.0], (len(columns), 1))
    return np.array([shape_of(mla, int(column), int(row)) for column, row in zip(columns, rows, strict=True)])


def _faces(
    mla: Lenslets, columns: NDArray[np.int64], rows: NDArray[np.int64], shapes: NDArray[np.float64],
    places: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:  # fmt: skip
    """Return the sag (n, m) of n lenslets at m points of a cell, and the normals there, (n, m, 3), towards +z."""
    if mla.alike:
        z, normals = faces_at(mla, 0, float(mla.curvature[0]), places)
        return np.tile(z, (len(columns), 1)), np.tile(normals, (len(columns), 1, 1))
    faces = [
        faces_at(mla, type_of(mla, int(column), int(row)), float(shape[0]), places - shape[1:])
        for column, row, shape in zip(columns, rows, shapes, strict=True)
    ]
    return np.array([z for z, _ in faces]), np.array([normals for _, normals in faces])


def face_corners(mla: Lenslets, z_mm: float) -> NDArray[np.float64]:
    """Return the corners (4, 3) of the cells' bounding box at a depth, counter-clockwise seen from +z."""
    x, y = mla.lattice.half_extent
    return np.array([[-x, -y, z_mm], [x, -y, z_mm], [x, y, z_mm], [-x, y, z_mm]])


ROUND = np.array([[i, j, k] for a in range(4) for b in [(a + 1) % 4] for i, j, k in ((a, a + 4, b + 4), (a, b + 4, b))])
"""Triangles of a rectangle with a rectangular hole, outer corners first."""


def face_round(mla: Lenslets, z_mm: float, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the corners (8, 3) of a face around all cells, and of a hole in it around some of them, mm.

    Parameters
    ----------
    mla : Lenslets
    z_mm : float, mm
        Position of the face in the array's frame.
    columns, rows : (n,) int64
        Indices of the lenslets in the hole.
    """
    outer = face_corners(mla, z_mm)
    centres = mla.lattice.centres()[rows, columns]
    reach = 0.5 * mla.lattice.pitch
    low, high = centres.min(axis=0) - reach, centres.max(axis=0) + reach
    inner = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return np.concatenate([outer, np.column_stack([inner, np.full(4, z_mm)])])


def lattice_picture(lattice: Lattice) -> tuple[NDArray[np.uint8], tuple[float, float]]:
    """Return a picture (h, w, 3) of the cell borders, starting at a centre, and its period in mm."""
    row_pitch = (ROW_SPACING if lattice.hexagonal else 1.0) * lattice.pitch
    period = (lattice.pitch, (2.0 if lattice.hexagonal else 1.0) * row_pitch)
    height = CELL_PX * (2 if lattice.hexagonal else 1)
    v, u = np.indices((height, CELL_PX))
    x, y = (u + 0.5) / CELL_PX * period[0], (v + 0.5) / height * period[1]
    row, column = np.mgrid[-1:4, -2:4]
    centre_x = (column + (0.5 * (row % 2) if lattice.hexagonal else 0.0)) * lattice.pitch
    # At a cell's border, the two nearest centres are equally far.
    distance = np.hypot(x[..., None] - centre_x.ravel(), y[..., None] - (row * row_pitch).ravel())
    nearest = np.sort(distance, axis=2)
    border = nearest[..., 1] - nearest[..., 0] < BORDER * lattice.pitch
    return np.where(border[..., None], BORDER_RGB, CELL_RGB).astype(np.uint8), period
