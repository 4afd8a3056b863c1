"""Passage of a ray through a gradient-index lenslet, from one face of the plate to the other.

The walls of its cell absorb, or are clear, so that it goes on in the next cell. As in the lens (`events.gradient`), it
is replaced by the straight ray that ends as the curve does. One function serves packets, blocks and aims.
"""

from typing import Any, NamedTuple

import numpy as np

from lfmesh.geometry.array.gradient_cell import BACK, FRONT, cell_at, follow_in_cell
from lfmesh.geometry.array.lattice import Lattice, centre, is_inside, neighbour
from lfmesh.geometry.array.lenslets import Lenslets, face_normal, shape_of
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.gradient_path import GradientRay
from lfmesh.optics.gradients import field_at
from lfmesh.transport.packets.book import MLA_EDGE, MLA_WALL, TRAPPED, TURNED_BACK
from lfmesh.transport.tables.tables import CellGradients, MlaTables

REACHED = -1
"""In place of a slot of the book: the ray reaches the other face."""


MOST_CELLS = 4_096
"""Cells that a ray may cross between clear walls, before it counts as trapped."""


class CellEnd(NamedTuple):
    """The straight ray that ends as a ray through a lenslet does, in the frame of the face that it goes to.

    Attributes
    ----------
    slot : int
        Slot of the book for the ray's end before the face, or `REACHED`.
    column, row : int
        Cell where it ends.
    x, y, z : float, mm
        Its start.
    dx, dy, dz : float
        Unit direction.
    distance : float, mm
        Length of the curve: the straight ray ends there.
    path : float, mm
        Optical path along the curve.
    """

    slot: int
    column: int
    row: int
    x: float
    y: float
    z: float
    dx: float
    dy: float
    dz: float
    distance: float
    path: float


@inlined
def has_gradient(gradient: Any) -> bool:
    """Tell whether the plate of an array is gradient-index glass; `gradient` : CellGradients or None."""
    return gradient is not None


@inlined
def _axis_of(gradient: CellGradients, lattice: Lattice, column: int, row: int) -> tuple[float, float]:
    """Return the axis of a lenslet's gradient, from the centre of its cell, mm."""
    if len(gradient.axes) == 0:
        return 0.0, 0.0
    cell = row * lattice.columns + column
    return gradient.axes[cell, 0], gradient.axes[cell, 1]


@inlined
def _own_z(mla: MlaTables, z: float) -> float:
    """Return z of a lenslet's own frame from z in the frame of a face, or the reverse."""
    return z if mla.curved_to_lens else mla.lenslets.thickness - z


@kernel
def cross_cells(gradient: CellGradients, mla: MlaTables, colour: int, column: int, row: int, ray: Ray) -> CellEnd:
    """Follow a ray from one face of its lenslet to the other, or to a wall that ends it.

    Parameters
    ----------
    gradient : CellGradients
        Gradient of `mla`.
    mla : MlaTables
        Tables of the face that the ray goes to.
    colour : int
        Wavelength number.
    column, row : int
        Column and row of the lenslet.
    ray : Ray
        From a point of the opposite face into the glass, in the frame of `mla`.
    """
    lattice, fields = mla.lenslets.lattice, gradient.gradients
    flip = 1.0 if mla.curved_to_lens else -1.0
    cx, cy = centre(lattice, column, row)
    axis = _axis_of(gradient, lattice, column, row)
    x, y, z = ray.x - cx - axis[0], ray.y - cy - axis[1], _own_z(mla, ray.z)
    n = np.sqrt(field_at(fields, colour, x, y, z)[0])
    own = GradientRay(x, y, z, n * ray.dx, n * ray.dy, n * flip * ray.dz, 0.0, 0.0)
    longest, steps = gradient.longest[colour], gradient.steps[colour]
    slot = TRAPPED
    for _ in range(MOST_CELLS):
        # The lenslets of the two faces may have different types.
        if mla.curved_to_lens:
            ahead = cell_at(mla.lenslets, gradient.opposite, column, row, axis)
            wall, own = follow_in_cell(fields, colour, ahead, own, longest, steps)
        else:
            behind = cell_at(gradient.opposite, mla.lenslets, column, row, axis)
            wall, own = follow_in_cell(fields, colour, behind, own, longest, steps)
        if wall >= FRONT:
            slot = REACHED if wall == (FRONT if mla.curved_to_lens else BACK) else TURNED_BACK
        if wall < 0 or wall >= FRONT:
            break
        next_column, next_row = neighbour(lattice, column, row, wall)
        if not is_inside(lattice, next_column, next_row):
            slot = MLA_EDGE
            break
        if not gradient.clear_walls:
            slot = MLA_WALL
            break
        # Cells are alike, so nothing else changes at their wall.
        from_x, from_y = centre(lattice, column, row)
        column, row = next_column, next_row
        to_x, to_y = centre(lattice, column, row)
        own = GradientRay(
            own.x + from_x - to_x, own.y + from_y - to_y, own.z, own.tx, own.ty, own.tz, own.path, own.length
        )  # fmt: skip
    cx, cy = centre(lattice, column, row)
    axis = _axis_of(gradient, lattice, column, row)
    over = 1.0 / np.sqrt(own.tx * own.tx + own.ty * own.ty + own.tz * own.tz)
    dx, dy, dz, t = over * own.tx, over * own.ty, flip * over * own.tz, own.length
    x, y, z = own.x + cx + axis[0], own.y + cy + axis[1], _own_z(mla, own.z)
    return CellEnd(slot, column, row, x - t * dx, y - t * dy, z - t * dz, dx, dy, dz, t, own.path)


@kernel
def index_in_cell(
    gradient: CellGradients, mla: MlaTables, colour: int, column: int, row: int, point: tuple[float, float, float]
) -> float:  # fmt: skip
    """Return the refractive index of a lenslet's glass.

    Parameters
    ----------
    gradient, mla, colour, column, row
        As for `cross_cells`.
    point : (3,) float, mm
        Point in the frame of `mla`.
    """
    cx, cy = centre(mla.lenslets.lattice, column, row)
    ax, ay = _axis_of(gradient, mla.lenslets.lattice, column, row)
    x, y, z = point
    return np.sqrt(field_at(gradient.gradients, colour, x - cx - ax, y - cy - ay, _own_z(mla, z))[0])


@inlined
def normal_in_cell(
    lenslets: Lenslets, column: int, row: int, point: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the unit normal of a lenslet's face, into the glass, at a point of it in the frame of the face.

    Parameters
    ----------
    lenslets : Lenslets
    column, row : int
    point : (3,) float, mm
    """
    cx, cy = centre(lenslets.lattice, column, row)
    curvature, ex, ey = shape_of(lenslets, column, row)
    return face_normal(lenslets, column, row, curvature, point[0] - cx - ex, point[1] - cy - ey, point[2])
