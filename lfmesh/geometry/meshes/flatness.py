"""Flatness of meshes: the plane that all facets share, if there is one."""

import numpy as np

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.tessellation import FLOAT32_MARGIN


def in_one_plane(corners: Array) -> bool:
    """Tell whether facets all lie in one plane, to the rounding of their coordinates; true of no facets.

    Light that leaves a flat mesh never meets it again. The plane is that of the largest facet. Files hold coordinates
    in float32, so each corner may stand off the plane by that rounding of the extent of the mesh. Coordinates are
    moved in float64 afterwards, which leaves a rounding of their own size.

    Parameters
    ----------
    corners : (m, 3, 3) float64, mm
    """
    if not len(corners):
        return True
    edges = corners[:, 1:] - corners[:, :1]
    cross = np.cross(edges[:, 0], edges[:, 1])
    area = np.linalg.norm(cross, axis=1)
    largest = int(area.argmax())
    if area[largest] == 0.0:
        return False
    from_plane = corners - corners[largest, 0]
    rounding = FLOAT32_MARGIN * float(np.abs(from_plane).max()) + np.finfo(np.float64).eps * float(
        np.abs(corners).max()
    )
    return bool((np.abs(from_plane @ (cross[largest] / area[largest])) <= rounding).all())
