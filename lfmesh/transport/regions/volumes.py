"""Packets in media of object space: light gathered and lost on the way, and scattering.

A packet that loses light to scattering continues with the rest; a child with the scattered light starts at a random
point of the way. So the medium adds no noise to unscattered light.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, move_direction, move_point, point_through
from lfmesh.geometry.meshes.boxes import box_entry
from lfmesh.geometry.meshes.levels import PATCH
from lfmesh.geometry.ray import Ray, along, ray_of
from lfmesh.geometry.surfaces.surface import distance_to
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase, sampled_cosine
from lfmesh.optics.scattering import about
from lfmesh.transport.aims.mixture import aimed
from lfmesh.transport.events.bending import is_in_field, squared_index_of_emission
from lfmesh.transport.events.bodies import RANK, bodies_round
from lfmesh.transport.events.crossing import deposit, end_here, record, too_deep, windowed
from lfmesh.transport.events.facets import meets_patch
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.polarisation import depolarise
from lfmesh.transport.events.scattering_point import scattering_point
from lfmesh.transport.events.volume import Line, pass_through
from lfmesh.transport.lights.combine import ask_lamps_on_line, has_asked, share_of_scattered, wait_for_lights
from lfmesh.transport.lights.media_emitters import density as density_to_media
from lfmesh.transport.packets.book import SAMPLING_ADDED, SAMPLING_REMOVED
from lfmesh.transport.packets.children import IN_MEDIUM
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    E_SCATTERED,
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
    Flow,
    count_event,
    mover_of_frame,
    put,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.paths.automaton import counts, counts_not_yet
from lfmesh.transport.tables.tables import OPAQUE, LensTables, ObjectTables

Array = NDArray[np.float64]

RETURNED = 10.0
"""Forward: relative weight to which roulette raises packets returned by the lens and scattered by a medium. Each
scattering point aims a packet at the lens; fog before the lens would otherwise multiply packets without end."""

COSINE, AZIMUTH, KEEP, DISK, TO_U, TO_V, RETURN, ON_CHORD = 3, 4, 5, 6, 7, 8, 9, 11
"""Dimensions of a scattering point's random numbers, beside those of `events.volume` and `lights.combine`."""


class Met(NamedTuple):
    """Facet that a packet meets.

    Attributes
    ----------
    prim : int
        Facet of a target, glass or housing; −1: none.
    t : float, mm
        Distance of the facet; inf if none.
    on_patch : bool
        The distance is to the facet's curved patch, or to a round face of glass.
    """

    prim: int
    t: float
    on_patch: bool


@inlined
def is_stopped_by_media(volumes: Any, space: ObjectSpace, lens: LensTables, packet: Any, met: Met) -> bool:
    """Let a packet pass through the media up to its next hit; tell whether none of its light is left.

    Parameters
    ----------
    volumes : Volumes or None
        None: there are no media, and numba compiles only the first line.
    space : ObjectSpace
    lens : LensTables
    packet : PACKET
    met : Met
    """
    if volumes is None:
        return False
    cross_media(space, packet, way_through_media(space, lens, packet, met))
    if packet.weight > 0.0:
        return False
    end_here(space.options, space.flow, space.frames, packet, volumes.rows[0].slot, S_ABSORBED)
    return True


@inlined
def way_through_media(space: ObjectSpace, lens: LensTables, packet: Any, met: Met) -> float:
    """Return the length of a packet's way through media, up to its hit or the lens, mm.

    Parameters
    ----------
    space, lens, packet, met
        As for `is_stopped_by_media`.
    """
    t = met.t
    if not met.on_patch:
        t = _distance_to_glass(space.objects.glass, space.flow, space.objects, packet, met.prim, t)
    if packet.last == LEFT_LENS or bodies_round(packet) & RANK != 0:
        return t
    px, py, pz = move_point(space.frames, OBJECT_FRAME, CAMERA_FRAME, packet.x, packet.y, packet.z)
    ex, ey, ez = move_direction(space.frames, OBJECT_FRAME, CAMERA_FRAME, packet.dx, packet.dy, packet.dz)
    return min(t, _way_to_lens(lens, px, py, pz, ex, ey, ez))


@inlined
def _distance_to_glass(glass: Any, flow: Flow, objects: ObjectTables, packet: Any, prim: int, t: float) -> float:
    """Return the distance of a packet's hit, for curved glass that to the curved face instead of the facet."""
    if glass is None:
        return t
    body = objects.facets[max(prim, 0)].body
    if prim < 0 or body < 0 or objects.medium[body] == OPAQUE or glass.level[body] != PATCH:
        return t
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    met, more, _, _, _ = meets_patch(
        flow, glass.patches, glass.across, objects.facets[prim], prim, Ray(x, y, z, packet.dx, packet.dy, packet.dz)
    )
    return max(t + more, 0.0) if met else t


@inlined
def _way_to_lens(lens: LensTables, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance along a camera-frame ray to the front of the lens; inf if it passes beside it.

    At a concave front, the medium reaches into the hollow, beyond the border of the lens's box.
    """
    enters = box_entry(lens.box_low, lens.box_high, Ray(x, y, z, dx, dy, dz))
    if enters == np.inf or lens.convex_front:
        return enters
    front = lens.surfaces[0]
    x, y, z = x + enters * dx, y + enters * dy, z + enters * dz
    if front.posed:
        x, y, z = point_through(front.unpose, x, y, z)
        dx, dy, dz = direction_through(front.unpose, dx, dy, dz)
    meets, more = distance_to(front, Ray(x, y, z - front.vertex_z, dx, dy, dz), 1.0)
    return enters + max(more, 0.0) if meets else enters


@kernel
def cross_media(space: ObjectSpace, packet: Any, reach: float) -> None:
    """Let a packet gather, lose and scatter light in the media between its start and a distance.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
    reach : float, mm
        Distance of the next hit; inf if none.
    """
    options, flow, frames, objects = space.options, space.flow, space.frames, space.objects
    volumes, colour, weight = objects.volumes, packet.colour, packet.weight
    line = Line(ray_of(packet), bodies_round(packet) & RANK, colour, flow.moving, mover_of_frame(packet.frame))
    key = derived(packet.key, IN_MEDIUM + packet.events)
    passage = pass_through(volumes, line, reach, flow.book, weight, key)
    packet.weight = weight * passage.transmittance
    estimated = counts(options, packet)
    if passage.light > 0.0 and options.adjoint and estimated:
        # Radiance over n² is conserved on the way out of glass and liquids.
        index = objects.media.indices[packet.medium, colour]
        index2 = index * index * squared_index_of_emission(objects.fields, packet)
        share = 1.0
        if has_asked(packet):
            share = share_of_scattered(packet, density_to_media(volumes, line))
        deposit(options, flow, packet.source, colour, weight * share * passage.light / index2)
    if passage.scattered <= 0.0 or not volumes.scatters:
        return
    lost = weight * passage.scattered
    of_twin = packet.kind == CAMERA and packet.last != LEFT_LENS and not (options.adjoint or options.tracing)
    of_other_class = packet.kind == LAMP and not estimated
    if of_twin or of_other_class:
        flow.book[SAMPLING_REMOVED] += lost
        return
    # From here on the record represents the child; the packet's own values are restored at the end.
    left, events, node, kind, last = packet.weight, packet.events, packet.node, packet.kind, packet.last
    facet, moves = packet.facet, packet.moves
    point = scattering_point(volumes, line, passage, key)
    packet.weight = weight * point.share
    flow.book[SAMPLING_ADDED] += packet.weight - lost
    bent = is_in_field(objects.fields, packet)
    if bent:
        # A child of each chord would multiply packets without end; of a curve there are as many as collisions.
        packet.weight = windowed(flow.book, packet.weight, weight, key, ON_CHORD)
    flow.counts[EVENTS] += 1
    if packet.kind == CAMERA and packet.last == LEFT_LENS and not (options.adjoint or options.tracing):
        packet.weight = windowed(flow.book, packet.weight, RETURNED * packet.start, key, RETURN)
    if packet.weight > 0.0 and not too_deep(options, flow, frames, packet):
        # No shadow packet leaves a field.
        asks = options.adjoint and estimated and not bent
        if asks and bodies_round(packet) == 0 and len(objects.lamps.rows) > 0:
            ask_lamps_on_line(space, packet, weight, line, passage, point, key)
        place = along(line.ray, point.t)
        if asks:
            packet.facet = IN_FOG
            wait_for_lights(space, packet, place, point.medium, key)
        scatter_in_medium(space, packet, point.medium, place, key)
    packet.weight, packet.events, packet.node, packet.kind, packet.last = left, events, node, kind, last
    packet.facet, packet.moves = facet, moves


@kernel
def scatter_in_medium(
    space: ObjectSpace, packet: Any, number: int, place: tuple[float, float, float], key: np.uint64
) -> None:
    """Scatter a packet's weight at a point of a medium: aim at the camera, and send a child in a random direction.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
    number : int
        Number of the medium.
    place : (3,) float, mm
    key : uint64
        Key of the random numbers.
    """
    flow, volumes = space.flow, space.objects.volumes
    packet.facet, packet.last = NO_SURFACE, NO_SURFACE
    phases, phase = volumes.phases, volumes.phases.rows[number, packet.colour]
    count_event(packet)
    depolarise(flow.polarised, packet)
    x, y, z = place
    if space.options.record:
        packet.node = record(
            flow, space.frames, OBJECT_FRAME, x, y, z, packet.weight, ENDS_AT + volumes.rows[number].slot, number,
            E_SCATTERED, packet.node,
        )  # fmt: skip
    cosine = sampled_cosine(phases, phase, uniform(key, COSINE))
    dx, dy, dz = about(packet.dx, packet.dy, packet.dz, cosine, 2.0 * np.pi * uniform(key, AZIMUTH))
    send_from_medium(space, packet, phase, Ray(x, y, z, dx, dy, dz), key)


@kernel
def send_from_medium(space: ObjectSpace, packet: Any, phase: Any, ray: Ray, key: np.uint64) -> None:
    """Queue a child in a direction drawn by the phase function and, forward, another one aimed at the camera.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
    phase : PHASE
    ray : Ray
        Ray of the child.
    key : uint64
        Key of the random numbers.
    """
    options, flow = space.options, space.flow
    phases, weight = space.objects.volumes.phases, packet.weight
    x, y, z, dx, dy, dz = ray
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    forward = not (options.adjoint or options.tracing)
    if forward and options.aimed:
        px, py, pz = move_point(space.frames, OBJECT_FRAME, CAMERA_FRAME, x, y, z)
        numbers = uniform(key, DISK), uniform(key, TO_U), uniform(key, TO_V)
        ax, ay, az, at_lens = aimed(space.aim, (px, py, pz), numbers)
        if at_lens > 0.0:
            ux, uy, uz = move_direction(space.frames, CAMERA_FRAME, OBJECT_FRAME, ax, ay, az)
            density = evaluate_phase(phases, phase, ix * ux + iy * uy + iz * uz)
            to_camera = weight * density / at_lens
            if to_camera > 0.0:
                flow.book[SAMPLING_ADDED] += to_camera
                twin_key = derived(key, 1)
                twin = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, to_camera, twin_key, 0.0)
                twin.kind, twin.start, twin.facet, twin.medium = CAMERA, to_camera, LEFT_MEDIUM, packet.medium
                twin.density = density
    cutoff = options.thinning.unturned_cutoff if counts_not_yet(options, packet) else options.thinning.cutoff
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
        # Roulette keeps only some of the samples; see `lights.combine`.
        child.density *= weight / kept
