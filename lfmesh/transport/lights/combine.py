"""Lights asked from points that scatter, combined with scattered rays.

A point of a target or a medium, seen from the sensor, sends a shadow packet to each kind of light, and its scattered
ray may meet the same light by chance. A light's `sample` draws a direction; its `density` gives the density of any
direction. A path that both ways can find is weighted by the balance heuristic (Veach & Guibas, SIGGRAPH 1995), so it
counts once. No scattered ray meets a lamp. Paths through glass or the lens are found by scattered rays alone and keep
their full weight.

Lamps are asked at once. For other lights the point waits at its own station, which is compiled only for scenes with
targets or media that emit, or with lamps and media that scatter.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray, along, ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.transport.events.bodies import RANK, bodies_round
from lfmesh.transport.events.crossing import deposit
from lfmesh.transport.events.facets import EDGE, clear_of
from lfmesh.transport.events.moving import begin
from lfmesh.transport.events.object_space import ObjectSpace
from lfmesh.transport.events.scattering import Point, density, evaluate
from lfmesh.transport.events.scattering_point import ScatteringPoint, scattered_at
from lfmesh.transport.events.surface import outward, point_of
from lfmesh.transport.events.travel import transmitted
from lfmesh.transport.events.volume import Line, Passage, pass_through
from lfmesh.transport.lights.emitting_facets import are_asked as facets_are_asked
from lfmesh.transport.lights.emitting_facets import radiance as radiance_of_facet
from lfmesh.transport.lights.emitting_facets import sample as sample_facets
from lfmesh.transport.lights.lamps import sample as sample_lamp
from lfmesh.transport.lights.lamps_on_line import density_by_angle, distance_by_angle, lamps_on_line, passes_lamp
from lfmesh.transport.lights.many_lamps import NO_NORMAL, lamps_to_ask
from lfmesh.transport.lights.media_emitters import sample as sample_media
from lfmesh.transport.lights.shadow import Way, send
from lfmesh.transport.lights.single_scatter import density as density_past_lamp
from lfmesh.transport.lights.single_scatter import gather as gather_past_lamp
from lfmesh.transport.lights.single_scatter import is_asked as single_scatter_is_asked
from lfmesh.transport.lights.single_scatter import sample as sample_past_lamp
from lfmesh.transport.packets.children import IN_MEDIUM, TOWARDS_MEDIA, TOWARDS_SCATTERED
from lfmesh.transport.packets.packet import (
    IN_FOG,
    LIGHTS,
    NO_SURFACE,
    OBJECT_FRAME,
    PAST_LAMP,
    SCATTERED,
    TO_FACET,
    TO_MEDIA,
    Flow,
    Options,
    count_event,
    mover_of_frame,
    put,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import ObjectTables

NEAR = 0.125
"""Distance of a lamp from a line, over the length on which the line scatters light, below which the lamp is near."""

BY_LAMP = 10
"""Dimension of the random number for a point drawn by the light of lamps on a line."""


@inlined
def share_of_scattered(packet: Any, asked: float) -> float:
    """Return the packet's weight (balance heuristic) for a light on its ray.

    Parameters
    ----------
    packet : PACKET
        At the start of the ray.
    asked : float, 1/sr
        The light's density of this direction.
    """
    return packet.density / (packet.density + asked) if asked > 0.0 else 1.0


@inlined
def has_asked(packet: Any) -> bool:
    """Tell whether the packet's start has asked lights too. False: it comes from the camera or glass.

    Parameters
    ----------
    packet : PACKET
    """
    return packet.kind == SCATTERED and packet.facet != NO_SURFACE


@inlined
def ask_lamps(space: ObjectSpace, packet: Any, point: Point) -> bool:
    """Send shadow packets from a point of a target to lamps; tell whether any was sent.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
        Has met the target.
    point : Point
    """
    objects = space.objects
    facet, any_lamp, asked = objects.facets[point.prim], False, space.flow.asked
    place, normal = (point.x, point.y, point.z), (point.nx, point.ny, point.nz)
    moving = space.flow.moving
    for k in range(lamps_to_ask(space.options, objects.lamps, packet, place, normal, asked, moving)):
        way = sample_lamp(space.options, objects, packet, asked[k].lamp, place, False, moving)
        ux, uy, uz = way.ray.dx, way.ray.dy, way.ray.dz
        cosine = point.nx * ux + point.ny * uy + point.nz * uz
        if cosine <= 0.0 or way.value <= 0.0:
            continue
        any_lamp = True
        brdf = evaluate(objects.scattering, point, packet.colour, (packet.dx, packet.dy, packet.dz), (ux, uy, uz))
        clear = clear_of(facet, point.x, point.y, point.z, ux, uy, uz)
        weight = packet.weight * brdf * way.value * cosine * asked[k].share
        shadow = send(space.flow, packet, way, weight, packet.key, clear)
        shadow.facet = point.prim
    return any_lamp


@inlined
def ask_lamps_on_line(
    space: ObjectSpace, packet: Any, weight: float, line: Line, passage: Passage, point: ScatteringPoint, key: np.uint64
) -> None:  # fmt: skip
    """Send shadow packets to lamps from a random point of a packet's path through media.

    The given point was drawn by the scattered light. On a line past a near lamp, where 1 / r² would be unbounded, a
    second point is drawn by the arriving light, and each is weighted by its share of the densities.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
        At the start of its path; its own weight is not used.
    weight : float
        Weight of the packet at its start.
    line : Line
    passage : Passage
    point : ScatteringPoint
    key : uint64
        For the random numbers.
    """
    objects, lamps, first, last = space.objects, space.objects.lamps, passage.first, passage.last
    t, share, scattered, medium = point
    whole = 0.0
    if passes_lamp(lamps, line, first, last, NEAR * passage.scattered / passage.densest):
        whole = lamps_on_line(lamps, line, first, last)
    points = 2 if whole > 0.0 else 1
    for number in range(points):
        if number == 1:
            t = distance_by_angle(lamps, line, first, last, whole * uniform(key, BY_LAMP))
            scattered, medium = scattered_at(objects.volumes, line, t, space.flow.book, key)
        if points == 2 and scattered > 0.0:
            own = scattered / passage.scattered
            by_lamp = density_by_angle(lamps, line, t) / whole
            share = (scattered if number == 1 else share * own) / (own + by_lamp)
        if scattered > 0.0:
            _ask_lamps_in_medium(space, packet, weight * share, medium, along(line.ray, t))


@kernel
def _ask_lamps_in_medium(
    space: ObjectSpace, packet: Any, weight: float, medium: int, place: tuple[float, float, float]
) -> None:  # fmt: skip
    """Send shadow packets from a point of a medium to lamps.

    Parameters
    ----------
    packet : PACKET
        On its way to the point.
    weight : float
        Weight scattered there.
    medium : int
    place : (3,) float, mm
        In the packet's frame.
    """
    objects, volumes, moving = space.objects, space.objects.volumes, space.flow.moving
    phase, asked = volumes.phases.rows[medium, packet.colour], space.flow.asked
    for k in range(lamps_to_ask(space.options, objects.lamps, packet, place, NO_NORMAL, asked, moving)):
        lamp = asked[k].lamp
        way = sample_lamp(space.options, objects, packet, lamp, place, True, moving)
        ray = way.ray
        scattered = evaluate_phase(volumes.phases, phase, packet.dx * ray.dx + packet.dy * ray.dy + packet.dz * ray.dz)
        if way.value * scattered > 0.0:
            lit = weight * way.value * scattered * asked[k].share
            if len(volumes.near_lamps.angles) > 0 and has_asked(packet) and way.reach < np.inf:
                by_scatter = density_past_lamp(volumes.near_lamps, objects, packet, lamp, along(ray, way.reach))
                lit *= share_of_scattered(packet, by_scatter)
            shadow = send(space.flow, packet, way, lit, packet.key, 0.0)
            shadow.facet = NO_SURFACE


@inlined
def wait_for_lights(
    space: ObjectSpace, packet: Any, place: tuple[float, float, float], medium: int, key: np.uint64
) -> None:  # fmt: skip
    """Let a packet wait at a point that asks lights other than lamps, if there are any.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
        On its way to the point, with the weight scattered there and the point's facet, `IN_FOG` in a medium.
    place : (3,) float, mm
    medium : int
        Number of the medium; −1 on a target.
    key : uint64
    """
    options, objects = space.options, space.objects
    if facets_are_asked(options, objects, packet.events) or _media_are_asked(objects.volumes, options, packet):
        asking = put(
            space.flow, LIGHTS, packet, OBJECT_FRAME, place[0], place[1], place[2], packet.dx, packet.dy, packet.dz,
            packet.weight, key, 0.0,
        )  # fmt: skip
        asking.in_medium = medium


@inlined
def _media_are_asked(volumes: Any, options: Options, packet: Any) -> bool:
    """Tell whether a point asks emitting media, or media near lamps.

    Parameters
    ----------
    volumes : Volumes or None
        None without media; numba then compiles only the first line.
    """
    if volumes is None:
        return False
    return (options.bounce and volumes.emit) or single_scatter_is_asked(volumes, options, packet.events)


@kernel
def ask_lights(wave: NDArray[np.void], space: ObjectSpace) -> None:
    """Send shadow packets from points to emitting facets, to emitting media and past a lamp.

    Parameters
    ----------
    wave : (n,) PACKET
        Packets at the points, with their directions of arrival and the points' facets. In a medium, `facet` is `IN_FOG`
        and `in_medium` the number of the medium.
    space : ObjectSpace
    """
    for i in range(len(wave)):
        packet, moving = wave[i], space.flow.moving
        begin(moving, space.options, packet)
        if facets_are_asked(space.options, space.objects, packet.events):
            _ask(space, packet, sample_facets(space.options, space.objects, packet, moving), packet.key)
        _ask_media(space.objects.volumes, space, packet)


@inlined
def _ask_media(volumes: Any, space: ObjectSpace, packet: Any) -> None:
    """Send packets from a point to emitting media and past a lamp; `volumes` : Volumes or None."""
    if volumes is None:
        return
    options = space.options
    if options.bounce and volumes.emit:
        key = derived(packet.key, TOWARDS_MEDIA + packet.events)
        _ask(space, packet, sample_media(volumes, options, packet, key, space.flow.moving), key)
    if single_scatter_is_asked(volumes, options, packet.events):
        key = derived(packet.key, TOWARDS_SCATTERED + packet.events)
        _ask(space, packet, sample_past_lamp(volumes.near_lamps, options, space.objects, packet, key), key)


@inlined
def _ask(space: ObjectSpace, packet: Any, way: Way, key: np.uint64) -> None:
    """Send a shadow packet from a point to a light, weighted by the balance heuristic."""
    if way.density <= 0.0:
        return
    scattered, by_chance, clear = _scattered_along(space.objects.volumes, space, packet, way.ray)
    value = way.value
    if scattered > 0.0 and way.light == TO_FACET:
        value = radiance_of_facet(space.objects, packet, way, space.flow.moving)
    weight = packet.weight * scattered * value / (way.density + by_chance)
    if weight > 0.0:
        shadow = send(space.flow, packet, way, weight, key, clear)
        if way.light == PAST_LAMP:
            # As for a scattered packet, which might take the same line.
            count_event(shadow)


@inlined
def _scattered_along(volumes: Any, space: ObjectSpace, packet: Any, ray: Ray) -> tuple[float, float, float]:
    """Return a point's scattering along a ray, with its cosine, and the density of scattered packets, both 1/sr.

    The density includes the survival of roulette; otherwise the light of rare survivors would be in single pixels.

    Parameters
    ----------
    volumes : Volumes or None
    packet : PACKET
        As in `ask_lights`.

    Returns
    -------
    scattered, density : float
        0 if the point scatters nothing that way.
    clear : float, mm
        Start of a query along the ray.
    """
    options, objects = space.options, space.objects
    x, y, z, ux, uy, uz = ray
    # Two conditions: numba leaves the code out where the first alone is known not to hold.
    if volumes is not None:  # noqa: SIM102
        if packet.facet == IN_FOG:
            phase = volumes.phases.rows[packet.in_medium, packet.colour]
            value = evaluate_phase(volumes.phases, phase, packet.dx * ux + packet.dy * uy + packet.dz * uz)
            return value, value * _kept(options, packet, packet.weight), 0.0
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    own = objects.facets[packet.facet]
    nx, ny, nz = outward(objects, packet.facet, x, y, z)
    side = -1.0 if nx * ix + ny * iy + nz * iz > 0.0 else 1.0
    cosine = side * (nx * ux + ny * uy + nz * uz)
    if cosine <= EDGE:
        return 0.0, 0.0, 0.0
    point = point_of(objects, packet, packet.facet, (x, y, z), side, True)
    by_chance = density(objects.scattering, point, packet.colour, (ix, iy, iz), (ux, uy, uz))
    brdf = evaluate(objects.scattering, point, packet.colour, (ix, iy, iz), (ux, uy, uz))
    if by_chance > 0.0:
        by_chance *= _kept(options, packet, packet.weight * brdf * cosine / by_chance)
    return brdf * cosine, by_chance, clear_of(own, x, y, z, ux, uy, uz)


@inlined
def _kept(options: Options, packet: Any, weight: float) -> float:
    """Return the probability that roulette keeps a scattered packet of that weight."""
    floor = options.thinning.cutoff * packet.start
    return weight / floor if weight < floor else 1.0


@inlined
def bring_light(space: ObjectSpace, packet: Any, reach: float) -> None:
    """Deposit the light along a shadow packet's path; a lamp or facet that is reached gives all of it.

    Parameters
    ----------
    space : ObjectSpace
    packet : PACKET
        At the start of the path.
    reach : float, mm
        Length of the path.
    """
    objects = space.objects
    light = _along_media(objects.volumes, objects, space.flow, packet, reach)
    if packet.light == TO_FACET:
        light *= transmitted(objects.media.absorption, packet.medium, packet.colour, reach)
    else:
        # Radiance over n² is conserved on the way into the camera; radiance of facets is divided already.
        index = objects.media.indices[packet.medium, packet.colour]
        light /= index * index
    if light > 0.0:
        deposit(space.options, space.flow, packet.source, packet.colour, light)


@inlined
def _along_media(volumes: Any, objects: ObjectTables, flow: Flow, packet: Any, reach: float) -> float:
    """Return the light of a shadow packet through media, and from them; `volumes` : Volumes or None."""
    if volumes is None:
        return packet.weight
    place, mover = bodies_round(packet) & RANK, mover_of_frame(packet.frame)
    line = Line(ray_of(packet), place, packet.colour, flow.moving, mover)
    key = derived(packet.key, IN_MEDIUM + packet.events)
    passage = pass_through(volumes, line, reach, flow.book, 0.0, key)
    if packet.light == TO_MEDIA:
        return packet.weight * passage.light
    if packet.light == PAST_LAMP:
        if passage.scattered > 0.0:
            gather_past_lamp(volumes.near_lamps, flow, objects, packet, line, passage, key)
        return 0.0
    return packet.weight * passage.transmittance
