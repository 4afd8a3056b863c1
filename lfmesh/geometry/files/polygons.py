"""Division of polygons in mesh files into triangles with the same area.

A convex polygon becomes a fan. Others are cut by ears (mapbox_earcut), so that notches stay open. Ears at straight
corners have no area; their long edges are flipped. A hole connected to the outline by a cut, as programs write rings,
stays a hole.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Index

STRAIGHT = 2.0**-40
"""Sine of the angle at a corner below which rounding of the coordinates decides the direction of its turn."""

MOST_CORNERS = 20_000
"""Most corners of a non-convex polygon: the time for cutting may grow as their square."""


class Cut(NamedTuple):
    """Triangles of some polygons.

    Attributes
    ----------
    corners : (m, 3) int64
        Position of each triangle's corners among the corners of all polygons.
    polygon : (m,) int64
        Polygon of each triangle, ascending.
    short : int
        Number of triangles missing because polygons touch or cross themselves.
    """

    corners: Index
    polygon: Index
    short: int = 0

    @property
    def in_words(self) -> str:
        """Message about the missing triangles, with `{}` in place of their number."""
        return "its polygons give {} triangles fewer than their corners require: some touch or cross themselves"


def cut(points: Array, corners: Index, counts: Index) -> Cut:
    """Cut polygons into triangles.

    Parameters
    ----------
    points : (n, 3) float64
    corners : (k,) int64
        Point at each corner, polygon after polygon.
    counts : (p,) int64
        Corners of each polygon; polygons with fewer than three have no triangles.

    Raises
    ------
    ValueError
        A non-convex polygon has more than `MOST_CORNERS` corners.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else np.zeros(0, np.int64)
    found: list[Index] = []
    owners: list[Index] = []
    lengths = np.flatnonzero(np.bincount(counts)) if len(counts) else counts
    for count in lengths[lengths >= 3].tolist():
        those = np.flatnonzero(counts == count)
        places = starts[those][:, None] + np.arange(count)
        if count == 3:
            found.append(places)
            owners.append(those)
            continue
        fan = _convex(points[corners[places]])
        triangles = [[0, k, k + 1] for k in range(1, count - 1)]
        found.append(places[fan][:, triangles].reshape(-1, 3))
        owners.append(np.repeat(those[fan], count - 2))
        for polygon, own in zip(those[~fan].tolist(), places[~fan], strict=True):
            cut_off = own[_ears(points[corners[own]])]
            found.append(cut_off)
            owners.append(np.full(len(cut_off), polygon))
    if not found:
        return Cut(np.zeros((0, 3), np.int64), np.zeros(0, np.int64))
    short = int((counts[counts >= 3] - 2).sum()) - sum(map(len, found))
    if len(found) == 1:
        return Cut(found[0], owners[0])
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return Cut(np.concatenate(found)[order], owner[order], short)


def _newell(polygons: Array) -> Array:
    """Return twice the vector area of polygons (g, k, 3) by Newell's method."""
    relative = polygons - polygons[:, :1]
    return np.asarray(np.cross(relative[:, 1:-1], relative[:, 2:]).sum(axis=1))


def _convex(polygons: Array) -> NDArray[np.bool_]:
    """Tell which polygons (g, k, 3) have corners that all turn one way, so that a fan covers each once.

    Polygons with a corner that is straight to rounding, or with non-finite coordinates, count as non-convex.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        normal = _newell(polygons)
        edge = np.roll(polygons, -1, axis=1) - polygons
        relative = polygons[:, 1:] - polygons[:, :1]
        turns = _sines(np.roll(edge, 1, axis=1), edge, normal)
        fan = _sines(relative[:, :-1], relative[:, 1:], normal)
        return np.asarray((turns > STRAIGHT).all(axis=1) & (fan > STRAIGHT).all(axis=1))


def _sines(one: Array, other: Array, normal: Array) -> Array:
    """Return the sines of the angles between edges (g, k, 3), as seen along normals (g, 3); NaN for zero lengths."""
    lengths = np.linalg.norm(one, axis=2) * np.linalg.norm(other, axis=2) * np.linalg.norm(normal, axis=1)[:, None]
    return np.asarray(np.einsum("gki,gi->gk", np.cross(one, other), normal) / lengths)


def _ears(polygon: Array) -> NDArray[np.int64]:
    """Return the triangles (m, 3) of a polygon (k, 3), in its own sense."""
    import mapbox_earcut

    count = len(polygon)
    fan = np.array([[0, k, k + 1] for k in range(1, count - 1)])
    if not np.isfinite(polygon).all():
        return fan
    if count > MOST_CORNERS:
        raise ValueError(f"a polygon that is not convex has {count:,} corners; the limit is {MOST_CORNERS:,}")
    with np.errstate(over="ignore", invalid="ignore"):
        normal = _newell(polygon[None])[0]
    if not (np.isfinite(normal).all() and normal.any()):
        return fan
    # Project along the axis nearest to the normal, which shows the whole polygon and keeps its coordinates exact.
    axis = int(np.abs(normal).argmax())
    flat = np.ascontiguousarray(polygon[:, [(axis + 1) % 3, (axis + 2) % 3]])
    ears = mapbox_earcut.triangulate_float64(flat, np.array([count], np.uint32)).astype(np.int64).reshape(-1, 3)
    ears = _without_slivers(polygon, ears)
    (ux, uy), (vx, vy) = (flat[ears[:, k]].T - flat[ears[:, 0]].T for k in (1, 2))
    area = ux * vy - uy * vx
    against = area * normal[axis] < 0.0
    ears[against] = ears[against][:, ::-1]
    return np.asarray(ears)


def _without_slivers(polygon: Array, triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return triangles (m, 3) that cover the same area without straight corners, if possible.

    A triangle with a straight corner b lies on its edge from a to c. With the triangle a, c, d on the other side of
    that edge it becomes a, b, d and b, c, d.
    """
    straight = _middle_sines(polygon[triangles]) <= STRAIGHT
    if not straight.any():
        return triangles
    made = [tuple(map(int, triangle)) for triangle in triangles]
    owner = {edge: number for number, triangle in enumerate(made) for edge in _edges(triangle)}
    waiting = np.flatnonzero(straight).tolist()
    while waiting:
        number = waiting.pop()
        edges = _edges(made[number])
        lengths = [float(np.linalg.norm(polygon[p] - polygon[q])) for p, q in edges]
        c, a = edges[int(np.argmax(lengths))]
        other = owner.get((a, c))
        if not straight[number] or other is None or straight[other]:
            continue
        (b,), (d,) = set(made[number]) - {a, c}, set(made[other]) - {a, c}
        for place, triangle in ((number, (a, b, d)), (other, (b, c, d))):
            made[place] = triangle
            owner |= dict.fromkeys(_edges(triangle), place)
            straight[place] = _middle_sines(polygon[[triangle]])[0] <= STRAIGHT
        # Resume triangles that waited for the neighbour across their long edge.
        beside = (owner.get((q, p)) for p, q in ((a, b), (b, c), (c, d), (d, a)))
        waiting += [each for each in beside if each is not None and straight[each]]
    return np.array(made)


def _edges(triangle: tuple[int, ...]) -> list[tuple[int, int]]:
    return [(triangle[k], triangle[(k + 1) % 3]) for k in range(3)]


def _middle_sines(triangles: Array) -> Array:
    """Return the sines of the angles opposite the longest edges of triangles (m, 3, 3); 1 if points coincide."""
    edge = np.roll(triangles, -1, axis=1) - triangles
    length = np.sort(np.linalg.norm(edge, axis=2), axis=1)
    twice_area = np.linalg.norm(np.cross(edge[:, 0], edge[:, 1]), axis=1)
    product = length[:, 0] * length[:, 1]
    return np.divide(twice_area, product, out=np.ones_like(product), where=product > 0.0)
