"""Rays through a plate of gradient-index lenslets, for drawings: directions at both ends, and points along curves.

Points and directions are in the camera frame. Faces of the array are `TO_LENS` and `TO_SENSOR`, by the side that they
look to.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.geometry.array.gradient_cell import FRONT, cell_at, follow_in_cell
from lfmesh.geometry.array.lattice import cell_of, centre, is_inside, neighbour
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay, advance
from lfmesh.optics.gradients import field_at
from lfmesh.transport.events.gradient_cell import cross_cells, index_in_cell, normal_in_cell
from lfmesh.transport.packets.packet import CAMERA_FRAME
from lfmesh.transport.tables.tables import CellGradients, MlaTables, Tables
from lfmesh.transport.world import World
from lfmesh.view.rays.names import curved_to_lens

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

TO_LENS, TO_SENSOR = -3, -2
"""Faces of the array."""

NEWTON_STEPS = 4
"""Steps to the point at a given length of a curve."""


def array_face(world: World, *, is_curved: bool) -> int:
    """Return the number of a face of the array: of the one that `camera.mla` describes as curved, or the other."""
    return TO_LENS if is_curved == curved_to_lens(world) else TO_SENSOR


def cells_at(tables: Tables, points: Floats) -> Ints:
    """Return the lenslets in whose cells points on faces of the array lie, row by row, (n,)."""
    lattice = tables.mla.lenslets.lattice
    own = frames.points(tables.frames[CAMERA_FRAME, tables.mla.frame], points)
    cells = [cell_of(lattice, x, y) for x, y, _ in own]
    return np.array([row * lattice.columns + column for column, row in cells], np.int64)


def face_tables(tables: Tables, face: int) -> MlaTables:
    """Return the tables of a face of an array whose plate is gradient-index glass."""
    towards_sensor: MlaTables = tables.mla
    back: MlaTables = tables.mla.back
    return towards_sensor if face == TO_SENSOR else back


def other_face(face: int) -> int:
    """Return the opposite face of the array."""
    return TO_LENS + TO_SENSOR - face


def indices_and_normals(tables: Tables, face: int, cells: Ints, points: Floats) -> tuple[Floats, Floats]:
    """Return the index of the glass at points on a face of the array, (n,), and its unit normals, (n, 3).

    Parameters
    ----------
    tables : Tables
        Of one wavelength.
    face : int
    cells : (n,) int64
        Lenslets, row by row.
    points : (n, 3) float64, mm
    """
    mla, values = face_tables(tables, face), np.empty((len(points), 4))
    own = frames.points(tables.frames[CAMERA_FRAME, mla.frame], points)
    _fill_face(mla.gradient, mla, cells, own, values)
    return values[:, 0], frames.directions(tables.frames[mla.frame, CAMERA_FRAME], values[:, 1:])


def indices_in_cells(tables: Tables, cells: Ints, points: Floats) -> Floats:
    """Return the index of the glass of lenslets at points, (n,).

    Parameters
    ----------
    tables, cells, points
        As for `indices_and_normals`, with points anywhere in the cells.
    """
    mla, values = tables.mla, np.empty((len(points), 4))
    _fill_face(mla.gradient, mla, cells, frames.points(tables.frames[CAMERA_FRAME, mla.frame], points), values)
    return values[:, 0]


def arriving_in_cells(tables: Tables, face: int, cells: Ints, points: Floats, leaving: Floats) -> Floats:
    """Return the unit directions in which rays from a face of the array arrive at the other, or at a wall, (n, 3).

    Parameters
    ----------
    tables, face, cells, points
        As for `indices_and_normals`.
    leaving : (n, 3) float64
        Unit directions in the glass at the points.
    """
    mla, ends = face_tables(tables, other_face(face)), np.empty((len(points), 3))
    into = tables.frames[CAMERA_FRAME, mla.frame]
    _fill_ends(mla.gradient, mla, cells, frames.points(into, points), frames.directions(into, leaving), ends)
    return frames.directions(tables.frames[mla.frame, CAMERA_FRAME], ends)


def cell_curves(
    tables: Tables, face: int, cells: Ints, points: Floats, leaving: Floats, count: int
) -> Floats:  # fmt: skip
    """Return points along rays from a face of the array to the other, or to a wall, (n, count, 3) mm.

    Parameters
    ----------
    tables, face, cells, points, leaving
        As for `arriving_in_cells`.
    count : int
        Number of points of each ray, 2 or more.
    """
    mla, curves = face_tables(tables, other_face(face)), np.empty((len(points), count, 3))
    into, out = tables.frames[CAMERA_FRAME, mla.frame], tables.frames[mla.frame, CAMERA_FRAME]
    _fill_curves(mla.gradient, mla, cells, frames.points(into, points), frames.directions(into, leaving), curves)
    return frames.points(out, curves.reshape(-1, 3)).reshape(curves.shape)


@kernel
def _fill_face(gradient: CellGradients, mla: MlaTables, cells: Ints, points: Floats, values: Floats) -> None:
    """Find the index and the normal at points on a face, in its frame."""
    columns = mla.lenslets.lattice.columns
    for i in range(len(points)):
        row, column = cells[i] // columns, cells[i] % columns
        point = (points[i, 0], points[i, 1], points[i, 2])
        values[i, 0] = index_in_cell(gradient, mla, 0, column, row, point)
        nx, ny, nz = normal_in_cell(mla.lenslets, column, row, point)
        values[i, 1], values[i, 2], values[i, 3] = nx, ny, nz


@kernel
def _fill_ends(
    gradient: CellGradients, mla: MlaTables, cells: Ints, points: Floats, directions: Floats, ends: Floats
) -> None:
    columns = mla.lenslets.lattice.columns
    for i in range(len(points)):
        ray = Ray(
            points[i, 0], points[i, 1], points[i, 2], directions[i, 0], directions[i, 1], directions[i, 2]
        )  # fmt: skip
        end = cross_cells(gradient, mla, 0, cells[i] % columns, cells[i] // columns, ray)
        ends[i, 0], ends[i, 1], ends[i, 2] = end.dx, end.dy, end.dz


@inlined
def _axis(gradient: CellGradients, mla: MlaTables, column: int, row: int) -> tuple[float, float, float, float]:
    """Return the centre of a cell, and the axis of its gradient from there, mm."""
    lattice = mla.lenslets.lattice
    cx, cy = centre(lattice, column, row)
    if len(gradient.axes) == 0:
        return cx, cy, 0.0, 0.0
    cell = row * lattice.columns + column
    return cx, cy, gradient.axes[cell, 0], gradient.axes[cell, 1]


@inlined
def _moved_along(gradient: CellGradients, ray: GradientRay, length: float, step: float) -> GradientRay:
    """Return a ray at a given length of its curve, mm, by steps in σ up to `step`."""
    sigma, end = 0.0, ray
    for _ in range(NEWTON_STEPS):
        sigma += (length - end.length) / np.sqrt(end.tx * end.tx + end.ty * end.ty + end.tz * end.tz)
        steps = max(int(np.ceil(abs(sigma) / step)), 1)
        end = advance(gradient.gradients, 0, ray, sigma / steps, steps)
    return end


@kernel
def _fill_curves(
    gradient: CellGradients, mla: MlaTables, cells: Ints, points: Floats, directions: Floats, curves: Floats
) -> None:
    """Find points at equal lengths along rays, in the frame of the face that they go to.

    Between clear walls the ray is followed cell by cell, as by `cross_cells`.
    """
    lattice, last = mla.lenslets.lattice, curves.shape[1] - 1
    longest, flip = gradient.longest[0], 1.0 if mla.curved_to_lens else -1.0
    base = 0.0 if mla.curved_to_lens else mla.lenslets.thickness
    for i in range(len(points)):
        row, column = cells[i] // lattice.columns, cells[i] % lattice.columns
        ray = Ray(
            points[i, 0], points[i, 1], points[i, 2], directions[i, 0], directions[i, 1], directions[i, 2]
        )  # fmt: skip
        whole = cross_cells(gradient, mla, 0, column, row, ray).distance
        cx, cy, ax, ay = _axis(gradient, mla, column, row)
        x, y, z = ray.x - cx - ax, ray.y - cy - ay, base + flip * ray.z
        n = np.sqrt(field_at(gradient.gradients, 0, x, y, z)[0])
        own = GradientRay(x, y, z, n * ray.dx, n * ray.dy, n * flip * ray.dz, 0.0, 0.0)
        j, ends = 0, False
        while j <= last:
            # The lenslets of the two faces may have different types.
            if mla.curved_to_lens:
                ahead = cell_at(mla.lenslets, gradient.opposite, column, row, (ax, ay))
                wall, end = follow_in_cell(gradient.gradients, 0, ahead, own, longest, gradient.steps[0])
            else:
                behind = cell_at(gradient.opposite, mla.lenslets, column, row, (ax, ay))
                wall, end = follow_in_cell(gradient.gradients, 0, behind, own, longest, gradient.steps[0])
            next_column, next_row = column, row
            if 0 <= wall < FRONT and gradient.clear_walls:
                next_column, next_row = neighbour(lattice, column, row, wall)
            ends = (next_column == column and next_row == row) or not is_inside(lattice, next_column, next_row)
            while j <= last and (ends or whole * j <= end.length * last):
                at = _moved_along(gradient, own, whole * j / last, longest)
                curves[i, j, 0], curves[i, j, 1] = at.x + cx + ax, at.y + cy + ay
                curves[i, j, 2] = base + flip * at.z
                j += 1
            from_x, from_y, column, row = cx + ax, cy + ay, next_column, next_row
            cx, cy, ax, ay = _axis(gradient, mla, column, row)
            own = GradientRay(
                end.x + from_x - cx - ax, end.y + from_y - cy - ay, end.z, end.tx, end.ty, end.tz, end.path, end.length
            )  # fmt: skip
