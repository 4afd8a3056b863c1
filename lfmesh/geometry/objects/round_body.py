"""Round targets: spheres, cylinders and disks that rays meet as they are, not by a mesh."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.primitives import KEPT, Primitive, hull, primitive
from lfmesh.geometry.objects.round_faces import FLAT, ROUND, SPHERE, WALL, boxes_of
from lfmesh.scene.objects.targets import Cylinder, Disk, Sphere

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

    def hull(self) -> Mesh:
        """Return a coarse mesh that encloses it."""
        return hull(self.shape).moved(self.place)

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

    def distance_mm(self, point: Array) -> float:
        """Return the distance of its surface from a point (3,) of the world frame."""
        (r, z), (radius, half) = self._seen_from_axis(point), self._size_mm
        if isinstance(self.shape, Sphere):
            return float(abs(np.hypot(r, z) - radius))
        beside, above = r - radius, abs(z) - half
        if self.holds(point):
            return float(min(-beside, -above))
        return float(np.hypot(max(beside, 0.0), max(above, 0.0)))

    def holds(self, point: Array) -> bool:
        """Tell whether a point (3,) of the world frame lies inside it, where it is closed."""
        (r, z), (radius, half) = self._seen_from_axis(point), self._size_mm
        if isinstance(self.shape, Sphere):
            return bool(np.hypot(r, z) < radius)
        return bool(r < radius and abs(z) < half)

    @property
    def _size_mm(self) -> tuple[float, float]:
        """Radius, and half the height along the axis."""
        return self.shape.radius_mm, 0.5 * self.shape.height_mm if isinstance(self.shape, Cylinder) else 0.0

    def _seen_from_axis(self, point: Array) -> tuple[float, float]:
        """Return a point's distance from the axis, and its height along that."""
        x, y, z = frame.points(frame.inverse(self.place), point)
        return float(np.hypot(x, y)), float(z)


@lru_cache(maxsize=KEPT)
def _meshed(body: RoundBody) -> Primitive:
    mesh, uv = primitive(body.shape)
    return Primitive(mesh.moved(body.place), None if uv is None else body.picture[0] + body.picture[1] * uv)
