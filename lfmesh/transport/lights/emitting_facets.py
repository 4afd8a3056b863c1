"""Emitting facets: random points of them, and the density with which they are drawn.

Pieces of facets are drawn by their power, texture included (see `tables.emitting_facets`). Neither a small, bright
facet, which scattered rays seldom meet, nor one that touches the point, where 1 / r² is unbounded, then makes the
variance large. Only a straight line in one medium joins a point to a facet: what comes through glass or through the
lens is found by scattered rays alone.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.ray import Ray, along
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.crossing import EMITTER_U, draw_two
from lfmesh.transport.events.facets import barycentric, crosses
from lfmesh.transport.events.surface import emitted_radiance, point_of
from lfmesh.transport.lights.shadow import Way
from lfmesh.transport.packets.packet import TO_FACET, Options
from lfmesh.transport.tables.tables import Emitters, ObjectTables


@inlined
def are_asked(options: Options, objects: ObjectTables, events: int) -> bool:
    """Tell whether a point, after so many events, asks emitting facets.

    It does not where no scattered packet could bring their light either: without other targets, or too deep.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    events : int
        That the packet has had.
    """
    return options.bounce and len(objects.emitters.until) > 0 and events + 1 < options.max_events


@inlined
def sample(options: Options, objects: ObjectTables, packet: Any) -> Way:
    """Draw a way from the point where a packet is to a point of the emitting facets.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    packet : PACKET
    """
    u, v = draw_two(options, packet, EMITTER_U)
    prim, x, y, z, per_area = emitting_point(objects, u, v)
    facet, normal = objects.facets[prim], objects.facets[prim].normal
    ux, uy, uz = x - packet.x, y - packet.y, z - packet.z
    distance2 = ux * ux + uy * uy + uz * uz
    distance = np.sqrt(distance2)
    drawn, away = 0.0, 0.0
    if prim != packet.facet and distance2 > 0.0:
        ux, uy, uz = ux / distance, uy / distance, uz / distance
        away = normal[0] * ux + normal[1] * uy + normal[2] * uz
    # A facet in the point's own plane, to rounding, sends it no light.
    if away < 0.0 or (away > 0.0 and not objects.one_sided[facet.body]):
        drawn = per_area * distance2 / abs(away)
    return Way(TO_FACET, prim, Ray(packet.x, packet.y, packet.z, ux, uy, uz), distance, 1.0, drawn)


@inlined
def density(objects: ObjectTables, packet: Any, prim: int, x: float, y: float, z: float) -> float:
    """Return the density, 1/sr, with which `sample` draws the way of a packet from its start to a facet.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        It starts where it was scattered.
    prim : int
        The facet.
    x, y, z : float, mm
        The point of the facet, object frame.
    """
    if len(objects.emitters.until) == 0:
        return 0.0
    facet = objects.facets[prim]
    per_area = density_at(objects.emitters, facet, prim, x, y, z)
    if per_area <= 0.0:
        return 0.0
    dx, dy, dz = x - packet.x, y - packet.y, z - packet.z
    normal = facet.normal
    cosine = abs(normal[0] * packet.dx + normal[1] * packet.dy + normal[2] * packet.dz)
    return per_area * (dx * dx + dy * dy + dz * dz) / cosine


@inlined
def radiance(objects: ObjectTables, packet: Any, way: Way) -> float:
    """Return the radiance of the facet at the end of a way, as the packet's weight counts it, W/(m² sr).

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        At the begin of the way.
    way : Way
        From `sample`.
    """
    ray, normal = way.ray, objects.facets[way.goal].normal
    side = -1.0 if normal[0] * ray.dx + normal[1] * ray.dy + normal[2] * ray.dz > 0.0 else 1.0
    there = point_of(objects, packet, way.goal, along(ray, way.reach), side, True)
    return emitted_radiance(objects, packet, there, -ray.dx, -ray.dy, -ray.dz)


@inlined
def is_reached(objects: ObjectTables, packet: Any, prim: int) -> bool:
    """Tell whether a shadow packet meets the facet that it was sent to, when the query found the facet `prim`.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
    prim : int
        −1: none.
    """
    if prim < 0 or prim == packet.goal:
        return prim >= 0
    # Next to an edge, float32 may find the neighbour of the right facet.
    facet = objects.facets[prim]
    if facet.body != objects.facets[packet.goal].body:
        return False
    return crosses(facet, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)[0] == np.inf


@inlined
def density_at(emitters: Emitters, facet: Any, prim: int, x: float, y: float, z: float) -> float:
    """Return the density, 1/mm², with which `emitting_point` draws a point of a facet.

    Parameters
    ----------
    emitters : Emitters
    facet : FACET
    prim : int
        Its number.
    x, y, z : float, mm
        The point, object frame.
    """
    first = emitters.first[prim]
    if first < 0:
        return 0.0
    b, c = barycentric(facet, x, y, z)
    piece = 0
    for _ in range(emitters.level[prim]):
        a = 1.0 - b - c
        if a > 0.5:
            digit, b, c = 1, 2.0 * b, 2.0 * c
        elif b > 0.5:
            digit, b, c = 2, 2.0 * b - 1.0, 2.0 * c
        elif c > 0.5:
            digit, b, c = 3, 2.0 * b, 2.0 * c - 1.0
        else:
            digit, b, c = 0, 1.0 - 2.0 * b, 1.0 - 2.0 * c
        piece = 4 * piece + digit
    return emitters.density[first + piece]


@inlined
def emitting_point(objects: ObjectTables, u: float, v: float) -> tuple[int, float, float, float, float]:
    """Return a random point of the emitters.

    Parameters
    ----------
    u, v : float
        Random numbers, uniform in [0, 1). Near ones give near points.

    Returns
    -------
    prim : int
        Facet.
    x, y, z : float, mm
    density : float, 1/mm²
    """
    emitters = objects.emitters
    pieces = len(emitters.until)
    piece = emitters.begin[int(u * pieces)]
    while u >= emitters.until[piece] and piece < pieces - 1:
        piece += 1
    below = emitters.until[piece - 1] if piece > 0 else 0.0
    # What is left of the first number is a random number of its own.
    u = min((u - below) / (emitters.until[piece] - below), 1.0)
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    prim = emitters.facet[piece]
    b, c = (
        emitters.place[piece, 0] + emitters.place[piece, 2] * u,
        emitters.place[piece, 1] + emitters.place[piece, 2] * v,
    )
    corner = objects.facets[prim].corners
    a = 1.0 - b - c
    x = a * corner[0, 0] + b * corner[1, 0] + c * corner[2, 0]
    y = a * corner[0, 1] + b * corner[1, 1] + c * corner[2, 1]
    z = a * corner[0, 2] + b * corner[1, 2] + c * corner[2, 2]
    return prim, x, y, z, emitters.density[piece]
