"""Flatness test of meshes."""

from collections.abc import Iterable

import numpy as np

from lfmesh.geometry.meshes.mesh import Mesh, facet_normals
from lfmesh.geometry.surfaces.tessellation import FLOAT32_MARGIN


def in_one_plane(meshes: Iterable[Mesh]) -> bool:
    """Tell whether all facets lie in the plane of the largest, to the rounding of coordinates; true without facets.

    Light that leaves a flat mesh never meets it again. Files hold float32 coordinates, so a corner may be off the plane
    by the float32 rounding of the mesh's extent, plus the float64 rounding of later transformations.

    Parameters
    ----------
    meshes : iterable of Mesh
        Vertices without a facet count too.
    """
    parts = [mesh for mesh in meshes if len(mesh.faces)]
    if not parts:
        return True
    largest = max(parts, key=lambda mesh: float(facet_normals(mesh)[1].max()))
    normals, areas = facet_normals(largest)
    facet = int(areas.argmax())
    if areas[facet] == 0.0:
        return False
    start, normal = largest.vertices[largest.faces[facet, 0]], normals[facet]
    low = np.min([mesh.vertices.min(axis=0) for mesh in parts], axis=0)
    high = np.max([mesh.vertices.max(axis=0) for mesh in parts], axis=0)
    rounding = FLOAT32_MARGIN * float(np.maximum(high - start, start - low).max()) + np.finfo(np.float64).eps * float(
        np.maximum(np.abs(low), np.abs(high)).max()
    )
    return all((np.abs((mesh.vertices - start) @ normal) <= rounding).all() for mesh in parts)
