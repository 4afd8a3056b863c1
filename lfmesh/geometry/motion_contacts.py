"""Proof that two moving surfaces do not touch, by conservative advancement.

If two convex bodies are a distance d apart at a time, and no two of their points approach along the direction of that
distance faster than v, they stay apart for d / v (B. Mirtich, Impulse-based dynamic simulation of rigid body systems,
1996). Here the claim is made for pairs of nodes of two trees of facets and for intervals of time. A pair that is not
proven apart is divided: in space if the nodes are larger than their motion, else in time.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.meshes.box_tree import box_tree
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.rigid_motion import fill_pose, fill_relative, segment_at, sweep
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel

LARGEST_LEAF = 1
"""Facets per leaf: the direction of a distance is that of two facets."""

MOST_STEPS = 1 << 23
"""Pairs of nodes and intervals after which a proof is given up: some ten seconds."""

DEEPEST = 512
"""Entries of the list of open pairs; each division adds one, and none is divided more often than 64 times per kind."""

Numbers = NDArray[np.int64]
Vector = tuple[float, float, float]


@by_address
class MovingSurface(NamedTuple):
    """Facets of a moving body in a full binary tree of spheres; node n has the children 2 n and 2 n + 1."""

    middle: Array  # (2 · leaves, 3) mm, centre of each node's sphere
    reach: Array  # (2 · leaves,) mm, its radius
    corners: Array  # (leaves, 3, 3) mm, of the facets, leaf by leaf; some twice, to fill the leaves
    leaves: int  # a power of two
    motion: NDArray[np.void]  # (n,) SEGMENT


@by_address
class _Work(NamedTuple):
    """Working memory of one proof."""

    nodes: Numbers  # (DEEPEST, 2) open pairs of nodes
    spans: Array  # (DEEPEST, 2) s, their intervals
    poses: Array  # (3, 3, 4) of both bodies, and of the second relative to the first
    facets: Array  # (2, 3, 3) mm


def moving_surface(corners: Array, motion: NDArray[np.void]) -> MovingSurface:
    """Return a moving surface.

    Parameters
    ----------
    corners : (m, 3, 3) float64, mm
        Corners of the facets at t = 0; points and segments are facets with equal corners.
    motion : (n,) SEGMENT
        The identity at t = 0.
    """
    tree = box_tree(corners.min(axis=1), corners.max(axis=1), corners.mean(axis=1), LARGEST_LEAF, 0.0)
    middle = 0.5 * (tree.low + tree.high)
    reach = 0.5 * np.linalg.norm(tree.high - tree.low, axis=1)
    return MovingSurface(middle, reach, np.ascontiguousarray(corners[tree.order]), tree.leaves, motion)


def swept_box(corners: Array, motion: NDArray[np.void], begin_s: float, end_s: float) -> Array:
    """Return the lowest and the highest corner of a box that holds a moving body throughout, (2, 3) mm.

    Parameters
    ----------
    corners : (..., 3) float64, mm
        Points of the body at t = 0.
    motion : (n,) SEGMENT
    begin_s, end_s : float
    """
    points = corners.reshape(-1, 3)
    box = corners_between(points.min(axis=0), points.max(axis=0))
    places, margin = sweep(motion, box, begin_s, end_s)
    return np.array([places.min(axis=(0, 1)) - margin, places.max(axis=(0, 1)) + margin])


def first_contact(one: MovingSurface, other: MovingSurface, begin_s: float, end_s: float, near_mm: float) -> float:
    """Return a time at which two surfaces come within a distance; inf if they are proven to stay farther apart.

    Surfaces that come within twice the distance may count as near. The time is that of the first contact, to the time
    in which they move by the distance.

    Parameters
    ----------
    one, other : MovingSurface
    begin_s, end_s : float
    near_mm : float
        Above 0.

    Returns
    -------
    float, s
        nan if there are too many close facets for a proof.
    """
    work = _Work(np.zeros((DEEPEST, 2), np.int64), np.zeros((DEEPEST, 2)), np.zeros((3, 3, 4)), np.zeros((2, 3, 3)))
    changes = np.concatenate([one.motion["begin_s"][1:], other.motion["begin_s"][1:]])
    ends = [begin_s, *np.unique(changes[(changes > begin_s) & (changes < end_s)]).tolist(), end_s]
    for first, last in pairwise(ends):
        segments = segment_at(one.motion, first), segment_at(other.motion, first)
        found = float(_first_contact(one, other, *segments, (first, last), near_mm, work))
        if found < np.inf or np.isnan(found):
            return found
    return np.inf


@kernel
def _first_contact(
    one: MovingSurface, other: MovingSurface, segment_one: int, segment_other: int,
    window: tuple[float, float], near: float, work: _Work,
) -> float:  # fmt: skip
    """Return the time of the first contact while both bodies follow one segment of their motions."""
    first, second, second_seen = work.poses
    row_one, row_other = one.motion[segment_one], other.motion[segment_other]
    nodes, spans = work.nodes, work.spans
    nodes[0, 0], nodes[0, 1], spans[0, 0], spans[0, 1] = 1, 1, window[0], window[1]
    count, found, steps, known = 1, np.inf, 0, np.nan
    while count > 0:
        steps += 1
        if steps > MOST_STEPS:
            return np.nan
        count -= 1
        a, b, begin, end = nodes[count, 0], nodes[count, 1], spans[count, 0], spans[count, 1]
        if begin >= found:
            continue
        middle = 0.5 * (begin + end)
        if middle != known:
            fill_pose(one.motion, segment_one, segment_one + 1, middle, first)
            fill_pose(other.motion, segment_other, segment_other + 1, middle, second)
            fill_relative(first, second, second_seen)
            known = middle
        # A leaf is represented by its facet, another node by its sphere.
        reach_one = 0.0 if a >= one.leaves else one.reach[a]
        reach_other = 0.0 if b >= other.leaves else other.reach[b]
        apart, direction = _apart(one, a, other, b, work)
        apart -= reach_one + reach_other
        # Along the direction that separates the nodes, and in all.
        one_turns, other_turns = _turning_speed(row_one, one, a), _turning_speed(row_other, other, b)
        turning = one_turns * _sine(direction, row_one.axis) + other_turns * _sine(direction, row_other.axis)
        slide, whole = 0.0, 0.0
        for i in range(3):
            slide += direction[i] * (row_one.velocity[i] - row_other.velocity[i])
            whole += (row_one.velocity[i] - row_other.velocity[i]) ** 2
        moved = 0.5 * (end - begin) * (abs(slide) + turning)
        path = 0.5 * (end - begin) * (np.sqrt(whole) + one_turns + other_turns)
        if apart - moved > near:
            continue
        if max(reach_one, reach_other) > 0.0 and max(reach_one, reach_other) >= moved:
            for child in range(2):
                splits_one = reach_one >= reach_other
                nodes[count, 0] = 2 * a + child if splits_one else a
                nodes[count, 1] = b if splits_one else 2 * b + child
                spans[count, 0], spans[count, 1] = begin, end
                count += 1
            continue
        touches = reach_one + reach_other == 0.0 and (apart <= near or moved <= near)
        if touches:
            found = min(found, begin if path <= near else middle)
            if path <= near:
                continue
        if not touches:
            nodes[count, 0], nodes[count, 1], spans[count, 0], spans[count, 1] = a, b, middle, end
            count += 1
        # Earlier times come first.
        nodes[count, 0], nodes[count, 1], spans[count, 0], spans[count, 1] = a, b, begin, middle
        count += 1
    return found


@kernel
def _turning_speed(row: Any, surface: MovingSurface, node: int) -> float:
    """Return a bound on the speed of the points of a node by the turn about the body's moving centre, mm/s."""
    if row.rate == 0.0:
        return 0.0
    m, start = surface.middle[node], row.start
    x = start[0, 0] * m[0] + start[0, 1] * m[1] + start[0, 2] * m[2] + start[0, 3] - row.centre[0]
    y = start[1, 0] * m[0] + start[1, 1] * m[1] + start[1, 2] * m[2] + start[1, 3] - row.centre[1]
    z = start[2, 0] * m[0] + start[2, 1] * m[1] + start[2, 2] * m[2] + start[2, 3] - row.centre[2]
    # Its component along n is n · (a × r) = r · (n × a), which the sine of the angle between n and a bounds.
    return row.rate * (_sine((x, y, z), row.axis) + surface.reach[node])


@inlined
def _sine(p: Vector, axis: Any) -> float:
    """Return the length of a vector's part across a unit axis."""
    x, y, z = p[1] * axis[2] - p[2] * axis[1], p[2] * axis[0] - p[0] * axis[2], p[0] * axis[1] - p[1] * axis[0]
    return np.sqrt(x * x + y * y + z * z)


@kernel
def _apart(one: MovingSurface, a: int, other: MovingSurface, b: int, work: _Work) -> tuple[float, Vector]:
    """Return the distance of two nodes, of the facets of leaves and the centres of others, mm, and its unit direction.

    The direction is one of the world, and zero if they cut each other.
    """
    first, _, second_seen = work.poses
    own, its = work.facets
    for k in range(3):
        for axis in range(3):
            own[k, axis] = one.corners[a - one.leaves, k, axis] if a >= one.leaves else one.middle[a, axis]
        if b >= other.leaves:
            _seen(second_seen, other.corners[b - other.leaves, k], its[k])
        else:
            _seen(second_seen, other.middle[b], its[k])
    if a < one.leaves and b < other.leaves:
        x, y, z = own[0, 0] - its[0, 0], own[0, 1] - its[0, 1], own[0, 2] - its[0, 2]
    else:
        x, y, z = _between(own, its)
    length = np.sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return 0.0, (0.0, 0.0, 0.0)
    x, y, z = x / length, y / length, z / length
    return length, (
        first[0, 0] * x + first[0, 1] * y + first[0, 2] * z,
        first[1, 0] * x + first[1, 1] * y + first[1, 2] * z,
        first[2, 0] * x + first[2, 1] * y + first[2, 2] * z,
    )


@inlined
def _seen(pose: Array, point: Array, into: Array) -> None:
    for i in range(3):
        into[i] = pose[i, 0] * point[0] + pose[i, 1] * point[1] + pose[i, 2] * point[2] + pose[i, 3]


@kernel
def facets_apart(one: Array, other: Array) -> float:
    """Return the distance of two triangles, mm; 0 if they cut each other.

    Parameters
    ----------
    one, other : (3, 3) float64, mm
        Corners; equal ones make a segment or a point.
    """
    x, y, z = _between(one, other)
    return np.sqrt(x * x + y * y + z * z)


@kernel
def _between(one: Array, other: Array) -> Vector:
    """Return the shortest vector between two triangles, of either sense; zero if they cut each other.

    The closest points of two triangles that do not cut lie on two edges, or at a corner and in a face.
    """
    least = _shorter(_from_face(one, other), _from_face(other, one))
    for i in range(3):
        for j in range(3):
            least = _shorter(least, _edges_apart(one[i], one[(i + 1) % 3], other[j], other[(j + 1) % 3]))
    return least


@inlined
def _shorter(p: Vector, q: Vector) -> Vector:
    """Return the shorter of two vectors."""
    return q if q[0] * q[0] + q[1] * q[1] + q[2] * q[2] < p[0] * p[0] + p[1] * p[1] + p[2] * p[2] else p


@kernel
def _from_face(face: Array, other: Array) -> Vector:
    """Return the shortest vector from corners to the face that they lie over; zero if an edge passes through."""
    a, b, c = face[0], face[1], face[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    normal = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2
    least = np.inf
    if square == 0.0:
        return least, least, least
    for k in range(3):
        p, q = other[k], other[(k + 1) % 3]
        here, there = _height(a, normal, p), _height(a, normal, q)
        if _lies_over(face, normal, p[0], p[1], p[2]):
            least = min(least, abs(here) / square)
        if (here < 0.0 < there) or (there < 0.0 < here):
            share = here / (here - there)
            x, y, z = p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1]), p[2] + share * (q[2] - p[2])
            if _lies_over(face, normal, x, y, z):
                return 0.0, 0.0, 0.0
    if least == np.inf:
        return least, least, least
    return least * normal[0], least * normal[1], least * normal[2]


@inlined
def _height(a: Array, normal: Vector, p: Array) -> float:
    """Return the height of a point over the plane of a face, times the length of the normal."""
    return normal[0] * (p[0] - a[0]) + normal[1] * (p[1] - a[1]) + normal[2] * (p[2] - a[2])


@kernel
def _lies_over(face: Array, normal: Vector, x: float, y: float, z: float) -> bool:
    """Tell whether the foot of the perpendicular from a point to the plane of a face lies in the face."""
    for k in range(3):
        p, q = face[k], face[(k + 1) % 3]
        ex, ey, ez = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        dx, dy, dz = x - p[0], y - p[1], z - p[2]
        inward = normal[0] * (ey * dz - ez * dy) + normal[1] * (ez * dx - ex * dz) + normal[2] * (ex * dy - ey * dx)
        if inward < 0.0:
            return False
    return True


@kernel
def _edges_apart(p: Array, q: Array, r: Array, s: Array) -> Vector:
    """Return the shortest vector from segment rs to pq (C. Ericson, Real-time collision detection, 2005, 5.1.9)."""
    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    ex, ey, ez = s[0] - r[0], s[1] - r[1], s[2] - r[2]
    fx, fy, fz = p[0] - r[0], p[1] - r[1], p[2] - r[2]
    a, e = dx * dx + dy * dy + dz * dz, ex * ex + ey * ey + ez * ez
    f, c, b = ex * fx + ey * fy + ez * fz, dx * fx + dy * fy + dz * fz, dx * ex + dy * ey + dz * ez
    scale = a * e - b * b
    u = min(max((b * f - c * e) / scale, 0.0), 1.0) if scale > 0.0 else 0.0
    v = (b * u + f) / e if e > 0.0 else 0.0
    if e == 0.0 or v < 0.0 or v > 1.0:
        v = min(max(v, 0.0), 1.0)
        u = min(max((b * v - c) / a, 0.0), 1.0) if a > 0.0 else 0.0
    return fx + u * dx - v * ex, fy + u * dy - v * ey, fz + u * dz - v * ez
