"""Scattered packets that are guided to emitting facets, and what they leave to the others.

A point of a target, seen from the sensor, finds the light of other targets by two packets: one is guided to a random
point of the emitting facets, the other takes the direction that the scattering model draws. Where a
straight line in one medium joins two points of targets, both find the path; each is weighted by its share of their
densities (the balance heuristic, Veach & Guibas, SIGGRAPH 1995), so that it counts once. Then neither a small, bright
facet, which is seldom met by chance, nor one that touches the point, where 1 / r² is unbounded, makes the variance
large. Paths through glass or through the lens are found by the second packet alone, which keeps its full weight.
"""

from typing import Any

from lfmesh.kernel import inlined
from lfmesh.transport.events.crossing import barycentric
from lfmesh.transport.packets.packet import NO_SURFACE, SCATTERED, Options
from lfmesh.transport.tables.tables import Guide, ObjectTables


@inlined
def sends_guided(options: Options, objects: ObjectTables, events: int) -> bool:
    """Tell whether a point of a target, after so many events, sends a guided packet.

    It does not where no scattered packet could bring light: without other targets, or too deep.
    """
    return options.bounce and len(objects.guide.until) > 0 and events + 1 < options.max_events


@inlined
def share_by_chance(objects: ObjectTables, packet: Any, prim: int, x: float, y: float, z: float) -> float:
    """Return the share of a path's light that a packet counts which has met a target; 1 if no guided one finds it.

    Parameters
    ----------
    packet : PACKET
        It starts where it was scattered.
    prim : int
        The facet that it met.
    x, y, z : float, mm
        The point that it met.
    """
    if packet.kind != SCATTERED or packet.facet == NO_SURFACE or len(objects.guide.until) == 0:
        # Guided, straight from the camera, or by way of glass.
        return 1.0
    facet = objects.facets[prim]
    dx, dy, dz = x - packet.x, y - packet.y, z - packet.z
    normal = facet.normal
    cos_facet = abs(normal[0] * packet.dx + normal[1] * packet.dy + normal[2] * packet.dz)
    guided = density_at(objects.guide, facet, prim, x, y, z) * (dx * dx + dy * dy + dz * dz)
    by_chance = packet.density * cos_facet
    return by_chance / (by_chance + guided) if guided > 0.0 else 1.0


@inlined
def density_at(guide: Guide, facet: Any, prim: int, x: float, y: float, z: float) -> float:
    """Return the density, 1/mm², with which `guided_point` draws a point of a facet."""
    first = guide.first[prim]
    if first < 0:
        return 0.0
    b, c = barycentric(facet, x, y, z)
    piece = 0
    for _ in range(guide.level[prim]):
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
    return guide.density[first + piece]


@inlined
def guided_point(objects: ObjectTables, u: float, v: float) -> tuple[int, float, float, float, float]:
    """Return a random point of the guide.

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
    guide = objects.guide
    pieces = len(guide.until)
    piece = guide.begin[int(u * pieces)]
    while u >= guide.until[piece] and piece < pieces - 1:
        piece += 1
    below = guide.until[piece - 1] if piece > 0 else 0.0
    # What is left of the first number is a random number of its own.
    u = min((u - below) / (guide.until[piece] - below), 1.0)
    if u + v > 1.0:
        u, v = 1.0 - u, 1.0 - v
    prim = guide.facet[piece]
    b, c = guide.place[piece, 0] + guide.place[piece, 2] * u, guide.place[piece, 1] + guide.place[piece, 2] * v
    corner = objects.facets[prim].corners
    a = 1.0 - b - c
    x = a * corner[0, 0] + b * corner[1, 0] + c * corner[2, 0]
    y = a * corner[0, 1] + b * corner[1, 1] + c * corner[2, 1]
    z = a * corner[0, 2] + b * corner[1, 2] + c * corner[2, 2]
    return prim, x, y, z, guide.density[piece]
