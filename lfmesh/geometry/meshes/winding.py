"""Winding number of closed shells about a point, which tells whether the point is in a body of any shape.

The solid angles of the facets, signed by the side that faces the point, sum to 4π inside a closed shell and to zero
outside. The solid angle of a triangle follows A. van Oosterom and J. Strackee, "The solid angle of a plane triangle",
IEEE Trans. Biomed. Eng. 30 (1983) 125-126.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.meshes.vertex_normals import smooth_groups
from lfmesh.kernels.decorators import kernel


def shells(mesh: Mesh) -> list[NDArray[np.int64]]:
    """Return the facets of each edge-connected part of a mesh."""
    group = smooth_groups(mesh, np.ones((len(mesh.faces), 3), dtype=bool))
    order = np.argsort(group, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group[order])) + 1)


def winding(corners: Array, points: Array) -> NDArray[np.int64]:
    """Return the winding number (n,) of a closed shell about points: 1 inside an outward-facing shell, 0 outside.

    Parameters
    ----------
    corners : (m, 3, 3) float64
        Corners of the facets.
    points : (n, 3) float64
        Not on the shell itself.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    numbers = np.zeros(len(points), dtype=np.int64)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    numbers[near] = [round(_solid_angle(corners, *points[i]) / (4.0 * np.pi)) for i in near]
    return numbers


@kernel
def _solid_angle(corners: Array, x: float, y: float, z: float) -> float:
    """Return the solid angle of facets as seen from a point, positive where their backs are seen."""
    total = 0.0
    for i in range(len(corners)):
        ax, ay, az = corners[i, 0, 0] - x, corners[i, 0, 1] - y, corners[i, 0, 2] - z
        bx, by, bz = corners[i, 1, 0] - x, corners[i, 1, 1] - y, corners[i, 1, 2] - z
        cx, cy, cz = corners[i, 2, 0] - x, corners[i, 2, 1] - y, corners[i, 2, 2] - z
        a = np.sqrt(ax * ax + ay * ay + az * az)
        b = np.sqrt(bx * bx + by * by + bz * bz)
        c = np.sqrt(cx * cx + cy * cy + cz * cz)
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
        total += 2.0 * np.arctan2(volume, a * b * c + ab * c + bc * a + ca * b)
    return total
