"""The main lens, packet by packet: a surface is found by Embree or by the order of the surfaces, and float64 decides.

All in the camera frame. A packet in space s lies between surface s − 1 and surface s (see `LensTables`).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.meshes.levels import EXACT, PATCH
from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.geometry.surfaces.surface import conic_distance, distance_to, first_crossing, normal_at
from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import (
    at_box,
    box_entry,
    crosses,
    end,
    end_here,
    facet_normal,
    lose,
    meets_patch,
    move_packet,
    next_query_from,
    requery,
    thinned,
    too_deep,
    write_query,
)
from lfmesh.transport.events.interface import (
    divided,
    is_rough,
    is_thin_lens,
    scattered,
    scatterer,
    splitter,
    through_thin_lens,
)
from lfmesh.transport.events.polarisation import IN_LENS, shares_by_state
from lfmesh.transport.events.travel import arrive, travel
from lfmesh.transport.packets.book import HOUSING, LOST_CONTRADICTION, STOP, THIN_LENSES
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    LEFT_LENS,
    LENS,
    LENS_MESH,
    NO_SURFACE,
    OBJECTS,
    PLATE,
    REQUERIES,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.paths.automaton import FACE_AGAIN, OUT_OF_LENS, cutoff_at_child
from lfmesh.transport.regions.lens_block import (
    ALONG_X,
    ALONG_Y,
    ALONG_Z,
    AT,
    BLOCK,
    CLEAR,
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
    REFLECTANCE,
    REFLECTED,
    REFRACTED,
    SENSE,
    SIZE,
    TERMS,
    TRANSMITTANCE,
    X,
    Y,
    Z,
    incidence,
    meet_aspheres,
    meet_aspheres_at_facets,
    meet_conics,
    meet_in_order,
    set_asphere,
    set_child,
    set_conic,
    set_facet,
    set_only_conic,
    set_order,
    set_ray,
    split_block,
)
from lfmesh.transport.tables.tables import AIR, LensTables

Array = NDArray[np.float64]

RING = -2
"""In place of a surface's number: the ring that bounds a space sideways."""

GRAZING = 1e-2
"""Cosine of incidence below which the order of aspheres and posed surfaces leaves a hit to the meshes."""

SAME_HIT = 1e-9
"""Share of a hit's distance within which another hit on the same surface is that hit, found in two ways."""

NEARBY_TRIES = 4
"""Number of refused facets near the start (the packet's own facet and its neighbours) that are queried from behind."""


@kernel
def admit_to_lens(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32],
    lens: LensTables, frames: Array, options: Options, flow: Flow, queried: bool,
) -> int:  # fmt: skip
    """Move a wave into the camera frame, write its rays for Embree, and return how many packets remain.

    Rays from outside the box start at its border.

    Packets that miss the box end on the housing; the others are moved up in the wave.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Filled.
    queried : bool
        Whether Embree is asked; if not, no rays are written.
    """
    low, high = lens.box_low, lens.box_high
    kept = 0
    for i in range(len(wave)):
        if kept < i:
            wave[kept] = wave[i]
        packet = wave[kept]
        if packet.frame != CAMERA_FRAME:
            move_packet(frames, packet, CAMERA_FRAME)
            t = box_entry(low, high, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)
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
def stop_cuts(
    lens: LensTables, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[bool, float]:  # fmt: skip
    """Return whether the line of a ray passes the plane of the stop outside its aperture, and at which distance.

    A ray parallel to the plane is cut, at distance 0.

    Parameters
    ----------
    lens : LensTables
    x, y, z : float, mm, camera frame
    dx, dy, dz : float
    """
    if lens.stop_posed:
        x, y, z = point_through(lens.stop_unpose, x, y, z)
        dx, dy, dz = direction_through(lens.stop_unpose, dx, dy, dz)
    if dz == 0.0:
        return True, 0.0
    t = (lens.stop_z - z) / dz
    px, py = x + t * dx, y + t * dy
    return not px * px + py * py <= lens.stop_radius * lens.stop_radius, t


@kernel
def leave_lens(
    options: Options, flow: Flow, frames: Array, lens: LensTables, has_mla: bool, packet: Any,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64, space: int,
    query_from: float,
) -> None:  # fmt: skip
    """Queue a packet that has left the lens: for object space, the array, or without an array the sensor.

    It ends on the stop if the stop lies on its side of the lens and it misses the aperture.

    Parameters
    ----------
    space : int
        In front of the lens (0) or behind it.
    query_from : float, mm
        Distance at which the next query starts.
    """
    if lens.stop_space == space:
        cuts, t = stop_cuts(lens, x, y, z, dx, dy, dz)
        if cuts:
            end(
                options, flow, frames, packet, CAMERA_FRAME, x + t * dx, y + t * dy, z + t * dz, dx, dy, dz,
                weight, STOP, S_ABSORBED,
            )  # fmt: skip
            return
    station = OBJECTS if space == 0 else (PLATE if has_mla else SENSOR)
    child = put(flow, station, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, weight, key, query_from)
    child.last = LEFT_LENS
    child.facet = NO_SURFACE
    if space == 0:
        child.bodies, child.medium = NO_SURFACE, AIR
        child.path = OUT_OF_LENS[packet.path]


@kernel
def shade_lens(
    wave: NDArray[np.void], found: NDArray[np.int32], block: Array, met: NDArray[np.int64],
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow, in_order: bool,
) -> None:  # fmt: skip
    """Process a wave of packets: refuse what a query found, absorb the packet, or split it at its surface.

    Works block by block: hits on conics, nearly all, are found by vector instructions, the others packet by packet, and
    all packets of the block are split together.

    Without a query, surfaces are found by their order: a packet in a space can only meet its two surfaces and its ring.
    Where both surfaces are exact conics, their roots decide, unless the ring may come first. A ray that is steeper than
    both surfaces are anywhere, aspheres and posed ones among them, can only meet the one ahead, and that once. What is
    not decided goes to the station of the lens's meshes.

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
        Whether surfaces are found by their order.
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
        split_block(block)
        for i in range(count):
            if met[i] != NO_SURFACE:
                _send_on(block, i, wave[first + i], met[i], lens, has_mla, frames, options, flow)


@kernel
def _most_terms(lens: LensTables) -> int:
    """Return the number of terms of the lens's most complicated asphere; 0 without any."""
    most = 0
    for k in range(len(lens.surfaces)):
        most = max(most, lens.surfaces[k].terms)
    return most


@kernel
def _at_aspheres(block: Array, count: int) -> int:
    """Return how many of the packets in a block are at aspheres, and clear the places beyond the packets."""
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
    """Enter a packet in the block for `meet_in_order`, unless it has to be looked at singly."""
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

    In the frame of that surface, if it is posed.
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
    # Beside the aperture the mesh of an asphere deviates from where the asphere ends.
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
    """Move a hit of the block into the camera frame; return the surface, unless stop or ring end the packet."""
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
    if lens.stop_space == space and _is_cut(options, flow, frames, lens, packet, k, block[AT + i], x, y, z):
        return NO_SURFACE
    return k


@kernel
def _decide_in_order(
    block: Array, i: int, packet: Any,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> int:  # fmt: skip
    """Find a single packet's surface by the roots of the conics of its space, as `_decide` does by meshes."""
    space, free2 = packet.space, lens.order[packet.space, 8]
    if packet.events >= options.max_events:
        too_deep(options, flow, frames, packet)
        return NO_SURFACE
    outside = space == 0 or space == len(lens.surfaces)
    if outside and (packet.dz < 0.0) == (space == 0) and abs(packet.dz) > lens.order[space, 9]:
        # It is steeper than the outermost surface, and runs away from it.
        _leaves(options, flow, frames, lens, has_mla, packet)
        return NO_SURFACE
    k, t, px, py, z, nx, ny, nz, settled = _first_conic(lens, packet)
    if k == NO_SURFACE:
        # Beside the circle that a mesh reaches everywhere may be a corner of it.
        settled = settled and outside and lens.by_roots[space] and not _crosses_beside(lens, packet)
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
        _leaves(options, flow, frames, lens, has_mla, packet)
        return NO_SURFACE
    if _is_cut(options, flow, frames, lens, packet, k, t, px, py, z):
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
    """Enter a packet in the block if the facet found is of an exact surface of its space; return the surface.

    `NO_SURFACE`: it has to be looked at singly. So has a ray at an asphere that is not steeper than that anywhere, as
    it may cross it more than once.
    """
    block[SENSE + i], block[TERMS + i] = 0.0, 0.0
    if prim < 0 or packet.events >= options.max_events:
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
        # It may first meet the other surface of its space, where that one's mesh lies below the surface, unless it
        # leaves that for good.
        other = 2 * space - 1 - k
        if packet.last != other or lens.surfaces[other].level == PATCH:
            return NO_SURFACE
        for_good = _bulges_everywhere(lens.surfaces[other], -sense)
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
    """Find where a single packet meets a surface; enter that in the block and return the surface.

    `NO_SURFACE`: the packet has ended, is queued for another query, or has left the lens.
    """
    if packet.events >= options.max_events and packet.tries == 0:
        too_deep(options, flow, frames, packet)
        return NO_SURFACE
    facets, surfaces = lens.facets, lens.surfaces
    space, last_space = packet.space, len(surfaces)
    outside = space == 0 or space == last_space
    missed_all = prim < 0 and outside
    by_mesh = missed_all and not _is_conic(surfaces[0 if space == 0 else last_space - 1])
    if by_mesh and packet.last == NO_SURFACE and packet.tries == 0:
        # It was on its way in: Embree misses facets when a ray is aimed exactly at a vertex.
        requery(options, flow, frames, LENS_MESH, packet, packet.query_from, True, lens.lost_slot[space])
        return NO_SURFACE
    k, t, px, py, z, nx, ny, nz = NO_SURFACE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    if prim >= 0:
        k, t, px, py, z, nx, ny, nz = _meets(flow, lens, packet, prim, 0.25 * packet.query_from)
        if k == NO_SURFACE and abs(t) <= facets[prim].size and abs(packet.tries) < NEARBY_TRIES:
            further = next_query_from(facets[prim], packet, t)
            requery(options, flow, frames, LENS_MESH, packet, further, False, lens.lost_slot[space])
            return NO_SURFACE
    if k != NO_SURFACE:
        # The mesh of a surface that bulges into the space lies behind the surface, and a ray that grazes the surface
        # may miss the mesh.
        first, sooner, gx, gy, gz, mx, my, mz, _ = _first_conic(lens, packet)
        if first != NO_SURFACE and first != k and sooner < t:
            flow.counts[REQUERIES] += 1
            k, prim, t, px, py, z, nx, ny, nz = first, -1, sooner, gx, gy, gz, mx, my, mz
    if k != NO_SURFACE or by_mesh:
        first, facet, sooner, gx, gy, gz, mx, my, mz = _first_bulge(lens, packet, k, t if k != NO_SURFACE else np.inf)
        if first != NO_SURFACE:
            flow.counts[REQUERIES] += 1
            k, prim, t, px, py, z, nx, ny, nz = first, facet, sooner, gx, gy, gz, mx, my, mz
        elif by_mesh:
            _leaves(options, flow, frames, lens, has_mla, packet)
            return NO_SURFACE
    if k == NO_SURFACE:
        # Rounding to float32 has put the start of the query, or the ray, past a facet; or a ray from outside grazes a
        # surface above the chords of all its facets.
        flow.counts[REQUERIES] += not missed_all
        k, prim, t, px, py, z, nx, ny, nz = _first_of_all(flow, lens, packet)
        if k == NO_SURFACE:
            if outside:
                # It passes beside the outermost surface.
                _leaves(options, flow, frames, lens, has_mla, packet)
            else:
                lose(options, flow, frames, packet, LOST_CONTRADICTION, lens.lost_slot[space])
            return NO_SURFACE
    if k == RING:
        _meets_ring(options, flow, frames, lens, packet, t)
        return NO_SURFACE
    if _is_cut(options, flow, frames, lens, packet, k, t, px, py, z):
        return NO_SURFACE
    set_ray(block, i, packet)
    block[PX + i], block[PY + i], block[PZ + i] = px, py, z
    block[NX + i], block[NY + i], block[NZ + i] = nx, ny, nz
    set_facet(block, i, facets[max(prim, 0)])
    if prim < 0:
        # No facet that the children's queries have to clear.
        block[SIZE + i] = 0.0
    _set_sides(block, i, packet, k, lens)
    return k


@kernel
def _is_cut(
    options: Options, flow: Flow, frames: Array, lens: LensTables, packet: Any,
    k: int, t: float, x: float, y: float, z: float,
) -> bool:  # fmt: skip
    """Absorb a packet at the stop of its space, or at the mount outside the aperture of surface `k`; tell whether.

    Parameters
    ----------
    t : float, mm
        Distance of the surface.
    x, y, z : float, mm
        Point at which the packet meets the surface.
    """
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    if lens.stop_space == space and packet.last != k:
        cuts, at = stop_cuts(lens, x, y, z, dx, dy, dz)
        # A ray that a user starts behind the stop does not cross it.
        if cuts and (packet.last != NO_SURFACE or space == 0 or space == len(lens.surfaces) or -t < at < 0.0):
            x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], x + at * dx, y + at * dy, z + at * dz)
            end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, STOP, S_ABSORBED)
            return True
    rim = lens.surfaces[k].semi_diameter
    if _radius2(lens.surfaces[k], x, y, z) > rim * rim:
        slot = lens.mount_slot[k]
        x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], x, y, z)
        end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, slot, S_ABSORBED)
        return True
    return False


@inlined
def _leaves_for_good(lens: LensTables, into: int, dz: float) -> bool:
    """Tell whether a ray from an outermost surface goes into a space outside the lens and cannot meet it again.

    As the surface bulges outwards, or the ray is steeper than it is anywhere.
    """
    last = len(lens.surfaces)
    return (into == 0 and (lens.convex_front or -dz > lens.order[0, 11])) or (
        into == last and (lens.convex_back or dz > lens.order[last, 10])
    )


@inlined
def _send_child(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at surface `k`; if it cannot meet the lens again, send it out of the lens."""
    block, i, k, space, lens, has_mla = place
    into = (k + 1 if k == space else k) if refracts else space
    leaves = _leaves_for_good(lens, into, dz)
    cutoff = cutoff_at_child(options, leaves and into == 0, refracts, packet)
    if cutoff > 0.0:
        weight = thinned(cutoff, flow.book, packet, weight, key)
        if weight == 0.0:
            return
    if leaves:
        packet.space = into
        leave_lens(options, flow, frames, lens, has_mla, packet, x, y, z, dx, dy, dz, weight, key, into, 0.0)
    else:
        clear = block[(REFRACTED if refracts else REFLECTED) + i + CLEAR]
        station = LENS if lens.ordered[into] else LENS_MESH
        sent = put(flow, station, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, weight, key, clear)
        sent.last, sent.space = k, into


_split = splitter(_send_child)
_send_scattered = scatterer(_send_child)


@inlined
def _send_on(
    block: Array, i: int, packet: Any, k: int,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Divide a packet of a block at surface `k`."""
    r, t = REFLECTED + i, REFRACTED + i
    if packet.last == k:
        packet.path = FACE_AGAIN[packet.path]
    x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], block[PX + i], block[PY + i], block[PZ + i])
    reflectance, transmittance = block[REFLECTANCE + i], block[TRANSMITTANCE + i]
    if lens.interfaces.coated:
        n_i, n_t = block[N_I + i], block[N_T + i]
        if is_rough(lens.interfaces, k):
            passes, dx, dy, dz = scattered(
                lens.interfaces, k, options, packet, n_i, n_t, packet.dx, packet.dy, packet.dz,
                block[NX + i], block[NY + i], block[NZ + i],
            )  # fmt: skip
            set_child(block, REFRACTED + i if passes else REFLECTED + i, i, dx, dy, dz)
            _send_scattered(
                (block, i, k, packet.space, lens, has_mla), options, flow, frames, CAMERA_FRAME, packet, k, NO_SURFACE,
                lens.medium[k + 1 if k == packet.space else k], x, y, z, passes, dx, dy, dz,
            )  # fmt: skip
            return
        if is_thin_lens(lens.interfaces, k):
            _bend_by_thin_lens(block, i, packet, k, lens, options, flow, x, y, z)
        else:
            reflectance, transmittance, _ = divided(
                lens.interfaces, k, packet.colour, n_i, n_t, incidence(block, i), k != packet.space, packet, flow.book
            )
    reflectance, transmittance = shares_by_state(
        flow.polarised, IN_LENS, k, k != packet.space, block[N_I + i], block[N_T + i], incidence(block, i),
        (block[NX + i], block[NY + i], block[NZ + i]), frames, CAMERA_FRAME, packet, flow.book,
        reflectance, transmittance,
    )  # fmt: skip
    _split(
        (block, i, k, packet.space, lens, has_mla), options, flow, frames, CAMERA_FRAME, packet, k, NO_SURFACE,
        lens.medium[k + 1 if k == packet.space else k], x, y, z, reflectance, transmittance,
        (block[r + ALONG_X], block[r + ALONG_Y], block[r + ALONG_Z]),
        (block[t + ALONG_X], block[t + ALONG_Y], block[t + ALONG_Z]),
    )  # fmt: skip


@kernel
def _bend_by_thin_lens(
    block: Array, i: int, packet: Any, k: int, lens: LensTables, options: Options, flow: Flow,
    x: float, y: float, z: float,
) -> None:  # fmt: skip
    """Enter the direction behind a thin lens for the refracted child; let importance change by the étendue."""
    surface, dx, dy, dz = lens.surfaces[k], packet.dx, packet.dy, packet.dz
    if surface.posed:
        x, y, z = point_through(surface.unpose, x, y, z)
        dx, dy, dz = direction_through(surface.unpose, dx, dy, dz)
    dx, dy, dz, factor = through_thin_lens(lens.interfaces, k, packet.colour, x, y, dx, dy, dz)
    if surface.posed:
        dx, dy, dz = direction_through(surface.pose, dx, dy, dz)
    set_child(block, REFRACTED + i, i, dx, dy, dz)
    if options.importance:
        flow.book[THIN_LENSES] += packet.weight * (1.0 - factor)
        packet.weight *= factor


@kernel
def _meets_ring(options: Options, flow: Flow, frames: Array, lens: LensTables, packet: Any, t: float) -> None:
    """Absorb a packet at the ring of its space, on a lens edge or the mount, or at the stop if it meets that first."""
    slot = lens.ring_slot[packet.space]
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    if lens.stop_space == packet.space:
        cuts, at = stop_cuts(lens, x, y, z, dx, dy, dz)
        if cuts and 0.0 < at < t:
            slot, t = STOP, at
    x, y, z = travel(flow, lens.media, packet, lens.medium[packet.space], t)
    end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, slot, S_ABSORBED)


@inlined
def _meets(
    flow: Flow, lens: LensTables, packet: Any, prim: int, least: float
) -> tuple[int, float, float, float, float, float, float, float]:
    """Return the surface of its space that a packet meets at a facet, the distance, the point, and the normal.

    The normal points along the ray. `RING` stands for the ring of the space. `NO_SURFACE` refuses the facet: it belongs
    to another space, is crossed in the wrong sense or, where the facet itself is the surface, lies nearer than `least`.
    """
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    facet = lens.facets[prim]
    normal = facet.normal
    nx, ny, nz = normal[0], normal[1], normal[2]
    along = nx * dx + ny * dy + nz * dz
    k = facet.body
    # A packet in front of a surface crosses its facets along their normals, one behind it against them.
    forward = k == space
    met = (forward and along > 0.0) or (k == space - 1 and along < 0.0)
    if met and _is_conic(lens.surfaces[k]):
        # The sense alone decides between the two roots, so the facet's distance, a division, is not needed.
        t = packet.query_from
    else:
        t = (facet.offset - nx * x - ny * y - nz * z) / along if along != 0.0 else packet.query_from
    px, py, pz = x + t * dx, y + t * dy, z + t * dz
    if k < 0:
        met = -1 - k == space and t > 0.0
        k = RING
    elif met:
        surface = lens.surfaces[k]
        level = surface.level
        if level == EXACT:
            ex, ey, ez = dx, dy, dz
            if surface.posed:
                px, py, pz = point_through(surface.unpose, px, py, pz)
                ex, ey, ez = direction_through(surface.unpose, dx, dy, dz)
            pz -= surface.vertex_z
            met, more = distance_to(surface, px, py, pz, ex, ey, ez, 1.0 if forward else -1.0)
            t += more
            px, py, pz = px + more * ex, py + more * ey, pz + more * ez
            nx, ny, nz = normal_at(surface, px, py, pz)
            pz += surface.vertex_z
            if surface.posed:
                px, py, pz = point_through(surface.pose, px, py, pz)
                nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
            if not met:
                t = (facet.offset - normal[0] * x - normal[1] * y - normal[2] * z) / along
            met = met and t > 0.0 and (nx * dx + ny * dy + nz * dz > 0.0) == forward
        else:
            met = t > least
            if level == PATCH:
                curved, more, nx, ny, nz = meets_patch(
                    flow, lens.patches, lens.across, facet, prim, px, py, pz, dx, dy, dz
                )
                t += more
                px, py, pz = px + more * dx, py + more * dy, pz + more * dz
                met = t > 0.0 if curved else met
            elif met:
                nx, ny, nz = facet_normal(level, facet, px, py, pz)
            if (nx * dx + ny * dy + nz * dz > 0.0) != forward:
                # An interpolated normal may point against a grazing ray; the facet's normal then replaces it.
                nx, ny, nz = normal[0], normal[1], normal[2]
        if not forward:
            nx, ny, nz = -nx, -ny, -nz
    return k if met else NO_SURFACE, t, px, py, pz, nx, ny, nz


@kernel
def _first_conic(lens: LensTables, packet: Any) -> tuple[int, float, float, float, float, float, float, float, bool]:
    """Return the first conic of its space that a packet meets, the distance, the point, and the normal along the ray.

    By the analytic roots, without meshes. The last value tells whether all surfaces of the space are conics.
    """
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    first, nearest = NO_SURFACE, np.inf
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    settled = True
    # Counted from where the ray enters the box, as fewer digits are lost than from its start, which may be far away.
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    x, y, z = packet.x + ahead * dx, packet.y + ahead * dy, packet.z + ahead * dz
    for k in range(max(space - 1, 0), min(space + 1, len(lens.surfaces))):
        surface = lens.surfaces[k]
        if not _is_conic(surface):
            settled = False
            continue
        sense = 1.0 if k == space else -1.0
        sx, sy, sz, ex, ey, ez = x, y, z, dx, dy, dz
        if surface.posed:
            sx, sy, sz = point_through(surface.unpose, x, y, z)
            ex, ey, ez = direction_through(surface.unpose, dx, dy, dz)
        met, t = conic_distance(surface.curvature, surface.conic, sx, sy, sz - surface.vertex_z, ex, ey, ez, sense)
        px, py, pz = sx + t * ex, sy + t * ey, sz + t * ez - surface.vertex_z
        t += ahead
        on_sheet = surface.curvature * (1.0 + surface.conic) * pz < 1.0
        # A ray that leaves a conic meets it again only on the hollow side; on the other, a root is rounding.
        again = k != packet.last or sense * surface.curvature < 0.0
        if met and again and on_sheet and 0.0 < t < nearest and _on_mesh(surface, px * px + py * py):
            first, nearest, fx, fy, fz = k, t, px, py, pz + surface.vertex_z
            mx, my, mz = normal_at(surface, px, py, pz)
            nx, ny, nz = sense * mx, sense * my, sense * mz
            if surface.posed:
                fx, fy, fz = point_through(surface.pose, fx, fy, fz)
                nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
    return first, nearest, fx, fy, fz, nx, ny, nz, settled


@kernel
def _first_bulge(
    lens: LensTables, packet: Any, found: int, until: float
) -> tuple[int, int, float, float, float, float, float, float, float]:  # fmt: skip
    """Return what `_first_conic` does for the other curved surfaces of a packet's space, where meshes may miss them.

    After the surface comes the facet of its patch, −1 for an exact one.

    The vertices of a mesh are on the surface: a ray that grazes a bulge may pass between surface and mesh, and one that
    leaves a hollow may meet that again before it comes to the mesh. A surface that is hollow everywhere has its mesh in
    the space, where a ray from elsewhere meets it first. By steps that miss no crossing.

    Parameters
    ----------
    found : int
        Surface that its mesh, or its roots, have found so far.
    until : float, mm
        Distance of that: what comes later is of no interest.
    """
    space = packet.space
    first, nearest = NO_SURFACE, until
    fx, fy, fz, nx, ny, nz = 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    for k in range(max(space - 1, 0), min(space + 1, len(lens.surfaces))):
        surface = lens.surfaces[k]
        sense = 1.0 if k == space else -1.0
        if surface.level != EXACT or surface.terms == 0:
            continue
        if k == packet.last:
            if _bulges_everywhere(surface, sense):
                continue
        elif not _bulges(surface, sense) or (k == found and _meets_once(surface)):
            continue
        x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
        if surface.posed:
            x, y, z = point_through(surface.unpose, x, y, z)
            dx, dy, dz = direction_through(surface.unpose, dx, dy, dz)
        z -= surface.vertex_z
        met, t = first_crossing(surface, x, y, z, dx, dy, dz, sense, ahead, nearest, k == packet.last)
        if not met or (k == found and t > nearest * (1.0 - SAME_HIT)):
            continue
        first, nearest, fx, fy, fz = k, t, x + t * dx, y + t * dy, z + t * dz
        nx, ny, nz = normal_at(surface, fx, fy, fz)
        nx, ny, nz, fz = sense * nx, sense * ny, sense * nz, fz + surface.vertex_z
        if surface.posed:
            fx, fy, fz = point_through(surface.pose, fx, fy, fz)
            nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
    # A crossing that the mesh has found already is no news.
    prim, t, mx, my, mz = _first_patch(
        lens.tree, space, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, ahead,
        nearest * (1.0 - SAME_HIT),
    )  # fmt: skip
    if prim >= 0:
        first, nearest = lens.facets[prim].body, t
        fx, fy, fz = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
        sense = 1.0 if first == space else -1.0
        nx, ny, nz = sense * mx, sense * my, sense * mz
    return first, prim, nearest, fx, fy, fz, nx, ny, nz


@inlined
def _sense_at(space: int, body: int) -> float:
    """Return the sense in which a packet of a space meets the patches of a surface; 0 for one of another space."""
    return 1.0 if body == space else (-1.0 if body == space - 1 else 0.0)


_first_patch = patch_finder(_sense_at)


@inlined
def _bulges(surface: Any, sense: float) -> bool:
    """Tell whether a surface bulges anywhere into the space from which it is crossed in a sense."""
    return surface.most_bend > 0.0 if sense > 0.0 else surface.least_bend < 0.0


@inlined
def _bulges_everywhere(surface: Any, sense: float) -> bool:
    """Tell whether a surface bulges everywhere into the space from which it is crossed in a sense."""
    return surface.least_bend >= 0.0 if sense > 0.0 else surface.most_bend <= 0.0


@inlined
def _meets_once(surface: Any) -> bool:
    """Tell whether a line crosses a surface once at most in either sense, as it is convex or hollow everywhere."""
    return surface.least_bend >= 0.0 or surface.most_bend <= 0.0


@kernel
def _crosses_beside(lens: LensTables, packet: Any) -> bool:
    """Tell whether a packet outside the lens crosses the outermost conic anywhere, if only beside its mesh."""
    k = 0 if packet.space == 0 else len(lens.surfaces) - 1
    surface, sense = lens.surfaces[k], 1.0 if packet.space == 0 else -1.0
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    ahead = packet.limit if packet.last == NO_SURFACE else 0.0
    x, y, z = packet.x + ahead * dx, packet.y + ahead * dy, packet.z + ahead * dz - surface.vertex_z
    meets, t = conic_distance(surface.curvature, surface.conic, x, y, z, dx, dy, dz, sense)
    return meets and ahead + t > 0.0 and surface.curvature * (1.0 + surface.conic) * (z + t * dz) < 1.0


@kernel
def _first_of_all(
    flow: Flow, lens: LensTables, packet: Any
) -> tuple[int, int, float, float, float, float, float, float, float]:
    """Return the first surface that a packet meets, its facet (−1: none), and the other results of `_meets`.

    Slow but certain: conics by their analytic roots, as a ray along a concave one may run between surface and mesh, and
    so other exact surfaces by steps; everything else by testing every facet in float64.
    """
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    first_prim = -1
    first, nearest, fx, fy, fz, nx, ny, nz, settled = _first_conic(lens, packet)
    if settled and (space == 0 or space == len(lens.surfaces)):
        # Outside the lens there is no ring.
        return first, first_prim, nearest, fx, fy, fz, nx, ny, nz
    k, facet, t, px, py, pz, mx, my, mz = _first_bulge(lens, packet, first, nearest)
    if k != NO_SURFACE:
        first, first_prim, nearest, fx, fy, fz, nx, ny, nz = k, facet, t, px, py, pz, mx, my, mz
    for prim in range(len(lens.facets)):
        body = lens.facets[prim].body
        if body != space and body != space - 1 and body != -1 - space:
            continue
        t, _ = crosses(lens.facets[prim], x, y, z, dx, dy, dz)
        if not -packet.limit < t < np.inf:
            continue
        k, t, px, py, pz, mx, my, mz = _meets(flow, lens, packet, prim, -packet.limit)
        if k == NO_SURFACE or t >= nearest:
            continue
        if k >= 0 and _is_conic(lens.surfaces[k]):
            surface = lens.surfaces[k]
            if _on_mesh(surface, _radius2(surface, px, py, pz)):
                continue
        first, first_prim, nearest, fx, fy, fz, nx, ny, nz = k, prim, t, px, py, pz, mx, my, mz
    if first == NO_SURFACE and _is_between_exact(lens, space):
        # As neither surface is met, it is the ring, between the circle of a rim and the chords of its mesh.
        first, nearest = RING, packet.limit
    return first, first_prim, nearest, fx, fy, fz, nx, ny, nz


@inlined
def _is_between_exact(lens: LensTables, space: int) -> bool:
    """Tell whether a space lies inside the lens, between two exact surfaces."""
    inside = 0 < space < len(lens.surfaces)
    return inside and lens.surfaces[space - 1].level == EXACT and lens.surfaces[space].level == EXACT


@inlined
def _is_conic(surface: Any) -> bool:
    """Tell whether a surface is an exact conic, whose hits have a closed form."""
    return surface.level == EXACT and surface.terms == 0


@inlined
def _radius2(surface: Any, x: float, y: float, z: float) -> float:
    """Return the squared distance of a point (camera frame) from the axis of a surface."""
    if surface.posed:
        x, y, z = point_through(surface.unpose, x, y, z)
    return x * x + y * y


@inlined
def _on_mesh(surface: Any, radius2: float) -> bool:
    """Tell whether a squared radius is within the clear aperture or the margin by which meshes exceed it."""
    reach = _reach(surface)
    return radius2 <= reach * reach


@inlined
def _reach(surface: Any) -> float:
    """Return the radius up to which the mesh of a surface reaches everywhere, mm."""
    return min(surface.semi_diameter * (1.0 + OVERREACH), surface.end)


@kernel
def _leaves(options: Options, flow: Flow, frames: Array, lens: LensTables, has_mla: bool, packet: Any) -> None:
    """Send a packet that met nothing out of the lens, or end it on the housing behind the lens."""
    if packet.space == 0 or packet.dz > 0.0:
        from_outside = packet.space == 0 and packet.last == NO_SURFACE
        x, y, z = at_box(packet) if from_outside else (packet.x, packet.y, packet.z)
        leave_lens(
            options, flow, frames, lens, has_mla, packet, x, y, z, packet.dx, packet.dy, packet.dz, packet.weight,
            packet.key, packet.space, 0.0 if from_outside else packet.limit,
        )  # fmt: skip
    else:
        end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
