"""Spheres, cylinders and disks, as targets or glass, that rays meet exactly instead of by a mesh."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.primitives import COARSE, KEPT, Primitive, hull, primitive
from lfmesh.geometry.objects.round_faces import FLAT, ROUND, SPHERE, WALL, boxes_of
from lfmesh.scene.objects.shapes import Cylinder, Disk, Sphere

ROUND_SHAPES = (Sphere, Cylinder, Disk)


@dataclass(frozen=True, eq=False)
class RoundBody:
    """Sphere, cylinder or disk in its place.

    Attributes
    ----------
    shape : Sphere, Cylinder or Disk
    place : (3, 4) float64
        Frame of the body in the world, mm.
    picture : (2, 2) float64
        Lower left corner of its picture in its texture, and the picture's extent there.
    """

    shape: Sphere | Cylinder | Disk
    place: Array
    picture: Array

    def meshed(self) -> Primitive:
        """Return a mesh with its vertices on the surface, and its texture coordinates; the latest meshes are cached."""
        return _meshed(self)

    def hull(self, rings: int = COARSE) -> Mesh:
        """Return a mesh that encloses the body, more tightly with more rings."""
        return hull(self.shape, rings).moved(self.place)

    def faces(self) -> NDArray[np.void]:
        """Return the faces (n,) ROUND in the world frame."""
        radius, half = self._size_mm
        if isinstance(self.shape, Sphere):
            faces = [(SPHERE, frame.IDENTITY, 4.0 * np.pi * radius**2)]
        else:
            faces = [(FLAT, frame.frame((0, 0, 0), (0, 0, half)), np.pi * radius**2)]
        if isinstance(self.shape, Cylinder):
            # Seen from behind, the picture's right is -x.
            faces.append((FLAT, frame.frame((0, 180, 0), (0, 0, -half)), np.pi * radius**2))
            faces.append((WALL, frame.IDENTITY, 4.0 * np.pi * radius * half))
        table = np.zeros(len(faces), ROUND)
        for row, (kind, own, area) in zip(table, faces, strict=True):
            stands = frame.compose(self.place, own)
            row["kind"], row["area"], row["radius"], row["half"] = kind, area, radius, half
            row["centre"], row["axes"] = stands[:, 3], stands[:, :3].T
            row["corner"], row["extent"] = self.picture
        return table

    def box_mm(self) -> Array:
        """Return the lowest and the highest corner of the bounding box, (2, 3), world frame."""
        low, high = boxes_of(self.faces())
        return np.array([low.min(axis=0), high.max(axis=0)])

    def farthest_mm(self, point: Array) -> float:
        """Return the largest distance of the body from a point (3,) of the world frame."""
        (r, z), (radius, half) = self._seen_from_axis(point), self._size_mm
        return float(np.hypot(r, z) + radius if isinstance(self.shape, Sphere) else np.hypot(r + radius, abs(z) + half))

    def distance_mm(self, points: Array) -> Array:
        """Return the distances (...) of world-frame points (..., 3) from the surface."""
        return np.abs(self.height_mm(points))

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Tell which world-frame points (..., 3) lie inside the body, if it is closed."""
        return self.height_mm(points) < 0.0

    def height_mm(self, points: Array) -> Array:
        """Return the signed distances (...) of world-frame points (..., 3) from the surface, negative inside."""
        (r, z), (radius, half) = self._seen_from_axis(points), self._size_mm
        if isinstance(self.shape, Sphere):
            return np.asarray(np.hypot(r, z) - radius)
        beside, above = r - radius, np.abs(z) - half
        outside = np.hypot(np.maximum(beside, 0.0), np.maximum(above, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(beside, above), 0.0))

    @property
    def half_mm(self) -> float:
        """Half the height along the axis; 0 for a sphere or disk."""
        return 0.5 * self.shape.height_mm if isinstance(self.shape, Cylinder) else 0.0

    @property
    def _size_mm(self) -> tuple[float, float]:
        """Radius, and half the height along the axis."""
        return self.shape.radius_mm, self.half_mm

    def _seen_from_axis(self, points: Array) -> tuple[Array, Array]:
        """Return the distances of points from the axis, and their heights along it."""
        x, y, z = np.moveaxis(frame.points(frame.inverse(self.place), points), -1, 0)
        return np.hypot(x, y), z


@lru_cache(maxsize=KEPT)
def _meshed(body: RoundBody) -> Primitive:
    mesh, uv = primitive(body.shape)
    return Primitive(mesh.moved(body.place), None if uv is None else body.picture[0] + body.picture[1] * uv)
