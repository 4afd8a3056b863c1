"""A block of rays through the microlens array, for rays that meet a single lenslet of each curved face.

Most do. The others, close to the border of a cell or of the array, keep their state, and `image_path` walks them from
cell to cell. All in the array frame, see `regions.mla`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice, half_hexagon
from lfmesh.geometry.array.lenslets import are_alike, shape_of
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, select
from lfmesh.transport.packets.packet import BACK_FRAME, MLA_FRAME
from lfmesh.transport.sequential.lens_bundle import (
    BLOCK,
    DX,
    DY,
    DZ,
    ENDED_ON,
    LEFT_BEHIND,
    MET,
    SCRATCH,
    WEIGHT,
    X,
    Y,
    Z,
    refraction,
    sphere_distance,
)
from lfmesh.transport.tables.tables import FLAT_ROW, Interfaces, MlaTables

Array = NDArray[np.float64]

# Working rows: the tentative state, whether it is valid (in the end: whether the ray passed the array), and the
# lenslet: its cell, the centre of that, its apex and its curvature.
_X, _Y, _Z = SCRATCH, SCRATCH + BLOCK, SCRATCH + 2 * BLOCK
_DX, _DY, _DZ = SCRATCH + 3 * BLOCK, SCRATCH + 4 * BLOCK, SCRATCH + 5 * BLOCK
_WEIGHT, _LEFT_BEHIND, PASSED = SCRATCH + 6 * BLOCK, SCRATCH + 7 * BLOCK, SCRATCH + 8 * BLOCK
_COLUMN, _ROW, _CENTRE_X, _CENTRE_Y = (
    SCRATCH + 9 * BLOCK, SCRATCH + 10 * BLOCK, SCRATCH + 11 * BLOCK, SCRATCH + 12 * BLOCK,
)  # fmt: skip
_APEX_X, _APEX_Y, _CURVATURE = SCRATCH + 13 * BLOCK, SCRATCH + 14 * BLOCK, SCRATCH + 15 * BLOCK


@kernel
def through_single_lenslets(bundle: Array, mla: MlaTables, colour: int, inward: bool, frames: Array) -> None:
    """Take the rays of a bundle that meet a single lenslet through the array; `PASSED` marks these rays.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Array frame.
    mla : MlaTables
    colour : int
        Number of the wavelength.
    inward : bool
        The rays meet the curved face first.
    frames : (6, 6, 3, 4) float64
    """
    glass = mla.media.indices[mla.medium, colour]
    _begin(bundle)
    if not inward:
        _through_other_face(mla.back, bundle, mla, colour, False, glass, frames)
    _through_lenslets(bundle, mla, colour, inward, glass)
    if inward:
        _through_other_face(mla.back, bundle, mla, colour, True, glass, frames)
    _commit(bundle)


@inlined
def _safe_extent(lattice: Lattice) -> tuple[float, float]:
    """Return half width and half height of the cells that are not outermost, mm.

    Between two points within them, a straight line stays over the array.
    """
    across, rows = (ROW_SPACING, 1.0) if lattice.hexagonal else (1.0, 0.5)
    return (0.5 * lattice.columns - 1.0) * lattice.pitch, (0.5 * lattice.rows - rows) * across * lattice.pitch


@kernel
def _through_lenslets(bundle: Array, mla: MlaTables, colour: int, inward: bool, glass: float) -> None:
    """Take the tentative rays through the lenslets of one face, in its frame."""
    lenslets, interfaces, number = mla.lenslets, mla.interfaces, mla.row
    lattice = lenslets.lattice
    safe_x, safe_y = _safe_extent(lattice)
    _find_cells(bundle, lattice, lenslets.top if inward else lenslets.valley)
    _look_up_shapes(bundle, mla)
    out = lenslets.valley if inward else lenslets.top
    n_i, n_t, sense = (1.0, glass, 1.0) if inward else (glass, 1.0, -1.0)
    if lattice.hexagonal:
        _through_hexagonal_lenslet(
            bundle, interfaces, number, colour, lattice.pitch, safe_x, safe_y, out, sense, n_i, n_t
        )
    else:
        _through_square_lenslet(bundle, interfaces, number, colour, lattice.pitch, safe_x, safe_y, out, sense, n_i, n_t)


@inlined
def _through_other_face(
    back: Any, bundle: Array, mla: MlaTables, colour: int, outward: bool, glass: float, frames: Array
) -> None:
    """Take the tentative rays through the flat face, or the lenslets in its place; `outward`: from the glass."""
    if back is None:
        safe_x, safe_y = _safe_extent(mla.lenslets.lattice)
        toward, n_i, n_t = (1.0, glass, 1.0) if outward else (-1.0, 1.0, glass)
        _through_flat_face(
            bundle, mla.interfaces, colour, mla.lenslets.thickness, safe_x, safe_y, toward, n_i, n_t
        )  # fmt: skip
        return
    _move(bundle, frames[MLA_FRAME, BACK_FRAME])
    _through_lenslets(bundle, back, colour, not outward, glass)
    _move(bundle, frames[BACK_FRAME, MLA_FRAME])


@kernel
def _move(bundle: Array, move: Array) -> None:
    """Move the tentative rays into the frame of the array's other face, whose axes are parallel: by a (3, 4) move."""
    shift_x, shift_y, shift_z = move[0, 3], move[1, 3], move[2, 3]
    for i in range(BLOCK):
        bundle[_X + i], bundle[_Y + i], bundle[_Z + i] = (
            bundle[_X + i] + shift_x, bundle[_Y + i] + shift_y, shift_z - bundle[_Z + i],
        )  # fmt: skip
        bundle[_DZ + i] = -bundle[_DZ + i]


@kernel
def _begin(bundle: Array) -> None:
    for i in range(BLOCK):
        bundle[_X + i], bundle[_Y + i], bundle[_Z + i] = bundle[X + i], bundle[Y + i], bundle[Z + i]
        bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i] = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        bundle[_WEIGHT + i], bundle[_LEFT_BEHIND + i] = bundle[WEIGHT + i], bundle[LEFT_BEHIND + i]
        bundle[PASSED + i] = select(bundle[ENDED_ON + i] == 0.0, 1.0, 0.0)


@kernel
def _commit(bundle: Array) -> None:
    for i in range(BLOCK):
        holds = bundle[PASSED + i] > 0.0
        bundle[X + i] = select(holds, bundle[_X + i], bundle[X + i])
        bundle[Y + i] = select(holds, bundle[_Y + i], bundle[Y + i])
        bundle[Z + i] = select(holds, bundle[_Z + i], bundle[Z + i])
        bundle[DX + i] = select(holds, bundle[_DX + i], bundle[DX + i])
        bundle[DY + i] = select(holds, bundle[_DY + i], bundle[DY + i])
        bundle[DZ + i] = select(holds, bundle[_DZ + i], bundle[DZ + i])
        bundle[WEIGHT + i] = select(holds, bundle[_WEIGHT + i], bundle[WEIGHT + i])
        bundle[LEFT_BEHIND + i] = select(holds, bundle[_LEFT_BEHIND + i], bundle[LEFT_BEHIND + i])
        bundle[MET + i] += select(holds, 2.0, 0.0)


@pasted
def _bend(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, i: int, holds: bool,
    px: float, py: float, pz: float, nx: float, ny: float, nz: float,
    cos_i: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    """Refract the tentative state at a point whose unit normal points along the ray."""
    weight = bundle[_WEIGHT + i]
    ux, uy, uz, total, transmittance = refraction(
        interfaces, number, colour, bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i], nx, ny, nz, cos_i, n_i, n_t
    )
    bundle[PASSED + i] = select(both(both(holds, cos_i > 0.0), not total), bundle[PASSED + i], 0.0)
    bundle[_X + i], bundle[_Y + i], bundle[_Z + i] = px, py, pz
    bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i] = ux, uy, uz
    on = weight * transmittance
    bundle[_LEFT_BEHIND + i] += weight - on
    bundle[_WEIGHT + i] = on


@kernel
def _through_flat_face(
    bundle: Array, interfaces: Interfaces, colour: int,
    z: float, safe_x: float, safe_y: float, toward: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    for i in range(BLOCK):
        t = (z - bundle[_Z + i]) / bundle[_DZ + i]
        x, y = bundle[_X + i] + t * bundle[_DX + i], bundle[_Y + i] + t * bundle[_DY + i]
        holds = both(t > 0.0, both(abs(x) <= safe_x, abs(y) <= safe_y))
        _bend(
            bundle, interfaces, FLAT_ROW, colour, i, holds, x, y, z, 0.0, 0.0, toward, toward * bundle[_DZ + i],
            n_i, n_t,
        )  # fmt: skip


@kernel
def _find_cells(bundle: Array, lattice: Lattice, border: float) -> None:
    """Find the cell in which each ray enters the layer of faces, at z = `border`."""
    if lattice.hexagonal:
        _find_hexagonal_cells(bundle, border, lattice.pitch, lattice.columns, lattice.rows)
    else:
        _find_square_cells(bundle, border, lattice.pitch, lattice.columns, lattice.rows)


@kernel
def _find_square_cells(bundle: Array, border: float, pitch: float, columns: int, rows: int) -> None:
    over = 1.0 / pitch
    for i in range(BLOCK):
        t = (border - bundle[_Z + i]) / bundle[_DZ + i]
        t = select(t > 0.0, t, 0.0)
        column = np.floor((bundle[_X + i] + t * bundle[_DX + i]) * over + 0.5 * columns)
        row = np.floor((bundle[_Y + i] + t * bundle[_DY + i]) * over + 0.5 * rows)
        bundle[_COLUMN + i], bundle[_ROW + i] = column, row
        bundle[_CENTRE_X + i] = (column - 0.5 * (columns - 1)) * pitch
        bundle[_CENTRE_Y + i] = (row - 0.5 * (rows - 1)) * pitch
        inside = both(both(column >= 0.0, column < columns), both(row >= 0.0, row < rows))
        bundle[PASSED + i] = select(inside, bundle[PASSED + i], 0.0)


@pasted
def _nearest_in_row(u: float, v: float, row: float, columns: int, rows: int) -> tuple[float, float, float, float]:
    """Return the column of a row's centre that is nearest to a point, that centre, and its squared distance."""
    shift = row - 2.0 * np.floor(0.5 * row)
    shift = 0.5 * shift - (0.25 if rows > 1 else 0.0)
    column = np.floor(u - shift + 0.5 * columns)
    x, y = column - 0.5 * (columns - 1) + shift, (row - 0.5 * (rows - 1)) * ROW_SPACING
    return column, x, y, (u - x) * (u - x) + (v - y) * (v - y)


@kernel
def _find_hexagonal_cells(bundle: Array, border: float, pitch: float, columns: int, rows: int) -> None:
    over = 1.0 / pitch
    for i in range(BLOCK):
        t = (border - bundle[_Z + i]) / bundle[_DZ + i]
        t = select(t > 0.0, t, 0.0)
        u, v = (bundle[_X + i] + t * bundle[_DX + i]) * over, (bundle[_Y + i] + t * bundle[_DY + i]) * over
        # The nearest centre is in the row of centres below the point or in the row above it.
        low = np.floor(v / ROW_SPACING + 0.5 * (rows - 1))
        column, x, y, square = _nearest_in_row(u, v, low, columns, rows)
        other, other_x, other_y, other_square = _nearest_in_row(u, v, low + 1.0, columns, rows)
        above = other_square < square
        column, row = select(above, other, column), select(above, low + 1.0, low)
        bundle[_COLUMN + i], bundle[_ROW + i] = column, row
        bundle[_CENTRE_X + i] = select(above, other_x, x) * pitch
        bundle[_CENTRE_Y + i] = select(above, other_y, y) * pitch
        inside = both(both(column >= 0.0, column < columns), both(row >= 0.0, row < rows))
        bundle[PASSED + i] = select(inside, bundle[PASSED + i], 0.0)


@kernel
def _look_up_shapes(bundle: Array, mla: MlaTables) -> None:
    """Write apex and curvature of each ray's lenslet to the working rows."""
    lenslets = mla.lenslets
    if are_alike(lenslets):
        _fill_shapes(bundle, lenslets.curvature[0])
        return
    for i in range(BLOCK):
        if bundle[PASSED + i] > 0.0:
            curvature, ex, ey = shape_of(lenslets, int(bundle[_COLUMN + i]), int(bundle[_ROW + i]))
            bundle[_CURVATURE + i] = curvature
            bundle[_APEX_X + i], bundle[_APEX_Y + i] = bundle[_CENTRE_X + i] + ex, bundle[_CENTRE_Y + i] + ey


@kernel
def _fill_shapes(bundle: Array, curvature: float) -> None:
    for i in range(BLOCK):
        bundle[_CURVATURE + i] = curvature
        bundle[_APEX_X + i], bundle[_APEX_Y + i] = bundle[_CENTRE_X + i], bundle[_CENTRE_Y + i]


@pasted
def _meet_face(bundle: Array, i: int, sense: float) -> tuple[bool, float, float, float, float, float, float, float]:
    """Return whether a ray meets its lenslet's sphere on the apex's half, the point, the normal and the cosine."""
    c = bundle[_CURVATURE + i]
    x, y, z = bundle[_X + i], bundle[_Y + i], bundle[_Z + i]
    dx, dy, dz = bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i]
    # Counted from the plane of the apex, as digits would be lost when a ray comes from far to a small lenslet.
    at = -z / dz
    ax, ay = x + at * dx - bundle[_APEX_X + i], y + at * dy - bundle[_APEX_Y + i]
    meets, t, cos_i = sphere_distance(c, ax, ay, 0.0, dx, dy, dz, sense)
    rx, ry, pz = ax + t * dx, ay + t * dy, t * dz
    holds = both(meets, both(at + t > 0.0, c * pz < 1.0))
    nx, ny, nz = -c * rx * sense, -c * ry * sense, (1.0 - c * pz) * sense
    return holds, rx + bundle[_APEX_X + i], ry + bundle[_APEX_Y + i], pz, nx, ny, nz, cos_i


@kernel
def _through_square_lenslet(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    pitch: float, safe_x: float, safe_y: float, out: float, sense: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    half = 0.5 * pitch
    for i in range(BLOCK):
        holds, px, py, pz, nx, ny, nz, cos_i = _meet_face(bundle, i, sense)
        x, y = px - bundle[_CENTRE_X + i], py - bundle[_CENTRE_Y + i]
        holds = both(both(holds, both(abs(px) <= safe_x, abs(py) <= safe_y)), both(abs(x) <= half, abs(y) <= half))
        _bend(bundle, interfaces, number, colour, i, holds, px, py, pz, nx, ny, nz, cos_i, n_i, n_t)
        t = (out - pz) / bundle[_DZ + i]
        x, y = x + t * bundle[_DX + i], y + t * bundle[_DY + i]
        holds = both(bundle[_DZ + i] * sense > 0.0, both(abs(x) <= half, abs(y) <= half))
        bundle[PASSED + i] = select(holds, bundle[PASSED + i], 0.0)


@kernel
def _through_hexagonal_lenslet(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    pitch: float, safe_x: float, safe_y: float, out: float, sense: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    half = 0.5 * pitch
    for i in range(BLOCK):
        holds, px, py, pz, nx, ny, nz, cos_i = _meet_face(bundle, i, sense)
        x, y = px - bundle[_CENTRE_X + i], py - bundle[_CENTRE_Y + i]
        holds = both(both(holds, both(abs(px) <= safe_x, abs(py) <= safe_y)), half_hexagon(x, y) <= half)
        _bend(bundle, interfaces, number, colour, i, holds, px, py, pz, nx, ny, nz, cos_i, n_i, n_t)
        t = (out - pz) / bundle[_DZ + i]
        x, y = x + t * bundle[_DX + i], y + t * bundle[_DY + i]
        holds = both(bundle[_DZ + i] * sense > 0.0, half_hexagon(x, y) <= half)
        bundle[PASSED + i] = select(holds, bundle[PASSED + i], 0.0)
