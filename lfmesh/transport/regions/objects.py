"""Object space: hits on targets, glass and housing, shadow packets, and entry into the lens.

Everything is in the object frame or, at things that move, in the frame of their mover (`events.moving`), and both
methods share the kernel. `first_hit` finds what a packet meets, and `targets` holds the scattering on targets.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.meshes.boxes import box_entry
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.bending import bends_before, next_chord, straight_mm
from lfmesh.transport.events.bodies import RANK, bodies_round
from lfmesh.transport.events.crossing import MAX_TRIES, end, end_here, lose, move_packet, requery, too_deep, write_query
from lfmesh.transport.events.facets import clear_of, next_query_from
from lfmesh.transport.events.moving import begin_hit, begin_query, enter_mover, hold_frame, set_rays, take_ray
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.travel import travel
from lfmesh.transport.lights.combine import bring_light
from lfmesh.transport.lights.emitting_facets import is_reached
from lfmesh.transport.packets.book import (
    ESCAPED,
    HOUSING,
    LENS_FRONT,
    LOST_CONTRADICTION,
    LOST_OUTSIDE,
    SAMPLING_REMOVED,
)
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    LAMP,
    LEFT_LENS,
    LEFT_MEDIUM,
    LENS,
    MOVING_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    REQUERIES,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    SCATTERED,
    SHADOW,
    SPECULAR,
    TO_FACET,
    TO_LAMP,
    Flow,
    Options,
    keep_chord,
    mover_of_frame,
    put,
)
from lfmesh.transport.paths.automaton import LAMP_ON_CAMERA, counts
from lfmesh.transport.regions.fields import begin_in_field, is_shared, take_share, to_chord_end
from lfmesh.transport.regions.first_hit import (
    certain_hit,
    comes_out_ahead,
    first_hit,
    in_its_medium,
    is_in_contact,
    is_sheer,
    might_have_met,
)
from lfmesh.transport.regions.glass import through_glass
from lfmesh.transport.regions.targets import meet_target, passes, share_with_other
from lfmesh.transport.regions.volumes import Met, is_stopped_by_media, way_through_media
from lfmesh.transport.tables.motions import FAR, STILL
from lfmesh.transport.tables.tables import OPAQUE, LensTables, ObjectTables

Array = NDArray[np.float64]


@kernel
def admit_to_objects(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], frames: Array, fields: Any,
    options: Options, moving: Any,
) -> None:  # fmt: skip
    """Write the rays of a wave for Embree, in the object frame; in a scene with motion, in the frame of each mover.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Output, in the object frame.
    frames : (6, 6, 3, 4) float64
        See `tables.frames`.
    fields : BendingFields or None
        Media that bend light; each packet is turned along its chord.
    options : Options
    moving : Moving or None
        Receives the queries for movers that packets pass near.
    """
    _begin_queries(moving)
    for i in range(len(wave)):
        begin_query(moving, options, wave[i], i)
        _move_to_objects(moving, fields, frames, wave[i])
        next_chord(fields, wave[i])
        _write_moved(moving, origins, directions, i, wave[i])
        if moving is None:
            write_query(origins, directions, i, wave[i], 0.0, 0.0)


@inlined
def _begin_queries(moving: Any) -> None:
    """Clear the queries of movers; `moving` : Moving or None."""
    if moving is None:
        return
    for mover in range(len(moving.queried)):
        moving.queried[mover] = 0


@inlined
def _move_to_objects(moving: Any, fields: Any, frames: Array, packet: Any) -> None:
    """Move a packet into the object frame, unless it is in the frame of a mover; fields stand still."""
    if fields is not None:
        enter_mover(moving, packet, STILL)
    if packet.frame <= MOVING_FRAME:
        move_packet(frames, packet, OBJECT_FRAME)


@inlined
def _write_moved(
    moving: Any, origins: NDArray[np.float32], directions: NDArray[np.float32], i: int, packet: Any
) -> None:  # fmt: skip
    """Write the rays of a packet in the frames of the movers that it passes near; `moving` : Moving or None."""
    if moving is None:
        return
    here = mover_of_frame(packet.frame)
    set_rays(moving, packet)
    for mover in range(len(moving.rays)):
        if mover != STILL and not _passes_near(moving, mover):
            moving.found[mover, i] = FAR
            continue
        take_ray(moving, packet, mover)
        if mover == STILL:
            write_query(origins, directions, i, packet, 0.0, 0.0)
            continue
        number = moving.queried[mover]
        write_query(moving.origins[mover], moving.directions[mover], number, packet, 0.0, 0.0)
        moving.packet[mover, number] = i
        moving.queried[mover] = number + 1
    take_ray(moving, packet, here)


@inlined
def _passes_near(moving: Any, mover: int) -> bool:
    """Tell whether the ray in hand passes the sphere round the targets of a mover."""
    (x, y, z, radius), ray = moving.motions.bounds[mover], moving.rays[mover]
    px, py, pz = x - ray[0], y - ray[1], z - ray[2]
    dx, dy, dz = ray[3], ray[4], ray[5]
    if radius <= 0.0 or px * dx + py * dy + pz * dz < -radius:
        return False
    # The cross product loses no digits far away.
    cx, cy, cz = py * dz - pz * dy, pz * dx - px * dz, px * dy - py * dx
    return bool(cx * cx + cy * cy + cz * cz <= radius * radius)


@kernel
def shade_objects(
    wave: NDArray[np.void], found: NDArray[np.int32], lens: LensTables, space: ObjectSpace
) -> None:  # fmt: skip
    """Process a wave of packets in object space after their query.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets found by Embree among those at rest relative to the camera; −1: none.
    lens : LensTables
    space : ObjectSpace
    """
    options, flow, frames, objects, aim = space
    facets = objects.facets
    for i in range(len(wave)):
        packet = wave[i]
        begin_hit(flow.moving, options, packet, i)
        begin_in_field(objects.fields, options, packet)
        here = mover_of_frame(packet.frame)
        hit, again = first_hit(flow.moving, objects, packet, found, i)
        if again < np.inf:
            requery(options, flow, frames, OBJECTS, packet, again, False, LOST_OUTSIDE)
            continue
        if hit.prim < 0 and packet.tries == 0 and might_have_met(flow.moving, objects, packet):
            # Embree misses a ray aimed exactly at a vertex.
            requery(options, flow, frames, OBJECTS, packet, packet.query_from, True, LOST_OUTSIDE)
            continue
        if packet.kind != SHADOW and hit.curved[0] < 0 and not in_its_medium(flow.moving, objects, packet, hit):
            if hit.prim >= 0 and abs(packet.tries) < MAX_TRIES and is_in_contact(objects.glass, hit.prim):
                # By rounding, a face of a body already entered or left at its contact with another body.
                again = next_query_from(facets[hit.prim], packet, hit.t)
                take_ray(flow.moving, packet, here)
                requery(options, flow, frames, OBJECTS, packet, again, False, LOST_OUTSIDE)
                continue
            # The query started beyond a facet, near an edge of the body, or missed the body at a vertex.
            flow.counts[REQUERIES] += 1
            inside = bodies_round(packet)
            body = objects.by_rank[inside & RANK] if inside != 0 else facets[max(hit.prim, 0)].body
            hit = certain_hit(flow.moving, objects, packet)
            if hit.prim < 0 and (packet.bodies >= 0 or comes_out_ahead(flow.moving, objects, packet)):
                if packet.facet == LEFT_MEDIUM:
                    # Emitted from a point of a medium that glass displaces.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
                lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
                continue
        prim, t, along, curved = hit
        facet = facets[max(prim, 0)]
        if _bends_first(objects.fields, frames, lens, options, packet, t):
            _take_ray_into(flow.moving, packet, STILL)
            to_chord_end(objects.fields, space, packet)
            continue
        if prim >= 0 and is_sheer(objects, facet.body) and passes(objects, packet, prim, t, along):
            _pass_on(options, flow, frames, objects, packet, prim, t)
            continue
        met = Met(prim, t, curved[0] >= 0)
        if packet.kind == SHADOW:
            _follow_shadow(space, lens, packet, met)
            continue
        if is_stopped_by_media(objects.volumes, space, lens, packet, met):
            continue
        if packet.last != LEFT_LENS:
            enters = _enters_lens(frames, lens, packet, t)
            if enters and packet.kind == LAMP and options.paths != LAMP_ON_CAMERA:
                # Through the opening it ends inside the housing; otherwise it passes beside the lens.
                if prim >= 0 and facet.body < 0:
                    flow.book[LENS_FRONT] += packet.weight
                    continue
            elif enters:
                take_share(objects.fields, flow, packet)
                unaimed = packet.kind == SPECULAR or packet.kind == LAMP
                by_itself = unaimed or (packet.kind == SCATTERED and not options.aimed)
                if options.adjoint or packet.kind == CAMERA or by_itself:
                    _take_ray_into(flow.moving, packet, STILL)
                    x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
                    child = put(flow, LENS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, 0.0)
                    if packet.kind != LAMP:
                        child.kind = CAMERA
                    child.space = 0
                else:
                    # Scattered light goes into the lens by aimed children only.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                continue
            elif packet.kind == CAMERA and packet.facet == NO_SURFACE and not (options.adjoint or options.tracing):
                # Aimed from rough glass: light that does not go straight to the lens belongs to the other child.
                flow.book[SAMPLING_REMOVED] += packet.weight
                continue
            elif options.bounce and options.aimed and not options.adjoint and packet.facet != NO_SURFACE:
                # It left a target, which sends two packets this way: one aimed at the lens, one unaimed.
                into_glass = prim >= 0 and facet.body >= 0 and objects.medium[facet.body] != OPAQUE
                if into_glass and is_shared(objects.fields, packet):
                    take_share(objects.fields, flow, packet)
                elif into_glass and (packet.kind == CAMERA or packet.kind == SCATTERED):
                    share_with_other(flow, frames, aim, packet)
                elif packet.kind == CAMERA:
                    # Neither into the lens nor into glass: the unaimed packet lights whatever is there.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
        if prim < 0:
            end_here(options, flow, frames, packet, ESCAPED, S_ESCAPED)
            continue
        body = facet.body
        if body >= 0 and objects.medium[body] != OPAQUE:
            if not too_deep(options, flow, frames, packet):
                through_glass(objects.glass, space, packet, prim, t, curved)
            continue
        x, y, z = travel(flow, objects.media, packet, packet.medium, t)
        dx, dy, dz, weight = packet.dx, packet.dy, packet.dz, packet.weight
        slot = HOUSING if body < 0 else objects.target_slot[body]
        if body < 0 or options.tracing:
            status = S_ABSORBED if body < 0 else S_TARGET
            end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, status)
            continue
        if packet.kind == LAMP and not counts(options, packet):
            # Its path belongs to another class, estimated from the sensor.
            flow.book[SAMPLING_REMOVED] += packet.weight
            continue
        if too_deep(options, flow, frames, packet):
            continue
        meet_target(space, packet, prim, x, y, z, along)


@inlined
def _take_ray_into(moving: Any, packet: Any, mover: int) -> None:
    """Give the packet in hand its ray in the frame of a mover, and let that stand for the object frame."""
    take_ray(moving, packet, mover)
    hold_frame(moving, packet)


@kernel
def _pass_on(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, packet: Any, prim: int, t: float
) -> None:
    """Let a packet pass through a facet: query the same ray from behind the facet."""
    facet = objects.facets[prim]
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    behind = t + clear_of(facet, packet.x + t * dx, packet.y + t * dy, packet.z + t * dz, dx, dy, dz)
    if behind <= packet.query_from:
        # The query began behind the facet and has found it again.
        requery(options, flow, frames, OBJECTS, packet, next_query_from(facet, packet, t), False, LOST_OUTSIDE)
        return
    limit = packet.limit
    child = put(
        flow, OBJECTS, packet, OBJECT_FRAME, packet.x, packet.y, packet.z, dx, dy, dz, packet.weight, packet.key, behind
    )
    child.limit = limit
    keep_chord(flow.bending, packet, child)
    # A ray that met nothing is queried again from its start only once, whatever it passes through.
    child.tries = packet.tries


@inlined
def _follow_shadow(space: ObjectSpace, lens: LensTables, packet: Any, met: Met) -> None:
    """Let a shadow packet bring its light if nothing stands in between."""
    objects = space.objects
    if packet.light == TO_LAMP:
        if met.t < packet.limit or bends_before(objects.fields, packet, packet.limit):
            return
        reach = packet.limit
    elif packet.light == TO_FACET:
        reach = met.t
        # A scattered packet that meets the lens first enters it with its full weight.
        if not is_reached(objects, packet, met.prim, met.t, space.flow.moving) or _enters_lens(
            space.frames, lens, packet, reach
        ):
            return
        if bends_before(objects.fields, packet, reach):
            return
    else:
        reach = min(way_through_media(space, lens, packet, met), straight_mm(objects.fields, packet))
    bring_light(space, packet, reach)


@inlined
def _enters_lens(frames: Array, lens: LensTables, packet: Any, t: float) -> bool:
    """Tell whether a packet enters the box round the lens within a distance."""
    px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
    ex, ey, ez = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
    return box_entry(lens.box_low, lens.box_high, Ray(px, py, pz, ex, ey, ez)) < t


@inlined
def _bends_first(
    fields: Any, frames: Array, lens: LensTables, options: Options, packet: Any, t: float
) -> bool:  # fmt: skip
    """Tell whether a packet comes to the end of its chord before its hit and before the lens.

    Shadow packets stay on their straight line. `fields` is None if nothing bends light; numba then compiles only the
    first line.
    """
    if fields is None:
        return False
    if packet.kind == SHADOW or not bends_before(fields, packet, t):
        return False
    if packet.last == LEFT_LENS or (packet.kind == LAMP and options.paths != LAMP_ON_CAMERA):
        return True
    return not _enters_lens(frames, lens, packet, straight_mm(fields, packet))
