"""Refuse curved faces of glass closer to another face than the distance of their facets from the curved surface.

A ray finds a facet, is moved to the curved surface that it represents, and searches on from there. It would miss a face
in between. Along lines across two faces, the spans between facet and curved surface must therefore not overlap. Two
cases are harmless: identical facets, which are crossed as one; and faces that cut at an angle, since only rays close to
the cut can be wrong, and the ledger shows their loss. Faces of one body are not compared: a shell so thin loses nearly
all light, and the run reports it.

The search divides pairs of facets into cells. The control points of a cell's patch and the corners of its facet bound
the space between the two (G. Farin, Curves and Surfaces for CAGD, 2002, chapter 17); vectors bound the normals
likewise. Pairs of cells that are apart or cut at an angle, by these bounds, are done; the others are divided, down to a
`FINEST` of the smaller facet. An overlap that fills such a cell cannot be missed.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.crossings import near_pairs
from lfmesh.geometry.meshes.levels import FLAT, SURFACE_LEVEL
from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_corner_normals
from lfmesh.geometry.meshes.patch import patch_points, patches
from lfmesh.geometry.meshes.patch_bends import (
    CORNERS,
    ENDS,
    QUARTERS,
    WHOLE,
    cell_control_points,
    cell_tangents,
    control_points,
    normal_control_vectors,
)
from lfmesh.geometry.objects.targets import TargetMesh, named_target
from lfmesh.scene import Scene, Target
from lfmesh.scene.literals import plain
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.tables.contacts import touching_mm

Index = NDArray[np.int64]

FINEST = 1.0 / 16.0
"""Size of the smallest cells, relative to the smaller of the two facets."""

AT_ONCE = 1 << 12
"""Pairs of cells compared at a time."""

ORDERS = np.array([[0, 1, 2, 3, 4, 5], [1, 2, 0, 4, 5, 3], [2, 0, 1, 5, 3, 4],
                   [0, 2, 1, 5, 4, 3], [2, 1, 0, 4, 3, 5], [1, 0, 2, 3, 5, 4]])  # fmt: skip
"""Possible orders of the same control points in two patches."""


@dataclass
class _Face:
    """Surface of a target: its facets, and the curved patches that they represent."""

    number: int
    mesh: Mesh
    curved: bool

    @cached_property
    def corners(self) -> Array:
        """Corners of the facets, (m, 3, 3), mm."""
        return self.mesh.vertices[self.mesh.faces]

    @cached_property
    def coefficients(self) -> Array:
        """Coefficients of the patches, (m, 6, 3); flat ones for a surface made of facets."""
        normals = self.mesh.corner_normals if self.curved else None
        return patches(self.corners, facet_corner_normals(self.mesh) if normals is None else normals)

    @cached_property
    def hulls(self) -> Array:
        """Control points of the patches, (m, 6, 3), mm: the corners, and one for each edge ab, bc, ca."""
        return control_points(self.coefficients)

    @cached_property
    def stand_off(self) -> float:
        """Upper bound of the distance between a facet and its patch, mm.

        The two differ by 2 Σ d λᵢ λⱼ over the edges, with the barycentric weights λ and the distances d of the edges'
        control points from their midpoints. The three products add up to at most 1/3.
        """
        middles = 0.5 * (self.corners + np.roll(self.corners, -1, axis=1))
        return 2.0 / 3.0 * float(np.linalg.norm(self.hulls[:, 3:] - middles, axis=2).max(initial=0.0))

    @cached_property
    def size(self) -> Array:
        """Longest edge of each facet, (m,), mm."""
        return np.asarray(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=1), axis=2).max(axis=1))


class _Cells(NamedTuple):
    """Pairs of cells, one of each face: triangles in the parameters of a facet."""

    facets: Index  # (k, 2)
    corners: Array  # (k, 2, 3, 2) parameters (η, ζ) of the corners

    def some(self, which: Any) -> "_Cells":
        """Return a selection of the pairs."""
        return _Cells(self.facets[which], self.corners[which])


@dataclass
class _Close:
    """Place where two faces are too close, the distance between the curved surfaces, and the stand-offs, mm."""

    place: Array
    gap: float
    stand_off: float


def refuse_close_faces(scene: Scene, targets: list[TargetMesh], bodies: list[int]) -> None:
    """Refuse faces closer to a curved face of glass than the stand-off of the facets there.

    Parameters
    ----------
    scene : Scene
    targets : list of TargetMesh
        All targets of the scene, in order.
    bodies : list of int
        Numbers of the targets that are bodies of glass.

    Raises
    ------
    SceneError
        Names the targets and the place.
    """
    if not any(_is_curved(scene.targets[i]) for i in bodies):
        return
    faces = [_Face(i, each.mesh, _is_curved(scene.targets[i])) for i, each in enumerate(targets)]
    near = touching_mm([targets[i].mesh for i in bodies])
    for i in bodies:
        for j, other in enumerate(faces):
            if j == i or (j in bodies and j < i) or not (faces[i].curved or other.curved):
                continue
            reach = faces[i].stand_off + other.stand_off
            close = _close_place((faces[i], other), near) if reach > 0.0 else None
            if close is not None:
                raise SceneError(_told(scene, i, j, close, reach))


def stand_off_mm(target: Target, mesh: Mesh) -> float:
    """Return a bound on the distance between the facets of a target and its curved faces, mm; 0 if it has none."""
    return _Face(0, mesh, curved=True).stand_off if _is_curved(target) else 0.0


def _is_curved(target: Target) -> bool:
    """Tell whether a target is glass with facets that represent a curved surface."""
    return target.refractor is not None and SURFACE_LEVEL[target.refractor.level] != FLAT


def _close_place(faces: tuple[_Face, _Face], near: float) -> _Close | None:
    """Return a place where two faces are too close; None if there is none."""
    vertices = np.concatenate([face.mesh.vertices for face in faces])
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    rounding = FLOAT32_GRAIN * float(np.abs(vertices - middle).sum(axis=1).max())
    pairs = near_pairs(faces[0].hulls, faces[1].hulls)
    pairs = pairs[_may_be_apart(faces, pairs, near)]
    waiting = [_Cells(pairs, np.broadcast_to(WHOLE, (len(pairs), 2, 3, 2)))]
    while waiting:
        cells = waiting.pop()
        if len(cells.facets) > AT_ONCE:
            half = len(cells.facets) // 2
            waiting += [cells.some(slice(half, None)), cells.some(slice(half))]
            continue
        cells = cells.some(_may_overlap(faces, cells, rounding))
        if not len(cells.facets):
            continue
        for own in (0, 1):
            close = _overlap_at_middles(faces, cells, own, rounding, near)
            if close is not None:
                return close
        waiting.append(_divided(faces, cells))
    return None


def _may_be_apart(faces: tuple[_Face, _Face], pairs: Index, near: float) -> NDArray[np.bool_]:
    """Return a mask of pairs (k, 2) of facets without a facet shared by both faces, to within a distance.

    A shared facet stands to the second face's other facets as these stand to each other.
    """
    one, other = (face.hulls[pairs[:, k]] for k, face in enumerate(faces))
    low, high = (np.abs(end(one, axis=1) - end(other, axis=1)).max(axis=1) <= near for end in (np.min, np.max))
    like = np.flatnonzero(low & high)
    same = np.zeros(len(like), np.bool_)
    for order in ORDERS:
        same |= np.linalg.norm(one[like] - other[like][:, order], axis=2).max(axis=1) <= near
    shared = pairs[like[same]]
    return ~(np.isin(pairs[:, 0], shared[:, 0]) | np.isin(pairs[:, 1], shared[:, 1]))


class _Bounds(NamedTuple):
    """Bounds of one cell in each pair."""

    hull: Array  # (k, 9, 3) mm, points with a hull that contains the cells of patch and facet and the space between
    depth: Array  # (k,) mm, largest distance between patch and facet
    axis: Array  # (k, 3) unit direction near the normals of the patch
    spread: Array  # (k,) rad, largest angle between a normal of the patch and the axis


def _bounds(face: _Face, facets: Index, corners: Array) -> _Bounds:
    """Return the bounds of cells with corners at some parameters, (k, 3, 2), of facets (k,) of a face."""
    of_patch = face.coefficients[facets]
    control = cell_control_points(of_patch, corners)
    one, other = corners[:, CORNERS], corners[:, ENDS]
    eta, zeta = 0.5 * (one[..., 0] + other[..., 0]), 0.5 * (one[..., 1] + other[..., 1])
    a, b, c = np.moveaxis(face.corners[facets], 1, 0)
    on_facet = a[:, None] + eta[..., None] * (b - a)[:, None] + zeta[..., None] * (c - b)[:, None]
    normals = normal_control_vectors(*cell_tangents(of_patch, corners))
    axis = normals.mean(axis=1)
    axis /= np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    along = np.einsum("kpi,ki->kp", normals, axis)
    across = np.linalg.norm(np.cross(normals, axis[:, None]), axis=2)
    return _Bounds(
        np.concatenate([control, on_facet[:, :3]], axis=1),
        np.linalg.norm(control - on_facet, axis=2).max(axis=1),
        axis,
        np.arctan2(across, along).max(axis=1),
    )


def _may_overlap(faces: tuple[_Face, _Face], cells: _Cells, rounding: float) -> NDArray[np.bool_]:
    """Return a mask of pairs of cells that their bounds show neither apart nor cutting at an angle."""
    pair = [_bounds(face, cells.facets[:, k], cells.corners[:, k]) for k, face in enumerate(faces)]
    axes = [*(np.broadcast_to(axis, pair[0].axis.shape) for axis in np.eye(3))]
    for k, face in enumerate(faces):
        corners = face.corners[cells.facets[:, k]]
        edges = np.roll(corners, -1, axis=1) - corners
        normal = np.cross(edges[:, 0], edges[:, 1])
        axes += [normal, pair[k].axis, *np.moveaxis(np.cross(edges, normal[:, None]), 1, 0)]
    axis = np.stack(axes, axis=1)
    length = np.linalg.norm(axis, axis=2, keepdims=True)
    axis = np.divide(axis, length, out=np.zeros_like(axis), where=length > 0.0)
    base = pair[0].hull[:, :1]
    one, other = (np.einsum("kai,kpi->kap", axis, each.hull - base) for each in pair)
    gap = np.maximum(other.min(axis=2) - one.max(axis=2), one.min(axis=2) - other.max(axis=2))
    apart = (gap >= -rounding) & (length[..., 0] > 0.0)
    cosine = np.abs(np.einsum("ki,ki->k", pair[0].axis, pair[1].axis))
    angle = np.arccos(np.minimum(cosine, 1.0)) - pair[0].spread - pair[1].spread
    smaller = np.minimum(*(face.size[cells.facets[:, k]] for k, face in enumerate(faces)))
    cut = (angle > 0.0) & (np.tan(np.maximum(angle, 0.0)) * smaller > 2.0 * (pair[0].depth + pair[1].depth))
    return ~(apart.any(axis=1) | cut)


def _divided(faces: tuple[_Face, _Face], cells: _Cells) -> _Cells:
    """Divide the larger cell of each pair into four; drop pairs that cannot be divided further."""
    edges = [
        np.linalg.norm(each - np.roll(each, -1, axis=1), axis=2).max(axis=1)
        for each in (_on_facets(face, cells.facets[:, k], cells.corners[:, k]) for k, face in enumerate(faces))
    ]
    finest = FINEST * np.minimum(*(face.size[cells.facets[:, k]] for k, face in enumerate(faces)))
    parts = [_Cells(np.zeros((0, 2), np.int64), np.zeros((0, 2, 3, 2)))]
    for k, larger in enumerate((edges[0] >= edges[1], edges[0] < edges[1])):
        which = cells.some(larger & (np.maximum(*edges) > finest * (1.0 + FLOAT32_GRAIN)))
        for quarter in QUARTERS:
            corners = np.array(which.corners)
            corners[:, k] = np.einsum("qc,kcp->kqp", quarter, which.corners[:, k])
            parts.append(_Cells(which.facets, corners))
    return _Cells(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _on_facets(face: _Face, facets: Index, places: Array) -> Array:
    """Return points (k, n, 3) of facets, mm, from the parameters (k, n, 2) of their patches."""
    a, b, c = np.moveaxis(face.corners[facets], 1, 0)
    return np.asarray(a[:, None] + places[..., :1] * (b - a)[:, None] + places[..., 1:] * (c - b)[:, None])


def _overlap_at_middles(
    faces: tuple[_Face, _Face], cells: _Cells, own: int, rounding: float, near: float
) -> _Close | None:
    """Return a place on a normal at a cell's middle where both spans from facet to patch overlap; None if none do."""
    mine, its = cells.facets[:, own], cells.facets[:, 1 - own]
    place = cells.corners[:, own].mean(axis=1)
    points, normals = (each[:, 0] for each in patch_points(faces[own].coefficients[mine], place[:, :1], place[:, 1:]))
    on_facet = _on_facets(faces[own], mine, place[:, None])[:, 0]
    before = np.einsum("ki,ki->k", points - on_facet, normals)
    at_facet, at_patch, turn, meets = _along(faces[1 - own], its, points, normals)
    # Both spans along the normal, measured from the point on the curved surface.
    mine_low, mine_high = np.minimum(0.0, -before), np.maximum(0.0, -before)
    its_low, its_high = np.minimum(at_facet, at_patch), np.maximum(at_facet, at_patch)
    overlap = meets & (mine_low + rounding <= its_high) & (its_low + rounding <= mine_high)
    overlap &= (np.abs(at_facet + before) > near) | (np.abs(at_patch) > near)
    depth = np.abs(before) + np.abs(at_patch - at_facet)
    overlap &= turn * np.minimum(faces[own].size[mine], faces[1 - own].size[its]) <= 2.0 * depth
    if not overlap.any():
        return None
    found = int(overlap.argmax())
    return _Close(points[found], abs(float(at_patch[found])), float(depth[found]))


def _along(face: _Face, facets: Index, points: Array, ways: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Return the distances along lines to facets and their patches, and the tangent of the angle.

    Parameters
    ----------
    facets : (n,) int64
        Facet that each line may meet.
    points, ways : (n, 3) float64
        Points and unit directions of the lines.

    Returns
    -------
    at_facet, at_patch : (n,) float64, mm
    turn : (n,) float64
        Tangent of the angle between line and normal.
    meets : (n,) bool
        The line meets the facet; otherwise the distance is to its plane.
    """
    a, b, c = np.moveaxis(face.corners[facets], 1, 0)
    cross = np.cross(b - a, c - a)
    rate, area = np.einsum("ij,ij->i", cross, ways), np.einsum("ij,ij->i", cross, cross)
    meets = rate != 0.0
    at_facet = np.divide(np.einsum("ij,ij->i", cross, a - points), rate, out=np.zeros_like(rate), where=meets)
    on_facet = points + at_facet[:, None] * ways
    of_b, of_c = (
        np.divide(np.einsum("ij,ij->i", cross, each), area, out=np.zeros_like(area), where=meets)
        for each in (np.cross(on_facet - a, c - a), np.cross(b - a, on_facet - a))
    )
    meets &= (of_b >= 0.0) & (of_c >= 0.0) & (of_b + of_c <= 1.0)
    of_b, of_c = np.where(meets, of_b, 0.0), np.where(meets, of_c, 0.0)
    on_patch, normal = patch_points(face.coefficients[facets], (of_b + of_c)[:, None], of_c[:, None])
    at_patch = at_facet + np.einsum("ij,ij->i", on_patch[:, 0] - on_facet, ways)
    cosine = np.abs(np.einsum("ij,ij->i", normal[:, 0], ways))
    sine = np.linalg.norm(np.cross(normal[:, 0], ways), axis=1)
    return at_facet, at_patch, np.divide(sine, cosine, out=np.full_like(sine, np.inf), where=cosine > 0.0), meets


def _told(scene: Scene, one: int, other: int, close: _Close, reach: float) -> str:
    """Return the error message for two faces."""
    x, y, z = close.place
    same = "give both the same facets there, " if scene.targets[other].refractor is not None else ""
    return (
        f"{named_target(scene, one)} and {named_target(scene, other)}: their faces are {plain(close.gap, 2)} mm "
        f"apart near ({x:.4g}, {y:.4g}, {z:.4g}) mm, but their facets are off the curved faces by "
        f"{plain(close.stand_off, 2)} mm, so rays would miss one of them; {same}leave {plain(reach, 2)} mm or more "
        "between them, or use finer meshes"
    )
