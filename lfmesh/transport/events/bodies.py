"""Stack of the glass bodies in object space that a packet is in, and the resulting medium.

Bodies may nest, touch and overlap. Each has a rank, by priority and, among equals, by nesting; the highest rank decides
the medium of an overlap. A packet holds the ranks of all bodies around it, highest first, as one number with 11 bits
per rank, in the fields `bodies` and `space`. See Schmidt & Budge, Simple nested dielectrics in ray traced images,
Journal of Graphics Tools 7(2), 2002.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.objects.round_faces import lies_in
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.facets import crosses
from lfmesh.transport.events.moving import mover_of, point_between
from lfmesh.transport.packets.packet import NO_SURFACE
from lfmesh.transport.tables.tables import AIR, GlassTables, ObjectTables

BITS = 11
RANK = (1 << BITS) - 1

LOW_BITS = 30
LOW = (1 << LOW_BITS) - 1
"""Bits of the number held in `bodies`; `space` holds the others."""

MOST_AT_ONCE = 4
"""Largest number of bodies that a packet can be in at once."""

MOST_BODIES = RANK
"""Largest number of bodies of glass in a scene."""

TOO_MANY = -1


@inlined
def bodies_round(packet: Any) -> int:
    """Return the ranks, as one number, of the bodies around a packet in object space; 0: none."""
    if packet.bodies < 0:
        return 0
    return int(np.int64(packet.bodies) | (np.int64(packet.space) << LOW_BITS))


@inlined
def set_bodies(packet: Any, inside: int) -> None:
    """Set the bodies around a packet."""
    packet.bodies = inside & LOW if inside != 0 else NO_SURFACE
    packet.space = inside >> LOW_BITS


@inlined
def is_in(inside: int, rank: int) -> bool:
    """Tell whether a packet is in the body of a rank."""
    while inside > 0:
        if inside & RANK == rank:
            return True
        inside >>= BITS
    return False


@inlined
def with_body(inside: int, rank: int) -> int:
    """Return the bodies with one added in order of rank; `TOO_MANY` if there is no room."""
    if inside >> ((MOST_AT_ONCE - 1) * BITS) != 0:
        return TOO_MANY
    above, shift = 0, 0
    while inside & RANK > rank:
        above |= (inside & RANK) << shift
        shift += BITS
        inside >>= BITS
    return above | (rank << shift) | (inside << (shift + BITS))


@inlined
def without_body(inside: int, rank: int) -> int:
    """Return the bodies without one of them."""
    above, shift = 0, 0
    while inside > 0 and inside & RANK != rank:
        above |= (inside & RANK) << shift
        shift += BITS
        inside >>= BITS
    return above | ((inside >> BITS) << shift)


@inlined
def medium_of(objects: ObjectTables, inside: int) -> int:
    """Return the number of the medium inside some bodies."""
    return objects.medium[objects.by_rank[inside & RANK]] if inside != 0 else AIR


@kernel
def bodies_at(objects: ObjectTables, moving: Any, mover: int, x: float, y: float, z: float) -> int:
    """Return the bodies around a point, as packets hold them; `TOO_MANY` if there is no room.

    A line along z from a point inside crosses a body's shell an odd number of times. Both facets of an edge decide
    alike on which side the line passes. Round bodies are tested directly.

    Parameters
    ----------
    objects : ObjectTables
    moving : Moving or None
    mover : int
        Mover in whose frame the point is given; 0: the object frame.
    x, y, z : float, mm
        Point, not on a shell.
    """
    inside, point = 0, (x, y, z)
    for rank in range(1, len(objects.by_rank)):
        body = objects.by_rank[rank]
        x, y, z = point_between(moving, mover, mover_of(moving, body), point[0], point[1], point[2])
        is_in_it = _is_in_round(objects.rounds, body, x, y, z)
        for prim in range(len(objects.facets)):
            facet = objects.facets[prim]
            if facet.body != body or not _is_above(facet, x, y):
                continue
            normal = facet.normal
            if normal[2] != 0.0 and (facet.offset - normal[0] * x - normal[1] * y) / normal[2] > z:
                is_in_it = not is_in_it
        if is_in_it and inside != TOO_MANY:
            inside = with_body(inside, rank)
    return inside


@inlined
def _is_in_round(rounds: Any, body: int, x: float, y: float, z: float) -> bool:
    """Tell whether a point lies in a round body; `rounds` : RoundFaces or None."""
    if rounds is not None:
        for number in range(len(rounds.faces)):
            face = rounds.faces[number]
            if face.body == body and lies_in(face, x, y, z):
                return True
    return False


@inlined
def _is_above(facet: Any, x: float, y: float) -> bool:
    """Tell whether a line along z through a point of the xy plane crosses a facet."""
    within = False
    corner = facet.corners
    for i in range(3):
        j = (i + 1) % 3
        if (corner[i, 1] > y) != (corner[j, 1] > y):
            low, high = (i, j) if corner[i, 1] < corner[j, 1] else (j, i)
            share = (y - corner[low, 1]) / (corner[high, 1] - corner[low, 1])
            if x < corner[low, 0] + share * (corner[high, 0] - corner[low, 0]):
                within = not within
    return within


@kernel
def beyond_facet(objects: ObjectTables, glass: GlassTables, inside: int, prim: int, enters: bool, ray: Ray) -> int:
    """Return the bodies around a ray after it crosses a facet; `TOO_MANY` if they cannot be represented.

    At touching bodies the ray crosses facets of both at once: it leaves one as it enters the other.

    Parameters
    ----------
    inside : int
        Bodies before the facet.
    prim : int
        Facet.
    enters : bool
        Whether the ray enters the facet's body or leaves it.
    ray : Ray
        Ray from the point of the crossing.
    """
    x, y, z, dx, dy, dz = ray
    rank = objects.rank[objects.facets[prim].body]
    after = with_body(inside, rank) if enters else without_body(inside, rank)
    if len(glass.contact_first) == 0 or after == TOO_MANY:
        return after
    # Entries before exits, so that entering and leaving a corner at once has no effect.
    for entering in (True, False):
        for number in range(glass.contact_first[prim], glass.contact_first[prim + 1]):
            facet = objects.facets[glass.contacts[number]]
            t, along = crosses(facet, x, y, z, dx, dy, dz)
            if t == np.inf or abs(t * along) > glass.contact_mm or (along < 0.0) != entering:
                continue
            other = objects.rank[facet.body]
            if is_in(after, other) == entering:
                continue
            after = with_body(after, other) if entering else without_body(after, other)
            if after == TOO_MANY:
                return after
    return after
