"""Shadows of targets, cast by a field point on the plane before the lens.

The outlines of a shadow are images of the edges where the target's facets end or turn away from the point. Quadrature
over the pupil divides its cells there.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.transport.aims.aim_table import widest_disk
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.tables import OPAQUE
from lfmesh.transport.world import World

Floats = NDArray[np.float64]

CLOSEST = 2.0**-30
"""Fraction of the way from point to plane from which edges count; nearer ones cast shadows beyond all disks."""


class Shadow(NamedTuple):
    """Targets between a field point and the lens, with the outlines of their shadows.

    Attributes
    ----------
    edges : (k, 2, 2) float64, mm
        Ends of the outlines on the plane before the lens, camera axes.
    facets : (m, 3, 3) float64, mm
        Corners of all blocking facets, relative to the point, camera axes.
    finder : Finder
        Finder of these facets.
    point : (3,) float64, mm
        Camera frame.
    plane_mm : float
        z of the plane, camera frame.
    """

    edges: Floats
    facets: Floats
    finder: Finder
    point: Floats
    plane_mm: float

    def hides(self, at_mm: Floats) -> NDArray[np.bool_]:
        """Tell whether the point is hidden from positions (n, 2) of the plane.

        Parameters
        ----------
        at_mm : (n, 2) float64, mm
            Camera axes.
        """
        ray = np.column_stack([at_mm, np.full(len(at_mm), self.plane_mm)]) - self.point
        found = self.finder.find(np.zeros(ray.shape, np.float32), ray.astype(np.float32))
        a, b, c = np.moveaxis(self.facets[found], 1, 0)
        normal = np.cross(b - a, c - a)
        # A facet counts if its plane lies within the ray's length. Facet −1 means none.
        reach, length = np.einsum("ij,ij->i", normal, a), np.einsum("ij,ij->i", normal, ray)
        return np.asarray((found >= 0) & (np.abs(reach) < np.abs(length)))


def shadow(world: World, point_mm: Floats) -> Shadow | None:
    """Return the shadow on the lens for a point of the camera frame, or None.

    Parameters
    ----------
    world : World
        Only opaque targets block light, see `in_the_way`.
    point_mm : (3,) float64, mm
    """
    opaque = [number for number in range(len(world.targets)) if is_opaque(world, number)]
    found = in_the_way(world, point_mm, opaque)
    if not found:
        return None
    facets = np.concatenate([_from_point(world, number, point_mm) for number in found])
    edges = np.concatenate(list(found.values()))
    mesh = Mesh(facets.reshape(-1, 3), np.arange(3 * len(facets)).reshape(-1, 3))
    return Shadow(edges, facets, Finder(mesh), point_mm, _plane_mm(world))


def in_the_way(world: World, point_mm: Floats, numbers: list[int]) -> dict[int, Floats]:
    """Return the targets between a point and the disk through which light can reach the lens.

    Parameters
    ----------
    world : World
    point_mm : (3,) float64, mm
        Camera frame, before the lens.
    numbers : list of int
        Targets to examine.

    Returns
    -------
    dict of int to (k, 2, 2) float64, mm
        Shadow outlines of each target that cross the disk, on the plane before the lens.
    """
    depth, radius = _plane_mm(world) - point_mm[2], widest_disk(world.tables.lens, point_mm[None], front=True)
    found = {}
    for number in numbers:
        outline = _outline(_from_point(world, number, point_mm), depth) + point_mm[:2]
        on_disk = _from_middle(outline) <= radius
        if on_disk.any() or _covers(_from_point(world, number, point_mm), np.array([*-point_mm[:2], depth])):
            found[number] = outline[on_disk]
    return found


def is_opaque(world: World, number: int) -> bool:
    """Tell whether a target blocks all light."""
    objects = world.tables.objects
    return bool(objects.medium[number] == OPAQUE and objects.opacity[number] == 1.0)


def _plane_mm(world: World) -> float:
    return float(world.tables.lens.box_low[2])


def _from_point(world: World, number: int, point_mm: Floats) -> Floats:
    """Return the corners of a target's facets, (m, 3, 3), relative to a point, camera axes."""
    mesh = world.targets[number].mesh
    return np.asarray(
        (frames.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], mesh.vertices) - point_mm)[mesh.faces]
    )


def _outline(facets: Floats, depth: float) -> Floats:
    """Return the silhouette and open edges of facets (k, 2, 2) seen from the origin, on the plane z = depth."""
    corners, number = np.unique(facets.reshape(-1, 3), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3)
    turned = np.linalg.det(facets) > 0.0
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    edges, which = np.unique(pairs, axis=0, return_inverse=True)
    which = which.reshape(-1)
    sides = np.bincount(which, minlength=len(edges))
    away = np.bincount(which, np.tile(turned, 3), len(edges))
    ends = corners[edges[(sides != 2) | (away == 1)]]
    # Keep the part of each edge between the point and the plane.
    z = ends[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = (np.array([CLOSEST * depth, depth])[:, None] - z[:, 0]) / (z[:, 1] - z[:, 0])
    level = z[:, 1] == z[:, 0]
    first = np.where(level, 0.0, np.clip(shares.min(axis=0), 0.0, 1.0))
    last = np.where(level, 1.0, np.clip(shares.max(axis=0), 0.0, 1.0))
    inside = np.where(level, (z[:, 0] >= CLOSEST * depth) & (z[:, 0] <= depth), first < last)
    way = ends[:, 1] - ends[:, 0]
    part = np.stack([ends[:, 0] + share[:, None] * way for share in (first, last)], axis=1)[inside]
    return np.asarray(part[..., :2] * (depth / part[..., 2:]))


def _from_middle(segments: Floats) -> Floats:
    """Return the distance of each segment (n, 2, 2) from the origin."""
    start, way = segments[:, 0], segments[:, 1] - segments[:, 0]
    length2 = (way * way).sum(axis=1)
    share = np.divide(-(start * way).sum(axis=1), length2, out=np.zeros(len(start)), where=length2 > 0.0)
    return np.asarray(np.linalg.norm(start + np.clip(share, 0.0, 1.0)[:, None] * way, axis=1))


def _covers(facets: Floats, ray: Floats) -> bool:
    """Tell whether a ray from the origin meets a facet (m, 3, 3)."""
    a, b, c = np.moveaxis(facets, 1, 0)
    # The ray passes on the same side of all three edges if these determinants have one sign.
    signs = np.sign([np.cross(p, q) @ ray for p, q in ((a, b), (b, c), (c, a))])
    normal = np.cross(b - a, c - a)
    reach, length = np.einsum("ij,ij->i", normal, a), normal @ ray
    between = (reach * length > 0.0) & (np.abs(reach) < np.abs(length))
    return bool((between & ((signs >= 0.0).all(axis=0) | (signs <= 0.0).all(axis=0))).any())
