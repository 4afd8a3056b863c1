"""Refuse curved faces of glass that come nearer to another face than their facets stand off the curved surface.

Rays look for facets, and are then moved to the curved surface that the facets stand for. From there they look for what
comes next, so a face between a facet and its curved surface is passed unseen. Along lines across both faces, the spans
between facet and curved surface must therefore not overlap. Two cases are harmless: facets that are the same, which
are crossed as one; and faces that cut each other at an angle, for then only rays that come close to the cut can be
wrong, and what they lose is in the ledger. Faces of one body are not compared: a shell thinner than that loses nearly
all light, and the run says so.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.levels import FLAT, SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import Array, Mesh, boxes_meet, facet_corner_normals
from lfmesh.geometry.meshes.patch import patch_points, patches
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Scene, Target
from lfmesh.scene.literals import plain
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.regions.embree import Finder
from lfmesh.transport.tables.contacts import touching_mm

Index = NDArray[np.int64]

WEIGHTS = np.concatenate([
    np.array([[1, 1, 1]]) / 3.0,
    np.array([[8, 1, 1], [1, 8, 1], [1, 1, 8]]) / 10.0,
    np.array([[1, 12, 12], [12, 1, 12], [12, 12, 1]]) / 25.0,
])  # fmt: skip
"""Places on a facet where the distance of other faces is measured, as barycentric weights of its corners. A facet
stands off its curved surface most at the centre and in the middle of its edges."""

ALLOWANCE = 1.2
"""Largest stand-off of a body's facets, relative to the largest at the places where it is measured."""


@dataclass
class _Face:
    """The surface of a target: facets, and the curved patches that they stand for."""

    number: int
    mesh: Mesh
    curved: bool

    def coefficients(self, facets: Index) -> Array:
        """Return the coefficients of patches, (n, 6, 3); flat ones where the surface is made of facets."""
        some = Mesh(self.mesh.vertices, self.mesh.faces[facets])
        normals = self.mesh.corner_normals if self.curved else None
        return patches(some.vertices[some.faces], facet_corner_normals(some) if normals is None else normals[facets])

    @cached_property
    def stand_off(self) -> float:
        """Largest distance between a facet and its patch, mm."""
        if not self.curved:
            return 0.0
        every = np.arange(len(self.mesh.faces))
        return ALLOWANCE * float(np.abs(self.samples(every)[2]).max(initial=0.0))

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Lowest and highest coordinates, (3,) each, mm."""
        return self.mesh.vertices.min(axis=0), self.mesh.vertices.max(axis=0)

    @cached_property
    def size(self) -> Array:
        """Longest edge of each facet, (m,), mm."""
        corners = self.mesh.vertices[self.mesh.faces]
        return np.asarray(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1))

    def near(self, box: tuple[Array, Array], reach: float) -> Index:
        """Return the numbers of the facets whose boxes come within a distance of a box."""
        corners = self.mesh.vertices[self.mesh.faces]
        low, high = box[0] - reach, box[1] + reach
        return np.flatnonzero(((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1))

    def samples(self, facets: Index) -> tuple[Array, Array, Array]:
        """Return points and unit normals of patches, (n, 7, 3), and how far they lie before their facets, (n, 7)."""
        points, normals = patch_points(self.coefficients(facets), WEIGHTS[:, 1] + WEIGHTS[:, 2], WEIGHTS[:, 2])
        on_facets = np.einsum("qk,mki->mqi", WEIGHTS, self.mesh.vertices[self.mesh.faces[facets]])
        return points, normals, np.einsum("mqi,mqi->mq", points - on_facets, normals)


@dataclass
class _Close:
    """Two faces that are too close: the place, the distance between the curved surfaces, and the stand-offs, mm."""

    place: Array
    gap: float
    stand_off: float


def refuse_close_faces(scene: Scene, targets: list[TargetMesh], bodies: list[int]) -> None:
    """Refuse faces that come nearer to a curved face of glass than facets stand off the curved surface there.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        Of the scene, in order.
    bodies : list of int
        Numbers of the targets that are bodies of glass.

    Raises
    ------
    SceneError
        Naming the targets and the place.
    """
    faces = [_Face(i, each.mesh, _is_curved(scene.targets[i])) for i, each in enumerate(targets)]
    near = touching_mm([targets[i].mesh for i in bodies])
    for i in bodies:
        for j, other in enumerate(faces):
            if j == i or (j in bodies and j < i) or not (faces[i].curved or other.curved):
                continue
            reach = faces[i].stand_off + other.stand_off
            if reach == 0.0 or not boxes_meet(faces[i].mesh, other.mesh, reach):
                continue
            close = _close_places(faces[i], other, near) or _close_places(other, faces[i], near)
            if close is not None:
                raise SceneError(_told(scene, i, j, close, reach))


def _is_curved(target: Target) -> bool:
    """Tell whether a target is glass whose facets stand for a curved surface."""
    return target.refractor is not None and SURFACE_LEVEL[target.refractor.level] != FLAT


def _close_places(own: _Face, other: _Face, near: float) -> _Close | None:
    """Return a place of a face where another is too close; None if there is none."""
    reach = own.stand_off + other.stand_off
    middle = 0.5 * (own.box[0] + own.box[1])
    extent = np.abs(np.concatenate([own.mesh.vertices, other.mesh.vertices]) - middle).sum(axis=1).max()
    rounding = FLOAT32_GRAIN * float(extent)
    reach += 2.0 * rounding
    mine, its = own.near(other.box, reach), other.near(own.box, reach)
    if not len(mine) or not len(its):
        return None
    finder = Finder(Mesh(other.mesh.vertices - middle, other.mesh.faces[its]))
    points, normals, before = (a.reshape(-1, *a.shape[2:]) for a in own.samples(mine))
    of_point = np.repeat(mine, len(WEIGHTS))
    for sense in (1.0, -1.0):
        start = (points - middle - sense * reach * normals).astype(np.float32)
        found = finder.find(np.ascontiguousarray(start), np.ascontiguousarray((sense * normals).astype(np.float32)))
        rows = np.flatnonzero(found >= 0)
        facets = its[found[rows]]
        at_facet, at_patch, turn = _along(other, facets, points[rows], normals[rows])
        # Both spans along the normal, from the point on the curved surface.
        mine_low, mine_high = np.minimum(0.0, -before[rows]), np.maximum(0.0, -before[rows])
        its_low, its_high = np.minimum(at_facet, at_patch), np.maximum(at_facet, at_patch)
        overlap = (mine_low + rounding <= its_high) & (its_low + rounding <= mine_high)
        overlap &= (np.abs(at_facet + before[rows]) > near) | (np.abs(at_patch) > near)
        depth = np.abs(before[rows]) + np.abs(at_patch - at_facet)
        overlap &= turn * np.minimum(own.size[of_point[rows]], other.size[facets]) <= 2.0 * depth
        if overlap.any():
            found_at = int(overlap.argmax())
            return _Close(points[rows[found_at]], abs(float(at_patch[found_at])), float(depth[found_at]))
    return None


def _along(face: _Face, facets: Index, points: Array, ways: Array) -> tuple[Array, Array, Array]:
    """Return where lines meet facets and their patches, as distances along the lines, and the tangent of the angle.

    Parameters
    ----------
    face : _Face
    facets : (n,) int64
        Facet that each line meets.
    points, ways : (n, 3) float64
        Points and unit directions of the lines.

    Returns
    -------
    at_facet, at_patch : (n,) float64, mm
    turn : (n,) float64
        Of the angle between line and normal.
    """
    a, b, c = np.moveaxis(face.mesh.vertices[face.mesh.faces[facets]], 1, 0)
    cross = np.cross(b - a, c - a)
    at_facet = np.einsum("ij,ij->i", cross, a - points) / np.einsum("ij,ij->i", cross, ways)
    on_facet = points + at_facet[:, None] * ways
    area = np.einsum("ij,ij->i", cross, cross)
    of_b = np.einsum("ij,ij->i", cross, np.cross(on_facet - a, c - a)) / area
    of_c = np.einsum("ij,ij->i", cross, np.cross(b - a, on_facet - a)) / area
    on_patch, normal = patch_points(face.coefficients(facets), (of_b + of_c)[:, None], of_c[:, None])
    at_patch = at_facet + np.einsum("ij,ij->i", on_patch[:, 0] - on_facet, ways)
    cosine = np.abs(np.einsum("ij,ij->i", normal[:, 0], ways))
    sine = np.linalg.norm(np.cross(normal[:, 0], ways), axis=1)
    return at_facet, at_patch, np.divide(sine, cosine, out=np.full_like(sine, np.inf), where=cosine > 0.0)


def _told(scene: Scene, one: int, other: int, close: _Close, reach: float) -> str:
    """Return the message with which two faces are refused."""
    x, y, z = close.place
    same = "let both have the same facets there, or " if scene.targets[other].refractor is not None else ""
    return (
        f"{named_target(scene, one)} and {named_target(scene, other)}: their faces are {plain(close.gap, 2)} mm apart "
        f"near ({x:.4g}, {y:.4g}, {z:.4g}) mm, where the facets stand {plain(close.stand_off, 2)} mm off the curved "
        f"faces. Rays would miss one of them; {same}leave {plain(reach, 2)} mm or more between them, or take "
        "finer meshes"
    )
