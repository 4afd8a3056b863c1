"""The main lens, packet by packet: Embree or the surfaces' order finds a surface, and float64 decides.

All in the camera frame. A packet in space s lies between surface s − 1 and surface s (see `LensTables`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.meshes.boxes import box_entry
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.ray import ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import end_here, lose, move_packet, requery, too_deep, write_query
from lfmesh.transport.events.facets import next_query_from
from lfmesh.transport.events.gradient import in_gradient
from lfmesh.transport.packets.book import HOUSING, LOST_CONTRADICTION
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    LENS_MESH,
    NO_SURFACE,
    REQUERIES,
    S_ABSORBED,
    Flow,
    Options,
    put,
)
from lfmesh.transport.regions.lens_block import (
    AT,
    BLOCK,
    DX,
    DY,
    DZ,
    HELD,
    N_I,
    N_T,
    NEXT_N,
    NEXT_NUMBER,
    NUMBER,
    NX,
    NY,
    NZ,
    PX,
    PY,
    PZ,
    SENSE,
    SIZE,
    TERMS,
    X,
    Y,
    Z,
    meet_aspheres,
    meet_aspheres_at_facets,
    meet_conics,
    meet_in_order,
    set_asphere,
    set_conic,
    set_facet,
    set_only_conic,
    set_order,
    set_ray,
    split_block,
)
from lfmesh.transport.regions.lens_exits import absorb_at_ring, divide_at_surface, is_cut, pass_by, stop_cuts
from lfmesh.transport.regions.lens_gap import decide_in_gap, set_index_behind_face
from lfmesh.transport.regions.lens_hits import (
    RING,
    bulges_everywhere,
    crosses_beside,
    first_bulge,
    first_conic,
    first_of_all,
    is_conic,
    meets_at_facet,
)
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]


GRAZING = 1e-2
"""Cosine of incidence below which hits on aspheres and posed surfaces are left to the meshes."""


NEARBY_TRIES = 4
"""Refused facets near the start (the packet's own facet and its neighbours) that are queried from behind."""


@kernel
def admit_to_lens(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32],
    lens: LensTables, frames: Array, options: Options, flow: Flow, queried: bool,
) -> int:  # fmt: skip
    """Move a wave into the camera frame, write its rays for Embree, and return how many packets remain.

    Rays from outside the box start at its border. Packets that miss it end on the housing; the others move up in the
    wave.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Filled.
    queried : bool
        Write rays for Embree.
    """
    low, high = lens.box_low, lens.box_high
    kept = 0
    for i in range(len(wave)):
        if kept < i:
            wave[kept] = wave[i]
        packet = wave[kept]
        if packet.frame != CAMERA_FRAME:
            move_packet(frames, packet, CAMERA_FRAME)
            t = box_entry(low, high, ray_of(packet))
            if t == np.inf:
                end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
                continue
            packet.last = NO_SURFACE
            packet.query_from = packet.limit = t
        if queried:
            write_query(origins, directions, kept, packet, 0.0, 0.0)
        kept += 1
    return kept


@kernel
def shade_lens(
    wave: NDArray[np.void], found: NDArray[np.int32], block: Array, met: NDArray[np.int64],
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow, in_order: bool,
) -> None:  # fmt: skip
    """Process a wave: refuse the facet found, absorb the packet, or split it at its surface.

    Works block by block. Hits on conics, nearly all, are found by vector instructions, the others singly, and all
    packets of the block are split together.

    Without a query, surfaces are found by their order: a packet in a space can only meet its two surfaces and its ring.
    If both surfaces are exact conics, their roots decide, unless the ring may come first. A ray that is steeper than
    both surfaces everywhere, including aspheres and posed ones, meets only the surface ahead, and only once. Undecided
    packets go to the station of the lens's meshes.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets that Embree found; −1: none. Not read if `in_order`.
    block : (ROWS · BLOCK,) float64
    met : (BLOCK,) int64
        Working memory.
    has_mla : bool
    in_order : bool
        Find surfaces by their order.
    """
    most_terms = _most_terms(lens)
    for first in range(0, len(wave), BLOCK):
        count = min(BLOCK, len(wave) - first)
        if in_order:
            for i in range(count):
                _prepare_in_order(block, i, wave[first + i], lens, options, most_terms)
            meet_in_order(block)
            if most_terms > 0 and _at_aspheres(block, count) > 0:
                meet_aspheres(block, most_terms)
            for i in range(count):
                packet = wave[first + i]
                if not block[HELD + i] > 0.0:
                    met[i] = _decide_in_order(block, i, packet, lens, has_mla, frames, options, flow)
                elif lens.by_roots[packet.space]:
                    met[i] = int(block[NUMBER + i])
                else:
                    met[i] = _meets_the_one_ahead(block, i, packet, lens, has_mla, frames, options, flow)
        else:
            for i in range(count):
                met[i] = _prepare(block, i, wave[first + i], found[first + i], lens, options, most_terms)
            curved = _at_aspheres(block, count) if most_terms > 0 else 0
            if curved < count:
                meet_conics(block)
            if curved > 0:
                meet_aspheres_at_facets(block, most_terms)
            for i in range(count):
                if not block[HELD + i] > 0.0:
                    prim = found[first + i]
                    met[i] = _decide(block, i, wave[first + i], prim, lens, has_mla, frames, options, flow)
        for i in range(count):
            set_index_behind_face(lens.gradients, block, i, wave[first + i], met[i], lens)
        split_block(block)
        for i in range(count):
            if met[i] != NO_SURFACE:
                divide_at_surface(block, i, wave[first + i], met[i], lens, has_mla, frames, options, flow)


@kernel
def _most_terms(lens: LensTables) -> int:
    """Return the number of terms of the lens's most complicated asphere; 0 without any."""
    most = 0
    for k in range(len(lens.surfaces)):
        most = max(most, lens.surfaces[k].terms)
    return most


@kernel
def _at_aspheres(block: Array, count: int) -> int:
    """Return the number of a block's packets at aspheres, and clear the unused places."""
    curved = 0
    for i in range(count):
        curved += 1 if block[TERMS + i] > 0.0 else 0
    for i in range(count, BLOCK):
        block[TERMS + i] = 0.0
    return curved


@inlined
def _prepare_in_order(
    block: Array, i: int, packet: Any, lens: LensTables, options: Options, most_terms: int
) -> None:  # fmt: skip
    """Enter a packet in the block for `meet_in_order`, unless it needs individual treatment."""
    block[SENSE + i], block[SIZE + i], block[TERMS + i] = 0.0, 0.0, 0.0
    space, colour, last_space = packet.space, packet.colour, len(lens.surfaces)
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    if packet.events >= options.max_events:
        return
    if not lens.by_roots[space]:
        _prepare_the_one_ahead(block, i, packet, lens, most_terms)
        return
    if lens.stop_space == space and stop_cuts(lens, x, y, z, dx, dy, dz)[0]:
        return
    last = packet.last
    set_ray(block, i, packet)
    set_order(block, i, lens.order[space], 1.0 if last == space else (-1.0 if last == space - 1 and last >= 0 else 0.0))
    indices, medium = lens.media.indices, lens.medium
    block[N_I + i], block[N_T + i] = indices[medium[space], colour], indices[medium[max(space - 1, 0)], colour]
    block[NEXT_N + i] = indices[medium[min(space + 1, last_space)], colour]
    block[NUMBER + i], block[NEXT_NUMBER + i] = max(space - 1, 0), min(space, last_space - 1)


@inlined
def _prepare_the_one_ahead(block: Array, i: int, packet: Any, lens: LensTables, most_terms: int) -> None:
    """Enter a packet that is steeper than the surfaces of its space in the block, with the surface ahead.

    In the frame of the surface, if it is posed.
    """
    space, order = packet.space, lens.order[packet.space]
    k = space if packet.dz > 0.0 else space - 1
    if not abs(packet.dz) > order[9] or k < 0 or k == len(lens.surfaces) or k == packet.last:
        return
    if packet.x * packet.x + packet.y * packet.y > order[8]:
        return
    surface = lens.surfaces[k]
    set_ray(block, i, packet)
    if surface.posed:
        block[X + i], block[Y + i], block[Z + i] = point_through(surface.unpose, packet.x, packet.y, packet.z)
        block[DX + i], block[DY + i], block[DZ + i] = direction_through(
            surface.unpose, packet.dx, packet.dy, packet.dz
        )  # fmt: skip
    # Outside the aperture the mesh of an asphere deviates where the asphere ends.
    reach = min(surface.semi_diameter, surface.end)
    set_only_conic(
        block, i, surface.curvature, 1.0 + surface.conic, surface.vertex_z, reach * reach,
        1.0 if packet.dz > 0.0 else -1.0,
    )  # fmt: skip
    set_asphere(block, i, surface, most_terms)
    _set_sides(block, i, packet, k, lens)
    block[NEXT_N + i], block[NEXT_NUMBER + i] = block[N_T + i], k


@inlined
def _meets_the_one_ahead(
    block: Array, i: int, packet: Any,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> int:  # fmt: skip
    """Move a hit of the block into the camera frame; return the surface unless stop or ring end the packet."""
    k, space = int(block[NUMBER + i]), packet.space
    surface = lens.surfaces[k]
    x, y, z = block[PX + i], block[PY + i], block[PZ + i]
    cosine = block[NX + i] * block[DX + i] + block[NY + i] * block[DY + i] + block[NZ + i] * block[DZ + i]
    if surface.posed:
        x, y, z = point_through(surface.pose, x, y, z)
        block[PX + i], block[PY + i], block[PZ + i] = x, y, z
        block[NX + i], block[NY + i], block[NZ + i] = direction_through(
            surface.pose, block[NX + i], block[NY + i], block[NZ + i]
        )  # fmt: skip
        block[DX + i], block[DY + i], block[DZ + i] = packet.dx, packet.dy, packet.dz
    if cosine < GRAZING or x * x + y * y > lens.order[space, 8]:
        return _decide_in_order(block, i, packet, lens, has_mla, frames, options, flow)
    if lens.stop_space == space and is_cut(options, flow, frames, lens, packet, k, block[AT + i], x, y, z):
        return NO_SURFACE
    return k


@kernel
def _decide_in_order(
    block: Array, i: int, packet: Any,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> int:  # fmt: skip
    """Find a single packet's surface by the roots of the conics of its space (by meshes: `_decide`)."""
    space, free2 = packet.space, lens.order[packet.space, 8]
    if packet.events >= options.max_events:
        too_deep(options, flow, frames, packet)
        return NO_SURFACE
    if in_gradient(lens.gradients, space):
        return decide_in_gap(lens.gradients, block, i, packet, lens, frames, options, flow)
    outside = space == 0 or space == len(lens.surfaces)
    if outside and (packet.dz < 0.0) == (space == 0) and abs(packet.dz) > lens.order[space, 9]:
        # It is steeper than the outermost surface, and moves away from it.
        pass_by(options, flow, frames, lens, has_mla, packet)
        return NO_SURFACE
    k, t, px, py, z, nx, ny, nz, settled = first_conic(lens, packet)
    if k == NO_SURFACE:
        # Outside the circle that a mesh reaches everywhere there may be a corner of it.
        settled = settled and outside and lens.by_roots[space] and not crosses_beside(lens, packet)
    elif not outside:
        settled = settled and px * px + py * py <= free2 and packet.x * packet.x + packet.y * packet.y <= free2
    if not lens.by_roots[space]:
        settled = settled and nx * packet.dx + ny * packet.dy + nz * packet.dz >= GRAZING
    if not settled:
        put(
            flow, LENS_MESH, packet, packet.frame, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz,
            packet.weight, packet.key, packet.query_from,
        )  # fmt: skip
        return NO_SURFACE
    if k == NO_SURFACE:
        pass_by(options, flow, frames, lens, has_mla, packet)
        return NO_SURFACE
    if is_cut(options, flow, frames, lens, packet, k, t, px, py, z):
        return NO_SURFACE
    set_ray(block, i, packet)
    block[PX + i], block[PY + i], block[PZ + i] = px, py, z
    block[NX + i], block[NY + i], block[NZ + i] = nx, ny, nz
    _set_sides(block, i, packet, k, lens)
    return k


@inlined
def _prepare(
    block: Array, i: int, packet: Any, prim: int, lens: LensTables, options: Options, most_terms: int
) -> int:  # fmt: skip
    """Enter a packet in the block if its facet belongs to an exact surface of its space; return the surface.

    `NO_SURFACE`: the packet needs individual treatment. So does a ray that may cross an asphere more than once, as it
    is not steeper everywhere.
    """
    block[SENSE + i], block[TERMS + i] = 0.0, 0.0
    if prim < 0 or packet.events >= options.max_events or in_gradient(lens.gradients, packet.space):
        return NO_SURFACE
    facet = lens.facets[prim]
    k, space, last_space = facet.body, packet.space, len(lens.surfaces)
    forward = k == space
    if k < 0 or not (forward or k == space - 1) or lens.surfaces[k].level != EXACT or lens.surfaces[k].posed:
        return NO_SURFACE
    outside = space == 0 or space == last_space
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    sense = 1.0 if forward else -1.0
    if not outside:
        # It may first meet the other surface of its space, if the mesh of that lies below the surface, unless it
        # leaves that surface for good.
        other = 2 * space - 1 - k
        if packet.last != other or lens.surfaces[other].level == PATCH:
            return NO_SURFACE
        for_good = bulges_everywhere(lens.surfaces[other], -sense)
        if not for_good and not sense * dz > lens.order[space, 10 if forward else 11]:
            return NO_SURFACE
    if lens.surfaces[k].terms > 0 and not sense * dz > lens.order[space, 11 if forward else 10]:
        return NO_SURFACE
    if lens.stop_space == space and packet.last != k and stop_cuts(lens, x, y, z, dx, dy, dz)[0]:
        return NO_SURFACE
    set_ray(block, i, packet)
    set_facet(block, i, facet)
    set_conic(block, i, lens.surfaces[k], sense)
    set_asphere(block, i, lens.surfaces[k], most_terms)
    _set_sides(block, i, packet, k, lens)
    return k


@inlined
def _set_sides(block: Array, i: int, packet: Any, k: int, lens: LensTables) -> None:
    """Enter surface `k` as an interface, and the indices before and after it."""
    space = packet.space
    indices, beyond = lens.media.indices, lens.medium[k + 1 if k == space else k]
    block[N_I + i], block[N_T + i] = indices[lens.medium[space], packet.colour], indices[beyond, packet.colour]
    block[NUMBER + i] = k


@kernel
def _decide(
    block: Array, i: int, packet: Any, prim: int,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> int:  # fmt: skip
    """Find a single packet's surface, enter the hit in the block, and return the surface.

    `NO_SURFACE`: the packet has ended, is queued for another query, or has left the lens.
    """
    if packet.events >= options.max_events and packet.tries == 0:
        too_deep(options, flow, frames, packet)
        return NO_SURFACE
    if in_gradient(lens.gradients, packet.space):
        return decide_in_gap(lens.gradients, block, i, packet, lens, frames, options, flow)
    facets, surfaces = lens.facets, lens.surfaces
    space, last_space = packet.space, len(surfaces)
    outside = space == 0 or space == last_space
    missed_all = prim < 0 and outside
    by_mesh = missed_all and not is_conic(surfaces[0 if space == 0 else last_space - 1])
    if by_mesh and packet.last == NO_SURFACE and packet.tries == 0:
        # It was on its way in: Embree misses facets when a ray is aimed exactly at a vertex.
        requery(options, flow, frames, LENS_MESH, packet, packet.query_from, True, lens.lost_slot[space])
        return NO_SURFACE
    k, t, px, py, z, nx, ny, nz = NO_SURFACE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    if prim >= 0:
        k, t, px, py, z, nx, ny, nz = meets_at_facet(flow, lens, packet, prim, 0.25 * packet.query_from)
        if k == NO_SURFACE and abs(t) <= facets[prim].size and abs(packet.tries) < NEARBY_TRIES:
            further = next_query_from(facets[prim], packet, t)
            requery(options, flow, frames, LENS_MESH, packet, further, False, lens.lost_slot[space])
            return NO_SURFACE
    if k != NO_SURFACE:
        # The mesh of a surface that bulges into the space lies behind the surface. A ray that grazes the surface
        # may miss the mesh.
        first, sooner, gx, gy, gz, mx, my, mz, _ = first_conic(lens, packet)
        if first != NO_SURFACE and first != k and sooner < t:
            flow.counts[REQUERIES] += 1
            k, prim, t, px, py, z, nx, ny, nz = first, -1, sooner, gx, gy, gz, mx, my, mz
    if k != NO_SURFACE or by_mesh:
        first, facet, sooner, gx, gy, gz, mx, my, mz = first_bulge(lens, packet, k, t if k != NO_SURFACE else np.inf)
        if first != NO_SURFACE:
            flow.counts[REQUERIES] += 1
            k, prim, t, px, py, z, nx, ny, nz = first, facet, sooner, gx, gy, gz, mx, my, mz
        elif by_mesh:
            pass_by(options, flow, frames, lens, has_mla, packet)
            return NO_SURFACE
    if k == NO_SURFACE:
        # Float32 rounding has put the start of the query, or the ray, past a facet; or a ray from outside grazes a
        # surface above the chords of all its facets.
        flow.counts[REQUERIES] += not missed_all
        k, prim, t, px, py, z, nx, ny, nz = first_of_all(flow, lens, packet)
        if k == NO_SURFACE:
            if outside:
                # It passes beside the outermost surface.
                pass_by(options, flow, frames, lens, has_mla, packet)
            else:
                lose(options, flow, frames, packet, LOST_CONTRADICTION, lens.lost_slot[space])
            return NO_SURFACE
    if k == RING:
        absorb_at_ring(options, flow, frames, lens, packet, t)
        return NO_SURFACE
    if is_cut(options, flow, frames, lens, packet, k, t, px, py, z):
        return NO_SURFACE
    set_ray(block, i, packet)
    block[PX + i], block[PY + i], block[PZ + i] = px, py, z
    block[NX + i], block[NY + i], block[NZ + i] = nx, ny, nz
    set_facet(block, i, facets[max(prim, 0)])
    if prim < 0:
        # The children's queries have no facet to clear.
        block[SIZE + i] = 0.0
    _set_sides(block, i, packet, k, lens)
    return k
