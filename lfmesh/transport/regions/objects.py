"""Object space: targets that scatter and emit, lights, shadows, and the way into the lens.

Object frame. The same kernel serves both methods: in adjoint a packet that reaches a target gathers what leaves the
point towards it (own emission, and light by next-event estimation); in forward it scatters a child that is aimed at
the entrance pupil. In both it may go on to other targets.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.levels import PATCH
from lfmesh.kernel import inlined, kernel
from lfmesh.optics.scattering import lambertian, tangents
from lfmesh.transport.aiming.mixture import aimed, aimed_density
from lfmesh.transport.events.crossing import (
    AIM_DISK,
    AIM_U,
    AIM_V,
    BOUNCE_U,
    BOUNCE_V,
    KEEP_BOUNCE,
    LIGHT_U,
    LIGHT_V,
    MAX_TRIES,
    ask_again,
    barycentric,
    behind,
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
    record,
    reflected,
    refracted,
    too_deep,
    windowed,
    write_query,
)
from lfmesh.transport.events.interface import shares, splitter
from lfmesh.transport.events.travel import arrive, travel
from lfmesh.transport.packets.book import (
    ESCAPED,
    HOUSING,
    LENS_FRONT,
    LIT,
    LOST_CONTRADICTION,
    LOST_OUTSIDE,
    REACHED,
    SAMPLING_ADDED,
    SAMPLING_REMOVED,
)
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    E_SCATTERED,
    EVENTS,
    LAMP,
    LEFT_LENS,
    LENS,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    ON_GLASS,
    ON_TARGET,
    REQUERIES,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    SCATTERED,
    SHADOW,
    SPECULAR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.path_class import OFF_IMAGE_PATH, is_estimated
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, derived, uniform
from lfmesh.transport.regions.bodies import (
    RANK,
    TOO_MANY,
    beyond_facet,
    bodies_round,
    is_in,
    medium_of,
    set_bodies,
)
from lfmesh.transport.regions.lens import box_entry
from lfmesh.transport.tables.tables import AIR, DIRECTIONAL, DISK, OPAQUE, Aim, LensTables, ObjectTables

Array = NDArray[np.float64]

MM2 = 1e-6
"""m² in a mm²."""

AIMED_CHILD = 1 << 20
"""Number of the aimed child among a packet's children, out of the way of its events."""


LIGHT_DIMENSIONS = 1 << 12
"""Each light's random numbers start this many dimensions after the last one's."""


@kernel
def admit_to_objects(
    wave: NDArray[np.void], origins: NDArray[np.float32], directions: NDArray[np.float32], frames: Array
) -> None:
    """Write the rays of a wave."""
    for i in range(len(wave)):
        move_packet(frames, wave[i], OBJECT_FRAME)
        write_query(origins, directions, i, wave[i], 0.0, 0.0)


@kernel
def shade_objects(
    wave: NDArray[np.void], found: NDArray[np.int32],
    objects: ObjectTables, lens: LensTables, aim: Aim, frames: Array, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Shade a wave of packets in object space."""
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
            # Nearer than the query's start: the facet that the packet left, or a neighbour in its plane.
            if prim == packet.facet or t <= 0.25 * packet.query_from or t <= 0.0:
                if packet.tries < MAX_TRIES:
                    again = behind(facet, packet, t if t > 0.0 else 0.0)
                    ask_again(options, flow, frames, OBJECTS, packet, again, False, LOST_OUTSIDE)
                    continue
                prim, t, along = _first_crossing(objects, packet, x, y, z, dx, dy, dz)
                facet = facets[max(prim, 0)]
        elif packet.tries == 0 and _might_have_met(objects, packet, x, y, z, dx, dy, dz):
            # Embree lets a ray pass that is aimed exactly at a vertex.
            ask_again(options, flow, frames, OBJECTS, packet, packet.query_from, True, LOST_OUTSIDE)
            continue
        if packet.kind != SHADOW and not _in_its_medium(objects, packet, prim, along):
            if prim >= 0 and packet.tries < MAX_TRIES and _is_in_contact(objects, prim):
                # The face of a body that was entered or left where it touches another one, to rounding.
                ask_again(options, flow, frames, OBJECTS, packet, behind(facet, packet, t), False, LOST_OUTSIDE)
                continue
            # The query began beyond a facet, near an edge of the body, or slipped through the body at a vertex.
            flow.counts[REQUERIES] += 1
            inside = bodies_round(packet)
            body = objects.by_rank[inside & RANK] if inside != 0 else facet.body
            prim, t, along = _first_crossing(objects, packet, x, y, z, dx, dy, dz)
            if prim < 0 and (packet.column >= 0 or _comes_out_ahead(objects, packet, x, y, z, dx, dy, dz)):
                lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
                continue
            facet = facets[max(prim, 0)]
        if packet.kind == SHADOW:
            if t >= packet.limit:
                deposit(options, flow, packet.source, packet.wave, packet.weight)
            continue
        if packet.last != LEFT_LENS:
            px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
            ex, ey, ez = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, dx, dy, dz)
            enters = box_entry(lens.box_low, lens.box_high, px, py, pz, ex, ey, ez) < t
            if enters and packet.kind == LAMP:
                # Through the opening it comes to the housing's inside; else it passes by the lens, as a shadow's ray.
                if prim >= 0 and facet.body < 0:
                    flow.book[LENS_FRONT] += packet.weight
                    continue
            elif enters:
                by_itself = packet.kind == SPECULAR or (packet.kind == SCATTERED and not options.aimed)
                if options.adjoint or packet.kind == CAMERA or by_itself:
                    child = put(flow, LENS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, 0.0)
                    child.kind = CAMERA
                    child.space = 0
                else:
                    # Scattered light goes into the lens by aimed children only.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                continue
            elif options.bounce and options.aimed and not options.adjoint and packet.facet != NO_SURFACE:
                # It left a target, whose light goes this way in two packets: one aimed at the lens, one that was not.
                into_glass = prim >= 0 and facet.body >= 0 and objects.medium[facet.body] != OPAQUE
                if into_glass and (packet.kind == CAMERA or packet.kind == SCATTERED):
                    _share_with_other(flow, frames, objects, aim, packet)
                elif packet.kind == CAMERA:
                    # Neither to the lens nor into glass: what else is there, the other brings light to.
                    flow.book[SAMPLING_REMOVED] += packet.weight
                    continue
        if prim < 0:
            end_here(options, flow, frames, packet, ESCAPED, S_ESCAPED)
            continue
        body = facet.body
        if body >= 0 and objects.medium[body] != OPAQUE:
            if not too_deep(options, flow, frames, packet):
                _through_glass(options, flow, frames, objects, packet, prim, t)
            continue
        x, y, z = travel(flow, objects.media, packet, t)
        weight = packet.weight
        slot = HOUSING if body < 0 else objects.target_slot[body]
        if body < 0 or options.tracing:
            status = S_ABSORBED if body < 0 else S_TARGET
            end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, status)
            continue
        if packet.kind == LAMP and not is_estimated(options, packet):
            # Its light is that of another class, which finds it from the sensor.
            flow.book[SAMPLING_REMOVED] += packet.weight
            continue
        if too_deep(options, flow, frames, packet):
            continue
        flow.counts[EVENTS] += 1
        if objects.closed[body] and along > 0.0:
            end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
            continue
        side = -1.0 if along > 0.0 else 1.0
        texel = texture_at(objects, prim, packet.wave, x, y, z)
        albedo = objects.reflectance[body, packet.wave] * texel
        if options.adjoint and is_estimated(options, packet):
            flow.book[REACHED] += weight
            radiance = objects.radiance[body, packet.wave] * texel
            if radiance > 0.0:
                if packet.medium != AIR:
                    # It shines inside glass, and radiance falls by n² on the way out.
                    radiance /= objects.media.indices[packet.medium, packet.wave] ** 2
                deposit(options, flow, packet.source, packet.wave, weight * radiance)
            lit = radiance > 0.0
            if albedo > 0.0:
                lit = _ask_lights(objects, flow, packet, prim, x, y, z, side, albedo) or lit
            if lit:
                flow.book[LIT] += weight
        scattered = weight * albedo
        if scattered <= 0.0:
            end(options, flow, frames, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, slot, S_ABSORBED)
            continue
        flow.book[slot] += weight - scattered
        if packet.last == LEFT_LENS and not options.bounce and not options.adjoint:
            # The lens reflected it back. Without bounces the adjoint method has no such paths, and this one neither.
            flow.book[ESCAPED] += scattered
            continue
        packet.events += 1
        scatter(options, flow, frames, objects, aim, packet, prim, x, y, z, side, scattered)


@inlined
def _in_its_medium(objects: ObjectTables, packet: Any, prim: int, along: float) -> bool:
    """Tell whether a packet in its medium can meet a facet from that side; −1: whether it can meet nothing at all."""
    if prim < 0:
        return packet.column < 0
    body = objects.facets[prim].body
    if body >= 0 and objects.medium[body] != OPAQUE:
        return (along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return True


@inlined
def _is_in_contact(objects: ObjectTables, prim: int) -> bool:
    """Tell whether a facet may lie on one of another body."""
    return len(objects.contact_first) > 0 and objects.contact_first[prim + 1] > objects.contact_first[prim]


@inlined
def _might_have_met(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Tell whether a packet outside all glass that met nothing comes from afar and passes near the targets."""
    if packet.kind == SHADOW or packet.column >= 0:
        return False
    toward = -(x * dx + y * dy + z * dz)
    distance2, radius2 = x * x + y * y + z * z, objects.radius * objects.radius
    return toward > 0.0 and distance2 > radius2 and distance2 - toward * toward <= radius2


@kernel
def _first_crossing(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[int, float, float]:
    """Return the facet that a packet in its medium meets first, where, and normal · direction; −1: none.

    All facets are tried in float64: slow, and sure. The facet that the packet left faces its medium the wrong way, so
    no distance from the start need be kept; a curved start may even lie a little beyond the next facet.
    """
    first, nearest, steepness = -1, np.inf, 0.0
    # The limit of a shadow is its light's distance, that of a packet which passed the lens the way to it.
    back = 0.0 if packet.kind == SHADOW or packet.last == LEFT_LENS else packet.limit
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        if t < nearest and t > -back and prim != packet.facet:
            body = objects.facets[prim].body
            glass = body >= 0 and objects.medium[body] != OPAQUE
            if (glass or t > 0.0) and _in_its_medium(objects, packet, prim, along):
                first, nearest, steepness = prim, t, along
    return first, nearest, steepness


@kernel
def _comes_out_ahead(
    objects: ObjectTables, packet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> bool:
    """Tell whether a packet in the open would come out of glass ahead: it is in a body without having entered it.

    If not, nothing lies ahead, and what float32 found was the edge of a facet that the ray passes.
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
    """Send a child on from a facet of glass, among the bodies on its side of it."""
    objects, prim, inside, after = place
    set_bodies(packet, after if refracts else inside)
    clear = clear_of(objects.facets[prim], x, y, z, dx, dy, dz)
    put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, key, clear)


_split_at_glass = splitter(_send_from_glass)


@kernel
def _through_glass(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, packet: Any, prim: int, t: float
) -> None:
    """Split a packet at a facet of a glass body, which it meets at t, by the media on both sides.

    A facet within another body of a higher rank, or of the same index, is passed as if it were not there.
    """
    facet = objects.facets[prim]
    body = facet.body
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    x, y, z = packet.x + t * dx, packet.y + t * dy, packet.z + t * dz
    inside = bodies_round(packet)
    entering = not is_in(inside, objects.rank[body])
    after = beyond_facet(objects, inside, prim, entering, x, y, z, dx, dy, dz)
    if after == TOO_MANY:
        lose(options, flow, frames, packet, LOST_CONTRADICTION, objects.lost_slot[body])
        return
    level = objects.level[body]
    if level == PATCH:
        met, more, nx, ny, nz = meets_patch(flow, objects.patches, objects.across, facet, prim, x, y, z, dx, dy, dz)
        if met and t + more <= 0.0:
            ask_again(options, flow, frames, OBJECTS, packet, behind(facet, packet, t), False, objects.lost_slot[body])
            return
        x, y, z = x + more * dx, y + more * dy, z + more * dz
    else:
        nx, ny, nz = facet_normal(level, facet, x, y, z)
    cos_i = nx * dx + ny * dy + nz * dz
    if (cos_i < 0.0) != entering:
        # A bent normal may look away from a grazing ray; its facet then decides.
        normal = facet.normal
        nx, ny, nz = normal[0], normal[1], normal[2]
        cos_i = nx * dx + ny * dy + nz * dz
    if cos_i < 0.0:
        nx, ny, nz, cos_i = -nx, -ny, -nz, -cos_i
    cos_i = min(cos_i, 1.0)
    x, y, z = arrive(flow, objects.media, packet, x, y, z)
    beyond = medium_of(objects, after)
    n_i, n_t = objects.media.indices[packet.medium, packet.wave], objects.media.indices[beyond, packet.wave]
    if n_i == n_t and inside != 0 and after != 0:
        packet.medium, packet.facet = beyond, NO_SURFACE
        set_bodies(packet, after)
        clear = clear_of(facet, x, y, z, dx, dy, dz)
        put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, packet.key, clear)
        return
    reflectance, transmittance, cos_t = shares(objects.interfaces, body, packet.wave, n_i, n_t, cos_i)
    packet.facet = NO_SURFACE
    packet.last = NO_SURFACE
    if packet.kind != LAMP:
        packet.kind = SPECULAR
    _split_at_glass(
        (objects, prim, inside, after), options, flow, frames, OBJECT_FRAME, packet, ON_GLASS, body, beyond,
        x, y, z, reflectance, transmittance,
        reflected(dx, dy, dz, nx, ny, nz), refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t),
    )  # fmt: skip


@inlined
def texture_at(objects: ObjectTables, prim: int, wave: int, x: float, y: float, z: float) -> float:
    """Return the texture's value (linear light, bilinear, clamped) at a point of a facet; 1 without."""
    body = objects.facets[prim].body
    height = objects.texture[body, 1]
    if height == 0:
        return 1.0
    first, width = objects.texture[body, 0], objects.texture[body, 2]
    b, c = barycentric(objects.facets[prim], x, y, z)
    uv = objects.uv[prim]
    a = 1.0 - b - c
    u = a * uv[0, 0] + b * uv[1, 0] + c * uv[2, 0]
    v = a * uv[0, 1] + b * uv[1, 1] + c * uv[2, 1]
    column = u * width - 0.5
    row = (1.0 - v) * height - 0.5
    left, low = int(np.floor(column)), int(np.floor(row))
    right_share, low_share = column - left, row - low
    value = 0.0
    for j in range(2):
        for k in range(2):
            r = min(max(low + j, 0), height - 1)
            s = min(max(left + k, 0), width - 1)
            share = (low_share if j else 1.0 - low_share) * (right_share if k else 1.0 - right_share)
            value += share * objects.texels[first + r * width + s, wave]
    return value


@inlined
def _ask_lights(
    objects: ObjectTables, flow: Flow, packet: Any, prim: int,
    x: float, y: float, z: float, side: float, albedo: float,
) -> bool:  # fmt: skip
    """Send a shadow packet to every light that faces the point (next-event estimation); tell whether any does."""
    facet = objects.facets[prim]
    nx, ny, nz = side * facet.normal[0], side * facet.normal[1], side * facet.normal[2]
    any_light = False
    for number in range(len(objects.lights)):
        light = objects.lights[number]
        lx, ly, lz = light.position[0], light.position[1], light.position[2]
        ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
        reach = np.inf
        if light.kind == DIRECTIONAL:
            ux, uy, uz = -ax, -ay, -az
            irradiance = light.power
        else:
            if light.kind == DISK:
                dimension = packet.events * DIMENSIONS_PER_EVENT + LIGHT_U + LIGHT_DIMENSIONS * number
                r = light.radius * np.sqrt(uniform(packet.key, dimension))
                phi = 2.0 * np.pi * uniform(packet.key, dimension + LIGHT_V - LIGHT_U)
                px, py, pz, qx, qy, qz = tangents(ax, ay, az)
                a, b = r * np.cos(phi), r * np.sin(phi)
                lx, ly, lz = lx + a * px + b * qx, ly + a * py + b * qy, lz + a * pz + b * qz
            ux, uy, uz = lx - x, ly - y, lz - z
            distance2 = ux * ux + uy * uy + uz * uz
            reach = np.sqrt(distance2)
            ux, uy, uz = ux / reach, uy / reach, uz / reach
            if light.kind == DISK:
                cos_light = -(ux * ax + uy * ay + uz * az)
                irradiance = max(0.0, cos_light) * light.power / (np.pi * MM2 * distance2)
            else:
                irradiance = light.power / (4.0 * np.pi * MM2 * distance2)
        cos_surface = nx * ux + ny * uy + nz * uz
        if cos_surface <= 0.0 or irradiance <= 0.0:
            continue
        any_light = True
        shadow = put(
            flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz,
            packet.weight * albedo / np.pi * irradiance * cos_surface, packet.key,
            clear_of(facet, x, y, z, ux, uy, uz),
        )  # fmt: skip
        shadow.kind = SHADOW
        shadow.facet = prim
        shadow.limit = reach
    return any_light


@kernel
def scatter(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: Aim, packet: Any, prim: int,
    x: float, y: float, z: float, side: float, weight: float,
) -> None:  # fmt: skip
    """Scatter (or emit) a weight from a point of a facet, Lambertian: towards the camera, and to other targets."""
    if weight <= 0.0:
        return
    facet = objects.facets[prim]
    normal = facet.normal
    nx, ny, nz = side * normal[0], side * normal[1], side * normal[2]
    packet.facet = prim
    packet.last = NO_SURFACE
    if options.record:
        packet.node = record(
            flow, frames, OBJECT_FRAME, x, y, z, weight, ON_TARGET, facet.body, E_SCATTERED, packet.node
        )
    to_camera = 0.0
    if options.aimed and not options.adjoint:
        to_camera = _aim_at_camera(flow, frames, aim, facet, packet, x, y, z, nx, ny, nz, weight)
    if not options.bounce and (options.aimed or options.adjoint):
        # Nothing else is there to be met: what does not go to the camera escapes.
        flow.book[ESCAPED] += weight - to_camera
        return
    flow.book[SAMPLING_ADDED] += to_camera
    dimension = packet.events * DIMENSIONS_PER_EVENT + KEEP_BOUNCE
    cutoff = options.cutoff
    if options.paths == OFF_IMAGE_PATH and packet.stray == 0:
        cutoff = options.unturned_cutoff
    weight = windowed(flow.book, weight, cutoff * packet.start, packet.key, dimension)
    if weight > 0.0:
        dx, dy, dz = lambertian(nx, ny, nz, draw(packet, BOUNCE_U), draw(packet, BOUNCE_V))
        clear = clear_of(facet, x, y, z, dx, dy, dz)
        child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight, packet.key, clear)
        child.kind = SCATTERED


@kernel
def _share_with_other(flow: Flow, frames: Array, objects: ObjectTables, aim: Aim, packet: Any) -> None:
    """Weight a packet that goes from a target into glass, where both it and one drawn the other way could have gone.

    By the balance heuristic (Veach & Guibas 1995): the lens may show behind the glass where it is aimed at, or
    elsewhere, as the glass bends light.
    """
    x, y, z = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
    dx, dy, dz = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
    normal = objects.facets[packet.facet].normal
    scattered = abs(normal[0] * packet.dx + normal[1] * packet.dy + normal[2] * packet.dz) / np.pi
    at_lens = aimed_density(x, y, z, dx, dy, dz, aim.entrance, aim.front_radius, aim.wide_share, aim.blind_share)
    weight = packet.weight
    if packet.kind == CAMERA:
        packet.weight *= at_lens / (at_lens + scattered)
        packet.start = packet.weight
    else:
        packet.weight *= scattered / (at_lens + scattered)
    flow.book[SAMPLING_REMOVED] += weight - packet.weight


@kernel
def _aim_at_camera(
    flow: Flow, frames: Array, aim: Aim, facet: Any, packet: Any,
    x: float, y: float, z: float, nx: float, ny: float, nz: float, weight: float,
) -> float:  # fmt: skip
    """Queue the child that is aimed at the entrance pupil: BRDF · cos · dω of the weight. Return its weight."""
    px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
    ax, ay, az, density = aimed(
        px, py, pz, aim.entrance, aim.front_radius, aim.wide_share, aim.blind_share,
        draw(packet, AIM_DISK), draw(packet, AIM_U), draw(packet, AIM_V),
    )  # fmt: skip
    dx, dy, dz = move_direction(frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
    cos_theta = nx * dx + ny * dy + nz * dz
    if cos_theta <= 0.0 or density <= 0.0:
        return 0.0
    weight *= cos_theta / (np.pi * density)
    child = put(
        flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, weight,
        derived(packet.key, AIMED_CHILD + packet.events), clear_of(facet, x, y, z, dx, dy, dz),
    )  # fmt: skip
    child.kind = CAMERA
    child.start = weight
    return weight
