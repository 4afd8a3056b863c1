"""Object space: hits on targets, glass and housing, shadow packets, and entry into the lens.

All in the object frame. The same kernel serves both methods. Scattering on targets is in `targets`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.meshes.levels import PATCH
from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aiming.mixture import aimed
from lfmesh.transport.events.crossing import (
    AIM_DISK,
    AIM_U,
    AIM_V,
    MAX_TRIES,
    box_entry,
    clear_of,
    crosses,
    deposit,
    draw,
    end,
    end_here,
    facet_normal,
    lose,
    meets_patch,
    move_packet,
    nearest_on_facet,
    next_query_from,
    reflected,
    refracted,
    requery,
    too_deep,
    write_query,
)
from lfmesh.transport.events.interface import (
    divided,
    is_coated,
    is_rough,
    scattered,
    scattered_density,
    scatterer,
    splitter,
)
from lfmesh.transport.events.lighting import from_light
from lfmesh.transport.events.polarisation import IN_OBJECTS, shares_by_state
from lfmesh.transport.events.travel import arrive, transmitted, travel
from lfmesh.transport.packets.book import (
    ESCAPED,
    HOUSING,
    LENS_FRONT,
    LOST_CONTRADICTION,
    LOST_OUTSIDE,
    SAMPLING_ADDED,
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
    ON_GLASS,
    REQUERIES,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    SCATTERED,
    SHADOW,
    SPECULAR,
    TO_EMITTER,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import LAMP_ON_CAMERA, counts
from lfmesh.transport.regions.bodies import (
    RANK,
    TOO_MANY,
    beyond_facet,
    bodies_round,
    is_in,
    medium_of,
    set_bodies,
)
from lfmesh.transport.regions.targets import AIMED_CHILD, meet_target, passes, share_with_other
from lfmesh.transport.regions.volumes import is_stopped_by_media
from lfmesh.transport.tables.tables import AIR, OPAQUE, AimTables, LensTables, ObjectTables, body_row

Array = NDArray[np.float64]
Curved = tuple[int, float, float, float, float]


@kernel
def admit_to_objects(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], frames: Array
) -> None:
    """Write the rays of a wave for Embree, in the object frame.

    Parameters
    ----------
    wave : (n,) PACKET
    origins, directions : (n, 3) float32
        Written.
    frames : (6, 6, 3, 4) float64
    """
    for i in range(len(wave)):
        move_packet(frames, wave[i], OBJECT_FRAME)
        write_query(origins, directions, i, wave[i], 0.0, 0.0)


@kernel
def shade_objects(
    wave: NDArray[np.void], found: NDArray[np.int32],
    objects: ObjectTables, lens: LensTables, aim: AimTables, frames: Array, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Process a wave of packets in object space after their query.

    Parameters
    ----------
    wave : (n,) PACKET
    found : (n,) int32
        Facets that Embree found; −1: none.
    """
    facets = objects.facets
    for i in range(len(wave)):
        packet = wave[i]
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
            # A hit nearer than the start of the query is on the facet that the packet left, or on one in its plane.
            if prim == packet.facet or t <= 0.25 * packet.query_from or t <= 0.0:
                if abs(packet.tries) < MAX_TRIES:
                    again = next_query_from(facet, packet, t if t > 0.0 else 0.0)
                    requery(options, flow, frames, OBJECTS, packet, again, False, LOST_OUTSIDE)
                    continue
                prim, t, along = _first_crossing(objects, packet, x, y, z, dx, dy, dz)
                facet = facets[max(prim, 0)]
        curved = _first_curved(objects.glass, objects, packet, t if t > 0.0 else np.inf)
        if curved[0] >= 0:
            prim, t, along = _as_met(curved, dx, dy, dz)
            facet = facets[prim]
        elif prim < 0 and packet.tries == 0 and _might_have_met(objects, packet, x, y, z, dx, dy, dz):
            # Embree lets a ray pass that is aimed exactly at a vertex.
            requery(options, flow, frames, OBJECTS, packet, packet.query_from, True, LOST_OUTSIDE)
            continue
        asks = packet.kind == SHADOW or packet.kind >= TO_EMITTER
        if not asks and curved[0] < 0 and not _in_its_medium(objects, packet, prim, along):
            if prim >= 0 and abs(packet.tries) < MAX_TRIES and _is_in_contact(objects.glass, prim):
                # To rounding, a face of a body that was already entered or left where it touches another body.
                requery(options, flow, frames, OBJECTS, packet, next_query_from(facet, packet, t), False, LOST_OUTSIDE)
                continue
            # The query started beyond a facet, near an edge of the body, or missed the body at a vertex.
            flow.counts[REQUERIES] += 1
            inside = bodies_round(packet)
            body = objects.by_rank[inside & RANK] if inside != 0 else facet.body
            prim, t, along = _first_crossing(objects, packet, x, y, z, dx, dy, dz)
            curved = _first_curved(objects.glass, objects, packet, t if t > 0.0 else np.inf)
            if curved[0] >= 0:
                prim, t, along = _as_met(curved, dx, dy, dz)
            if prim < 0 and (packet.bodies >= 0 or _comes_out_ahead(objects, packet, x, y, z, dx, dy, dz)):
                if packet.facet == LEFT_MEDIUM:
                    # Emitted from a point of a medium where glass is in its place.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
                lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
                continue
            facet = facets[max(prim, 0)]
        if prim >= 0 and _is_sheer(objects, facet.body) and passes(objects, packet, prim, t):
            _pass_on(options, flow, frames, objects, packet, prim, t)
            continue
        if is_stopped_by_media(
            objects.volumes, options, flow, frames, objects, lens, aim, packet, prim, t, curved[0] >= 0
        ):
            continue
        if packet.kind == SHADOW:
            if t >= packet.limit:
                # Straight from a lamp, and lamps stand in air, which absorbs nothing.
                deposit(options, flow, packet.source, packet.colour, packet.weight)
            continue
        if packet.last != LEFT_LENS:
            px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
            ex, ey, ez = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, dx, dy, dz)
            enters = box_entry(lens.box_low, lens.box_high, px, py, pz, ex, ey, ez) < t
            if packet.kind == TO_EMITTER:
                # A scattered packet that comes to the lens first goes into it, and keeps its full weight.
                if not enters and _arrives(objects, packet, prim):
                    share = transmitted(objects.media.absorption, packet.medium, packet.colour, t)
                    deposit(options, flow, packet.source, packet.colour, packet.weight * share)
                continue
            if enters and packet.kind == LAMP and options.paths != LAMP_ON_CAMERA:
                # Through the opening it meets the inside of the housing, and ends; else it passes beside the lens.
                if prim >= 0 and facet.body < 0:
                    flow.book[LENS_FRONT] += packet.weight
                    continue
            elif enters:
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
                # Aimed from rough glass: what does not go straight to the lens is the other child's.
                flow.book[SAMPLING_REMOVED] += packet.weight
                continue
            elif options.bounce and options.aimed and not options.adjoint and packet.facet != NO_SURFACE:
                # It left a target, which sends two packets this way: one aimed at the lens, one not aimed.
                into_glass = prim >= 0 and facet.body >= 0 and objects.medium[facet.body] != OPAQUE
                if into_glass and (packet.kind == CAMERA or packet.kind == SCATTERED):
                    share_with_other(flow, frames, aim, packet)
                elif packet.kind == CAMERA:
                    # Neither into the lens nor into glass: whatever is there is lit by the packet that is not aimed.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
        if prim < 0:
            end_here(options, flow, frames, packet, ESCAPED, S_ESCAPED)
            continue
        body = facet.body
        if body >= 0 and objects.medium[body] != OPAQUE:
            if not too_deep(options, flow, frames, packet):
                _through_glass(objects.glass, options, flow, frames, objects, aim, packet, prim, t, curved)
            continue
        x, y, z = travel(flow, objects.media, packet, packet.medium, t)
        weight = packet.weight
        slot = HOUSING if body < 0 else objects.target_slot[body]
        if body < 0 or options.tracing:
            status = S_ABSORBED if body < 0 else S_TARGET
            end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, status)
            continue
        if packet.kind == LAMP and not counts(options, packet):
            # Its path belongs to another class, which is estimated from the sensor.
            flow.book[SAMPLING_REMOVED] += packet.weight
            continue
        if too_deep(options, flow, frames, packet):
            continue
        meet_target(options, flow, frames, objects, aim, packet, prim, x, y, z, along)


@inlined
def _sense_at(state: Any, body: int) -> float:
    """Return the sense in which a packet that is in some bodies of glass meets the patches of a body."""
    inside, rank = state
    return 1.0 if is_in(inside, rank[body]) else -1.0


_first_patch = patch_finder(_sense_at)


@inlined
def _first_curved(glass: Any, objects: ObjectTables, packet: Any, until: float) -> Curved:
    """Return the first curved patch of glass that a packet meets before a distance, even where it passes all facets.

    Parameters
    ----------
    glass : GlassTables or None
        None: there is no glass, and numba compiles nothing but the first line.
    until : float, mm

    Returns
    -------
    prim : int
        Facet of the patch; −1: it meets none.
    t : float, mm
    nx, ny, nz : float
        Unit normal of the patch, in the sense of its facet's.
    """
    if glass is None:
        return -1, until, 0.0, 0.0, 1.0
    if packet.kind == SHADOW:
        until = min(until, packet.limit)
    state = bodies_round(packet), objects.rank
    return _first_patch(glass.tree, state, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, 0.0, until)


@inlined
def _as_met(curved: Curved, dx: float, dy: float, dz: float) -> tuple[int, float, float]:
    """Return the facet of a patch, the distance of the patch, and normal · direction there."""
    return curved[0], curved[1], curved[2] * dx + curved[3] * dy + curved[4] * dz


@inlined
def _is_sheer(objects: ObjectTables, body: int) -> bool:
    """Tell whether light may pass straight through a target that is no glass."""
    return body >= 0 and objects.opacity[body] < 1.0


@kernel
def _pass_on(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, packet: Any, prim: int, t: float
) -> None:
    """Let a packet pass through a facet: the same ray is queried from behind the facet."""
    facet = objects.facets[prim]
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    behind = t + clear_of(facet, packet.x + t * dx, packet.y + t * dy, packet.z + t * dz, dx, dy, dz)
    if behind <= packet.query_from:
        # The query, which began behind it, has found it once more.
        requery(options, flow, frames, OBJECTS, packet, next_query_from(facet, packet, t), False, LOST_OUTSIDE)
        return
    limit = packet.limit
    child = put(
        flow, OBJECTS, packet, OBJECT_FRAME, packet.x, packet.y, packet.z, dx, dy, dz, packet.weight, packet.key, behind
    )
    child.limit = limit
    # A ray that met nothing is queried again from its start, but once only, whatever it passes through.
    child.tries = packet.tries


@inlined
def _arrives(objects: ObjectTables, packet: Any, prim: int) -> bool:
    """Tell whether a packet meets the emitting facet that it was sent to, when the query found the facet `prim`."""
    if prim < 0 or prim == packet.to_facet:
        return prim >= 0
    # Next to an edge, float32 may find the neighbour of the right facet.
    facet = objects.facets[prim]
    if facet.body != objects.facets[packet.to_facet].body:
        return False
    return crosses(facet, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)[0] == np.inf


@inlined
def _in_its_medium(objects: ObjectTables, packet: Any, prim: int, along: float) -> bool:
    """Tell whether a packet can meet a facet from that side, by the bodies it is in; −1: whether it can meet none."""
    if prim < 0:
        return packet.bodies < 0
    body = objects.facets[prim].body
    if body >= 0 and objects.medium[body] != OPAQUE:
        return (along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return True


@inlined
def _is_in_contact(glass: Any, prim: int) -> bool:
    """Tell whether a facet may lie on one of another body of glass."""
    if glass is None:
        return False
    return len(glass.contact_first) > 0 and glass.contact_first[prim + 1] > glass.contact_first[prim]


@inlined
def _might_have_met(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Tell whether a packet outside all glass that met nothing comes from afar and passes near the targets."""
    if packet.kind == SHADOW or packet.kind >= TO_EMITTER or packet.bodies >= 0:
        return False
    toward = -(x * dx + y * dy + z * dz)
    distance2, radius2 = x * x + y * y + z * z, objects.radius * objects.radius
    return toward > 0.0 and distance2 > radius2 and distance2 - toward * toward <= radius2


@kernel
def _first_crossing(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[int, float, float]:
    """Return the first facet that a packet can meet, the distance, and normal · direction; −1: none.

    All facets are tested in float64: slow but certain. The facet that the packet left faces the wrong way for its
    medium, so no distance from the start has to be kept; the start on a curved patch may even lie slightly beyond the
    next facet.
    """
    first, nearest, steepness = -1, np.inf, 0.0
    # A shadow packet's `limit` is the distance of its light, that of a packet from the lens the way past the lens.
    back = 0.0 if packet.kind == SHADOW or packet.last == LEFT_LENS else packet.limit
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        if t < nearest and t > -back and prim != packet.facet:
            body = objects.facets[prim].body
            glass = body >= 0 and objects.medium[body] != OPAQUE
            if (glass or t > 0.0) and _in_its_medium(objects, packet, prim, along):
                if _is_sheer(objects, body) and passes(objects, packet, prim, t):
                    continue
                first, nearest, steepness = prim, t, along
    return first, nearest, steepness


@kernel
def _comes_out_ahead(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Tell whether a packet that is in no body would leave a body ahead, which it must have entered unnoticed.

    If not, nothing lies ahead: the facet that Embree found is one whose edge the ray passes.
    """
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        body = objects.facets[prim].body
        if along > 0.0 and packet.limit < t < np.inf and body >= 0 and objects.medium[body] != OPAQUE:
            return True
    return False


@inlined
def _send_from_glass(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at a facet of glass, with the bodies on the child's side."""
    objects, prim, inside, after = place
    set_bodies(packet, after if refracts else inside)
    clear = clear_of(objects.facets[prim], x, y, z, dx, dy, dz)
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, key, clear)


_split_at_glass = splitter(_send_from_glass)
_send_from_rough_glass = scatterer(_send_from_glass)


@kernel
def _through_glass(
    glass: Any, options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any,
    prim: int, t: float, curved: Curved,
) -> None:  # fmt: skip
    """Split a packet at a facet of a glass body, at distance t, by the media on both sides.

    A facet between equal indices, or inside another body of a higher rank, has no effect.

    Parameters
    ----------
    glass : GlassTables or None
        None: there is no glass, and numba compiles nothing but the first line.
    curved : tuple
        From `_first_curved`: if it is a patch, t is its distance.
    """
    if glass is None:
        return
    facet = objects.facets[prim]
    body = facet.body
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    x, y, z = packet.x + t * dx, packet.y + t * dy, packet.z + t * dz
    inside = bodies_round(packet)
    entering = not is_in(inside, objects.rank[body])
    on_patch = curved[0] >= 0
    if on_patch:
        # Bodies that touch have the same facets: which of them are met is seen on the facet, along its normal.
        fx, fy, fz = nearest_on_facet(facet, x, y, z)
        sense, normal = -1.0 if entering else 1.0, facet.normal
        after = beyond_facet(
            objects, glass, inside, prim, entering, fx, fy, fz, sense * normal[0], sense * normal[1], sense * normal[2]
        )  # fmt: skip
    else:
        after = beyond_facet(objects, glass, inside, prim, entering, x, y, z, dx, dy, dz)
    if after == TOO_MANY:
        lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
        return
    beyond = medium_of(objects, after)
    media, own = len(objects.media.indices), objects.medium[body]
    number = body_row(body, beyond if packet.medium == own else packet.medium, media)
    rough = is_rough(glass.interfaces, number)
    level = glass.level[body]
    if on_patch:
        nx, ny, nz = curved[2], curved[3], curved[4]
    elif level == PATCH:
        met, more, nx, ny, nz = meets_patch(flow, glass.patches, glass.across, facet, prim, x, y, z, dx, dy, dz)
        if rough:
            # A ray that scatters along a curved patch would run between it and the facets, where no query finds a way
            # out: it starts on the facet, and only the normal is the patch's.
            more = 0.0
        elif met and t + more <= 0.0:
            further = next_query_from(facet, packet, t)
            requery(options, flow, frames, OBJECTS, packet, further, False, objects.lost_slot[body])
            return
        x, y, z = x + more * dx, y + more * dy, z + more * dz
    else:
        nx, ny, nz = facet_normal(level, facet, x, y, z)
    cos_i = nx * dx + ny * dy + nz * dz
    if (cos_i < 0.0) != entering:
        # An interpolated normal may point against a grazing ray; the facet's normal then replaces it.
        normal = facet.normal
        nx, ny, nz = normal[0], normal[1], normal[2]
        cos_i = nx * dx + ny * dy + nz * dz
    if cos_i < 0.0:
        nx, ny, nz, cos_i = -nx, -ny, -nz, -cos_i
    cos_i = min(cos_i, 1.0)
    n_i, n_t = objects.media.indices[packet.medium, packet.colour], objects.media.indices[beyond, packet.colour]
    x, y, z = arrive(flow, objects.media, packet, packet.medium, x, y, z)
    # A coating between equal indices counts, unless a body of a higher rank covers it.
    uncovered = (after if entering else inside) & RANK == objects.rank[body]
    if n_i == n_t and inside != 0 and after != 0 and not (uncovered and is_coated(glass.interfaces, number)):
        packet.medium, packet.facet = beyond, NO_SURFACE
        if packet.kind == CAMERA and not (options.adjoint or options.tracing):
            # Its share is taken: from here on it is not the child that rough glass aims through air.
            packet.kind = SPECULAR
        set_bodies(packet, after)
        clear = clear_of(facet, x, y, z, dx, dy, dz)
        put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, clear)
        return
    if rough:
        place = objects, prim, inside, after, beyond, number, glass.interfaces
        _through_rough_glass(place, options, flow, frames, aim, packet, x, y, z, nx, ny, nz, n_i, n_t)
        return
    reflectance, transmittance, cos_t = divided(
        glass.interfaces, number, packet.colour, n_i, n_t, cos_i, not entering, packet, flow.book
    )
    reflectance, transmittance = shares_by_state(
        flow.polarised, IN_OBJECTS, number, not entering, n_i, n_t, cos_i, (nx, ny, nz), frames, OBJECT_FRAME, packet,
        flow.book, reflectance, transmittance,
    )  # fmt: skip
    packet.facet = NO_SURFACE
    packet.last = NO_SURFACE
    if packet.kind != LAMP:
        packet.kind = SPECULAR
    _split_at_glass(
        (objects, prim, inside, after), options, flow, frames, OBJECT_FRAME, packet, ON_GLASS, body, beyond,
        x, y, z, reflectance, transmittance,
        reflected(dx, dy, dz, nx, ny, nz), refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t),
    )  # fmt: skip


@kernel
def _through_rough_glass(
    place: Any, options: Options, flow: Flow, frames: Array, aim: AimTables, packet: Any,
    x: float, y: float, z: float, nx: float, ny: float, nz: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    """Gather light at a rough facet of glass, and send the packet on in a random direction, with its whole weight.

    As on a target, the adjoint method finds the light of lamps by next-event estimation. The forward method sends a
    child aimed at the entrance pupil, which counts if it goes straight there; the other child counts if it does not.

    Parameters
    ----------
    place : tuple
        Object tables, facet, bodies before and after it, medium beyond it, and row of the interface in their table.
    x, y, z : float, mm
        Point on the interface.
    nx, ny, nz : float
        Unit normal along the ray.
    n_i, n_t : float
        Refractive index before and after the interface.
    """
    objects, prim, inside, after, beyond, number, interfaces = place
    packet.facet, packet.last = NO_SURFACE, NO_SURFACE
    if packet.kind == LAMP and not counts(options, packet):
        # Its path belongs to another class, which is estimated from the sensor.
        flow.book[SAMPLING_REMOVED] += packet.weight
        return
    if options.adjoint and counts(options, packet):
        _ask_lights_at_glass(place, options, flow, packet, x, y, z, nx, ny, nz, n_i, n_t)
    passes, dx, dy, dz = scattered(
        interfaces, number, options, packet, n_i, n_t, packet.dx, packet.dy, packet.dz, nx, ny, nz
    )
    fx, fy, fz = _along_facet(objects.facets[prim], nx, ny, nz)
    if (fx * dx + fy * dy + fz * dz > 0.0) != passes:
        # The normal of a curved patch, or an interpolated one, differs from the facet's, which parts the media.
        dx, dy, dz = reflected(dx, dy, dz, fx, fy, fz)
    packet.kind = SPECULAR
    if options.aimed and not options.adjoint and not options.tracing:
        _aim_from_glass(place, flow, frames, aim, packet, x, y, z, nx, ny, nz, n_i, n_t)
        packet.kind = SCATTERED
    _send_from_rough_glass(
        (objects, prim, inside, after), options, flow, frames, OBJECT_FRAME, packet, ON_GLASS,
        objects.facets[prim].body, beyond, x, y, z, passes, dx, dy, dz,
    )  # fmt: skip


@inlined
def _along_facet(facet: Any, nx: float, ny: float, nz: float) -> tuple[float, float, float]:
    """Return a facet's normal, in the sense of the normal of its surface."""
    normal = facet.normal
    sense = 1.0 if normal[0] * nx + normal[1] * ny + normal[2] * nz > 0.0 else -1.0
    return sense * normal[0], sense * normal[1], sense * normal[2]


@kernel
def _ask_lights_at_glass(
    place: Any, options: Options, flow: Flow, packet: Any,
    x: float, y: float, z: float, nx: float, ny: float, nz: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    """Send a shadow packet to every light that a rough facet of glass sees through air, on either of its sides.

    Parameters
    ----------
    place, options, packet, x, y, z, nx, ny, nz, n_i, n_t
        As for `_through_rough_glass`.
    """
    objects = place[0]
    for light in range(len(objects.lights)):
        ux, uy, uz, reach, irradiance = from_light(options, objects, packet, light, x, y, z)
        if irradiance <= 0.0:
            continue
        density = _density_into_air(place, packet, nx, ny, nz, n_i, n_t, ux, uy, uz, light)
        if density > 0.0:
            weight = packet.weight * irradiance * density
            shadow = _put_in_air(place, flow, packet, x, y, z, ux, uy, uz, weight, packet.key)
            shadow.kind, shadow.facet, shadow.limit = SHADOW, place[1], reach


@kernel
def _aim_from_glass(
    place: Any, flow: Flow, frames: Array, aim: AimTables, packet: Any,
    x: float, y: float, z: float, nx: float, ny: float, nz: float, n_i: float, n_t: float,
) -> None:  # fmt: skip
    """Queue a child that is aimed at the entrance pupil, if the rough facet of glass sees it through air.

    Parameters
    ----------
    place, packet, x, y, z, nx, ny, nz, n_i, n_t
        As for `_through_rough_glass`.
    """
    px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
    ax, ay, az, at_lens = aimed(
        px, py, pz, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim,
        draw(packet, AIM_DISK), draw(packet, AIM_U), draw(packet, AIM_V),
    )  # fmt: skip
    if at_lens <= 0.0:
        return
    ux, uy, uz = move_direction(frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
    density = _density_into_air(place, packet, nx, ny, nz, n_i, n_t, ux, uy, uz, 0)
    if density > 0.0:
        weight = packet.weight * density / at_lens
        flow.book[SAMPLING_ADDED] += weight
        key = derived(packet.key, AIMED_CHILD + packet.events)
        child = _put_in_air(place, flow, packet, x, y, z, ux, uy, uz, weight, key)
        child.kind, child.start = CAMERA, weight


@kernel
def _density_into_air(
    place: Any, packet: Any, nx: float, ny: float, nz: float, n_i: float, n_t: float, ux: float, uy: float, uz: float,
    light: int,
) -> float:  # fmt: skip
    """Return the density, 1/sr, with which a rough facet scatters a packet in a direction; 0: not into air.

    Parameters
    ----------
    place, packet, nx, ny, nz, n_i, n_t
        As for `_through_rough_glass`.
    ux, uy, uz : float
        Unit direction.
    light : int
        See `scattered_density`.
    """
    objects, prim, inside, after, _, number, interfaces = place
    fx, fy, fz = _along_facet(objects.facets[prim], nx, ny, nz)
    passes = fx * ux + fy * uy + fz * uz > 0.0
    if (after if passes else inside) != 0:
        return 0.0
    density = 0.0
    # A direction is also what the facet makes of its mirror image, where that lies on the other side of the facet.
    for vx, vy, vz in ((ux, uy, uz), reflected(ux, uy, uz, fx, fy, fz)):
        if (nx * vx + ny * vy + nz * vz > 0.0) == passes:
            density += scattered_density(
                interfaces, number, packet, n_i, n_t, packet.dx, packet.dy, packet.dz, nx, ny, nz, vx, vy, vz,
                light,
            )  # fmt: skip
    return density


@inlined
def _put_in_air(
    place: Any, flow: Flow, packet: Any, x: float, y: float, z: float, ux: float, uy: float, uz: float,
    weight: float, key: np.uint64,
) -> Any:  # fmt: skip
    """Queue a child that leaves a facet of glass into air."""
    clear = clear_of(place[0].facets[place[1]], x, y, z, ux, uy, uz)
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, weight, key, clear)
    child.medium = AIR
    set_bodies(child, 0)
    return child
