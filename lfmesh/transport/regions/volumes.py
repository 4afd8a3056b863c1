"""Packets in media of object space: what they gather and lose on their way, and where they are scattered.

A packet that some light is taken from by scattering goes on with the rest, and a child starts from a random point of
its way with what was scattered there. So the unscattered light has no noise of the medium.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, move_direction, move_point, point_through
from lfmesh.geometry.meshes.levels import PATCH
from lfmesh.geometry.surfaces.surface import distance_to
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase, sampled_cosine
from lfmesh.optics.scattering import about
from lfmesh.transport.aiming.through_glass import aimed_from
from lfmesh.transport.events.crossing import (
    box_entry,
    deposit,
    end_here,
    meets_patch,
    record,
    too_deep,
    windowed,
)
from lfmesh.transport.events.emission import asks_emitters
from lfmesh.transport.events.glow import asks_media, share_of_line
from lfmesh.transport.events.halo import (
    ALONG,
    BY_ANGLE,
    LAMP_U,
    LAMP_V,
    all_halos,
    asks_halos,
    draws_halo,
    halo_chance,
    past_point,
    share_past_lamp,
)
from lfmesh.transport.events.lamps_on_line import (
    density_by_angle,
    distance_by_angle,
    lamps_on_line,
    lit_part,
    passes_lamp,
)
from lfmesh.transport.events.lighting import from_light_nearby, illuminate_from, point_of_light
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.events.volume import Passage, Ray, pass_through, scattered_at, scattering_point
from lfmesh.transport.packets.book import SAMPLING_ADDED, SAMPLING_REMOVED
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    E_SCATTERED,
    EMITTERS,
    ENDS_AT,
    EVENTS,
    IN_FOG,
    LAMP,
    LEFT_LENS,
    LEFT_MEDIUM,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    S_ABSORBED,
    SCATTERED,
    SHADOW,
    TO_EMITTER,
    TO_HALO,
    TO_MEDIUM,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.paths.automaton import counts, counts_not_yet
from lfmesh.transport.regions.bodies import RANK, bodies_round
from lfmesh.transport.tables.halos import Halos, angle_beyond, light_beyond, phase_at
from lfmesh.transport.tables.tables import OPAQUE, AimTables, LensTables, ObjectTables

Array = NDArray[np.float64]

IN_MEDIUM = 1 << 21
"""Number of the random numbers, among those that a packet's key has for its children, for its way through media."""

RETURNED = 10.0
"""Forward, weight over that at the start to which roulette raises light that the lens sends back and a medium scatters.
Each scattering point aims a packet at the lens, so that fog before the lens would else multiply packets without end."""

NEAR = 0.125
"""Distance of a lamp from a line, over the length on which the line's light is scattered, below which it is near."""

COSINE, AZIMUTH, KEEP, DISK, TO_U, TO_V, RETURN, BY_LAMP = 3, 4, 5, 6, 7, 8, 9, 10
"""Dimensions of a scattering point's random numbers, after those of `events.volume`."""


@inlined
def is_stopped_by_media(
    volumes: Any, options: Options, flow: Flow, frames: Array, objects: ObjectTables, lens: LensTables, aim: AimTables,
    packet: Any, prim: int, t: float, on_patch: bool,
) -> bool:  # fmt: skip
    """Let a packet pass through the media where it is, up to what it meets; tell whether none of its light is left.

    Parameters
    ----------
    volumes : Volumes or None
        None: there are no media, and numba compiles nothing but the first line.
    prim : int
        Facet of the target, glass or housing that it meets; −1: none.
    t : float, mm
        Distance of the facet; inf if none.
    on_patch : bool
        t is that of the facet's curved patch.
    """
    if volumes is None:
        return False
    place = bodies_round(packet) & RANK
    t = t if on_patch else _distance_to_glass(objects.glass, flow, objects, packet, prim, t)
    reach = t
    if packet.kind == SHADOW:
        reach = min(t, packet.limit)
    elif packet.last != LEFT_LENS and place == 0:
        px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
        ex, ey, ez = move_direction(frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
        reach = min(t, _way_to_lens(lens, px, py, pz, ex, ey, ez))
    cross_media(options, flow, frames, objects, aim, packet, place, reach)
    if packet.weight > 0.0:
        return False
    if packet.kind != SHADOW and packet.kind < TO_EMITTER:
        end_here(options, flow, frames, packet, volumes.rows[0].slot, S_ABSORBED)
    return True


@inlined
def _distance_to_glass(glass: Any, flow: Flow, objects: ObjectTables, packet: Any, prim: int, t: float) -> float:
    """Return the distance of what a packet meets: for a curved face of glass that of the face, not of its facet."""
    if glass is None:
        return t
    body = objects.facets[max(prim, 0)].body
    if prim < 0 or body < 0 or objects.medium[body] == OPAQUE or glass.level[body] != PATCH:
        return t
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    met, more, _, _, _ = meets_patch(
        flow, glass.patches, glass.across, objects.facets[prim], prim, x, y, z, packet.dx, packet.dy, packet.dz
    )
    return max(t + more, 0.0) if met else t


@inlined
def _way_to_lens(lens: LensTables, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance at which a ray, in the camera frame, meets the front of the lens; inf if it passes beside it.

    Where the front is hollow, the medium reaches into the hollow, beyond the border of the lens's box.
    """
    enters = box_entry(lens.box_low, lens.box_high, x, y, z, dx, dy, dz)
    if enters == np.inf or lens.convex_front:
        return enters
    front = lens.surfaces[0]
    x, y, z = x + enters * dx, y + enters * dy, z + enters * dz
    if front.posed:
        x, y, z = point_through(front.unpose, x, y, z)
        dx, dy, dz = direction_through(front.unpose, dx, dy, dz)
    meets, more = distance_to(front, x, y, z - front.vertex_z, dx, dy, dz, 1.0)
    return enters + max(more, 0.0) if meets else enters


@kernel
def cross_media(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any, place: int,
    reach: float,
) -> None:  # fmt: skip
    """Let a packet pass through the media between its start and a distance: it gathers, is weakened, and scatters.

    Parameters
    ----------
    place : int
        Rank of the body of glass or liquid that the packet is in; 0: air.
    reach : float, mm
        Where it meets something; inf if nothing.
    """
    volumes = objects.volumes
    asks = packet.kind == SHADOW or packet.kind >= TO_EMITTER
    colour, weight = packet.colour, packet.weight
    x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
    key = derived(packet.key, IN_MEDIUM + packet.events)
    passage = pass_through(volumes, place, colour, x, y, z, dx, dy, dz, reach, flow.book, 0.0 if asks else weight, key)
    packet.weight = weight * passage.transmittance if packet.kind < TO_MEDIUM else 0.0
    estimated = counts(options, packet)
    if passage.light > 0.0 and options.adjoint and estimated and (not asks or packet.kind == TO_MEDIUM):
        # Radiance over n² is conserved on the way out of glass and liquids.
        index = objects.media.indices[packet.medium, colour]
        light = weight * share_of_line(volumes, packet, place) * passage.light / (index * index)
        deposit(options, flow, packet.source, colour, light)
    if passage.scattered <= 0.0 or not volumes.scatters:
        return
    if packet.kind == TO_HALO:
        _gather_halo(volumes.halos, options, flow, objects, packet, passage, place, weight, key)
    if asks:
        return
    lost = weight * passage.scattered
    of_twin = packet.kind == CAMERA and packet.last != LEFT_LENS and not (options.adjoint or options.tracing)
    of_other_class = packet.kind == LAMP and not estimated
    if of_twin or of_other_class:
        flow.book[SAMPLING_REMOVED] += lost
        return
    # From here on the record stands for the child; its own weight is put back at the end.
    left, events, node, kind, last = packet.weight, packet.events, packet.node, packet.kind, packet.last
    facet, moves = packet.facet, packet.moves
    t, share, density, number = scattering_point(volumes, place, colour, passage, x, y, z, dx, dy, dz, key)
    packet.weight = weight * share
    flow.book[SAMPLING_ADDED] += packet.weight - lost
    flow.counts[EVENTS] += 1
    if packet.kind == CAMERA and packet.last == LEFT_LENS and not (options.adjoint or options.tracing):
        packet.weight = windowed(flow.book, packet.weight, RETURNED * packet.start, key, RETURN)
    if packet.weight > 0.0 and not too_deep(options, flow, frames, packet):
        if options.adjoint and estimated and bodies_round(packet) == 0 and len(objects.lights) > 0:
            _ask_lamps(options, flow, objects, packet, passage, place, weight, t, share, density, number, key)
        px, py, pz = x + t * dx, y + t * dy, z + t * dz
        if options.adjoint and estimated:
            _ask_what_emits(options, flow, objects, packet, number, px, py, pz, key)
        scatter_in_medium(options, flow, frames, objects, aim, packet, number, px, py, pz, key)
    packet.weight, packet.events, packet.node, packet.kind, packet.last = left, events, node, kind, last
    packet.facet, packet.moves = facet, moves


@inlined
def _ask_lamps(
    options: Options, flow: Flow, objects: ObjectTables, packet: Any, passage: Passage, place: int, weight: float,
    t: float, share: float, density: float, number: int, key: np.uint64,
) -> None:  # fmt: skip
    """Send a shadow packet to every light from a random point of a packet's way through media.

    The point is that which was drawn by what is scattered there. On a line past a near lamp, whose 1 / r² would be
    unbounded there, a second one is drawn by the light that arrives, and each counts its share of the two densities
    (balance heuristic, Veach & Guibas 1995).

    Parameters
    ----------
    packet : PACKET
        At the start of its way; its own weight is not used.
    passage : Passage
    weight : float
        Of the packet at its start.
    t, share, density, number
        What `scattering_point` returned.
    key : uint64
        Of the random numbers.
    """
    lights, spectra, colour = objects.lights, objects.light_spectra, packet.colour
    x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
    line, first, last = Ray(x, y, z, dx, dy, dz), passage.first, passage.last
    near = NEAR * passage.scattered / passage.densest
    whole = 0.0
    if passes_lamp(lights, spectra, colour, line, first, last, near):
        whole = lamps_on_line(lights, spectra, colour, line, first, last)
    points = 2 if whole > 0.0 else 1
    for point in range(points):
        if point == 1:
            choice = whole * uniform(key, BY_LAMP)
            t = distance_by_angle(lights, spectra, colour, line, first, last, choice)
            density, number = scattered_at(objects.volumes, place, colour, t, x, y, z, dx, dy, dz, flow.book, key)
        if points == 2 and density > 0.0:
            own = density / passage.scattered
            by_lamp = density_by_angle(lights, spectra, colour, line, t) / whole
            share = (density if point == 1 else share * own) / (own + by_lamp)
        if density > 0.0:
            _ask_lamps_from(options, flow, objects, packet, weight * share, number, x + t * dx, y + t * dy, z + t * dz)


@kernel
def _ask_lamps_from(
    options: Options, flow: Flow, objects: ObjectTables, packet: Any, weight: float, number: int,
    x: float, y: float, z: float,
) -> None:  # fmt: skip
    """Send a shadow packet to every light from a point of a medium.

    Parameters
    ----------
    packet : PACKET
        On its way to the point.
    weight : float
        That is scattered there.
    number : int
        Of the medium.
    x, y, z : float, mm
    """
    volumes, colour = objects.volumes, packet.colour
    phases, phase = volumes.phases, volumes.phases.rows[number, colour]
    halos = 0.0
    if draws_halo(packet):
        halos = all_halos(objects.lights, objects.light_spectra, colour, packet.x, packet.y, packet.z)
    for light in range(len(objects.lights)):
        ux, uy, uz, far, irradiance = from_light_nearby(options, objects, packet, light, x, y, z)
        scattered = evaluate_phase(phases, phase, packet.dx * ux + packet.dy * uy + packet.dz * uz)
        if irradiance * scattered > 0.0:
            lit = weight * irradiance * scattered
            if halos > 0.0 and far < np.inf:
                lx, ly, lz = x + far * ux, y + far * uy, z + far * uz
                lit *= _share_of_line(volumes.halos, objects, packet, light, halos, lx, ly, lz)
            shadow = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, lit, packet.key, 0.0)
            shadow.kind, shadow.limit, shadow.facet, shadow.last = SHADOW, far, NO_SURFACE, NO_SURFACE


@inlined
def _share_of_line(
    halos: Any, objects: ObjectTables, packet: Any, light: int, whole: float, lx: float, ly: float, lz: float
) -> float:  # fmt: skip
    """Return the share that a packet, scattered at the start of its line, counts of the light of a lamp's point."""
    if halos is None:
        return 1.0
    x, y, z, colour = packet.x, packet.y, packet.z, packet.colour
    chance = halo_chance(halos, objects.lights, objects.light_spectra, light, colour, whole, x, y, z)
    return share_past_lamp(halos, colour, chance, packet, lx, ly, lz)


@inlined
def _gather_halo(
    halos: Any, options: Options, flow: Flow, objects: ObjectTables, packet: Any, passage: Passage, place: int,
    weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Send a shadow packet to a lamp from a random point of the line of a packet that goes past it.

    Parameters
    ----------
    halos : Halos or None
        None: no packet goes past lamps, and numba compiles nothing but the first line.
    packet : PACKET
        At the start of the line, in no body of glass; its own weight is not used.
    passage : Passage
    place : int
    weight : float
        Of the packet at its start.
    key : uint64
        Of the random numbers of its way.
    """
    if halos is None:
        return
    _gather_past_lamp(halos, options, flow, objects, packet, passage, place, weight, key)


@kernel
def _gather_past_lamp(
    halos: Halos, options: Options, flow: Flow, objects: ObjectTables, packet: Any, passage: Passage, place: int,
    weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Do what `_gather_halo` does, in scenes with halos.

    The point is drawn by the mean phase function over the angle of scattering or, with equal chance, by what is
    scattered there: the sum of both densities divides the light (balance heuristic).
    """
    volumes, colour, number = objects.volumes, packet.colour, packet.to_lamp
    light = objects.lights[number]
    x, y, z, dx, dy, dz = packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz
    px, py, pz = point_of_light(light, uniform(packet.key, LAMP_U), uniform(packet.key, LAMP_V))
    s, h, _ = past_point(px, py, pz, x, y, z, dx, dy, dz)
    first, last = lit_part(light, Ray(x, y, z, dx, dy, dz), passage.first, passage.last)
    if first >= last:
        return
    begin = light_beyond(halos, colour, np.arctan2(h, s - first))
    on_line = begin - light_beyond(halos, colour, np.arctan2(h, s - last))
    by_angle = uniform(packet.key, BY_ANGLE) < 0.5
    if by_angle:
        angle = angle_beyond(halos, colour, begin - uniform(packet.key, ALONG) * on_line)
        t = min(max(s - h / np.tan(angle), first), last)
        density, medium = scattered_at(volumes, place, colour, t, x, y, z, dx, dy, dz, flow.book, key)
    else:
        t, _, density, medium = scattering_point(volumes, place, colour, passage, x, y, z, dx, dy, dz, key)
    if density <= 0.0 or t < first or t > last or on_line <= 0.0:
        return
    off = t - s
    r2 = h * h + off * off
    drawn = 0.5 * density / passage.scattered
    drawn += 0.5 * phase_at(halos, colour, np.arctan2(h, -off)) / on_line * h / r2
    x, y, z = x + t * dx, y + t * dy, z + t * dz
    ux, uy, uz, far, irradiance = illuminate_from(objects.profiles, light, px, py, pz, x, y, z)
    scattered = evaluate_phase(volumes.phases, volumes.phases.rows[medium, colour], dx * ux + dy * uy + dz * uz)
    lit = weight * density / drawn * scattered * irradiance * objects.light_spectra[number, colour]
    if lit > 0.0:
        shadow = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, lit, packet.key, 0.0)
        shadow.kind, shadow.limit, shadow.facet, shadow.last = SHADOW, far, NO_SURFACE, NO_SURFACE


@inlined
def _ask_what_emits(
    options: Options, flow: Flow, objects: ObjectTables, packet: Any, number: int, x: float, y: float, z: float,
    key: np.uint64,
) -> None:  # fmt: skip
    """Queue a packet at a point of a medium that asks targets and media which emit, and the light round lamps.

    Parameters
    ----------
    packet : PACKET
        On its way to the point, with the weight that is scattered there.
    number : int
        Of the medium.
    x, y, z : float, mm
    key : uint64
    """
    volumes, events = objects.volumes, packet.events
    if asks_emitters(options, objects, events) or asks_media(volumes, options) or asks_halos(volumes, options, events):
        dx, dy, dz = packet.dx, packet.dy, packet.dz
        asking = put(flow, EMITTERS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, packet.weight, key, 0.0)
        asking.facet, asking.in_medium = IN_FOG, number


@kernel
def scatter_in_medium(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any, number: int,
    x: float, y: float, z: float, key: np.uint64,
) -> None:  # fmt: skip
    """Scatter a packet's weight at a point of a medium: aim at the camera, and send a child anywhere.

    Parameters
    ----------
    number : int
        Of the medium.
    x, y, z : float, mm
    key : uint64
        Of the random numbers.
    """
    volumes = objects.volumes
    packet.facet, packet.last = NO_SURFACE, NO_SURFACE
    phases, phase = volumes.phases, volumes.phases.rows[number, packet.colour]
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    count_event(packet)
    depolarise(flow.polarised, packet)
    if options.record:
        packet.node = record(
            flow, frames, OBJECT_FRAME, x, y, z, packet.weight, ENDS_AT + volumes.rows[number].slot, number,
            E_SCATTERED, packet.node,
        )  # fmt: skip
    cosine = sampled_cosine(phases, phase, uniform(key, COSINE))
    dx, dy, dz = about(ix, iy, iz, cosine, 2.0 * np.pi * uniform(key, AZIMUTH))
    send_from_medium(options, flow, frames, objects, aim, packet, phase, x, y, z, dx, dy, dz, key)


@kernel
def send_from_medium(
    options: Options, flow: Flow, frames: Array, objects: ObjectTables, aim: AimTables, packet: Any, phase: Any,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child in a direction that the phase function drew and, forward, one that is aimed at the camera.

    Parameters
    ----------
    phase : PHASE
    x, y, z : float, mm
    dx, dy, dz : float
        Unit direction.
    key : uint64
        Of the random numbers.
    """
    phases, weight = objects.volumes.phases, packet.weight
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    forward = not (options.adjoint or options.tracing)
    if forward and options.aimed:
        px, py, pz = move_point(frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
        ax, ay, az, at_lens = aimed_from(
            aim.through, aim, px, py, pz,
            uniform(key, DISK), uniform(key, TO_U), uniform(key, TO_V),
        )  # fmt: skip
        if at_lens > 0.0:
            ux, uy, uz = move_direction(frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
            density = evaluate_phase(phases, phase, ix * ux + iy * uy + iz * uz)
            to_camera = weight * density / at_lens
            if to_camera > 0.0:
                flow.book[SAMPLING_ADDED] += to_camera
                twin_key = derived(key, 1)
                twin = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, to_camera, twin_key, 0.0)
                twin.kind, twin.start, twin.facet, twin.medium = CAMERA, to_camera, LEFT_MEDIUM, packet.medium
                twin.density = density
    cutoff = options.unturned_cutoff if counts_not_yet(options, packet) else options.cutoff
    kept = windowed(flow.book, weight, cutoff * packet.start, key, KEEP)
    if kept <= 0.0:
        return
    child_key = derived(key, 2)
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, kept, child_key, 0.0)
    child.kind = CAMERA if options.tracing else SCATTERED
    child.facet = LEFT_MEDIUM if forward and options.aimed else NO_SURFACE
    if options.adjoint:
        child.facet = IN_FOG
    child.density = evaluate_phase(phases, phase, ix * dx + iy * dy + iz * dz)
    if options.adjoint:
        # Of all that are drawn, roulette keeps few; see `regions.emitters`.
        child.density *= weight / kept
