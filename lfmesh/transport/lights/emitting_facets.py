"""Emitting facets as lights: random points on them, and their density.

Pieces of facets are drawn by their power, texture included (see `tables.emitting_facets`). If there are many, a leaf of
their tree is drawn first, by its light at the point (see `many_emitters`). Scattered rays alone would have a large
variance: they seldom meet small, bright facets, and 1/r² is unbounded at facets that touch the point. Only straight
lines in one medium are sampled; scattered rays find light through glass or the lens. Points of facets are given in the
frame of their mover.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.objects.round_faces import FLAT, parameters_at
from lfmesh.geometry.ray import Ray, along, ray_of
from lfmesh.kernels.decorators import inlined
from lfmesh.kernels.search import drawn_by
from lfmesh.transport.events.crossing import EMITTER_U, draw_two
from lfmesh.transport.events.facets import barycentric, crosses
from lfmesh.transport.events.moving import direction_between, mover_of, point_between, ray_between
from lfmesh.transport.events.surface import emitted_radiance, outward, place_on, point_of, spread
from lfmesh.transport.lights.many_emitters import chance_of_leaf, chance_of_tree, drawn_leaf, drawn_tree, lit_normal
from lfmesh.transport.lights.many_lamps import Place
from lfmesh.transport.lights.shadow import Way
from lfmesh.transport.packets.packet import NO_SURFACE, TO_FACET, Options, mover_of_frame
from lfmesh.transport.tables.tables import ObjectTables


@inlined
def are_asked(options: Options, objects: ObjectTables, events: int) -> bool:
    """Tell whether a point, after so many events, samples emitting facets.

    It does not if scattered packets could not bring their light either: without other targets, or too deep.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    events : int
        Number of the packet's events so far.
    """
    return options.bounce and len(objects.emitters.until) > 0 and events + 1 < options.max_events


@inlined
def sample(options: Options, objects: ObjectTables, packet: Any, moving: Any) -> Way:
    """Draw a way from a packet's position to a point of the emitting facets.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    packet : PACKET
    moving : Moving or None
    """
    u, v = draw_two(options, packet, EMITTER_U)
    normal, here = lit_normal(objects, packet, True, moving), mover_of_frame(packet.frame)
    prim, x, y, z, per_area = emitting_point(objects, (packet.x, packet.y, packet.z), normal, u, v, moving, here)
    if prim < 0:
        return Way(TO_FACET, prim, ray_of(packet), 0.0, 1.0, 0.0)
    nx, ny, nz = outward(objects, prim, x, y, z)
    there = mover_of(moving, objects.facets[prim].body)
    px, py, pz = point_between(moving, here, there, packet.x, packet.y, packet.z)
    ux, uy, uz = x - px, y - py, z - pz
    distance2 = ux * ux + uy * uy + uz * uz
    distance = np.sqrt(distance2)
    drawn, away = 0.0, 0.0
    if (prim != packet.facet or _is_bent(objects.rounds, prim)) and distance2 > 0.0:
        ux, uy, uz = ux / distance, uy / distance, uz / distance
        away = nx * ux + ny * uy + nz * uz
    # A facet in the point's own plane, to within rounding, sends it no light.
    if away < 0.0 or (away > 0.0 and not objects.one_sided[objects.facets[prim].body]):
        drawn = per_area * distance2 / abs(away)
    ux, uy, uz = direction_between(moving, there, here, ux, uy, uz)
    return Way(TO_FACET, prim, Ray(packet.x, packet.y, packet.z, ux, uy, uz), distance, 1.0, drawn)


@inlined
def _is_bent(rounds: Any, prim: int) -> bool:
    """Tell whether points of a facet may see each other; `rounds` : RoundFaces or None."""
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            return rounds.faces[prim - rounds.first].kind != FLAT
    return False


@inlined
def density(objects: ObjectTables, packet: Any, prim: int, x: float, y: float, z: float, moving: Any) -> float:
    """Return the density, 1/sr, of `sample` for the way from a packet's start to a point of a facet.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        At its last scattering, in the frame of the facet's mover.
    prim : int
        Facet.
    x, y, z : float, mm
        Point of the facet.
    moving : Moving or None
    """
    if len(objects.emitters.until) == 0:
        return 0.0
    place, normal = (packet.x, packet.y, packet.z), lit_normal(objects, packet, False, moving)
    per_area = density_at(objects, place, normal, prim, (x, y, z), moving, mover_of_frame(packet.frame))
    if per_area <= 0.0:
        return 0.0
    dx, dy, dz = x - packet.x, y - packet.y, z - packet.z
    nx, ny, nz = outward(objects, prim, x, y, z)
    cosine = abs(nx * packet.dx + ny * packet.dy + nz * packet.dz)
    return per_area * (dx * dx + dy * dy + dz * dz) / cosine


@inlined
def radiance(objects: ObjectTables, packet: Any, way: Way, moving: Any) -> float:
    """Return the radiance of the facet at the end of a way, scaled for the packet's weight, W/(m² sr).

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
        At the start of the way.
    way : Way
        From `sample`.
    moving : Moving or None
    """
    ray = _ray_at(objects, packet, way.goal, way.ray, moving)
    place = along(ray, way.reach)
    nx, ny, nz = outward(objects, way.goal, place[0], place[1], place[2])
    side = -1.0 if nx * ray.dx + ny * ray.dy + nz * ray.dz > 0.0 else 1.0
    there = point_of(objects, packet, way.goal, place, side, True)
    return emitted_radiance(objects, packet, there, -ray.dx, -ray.dy, -ray.dz, moving)


@inlined
def _ray_at(objects: ObjectTables, packet: Any, prim: int, ray: Ray, moving: Any) -> Ray:
    """Return a ray, given in a packet's frame, in the frame of a facet's mover."""
    return ray_between(moving, mover_of_frame(packet.frame), mover_of(moving, objects.facets[prim].body), ray)


@inlined
def is_reached(objects: ObjectTables, packet: Any, prim: int, t: float, moving: Any) -> bool:
    """Tell whether a shadow packet reaches its goal when the query has found the facet `prim`.

    Parameters
    ----------
    objects : ObjectTables
    packet : PACKET
    prim : int
        Facet; −1: none.
    t : float, mm
        Distance of the facet.
    moving : Moving or None
    """
    if prim < 0:
        return False
    ray = _ray_at(objects, packet, prim, ray_of(packet), moving)
    if prim == packet.goal:
        # A line meets a round face on two sides; the point lies on one of them.
        return not _is_bent(objects.rounds, prim) or (
            (_along_at(objects, prim, ray, t) > 0.0) == (_along_at(objects, prim, ray, packet.limit) > 0.0)
        )
    # Next to an edge, float32 may find the neighbour of the right facet; round faces are found in float64.
    facet = objects.facets[prim]
    if facet.body != objects.facets[packet.goal].body or facet.size == 0.0:
        return False
    return crosses(facet, ray.x, ray.y, ray.z, ray.dx, ray.dy, ray.dz)[0] == np.inf


@inlined
def _along_at(objects: ObjectTables, prim: int, ray: Ray, t: float) -> float:
    """Return outward normal · direction at a ray's intersection with a facet."""
    x, y, z = along(ray, t)
    nx, ny, nz = outward(objects, prim, x, y, z)
    return nx * ray.dx + ny * ray.dy + nz * ray.dz


@inlined
def density_at(
    objects: ObjectTables, place: Place, normal: Place, prim: int, there: Place, moving: Any, here: int
) -> float:  # fmt: skip
    """Return the density, 1/mm², of `emitting_point` at a point of a facet.

    Parameters
    ----------
    objects : ObjectTables
    place, normal, moving, here
        As for `emitting_point`.
    prim : int
        Number of the facet.
    there : (3,) float, mm
        Point of the facet.
    """
    emitters = objects.emitters
    first = emitters.first[prim]
    if first < 0:
        return 0.0
    piece = emitters.number[first + _piece_at(objects.rounds, objects, prim, there[0], there[1], there[2])]
    if len(emitters.nodes) == 0:
        return emitters.density[piece]
    root, chance = chance_of_tree(emitters.trees, emitters, place, normal, piece, moving, here)
    own = mover_of(moving, objects.facets[prim].body)
    at = point_between(moving, here, own, place[0], place[1], place[2])
    facing = direction_between(moving, here, own, normal[0], normal[1], normal[2])
    return chance * chance_of_leaf(emitters, root, at, facing, piece) * emitters.density[piece]


@inlined
def _piece_at(rounds: Any, objects: ObjectTables, prim: int, x: float, y: float, z: float) -> int:
    """Return the number of the piece at a point of an emitting facet; `rounds` : RoundFaces or None."""
    emitters = objects.emitters
    if rounds is not None:  # noqa: SIM102
        if prim >= rounds.first:
            return _square_at(rounds.faces[prim - rounds.first], emitters.level[prim], x, y, z)
    b, c = barycentric(objects.facets[prim], x, y, z)
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
    return piece


@inlined
def _square_at(face: Any, level: int, x: float, y: float, z: float) -> int:
    """Return the number of the piece at a point of a round face; pieces are squares of its parameters."""
    piece = 0
    if level > 0:
        s, t = parameters_at(face, x, y, z)
        for _ in range(level):
            s, t = 2.0 * s, 2.0 * t
            right, up = 1 if s >= 1.0 else 0, 1 if t >= 1.0 else 0
            s, t = s - right, t - up
            piece = 4 * piece + 2 * up + right
    return piece


@inlined
def emitting_point(
    objects: ObjectTables, place: Place, normal: Place, u: float, v: float, moving: Any, here: int
) -> tuple[int, float, float, float, float]:  # fmt: skip
    """Return a random point of the emitters, drawn for a point that they may light.

    Parameters
    ----------
    objects : ObjectTables
    place, normal
        As for `many_emitters.drawn_leaf`, in the frame of the mover `here`.
    u, v : float
        Random numbers, uniform in [0, 1); close numbers give close points.
    moving : Moving or None
    here : int

    Returns
    -------
    prim : int
        Facet; −1: no emitter brings light.
    x, y, z : float, mm
        In the frame of the facet's mover.
    density : float, 1/mm²
    """
    emitters = objects.emitters
    begin, end, chance = 0, len(emitters.until), 1.0
    if len(emitters.nodes) > 0:
        root, chance, u = drawn_tree(emitters.trees, emitters, place, normal, u, moving, here)
        own = mover_of(moving, objects.facets[emitters.facet[emitters.nodes[root].begin]].body)
        at = point_between(moving, here, own, place[0], place[1], place[2])
        facing = direction_between(moving, here, own, normal[0], normal[1], normal[2])
        leaf, within, u = drawn_leaf(emitters, root, at, facing, u)
        chance *= within
        begin, end = emitters.nodes[leaf].begin, emitters.nodes[leaf].end
    if not chance > 0.0:
        return NO_SURFACE, 0.0, 0.0, 0.0, 0.0
    piece = begin + drawn_by(emitters.until[begin:end], u)
    below = emitters.until[piece - 1] if piece > begin else 0.0
    # Rescaled, the first number is uniform again.
    u = min((u - below) / (emitters.until[piece] - below), 1.0)
    prim = emitters.facet[piece]
    u, v = spread(objects, prim, u, v)
    b, c = (
        emitters.place[piece, 0] + emitters.place[piece, 2] * u,
        emitters.place[piece, 1] + emitters.place[piece, 2] * v,
    )
    x, y, z = place_on(objects, prim, b, c)
    return prim, x, y, z, chance * emitters.density[piece]
