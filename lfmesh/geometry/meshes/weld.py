"""Vertices that stand in the same place, made one, so that facets which touch share their edges."""

import numpy as np

from lfmesh.geometry.meshes.mesh import Mesh


def welded(mesh: Mesh) -> Mesh:
    """Return the mesh with equal vertices merged; the facets keep their order and their corner normals.

    Equal means equal in float64: nothing is moved, and a gap that the mesh has stays open.
    """
    # Adding zero turns -0.0 into 0.0, which is the same place.
    vertices = mesh.vertices + 0.0
    order = np.lexsort(vertices.T)
    ranked = vertices[order]
    is_new = np.ones(len(ranked), dtype=np.bool_)
    is_new[1:] = (ranked[1:] != ranked[:-1]).any(axis=1)
    number = np.empty(len(ranked), dtype=np.int64)
    number[order] = np.cumsum(is_new) - 1
    return Mesh(ranked[is_new], number[mesh.faces], mesh.corner_normals)
