"""Rays through a cell of a microlens array that gradient-index glass fills, from any point to a face or a wall.

All in the lenslet's own frame: x and y from its axis, z from the vertex of the face towards the lens to the sensor.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING
from lfmesh.geometry.array.lenslet_profile import profile_shape
from lfmesh.geometry.array.lenslets import Lenslets, shape_of, type_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay, drift, kicker
from lfmesh.optics.gradient_walls import lander, wall_finder
from lfmesh.optics.gradients import Gradients, field_at

Array = NDArray[np.float64]

SIDES = 6
"""Number of sides of a hexagon. Walls below it are sides of the cell, numbered as in `lattice.leaves_at`."""

FRONT, BACK = SIDES, SIDES + 1
"""The other walls: the faces towards the lens and towards the sensor."""

WALLS = SIDES + 2


class CellFace(NamedTuple):
    """Face of a lenslet.

    Attributes
    ----------
    lenslets : Lenslets
    kind : int
        Type of the lenslet.
    curvature : float, 1/mm
    x, y : float, mm
        Apex, from the axis of the gradient.
    vertex_z : float, mm
    sense : float
        Direction into the glass along z: 1 for the face towards the lens, −1 for the one towards the sensor.
    """

    lenslets: Lenslets
    kind: int
    curvature: float
    x: float
    y: float
    vertex_z: float
    sense: float


class Cell(NamedTuple):
    """The glass of a lenslet.

    Attributes
    ----------
    x, y : float, mm
        Axis of the gradient, from the centre of the cell.
    half : float, mm
        Half the pitch.
    hexagonal : bool
    front, back : CellFace
        Faces towards the lens and towards the sensor.
    """

    x: float
    y: float
    half: float
    hexagonal: bool
    front: CellFace
    back: CellFace


@inlined
def cell_at(front: Lenslets, back: Lenslets, column: int, row: int, axis: tuple[float, float]) -> Cell:
    """Return the glass of a lenslet.

    Parameters
    ----------
    front, back : Lenslets
        Of the faces towards the lens and towards the sensor.
    column, row : int
    axis : (2,) float, mm
        Axis of the gradient, from the centre of the cell.
    """
    lattice = front.lattice
    return Cell(
        axis[0], axis[1], 0.5 * lattice.pitch, lattice.hexagonal, _face(front, column, row, axis, 0.0, 1.0),
        _face(back, column, row, axis, front.thickness, -1.0),
    )  # fmt: skip


@inlined
def _face(
    lenslets: Lenslets, column: int, row: int, axis: tuple[float, float], vertex_z: float, sense: float
) -> CellFace:  # fmt: skip
    curvature, ex, ey = shape_of(lenslets, column, row)
    return CellFace(
        lenslets, type_of(lenslets, column, row), curvature, ex - axis[0], ey - axis[1], vertex_z, sense
    )  # fmt: skip


@inlined
def _sag_by(profile: Any, face: CellFace, x: float, y: float) -> tuple[float, float, float]:
    """Return the sag of a face at a point from its apex, and its slopes; `profile` : Profile or None."""
    if profile is None:
        c, r2 = face.curvature, x * x + y * y
        steep = np.sqrt(1.0 - c * c * r2)
        return c * r2 / (1.0 + steep), c * x / steep, c * y / steep
    return profile_shape(profile, face.kind, face.curvature, x, y)


@inlined
def _height_at(face: CellFace, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the height along z over a face, and its gradient.

    Unlike the equation of a sphere, it is not 0 on the far half. It is NaN beyond the end of a face, which lies outside
    the cell.
    """
    sag, by_x, by_y = _sag_by(face.lenslets.profile, face, x - face.x, y - face.y)
    return z - face.vertex_z - face.sense * sag, -face.sense * by_x, -face.sense * by_y, 1.0


@inlined
def _clearance_at(cell: Cell, wall: int, ray: GradientRay) -> tuple[float, float]:
    """Return the distance of a ray from a side, or its height over a face; and the rate along T."""
    if wall >= FRONT:
        if wall == FRONT:
            height, by_x, by_y, by_z = _height_at(cell.front, ray.x, ray.y, ray.z)
            return height, by_x * ray.tx + by_y * ray.ty + by_z * ray.tz
        height, by_x, by_y, by_z = _height_at(cell.back, ray.x, ray.y, ray.z)
        return -height, -(by_x * ray.tx + by_y * ray.ty + by_z * ray.tz)
    if cell.hexagonal:
        half_turn, nx, ny = 3, 1.0, 0.0
        if wall % 3 != 0:
            nx, ny = 0.5 if wall % 3 == 1 else -0.5, ROW_SPACING
    else:
        half_turn, nx, ny = 2, 1.0 - wall % 2, 1.0 * (wall % 2)
        if wall >= 4:
            # A square has no such side.
            return np.inf, 0.0
    if wall >= half_turn:
        nx, ny = -nx, -ny
    return cell.half - nx * (ray.x + cell.x) - ny * (ray.y + cell.y), -nx * ray.tx - ny * ray.ty


_find_wall = wall_finder(WALLS, _clearance_at)
_land = lander(_height_at)
_kick = kicker(field_at)


@inlined
def _onto_side(gradients: Gradients, number: int, cell: Cell, wall: int, ray: GradientRay) -> GradientRay:
    """Return a ray close to a side of the cell moved onto it, which takes a single leapfrog step."""
    clearance, rate = _clearance_at(cell, wall, ray)
    change = -clearance / rate
    if not abs(change) < np.inf:
        return ray
    return drift(_kick(gradients, number, drift(ray, 0.5 * change), change), 0.5 * change)


@kernel
def follow_in_cell(
    gradients: Gradients, number: int, cell: Cell, ray: GradientRay, step: float, steps: int
) -> tuple[int, GradientRay]:
    """Return the first wall that a ray meets, or `gradient_walls.NO_WALL`, and the ray there.

    Parameters
    ----------
    gradients : Gradients
    number : int
        Row of the profile.
    cell : Cell
    ray : GradientRay
        In the glass, or on a wall of it.
    step : float, mm
        Longest step in σ.
    steps : int
        Number of equal steps to a face; more for rays that need longer ones than `step`.
    """
    wall, end, length = _find_wall(gradients, number, ray, cell, step, steps)
    if 0 <= wall < FRONT:
        return wall, _onto_side(gradients, number, cell, wall, end)
    if wall < 0 or not length > 0.0:
        return wall, end
    count = max(steps, int(np.ceil(length / step)))
    if wall == FRONT:
        lands, there, _ = _land(gradients, number, ray, cell.front, length, count)
    else:
        lands, there, _ = _land(gradients, number, ray, cell.back, length, count)
    return wall, there if lands else end


@kernel
def follow_rays_in_cell(
    gradients: Gradients, number: int, front: Lenslets, back: Lenslets, cells: NDArray[np.int64], rays: Array,
    walls: NDArray[np.int64], step: float, steps: int,
) -> None:  # fmt: skip
    """Follow rays as `follow_in_cell` does, each from the axis of its lenslet's apex.

    Parameters
    ----------
    gradients, number
        As for `follow_in_cell`.
    front, back : Lenslets
        Of the faces towards the lens and towards the sensor.
    cells : (n, 2) int64
        Column and row of each ray's lenslet.
    rays : (n, 8) float64
        Rows of `GradientRay`; replaced by the ends.
    walls : (n,) int64
        Filled with the walls.
    step, steps
        As for `follow_in_cell`.
    """
    for i in range(len(rays)):
        ray = GradientRay(
            rays[i, 0], rays[i, 1], rays[i, 2], rays[i, 3], rays[i, 4], rays[i, 5], rays[i, 6], rays[i, 7]
        )  # fmt: skip
        cell = cell_at(front, back, cells[i, 0], cells[i, 1], (0.0, 0.0))
        walls[i], end = follow_in_cell(gradients, number, cell, ray, step, steps)
        rays[i, 0], rays[i, 1], rays[i, 2] = end.x, end.y, end.z
        rays[i, 3], rays[i, 4], rays[i, 5] = end.tx, end.ty, end.tz
        rays[i, 6], rays[i, 7] = end.path, end.length
