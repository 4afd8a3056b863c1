"""Object space: hits on targets, glass and housing, shadow packets, and entry into the lens.

Everything is in the object frame, and both methods share the kernel. `targets` holds the scattering on targets.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.meshes.boxes import box_entry
from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.geometry.objects.round_faces import round_finder, round_normal
from lfmesh.geometry.ray import Ray, ray_of
from lfmesh.geometry.ray import along as point_along
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.bending import bends_before, next_chord, straight_mm
from lfmesh.transport.events.bodies import RANK, bodies_round, is_in
from lfmesh.transport.events.crossing import MAX_TRIES, end, end_here, lose, move_packet, requery, too_deep, write_query
from lfmesh.transport.events.facets import clear_of, crosses, next_query_from
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
    put,
)
from lfmesh.transport.paths.automaton import LAMP_ON_CAMERA, counts
from lfmesh.transport.regions.fields import begin_in_field, is_shared, take_share, to_chord_end
from lfmesh.transport.regions.glass import Curved, through_glass
from lfmesh.transport.regions.targets import meet_target, passes, share_with_other
from lfmesh.transport.regions.volumes import Met, is_stopped_by_media, way_through_media
from lfmesh.transport.tables.tables import OPAQUE, LensTables, ObjectTables

Array = NDArray[np.float64]


@kernel
def admit_to_objects(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], frames: Array, fields: Any
) -> None:
    """Write the rays of a wave for Embree, in the object frame.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Output.
    frames : (6, 6, 3, 4) float64
    fields : BendingFields or None
        Media that bend light; each packet is turned along its chord.
    """
    for i in range(len(wave)):
        move_packet(frames, wave[i], OBJECT_FRAME)
        next_chord(fields, wave[i])
        write_query(origins, directions, i, wave[i], 0.0, 0.0)


@kernel
def shade_objects(
    wave: NDArray[np.void], found: NDArray[np.int32], lens: LensTables, space: ObjectSpace
) -> None:  # fmt: skip
    """Process a wave of packets in object space after their query.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets found by Embree; −1: none.
    lens : LensTables
    space : ObjectSpace
    """
    options, flow, frames, objects, aim = space
    facets = objects.facets
    for i in range(len(wave)):
        packet = wave[i]
        begin_in_field(objects.fields, options, packet)
        x, y, z = packet.x, packet.y, packet.z
        dx, dy, dz = packet.dx, packet.dy, packet.dz
        prim = found[i]
        t, along = np.inf, 0.0
        facet = facets[max(prim, 0)]
        if prim >= 0:
            normal = facet.normal
            along = normal[0] * dx + normal[1] * dy + normal[2] * dz
            height = normal[0] * x + normal[1] * y + normal[2] * z - facet.offset
            t = -height / along if along != 0.0 else -np.inf
            # A hit closer than the start of the query is on the facet that the packet left, or on one in its plane.
            if prim == packet.facet or t <= 0.25 * packet.query_from or t <= 0.0:
                if abs(packet.tries) < MAX_TRIES:
                    again = next_query_from(facet, packet, t if t > 0.0 else 0.0)
                    requery(options, flow, frames, OBJECTS, packet, again, False, LOST_OUTSIDE)
                    continue
                prim, t, along = _first_crossing(objects, packet)
                facet = facets[max(prim, 0)]
        prim, t, along, curved = _first_of_all(objects, packet, prim, t, along)
        facet = facets[max(prim, 0)]
        if prim < 0 and packet.tries == 0 and _might_have_met(objects, packet):
            # Embree misses a ray aimed exactly at a vertex.
            requery(options, flow, frames, OBJECTS, packet, packet.query_from, True, LOST_OUTSIDE)
            continue
        if packet.kind != SHADOW and curved[0] < 0 and not _in_its_medium(objects, packet, prim, t, along):
            if prim >= 0 and abs(packet.tries) < MAX_TRIES and _is_in_contact(objects.glass, prim):
                # By rounding, a face of a body already entered or left at its contact with another body.
                requery(options, flow, frames, OBJECTS, packet, next_query_from(facet, packet, t), False, LOST_OUTSIDE)
                continue
            # The query started beyond a facet, near an edge of the body, or missed the body at a vertex.
            flow.counts[REQUERIES] += 1
            inside = bodies_round(packet)
            body = objects.by_rank[inside & RANK] if inside != 0 else facet.body
            prim, t, along = _first_crossing(objects, packet)
            prim, t, along, curved = _first_of_all(objects, packet, prim, t, along)
            if prim < 0 and (packet.bodies >= 0 or _comes_out_ahead(objects, packet)):
                if packet.facet == LEFT_MEDIUM:
                    # Emitted from a point of a medium that glass displaces.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
                lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
                continue
            facet = facets[max(prim, 0)]
        if _bends_first(objects.fields, frames, lens, options, packet, t):
            to_chord_end(objects.fields, space, packet)
            continue
        if prim >= 0 and _is_sheer(objects, facet.body) and passes(objects, packet, prim, t, along):
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
        weight = packet.weight
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
def _first_of_all(
    objects: ObjectTables, packet: Any, prim: int, t: float, along: float
) -> tuple[int, float, float, Curved]:
    """Return the first hit of a packet: a facet already found, or a curved patch or round face before it.

    Parameters
    ----------
    prim : int
        Facet; −1: none.
    t : float, mm
        Distance of the facet; limits the search if it lies ahead.
    along : float
        The facet's normal · direction.

    Returns
    -------
    prim, t, along
        The first hit.
    curved : tuple
        As from `_first_curved`, also for a round face of glass.
    """
    curved = _first_curved(objects.glass, objects, packet, t if t > 0.0 else np.inf)
    if curved[0] >= 0:
        prim, t, along = _as_met(curved, packet.dx, packet.dy, packet.dz)
    return _round_before(objects.rounds, objects, packet, prim, t, along, curved)


@inlined
def _sense_at(state: Any, body: int) -> float:
    """Return the side from which a packet meets the patches of a body, by the bodies around it."""
    inside, rank = state
    return 1.0 if is_in(inside, rank[body]) else -1.0


_first_patch = patch_finder(_sense_at)


@inlined
def _first_curved(glass: Any, objects: ObjectTables, packet: Any, until: float) -> Curved:
    """Return the first curved patch of glass that a packet meets within a distance, even if it misses all facets.

    Parameters
    ----------
    glass : GlassTables or None
        None: there is no glass, and numba compiles only the first line.

    Returns
    -------
    prim : int
        Facet of the patch; −1: none.
    t : float, mm
    nx, ny, nz : float
        Unit normal of the patch, oriented like its facet's.
    """
    if glass is None:
        return -1, until, 0.0, 0.0, 1.0
    if packet.kind == SHADOW:
        until = min(until, packet.limit)
    state = bodies_round(packet), objects.rank
    return _first_patch(glass.tree, state, ray_of(packet), 0.0, until)


@inlined
def _is_met(state: Any, number: int, t: float, along: float) -> bool:
    """Tell whether a round face stops a packet: glass by the bodies around the packet, transparent targets by chance.

    `state` holds ObjectTables and PACKET; see `round_finder`.
    """
    objects, packet = state
    prim = objects.rounds.first + number
    body = objects.facets[prim].body
    if objects.medium[body] != OPAQUE:
        return (along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return not (_is_sheer(objects, body) and passes(objects, packet, prim, t, along))


_first_round = round_finder(_is_met)


@inlined
def _round_before(
    rounds: Any, objects: ObjectTables, packet: Any, prim: int, t: float, along: float, curved: Curved
) -> tuple[int, float, float, Curved]:
    """Return the result of `_first_of_all` from the first hit on a facet or curved patch.

    `rounds` is None if there are no round faces; numba then compiles only the first line.
    """
    if rounds is None:
        return prim, t, along, curved
    until = t if t > 0.0 else np.inf
    if packet.kind == SHADOW and packet.light == TO_LAMP:
        # A way to an emitting facet extends to the facet itself.
        until = min(until, packet.limit)
    ray = ray_of(packet)
    number, nearest, steepness = _first_round(rounds, (objects, packet), ray, packet.facet - rounds.first, until)
    if number < 0:
        return prim, t, along, curved
    found = rounds.first + number
    if objects.medium[objects.facets[found].body] == OPAQUE:
        return found, nearest, steepness, (-1, nearest, 0.0, 0.0, 1.0)
    x, y, z = point_along(ray, nearest)
    nx, ny, nz = round_normal(rounds.faces[number], x, y, z)
    return found, nearest, steepness, (found, nearest, nx, ny, nz)


@inlined
def _as_met(curved: Curved, dx: float, dy: float, dz: float) -> tuple[int, float, float]:
    """Return the facet of a patch, the distance of the patch, and normal · direction there."""
    return curved[0], curved[1], curved[2] * dx + curved[3] * dy + curved[4] * dz


@inlined
def _is_sheer(objects: ObjectTables, body: int) -> bool:
    """Tell whether light may pass straight through a target that is not glass."""
    return body >= 0 and objects.opacity[body] < 1.0


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
        if not is_reached(objects, packet, met.prim, met.t) or _enters_lens(space.frames, lens, packet, reach):
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


@inlined
def _in_its_medium(objects: ObjectTables, packet: Any, prim: int, t: float, along: float) -> bool:
    """Tell whether a packet can meet a facet from that side, or nothing (−1), by the bodies around it."""
    if prim < 0:
        return packet.bodies < 0
    body = objects.facets[prim].body
    if body >= 0 and objects.medium[body] != OPAQUE:
        return (along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return packet.bodies < 0 or not _is_outside(objects.glass, objects, packet, t)


@inlined
def _is_outside(glass: Any, objects: ObjectTables, packet: Any, t: float) -> bool:
    """Tell whether a packet in a body of glass would have left the body's box at a distance."""
    if glass is None:
        return False
    low, high = glass.boxes[objects.by_rank[bodies_round(packet) & RANK]]
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    return not (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2])


@inlined
def _is_in_contact(glass: Any, prim: int) -> bool:
    """Tell whether a facet may lie on a facet of another body of glass."""
    if glass is None:
        return False
    return len(glass.contact_first) > 0 and glass.contact_first[prim + 1] > glass.contact_first[prim]


@inlined
def _might_have_met(objects: ObjectTables, packet: Any) -> bool:
    """Tell whether a packet outside all glass that met nothing starts far away and passes near the targets."""
    if packet.kind == SHADOW or packet.bodies >= 0:
        return False
    x, y, z, dx, dy, dz = ray_of(packet)
    toward = -(x * dx + y * dy + z * dz)
    distance2, radius2 = x * x + y * y + z * z, objects.radius * objects.radius
    return toward > 0.0 and distance2 > radius2 and distance2 - toward * toward <= radius2


@kernel
def _first_crossing(objects: ObjectTables, packet: Any) -> tuple[int, float, float]:
    """Return the first facet that a packet can meet, its distance, and normal · direction; −1: none.

    All facets are tested in float64: slow but certain. The facet just left faces the wrong way for the packet's medium,
    so no distance from the start is needed; the start on a curved patch may even lie slightly beyond the next facet.
    """
    x, y, z, dx, dy, dz = ray_of(packet)
    first, nearest, steepness = -1, np.inf, 0.0
    # `limit` is the distance of the light for a shadow packet, the way past the lens for a packet from the lens.
    back = 0.0 if packet.kind == SHADOW or packet.last == LEFT_LENS else packet.limit
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        if t < nearest and t > -back and prim != packet.facet:
            body = objects.facets[prim].body
            glass = body >= 0 and objects.medium[body] != OPAQUE
            if (glass or t > 0.0) and _in_its_medium(objects, packet, prim, t, along):
                if _is_sheer(objects, body) and passes(objects, packet, prim, t, along):
                    continue
                first, nearest, steepness = prim, t, along
    return first, nearest, steepness


@kernel
def _comes_out_ahead(objects: ObjectTables, packet: Any) -> bool:
    """Tell whether a packet in no body would leave a body ahead, and so must have entered it unnoticed.

    Otherwise nothing lies ahead: the ray passes the edge of the facet that Embree found.
    """
    x, y, z, dx, dy, dz = ray_of(packet)
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        body = objects.facets[prim].body
        if along > 0.0 and packet.limit < t < np.inf and body >= 0 and objects.medium[body] != OPAQUE:
            return True
    return False
