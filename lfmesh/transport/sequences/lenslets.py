"""Intersections of ray blocks with both faces of the microlens array, and the way out of the lenslet layer.

Most rays meet a single lenslet of a face and are treated together. Rays close to the border of a cell or of the array,
and all rays at non-spherical lenslets, walk from cell to cell one by one. All coordinates are in the frame of the face,
with z into the glass, see `regions.mla`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import (
    ROW_SPACING,
    Lattice,
    cell_of,
    centre,
    half_hexagon,
    is_inside,
    leaves_at,
    neighbour,
    stays_inside,
)
from lfmesh.geometry.array.lenslets import (
    Lenslets,
    are_alike,
    face_normal,
    face_sag,
    is_spherical,
    meets_profile,
    shape_of,
)
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import conic_distance
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, select
from lfmesh.transport.events.gradient_cell import has_gradient
from lfmesh.transport.packets.book import MLA_EDGE, MLA_MASK, MLA_MOUNT, MLA_WALL
from lfmesh.transport.packets.packet import BACK_FRAME, MLA_FRAME
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    FATE,
    PHASE_X,
    PHASE_Y,
    SCRATCH,
    X,
    Y,
    Z,
    absorb,
    drop,
    end_by_fate,
    move_bundle,
    set_fate,
    set_normal,
)
from lfmesh.transport.sequences.division import divide
from lfmesh.transport.sequences.gradient_lenslets import COLUMN, ROW, divide_in_cells, meet_along_curves
from lfmesh.transport.sequences.kicks import diffract
from lfmesh.transport.sequences.lens_surfaces import sphere_crossing
from lfmesh.transport.tables.tables import AIR, FLAT_ROW, MlaTables

Array = NDArray[np.float64]

MEETS_FACE, LEAVES_LAYER = -1, -2
"""Fates of a ray that does not end in the layer of curved faces."""

# Working rows: the lenslet's centre, apex and curvature; 1 if the ray certainly meets nothing else.
_CENTRE_X, _CENTRE_Y = SCRATCH + 2 * BLOCK, SCRATCH + 3 * BLOCK
_APEX_X, _APEX_Y, _CURVATURE = SCRATCH + 4 * BLOCK, SCRATCH + 5 * BLOCK, SCRATCH + 6 * BLOCK
_CERTAIN = SCRATCH + 7 * BLOCK
# In place of the apex: exit point from the layer of faces.
_OUT_X, _OUT_Y = _APEX_X, _APEX_Y


@kernel
def at_lenslets(bundle: Array, mla: MlaTables, inward: bool, mirrors: bool, colour: int, book: Array) -> None:
    """Take a bundle (frame of the face) through or off the lenslets of a face, and out of their layer.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    mla : MlaTables
        Tables of the face.
    inward : bool
        The rays come from the air.
    mirrors : bool
        Reflect the rays; else refract them.
    colour : int
        Wavelength number.
    book : (slots,) float64
        Receives light absorbed by glass and coating.
    """
    media = mla.media
    if not inward and has_gradient(mla.gradient):
        meet_along_curves(mla.gradient, bundle, mla, colour)
    else:
        _meet_lenslets(bundle, mla, inward)
    _end_on_mask(bundle, mla.lenslets)
    absorb(bundle, media.absorption, AIR if inward else mla.medium, colour, book)
    in_air = inward == mirrors
    if inward:
        diffract(mla.apertures, mla.row, bundle, colour, 1.0)
    _place_on_lenslets(mla.interfaces.phases, bundle, mla.lenslets)
    _divide_at_face(mla.gradient, bundle, mla, inward, mirrors, colour, book)
    if in_air:
        diffract(mla.apertures, mla.row, bundle, colour, -1.0 if mirrors else 1.0)
    elif has_gradient(mla.gradient):
        # Until they reach the other face, rays stay in their cell.
        return
    _find_ways_out(bundle, mla.lenslets, inward != mirrors)
    walked = 0
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[_CERTAIN + i] == 0.0:
            _leave_singly(bundle, i, mla, inward != mirrors, in_air)
            walked += 1
    if walked > 0:
        absorb(bundle, media.absorption, AIR if in_air else mla.medium, colour, book)
        end_by_fate(bundle)


@kernel
def _meet_lenslets(bundle: Array, mla: MlaTables, inward: bool) -> None:
    """Find the intersections of straight rays with the lenslets of a face."""
    if is_spherical(mla.lenslets.profile):
        _meet_single_lenslets(bundle, mla, inward)
    else:
        for i in range(BLOCK):
            bundle[_CERTAIN + i] = 0.0
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[_CERTAIN + i] == 0.0:
            _meet_singly(bundle, i, mla, inward)


@inlined
def _divide_at_face(
    gradient: Any, bundle: Array, mla: MlaTables, inward: bool, mirrors: bool, colour: int, book: Array
) -> None:
    """Divide rays at their lenslets' faces; `gradient` : CellGradients or None."""
    if gradient is None:
        divide(bundle, mla.interfaces, mla.row, colour, _indices(mla, inward, colour), not inward, mirrors, book)
    else:
        divide_in_cells(gradient, bundle, mla, inward, mirrors, colour, book)


@inlined
def _end_on_mask(bundle: Array, lenslets: Lenslets) -> None:
    """End rays that meet a lenslet outside its clear aperture, if smaller than the cell."""
    clear_radius = lenslets.clear_radius
    if clear_radius == np.inf:
        return
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            cx, cy = centre(lenslets.lattice, int(bundle[COLUMN + i]), int(bundle[ROW + i]))
            x, y = bundle[AT_X + i] - cx, bundle[AT_Y + i] - cy
            if not x * x + y * y <= clear_radius * clear_radius:
                bundle[FATE + i] = MLA_MASK + 1.0


@inlined
def _place_on_lenslets(phases: Any, bundle: Array, lenslets: Lenslets) -> None:
    """Set the intersections relative to the lenslets' apexes, for the phase of a face if the array has any.

    Parameters
    ----------
    phases : PhaseFaces or None
    """
    if phases is None:
        return
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            column, row = int(bundle[COLUMN + i]), int(bundle[ROW + i])
            cx, cy = centre(lenslets.lattice, column, row)
            _, ex, ey = shape_of(lenslets, column, row)
            bundle[PHASE_X + i], bundle[PHASE_Y + i] = bundle[AT_X + i] - cx - ex, bundle[AT_Y + i] - cy - ey


@inlined
def _indices(mla: MlaTables, entering: bool, colour: int) -> tuple[float, float]:
    """Return the indices before and after a face of the array, from outside if `entering`."""
    glass, outside = mla.media.indices[mla.medium, colour], mla.media.indices[AIR, colour]
    return (outside, glass) if entering else (glass, outside)


@inlined
def at_other_face(
    back: Any, bundle: Array, mla: MlaTables, entering: bool, mirrors: bool, colour: int, frames: Array, book: Array
) -> None:
    """Take a bundle through or off the flat face, or the lenslets in its place.

    Parameters
    ----------
    back : MlaTables or None
        Back face of `mla`.
    bundle, mla, mirrors, colour, book
        As for `at_lenslets`.
    entering : bool
        The rays come from the air.
    frames : (6, 6, 3, 4) float64
    """
    if back is None:
        _at_flat_face(bundle, mla, entering, mirrors, colour, book)
        return
    move_bundle(bundle, frames[MLA_FRAME, BACK_FRAME])
    at_lenslets(bundle, back, entering, mirrors, colour, book)
    move_bundle(bundle, frames[BACK_FRAME, MLA_FRAME])


@kernel
def _at_flat_face(bundle: Array, mla: MlaTables, entering: bool, mirrors: bool, colour: int, book: Array) -> None:
    _meet_flat_face(bundle, mla.lenslets, entering)
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] == 0.0 and bundle[_CERTAIN + i] == 0.0:
            _meet_flat_face_singly(bundle, i, mla.lenslets, entering)
    absorb(bundle, mla.media.absorption, AIR if entering else mla.medium, colour, book)
    divide(bundle, mla.interfaces, FLAT_ROW, colour, _indices(mla, entering, colour), not entering, mirrors, book)


@inlined
def _safe_extent(lattice: Lattice) -> tuple[float, float]:
    """Return half width and half height of the array's inner cells, mm.

    A straight line between two points within stays over the array.
    """
    across, rows = (ROW_SPACING, 1.0) if lattice.hexagonal else (1.0, 0.5)
    return (0.5 * lattice.columns - 1.0) * lattice.pitch, (0.5 * lattice.rows - rows) * across * lattice.pitch


@kernel
def _meet_flat_face(bundle: Array, lenslets: Any, entering: bool) -> None:
    safe_x, safe_y = _safe_extent(lenslets.lattice)
    z, sense = lenslets.thickness, -1.0 if entering else 1.0
    for i in range(BLOCK):
        t = (z - bundle[Z + i]) / bundle[DZ + i]
        set_fate(bundle, i, t, 0.0)
        bundle[AT_Z + i] = z
        set_normal(bundle, i, 0.0, 0.0, sense)
        holds = both(both(t > 0.0, sense * bundle[DZ + i] > 0.0), _is_safe(bundle, i, safe_x, safe_y, entering))
        bundle[_CERTAIN + i] = select(holds, 1.0, 0.0)


@pasted
def _is_safe(bundle: Array, i: int, safe_x: float, safe_y: float, from_air: bool) -> bool:
    """Tell whether a ray meets a face at the inner cells and, within the glass, starts there too."""
    there = both(abs(bundle[AT_X + i]) <= safe_x, abs(bundle[AT_Y + i]) <= safe_y)
    here = select(from_air, 0.0, select(both(abs(bundle[X + i]) <= safe_x, abs(bundle[Y + i]) <= safe_y), 0.0, 1.0))
    return both(there, here == 0.0)


@kernel
def _meet_flat_face_singly(bundle: Array, i: int, lenslets: Any, entering: bool) -> None:
    """Find one ray's intersection with the flat face, or its end before or beside it."""
    x, y, dz = bundle[X + i], bundle[Y + i], bundle[DZ + i]
    t = (lenslets.thickness - bundle[Z + i]) / dz
    if not t > 0.0 or (dz < 0.0) != entering:
        set_fate(bundle, i, 0.0, MLA_MOUNT + 1.0)
        return
    to_x, to_y = x + t * bundle[DX + i], y + t * bundle[DY + i]
    if entering:
        column, row = cell_of(lenslets.lattice, to_x, to_y)
        held = is_inside(lenslets.lattice, column, row)
    else:
        held = stays_inside(lenslets.lattice, x, y, to_x, to_y)
    set_fate(bundle, i, t, 0.0 if held else (MLA_MOUNT if entering else MLA_EDGE) + 1.0)
    bundle[AT_Z + i] = lenslets.thickness


@kernel
def _meet_single_lenslets(bundle: Array, mla: MlaTables, inward: bool) -> None:
    """Intersect rays with the sphere of the cell where they enter the layer; `_CERTAIN` if in that cell."""
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    safe_x, safe_y = _safe_extent(lattice)
    border = lenslets.top if inward else lenslets.valley
    if lattice.hexagonal:
        _find_hexagonal_cells(bundle, border, lattice.pitch, lattice.columns, lattice.rows)
    else:
        _find_square_cells(bundle, border, lattice.pitch, lattice.columns, lattice.rows)
    if are_alike(lenslets):
        _fill_shapes(bundle, lenslets.curvature[0])
    else:
        for i in range(BLOCK):
            if bundle[_CERTAIN + i] > 0.0:
                curvature, ex, ey = shape_of(lenslets, int(bundle[COLUMN + i]), int(bundle[ROW + i]))
                bundle[_CURVATURE + i] = curvature
                bundle[_APEX_X + i], bundle[_APEX_Y + i] = bundle[_CENTRE_X + i] + ex, bundle[_CENTRE_Y + i] + ey
    _meet_spheres(bundle, 1.0 if inward else -1.0, safe_x, safe_y)
    _keep_in_cells(bundle, AT_X, lattice.hexagonal, 0.5 * lattice.pitch)


@kernel
def _find_square_cells(bundle: Array, border: float, pitch: float, columns: int, rows: int) -> None:
    """Find the cell where each ray enters the layer, at z = `border`."""
    over = 1.0 / pitch
    for i in range(BLOCK):
        t = (border - bundle[Z + i]) / bundle[DZ + i]
        t = select(t > 0.0, t, 0.0)
        column = np.floor((bundle[X + i] + t * bundle[DX + i]) * over + 0.5 * columns)
        row = np.floor((bundle[Y + i] + t * bundle[DY + i]) * over + 0.5 * rows)
        bundle[_CENTRE_X + i] = (column - 0.5 * (columns - 1)) * pitch
        bundle[_CENTRE_Y + i] = (row - 0.5 * (rows - 1)) * pitch
        _enter_cell(bundle, i, column, row, columns, rows)


@pasted
def _enter_cell(bundle: Array, i: int, column: float, row: float, columns: int, rows: int) -> None:
    inside = both(both(column >= 0.0, column < columns), both(row >= 0.0, row < rows))
    bundle[COLUMN + i], bundle[ROW + i] = column, row
    bundle[_CERTAIN + i] = select(both(inside, bundle[ENDED_ON + i] == 0.0), 1.0, 0.0)


@pasted
def _nearest_in_row(u: float, v: float, row: float, columns: int, rows: int) -> tuple[float, float, float, float]:
    """Return the column of a row's nearest centre, that centre, and its squared distance."""
    shift = row - 2.0 * np.floor(0.5 * row)
    shift = 0.5 * shift - (0.25 if rows > 1 else 0.0)
    column = np.floor(u - shift + 0.5 * columns)
    x, y = column - 0.5 * (columns - 1) + shift, (row - 0.5 * (rows - 1)) * ROW_SPACING
    return column, x, y, (u - x) * (u - x) + (v - y) * (v - y)


@kernel
def _find_hexagonal_cells(bundle: Array, border: float, pitch: float, columns: int, rows: int) -> None:
    over = 1.0 / pitch
    for i in range(BLOCK):
        t = (border - bundle[Z + i]) / bundle[DZ + i]
        t = select(t > 0.0, t, 0.0)
        u, v = (bundle[X + i] + t * bundle[DX + i]) * over, (bundle[Y + i] + t * bundle[DY + i]) * over
        # The nearest centre is in the row below the point or the row above it.
        low = np.floor(v / ROW_SPACING + 0.5 * (rows - 1))
        column, x, y, square = _nearest_in_row(u, v, low, columns, rows)
        other, other_x, other_y, other_square = _nearest_in_row(u, v, low + 1.0, columns, rows)
        above = other_square < square
        bundle[_CENTRE_X + i] = select(above, other_x, x) * pitch
        bundle[_CENTRE_Y + i] = select(above, other_y, y) * pitch
        _enter_cell(bundle, i, select(above, other, column), select(above, low + 1.0, low), columns, rows)


@kernel
def _fill_shapes(bundle: Array, curvature: float) -> None:
    for i in range(BLOCK):
        bundle[_CURVATURE + i] = curvature
        bundle[_APEX_X + i], bundle[_APEX_Y + i] = bundle[_CENTRE_X + i], bundle[_CENTRE_Y + i]


@kernel
def _meet_spheres(bundle: Array, sense: float, safe_x: float, safe_y: float) -> None:
    """Intersect rays with the apex half of their lenslets' spheres; certain only at the inner cells."""
    from_air = sense > 0.0
    for i in range(BLOCK):
        c = bundle[_CURVATURE + i]
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        # Measured from the plane of the apex, as a ray from far to a small lenslet would lose digits.
        at = -z / dz
        ax, ay = x + at * dx - bundle[_APEX_X + i], y + at * dy - bundle[_APEX_Y + i]
        root, cos_i, above, below = sphere_crossing(c * sense, Ray(ax, ay, 0.0, dx, dy, dz), sense)
        t = above / below
        rx, ry, pz = ax + t * dx, ay + t * dy, t * dz
        bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i] = rx + bundle[_APEX_X + i], ry + bundle[_APEX_Y + i], pz
        set_normal(bundle, i, -c * rx * sense, -c * ry * sense, (1.0 - c * pz) * sense)
        bundle[FATE + i] = 0.0
        holds = both(both(root > 0.0, sense * dz > 0.0), both(both(at + t > 0.0, c * pz < 1.0), cos_i > 0.0))
        holds = both(holds, _is_safe(bundle, i, safe_x, safe_y, from_air))
        bundle[_CERTAIN + i] = select(holds, bundle[_CERTAIN + i], 0.0)


@kernel
def _keep_in_cells(bundle: Array, row: int, hexagonal: bool, half: float) -> None:
    """Clear the certainty of rays with a point, in `row` and the next, outside their cell."""
    if hexagonal:
        for i in range(BLOCK):
            x, y = bundle[row + i] - bundle[_CENTRE_X + i], bundle[row + BLOCK + i] - bundle[_CENTRE_Y + i]
            bundle[_CERTAIN + i] = select(half_hexagon(x, y) <= half, bundle[_CERTAIN + i], 0.0)
    else:
        for i in range(BLOCK):
            x, y = bundle[row + i] - bundle[_CENTRE_X + i], bundle[row + BLOCK + i] - bundle[_CENTRE_Y + i]
            bundle[_CERTAIN + i] = select(both(abs(x) <= half, abs(y) <= half), bundle[_CERTAIN + i], 0.0)


@kernel
def _find_ways_out(bundle: Array, lenslets: Any, into_glass: bool) -> None:
    """Keep certain only rays that leave the layer within their cell, in the right direction."""
    out, sense = (lenslets.valley, 1.0) if into_glass else (lenslets.top, -1.0)
    for i in range(BLOCK):
        t = (out - bundle[Z + i]) / bundle[DZ + i]
        bundle[_OUT_X + i], bundle[_OUT_Y + i] = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        bundle[_CERTAIN + i] = select(bundle[DZ + i] * sense > 0.0, bundle[_CERTAIN + i], 0.0)
        set_fate(bundle, i, 0.0, 0.0)
    _keep_in_cells(bundle, _OUT_X, lenslets.lattice.hexagonal, 0.5 * lenslets.lattice.pitch)


@kernel
def _meet_singly(bundle: Array, i: int, mla: MlaTables, inward: bool) -> None:
    """Find one ray's lenslet and intersection, or its end before, or passage through, the layer."""
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z, dz = bundle[X + i], bundle[Y + i], bundle[Z + i], bundle[DZ + i]
    if (dz > 0.0) != inward or (inward and z > lenslets.valley):
        set_fate(bundle, i, 0.0, MLA_MOUNT + 1.0)
        return
    t = max(0.0, ((lenslets.top if inward else lenslets.valley) - z) / dz)
    at_x, at_y = x + t * bundle[DX + i], y + t * bundle[DY + i]
    column, row = cell_of(lattice, at_x, at_y)
    if not (is_inside(lattice, column, row) if inward else stays_inside(lattice, x, y, at_x, at_y)):
        set_fate(bundle, i, t, (MLA_MOUNT if inward else MLA_EDGE) + 1.0)
        return
    fate, t, column, row = _next_in_layer(bundle, i, mla, inward, column, row, t)
    set_fate(bundle, i, t, fate + 1.0 if fate >= 0 else (0.0 if fate == MEETS_FACE else DROPPED))
    bundle[COLUMN + i], bundle[ROW + i] = column, row
    if fate == MEETS_FACE:
        cx, cy = centre(lattice, column, row)
        curvature, ex, ey = shape_of(lenslets, column, row)
        sense = 1.0 if inward else -1.0
        nx, ny, nz = face_normal(
            lenslets, column, row, curvature, bundle[AT_X + i] - cx - ex, bundle[AT_Y + i] - cy - ey, bundle[AT_Z + i]
        )
        set_normal(bundle, i, sense * nx, sense * ny, sense * nz)


@kernel
def _leave_singly(bundle: Array, i: int, mla: MlaTables, into_glass: bool, in_air: bool) -> None:
    """Find one ray's exit from the layer of faces, or the wall that ends it before.

    A ray that turns back or meets another face is dropped.
    """
    if (bundle[DZ + i] > 0.0) != into_glass:
        drop(bundle, i)
        return
    column, row = int(bundle[COLUMN + i]), int(bundle[ROW + i])
    fate, t, column, row = _next_in_layer(bundle, i, mla, in_air, column, row, 0.0)
    if fate >= 0:
        set_fate(bundle, i, t, fate + 1.0)
    elif fate != LEAVES_LAYER:
        drop(bundle, i)


@kernel
def _next_in_layer(
    bundle: Array, i: int, mla: MlaTables, in_air: bool, column: int, row: int, start: float
) -> tuple[int, float, int, int]:
    """Walk a ray through the layer; return its fate (or book slot), the distance and the cell.

    Parameters
    ----------
    in_air : bool
        The ray is before the curved face; else in the glass.
    column, row : int
        Cell where the walk starts.
    start : float, mm
        Distance at which the ray is in that cell.
    """
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
    dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
    out = ((lenslets.valley if dz > 0.0 else lenslets.top) - z) / dz
    t = start
    # Each step follows the ray's direction, so the walk ends at the array's edge at the latest.
    while True:
        cx, cy = centre(lattice, column, row)
        curvature, ex, ey = shape_of(lenslets, column, row)
        leaves, side = leaves_at(lattice, x - cx, y - cy, dx, dy)
        if is_spherical(lenslets.profile):
            met, more = conic_distance(
                curvature, 0.0, Ray(x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz, dx, dy, dz),
                1.0 if in_air else -1.0,
            )  # fmt: skip
            hit = t + more
            # A hit beyond the layer is on the sphere's other half.
            met = met and 0.0 < hit <= leaves and curvature * (z + hit * dz) < 1.0
        else:
            met, hit = meets_profile(
                lenslets.profile, lenslets, column, row, Ray(x - cx, y - cy, z, dx, dy, dz), in_air, t, min(leaves, out)
            )
        if met:
            return MEETS_FACE, hit, column, row
        if out < leaves:
            return LEAVES_LAYER, out, column, row
        t = leaves
        column, row = neighbour(lattice, column, row, side)
        if not is_inside(lattice, column, row):
            return MLA_MOUNT if in_air else MLA_EDGE, t, column, row
        if not are_alike(lenslets):
            cx, cy = centre(lattice, column, row)
            curvature, ex, ey = shape_of(lenslets, column, row)
            face = face_sag(lenslets, column, row, curvature, x + t * dx - cx - ex, y + t * dy - cy - ey)
            if (z + t * dz > face) == in_air:
                return MLA_WALL, t, column, row
