"""Round targets and bodies of glass: spheres, cylinders and disks that rays meet as they are, not by a mesh."""

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
    """A sphere, cylinder or disk in its place.

    Attributes
    ----------
    shape : Sphere, Cylinder or Disk
    place : (3, 4) float64
        Of its own frame in the world, mm.
    picture : (2, 2) float64
        Lower left corner of its picture in its texture, and the picture's extent there.
    """

    shape: Sphere | Cylinder | Disk
    place: Array
    picture: Array

    def meshed(self) -> Primitive:
        """Return a mesh whose vertices lie on it, and where its texture lies on the facets; the latest are kept."""
        return _meshed(self)

    def hull(self, rings: int = COARSE) -> Mesh:
        """Return a mesh that encloses it; the more rings, the more closely."""
        return hull(self.shape, rings).moved(self.place)

    def faces(self) -> NDArray[np.void]:
        """Return its faces, (n,) ROUND, in the world frame."""
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
        """Return the lowest and the highest corner of the box round it, (2, 3), world frame."""
        low, high = boxes_of(self.faces())
        return np.array([low.min(axis=0), high.max(axis=0)])

    def farthest_mm(self, point: Array) -> float:
        """Return the distance of its farthest point from a point (3,) of the world frame."""
        (r, z), (radius, half) = self._seen_from_axis(point), self._size_mm
        return float(np.hypot(r, z) + radius if isinstance(self.shape, Sphere) else np.hypot(r + radius, abs(z) + half))

    def distance_mm(self, points: Array) -> Array:
        """Return the distances (...) of its surface from points (..., 3) of the world frame."""
        return np.abs(self.height_mm(points))

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Tell which points (..., 3) of the world frame lie inside it, where it is closed."""
        return self.height_mm(points) < 0.0

    def height_mm(self, points: Array) -> Array:
        """Return the distances (...) of its surface from points (..., 3) of the world frame, negative inside it."""
        (r, z), (radius, half) = self._seen_from_axis(points), self._size_mm
        if isinstance(self.shape, Sphere):
            return np.asarray(np.hypot(r, z) - radius)
        beside, above = r - radius, np.abs(z) - half
        outside = np.hypot(np.maximum(beside, 0.0), np.maximum(above, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(beside, above), 0.0))

    @property
    def half_mm(self) -> float:
        """Half the height along the axis; 0 of a sphere or a disk."""
        return 0.5 * self.shape.height_mm if isinstance(self.shape, Cylinder) else 0.0

    @property
    def _size_mm(self) -> tuple[float, float]:
        """Radius, and half the height along the axis."""
        return self.shape.radius_mm, self.half_mm

    def _seen_from_axis(self, points: Array) -> tuple[Array, Array]:
        """Return the distances of points from the axis, and their heights along that."""
        x, y, z = np.moveaxis(frame.points(frame.inverse(self.place), points), -1, 0)
        return np.hypot(x, y), z


@lru_cache(maxsize=KEPT)
def _meshed(body: RoundBody) -> Primitive:
    mesh, uv = primitive(body.shape)
    return Primitive(mesh.moved(body.place), None if uv is None else body.picture[0] + body.picture[1] * uv)
