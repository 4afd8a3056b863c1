"""Views of the lens's opening through plates with lenslets on both faces, by real rays.

Rays go from the opening through every lenslet on the lens side to a lenslet on the sensor side, not always the opposite
one. The bounding box of the rays' slopes at the latter gives the middle of its view, the farthest ray the radius.
"""

from typing import Any

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.array.lattice import cell_of, centre, is_inside
from lfmesh.geometry.array.lenslets import face_normal, face_sag, shape_of, type_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase_law import diffracted
from lfmesh.transport.aims.lenslet_faces import on_lenslet
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.events.crossing import refracted
from lfmesh.transport.events.gradient_cell import REACHED, cross_cells, index_in_cell
from lfmesh.transport.events.phase import momentum_change
from lfmesh.transport.packets.packet import BACK_FRAME, CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.tables.phase_faces import FIRST_TRANSMITTED
from lfmesh.transport.tables.tables import MlaTables, Opening

ZONES = 2
"""Number of points of a lenslet, from its centre to each corner, that rays go through."""

INSIDE = 0.98
"""Share of the way to the corners: at a corner a ray may land in any of the adjacent lenslets."""

OF_OPENING = 5
"""Number of points of the opening: its centre, and four on its border."""

RINGS, TURNS = 4, 8
"""Rings, and rays in each, of the directions that a gradient-index lenslet accepts."""

NOTHING_SEEN = -1.0
"""In place of the radius of a lenslet's view: the lenslet does not show the opening."""


def views_through_plate(
    mla: MlaTables, opening: Opening, moves: Array, sensor_z: float, slope: Array, slope_radius: Array
) -> None:  # fmt: skip
    """Measure the view of every lenslet on the sensor side.

    Parameters
    ----------
    mla : MlaTables
        With lenslets on both faces.
    opening : Opening
    moves : (6, 6, 3, 4) float64
    sensor_z : float, mm
        Height of the apexes, array frame.
    slope : (cells, 2) float64
        Filled with the slope, array frame, away from the sensor, of the middle of the view.
    slope_radius : (cells,) float64
        Filled with the radius of the view, in slopes; −1: the lenslet does not show the opening.
    """
    corners = mla.lenslets.lattice.corners()
    low, high = np.full(slope.shape, np.inf), np.full(slope.shape, -np.inf)
    _through_all(mla, opening, moves, sensor_z, corners, low, high, slope_radius, False)
    seen = np.isfinite(low[:, 0])
    slope[:] = 0.0
    slope[seen] = 0.5 * (low[seen] + high[seen])
    slope_radius[:] = np.where(seen, 0.0, NOTHING_SEEN)
    _through_all(mla, opening, moves, sensor_z, corners, slope, slope, slope_radius, True)


@kernel
def _through_all(
    mla: MlaTables, opening: Opening, moves: Array, sensor_z: float, corners: Array, low: Array, high: Array,
    radius: Array, has_middle: bool,
) -> None:  # fmt: skip
    """Send rays through all lens-side lenslets; enter them in boxes, or in radii about the middle `low`."""
    lattice = mla.lenslets.lattice
    for row in range(lattice.rows):
        for column in range(lattice.columns):
            cx, cy = centre(lattice, column, row)
            for point in range(1 + ZONES * len(corners)):
                zone, corner = (point + len(corners) - 1) // len(corners) / ZONES, point % len(corners)
                x, y = cx + INSIDE * zone * corners[corner, 0], cy + INSIDE * zone * corners[corner, 1]
                for colour in range(mla.media.indices.shape[1]):
                    for which in range(_rays_through(mla.gradient)):
                        cell, a, b = _slope_through(
                            mla, mla.back, opening, moves, sensor_z, column, row, x, y, colour, which
                        )
                        if cell < 0:
                            continue
                        if has_middle:
                            off = np.sqrt((a - low[cell, 0]) ** 2 + (b - low[cell, 1]) ** 2)
                            radius[cell] = max(radius[cell], off)
                        else:
                            low[cell, 0], low[cell, 1] = min(low[cell, 0], a), min(low[cell, 1], b)
                            high[cell, 0], high[cell, 1] = max(high[cell, 0], a), max(high[cell, 1], b)


@inlined
def _slope_through(
    mla: MlaTables, back: MlaTables, opening: Opening, moves: Array, sensor_z: float, column: int, row: int,
    x: float, y: float, colour: int, which: int,
) -> tuple[int, float, float]:  # fmt: skip
    """Trace a ray through a lens-side lenslet; return the cell where it leaves, and its slope there.

    The cell is −1 if the ray does not get to the sensor.

    Parameters
    ----------
    back : MlaTables
        Lenslets on the lens side.
    column, row : int
        Column and row of the lenslet among them.
    x, y : float, mm
        Point, in their frame.
    which : int
        Point of the opening: its centre, one of four on its border, or for a gradient-index lenslet in one of the
        directions that it accepts.
    """
    curvature, ex, ey = shape_of(back.lenslets, column, row)
    cx, cy = centre(back.lenslets.lattice, column, row)
    ux, uy = x - cx - ex, y - cy - ey
    z = face_sag(back.lenslets, column, row, curvature, ux, uy)
    nx, ny, nz = face_normal(back.lenslets, column, row, curvature, ux, uy, z)
    px, py, pz = frame.move_point(moves, BACK_FRAME, CAMERA_FRAME, x, y, z)
    ox, oy, radius = opening_from(opening, (px, py, pz))
    if not radius > 0.0:
        return -1, 0.0, 0.0
    if which >= OF_OPENING:
        accepted, ox, oy = _in_acceptance(
            mla.gradient, colour, which - OF_OPENING, px, py, opening.plane_z - pz, (ox, oy, radius)
        )
        if not accepted:
            return -1, 0.0, 0.0
    elif which > 0:
        ox += radius * (0.0 if which > 2 else (1.0 if which == 1 else -1.0))
        oy += radius * (0.0 if which <= 2 else (1.0 if which == 3 else -1.0))
    dx, dy, dz = frame.move_direction(moves, CAMERA_FRAME, BACK_FRAME, px - ox, py - oy, pz - opening.plane_z)
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    glass = _index_at(back.gradient, back, colour, column, row, (x, y, z))
    passes, dx, dy, dz = bent_at_lenslet(
        back.interfaces.phases, back.row, colour, (ux, uy), (1.0, glass), (dx * scale, dy * scale, dz * scale),
        (nx, ny, nz),
    )  # fmt: skip
    if not passes:
        return -1, 0.0, 0.0
    px, py, pz = frame.move_point(moves, BACK_FRAME, MLA_FRAME, x, y, z)
    dx, dy, dz = frame.move_direction(moves, BACK_FRAME, MLA_FRAME, dx, dy, dz)
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    met, own_column, own_row, ux, uy, dx, dy, dz = _onto_other_face(
        mla.gradient, mla, colour, column, row, Ray(px, py, pz, dx, dy, dz)
    )
    if not met:
        return -1, 0.0, 0.0
    curvature, ex, ey = shape_of(lenslets, own_column, own_row)
    cx, cy = centre(lattice, own_column, own_row)
    z = face_sag(lenslets, own_column, own_row, curvature, ux, uy)
    nx, ny, nz = face_normal(lenslets, own_column, own_row, curvature, ux, uy, z)
    glass = _index_at(mla.gradient, mla, colour, own_column, own_row, (ux + cx + ex, uy + cy + ey, z))
    passes, dx, dy, dz = bent_at_lenslet(
        mla.interfaces.phases, mla.row, colour, (ux, uy), (glass, 1.0), (dx, dy, dz), (-nx, -ny, -nz)
    )
    if not passes:
        return -1, 0.0, 0.0
    px, py = ux + cx + ex, uy + cy + ey
    sx, sy, sz = frame.move_point(moves, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 0.0)
    mx, my, mz = frame.move_direction(moves, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 1.0)
    t = ((sx - px) * mx + (sy - py) * my + (sz - z) * mz) / (dx * mx + dy * my + dz * mz)
    over = 1.0 / abs(z + t * dz - sensor_z)
    return own_row * lattice.columns + own_column, (cx - px - t * dx) * over, (cy - py - t * dy) * over


@inlined
def _rays_through(gradient: Any) -> int:
    """Return the number of rays through a point of a lenslet; `gradient` : CellGradients or None."""
    return OF_OPENING if gradient is None else OF_OPENING + RINGS * TURNS


@inlined
def _in_acceptance(
    gradient: Any, colour: int, number: int, x: float, y: float, ahead: float, disk: tuple[float, float, float]
) -> tuple[bool, float, float]:  # fmt: skip
    """Return whether a ray in a gradient-index lenslet's acceptance comes from the opening, and its point there.

    Of a wide opening a long lenslet sees a part only, which rays from centre and border may miss.

    Parameters
    ----------
    gradient : CellGradients or None
    colour, number : int
        Numbers of the wavelength and of the ray.
    x, y : float, mm
        Point of the lenslet, camera frame.
    ahead : float, mm
        Distance along z to the plane of the opening.
    disk : (3,) float, mm
        Centre and radius of the opening.
    """
    if gradient is None:
        return False, 0.0, 0.0
    slope = gradient.acceptance[colour] * (number // TURNS + 1.0) / RINGS
    turn = 2.0 * np.pi * (number % TURNS) / TURNS
    x, y = x + ahead * slope * np.cos(turn), y + ahead * slope * np.sin(turn)
    ox, oy = x - disk[0], y - disk[1]
    return ox * ox + oy * oy <= disk[2] * disk[2], x, y


@inlined
def _index_at(
    gradient: Any, mla: MlaTables, colour: int, column: int, row: int, point: tuple[float, float, float]
) -> float:  # fmt: skip
    """Return the index of a lenslet's glass at a point in the frame of its face, relative to the medium outside.

    Parameters
    ----------
    gradient : CellGradients or None
        Gradient of `mla`.
    """
    if gradient is None:
        return mla.media.indices[mla.medium, colour]
    return index_in_cell(gradient, mla, colour, column, row, point) / gradient.outside[colour]


@inlined
def _onto_other_face(
    gradient: Any, mla: MlaTables, colour: int, column: int, row: int, ray: Ray
) -> tuple[bool, int, int, float, float, float, float, float]:
    """Follow a ray in the glass to the face towards the sensor.

    Parameters
    ----------
    gradient : CellGradients or None
        Gradient of `mla`.
    column, row : int
        Lenslet on the lens side.
    ray : Ray
        In the frame of `mla`.

    Returns
    -------
    met : bool
    column, row : int
        Lenslet where it arrives.
    x, y : float, mm
        Point, from its apex.
    dx, dy, dz : float
    """
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    px, py, pz, dx, dy, dz = ray
    if gradient is not None:
        end = cross_cells(gradient, mla, colour, column, row, ray)
        cx, cy = centre(lattice, end.column, end.row)
        _, ex, ey = shape_of(lenslets, end.column, end.row)
        ux, uy = end.x + end.distance * end.dx - cx - ex, end.y + end.distance * end.dy - cy - ey
        return end.slot == REACHED, end.column, end.row, ux, uy, end.dx, end.dy, end.dz
    gx, gy = dx / dz, dy / dz
    # The line at the height of the apexes and in the middle of the layer of faces.
    ax, ay, middle = px - pz * gx, py - pz * gy, 0.5 * (lenslets.top + lenslets.valley)
    column, row = cell_of(lattice, ax + middle * gx, ay + middle * gy)
    if not is_inside(lattice, column, row):
        return False, column, row, 0.0, 0.0, dx, dy, dz
    curvature, ex, ey = shape_of(lenslets, column, row)
    cx, cy = centre(lattice, column, row)
    kind = type_of(lenslets, column, row)
    met, ux, uy = on_lenslet(lenslets, kind, curvature, ax - cx - ex, ay - cy - ey, gx, gy, True)
    return met, column, row, ux, uy, dx, dy, dz


@inlined
def refract_if_possible(
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float
) -> tuple[bool, float, float, float]:
    """Return whether a face with a normal along the ray refracts it, and the refracted direction.

    Parameters
    ----------
    dx, dy, dz : float
        Unit direction.
    nx, ny, nz : float
        Unit normal.
    eta : float
        Index before the face over that behind it.
    """
    cos_i = dx * nx + dy * ny + dz * nz
    cos2_t = 1.0 - eta * eta * (1.0 - cos_i * cos_i)
    if cos_i <= 0.0 or cos2_t <= 0.0:
        return False, dx, dy, dz
    ux, uy, uz = refracted(dx, dy, dz, nx, ny, nz, eta, cos_i, np.sqrt(cos2_t))
    return True, ux, uy, uz


@inlined
def bent_at_lenslet(
    phases: Any, row: int, colour: int, place: tuple[float, float], indices: tuple[float, float],
    d: tuple[float, float, float], n: tuple[float, float, float],
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Return whether a lenslet's face lets a ray through, in the main order of its phase if any, and the direction.

    Parameters
    ----------
    phases : PhaseFaces or None
        Phases of the array.
    row, colour : int
        Row of the face, and number of the wavelength.
    place : (2,) float, mm
        Point of the face, relative to its apex.
    indices : (2,) float
        Refractive indices before and after the face, relative to the medium outside.
    d, n : (3,) float
        Unit direction, and unit normal along the ray.
    """
    if phases is None:
        return refract_if_possible(d[0], d[1], d[2], n[0], n[1], n[2], indices[0] / indices[1])
    if phases.number[row] < 0:
        return refract_if_possible(d[0], d[1], d[2], n[0], n[1], n[2], indices[0] / indices[1])
    order = phases.order[phases.first[row, FIRST_TRANSMITTED]]
    gx, gy = momentum_change(phases, row, colour, place[0], place[1])
    passes, _, dx, dy, dz = diffracted(indices[0], indices[1], d, n, order * gx, order * gy, False)
    return passes and d[0] * n[0] + d[1] * n[1] + d[2] * n[2] > 0.0, dx, dy, dz
