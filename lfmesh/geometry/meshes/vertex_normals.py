"""Vertex normals of a mesh that came without: smooth groups, creases, and a second-order fit.

The usual mean of the neighbouring facets' normals is of first order on uneven meshes and tilts at rims. Here the normal
is the gradient of a quadric fitted to a vertex's neighbours in its smooth group. It is exact for quadrics if these are
symmetric, otherwise of second order in the facet size.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Index, Mesh, facet_normals

LEAST_NEIGHBOURS = 8
"""Least number of neighbours for a fit of five coefficients; if there are fewer, their own neighbours are added."""

HUB = 64
"""Number of neighbours above which a vertex is the centre of a fan, and does not connect its neighbours."""

CREASE_FACTOR = 3.0
CREASE_QUANTILE = 0.75
CREASE_RANGE_DEG = (0.5, 30.0)

NO_FIT = 1e-10
"""Fraction of a fit's largest singular value below which the neighbours do not determine a coefficient."""

IN_ONE_PLANE = 1e-5
"""Angle in rad between coplanar facets due to float32 coordinates."""


def edge_partners(faces: Index) -> tuple[Index, Index]:
    """Return the pairs of coincident facet edges, (k,) each, as 3 · facet + edge; edge 0 is ab, 1 bc, 2 ca.

    Edges shared by more than two facets have no partner.
    """
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    low, high = edges.min(axis=1), edges.max(axis=1)
    # Encoding both ends in one number halves the time of the sort.
    edge = low * np.int64(high.max(initial=0) + 1) + high
    order = np.argsort(edge, kind="stable")
    same = np.diff(edge[order]) == 0
    alone = same & ~np.append(False, same[:-1]) & ~np.append(same[1:], False)
    return order[:-1][alone], order[1:][alone]


def is_closed(faces: Index) -> bool:
    """Tell whether every edge joins two facets, which run along it in opposite senses."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    if not _may_be_closed(start, end):
        return False
    first, second = edge_partners(faces)
    return faces.size == 2 * len(first) and bool((start[first] == end[second]).all())


def _may_be_closed(start: Index, end: Index) -> bool:
    """Tell whether edges may cancel in pairs of opposite senses: the sum of the signed hashes of their ends is zero.

    False is certain. This rules out an open scan of a million facets without sorting its edges.
    """
    low, high = np.minimum(start, end).astype(np.uint64), np.maximum(start, end).astype(np.uint64)
    hashed = low * np.uint64(0x9E3779B97F4A7C15) + high * np.uint64(0xBF58476D1CE4E5B9)
    hashed ^= hashed >> np.uint64(29)
    hashed *= np.uint64(0x94D049BB133111EB)
    hashed ^= hashed >> np.uint64(32)
    return bool(hashed[start < end].sum() == hashed[start > end].sum())


def smooth_edges(mesh: Mesh, crease_deg: float | None) -> NDArray[np.bool_]:
    """Tell across which edges (m, 3) the surface is smooth: the facets' normals differ by less than an angle.

    The default angle is `CREASE_FACTOR` times the upper quartile of the angles between facets that are not coplanar. On
    a mesh of curved faces, most edges lie on the faces, including the more curved ones, and few between faces.
    """
    normals, _ = facet_normals(mesh)
    first, second = edge_partners(mesh.faces)
    # The sine of the half angle keeps its digits where the cosine is close to one.
    angle = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(normals[first // 3] - normals[second // 3], axis=1), 1.0))
    if crease_deg is None:
        curved = angle[angle > IN_ONE_PLANE]
        usual = np.rad2deg(np.quantile(curved, CREASE_QUANTILE)) if len(curved) else 0.0
        crease_deg = float(np.clip(CREASE_FACTOR * usual, *CREASE_RANGE_DEG))
    flat = angle < np.deg2rad(crease_deg)
    smooth = np.zeros(3 * len(mesh.faces), dtype=bool)
    smooth[first[flat]] = smooth[second[flat]] = True
    return smooth.reshape(-1, 3)


def smooth_groups(mesh: Mesh, smooth: NDArray[np.bool_]) -> Index:
    """Return the smooth group (m,) of each facet: facets connected across smooth edges."""
    first, second = edge_partners(mesh.faces)
    goes_on = smooth.reshape(-1)[first]
    a, b = first[goes_on] // 3, second[goes_on] // 3
    label = np.arange(len(mesh.faces))
    # Every facet takes the smallest label among its neighbours, then the label of that facet, until none changes.
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, a, label[b])
        np.minimum.at(lowest, b, label[a])
        lowest = lowest[lowest]
        if np.array_equal(lowest, label):
            return np.unique(label, return_inverse=True)[1].reshape(-1)
        label = lowest


def estimated_corner_normals(mesh: Mesh, groups: Index) -> Array:
    """Return unit normals (m, 3, 3) at the facets' corners, one per vertex and smooth group.

    Parameters
    ----------
    mesh : Mesh
        Coincident vertices merged.
    groups : (m,)
        Smooth group of each facet; a vertex on a crease has a normal in each.
    """
    count = len(mesh.vertices)
    # Each group has its own copy of a shared vertex.
    key = groups[:, None] * count + mesh.faces
    own, corner = np.unique(key, return_inverse=True)
    corner = corner.reshape(-1, 3)
    place = mesh.vertices[own % count]
    normals, areas = facet_normals(mesh)
    mean = np.zeros((len(own), 3))
    np.add.at(mean, corner, (normals * areas[:, None])[:, None, :])
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0)
    return _fitted(place, mean, _neighbour_lists(corner, len(own)))[corner]


def _neighbour_lists(corner: Index, count: int) -> list[Index]:
    """Return each vertex's neighbours along edges, with their own neighbours if there are few."""
    pairs = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    pairs = np.unique(np.concatenate([pairs, pairs[:, ::-1]]), axis=0)
    starts = np.searchsorted(pairs[:, 0], np.arange(count + 1))
    near = [pairs[a:b, 1] for a, b in pairwise(starts)]
    lists = []
    for vertex, first in enumerate(near):
        ring = first
        for _ in range(2):
            if len(ring) >= LEAST_NEIGHBOURS:
                break
            ring = np.unique(np.concatenate([ring, *(near[v] for v in ring if len(near[v]) <= HUB)]))
            ring = ring[ring != vertex]
        lists.append(ring)
    return lists


def _fitted(place: Array, mean: Array, lists: list[Index]) -> Array:
    """Fit height = d u + e v + a u² + b u v + c v² over the neighbours of each vertex; return unit normals."""
    normals = mean.copy()
    sizes = np.array([len(ring) for ring in lists])
    for size in np.unique(sizes[sizes >= 5]):
        some = np.flatnonzero(sizes == size)
        around = place[np.stack([lists[v] for v in some])] - place[some][:, None, :]
        axis = mean[some]
        side = np.where(np.abs(axis[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        u = np.cross(axis, side)
        u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        v = np.cross(axis, u)
        a = np.einsum("nki,ni->nk", around, u)
        b = np.einsum("nki,ni->nk", around, v)
        h = np.einsum("nki,ni->nk", around, axis)
        scale = np.sqrt((a * a + b * b).mean(axis=1, keepdims=True))
        scale[scale == 0.0] = 1.0
        a, b, h = a / scale, b / scale, h / scale
        basis = np.stack([a, b, a * a, a * b, b * b], axis=-1)
        # Near neighbours count for more: the error of the quadric grows with the third power of the distance.
        weight = 1.0 / (0.1 + a * a + b * b)
        left = np.einsum("nki,nk,nkj->nij", basis, weight, basis)
        right = np.einsum("nki,nk,nk->ni", basis, weight, h)
        # Neighbours on a line or a conic do not determine the fit; take the least-norm one.
        solution = np.einsum("nij,nj->ni", np.linalg.pinv(left, rcond=NO_FIT, hermitian=True), right)
        tilted = axis - solution[:, :1] * u - solution[:, 1:2] * v
        normals[some] = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return normals
