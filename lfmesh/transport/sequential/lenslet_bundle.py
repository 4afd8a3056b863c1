"""A block of rays through the microlens array, for rays that meet a single lenslet.

Most do. The others, close to the border of a cell or of the array, keep their state, and `image_path` walks them from
cell to cell. All in the array frame, see `regions.mla`.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lattice import ROW_SPACING, Lattice, half_hexagon
from lfmesh.geometry.lenslets import are_alike, shape_of
from lfmesh.kernel import kernel, pasted
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
from lfmesh.transport.tables.tables import CURVED_ROW, FLAT_ROW, Interfaces, MlaTables
from lfmesh.vector import both, select

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
def through_single_lenslets(bundle: Array, mla: MlaTables, colour: int, inward: bool) -> None:
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
    """
    lenslets = mla.lenslets
    lattice, interfaces, glass = lenslets.lattice, mla.interfaces, mla.media.indices[mla.medium, colour]
    # Between two points within the cells that are not outermost, a straight line stays over the array.
    across, rows = (ROW_SPACING, 1.0) if lattice.hexagonal else (1.0, 0.5)
    safe_x, safe_y = (0.5 * lattice.columns - 1.0) * lattice.pitch, (0.5 * lattice.rows - rows) * across * lattice.pitch
    _begin(bundle)
    if not inward:
        _through_flat_face(bundle, interfaces, colour, lenslets.thickness, safe_x, safe_y, -1.0, 1.0, glass)
    _find_cells(bundle, lattice, lenslets.top if inward else lenslets.valley)
    _look_up_shapes(bundle, mla)
    out = lenslets.valley if inward else lenslets.top
    n_i, n_t, sense = (1.0, glass, 1.0) if inward else (glass, 1.0, -1.0)
    if lattice.hexagonal:
        _through_hexagonal_lenslet(bundle, interfaces, colour, lattice.pitch, safe_x, safe_y, out, sense, n_i, n_t)
    else:
        _through_square_lenslet(bundle, interfaces, colour, lattice.pitch, safe_x, safe_y, out, sense, n_i, n_t)
    if inward:
        _through_flat_face(bundle, interfaces, colour, lenslets.thickness, safe_x, safe_y, 1.0, glass, 1.0)
    _commit(bundle)


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
    bundle: Array, interfaces: Interfaces, colour: int,
    pitch: float, safe_x: float, safe_y: float, out: float, sense: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    half = 0.5 * pitch
    for i in range(BLOCK):
        holds, px, py, pz, nx, ny, nz, cos_i = _meet_face(bundle, i, sense)
        x, y = px - bundle[_CENTRE_X + i], py - bundle[_CENTRE_Y + i]
        holds = both(both(holds, both(abs(px) <= safe_x, abs(py) <= safe_y)), both(abs(x) <= half, abs(y) <= half))
        _bend(bundle, interfaces, CURVED_ROW, colour, i, holds, px, py, pz, nx, ny, nz, cos_i, n_i, n_t)
        t = (out - pz) / bundle[_DZ + i]
        x, y = x + t * bundle[_DX + i], y + t * bundle[_DY + i]
        holds = both(bundle[_DZ + i] * sense > 0.0, both(abs(x) <= half, abs(y) <= half))
        bundle[PASSED + i] = select(holds, bundle[PASSED + i], 0.0)


@kernel
def _through_hexagonal_lenslet(
    bundle: Array, interfaces: Interfaces, colour: int,
    pitch: float, safe_x: float, safe_y: float, out: float, sense: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    half = 0.5 * pitch
    for i in range(BLOCK):
        holds, px, py, pz, nx, ny, nz, cos_i = _meet_face(bundle, i, sense)
        x, y = px - bundle[_CENTRE_X + i], py - bundle[_CENTRE_Y + i]
        holds = both(both(holds, both(abs(px) <= safe_x, abs(py) <= safe_y)), half_hexagon(x, y) <= half)
        _bend(bundle, interfaces, CURVED_ROW, colour, i, holds, px, py, pz, nx, ny, nz, cos_i, n_i, n_t)
        t = (out - pz) / bundle[_DZ + i]
        x, y = x + t * bundle[_DX + i], y + t * bundle[_DY + i]
        holds = both(bundle[_DZ + i] * sense > 0.0, half_hexagon(x, y) <= half)
        bundle[PASSED + i] = select(holds, bundle[PASSED + i], 0.0)
