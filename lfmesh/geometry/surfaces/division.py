"""Division of long facets, so that Embree's boxes are small.

A box around a long, thin, oblique triangle is nearly empty, and rays through it test the triangle in vain. Flat walls
and fillets of CAD parts consist of such triangles.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Mesh, longest_edges

EDGES_ACROSS = 8.0
"""Size of a body over the longest edge that its facets keep."""

MANY = 64
"""Bodies with fewer facets stay unchanged: few large facets are best for sheets and boxes."""

MOST_GROWTH = 4
"""Largest factor on a body's number of facets; otherwise it stays unchanged."""


def divided(mesh: Mesh, bodies: NDArray[np.int64]) -> tuple[Mesh, NDArray[np.int64]]:
    """Divide long facets at the middles of their edges; return the mesh and the original facet of each facet.

    An edge is divided by its length alone, so neighbours divide it at the same points and no gap opens. Without long
    facets the mesh itself is returned.

    Parameters
    ----------
    mesh : Mesh
    bodies : (m,) int64
        Body of each facet.
    """
    corners, owners = [], []
    order = np.argsort(bodies, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(bodies[order])) + 1):
        facets = None
        if len(own) >= MANY:
            vertices = mesh.vertices[mesh.faces[own].ravel()]
            longest = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0))) / EDGES_ACROSS
            if longest_edges(mesh)[own].max() > longest:
                facets, within = _divided(vertices.reshape(-1, 3, 3), longest)
                own = own[within]
        corners.append(facets)
        owners.append(own)
    if all(facets is None for facets in corners):
        return mesh, np.arange(len(mesh.faces))
    corners = [
        mesh.vertices[mesh.faces[own]] if facets is None else facets
        for facets, own in zip(corners, owners, strict=True)
    ]
    all_corners = np.concatenate([*corners, np.zeros((0, 3, 3))])
    faces = np.arange(3 * len(all_corners)).reshape(-1, 3)
    return Mesh(all_corners.reshape(-1, 3), faces), np.concatenate([*owners, np.zeros(0, np.int64)])


def _divided(facets: NDArray[np.float64], longest: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Divide the facets (n, 3, 3) of a body with edges above a length; return them, and the original facet of each."""
    whole, most = facets, MOST_GROWTH * len(facets)
    owners = np.arange(len(facets))
    while True:
        edges = np.linalg.norm(facets - np.roll(facets, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        if not long.any():
            return facets, owners
        if len(facets) + long.sum() > most:
            return whole, np.arange(len(whole))
        rows, first = np.arange(long.sum()), edges[long].argmax(axis=1)
        a, b, c = (facets[long][rows, (first + k) % 3] for k in range(3))
        middle = 0.5 * (a + b)
        halves = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        facets = np.concatenate([facets[~long], *halves])
        owners = np.concatenate([owners[~long], owners[long], owners[long]])
