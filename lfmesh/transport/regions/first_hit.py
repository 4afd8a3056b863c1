"""First facet, curved patch or round face that a packet meets in object space, found by Embree and decided in float64.

In a scene with motion each mover has its own facets: the ray is moved into the frame of each mover that it passes near,
and the nearest hit counts, as distances along a ray are the same in all frames. The packet is then in the frame of the
mover that it meets.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.patch_tree import patch_finder
from lfmesh.geometry.objects.round_faces import round_finder, round_normal
from lfmesh.geometry.ray import along as point_along
from lfmesh.geometry.ray import ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.bodies import RANK, bodies_round, is_in
from lfmesh.transport.events.crossing import MAX_TRIES
from lfmesh.transport.events.facets import crosses, next_query_from
from lfmesh.transport.events.moving import hold_frame, mover_of, movers, ray_between, set_rays, take_ray
from lfmesh.transport.packets.packet import LEFT_LENS, SHADOW, TO_LAMP, mover_of_frame
from lfmesh.transport.regions.glass import Curved
from lfmesh.transport.regions.targets import passes
from lfmesh.transport.tables.motions import FAR
from lfmesh.transport.tables.tables import OPAQUE, ObjectTables


class Hit(NamedTuple):
    """First hit of a packet.

    Attributes
    ----------
    prim : int
        Facet; −1: none.
    t : float, mm
        Its distance; inf if there is none.
    along : float
        Normal · direction.
    curved : tuple
        As from `_first_curved`, also for a round face of glass.
    """

    prim: int
    t: float
    along: float
    curved: Curved


@inlined
def first_hit(
    moving: Any, objects: ObjectTables, packet: Any, found: NDArray[np.int32], i: int
) -> tuple[Hit, float]:  # fmt: skip
    """Return the first hit of a packet after its query, and where another query must start, mm; inf: none is needed.

    Parameters
    ----------
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
        It is moved into the frame of the mover that it meets, unless it needs another query.
    found : (n,) int32
        Facets found by Embree; −1: none.
    i : int
        Number of the packet in its wave.
    """
    if moving is None:
        return _hit_on(moving, objects, packet, found[i])
    return _first_of_movers(moving, objects, packet, i)


@kernel
def _first_of_movers(moving: Any, objects: ObjectTables, packet: Any, i: int) -> tuple[Hit, float]:
    """Return the result of `first_hit` in a scene with motion."""
    here = mover_of_frame(packet.frame)
    set_rays(moving, packet)
    first, again, whose = _nothing(), np.inf, here
    for mover in range(movers(moving)):
        prim = moving.found[mover, i]
        if prim == FAR:
            continue
        take_ray(moving, packet, mover)
        hit, refused = _hit_on(moving, objects, packet, prim)
        if refused < np.inf:
            again = min(again, refused)
            hit = _first_of_all(moving, objects, packet, _nothing())
        if hit.prim >= 0 and hit.t < first.t:
            first, whose = hit, mover
    if first.prim >= 0 and first.t < again:
        again = np.inf
    take_ray(moving, packet, whose if again == np.inf else here)
    hold_frame(moving, packet)
    return first, again


@inlined
def _nothing() -> Hit:
    """Return the hit of a ray that meets nothing."""
    return Hit(-1, np.inf, 0.0, (-1, np.inf, 0.0, 0.0, 1.0))


@inlined
def _hit_on(moving: Any, objects: ObjectTables, packet: Any, prim: int) -> tuple[Hit, float]:
    """Return the first hit on the bodies of the packet's mover, from the facet that Embree has found, and as above."""
    t, along = np.inf, 0.0
    if prim >= 0:
        x, y, z, dx, dy, dz = ray_of(packet)
        facet = objects.facets[prim]
        normal = facet.normal
        along = normal[0] * dx + normal[1] * dy + normal[2] * dz
        height = normal[0] * x + normal[1] * y + normal[2] * z - facet.offset
        t = -height / along if along != 0.0 else -np.inf
        # A hit closer than the start of the query is on the facet that the packet left, or on one in its plane.
        if prim == packet.facet or t <= 0.25 * packet.query_from or t <= 0.0:
            if abs(packet.tries) < MAX_TRIES:
                return _nothing(), next_query_from(facet, packet, t if t > 0.0 else 0.0)
            prim, t, along = _first_crossing(moving, objects, packet)
    return _first_of_all(moving, objects, packet, Hit(prim, t, along, (-1, np.inf, 0.0, 0.0, 1.0))), np.inf


@inlined
def certain_hit(moving: Any, objects: ObjectTables, packet: Any) -> Hit:
    """Return the first hit of a packet among all facets, tested in float64: slow but certain.

    Parameters
    ----------
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
        After `first_hit`; it is moved into the frame of the mover that it meets.
    """
    if moving is None:
        prim, t, along = _first_crossing(moving, objects, packet)
        return _first_of_all(moving, objects, packet, Hit(prim, t, along, (-1, np.inf, 0.0, 0.0, 1.0)))
    return _certain_of_movers(moving, objects, packet)


@kernel
def _certain_of_movers(moving: Any, objects: ObjectTables, packet: Any) -> Hit:
    """Return the result of `certain_hit` in a scene with motion."""
    first, whose = _nothing(), mover_of_frame(packet.frame)
    for mover in range(movers(moving)):
        take_ray(moving, packet, mover)
        prim, t, along = _first_crossing(moving, objects, packet)
        hit = _first_of_all(moving, objects, packet, Hit(prim, t, along, (-1, np.inf, 0.0, 0.0, 1.0)))
        if hit.prim >= 0 and hit.t < first.t:
            first, whose = hit, mover
    take_ray(moving, packet, whose)
    hold_frame(moving, packet)
    return first


@inlined
def _first_of_all(moving: Any, objects: ObjectTables, packet: Any, hit: Hit) -> Hit:
    """Return the first hit of a packet: on a facet already found, or on a curved patch or round face before it.

    Parameters
    ----------
    hit : Hit
        On a facet; limits the search if it lies ahead.
    """
    prim, t, along, _ = hit
    curved = _first_curved(objects.glass, moving, objects, packet, t if t > 0.0 else np.inf)
    if curved[0] >= 0:
        prim, t, along = _as_met(curved, packet.dx, packet.dy, packet.dz)
    return _round_before(objects.rounds, moving, objects, packet, Hit(prim, t, along, curved))


@inlined
def _sense_at(state: Any, body: int) -> float:
    """Return the side from which a packet meets the patches of a body, by the bodies around it; 0 in other frames."""
    inside, rank, moving, mover = state
    if mover_of(moving, body) != mover:
        return 0.0
    return 1.0 if is_in(inside, rank[body]) else -1.0


_first_patch = patch_finder(_sense_at)


@inlined
def _first_curved(glass: Any, moving: Any, objects: ObjectTables, packet: Any, until: float) -> Curved:
    """Return the first curved patch of glass that a packet meets within a distance, even if it misses all facets.

    Parameters
    ----------
    glass : GlassTables or None
        None: there is no glass, and numba compiles only the first line.

    Returns
    -------
    prim : int
        Facet of the patch; −1: none.
    t : float, mm
    nx, ny, nz : float
        Unit normal of the patch, oriented like its facet's.
    """
    if glass is None:
        return -1, until, 0.0, 0.0, 1.0
    if packet.kind == SHADOW:
        until = min(until, packet.limit)
    state = bodies_round(packet), objects.rank, moving, mover_of_frame(packet.frame)
    return _first_patch(glass.tree, state, ray_of(packet), 0.0, until)


@inlined
def _is_met(state: Any, number: int, t: float, along: float) -> bool:
    """Tell whether a round face stops a packet: glass by the bodies around the packet, transparent targets by chance.

    `state` holds Moving or None, ObjectTables and PACKET; see `round_finder`. Faces of other movers stop nothing.
    """
    moving, objects, packet = state
    prim = objects.rounds.first + number
    body = objects.facets[prim].body
    if mover_of(moving, body) != mover_of_frame(packet.frame):
        return False
    if objects.medium[body] != OPAQUE:
        return (along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return not (is_sheer(objects, body) and passes(objects, packet, prim, t, along))


_first_round = round_finder(_is_met)


@inlined
def _round_before(rounds: Any, moving: Any, objects: ObjectTables, packet: Any, hit: Hit) -> Hit:
    """Return the result of `_first_of_all` from the first hit on a facet or curved patch.

    `rounds` is None if there are no round faces; numba then compiles only the first line.
    """
    if rounds is None:
        return hit
    until = hit.t if hit.t > 0.0 else np.inf
    if packet.kind == SHADOW and packet.light == TO_LAMP:
        # A way to an emitting facet extends to the facet itself.
        until = min(until, packet.limit)
    ray = ray_of(packet)
    state = moving, objects, packet
    number, nearest, steepness = _first_round(rounds, state, ray, packet.facet - rounds.first, until)
    if number < 0:
        return hit
    found = rounds.first + number
    if objects.medium[objects.facets[found].body] == OPAQUE:
        return Hit(found, nearest, steepness, (-1, nearest, 0.0, 0.0, 1.0))
    x, y, z = point_along(ray, nearest)
    nx, ny, nz = round_normal(rounds.faces[number], x, y, z)
    return Hit(found, nearest, steepness, (found, nearest, nx, ny, nz))


@inlined
def _as_met(curved: Curved, dx: float, dy: float, dz: float) -> tuple[int, float, float]:
    """Return the facet of a patch, the distance of the patch, and normal · direction there."""
    return curved[0], curved[1], curved[2] * dx + curved[3] * dy + curved[4] * dz


@inlined
def is_sheer(objects: ObjectTables, body: int) -> bool:
    """Tell whether light may pass straight through a target that is not glass."""
    return body >= 0 and objects.opacity[body] < 1.0


@inlined
def in_its_medium(moving: Any, objects: ObjectTables, packet: Any, hit: Hit) -> bool:
    """Tell whether a packet can meet a facet from that side, or nothing (−1), by the bodies around it.

    Parameters
    ----------
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
        In the frame of the facet's mover.
    hit : Hit
    """
    if hit.prim < 0:
        return packet.bodies < 0
    body = objects.facets[hit.prim].body
    if body >= 0 and objects.medium[body] != OPAQUE:
        return (hit.along > 0.0) == is_in(bodies_round(packet), objects.rank[body])
    return packet.bodies < 0 or not _is_outside(objects.glass, moving, objects, packet, hit.t)


@inlined
def _is_outside(glass: Any, moving: Any, objects: ObjectTables, packet: Any, t: float) -> bool:
    """Tell whether a packet in a body of glass would have left the body's box at a distance."""
    if glass is None:
        return False
    body = objects.by_rank[bodies_round(packet) & RANK]
    low, high = glass.boxes[body]
    ray = ray_between(moving, mover_of_frame(packet.frame), mover_of(moving, body), ray_of(packet))
    x, y, z = point_along(ray, t)
    return not (low[0] <= x <= high[0] and low[1] <= y <= high[1] and low[2] <= z <= high[2])


@inlined
def is_in_contact(glass: Any, prim: int) -> bool:
    """Tell whether a facet may lie on a facet of another body of glass; `glass` : GlassTables or None."""
    if glass is None:
        return False
    return len(glass.contact_first) > 0 and glass.contact_first[prim + 1] > glass.contact_first[prim]


@inlined
def might_have_met(moving: Any, objects: ObjectTables, packet: Any) -> bool:
    """Tell whether a packet outside all glass that met nothing starts far away and passes near the targets.

    Parameters
    ----------
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
        After `first_hit`.
    """
    if packet.kind == SHADOW or packet.bodies >= 0:
        return False
    if moving is None:
        return _comes_near(packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, objects.radius)
    for mover in range(movers(moving)):
        (x, y, z, radius), ray = moving.motions.bounds[mover], moving.rays[mover]
        near = _comes_near(ray[0] - x, ray[1] - y, ray[2] - z, ray[3], ray[4], ray[5], radius)
        if radius > 0.0 and near:
            return True
    return False


@inlined
def _comes_near(x: float, y: float, z: float, dx: float, dy: float, dz: float, radius: float) -> bool:
    """Tell whether a ray starts outside a sphere about the origin and passes through it."""
    toward = -(x * dx + y * dy + z * dz)
    distance2, radius2 = x * x + y * y + z * z, radius * radius
    return toward > 0.0 and distance2 > radius2 and distance2 - toward * toward <= radius2


@kernel
def _first_crossing(moving: Any, objects: ObjectTables, packet: Any) -> tuple[int, float, float]:
    """Return the first facet that a packet can meet, its distance, and normal · direction; −1: none.

    All facets of its mover are tested in float64. The facet just left faces the wrong way for the packet's medium, so
    no distance from the start is needed; the start on a curved patch may even lie slightly beyond the next facet.
    """
    x, y, z, dx, dy, dz = ray_of(packet)
    first, nearest, steepness = -1, np.inf, 0.0
    # `limit` is the distance of the light for a shadow packet, the way past the lens for a packet from the lens.
    back = 0.0 if packet.kind == SHADOW or packet.last == LEFT_LENS else packet.limit
    mover = mover_of_frame(packet.frame)
    for prim in range(len(objects.facets)):
        if mover_of(moving, objects.facets[prim].body) != mover:
            continue
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        if t < nearest and t > -back and prim != packet.facet:
            body = objects.facets[prim].body
            glass = body >= 0 and objects.medium[body] != OPAQUE
            met = Hit(prim, t, along, (-1, np.inf, 0.0, 0.0, 1.0))
            if (glass or t > 0.0) and in_its_medium(moving, objects, packet, met):
                if is_sheer(objects, body) and passes(objects, packet, prim, t, along):
                    continue
                first, nearest, steepness = prim, t, along
    return first, nearest, steepness


@inlined
def comes_out_ahead(moving: Any, objects: ObjectTables, packet: Any) -> bool:
    """Tell whether a packet in no body would leave a body ahead, and so must have entered it unnoticed.

    Otherwise nothing lies ahead: the ray passes the edge of the facet that Embree found.

    Parameters
    ----------
    moving : Moving or None
    objects : ObjectTables
    packet : PACKET
        After `first_hit`.
    """
    if moving is None:
        return _comes_out(moving, objects, packet)
    here, ahead = mover_of_frame(packet.frame), False
    for mover in range(movers(moving)):
        take_ray(moving, packet, mover)
        ahead = ahead or _comes_out(moving, objects, packet)
    take_ray(moving, packet, here)
    return ahead


@kernel
def _comes_out(moving: Any, objects: ObjectTables, packet: Any) -> bool:
    """Tell whether a packet would leave a body of its mover ahead."""
    x, y, z, dx, dy, dz = ray_of(packet)
    mover = mover_of_frame(packet.frame)
    for prim in range(len(objects.facets)):
        t, along = crosses(objects.facets[prim], x, y, z, dx, dy, dz)
        body = objects.facets[prim].body
        if mover_of(moving, body) != mover:
            continue
        if along > 0.0 and packet.limit < t < np.inf and body >= 0 and objects.medium[body] != OPAQUE:
            return True
    return False
