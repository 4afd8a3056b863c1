"""Emitting facets as light sources: random points of them, and the density with which they are drawn.

A point of a target, seen from the sensor, finds the light of emitting targets in two ways: a packet is sent to a random
point of an emitting facet, and the packet that is scattered may meet one by chance. Where a straight line in one medium
joins the two points, both ways find the path; each is weighted by its share of their densities (the balance heuristic,
Veach & Guibas, SIGGRAPH 1995), so that it counts once. Then neither a small, bright facet, which is seldom met by
chance, nor one that touches the point, where 1 / r² is unbounded, makes the variance large. Paths through glass or
through the lens are found by scattered packets alone and keep their full weight.
"""

from typing import Any

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.crossing import barycentric
from lfmesh.transport.packets.packet import NO_SURFACE, SCATTERED, Options
from lfmesh.transport.tables.tables import Emitters, ObjectTables


@inlined
def asks_emitters(options: Options, objects: ObjectTables, events: int) -> bool:
    """Tell whether a point of a target, after so many events, sends packets to emitting facets.

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
def share_by_chance(objects: ObjectTables, packet: Any, prim: int, x: float, y: float, z: float) -> float:
    """Return the share of a facet's emission that a packet counts which has met it.

    Parameters
    ----------
    packet : PACKET
        It starts where it was scattered.
    prim : int
        The facet.
    x, y, z : float, mm
        The point that it met.
    """
    if packet.kind != SCATTERED or packet.facet == NO_SURFACE or len(objects.emitters.until) == 0:
        # Straight from the camera, or by way of glass.
        return 1.0
    facet = objects.facets[prim]
    dx, dy, dz = x - packet.x, y - packet.y, z - packet.z
    normal = facet.normal
    cos_facet = abs(normal[0] * packet.dx + normal[1] * packet.dy + normal[2] * packet.dz)
    aimed = density_at(objects.emitters, facet, prim, x, y, z) * (dx * dx + dy * dy + dz * dz)
    by_chance = packet.density * cos_facet
    return by_chance / (by_chance + aimed) if aimed > 0.0 else 1.0


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
