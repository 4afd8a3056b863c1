"""Packets from points that scatter to random points of emitting facets and media, whose light they gather.

A station of its own: its kernel is compiled, and runs, only in scenes with targets or media that emit.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import inlined, kernel
from lfmesh.optics.phase import evaluate_phase
from lfmesh.transport.events.crossing import EDGE, EMITTER_U, clear_of, draw_two
from lfmesh.transport.events.emission import asks_emitters, emitting_point
from lfmesh.transport.events.glow import asks_media, density_to_media, point_of_media
from lfmesh.transport.events.scattering import density, evaluate
from lfmesh.transport.packets.packet import (
    IN_FOG,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    TO_EMITTER,
    TO_MEDIUM,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.regions.bodies import RANK, bodies_round
from lfmesh.transport.regions.targets import emitted_radiance, point_of, texture_at
from lfmesh.transport.tables.tables import ObjectTables

TO_GLOW = 1 << 22
"""Number of the random numbers, among those that a packet's key has for its children, of points of emitting media."""


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
    cos_facet = facet.normal[0] * ux + facet.normal[1] * uy + facet.normal[2] * uz
    # A facet in the point's own plane, to rounding, sends it no light.
    if cos_facet == 0.0 or (objects.one_sided[facet.body] and cos_facet > 0.0):
        return
    cos_facet = abs(cos_facet)
    scattered, by_chance, clear = _scattered_towards(objects.volumes, objects, options, packet, ux, uy, uz)
    if scattered <= 0.0:
        return
    # Over the sum of both densities: over its own one, and weighted by the balance heuristic.
    radiance = emitted_radiance(objects, packet, prim, texture_at(objects, prim, packet.colour, ex, ey, ez))
    light = radiance * scattered * cos_facet / (per_area * distance2 + by_chance * cos_facet)
    if light <= 0.0:
        return
    child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz, packet.weight * light, packet.key, clear)
    child.kind = TO_EMITTER
    child.last = NO_SURFACE
    child.row = prim


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
            phase = volumes.phases.rows[packet.row, packet.colour]
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
    point = point_of(objects, packet.facet, x, y, z, side, objects.model[packet.facet], texel, True)
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
