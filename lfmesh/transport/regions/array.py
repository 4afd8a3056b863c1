"""The microlens array in the mesh engine, folded: all lenslets of a type share one cell mesh about their centre.

Array frame: z runs from the curved face into the glass. Space 0 is the air before the curved face, 1 the glass, 2 the
air behind the flat face. The curved faces lie in the thin layer top ≤ z ≤ valley. Only in that layer does a ray belong
to a cell; where it leaves the cell sideways before it meets the face or leaves the layer, it walks into the next cell.
Below the layer the glass is one plate. The flat face is one plane and needs no query of Embree.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lattice import cell_of, centre, is_inside, leaves_at, neighbour, stays_inside
from lfmesh.geometry.lenslets import are_alike, border_sag, cap_sag, shape_of, type_of
from lfmesh.geometry.levels import EXACT, FLAT, PATCH, SMOOTH
from lfmesh.geometry.surface import conic_distance
from lfmesh.kernel import inlined, kernel
from lfmesh.transport.events.crossing import (
    clear_of,
    end,
    end_here,
    facet_normal,
    meets_patch,
    move_packet,
    next_query_from,
    reflected,
    refracted,
    requery,
    too_deep,
    write_query,
)
from lfmesh.transport.events.interface import divided, splitter
from lfmesh.transport.events.travel import arrive, travel
from lfmesh.transport.packets.book import ARRAY_EDGE, ARRAY_MOUNT, ARRAY_WALL, LOST_IN_ARRAY
from lfmesh.transport.packets.packet import (
    ARRAY_FRAME,
    CELLS,
    CURVED_FACE,
    FLAT_FACE,
    LEFT_FACE,
    LENS,
    NO_SURFACE,
    PLATE,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.tables.tables import AIR, CURVED_ROW, FLAT_ROW, ArrayTables

Array = NDArray[np.float64]

BEFORE, GLASS, BEHIND = 0, 1, 2


@inlined
def leave_array(
    flow: Flow, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float,
    weight: float, key: np.uint64, to_lens: bool, lens_surfaces: int,
) -> None:  # fmt: skip
    """Queue a packet that has left the array, for the lens or for the sensor."""
    child = put(flow, LENS if to_lens else SENSOR, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, weight, key, 0.0)
    child.space = lens_surfaces


@inlined
def into_layer(
    options: Options, flow: Flow, frames: Array, array: ArrayTables, packet: Any,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64, space: int,
) -> None:  # fmt: skip
    """Find the cell in which a packet enters the layer of curved faces, and queue it there.

    It ends on the mount or on the array's edge if it misses the array.

    Parameters
    ----------
    space : int
        Space that it comes from: `BEFORE` or `GLASS`.
    """
    lenslets = array.lenslets
    border = lenslets.top if space == BEFORE else lenslets.valley
    t = max(0.0, (border - z) / dz)
    column, row = cell_of(lenslets.lattice, x + t * dx, y + t * dy)
    held = is_inside(lenslets.lattice, column, row)
    if space == GLASS:
        held = stays_inside(lenslets.lattice, x, y, x + t * dx, y + t * dy)
    if not held:
        end(
            options, flow, frames, packet, ARRAY_FRAME, x + t * dx, y + t * dy, z + t * dz, dx, dy, dz,
            weight, ARRAY_MOUNT if space == BEFORE else ARRAY_EDGE, S_ABSORBED,
        )  # fmt: skip
        return
    child = put(flow, CELLS, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, weight, key, t)
    child.space, child.column, child.row = space, column, row


@inlined
def _send_from_flat_face(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at the flat face, which the parent met from the glass (`outward`) or from the air."""
    array, lens_surfaces, outward = place
    if refracts == outward:
        leave_array(flow, packet, x, y, z, dx, dy, dz, weight, key, not array.curved_to_lens, lens_surfaces)
    else:
        into_layer(options, flow, frames, array, packet, x, y, z, dx, dy, dz, weight, key, GLASS)


_split_at_flat_face = splitter(_send_from_flat_face)


@kernel
def through_plate(
    wave: NDArray[np.void], array: ArrayTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow
) -> None:
    """Take a wave of packets into the layer of curved faces, or split them at the flat face.

    Parameters
    ----------
    wave : (n,) PACKET
    lens_surfaces : int
        Number of refracting surfaces of the lens.
    """
    lenslets = array.lenslets
    thickness = lenslets.thickness
    for i in range(len(wave)):
        packet = wave[i]
        if packet.frame != ARRAY_FRAME:
            move_packet(frames, packet, ARRAY_FRAME)
            if packet.dz > 0.0 and packet.z <= lenslets.valley:
                into_layer(
                    options, flow, frames, array, packet, packet.x, packet.y, packet.z,
                    packet.dx, packet.dy, packet.dz, packet.weight, packet.key, BEFORE,
                )  # fmt: skip
                continue
            if not (packet.dz < 0.0 and packet.z >= thickness):
                end_here(options, flow, frames, packet, ARRAY_MOUNT, S_ABSORBED)
                continue
            packet.space = BEHIND
        if too_deep(options, flow, frames, packet):
            continue
        dx, dy, dz = packet.dx, packet.dy, packet.dz
        t = (thickness - packet.z) / dz
        x, y, _ = travel(flow, array.media, packet, t)
        z = thickness
        outward = packet.space == GLASS
        if outward:
            held = stays_inside(lenslets.lattice, packet.x, packet.y, x, y)
        else:
            column, row = cell_of(lenslets.lattice, x, y)
            held = is_inside(lenslets.lattice, column, row)
        if not held:
            slot = ARRAY_EDGE if outward else ARRAY_MOUNT
            end(options, flow, frames, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, packet.weight, slot, S_ABSORBED)
            continue
        glass = array.media.indices[array.medium, packet.colour]
        n_i, n_t = (glass, 1.0) if outward else (1.0, glass)
        reflectance, transmittance, cos_t = divided(
            array.interfaces, FLAT_ROW, packet.colour, n_i, n_t, abs(dz), outward, packet, flow.book
        )
        toward = 1.0 if dz > 0.0 else -1.0
        _split_at_flat_face(
            (array, lens_surfaces, outward), options, flow, frames, ARRAY_FRAME, packet, FLAT_FACE, NO_SURFACE,
            AIR if outward else array.medium, x, y, z, reflectance, transmittance,
            (dx, dy, -dz), refracted(dx, dy, dz, 0.0, 0.0, toward, n_i / n_t, abs(dz), cos_t),
        )  # fmt: skip


@inlined
def fold_of(array: ArrayTables, column: int, row: int) -> tuple[float, float]:
    """Return the x and y offset from the cell mesh in Embree's scene to a lenslet, mm."""
    cx, cy = centre(array.lenslets.lattice, column, row)
    return cx - type_of(array.lenslets, column, row) * array.type_shift, cy


@kernel
def admit_to_cells(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], array: ArrayTables
) -> None:
    """Write the rays of a wave for Embree, moved to the cell mesh of their lenslets."""
    for i in range(len(wave)):
        fold_x, fold_y = fold_of(array, wave[i].column, wave[i].row)
        write_query(origins, directions, i, wave[i], fold_x, fold_y)


@kernel
def shade_cells(
    wave: NDArray[np.void], found: NDArray[np.int32],
    array: ArrayTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Process a wave of packets in the layer: decide in float64 whether each meets its cell's face, and split it there.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets that Embree found; −1: none.
    lens_surfaces : int
        Number of refracting surfaces of the lens.
    """
    lenslets = array.lenslets
    lattice = lenslets.lattice
    for i in range(len(wave)):
        packet = wave[i]
        if packet.tries == 0 and too_deep(options, flow, frames, packet):
            continue
        x, y, z = packet.x, packet.y, packet.z
        dx, dy, dz = packet.dx, packet.dy, packet.dz
        column, row = packet.column, packet.row
        inward = packet.space == BEFORE
        cx, cy = centre(lattice, column, row)
        curvature, ex, ey = shape_of(lenslets, column, row)
        fold_x, fold_y = fold_of(array, column, row)
        sideways, side = leaves_at(lattice, x - cx, y - cy, dx, dy)
        layer = np.inf
        if dz != 0.0:
            layer = ((lenslets.valley if dz > 0.0 else lenslets.top) - z) / dz
        prim = found[i]
        at_facet = packet.query_from
        crossed = False
        if prim >= 0:
            facet = array.facets[prim]
            normal = facet.normal
            along = normal[0] * dx + normal[1] * dy + normal[2] * dz
            height = normal[0] * (x - fold_x) + normal[1] * (y - fold_y) + normal[2] * z - facet.offset
            if along != 0.0:
                at_facet = -height / along
            crossed = along != 0.0 and (along > 0.0) == inward
        t = at_facet if crossed else packet.query_from
        nx, ny, nz = 0.0, 0.0, 1.0
        if options.surface == EXACT:
            # A ray crosses a sphere once in either sense. The facet gives the point to start from; where Embree finds
            # A ray crosses a sphere once in either sense. The facet gives the point to start from; if Embree finds
            met, more = conic_distance(
                curvature, 0.0, x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz,
                dx, dy, dz, 1.0 if inward else -1.0,
            )  # fmt: skip
            t += more
            px, py, pz = x + t * dx - cx - ex, y + t * dy - cy - ey, z + t * dz
            nx, ny, nz = -curvature * px, -curvature * py, 1.0 - curvature * pz
            # A hit beyond the layer is on the sphere's other half.
            met = met and 0.0 < t <= layer * (1.0 + 1e-12)
        else:
            met = crossed and t > 0.0
            if met and options.surface == PATCH:
                _, more, nx, ny, nz = meets_patch(
                    flow, array.patches, array.across, array.facets[prim], prim,
                    x + t * dx - fold_x, y + t * dy - fold_y, z + t * dz, dx, dy, dz,
                )  # fmt: skip
                t += more
                met = t > 0.0
        if met and t <= sideways * (1.0 + 1e-12):
            if options.surface == FLAT or options.surface == SMOOTH:
                nx, ny, nz = facet_normal(
                    options.surface, array.facets[prim], x + t * dx - fold_x, y + t * dy - fold_y, z + t * dz
                )
            _through_face(options, flow, frames, array, lens_surfaces, packet, t, prim, nx, ny, nz)
        elif options.surface != EXACT and prim >= 0 and not met and at_facet < min(sideways, layer):
            further = next_query_from(array.facets[prim], packet, at_facet)
            requery(options, flow, frames, CELLS, packet, further, False, LOST_IN_ARRAY)
        elif options.surface != EXACT and prim < 0 and packet.tries == 0:
            # Embree misses facets when a ray is aimed exactly at a vertex.
            requery(options, flow, frames, CELLS, packet, packet.query_from, True, LOST_IN_ARRAY)
        elif sideways <= layer:
            _walk(options, flow, frames, array, packet, sideways, side)
        elif dz < 0.0 and inward:
            leave_array(
                flow, packet, x, y, z, dx, dy, dz, packet.weight, packet.key, array.curved_to_lens,
                lens_surfaces,
            )  # fmt: skip
        elif dz > 0.0 and not inward:
            put(flow, PLATE, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, 0.0)
        else:
            requery(options, flow, frames, CELLS, packet, packet.query_from, True, LOST_IN_ARRAY)


@kernel
def _walk(
    options: Options, flow: Flow, frames: Array, array: ArrayTables, packet: Any, sideways: float, side: int
) -> None:
    """Take a packet into the next cell; the step between lenslets of different shape is a wall, which absorbs."""
    lenslets = array.lenslets
    lattice = lenslets.lattice
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    inward = packet.space == BEFORE
    px, py, pz = x + sideways * dx, y + sideways * dy, z + sideways * dz
    column, row = neighbour(lattice, packet.column, packet.row, side)
    slot = -1
    if not is_inside(lattice, column, row):
        slot = ARRAY_MOUNT if inward else ARRAY_EDGE
    elif not are_alike(lenslets):
        curvature, ex, ey = shape_of(lenslets, column, row)
        cx, cy = centre(lattice, column, row)
        if options.surface == EXACT:
            face = cap_sag(curvature, (px - cx - ex) ** 2 + (py - cy - ey) ** 2)
        else:
            curvature = lenslets.curvature[type_of(lenslets, column, row)]
            face = border_sag(lattice, curvature, px - cx, py - cy, side)
        in_glass = pz > face
        if in_glass == inward:
            slot = ARRAY_WALL
    if slot >= 0:
        px, py, pz = arrive(flow, array.media, packet, px, py, pz)
        end(options, flow, frames, packet, ARRAY_FRAME, px, py, pz, dx, dy, dz, packet.weight, slot, S_ABSORBED)
        return
    child = put(flow, CELLS, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, sideways)
    child.column, child.row = column, row


@inlined
def _send_from_curved_face(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at a curved face, which the parent met from the air (`inward`) or from the glass.

    A child cannot meet its own lenslet again, which is a single sphere. So it is through if it leaves the layer before
    it leaves the cell; else it may meet a neighbouring lenslet.
    """
    array, lens_surfaces, inward, prim = place
    lenslets = array.lenslets
    cx, cy = centre(lenslets.lattice, packet.column, packet.row)
    packet.space = GLASS if refracts == inward else BEFORE
    sideways, _ = leaves_at(lenslets.lattice, x - cx, y - cy, dx, dy)
    if packet.space == BEFORE and dz < 0.0 and (lenslets.top - z) / dz <= sideways:
        leave_array(flow, packet, x, y, z, dx, dy, dz, weight, key, array.curved_to_lens, lens_surfaces)
    elif packet.space == GLASS and dz > 0.0 and (lenslets.valley - z) / dz <= sideways:
        put(flow, PLATE, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, weight, key, 0.0)
    else:
        clear = 0.0
        if prim >= 0:
            fold_x, fold_y = fold_of(array, packet.column, packet.row)
            clear = clear_of(array.facets[prim], x - fold_x, y - fold_y, z, dx, dy, dz)
        put(flow, CELLS, packet, ARRAY_FRAME, x, y, z, dx, dy, dz, weight, key, clear)


_split_at_curved_face = splitter(_send_from_curved_face)


@inlined
def _through_face(
    options: Options, flow: Flow, frames: Array, array: ArrayTables, lens_surfaces: int,
    packet: Any, t: float, prim: int, nx: float, ny: float, nz: float,
) -> None:  # fmt: skip
    """Split a packet where it meets the curved face of its cell, at distance t."""
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    cos_i = nx * dx + ny * dy + nz * dz
    if cos_i < 0.0:
        nx, ny, nz, cos_i = -nx, -ny, -nz, -cos_i
    cos_i = min(cos_i, 1.0)
    inward = packet.space == BEFORE
    glass = array.media.indices[array.medium, packet.colour]
    n_i, n_t = (1.0, glass) if inward else (glass, 1.0)
    reflectance, transmittance, cos_t = divided(
        array.interfaces, CURVED_ROW, packet.colour, n_i, n_t, cos_i, not inward, packet, flow.book
    )
    if packet.last == LEFT_FACE:
        # The second curved face in one passage is off the image path.
        packet.stray = 1
    packet.last = LEFT_FACE
    x, y, z = travel(flow, array.media, packet, t)
    cell = packet.row * array.lenslets.lattice.columns + packet.column
    _split_at_curved_face(
        (array, lens_surfaces, inward, prim), options, flow, frames, ARRAY_FRAME, packet, CURVED_FACE, cell,
        array.medium if inward else AIR, x, y, z, reflectance, transmittance,
        reflected(dx, dy, dz, nx, ny, nz), refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t),
    )  # fmt: skip
