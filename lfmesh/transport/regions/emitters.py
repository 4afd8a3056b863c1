"""Packets from points that scatter to random points of emitting facets and media, and past lamps in scattering media.

A station of its own: its kernel is compiled, and runs, only in scenes with targets or media that emit, or with lamps
and media that scatter.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.optics.scattering import near
from lfmesh.transport.events.crossing import EDGE, EMITTER_U, LIGHT_U, clear_of, draw_two
from lfmesh.transport.events.emission import asks_emitters, emitting_point
from lfmesh.transport.events.glow import asks_media, density_to_media, point_of_media
from lfmesh.transport.events.halo import LAMP_U, LAMP_V, all_halos, asks_halos, halo_chance, halo_density, lamp_past
from lfmesh.transport.events.lighting import LIGHT_DIMENSIONS, point_of_light
from lfmesh.transport.events.scattering import density, evaluate
from lfmesh.transport.packets.packet import (
    IN_FOG,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    TO_EMITTER,
    TO_HALO,
    TO_MEDIUM,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.regions.bodies import RANK, bodies_round
from lfmesh.transport.regions.targets import emitted_radiance, point_of, texture_at
from lfmesh.transport.tables.halos import drawn_angle
from lfmesh.transport.tables.tables import ObjectTables

TO_GLOW = 1 << 22
"""Number of the random numbers, among those that a packet's key has for its children, of points of emitting media."""

PAST_LAMP = 1 << 23
"""The same of packets past lamps."""


@kernel
def ask_emitters(wave: NDArray[np.void], objects: ObjectTables, options: Options, flow: Flow) -> None:
    """Send packets from each point to a random point of emitting facets, and to one of emitting media.

    Parameters
    ----------
    wave : (n,) PACKET
        Packets at the points, with the directions in which they arrived, and the facets in `facet`: `IN_FOG` in a
        medium, whose number is then in `row`.
    """
    for i in range(len(wave)):
        packet = wave[i]
        if asks_emitters(options, objects, packet.events):
            _ask_facet(objects, options, flow, packet)
        if asks_media(objects.volumes, options):
            _ask_media(objects.volumes, objects, options, flow, packet)
        if asks_halos(objects.volumes, options, packet.events):
            _ask_halo(objects.volumes, objects, options, flow, packet)


@inlined
def _ask_facet(objects: ObjectTables, options: Options, flow: Flow, packet: Any) -> None:
    """Send a packet from a point to a random point of the emitting facets.

    Parameters
    ----------
    packet : PACKET
        As in `ask_emitters`.
    """
    x, y, z = packet.x, packet.y, packet.z
    u, v = draw_two(options, packet, EMITTER_U)
    prim, ex, ey, ez, per_area = emitting_point(objects, u, v)
    facet = objects.facets[prim]
    ux, uy, uz = ex - x, ey - y, ez - z
    distance2 = ux * ux + uy * uy + uz * uz
    if prim == packet.facet or distance2 == 0.0:
        return
    distance = np.sqrt(distance2)
    ux, uy, uz = ux / distance, uy / distance, uz / distance
    away = facet.normal[0] * ux + facet.normal[1] * uy + facet.normal[2] * uz
    # A facet in the point's own plane, to rounding, sends it no light.
    if away == 0.0 or (objects.one_sided[facet.body] and away > 0.0):
        return
    cos_facet = abs(away)
    scattered, by_chance, clear = _scattered_towards(objects.volumes, objects, options, packet, ux, uy, uz)
    if scattered <= 0.0:
        return
    # Over the sum of both densities: over its own one, and weighted by the balance heuristic.
    side = -1.0 if away > 0.0 else 1.0
    there = point_of(objects, prim, ex, ey, ez, side, texture_at(objects, prim, packet.colour, ex, ey, ez), True)
    radiance = emitted_radiance(objects, packet, there, -ux, -uy, -uz)
    light = radiance * scattered * cos_facet / (per_area * distance2 + by_chance * cos_facet)
    if light <= 0.0:
        return
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, packet.weight * light, packet.key, clear)
    child.kind = TO_EMITTER
    child.last = NO_SURFACE
    child.to_facet = prim


@inlined
def _ask_media(volumes: Any, objects: ObjectTables, options: Options, flow: Flow, packet: Any) -> None:
    """Send a packet from a point towards a random point of the emitting media in its body, or in air.

    Parameters
    ----------
    volumes : Volumes or None
        As for `asks_media`.
    packet : PACKET
        As in `ask_emitters`.
    """
    if volumes is None:
        return
    x, y, z, place = packet.x, packet.y, packet.z, bodies_round(packet) & RANK
    key = derived(packet.key, TO_GLOW + packet.events)
    choice, u = draw_two(options, packet, EMITTER_U)
    found, mx, my, mz = point_of_media(volumes, place, choice, u, uniform(key, 0), uniform(key, 1))
    ux, uy, uz = mx - x, my - y, mz - z
    distance = np.sqrt(ux * ux + uy * uy + uz * uz)
    if not found or distance == 0.0:
        return
    ux, uy, uz = ux / distance, uy / distance, uz / distance
    scattered, by_chance, clear = _scattered_towards(volumes, objects, options, packet, ux, uy, uz)
    if scattered <= 0.0:
        return
    aimed = density_to_media(volumes, place, x, y, z, ux, uy, uz)
    if aimed <= 0.0:
        # The direction grazes the medium, to rounding.
        return
    weight = packet.weight * scattered / (aimed + by_chance)
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, weight, key, clear)
    child.kind, child.last = TO_MEDIUM, NO_SURFACE


@inlined
def _ask_halo(volumes: Any, objects: ObjectTables, options: Options, flow: Flow, packet: Any) -> None:
    """Send a packet from a point in air past a lamp, to gather what media scatter of its light.

    Parameters
    ----------
    volumes : Volumes or None
        As for `asks_halos`.
    packet : PACKET
        As in `ask_emitters`.
    """
    if volumes is None:
        return
    if bodies_round(packet) == 0:
        _ask_halo_in_air(volumes, volumes.halos, objects, options, flow, packet)


@inlined
def _ask_halo_in_air(
    volumes: Any, halos: Any, objects: ObjectTables, options: Options, flow: Flow, packet: Any
) -> None:  # fmt: skip
    """Do what `_ask_halo` does for a point in no body of glass; `halos` : Halos or None, as for `asks_halos`."""
    if halos is None:
        return
    lights, spectra, colour = objects.lights, objects.light_spectra, packet.colour
    x, y, z = packet.x, packet.y, packet.z
    key = derived(packet.key, PAST_LAMP + packet.events)
    number = lamp_past(halos, lights, spectra, colour, x, y, z, key)
    if number < 0:
        return
    light = lights[number]
    px, py, pz = point_of_light(light, uniform(key, LAMP_U), uniform(key, LAMP_V))
    px, py, pz = px - x, py - y, pz - z
    far = np.sqrt(px * px + py * py + pz * pz)
    u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * len(lights))
    angle = drawn_angle(halos, colour, u)
    sine = np.sin(angle)
    if far <= 0.0 or sine <= 0.0:
        return
    height = 2.0 * np.sin(0.5 * angle) ** 2
    ux, uy, uz = near(px / far, py / far, pz / far, height, 2.0 * np.pi * v)
    scattered, by_chance, clear = _scattered_towards(volumes, objects, options, packet, ux, uy, uz)
    if scattered <= 0.0:
        return
    chance = halo_chance(halos, lights, spectra, number, colour, all_halos(lights, spectra, colour, x, y, z), x, y, z)
    weight = packet.weight * scattered / (chance * halo_density(halos, colour, angle, sine) + by_chance)
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, weight, key, clear)
    child.kind, child.last, child.to_lamp = TO_HALO, NO_SURFACE, number
    # As of the packet that is scattered, whose line this might be.
    count_event(child)


@inlined
def _scattered_towards(
    volumes: Any, objects: ObjectTables, options: Options, packet: Any, ux: float, uy: float, uz: float
) -> tuple[float, float, float]:
    """Return what a point scatters in a direction, with its cosine, and the density of scattered packets, both 1/sr.

    The density is that of those which roulette keeps: where hardly any are, their light would else be in single pixels.

    Parameters
    ----------
    volumes : Volumes or None
    options : Options
    packet : PACKET
        As in `ask_emitters`.
    ux, uy, uz : float
        Unit direction.

    Returns
    -------
    scattered, density : float
        0 where it scatters nothing.
    clear : float, mm
        Distance at which a query that way begins.
    """
    # Two conditions: numba leaves the code out where the first alone is known not to hold.
    if volumes is not None:  # noqa: SIM102
        if packet.facet == IN_FOG:
            phase = volumes.phases.rows[packet.in_medium, packet.colour]
            value = evaluate_phase(volumes.phases, phase, packet.dx * ux + packet.dy * uy + packet.dz * uz)
            return value, value * _kept(options, packet, packet.weight), 0.0
    x, y, z = packet.x, packet.y, packet.z
    ix, iy, iz = packet.dx, packet.dy, packet.dz
    own = objects.facets[packet.facet]
    along = own.normal[0] * ix + own.normal[1] * iy + own.normal[2] * iz
    side = -1.0 if along > 0.0 else 1.0
    cosine = side * (own.normal[0] * ux + own.normal[1] * uy + own.normal[2] * uz)
    if cosine <= EDGE:
        return 0.0, 0.0, 0.0
    texel = texture_at(objects, packet.facet, packet.colour, x, y, z)
    point = point_of(objects, packet.facet, x, y, z, side, texel, True)
    by_chance = density(objects.scattering, point, packet.colour, ix, iy, iz, ux, uy, uz)
    brdf = evaluate(objects.scattering, point, packet.colour, ix, iy, iz, ux, uy, uz)
    if by_chance > 0.0:
        by_chance *= _kept(options, packet, packet.weight * brdf * cosine / by_chance)
    return brdf * cosine, by_chance, clear_of(own, x, y, z, ux, uy, uz)


@inlined
def _kept(options: Options, packet: Any, weight: float) -> float:
    """Return the chance with which roulette keeps a scattered packet of that weight."""
    floor = options.cutoff * packet.start
    return weight / floor if weight < floor else 1.0
