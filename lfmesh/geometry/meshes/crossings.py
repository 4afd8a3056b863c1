"""Crossings of meshes: intersection segments of facets, and the parts of a surface inside and outside closed shells.

Two facets that are not coplanar meet in a segment (T. Möller, "A fast triangle-triangle intersection test", Journal of
Graphics Tools 2(2) (1997) 25-30). A corner in the plane of the other facet counts as in front of it, for all facets
around the corner alike, so that no crossing slips through an edge or a corner. Segments divide facets into parts, and
each part is bordered by a piece of a segment. All parts are therefore sampled by points beside all pieces, and one
point in each facet without a segment.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.meshes.shell_tree import ShellTree, next_crossing, tree_of
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel

Index = NDArray[np.int64]

AT_ONCE = 1 << 16
"""Pairs of facets with boxes compared at a time; larger sets are halved."""

BESIDE = 4.0
"""Distance of sample points from their segment, in units of the distance within which surfaces touch."""

BEHIND = 3.0
"""Distance by which a surface is set back, in units of the distance within which surfaces touch."""

ROUNDINGS = 32.0
"""Roundings of the coordinates within which two facets are coplanar: the intersection of their planes is noise."""

AWAY = np.array([3.0, 5.0, 7.0]) / np.sqrt(83.0)
"""Direction of the test lines for points in a shell: parallel to no face of an upright box."""


class Segments(NamedTuple):
    """Intersection segments of the facets of two meshes."""

    own: Index  # (n,) number of the facet of the first mesh
    other: Index  # (n,) number of the facet of the second
    ends: Array  # (n, 2, 3) mm


def near_pairs(one: Array, other: Array) -> Index:
    """Return the pairs (k, 2) of facets of two meshes with overlapping boxes.

    Parameters
    ----------
    one, other : (n, 3, 3) and (m, 3, 3) float64, mm
        Corners of the facets.
    """
    lows, highs = [each.min(axis=1) for each in (one, other)], [each.max(axis=1) for each in (one, other)]
    found = [np.zeros((0, 2), np.int64)]
    waiting = [(np.arange(len(one)), np.arange(len(other)))]
    while waiting:
        pair = waiting.pop()
        if not all(map(len, pair)):
            continue
        low = np.max([lows[k][pair[k]].min(axis=0) for k in (0, 1)], axis=0)
        high = np.min([highs[k][pair[k]].max(axis=0) for k in (0, 1)], axis=0)
        a, b = (some[((lows[k][some] <= high) & (highs[k][some] >= low)).all(axis=1)] for k, some in enumerate(pair))
        if len(a) * len(b) <= AT_ONCE:
            meet = (lows[0][a][:, None] <= highs[1][b]) & (highs[0][a][:, None] >= lows[1][b])
            first, second = np.nonzero(meet.all(axis=2))
            found.append(np.column_stack([a[first], b[second]]))
        elif len(a) >= len(b):
            waiting += [(half, b) for half in _halves(lows[0] + highs[0], a)]
        else:
            waiting += [(a, half) for half in _halves(lows[1] + highs[1], b)]
    return np.concatenate(found)


def _halves(middles: Array, some: Index) -> Iterator[Index]:
    """Yield two halves of some facets, divided across the longest extent of their middles."""
    own = middles[some]
    order = np.argsort(own[:, int(np.ptp(own, axis=0).argmax())], kind="stable")
    yield some[order[: len(some) // 2]]
    yield some[order[len(some) // 2 :]]


def _normals(corners: Array) -> Array:
    """Return the unit normals (n, 3) of facets; zero for a facet without area."""
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    return np.divide(cross, length, out=np.zeros_like(cross), where=length > 0.0)


def segments(one: Array, other: Array) -> Segments:
    """Return the intersection segments of the facets of two meshes; coplanar facets have none.

    Parameters
    ----------
    one, other : (n, 3, 3) and (m, 3, 3) float64, mm
        Corners of the facets.
    """
    pairs = near_pairs(one, other)
    a, b = one[pairs[:, 0]], other[pairs[:, 1]]
    normals = _normals(a), _normals(b)
    heights = [np.einsum("nij,nj->ni", p - q[:, :1], n) for p, q, n in ((a, b, normals[1]), (b, a, normals[0]))]
    way = np.cross(*normals)
    size = np.maximum(np.abs(a).max(axis=(1, 2), initial=0.0), np.abs(b).max(axis=(1, 2), initial=0.0))
    tilt = np.maximum(*(np.abs(height).max(axis=1, initial=0.0) for height in heights))
    crossed = (way != 0.0).any(axis=1) & (tilt > ROUNDINGS * np.finfo(np.float64).eps * size)
    for height in heights:
        crossed &= (height >= 0.0).any(axis=1) & (height < 0.0).any(axis=1)
    kept = np.flatnonzero(crossed)
    way = way[kept] / np.linalg.norm(way[kept], axis=1, keepdims=True)
    origin = a[kept, 0]
    low, high = np.full(len(kept), -np.inf), np.full(len(kept), np.inf)
    for corners, height in ((a[kept], heights[0][kept]), (b[kept], heights[1][kept])):
        along = np.einsum("nij,nj->ni", _in_plane(corners, height) - origin[:, None], way)
        low, high = np.maximum(low, along.min(axis=1)), np.minimum(high, along.max(axis=1))
        base = _in_plane(corners, height)[:, 0]
    base = base - np.einsum("ni,ni->n", base - origin, way)[:, None] * way
    ends = np.stack([base + low[:, None] * way, base + high[:, None] * way], axis=1)
    meet = low < high
    return Segments(pairs[kept[meet], 0], pairs[kept[meet], 1], ends[meet])


def _in_plane(corners: Array, height: Array) -> Array:
    """Return the two intersections (n, 2, 3) of a facet's edges with a plane, from the heights of its corners."""
    above = height >= 0.0
    alone = np.argmax(above == (above.sum(axis=1) == 1)[:, None], axis=1)
    rows = np.arange(len(corners))
    points = []
    for step in (1, 2):
        next_to = (alone + step) % 3
        share = height[rows, alone] / (height[rows, alone] - height[rows, next_to])
        p, q = corners[rows, alone], corners[rows, next_to]
        points.append(p + share[:, None] * (q - p))
    return np.stack(points, axis=1)


def set_back(corners: Array, near_mm: float) -> Array:
    """Move facets (n, 3, 3) behind themselves, clear of surfaces within `near_mm`; in front if it is negative."""
    return np.asarray(corners - BEHIND * near_mm * _normals(corners)[:, None])


def parts_in_shells(own: Array, shells: Sequence[Array], near_mm: float) -> tuple[NDArray[np.bool_], Array]:
    """Return the combinations of closed shells that contain parts of a surface, and a point for each combination.

    Parts that lie on a shell, or reach less than `near_mm` into it, are left out.

    Parameters
    ----------
    own : (n, 3, 3) float64, mm
        Corners of the facets of the surface.
    shells : sequence of (m, 3, 3) float64, mm
        Outward-facing, closed; each may consist of several surfaces.
    near_mm : float
        Distance within which surfaces touch.

    Returns
    -------
    inside : (k, shells) bool
        The distinct combinations.
    places : (k, 3) float64, mm
    """
    found = [segments(own, shell) for shell in shells]
    facet = np.concatenate([np.zeros(0, np.int64), *(each.own for each in found)])
    owner = np.repeat(np.arange(len(shells)), [len(each.own) for each in found])
    ends = np.concatenate([np.zeros((0, 2, 3)), *(each.ends for each in found)])
    normals = _normals(own)
    facets, places = _beside(own, normals, *_pieces(facet, owner, ends, normals), BESIDE * near_mm)
    whole = np.setdiff1d(np.arange(len(own)), facet)
    facets = np.concatenate([facets, whole])
    places = np.concatenate([places, own[whole].mean(axis=1)])
    solids = [Solid(shell) for shell in shells]
    inside = _membership(solids, places)
    distinct, of_place = np.unique(inside, axis=0, return_inverse=True)
    off = near_mm * normals[facets]
    deep = [
        _deep_place(solids, row, places, off, np.flatnonzero(of_place.reshape(-1) == k))
        for k, row in enumerate(distinct)
    ]
    kept = [k for k, place in enumerate(deep) if place is not None]
    return distinct[kept], places[[place for place in deep if place is not None]]


def _membership(solids: Sequence["Solid"], places: Array) -> NDArray[np.bool_]:
    """Tell which solids contain each point, (n, solids)."""
    return np.stack([solid.holds(places) for solid in solids], axis=1)


def _deep_place(
    solids: Sequence["Solid"], row: NDArray[np.bool_], places: Array, off: Array, some: Index
) -> int | None:  # fmt: skip
    """Return one of some places that is in the same solids on both sides of its facet; None if there is none.

    Parameters
    ----------
    solids : sequence of Solid
    row : (solids,) bool
        Solids that contain the places.
    places, off : (n, 3) float64, mm
        Points of the surface, and offsets to either side.
    some : (m,) int64
        Numbers of the places.
    """
    count = 1
    while len(some):
        tried, some, count = some[:count], some[count:], 16 * count
        sides = [(_membership(solids, places[tried] + sign * off[tried]) == row).all(axis=1) for sign in (1.0, -1.0)]
        deep = np.flatnonzero(sides[0] & sides[1])
        if len(deep):
            return int(tried[deep[0]])
    return None


def _pieces(facet: Index, owner: Index, ends: Array, normals: Array) -> tuple[Index, Array]:
    """Cut segments where segments of other shells cross them; return the facets and the ends (n, 2, 3)."""
    numbers, cut = [np.zeros(0, np.int64)], [np.zeros((0, 2, 3))]
    order = np.argsort(facet, kind="stable")
    for some in np.split(order, np.flatnonzero(np.diff(facet[order])) + 1):
        if len(np.unique(owner[some])) < 2:
            numbers.append(facet[some])
            cut.append(ends[some])
            continue
        for k in some:
            its = some[owner[some] != owner[k]]
            begin, way = ends[k, 0], ends[k, 1] - ends[k, 0]
            across = np.cross(normals[facet[k]], way)
            sides = (ends[its] - begin) @ across
            its = its[(sides[:, 0] >= 0.0) != (sides[:, 1] >= 0.0)]
            sides = (ends[its] - begin) @ across
            share = sides[:, :1] / (sides[:, :1] - sides[:, 1:])
            met = ends[its, 0] + share * (ends[its, 1] - ends[its, 0])
            at = (met - begin) @ way / (way @ way)
            at = np.sort(np.concatenate([[0.0, 1.0], at[(at > 0.0) & (at < 1.0)]]))
            places = begin + at[:, None] * way
            numbers.append(np.full(len(at) - 1, facet[k]))
            cut.append(np.stack([places[:-1], places[1:]], axis=1))
    return np.concatenate(numbers), np.concatenate(cut)


def _beside(own: Array, normals: Array, facet: Index, ends: Array, distance: float) -> tuple[Index, Array]:
    """Return points (n, 3) on both sides of segments, if inside the segment's facet, and their facets."""
    way = ends[:, 1] - ends[:, 0]
    across = np.cross(normals[facet], way)
    length = np.linalg.norm(across, axis=1)
    # A segment may end where another one crosses it; the piece between has no length.
    facet, ends, across = facet[length > 0.0], ends[length > 0.0], across[length > 0.0] / length[length > 0.0, None]
    middle = 0.5 * (ends[:, 0] + ends[:, 1])
    places = np.concatenate([middle + distance * across, middle - distance * across])
    facets = np.concatenate([facet, facet])
    within = np.ones(len(facets), np.bool_)
    for k in range(3):
        begin, end = own[facets, k], own[facets, (k + 1) % 3]
        within &= np.einsum("ni,ni->n", np.cross(normals[facets], end - begin), places - begin) >= 0.0
    return facets[within], places[within]


class Solid:
    """A closed shell, for point-in-body tests.

    Parameters
    ----------
    shell : (m, 3, 3) float64, mm
        Outward-facing.
    """

    def __init__(self, shell: Array) -> None:
        self._box = shell.min(axis=(0, 1)), shell.max(axis=(0, 1))
        self._shell = shell

    @cached_property
    def _tree(self) -> tuple[ShellTree, int]:
        tree, ends = tree_of([self._shell])
        return tree, ends[0][1]

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points, (n, 3) mm, are inside, (n,)."""
        found = np.zeros(len(points), np.bool_)
        near = np.flatnonzero(((points >= self._box[0]) & (points <= self._box[1])).all(axis=1))
        if len(near):
            within = np.zeros(len(near), np.bool_)
            _mark_inside(*self._tree, points[near], within)
            found[near] = within
        return found


@kernel
def _mark_inside(tree: ShellTree, end: int, points: Array, found: NDArray[np.bool_]) -> None:
    """Write which points are in the shell of a tree."""
    for i in range(len(points)):
        ray = Ray(points[i, 0], points[i, 1], points[i, 2], AWAY[0], AWAY[1], AWAY[2])
        found[i], _ = next_crossing(tree, 0, end, 0.0, ray)
