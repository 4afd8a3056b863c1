"""Triangle meshes in float64, and the facet table that the kernels read.

`Mesh` is deliberately thin. It is converted to trimesh objects for export and checks, and to float32 for Embree.
Modules import trimesh only on use, since it takes half a second to load.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACET = np.dtype(
    [
        ("normal", "f8", (3,)),  # unit, from the winding
        ("offset", "f8"),  # normal · any point of the plane
        ("size", "f8"),  # longest edge
        ("body", "i8"),  # body of the facet; the owner of the table defines the number
        ("corners", "f8", (3, 3)),
        ("corner_normals", "f8", (3, 3)),
    ]
)


@dataclass(frozen=True)
class Mesh:
    """Vertices (n, 3) float64 mm, faces (m, 3), and corner normals (m, 3, 3) of the surface it stands for, if known.

    Do not write to its arrays: derived values are computed once, see `facet_normals`.
    """

    vertices: Array
    faces: Index
    corner_normals: Array | None = field(default=None)

    @cached_property
    def _measures(self) -> tuple[Array, Array, Array]:
        """Unit normals (m, 3), areas in mm² and longest edges in mm, (m,), from one pass over the coordinates."""
        corners, axes = np.ascontiguousarray(self.faces.T), np.ascontiguousarray(self.vertices.T)
        edges = [[axis[b] - axis[a] for axis in axes] for a, b in (corners[:2], corners[::2], corners[1:])]
        longest = np.sqrt(np.maximum.reduce([x * x + y * y + z * z for x, y, z in edges]))
        (ux, uy, uz), (vx, vy, vz), _ = edges
        cross = np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1)
        length = np.sqrt(cross[:, 0] ** 2 + cross[:, 1] ** 2 + cross[:, 2] ** 2)
        areas = 0.5 * length
        cross /= np.where(length > 0.0, length, np.inf)[:, None]
        for values in (cross, areas, longest):
            values.setflags(write=False)
        return cross, areas, longest

    def moved(self, through: Array) -> "Mesh":
        """Return the mesh transformed by a frame; a reflection reverses the winding, so that outward stays outward."""
        linear = through[:, :3]
        faces, normals = self.faces, self.corner_normals
        if normals is not None:
            normals = normals @ linear.T
        if np.linalg.det(linear) < 0:
            faces = faces[:, ::-1]
            normals = normals[:, ::-1] if normals is not None else None
        return Mesh(self.vertices @ linear.T + through[:, 3], faces, normals)

    def flipped(self) -> "Mesh":
        """Return the mesh with all faces reversed."""
        normals = -self.corner_normals[:, ::-1] if self.corner_normals is not None else None
        return Mesh(self.vertices, self.faces[:, ::-1], normals)

    def solid(self) -> "trimesh.Trimesh":
        """Return a trimesh object with coincident vertices merged, so that shared rims close."""
        import trimesh

        return trimesh.Trimesh(self.vertices, self.faces, process=True, validate=False)


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """Return all meshes as one; facets keep the given order."""
    parts = list(meshes)
    starts = np.cumsum([0, *(len(m.vertices) for m in parts)])
    with_normals = [m.corner_normals for m in parts]
    return Mesh(
        np.concatenate([m.vertices for m in parts]) if parts else np.zeros((0, 3)),
        np.concatenate([m.faces + s for m, s in zip(parts, starts, strict=False)])
        if parts
        else np.zeros((0, 3), np.int64),
        np.concatenate(
            [n if n is not None else facet_corner_normals(m) for m, n in zip(parts, with_normals, strict=True)]
        )
        if parts and any(n is not None for n in with_normals)
        else None,
    )


def boxes_meet(one: Mesh, other: Mesh, within: float) -> bool:
    """Tell whether the boxes round two meshes come within a distance of each other, mm.

    Parameters
    ----------
    one, other : Mesh
    within : float, mm
    """
    low = np.maximum(one.vertices.min(axis=0), other.vertices.min(axis=0))
    high = np.minimum(one.vertices.max(axis=0), other.vertices.max(axis=0))
    return bool((low <= high + within).all())


def facet_normals(mesh: Mesh) -> tuple[Array, Array]:
    """Return unit normals (m, 3) and areas (m,) in mm², both read-only; a facet without area has a zero normal."""
    return mesh._measures[:2]


def longest_edges(mesh: Mesh) -> Array:
    """Return the longest edge of each facet, (m,) mm, read-only."""
    return mesh._measures[2]


def facet_corner_normals(mesh: Mesh) -> Array:
    """Return the facet normals as corner normals (m, 3, 3), for a faceted body."""
    return np.repeat(facet_normals(mesh)[0][:, None, :], 3, axis=1)


def facet_table(mesh: Mesh, bodies: NDArray[np.int64]) -> NDArray[np.void]:
    """Return the `FACET` table (m,) of a mesh; `bodies` (m,) are the numbers of the facets' bodies."""
    table = np.empty(len(mesh.faces), FACET)
    corner, normals = mesh.vertices[mesh.faces], facet_normals(mesh)[0]
    table["normal"] = normals
    # Any corner would do; the mean of the three halves the rounding.
    table["offset"] = np.einsum("ij,ikj->i", normals, corner) / 3.0
    table["size"] = longest_edges(mesh)
    table["body"] = bodies
    table["corners"] = corner
    table["corner_normals"] = normals[:, None, :] if mesh.corner_normals is None else mesh.corner_normals
    return table


def distance_mm(corners: Array, point: Array) -> float:
    """Return the distance of a point from the nearest of some facets, mm.

    Parameters
    ----------
    corners : (n, 3, 3) float64, mm
    point : (3,) float64, mm
    """
    from trimesh.triangles import closest_point

    found = closest_point(corners, np.tile(point, (len(corners), 1)))
    return float(np.linalg.norm(found - point, axis=1).min(initial=np.inf))


def distance_of_segment_mm(corners: Array, start: Array, end: Array) -> float:
    """Return the distance of a segment from the nearest of some facets, mm; 0 if it passes through one.

    Parameters
    ----------
    corners : (n, 3, 3) float64, mm
    start, end : (3,) float64, mm
    """
    nearest = min(distance_mm(corners, start), distance_mm(corners, end))
    if not len(corners) or np.array_equal(start, end):
        return nearest
    if crossings(corners, start, end)[1].any():
        return 0.0
    way = end - start
    for k in range(3):
        edge, from_start = corners[:, (k + 1) % 3] - corners[:, k], corners[:, k] - start
        # Closest points of the two lines; the ends of both are compared as well.
        a, b, c = float(way @ way), edge @ way, np.einsum("ij,ij->i", edge, edge)
        d, e = from_start @ way, np.einsum("ij,ij->i", from_start, edge)
        scale = a * c - b * b
        on_edge = np.divide(b * d - a * e, scale, out=np.zeros(len(corners)), where=scale > 0.0).clip(0.0, 1.0)
        on_way = ((d + on_edge * b) / a).clip(0.0, 1.0)
        on_edge = np.divide(on_way * b - e, c, out=np.zeros(len(corners)), where=c > 0.0).clip(0.0, 1.0)
        apart = from_start + on_edge[:, None] * edge - on_way[:, None] * way
        nearest = min(nearest, float(np.linalg.norm(apart, axis=1).min()))
    return nearest


def crossings(corners: Array, start: Array, end: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Intersect a segment with the planes of facets: return its fraction at each, and whether it meets the facet there.

    Parameters
    ----------
    corners : (n, 3, 3) float64, mm
    start, end : (3,) float64, mm

    Returns
    -------
    shares : (n,) float64
        nan for parallel planes.
    inside : (n,) bool
        Borders count as inside; False if the segment lies in the plane.
    """
    way = end - start
    a, b, c = np.moveaxis(corners, 1, 0)
    # Möller and Trumbore 1997: fractions of the two edges and of the segment.
    across = np.cross(way, c - a)
    scale = np.einsum("ij,ij->i", b - a, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ij,ij->i", start - a, across) / scale
        other = np.cross(start - a, b - a)
        v = other @ way / scale
        share = np.einsum("ij,ij->i", c - a, other) / scale
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (share > 0.0) & (share < 1.0)
    return share, inside
