"""The microlens array in the mesh engine, folded: all lenslets of a type share one cell mesh about their centre.

Array frame: z runs from the curved face into the glass. Space 0 is outside, in front of the curved face, 1 the glass, 2
outside, behind the flat face. The curved faces lie in the thin layer top ≤ z ≤ valley, the only place where a ray
belongs to a cell. If it leaves the cell sideways first, it walks into the next cell. Below the layer the glass is one
plate. The flat face is one plane and needs no Embree query. In a gradient-index plate a ray stays in the cell where it
entered, up to the other face, and its curve decides.

If the lenslets are exact spheres, a ray in a cell can only meet the sphere of that cell, the cell's sides and the
borders of the layer. Their distances decide without a query; undecided packets go to the station of the cells' meshes.
Other exact profiles are met by steps that miss no crossing, which always decides.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import centre, is_inside, leaves_at, neighbour
from lfmesh.geometry.array.lenslets import (
    are_alike,
    border_sag,
    face_normal,
    face_sag,
    is_spherical,
    leaves_face,
    meets_profile,
    shape_of,
    type_of,
)
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import conic_distance
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import end, requery, too_deep, write_query
from lfmesh.transport.events.facets import clear_of, facet_normal, meets_patch, next_query_from
from lfmesh.transport.events.gradient_cell import has_gradient
from lfmesh.transport.events.interface import is_rough, scatterer, splitter
from lfmesh.transport.events.kick import kicked
from lfmesh.transport.events.phase import light_at_phase, order_splitter
from lfmesh.transport.events.travel import arrive, travel
from lfmesh.transport.packets.book import EVANESCENT, LOST_IN_MLA, MLA_EDGE, MLA_MOUNT, MLA_WALL
from lfmesh.transport.packets.packet import LEFT_FACE, NO_SURFACE, PLATE, S_ABSORBED, Flow, Options, put
from lfmesh.transport.paths.automaton import NEXT_LENSLET
from lfmesh.transport.regions import lens_block as rows
from lfmesh.transport.regions.lens_block import BLOCK, meet_in_order, set_only_conic, set_ray, split_block
from lfmesh.transport.regions.mla_gradient import meets_along_curve
from lfmesh.transport.regions.mla_plate import (
    BEFORE,
    GLASS,
    ends_on_mask,
    leave_mla,
    medium_of,
    scattered_at_face,
    set_local_sides,
    set_sides,
    shares_at_face,
)
from lfmesh.transport.tables.tables import AIR, MlaTables

Array = NDArray[np.float64]


UNSURE = 1e-9
"""Relative distance to the border of a cell, or of the layer, within which a hit is left to the mesh."""


ROUNDED = 1e-12
"""Relative distance beyond the border of a cell, or of the layer, at which a hit is accepted as rounding."""


@inlined
def fold_of(mla: MlaTables, column: int, row: int) -> tuple[float, float]:
    """Return the x and y offsets, mm, from the cell mesh in Embree's scene to a lenslet.

    Parameters
    ----------
    mla : MlaTables
    column, row : int
        Of the lenslet.
    """
    cx, cy = centre(mla.lenslets.lattice, column, row)
    return cx - type_of(mla.lenslets, column, row) * mla.type_shift, cy


@kernel
def admit_to_cells(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], mla: MlaTables
) -> None:
    """Write the rays of a wave for Embree, moved to the cell mesh of their lenslets.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Written.
    mla : MlaTables
    """
    for i in range(len(wave)):
        fold_x, fold_y = fold_of(mla, wave[i].column, wave[i].row)
        write_query(origins, directions, i, wave[i], fold_x, fold_y)


@kernel
def shade_cells(
    wave: NDArray[np.void], found: NDArray[np.int32], block: Array, met: NDArray[np.int64],
    mla: MlaTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow, in_order: bool,
) -> None:  # fmt: skip
    """Process a wave in the layer: find hits on the cells' faces in float64, and split packets there.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets that Embree found; −1: none. Not read if `in_order`.
    block : (ROWS · BLOCK,) float64
    met : (BLOCK,) int64
        Working memory.
    lens_surfaces : int
        Refracting surfaces of the lens.
    in_order : bool
        The lenslets are exact spheres, met without a query.
    """
    for first in range(0, len(wave), BLOCK):
        count = min(BLOCK, len(wave) - first)
        if in_order and is_spherical(mla.lenslets.profile):
            for i in range(count):
                _enter_cell(block, i, wave[first + i], mla)
            meet_in_order(block)
        for i in range(count):
            prim = NO_SURFACE if in_order else found[first + i]
            met[i] = _meets_face(
                block, i, wave[first + i], prim, mla, frames, lens_surfaces, options, flow, in_order
            )  # fmt: skip
        split_block(block)
        for i in range(count):
            if met[i] != NO_SURFACE:
                prim = NO_SURFACE if in_order else found[first + i]
                _through_face(block, i, wave[first + i], prim, mla, frames, lens_surfaces, options, flow)


@inlined
def _enter_cell(block: Array, i: int, packet: Any, mla: MlaTables) -> None:
    """Enter a packet and its cell's sphere in the block for `meet_in_order`, relative to the lenslet's apex."""
    column, row = packet.column, packet.row
    cx, cy = centre(mla.lenslets.lattice, column, row)
    curvature, ex, ey = shape_of(mla.lenslets, column, row)
    inward = packet.space == BEFORE
    set_ray(block, i, packet)
    block[rows.X + i], block[rows.Y + i] = packet.x - cx - ex, packet.y - cy - ey
    set_only_conic(block, i, curvature, 1.0, 0.0, np.inf, 1.0 if inward else -1.0)
    set_sides(block, i, packet, mla, not inward, mla.row)
    block[rows.NEXT_N + i], block[rows.NEXT_NUMBER + i] = block[rows.N_T + i], mla.row


@inlined
def _sense_at(sense: float, _: int) -> float:
    """Return the sense of a packet's crossing of its cell's face."""
    return sense


_first_patch = patch_finder(_sense_at)


@inlined
def _meets_face(
    block: Array, i: int, packet: Any, prim: int,
    mla: MlaTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow, in_order: bool,
) -> int:  # fmt: skip
    """Enter a packet's hit on the face of its cell in the block, or send the packet on.

    `NO_SURFACE`: the packet has ended, or is queued in the next cell, behind the layer, or for another query.
    """
    if packet.tries == 0 and too_deep(options, flow, frames, packet):
        return NO_SURFACE
    inward = packet.space == BEFORE
    if not inward and has_gradient(mla.gradient):
        return meets_along_curve(mla.gradient, block, i, packet, mla, frames, options, flow)
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    column, row = packet.column, packet.row
    cx, cy = centre(lattice, column, row)
    sideways, side = leaves_at(lattice, x - cx, y - cy, dx, dy)
    layer = np.inf
    if dz != 0.0:
        layer = ((lenslets.valley if dz > 0.0 else lenslets.top) - z) / dz
    at_facet, slack = packet.query_from, ROUNDED
    met, sure, t, nx, ny, nz = False, True, 0.0, 0.0, 0.0, 1.0
    by_profile = options.surface == EXACT and not is_spherical(lenslets.profile)
    if by_profile:
        met, t = meets_profile(
            lenslets.profile, lenslets, column, row, Ray(x - cx, y - cy, z, dx, dy, dz), inward,
            packet.query_from, min(sideways, layer),
        )  # fmt: skip
        if met:
            curvature, ex, ey = shape_of(lenslets, column, row)
            nx, ny, nz = face_normal(
                lenslets, column, row, curvature, x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz
            )
    elif in_order:
        met, t = block[rows.HELD + i] > 0.0, block[rows.AT + i]
        nearer = min(sideways, layer)
        sure = not met or abs(t - nearer) > UNSURE * abs(nearer)
        met = met and t <= layer
        slack = 0.0
    else:
        fold_x, fold_y = fold_of(mla, column, row)
        crossed, curved = False, -1
        if prim >= 0:
            facet = mla.facets[prim]
            normal = facet.normal
            along = normal[0] * dx + normal[1] * dy + normal[2] * dz
            height = normal[0] * (x - fold_x) + normal[1] * (y - fold_y) + normal[2] * z - facet.offset
            if along != 0.0:
                at_facet = -height / along
            crossed = along != 0.0 and (along > 0.0) == inward
        t = at_facet if crossed else packet.query_from
        if options.surface == EXACT:
            # A ray crosses a sphere once in either sense. The search starts at the facet or, if Embree finds
            # no facet, at the entry into the layer.
            curvature, ex, ey = shape_of(lenslets, column, row)
            met, more = conic_distance(
                curvature, 0.0, Ray(x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz, dx, dy, dz),
                1.0 if inward else -1.0,
            )  # fmt: skip
            t += more
            px, py, pz = x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz
            nx, ny, nz = -curvature * px, -curvature * py, 1.0 - curvature * pz
            # A hit beyond the layer is on the sphere's other half.
            met = met and 0.0 < t <= layer * (1.0 + slack)
        else:
            met = crossed and t > 0.0
            if options.surface == PATCH:
                # A ray that grazes a lenslet may pass between its facets and their patches.
                curved, at_patch, nx, ny, nz = _first_patch(
                    mla.tree, 1.0 if inward else -1.0, Ray(x - fold_x, y - fold_y, z, dx, dy, dz), 0.0,
                    sideways * (1.0 + slack),
                )  # fmt: skip
            if curved >= 0:
                met, t = True, at_patch
            elif met and options.surface == PATCH:
                _, more, nx, ny, nz = meets_patch(
                    flow, mla.patches, mla.across, mla.facets[prim], prim,
                    Ray(x + t * dx - fold_x, y + t * dy - fold_y, z + t * dz, dx, dy, dz),
                )  # fmt: skip
                t += more
                met = t > 0.0
            elif met:
                nx, ny, nz = facet_normal(
                    options.surface, mla.facets[prim], x + t * dx - fold_x, y + t * dy - fold_y, z + t * dz
                )
    if not sure:
        put(
            flow, mla.cells_mesh, packet, mla.frame, x, y, z, dx, dy, dz, packet.weight, packet.key, packet.query_from
        )  # fmt: skip
        return NO_SURFACE
    if met and t <= sideways * (1.0 + slack):
        block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i] = travel(
            flow, mla.media, packet, medium_of(mla, packet), t
        )
        if by_profile or not in_order:
            if nx * dx + ny * dy + nz * dz < 0.0:
                nx, ny, nz = -nx, -ny, -nz
            block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i] = dx, dy, dz
            block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i] = nx, ny, nz
            set_sides(block, i, packet, mla, not inward, mla.row)
        if ends_on_mask(block, i, packet, mla, frames, options, flow):
            return NO_SURFACE
        if inward and _ends_by_diffraction(mla.apertures, block, i, packet, mla, frames, options, flow):
            return NO_SURFACE
        set_local_sides(mla.gradient, block, i, packet, mla, not inward)
        return mla.row
    if options.surface != EXACT and prim >= 0 and not met and at_facet < min(sideways, layer):
        further = next_query_from(mla.facets[prim], packet, at_facet)
        requery(options, flow, frames, mla.cells_mesh, packet, further, False, LOST_IN_MLA)
    elif options.surface != EXACT and prim < 0 and packet.tries == 0:
        # Embree misses facets when a ray is aimed exactly at a vertex.
        requery(options, flow, frames, mla.cells_mesh, packet, packet.query_from, True, LOST_IN_MLA)
    elif sideways <= layer:
        _walk(options, flow, frames, mla, packet, sideways, side)
    elif dz < 0.0 and inward:
        leave_mla(
            flow, packet, mla.frame, x, y, z, dx, dy, dz, packet.weight, packet.key, mla.curved_to_lens,
            lens_surfaces,
        )  # fmt: skip
    elif dz > 0.0 and not inward:
        put(flow, PLATE, packet, mla.frame, x, y, z, dx, dy, dz, packet.weight, packet.key, 0.0)
    else:
        requery(options, flow, frames, mla.cells_mesh, packet, packet.query_from, True, LOST_IN_MLA)
    return NO_SURFACE


@inlined
def _ends_by_diffraction(
    apertures: Any, block: Array, i: int, packet: Any, mla: MlaTables, frames: Array, options: Options, flow: Flow
) -> bool:
    """Diffract a packet that meets a lenslet from outside; return True if that ends it.

    Parameters
    ----------
    apertures : Apertures or None
        `mla.apertures`; None without diffraction.
    """
    if apertures is None:
        return False
    goes_on, dx, dy, dz = kicked(
        apertures, mla.row, options.pixels, packet, packet.key,
        (block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i]),
        (block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i]),
    )  # fmt: skip
    block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i] = dx, dy, dz
    if not goes_on:
        end(
            options, flow, frames, packet, mla.frame, block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i],
            dx, dy, dz, packet.weight, EVANESCENT, S_ABSORBED,
        )  # fmt: skip
    return not goes_on


@kernel
def _walk(options: Options, flow: Flow, frames: Array, mla: MlaTables, packet: Any, sideways: float, side: int) -> None:
    """Move a packet into the next cell; the step between lenslets of different shape is an absorbing wall."""
    lenslets = mla.lenslets
    lattice = lenslets.lattice
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    inward = packet.space == BEFORE
    px, py, pz = x + sideways * dx, y + sideways * dy, z + sideways * dz
    column, row = neighbour(lattice, packet.column, packet.row, side)
    slot = -1
    if not is_inside(lattice, column, row):
        slot = MLA_MOUNT if inward else MLA_EDGE
    elif not are_alike(lenslets):
        curvature, ex, ey = shape_of(lenslets, column, row)
        cx, cy = centre(lattice, column, row)
        if options.surface == EXACT:
            face = face_sag(lenslets, column, row, curvature, px - cx - ex, py - cy - ey)
        else:
            face = border_sag(lenslets, column, row, px - cx, py - cy, side)
        in_glass = pz > face
        if in_glass == inward:
            slot = MLA_WALL
    if slot >= 0:
        px, py, pz = arrive(flow, mla.media, packet, medium_of(mla, packet), px, py, pz)
        end(options, flow, frames, packet, mla.frame, px, py, pz, dx, dy, dz, packet.weight, slot, S_ABSORBED)
        return
    child = put(flow, mla.cells, packet, mla.frame, x, y, z, dx, dy, dz, packet.weight, packet.key, sideways)
    child.column, child.row = column, row


@inlined
def _send_from_curved_face(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at a curved face that the parent met from outside (`inward`) or from the glass.

    A child cannot meet its own lenslet again if that is a single sphere, or less steep than the child. If it then
    leaves the layer before the cell, it is through; else it may meet a neighbouring lenslet. (A line that
    meets a sphere twice crosses the border of the layer outside the cell.) This is geometry, not refraction: it holds
    for directions that a finish or a phase gives as well.
    """
    mla, lens_surfaces, inward, prim, normal = place
    lenslets = mla.lenslets
    cx, cy = centre(lenslets.lattice, packet.column, packet.row)
    packet.space = GLASS if refracts == inward else BEFORE
    if packet.space == GLASS and has_gradient(mla.gradient):
        put(flow, PLATE, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, 0.0)
        return
    if packet.space == BEFORE:
        sense = 1.0 if refracts else -1.0
        goes_on, dx, dy, dz = kicked(
            mla.apertures, mla.row, options.pixels, packet, key, (dx, dy, dz),
            (sense * normal[0], sense * normal[1], sense * normal[2]),
        )  # fmt: skip
        if not goes_on:
            end(options, flow, frames, packet, mla.frame, x, y, z, dx, dy, dz, weight, EVANESCENT, S_ABSORBED)
            return
    sideways, _ = leaves_at(lenslets.lattice, x - cx, y - cy, dx, dy)
    if not leaves_face(lenslets.profile, lenslets, packet.column, packet.row, dx, dy, dz):
        sideways = -np.inf
    if packet.space == BEFORE and dz < 0.0 and (lenslets.top - z) / dz <= sideways:
        leave_mla(flow, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, mla.curved_to_lens, lens_surfaces)
    elif packet.space == GLASS and dz > 0.0 and (lenslets.valley - z) / dz <= sideways:
        put(flow, PLATE, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, 0.0)
    else:
        clear = 0.0
        if prim >= 0 and (is_spherical(lenslets.profile) or options.surface != EXACT):
            fold_x, fold_y = fold_of(mla, packet.column, packet.row)
            clear = clear_of(mla.facets[prim], x - fold_x, y - fold_y, z, dx, dy, dz)
        put(flow, mla.cells, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, clear)


_split_at_curved_face = splitter(_send_from_curved_face)
_scatter_at_curved_face = scatterer(_send_from_curved_face)
_split_orders_at_curved_face = order_splitter(_send_from_curved_face)


@inlined
def _through_face(
    block: Array, i: int, packet: Any, prim: int,
    mla: MlaTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Divide a packet of a block at the curved face of its cell."""
    inward = packet.space == BEFORE
    if packet.last == LEFT_FACE:
        # A second lenslet before the array's other face is off the image path, and off the path of every ghost.
        packet.path = NEXT_LENSLET[packet.path]
    packet.last = LEFT_FACE
    cell = packet.row * mla.lenslets.lattice.columns + packet.column
    normal = block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i]
    if _divided_by_phase(
        mla.interfaces.phases, block, i, packet, prim, mla, frames, lens_surfaces, options, flow, inward, cell
    ):
        return
    if mla.interfaces.rough and is_rough(mla.interfaces, mla.row):
        passes, dx, dy, dz = scattered_at_face(block, i, packet, mla, mla.row, options)
        _scatter_at_curved_face(
            (mla, lens_surfaces, inward, prim, normal), options, flow, frames, mla.frame, packet, mla.face, cell,
            mla.medium if inward else AIR, block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i],
            passes, dx, dy, dz,
        )  # fmt: skip
        return
    reflectance, transmittance = shares_at_face(block, i, packet, mla, frames, mla.row, not inward, flow)
    r, t = rows.REFLECTED + i, rows.REFRACTED + i
    _split_at_curved_face(
        (mla, lens_surfaces, inward, prim, normal), options, flow, frames, mla.frame, packet, mla.face, cell,
        mla.medium if inward else AIR, block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i],
        reflectance, transmittance,
        (block[r + rows.ALONG_X], block[r + rows.ALONG_Y], block[r + rows.ALONG_Z]),
        (block[t + rows.ALONG_X], block[t + rows.ALONG_Y], block[t + rows.ALONG_Z]),
    )  # fmt: skip


@inlined
def _divided_by_phase(
    phases: Any, block: Array, i: int, packet: Any, prim: int,
    mla: MlaTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow, inward: bool, cell: int,
) -> bool:  # fmt: skip
    """Divide a packet of a block into the orders of its lenslet; return False if that has no phase.

    Parameters
    ----------
    phases : PhaseFaces or None
        None: no face of the array has one.
    inward : bool
        It comes from outside the plate.
    cell : int
        Number of the lenslet.
    """
    if phases is None:
        return False
    if phases.number[mla.row] < 0:
        return False
    x, y, z = block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i]
    normal = block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i]
    cx, cy = centre(mla.lenslets.lattice, packet.column, packet.row)
    _, ex, ey = shape_of(mla.lenslets, packet.column, packet.row)
    light = light_at_phase(
        mla.interfaces, phases, mla.row, packet.colour, (block[rows.N_I + i], block[rows.N_T + i]),
        (block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i]), normal, (x - cx - ex, y - cy - ey), not inward,
    )  # fmt: skip
    _split_orders_at_curved_face(
        (mla, lens_surfaces, inward, prim, normal), options, flow, frames, mla.frame, packet, mla.face, cell,
        mla.medium if inward else AIR, x, y, z, mla.interfaces, phases, light,
    )  # fmt: skip
    return True
