"""Contacts between bodies of glass: pairs of facets of different bodies that may lie on each other.

A ray through such a pair passes directly from one body into the other, without air between.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Mesh, boxes_meet, facet_normals

Index = NDArray[np.int64]

CUT = 1e-5
"""Largest overlap or gap of surfaces in contact, relative to the smaller body's size: the error of float32 files and of
coincident faces. Bodies that cut deeper overlap."""

LEAST_COSINE = 0.9
"""Least cosine between the normals of facets in contact; on curved surfaces they differ slightly."""

MOST_AT_ONCE = 1 << 22
"""Pairs of facets compared at a time, to bound the memory."""


def contacts(meshes: list[Mesh], is_glass: NDArray[np.bool_], facets: int) -> tuple[Index, Index, float]:
    """Return the possible contact partners of each facet, and the distance that counts as contact.

    Parameters
    ----------
    meshes : list of Mesh
        Meshes of all targets; facets are numbered consecutively, mesh by mesh.
    is_glass : (targets,) bool
    facets : int
        Number of facets in object space.

    Returns
    -------
    first : (facets + 1,) int64
        Start of each facet's partners in `partners`; (0,) if no two bodies touch.
    partners : (n,) int64
        Facet numbers.
    near_mm : float
    """
    none = np.zeros(0, np.int64)
    # Round bodies have no mesh; those that lie on others are refused.
    glass = np.array([i for i in np.flatnonzero(is_glass) if len(meshes[i].faces)], np.int64)
    if len(glass) < 2:
        return none, none, 0.0
    begins = np.concatenate([[0], np.cumsum([len(mesh.faces) for mesh in meshes])])
    near = touching_mm([meshes[i] for i in glass])
    pairs = [np.zeros((0, 2), np.int64)]
    for place, i in enumerate(glass):
        for j in glass[place + 1 :]:
            found = np.add(_pairs(meshes[i], meshes[j], near), begins[[i, j]])
            pairs += [found, found[:, ::-1]]
    both = np.concatenate(pairs)
    if not len(both):
        return none, none, near
    both = both[np.argsort(both[:, 0], kind="stable")]
    # The housing's facets and round faces come last and touch nothing.
    first = np.searchsorted(both[:, 0], np.arange(facets + 1))
    return first, np.ascontiguousarray(both[:, 1]), near


def touching_mm(bodies: list[Mesh]) -> float:
    """Return the distance within which facets of glass bodies count as touching, mm."""
    return CUT * min(float(np.ptp(mesh.vertices, axis=0).max()) for mesh in bodies)


def common_area(one: Mesh, other: Mesh, near: float) -> Array | None:
    """Return a point where facets of two meshes lie on each other; None if none do.

    They must share an area of their planes: facets side by side or joined at an edge do not count.

    Parameters
    ----------
    one, other : Mesh
    near : float, mm
        Largest distance between the facets, and least width of the shared area.

    Returns
    -------
    (3,) float64, mm, or None
    """
    first, second = _lying_on_each_other(one, other, near)
    return None if not len(first) else _middle_of_both(first[0], second[0])


def widest_contact_mm(one: Mesh, other: Mesh, near: float) -> float | None:
    """Return the largest distance between facets that lie on each other, mm; None if none do.

    Parameters
    ----------
    one, other, near
        As for `common_area`.
    """
    first, second = _lying_on_each_other(one, other, near)
    if not len(first):
        return None
    normal = np.cross(first[:, 1] - first[:, 0], first[:, 2] - first[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return float(np.abs(np.einsum("nij,nj->ni", second - first[:, :1], normal)).max())


def _lying_on_each_other(one: Mesh, other: Mesh, near: float) -> tuple[Array, Array]:
    """Return the corners (n, 3, 3) of pairs of facets, one from each mesh, that share an area of their planes."""
    pairs = _pairs(one, other, near)
    first, second = one.vertices[one.faces[pairs[:, 0]]], other.vertices[other.faces[pairs[:, 1]]]
    normals = facet_normals(one)[0][pairs[:, 0]], facet_normals(other)[0][pairs[:, 1]]
    flat = _lies_in(first, second[:, 0], normals[1], near) | _lies_in(second, first[:, 0], normals[0], near)
    overlap = np.where(flat, np.inf, -np.inf)
    # Two triangles of one plane overlap if no edge of either has the other on its far side.
    for own, its, normal in ((first, second, normals[0]), (second, first, normals[1])):
        for corner in range(3):
            edge = own[:, (corner + 1) % 3] - own[:, corner]
            inward = np.cross(normal, edge) / np.linalg.norm(edge, axis=1)[:, None]
            depth = np.einsum("nij,nj->ni", its - own[:, None, corner], inward).max(axis=1)
            overlap = np.minimum(overlap, depth)
    found = overlap > near
    return first[found], second[found]


def _lies_in(facets: Array, point: Array, normal: Array, near: float) -> NDArray[np.bool_]:
    """Return a mask of facets, (n, 3, 3), that each lie in a given plane."""
    away = np.einsum("nij,nj->ni", facets - point[:, None], normal)
    return np.asarray((np.abs(away) <= near).all(axis=1))


def _middle_of_both(one: Array, other: Array) -> Array:
    """Return the middle of the intersection of two facets' bounding boxes."""
    low = np.maximum(one.min(axis=0), other.min(axis=0))
    return np.asarray(0.5 * (low + np.minimum(one.max(axis=0), other.max(axis=0))))


def _pairs(one: Mesh, other: Mesh, near: float) -> Index:
    """Return (n, 2) facets of two meshes with boxes near each other and nearly parallel or opposite normals."""
    if not boxes_meet(one, other, near):
        return np.zeros((0, 2), np.int64)
    boxes = [_boxes(mesh) for mesh in (one, other)]
    for own, its in ((0, 1), (1, 0)):
        # Keep only facets near the other mesh's bounding box.
        low, high, _, _ = boxes[own]
        below, above = boxes[its][0].min(axis=0, initial=np.inf), boxes[its][1].max(axis=0, initial=-np.inf)
        kept = ((low <= above + near) & (high >= below - near)).all(axis=1)
        boxes[own] = _Boxes(*(column[kept] for column in boxes[own]))
    first, second = boxes
    if not len(first.number) or not len(second.number):
        return np.zeros((0, 2), np.int64)
    found = [np.zeros((0, 2), np.int64)]
    rows = max(1, MOST_AT_ONCE // len(second.number))
    for begin in range(0, len(first.number), rows):
        part = slice(begin, begin + rows)
        meets = np.abs(first.normal[part] @ second.normal.T) >= LEAST_COSINE
        for axis in range(3):
            meets &= first.low[part, axis, None] <= second.high[:, axis] + near
            meets &= first.high[part, axis, None] >= second.low[:, axis] - near
        a, b = np.nonzero(meets)
        found.append(np.column_stack([first.number[part][a], second.number[b]]))
    return np.concatenate(found)


class _Boxes(NamedTuple):
    """Bounding boxes, normals and numbers of facets."""

    low: Array
    high: Array
    normal: Array
    number: Index


def _boxes(mesh: Mesh) -> _Boxes:
    """Return the bounding boxes of all facets of a mesh."""
    corners = mesh.vertices[mesh.faces]
    return _Boxes(corners.min(axis=1), corners.max(axis=1), facet_normals(mesh)[0], np.arange(len(mesh.faces)))
