"""Glass from mesh files: closed bodies with their normals, and the two optical faces of a lens element.

A face is traced as the exact surface that it lies on, if that is recognised. Otherwise an even polynomial in the
radius, fitted to its vertices, gives its vertex, curvature and asphere for the first-order optics.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import MeshError
from lfmesh.geometry import frame
from lfmesh.geometry.files.cad_file import STEP_ENDINGS
from lfmesh.geometry.files.mesh_file import load_mesh, surfaces_of_step
from lfmesh.geometry.lens.element_poses import pose_of
from lfmesh.geometry.meshes.kernel_mesh import mended
from lfmesh.geometry.meshes.mesh import Array, Mesh, facet_normals, joined
from lfmesh.geometry.meshes.patch import neighbours
from lfmesh.geometry.meshes.vertex_normals import edge_partners, estimated_corner_normals, smooth_edges, smooth_groups
from lfmesh.geometry.meshes.weld import welded
from lfmesh.geometry.surfaces.optical_face import ON_SURFACE, Form, Told, fitted_form, plane_through, told_form
from lfmesh.scene import Element, Lens, MeshFace, MeshShape, Pose, Scene, Surface
from lfmesh.scene.files import with_lens_file
from lfmesh.scene.inputs import file_stamp

RIM_MARGIN = 0.02
"""Relative distance of the clear aperture's edge inside the mesh's rim, if no aperture is given."""

FLAT_SHADED = 1e-3
"""Angle in rad within which a corner normal counts as the facet's own."""

STEEPEST_DEG = 30.0
"""Largest angle between a corner normal and its facet on a smooth surface."""

TURN_FACTOR, SLACK_DEG = 1.5, 5.0
"""Limit of a corner normal's angle to its facet: a multiple of the facet's angle to its neighbours, plus a slack."""

SLIVER = 1e-3
"""Height over length below which the normal of a facet is mostly rounding."""

MOST_ROUND_A_VERTEX = 64
"""Facets compared round a vertex; more form the fan of a flat or conical face."""

NO_POWER = 1e-9
"""Curvature times the rim's radius, a slope, below which a face is flat: less than the fit's rounding."""

SAME_NORMAL = 1e-6
"""Difference of unit normals above the rounding of float32."""

FIT_TERMS = 4
"""Even powers of the radius in the fit of a face: r², r⁴, r⁶, r⁸."""


@dataclass(frozen=True)
class Face:
    """Optical face of a lens element, in the mesh's own frame.

    Attributes
    ----------
    mesh : Mesh
        Facing +z, with corner normals.
    rim_mm : float
        Largest radius that the face covers all round.
    form : Form
        Exact surface, or its measured substitute.
    is_exact : bool
        The form replaces the whole mesh.
    """

    mesh: Mesh
    rim_mm: float
    form: Form
    is_exact: bool = False

    @property
    def vertex_z(self) -> float:
        """Intersection with the z axis, mm."""
        return self.form.vertex_z

    @property
    def radius_mm(self) -> float:
        """Radius of curvature at the vertex, in the section y–z."""
        return float(self.form.keys["radius_mm"])


def solid_mesh(
    path: Path,
    units: str | None,
    crease_deg: float | None,
    node: str | int | None = None,
    tolerance_mm: float | None = None,
) -> Mesh:
    """Load a closed body of glass: outward-oriented, with corner normals.

    They are estimated to second order if the file has none or only facet normals, or if `crease_deg` is given.

    Parameters
    ----------
    path : Path
    units : str, optional
        Required if the format carries none.
    crease_deg : float, optional
        Angle between facets above which their edge is a crease.
    node : str or int, optional
        Body to take from a file with several.
    tolerance_mm : float, optional
        Largest distance of a facet from its surface, for a STEP file.

    Raises
    ------
    MeshError
        The file cannot be used, its body is not closed, or its normals do not fit its facets.
    """
    pieces = [piece.mesh for piece in load_mesh(path, units, node=node, tolerance_mm=tolerance_mm)]
    brings_normals = all(piece.corner_normals is not None for piece in pieces)
    mesh = _closed(path, joined(pieces), brings_normals, "a refractor")
    if path.suffix.lower() in STEP_ENDINGS:
        mesh = mended(mesh)
    normals = _normals_of_file(path, mesh) if crease_deg is None else None
    if normals is None:
        normals = estimated_corner_normals(mesh, smooth_groups(mesh, smooth_edges(mesh, crease_deg)))
    return Mesh(mesh.vertices, mesh.faces, normals)


def bounding_mesh(
    path: Path, units: str | None, node: str | int | None = None, tolerance_mm: float | None = None
) -> Mesh:  # fmt: skip
    """Load a closed boundary mesh: outward-oriented, with flat facets.

    Parameters
    ----------
    path : Path
    units : str, optional
        Required if the format carries none.
    node : str or int, optional
        Body to take from a file with several.
    tolerance_mm : float, optional
        Largest distance of a facet from its surface, for a STEP file.

    Raises
    ------
    MeshError
        The file cannot be used, or its body is not closed.
    """
    path = path.resolve()
    return _bounding_mesh(path, file_stamp(path), units, node, tolerance_mm)


@lru_cache(maxsize=32)
def _bounding_mesh(
    path: Path, stamp: tuple[object, ...], units: str | None, node: str | int | None, tolerance_mm: float | None
) -> Mesh:  # fmt: skip
    pieces = load_mesh(path, units, node=node, tolerance_mm=tolerance_mm)
    return _closed(path, joined(piece.mesh for piece in pieces), False, "the boundary of a medium")


def _closed(path: Path, mesh: Mesh, keeps_normals: bool, what_it_is: str) -> Mesh:
    """Return a mesh welded, outward-oriented, and without facets of zero area.

    Raises
    ------
    MeshError
        The mesh is open, or encloses no volume.
    """
    import trimesh

    mesh = welded(mesh)
    with_area = facet_normals(mesh)[1] > 0.0
    if not with_area.any():
        raise MeshError(
            f"{path}: {what_it_is} must be a closed body; its facets have no area: "
            "all vertices lie in one point or on one line"
        )
    given = mesh.corner_normals[with_area] if mesh.corner_normals is not None and keeps_normals else None
    mesh = Mesh(mesh.vertices, mesh.faces[with_area], given)
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if not body.is_watertight or not body.is_winding_consistent:
        raise MeshError(f"{path}: {what_it_is} must be a closed body; {_fault_of(mesh)}; repair it and export it again")
    corners = mesh.vertices[np.unique(mesh.faces)]
    if np.linalg.matrix_rank(corners - corners.mean(axis=0)) < 3:
        raise MeshError(f"{path}: {what_it_is} must be a closed body; its facets all lie in one plane")
    return mesh.flipped() if body.volume < 0.0 else mesh


def _fault_of(mesh: Mesh) -> str:
    """Return the reason why a mesh is not closed or not consistently oriented."""
    doubled = len(mesh.faces) - len(np.unique(np.sort(mesh.faces, axis=1), axis=0))
    if doubled:
        twice = "is a duplicate" if doubled == 1 else "are duplicates"
        return f"{doubled} of its {len(mesh.faces)} facets {twice}: another one has the same corners"
    edges = np.sort(np.concatenate([mesh.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    joins = np.unique(edges, axis=0, return_counts=True)[1]
    if (joins == 1).any():
        return f"{(joins == 1).sum()} of its edges belong to only one facet"
    if (joins > 2).any():
        return f"{(joins > 2).sum()} of its edges join more than two facets"
    return "its facets do not all face one way"


def _normals_of_file(path: Path, mesh: Mesh) -> Array | None:
    """Return the file's unit corner normals; None if they equal the facets'."""
    if mesh.corner_normals is None:
        return None
    length = np.linalg.norm(mesh.corner_normals, axis=2, keepdims=True)
    no_direction = ~(np.isfinite(length) & (length > 0.0))
    normals = mesh.corner_normals / np.where(no_direction, 1.0, length)
    own = facet_normals(mesh)[0][:, None, :]
    behind = ~no_direction[..., 0] & ((normals * own).sum(axis=2) <= 0.0)
    too_far = _too_far_off(mesh, normals, own)
    for bad, what in (
        (no_direction, "have no direction"),
        (behind, "point to the wrong side of their facet"),
        (
            too_far,
            f"deviate more from their facet than on a smooth surface (at most {STEEPEST_DEG:g}°, and {TURN_FACTOR:g} "
            f"times its angle to the facets around that corner, plus {SLACK_DEG:g}°)",
        ),
    ):
        if bad.any():
            raise MeshError(
                f"{path}: {bad.sum()} of its {bad.size} corner normals {what}; export it with correct normals or "
                "without any, or give crease_deg to have them estimated"
            )
    tells_more = np.linalg.norm(normals - own, axis=2).max() > FLAT_SHADED
    return _without_seams(mesh.faces, np.asarray(normals)) if tells_more else None


def _without_seams(faces: NDArray[np.int64], normals: Array) -> Array:
    """Return corner normals (m, 3, 3) made equal across edges if they differ only by rounding.

    A CAD program closes a sphere at a seam and computes the normals of its two sides independently.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = edge_partners(faces)
    f, e = np.divmod(first, 3)
    g, h = np.divmod(second, 3)
    # The partner runs the other way: its end is this edge's start.
    one = np.concatenate([3 * f + e, 3 * f + (e + 1) % 3])
    other = np.concatenate([3 * g + (h + 1) % 3, 3 * g + h])
    each = normals.reshape(-1, 3)
    alike = np.linalg.norm(each[one] - each[other], axis=1) <= SAME_NORMAL
    links = coo_array((np.ones(alike.sum()), (one[alike], other[alike])), shape=(len(each), len(each)))
    group = connected_components(links, directed=False)[1]
    _, leader = np.unique(group, return_index=True)
    return np.asarray(each[leader[group]].reshape(normals.shape))


def _too_far_off(mesh: Mesh, normals: Array, own: Array) -> NDArray[np.bool_]:
    """Return an (m, 3) mask of corner normals that no smooth surface through the mesh's vertices can have.

    Between a corner and its facet, a surface turns no more than the mesh does between that facet and the others round
    the corner, plus a slack for uneven facets. Slivers, with their unreliable normals, are left out.
    """
    angle = _angle(normals, own)
    height2 = 2.0 * facet_normals(mesh)[1]
    longest = np.linalg.norm(mesh.vertices[np.roll(mesh.faces, -1, axis=1)] - mesh.vertices[mesh.faces], axis=2).max(
        axis=1
    )
    is_sliver = height2 < SLIVER * longest * longest
    turn = np.zeros_like(angle)
    corner = mesh.faces.ravel()
    order = np.argsort(corner, kind="stable")
    facet = order // 3
    # Round every vertex, compare each facet with the k-th after it, for all k.
    starts = np.searchsorted(corner[order], np.arange(len(mesh.vertices) + 1))
    count = np.diff(starts)[corner[order]]
    first = starts[:-1][corner[order]]
    place = np.arange(len(order)) - first
    for k in range(1, min(int(count.max(initial=0)), MOST_ROUND_A_VERTEX)):
        partner = facet[first + (place + k) % count]
        turn.reshape(-1)[order] = np.maximum(turn.reshape(-1)[order], _angle(own[facet, 0], own[partner, 0]))
    allowed = np.minimum(TURN_FACTOR * turn + np.deg2rad(SLACK_DEG), np.deg2rad(STEEPEST_DEG))
    return np.asarray((angle > allowed) & ~is_sliver[:, None])


def _angle(a: Array, b: Array) -> Array:
    """Return the angle between unit vectors along the last axis, from its half, to keep the digits of small angles."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(a - b, axis=-1), 1.0)))


@lru_cache(maxsize=32)
def _faces(path: Path, stamp: tuple[object, ...], shape: MeshShape) -> tuple[Face, Face]:
    mesh = solid_mesh(path, shape.units, shape.crease_deg, shape.node, shape.tolerance_mm)
    assert mesh.corner_normals is not None
    groups = smooth_groups(mesh, neighbours(mesh.faces, mesh.corner_normals) >= 0)
    z, facets = _axis_crossings(mesh)
    if len(z) < 2:
        raise MeshError(f"{path}: its z axis, which must be the axis of the lens, does not pass through the body")
    told = None
    if shape.surface == "exact" and path.suffix.lower() in STEP_ENDINGS:
        told = surfaces_of_step(path, shape.node, shape.tolerance_mm)
    front, back = _side(mesh, groups, facets[0], -1.0), _side(mesh, groups, facets[-1], 1.0)
    return _face(path, front, shape, told), _face(path, back, shape, told)


def _face(path: Path, side: Mesh, shape: MeshShape, told: list[Told] | None) -> Face:
    """Return a face with the exact surface that it lies on, or with a form fitted to its facets."""
    if shape.surface != "exact":
        return _fitted(path, side, f'surface = "{shape.surface}" asks for facets')
    points = side.vertices[np.unique(side.faces)]
    form, why_not = fitted_form(points) if told is None else told_form(points, told)
    return _fitted(path, side, why_not) if form is None else Face(side, _round_rim(side), form, True)


def _round_rim(side: Mesh) -> float:
    """Return the rim's radius, from its vertices if they lie on a circle, as its edges run inside it."""
    border = np.linalg.norm(side.vertices[_border(side).ravel(), :2], axis=1)
    is_circle = np.ptp(border) <= ON_SURFACE * border.max()
    return float(border.mean()) if is_circle else _rim(side)


def faces(shape: MeshShape, scene: Scene) -> tuple[Face, Face]:
    """Return the front and the back face of a lens element given as a mesh."""
    path = scene.resolve(str(shape.file)).resolve()
    # The material does not count, so that both faces and their element share a cache entry.
    only = MeshShape(**shape.model_dump(include=set(MeshShape.model_fields)))
    return _faces(path, file_stamp(path), only)


def face_of(shape: MeshFace, scene: Scene) -> Face:
    """Return the face that a lens surface's mesh names."""
    return faces(shape, scene)[0 if shape.side == "front" else 1]


def _axis_crossings(mesh: Mesh) -> tuple[Array, list[int]]:
    """Return the z of the z axis's crossings with the mesh, in order, and the facets crossed."""
    corner = mesh.vertices[mesh.faces]
    x, y = corner[:, :, 0], corner[:, :, 1]
    cross = x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y
    scale = np.abs(mesh.vertices[:, :2]).max() ** 2 * 1e-12
    within = (cross >= -scale).all(axis=1) | (cross <= scale).all(axis=1)
    total = cross.sum(axis=1)
    found = np.flatnonzero(within & (np.abs(total) > scale))
    # Weights of the corners opposite to each edge.
    weight = np.roll(cross[found], -1, axis=1) / total[found, None]
    z = (weight * corner[found][:, :, 2]).sum(axis=1)
    order = np.argsort(z)
    return z[order], [int(f) for f in found[order]]


def _side(mesh: Mesh, groups: np.ndarray, facet: int, outward: float) -> Mesh:
    """Return the smooth face round a facet, limited to facets that look the same way along z."""
    normals, _ = facet_normals(mesh)
    chosen = np.flatnonzero((groups == groups[facet]) & (normals[:, 2] * outward > 0.05))
    part = welded(Mesh(mesh.vertices, mesh.faces[chosen], None))
    assert mesh.corner_normals is not None
    side = Mesh(part.vertices, part.faces, mesh.corner_normals[chosen])
    return side.flipped() if outward < 0.0 else side


def _fitted(path: Path, side: Mesh, why: str) -> Face:
    """Return a face that remains facets, with fitted vertex, curvature and asphere, and the reason."""
    used = np.unique(side.faces)
    r2 = np.square(side.vertices[used, :2]).sum(axis=1)
    rim = _rim(side)
    flat = plane_through(side.vertices[used])
    if flat is not None:
        # All its vertices may lie on the rim.
        return Face(side, rim, Form(flat, {"radius_mm": np.inf}, words=why))
    near = r2 <= rim * rim * (1 + 1e-9)
    if near.sum() < FIT_TERMS + 2:
        raise MeshError(f"{path}: the face on its axis has only {near.sum()} vertices; mesh it more finely")
    scale = rim * rim
    u = r2[near] / scale
    basis = np.stack([u**k for k in range(FIT_TERMS + 1)], axis=1)
    coefficients, *_ = np.linalg.lstsq(basis, side.vertices[used][near, 2], rcond=None)
    a = coefficients[1:] / scale ** np.arange(1, FIT_TERMS + 1)
    curvature = 2.0 * float(a[0])
    radius = 1.0 / curvature if abs(curvature) * rim > NO_POWER else float("inf")
    # The asphere is the fit minus the sphere's own r⁴, r⁶, r⁸.
    c = 0.0 if np.isinf(radius) else curvature
    sphere = np.array([c**3 / 8.0, c**5 / 16.0, 5.0 * c**7 / 128.0])
    terms = tuple(float(t) for t in a[1:] - sphere)
    return Face(side, rim, Form(float(coefficients[0]), {"radius_mm": radius, "asphere_mm": terms}, words=why))


def _border(mesh: Mesh) -> Array:
    """Return the vertices (e, 2) of the edges that bound a face."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    key = edges[:, 0] * (len(mesh.vertices) + 1) + edges[:, 1]
    back = edges[:, 1] * (len(mesh.vertices) + 1) + edges[:, 0]
    return np.asarray(edges[~np.isin(key, back)])


def _rim(mesh: Mesh) -> float:
    """Return the radius of the largest circle about the axis that a face covers."""
    border = _border(mesh)
    a, b = mesh.vertices[border[:, 0], :2], mesh.vertices[border[:, 1], :2]
    d = b - a
    share = np.clip(-(a * d).sum(axis=1) / np.maximum((d * d).sum(axis=1), np.finfo(np.float64).tiny), 0.0, 1.0)
    return float(np.linalg.norm(a + share[:, None] * d, axis=1).min())


def measured(scene: Scene) -> Scene:
    """Return the scene with every refractor of the lens replaced by its two faces, measured on its mesh."""
    lens = with_lens_file(scene.camera.lens, scene.folder)
    if all(s.refractor is None for s in lens.surfaces):
        return scene
    surfaces: list[Surface] = []
    turns: dict[int, float] = {}
    for surface in lens.surfaces:
        refractor = surface.refractor
        if refractor is None:
            surfaces.append(surface)
            continue
        front, back = faces(refractor, scene)
        shape = refractor.model_dump(include=set(MeshShape.model_fields))
        for face, side in ((front, "front"), (back, "back")):
            aperture = surface.semi_diameter_mm or face.rim_mm
            largest = face.rim_mm if face.is_exact else (1.0 - RIM_MARGIN) * face.rim_mm
            if face.form.azimuth_deg:
                turns[len(surfaces)] = face.form.azimuth_deg
            surfaces.append(
                Surface(
                    **face.form.keys,
                    thickness_mm=back.vertex_z - front.vertex_z if side == "front" else surface.thickness_mm,
                    index=refractor.index if side == "front" else None,
                    glass=refractor.glass if side == "front" else None,
                    coating=refractor.coating,
                    finish=refractor.finish,
                    semi_diameter_mm=min(aperture, largest),
                    mesh=None if face.is_exact else MeshFace(**shape, side=side),
                )
            )
    first = [0, *np.cumsum([1 if s.refractor is None else 2 for s in lens.surfaces]).tolist()]
    elements = [
        Element(surfaces=tuple(n for i in e.surfaces for n in range(first[i], first[i + 1])), pose=e.pose)
        for e in lens.elements
    ]
    given = lens.model_dump(exclude={"surfaces", "file", "elements"})
    new = Lens(**given, surfaces=tuple(surfaces), elements=tuple(elements))
    if turns:
        new = new.model_copy(update={"elements": _turned(new, turns)})
    camera = scene.camera.model_copy(update={"lens": new})
    copy = scene.model_copy(update={"camera": camera})
    return copy.in_folder(scene.folder)


def _turned(lens: Lens, turns: dict[int, float]) -> tuple[Element, ...]:
    """Return the elements of a lens, with surfaces turned about their own axes by `turns`, degrees by surface number.

    An element with a turned surface is split into one element for each of its surfaces.
    """
    kept = [element for element in lens.elements if not any(number in turns for number in element.surfaces)]
    split = {n for element in lens.elements if element not in kept for n in element.surfaces} | set(turns)
    return (*kept, *(_alone(lens, number, turns.get(number, 0.0)) for number in sorted(split)))


def _alone(lens: Lens, number: int, turn_deg: float) -> Element:
    """Return a surface as an element of its own, in place, turned about its own axis."""
    stands = pose_of(lens, number)
    turned = stands[:, :3] @ frame.rotation((0.0, 0.0, turn_deg))
    vertex = np.array([0.0, 0.0, lens.vertices_mm[number]])
    shift = frame.points(stands, [vertex])[0] - vertex
    shift_mm = (float(shift[0]), float(shift[1]), float(shift[2]))
    return Element(surfaces=(number,), pose=Pose(shift_mm=shift_mm, tilt_deg=frame.tilt_of(turned)))


def face_lines(scene: Scene) -> list[str]:
    """Describe the form traced for each face of the lens's mesh elements, and the reason, for an unmeasured scene."""
    lens = with_lens_file(scene.camera.lens, scene.folder)
    lines, number = [], 0
    for surface in lens.surfaces:
        if surface.refractor is None:
            number += 1
            continue
        for face in faces(surface.refractor, scene):
            way = "exact, " if face.is_exact else "facets: "
            lines.append(f"surface {number:<15}{way}{face.form.words}")
            number += 1
    return lines
