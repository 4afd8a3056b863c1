"""Which bodies of glass in object space a packet is in, and what medium that makes of where it is.

Bodies may nest, touch and overlap. Each has a rank, by its priority and, among equals, by nesting; where several are,
the one of the highest rank is what the packet travels in. A packet keeps the ranks of all that it is in, the highest
first, as one number of 11 bits a rank, in fields that lens and array use: `column` and `space`. See Schmidt & Budge,
Simple nested dielectrics in ray traced images, Journal of Graphics Tools 7(2), 2002.
"""

from typing import Any

import numpy as np

from lfmesh.kernel import inlined, kernel
from lfmesh.transport.events.crossing import crosses
from lfmesh.transport.packets.packet import NO_SURFACE
from lfmesh.transport.tables.tables import AIR, ObjectTables

BITS = 11
RANK = (1 << BITS) - 1

LOW_BITS = 30
LOW = (1 << LOW_BITS) - 1
"""What of the number is in `column`; the rest is in `space`."""

MOST_AT_ONCE = 4
"""Bodies that a packet can be in at once."""

MOST_BODIES = RANK
"""Bodies of glass that there can be."""

TOO_MANY = -1


@inlined
def bodies_round(packet: Any) -> int:
    """Return the bodies that a packet in object space is in; 0: none."""
    if packet.column < 0:
        return 0
    return int(np.int64(packet.column) | (np.int64(packet.space) << LOW_BITS))


@inlined
def set_bodies(packet: Any, inside: int) -> None:
    """Say which bodies a packet is in."""
    packet.column = inside & LOW if inside != 0 else NO_SURFACE
    packet.space = inside >> LOW_BITS


@inlined
def is_in(inside: int, rank: int) -> bool:
    """Tell whether the body of a rank is among those that a packet is in."""
    while inside != 0:
        if inside & RANK == rank:
            return True
        inside >>= BITS
    return False


@inlined
def with_body(inside: int, rank: int) -> int:
    """Return the bodies with one more, its place by its rank; `TOO_MANY` where there is no room."""
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
    """Return the bodies without one that is among them."""
    above, shift = 0, 0
    while inside & RANK != rank:
        above |= (inside & RANK) << shift
        shift += BITS
        inside >>= BITS
    return above | ((inside >> BITS) << shift)


@inlined
def medium_of(objects: ObjectTables, inside: int) -> int:
    """Return the medium where a packet is in some bodies."""
    return objects.medium[objects.by_rank[inside & RANK]] if inside != 0 else AIR


@kernel
def beyond_facet(
    objects: ObjectTables, inside: int, prim: int, enters: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
) -> int:  # fmt: skip
    """Return the bodies that a ray is in beyond the point at which it crosses a facet; `TOO_MANY` where it cannot know.

    Where bodies touch, it crosses facets of both there, and leaves the one as it enters the other.
    """
    rank = objects.rank[objects.facets[prim].body]
    after = with_body(inside, rank) if enters else without_body(inside, rank)
    if len(objects.contact_first) == 0 or after == TOO_MANY:
        return after
    # What is entered first, so that a corner which is entered and left at once leaves no trace.
    for entering in (True, False):
        for number in range(objects.contact_first[prim], objects.contact_first[prim + 1]):
            facet = objects.facets[objects.contacts[number]]
            t, along = crosses(facet, x, y, z, dx, dy, dz)
            if t == np.inf or abs(t * along) > objects.contact_mm or (along < 0.0) != entering:
                continue
            other = objects.rank[facet.body]
            if is_in(after, other) == entering:
                continue
            after = with_body(after, other) if entering else without_body(after, other)
            if after == TOO_MANY:
                return after
    return after
