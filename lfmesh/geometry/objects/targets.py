"""Targets of a scene, each as a mesh or round surface in the world frame with its picture."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError, MeshError
from lfmesh.geometry.files.mesh_file import FARTHEST_MM, UNIT_OF_FORMAT, load_mesh
from lfmesh.geometry.files.piece import Piece
from lfmesh.geometry.frame import frame, points
from lfmesh.geometry.meshes.mesh import (
    Array,
    Index,
    Mesh,
    distance_mm,
    facet_corner_normals,
    facet_normals,
    joined,
)
from lfmesh.geometry.meshes.vertex_normals import is_closed
from lfmesh.geometry.meshes.weld import welded
from lfmesh.geometry.meshes.winding import winding
from lfmesh.geometry.objects.atlas import atlas
from lfmesh.geometry.objects.gloss_pictures import GlossOnFacets, gloss_on_facets, without_even_gloss
from lfmesh.geometry.objects.primitives import Primitive, primitive, solid_of_glass
from lfmesh.geometry.objects.refractors import solid_mesh
from lfmesh.geometry.objects.round_body import ROUND_SHAPES, RoundBody
from lfmesh.geometry.objects.texture import Texture, load_texture
from lfmesh.geometry.objects.vertex_colours import with_colours_as_picture
from lfmesh.optics.gltf_material import GltfMaterial
from lfmesh.scene import Scene, Target
from lfmesh.scene.objects.shapes import Disk, Plane, Shape

STEEPEST_DEG = 45.0
"""Largest angle between a vertex normal of a mesh file and its facet's; beyond it, a program averaged a sharp edge."""

NO_FACETS = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64))

FLAT = 1e-5
"""Angle in rad between a vertex normal and its facet's that float32 leaves on flat facets."""


@dataclass
class TargetMesh:
    """Surface of a target.

    Attributes
    ----------
    surface : Primitive or RoundBody
        Mesh in the world frame, mm, without facets of zero area; or a round surface that rays meet exactly.
    texture : (h, w, 3) float32 or None
        Linear light, 0 to 1, that multiplies reflectance and radiance.
    alpha : (h, w) float32 or None
        Opacity on the same picture, if the material asks for it.
    materials : tuple of GltfMaterial
        Materials of the mesh file, if they replace the scene's.
    material_of : (m,) int64 or None
        Index in `materials` of each facet; -1: the scene's material. With varying gloss, the first material spanned.
    gloss : GlossOnFacets or None
        Metallic and roughness by a picture, if the file's materials have one.
    smooth : bool
        Shaded with the mesh's corner normals.
    closed : bool
        Watertight, outward-oriented: the target scatters and emits from its outside only. An open sheet does so on
        both sides.
    """

    surface: Primitive | RoundBody
    texture: Texture | None
    closed: bool
    alpha: Texture | None = None
    materials: tuple[GltfMaterial, ...] = ()
    material_of: Index | None = None
    gloss: GlossOnFacets | None = None
    smooth: bool = False

    @property
    def round(self) -> RoundBody | None:
        """Round surface that rays meet exactly; None if they meet the mesh."""
        return self.surface if isinstance(self.surface, RoundBody) else None

    @property
    def mesh(self) -> Mesh:
        """Mesh in the world frame, mm; the vertices of a round surface's mesh lie on it."""
        return self.surface.meshed().mesh if isinstance(self.surface, RoundBody) else self.surface.mesh

    @property
    def uv(self) -> Array | None:
        """Texture coordinates (m, 3, 2) of each facet's corners, 0..1, repeats unrolled; None if there are none.

        (0, 0) is the bottom left of the picture, (0, 1) the top left, at row 0.
        """
        return self.surface.meshed().uv if isinstance(self.surface, RoundBody) else self.surface.uv

    @property
    def met_mesh(self) -> Mesh:
        """Mesh that rays meet; empty if they meet a round surface."""
        return NO_FACETS if isinstance(self.surface, RoundBody) else self.surface.mesh

    @property
    def hull(self) -> Mesh:
        """Mesh of some hundred facets that encloses a round surface; otherwise the mesh itself."""
        return self.surface.hull() if isinstance(self.surface, RoundBody) else self.surface.mesh

    @property
    def box_mm(self) -> Array:
        """Lowest and highest corner of the bounding box, (2, 3), world frame."""
        if isinstance(self.surface, RoundBody):
            return self.surface.box_mm()
        vertices = self.surface.mesh.vertices
        return np.array([vertices.min(axis=0), vertices.max(axis=0)])

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Tell which world-frame points (n, 3) lie inside a closed body."""
        if isinstance(self.surface, RoundBody):
            return self.surface.holds(points)
        return winding(self.mesh.vertices[self.mesh.faces], points) != 0

    def distance_mm(self, point: Array) -> float:
        """Return the distance of a world-frame point (3,) from the surface, mm."""
        if isinstance(self.surface, RoundBody):
            return float(self.surface.distance_mm(point))
        return distance_mm(self.mesh.vertices[self.mesh.faces], point)


def target_body(target: Target, scene: Scene) -> TargetMesh:
    """Build a target as rays meet it: round shapes exactly, all others by a mesh.

    Raises
    ------
    MeshError, FileError
        As for `target_mesh`.
    """
    shape = _shape_of(target)
    if not isinstance(shape, ROUND_SHAPES) or not is_met_exactly(target, scene):
        return target_mesh(target, scene)
    texture, alpha, place = None, None, np.array([[0.0, 0.0], [1.0, 1.0]])
    asks_alpha = target.material.opacity == "texture_alpha"
    if target.material.texture is not None:
        name = str(shape.kind)
        picture = _picture(target, scene, asks_alpha)
        # The picture's corners lie in the texture as on a rectangle.
        placed, texture = atlas(name, [_covered(Piece(*primitive(Plane(width_mm=1.0, height_mm=1.0))), picture, name)])
        if placed is not None:
            place = np.array([placed[0, 0], placed[0, 2] - placed[0, 0]])
        texture, alpha = _parted(texture)
    if asks_alpha and alpha is None:
        _refuse_opaque(target, str(shape.kind))
    body = RoundBody(shape, frame(target.rotation_deg, target.position_mm), place)
    _refuse_too_far(target, body.box_mm())
    return TargetMesh(body, texture, not isinstance(shape, Disk), alpha)


def is_met_exactly(target: Target, scene: Scene) -> bool:
    """Tell whether rays meet a target's exact round surface instead of a mesh."""
    of_target = "exact" if target.refractor is None else target.refractor.surface
    return scene.transport.surface == of_target == "exact" and isinstance(_shape_of(target), ROUND_SHAPES)


def _shape_of(target: Target) -> Shape | None:
    """Return the primitive shape of a target, of glass or not; None if it comes from a mesh file."""
    return target.shape if target.refractor is None else target.refractor.solid


def _parted(texture: Texture | None) -> tuple[Texture | None, Texture | None]:
    """Return the colours of a picture and its alpha; None for an alpha that is missing or 1 all over."""
    if texture is None or texture.shape[2] < 4:
        return texture, None
    alpha = np.ascontiguousarray(texture[..., 3])
    return np.ascontiguousarray(texture[..., :3]), None if (alpha == 1.0).all() else alpha


def _refuse_opaque(target: Target, name: str) -> NoReturn:
    """Refuse a target that takes its opacity from a picture without alpha."""
    which = target.material.texture or name
    raise MeshError(f'{which}: is opaque everywhere, but opacity = "texture_alpha" needs its alpha; omit it')


def target_mesh(target: Target, scene: Scene) -> TargetMesh:
    """Build a target's mesh and load its picture.

    The texture of the target's material replaces any colours from its mesh file. If the scene gives the target no
    material, all materials of a glTF file are taken over.

    Raises
    ------
    MeshError
        The mesh file cannot be used, or a texture is given for a mesh without texture coordinates.
    FileError
        The texture is no picture.
    """
    if target.refractor is not None:
        glass = target.refractor
        if glass.solid is not None:
            body = solid_of_glass(glass.solid)
        else:
            body = solid_mesh(
                scene.resolve(str(glass.file)), glass.units, glass.crease_deg, glass.node, glass.tolerance_mm
            )
        return TargetMesh(Primitive(_stood(body, target), None), None, True)
    asks_alpha = target.material.opacity == "texture_alpha"
    taken = False
    if target.shape is not None:
        name = str(target.shape.kind)
        pieces = [Piece(*primitive(target.shape))]
    else:
        name = str(target.file)
        may_take = target.takes_materials and Path(name).suffix.lower() in UNIT_OF_FORMAT
        pieces = load_mesh(scene.resolve(name), target.units, asks_alpha or may_take, target.node, target.tolerance_mm)
        taken = may_take and any(piece.material is not None for piece in pieces)
        if target.materials == "file" and not taken:
            raise MeshError(f'{name}: has no glTF materials, but materials = "file" needs them; omit it')
        if taken:
            pieces = [without_even_gloss(piece) for piece in _with_alpha_by_mode(pieces)]
        elif may_take:
            pieces = [_opaque(piece) for piece in pieces]
        elif target.materials == "ignore":
            pieces = [replace(piece, picture=None, factor=np.ones(len(piece.factor)), colours=None) for piece in pieces]
    with_alpha = asks_alpha or taken
    if target.material.texture is not None:
        picture = _picture(target, scene, with_alpha)
        pieces = [_covered(piece, picture, name) for piece in pieces]
    pieces = [with_colours_as_picture(piece) for piece in pieces]
    pieces, closed = _oriented([replace(piece, mesh=welded(piece.mesh)) for piece in pieces])
    placed, texture = atlas(name, pieces)
    alpha = None
    if with_alpha and texture is not None and texture.shape[2] == 4:
        texture, alpha = _parted(texture)
        if taken and texture is not None and (texture == 1.0).all() and alpha is None:
            texture = None
    if asks_alpha and alpha is None:
        _refuse_opaque(target, name)
    if target.file is None or target.normals == "facets":
        pieces = [replace(piece, mesh=replace(piece.mesh, corner_normals=None)) for piece in pieces]
    mesh = joined(piece.mesh for piece in pieces)
    at_corners = _shading_normals(mesh)
    solid = facet_normals(mesh)[1] > 0.0
    if not solid.any():
        raise MeshError(f"{name}: none of its {len(solid)} facets has an area")
    mesh = Mesh(mesh.vertices, mesh.faces[solid], at_corners[solid] if at_corners is not None else None)
    mesh = _stood(mesh, target)
    placed = placed[solid] if placed is not None else None
    made = TargetMesh(Primitive(mesh, placed), texture, closed, alpha, smooth=at_corners is not None)
    if taken:
        _take_materials(made, name, pieces, solid)
    return made


def _take_materials(made: TargetMesh, name: str, pieces: list[Piece], solid: NDArray[np.bool_]) -> None:
    """Give a target, made of the `solid` facets of some pieces, the materials of the pieces."""
    gloss = gloss_on_facets(name, pieces)
    materials = [None if piece.gloss is not None else piece.material for piece in pieces]
    spanned = [each.materials for each in gloss.ranges] if gloss is not None else []
    made.materials = tuple(
        dict.fromkeys([each for each in materials if each is not None] + [each for some in spanned for each in some])
    )
    number = {None: -1} | {each: i for i, each in enumerate(made.materials)}
    of_facets = np.repeat([number[each] for each in materials], [len(piece.mesh.faces) for piece in pieces])
    if gloss is not None:
        firsts = np.array([number[some[0]] for some in spanned])
        of_facets = np.where(gloss.range_of < 0, of_facets, firsts[gloss.range_of])
        made.gloss = gloss.of(solid)
    made.material_of = of_facets[solid]


def _stood(mesh: Mesh, target: Target) -> Mesh:
    """Return a target's mesh in the world: scaled, turned, and placed by its anchor.

    Raises
    ------
    MeshError
        The scaled target exceeds the largest scene.
    """
    scale = 1.0 if target.scale is None else target.scale
    if scale != 1.0:
        mesh = replace(mesh, vertices=mesh.vertices * scale)
    corners = mesh.vertices[np.unique(mesh.faces)] if target.anchor not in (None, "origin") else mesh.vertices
    made = mesh.moved(frame(target.rotation_deg, origin_mm(target, corners)))
    if np.abs(made.vertices).max() > FARTHEST_MM:
        _refuse_too_far(target, made.vertices[made.faces])
    return made


def origin_mm(target: Target, corners: Array) -> tuple[float, float, float]:
    """Return the position of a target's own origin in the world, at which its anchor lies at `position_mm`.

    Parameters
    ----------
    target : Target
    corners : (n, 3) float64, mm
        Corners of its facets in its own frame, scaled.
    """
    if target.anchor in (None, "origin"):
        return target.position_mm
    middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    turn = frame(target.rotation_deg, (0.0, 0.0, 0.0))
    point = points(turn, middle[None])[0]
    if target.anchor == "base":
        turned = points(turn, corners - middle)
        low, high = turned.min(axis=0), turned.max(axis=0)
        point = np.add(point, [0.5 * (low[0] + high[0]), low[1], 0.5 * (low[2] + high[2])])
    x, y, z = np.subtract(target.position_mm, point).tolist()
    return x, y, z


def _refuse_too_far(target: Target, corners: Array) -> None:
    """Refuse a target with corners, mm, beyond the limit of a scene."""
    if np.abs(corners).max() > FARTHEST_MM:
        scale = 1.0 if target.scale is None else target.scale
        raise MeshError(
            f"{target.name or target.file or 'a target'}: scale = {scale:g} puts it beyond {FARTHEST_MM:g} mm"
        )


def _opaque(piece: Piece) -> Piece:
    """Return a piece without the alpha of its plain colours."""
    return replace(
        piece, factor=piece.factor[:3], colours=piece.colours[..., :3] if piece.colours is not None else None
    )


def _with_alpha_by_mode(pieces: list[Piece]) -> list[Piece]:
    """Return pieces coloured by their material alone, with its opacity (by glTF alpha mode) as alpha."""
    made = []
    pictures: dict[tuple[int, str, float, float], Texture] = {}
    for piece in pieces:
        if piece.material is None:
            made.append(replace(piece, picture=None, factor=np.ones(4)))
            continue
        mode, cutoff, alpha = piece.alpha_mode, piece.alpha_cutoff, float(piece.factor[3])
        picture = piece.picture
        if mode != "BLEND" and picture is not None:
            key = (id(picture), mode, cutoff, alpha)
            if key not in pictures:
                there = picture[..., 3:] * alpha >= cutoff if mode == "MASK" else np.ones_like(picture[..., 3:])
                pictures[key] = np.concatenate([picture[..., :3], there], axis=2, dtype=np.float32)
            picture, alpha = pictures[key], 1.0
        elif mode != "BLEND":
            alpha = float(mode == "OPAQUE" or alpha >= cutoff)
        made.append(replace(piece, picture=picture, factor=np.array([1.0, 1.0, 1.0, alpha])))
    return made


def _shading_normals(mesh: Mesh) -> Array | None:
    """Return the unit normals at the facets' corners, on their own side; None if they are the facets' own.

    The facet's normal replaces an invalid one, or one more than `STEEPEST_DEG` off the facet.
    """
    if mesh.corner_normals is None:
        return None
    facet = facet_corner_normals(mesh)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        normals = mesh.corner_normals / np.linalg.norm(mesh.corner_normals, axis=2, keepdims=True)
        cosine = np.einsum("fci,fci->fc", normals, facet)[..., None]
        normals = np.where(
            np.abs(cosine) >= np.cos(np.deg2rad(STEEPEST_DEG)), np.copysign(1.0, cosine) * normals, facet
        )
    return normals if np.abs(normals - facet).max(initial=0.0) > FLAT else None


def _picture(target: Target, scene: Scene, alpha: bool) -> Texture:
    try:
        return load_texture(scene.resolve(str(target.material.texture)), alpha)
    except FileError as error:
        number = next((i for i, each in enumerate(scene.targets) if each is target), None)
        which = "" if number is None else f"targets[{number}]."
        raise FileError(f"{which}material.texture: {error}") from None


def named_target(scene: Scene, number: int) -> str:
    """Return the name of a target for messages: its path in the scene file, and its own name or file."""
    target = scene.targets[number]
    own = target.name or (target.refractor.file if target.refractor is not None else target.file)
    return f"targets[{number}]" + (f" ({own})" if own else "")


def _covered(piece: Piece, picture: Texture, name: str) -> Piece:
    """Return the piece with its colours replaced by the material's picture."""
    if piece.uv is None:
        raise MeshError(
            f"{name}: the mesh has no texture coordinates, so its material's texture cannot be placed on it; "
            "omit the texture, or export the mesh with UVs (OBJ, PLY, GLB)"
        )
    return Piece(piece.mesh, piece.uv, picture=picture, factor=np.ones(picture.shape[2]))


def _oriented(pieces: list[Piece]) -> tuple[list[Piece], bool]:
    """Turn closed pieces to face outwards; tell whether the whole body is closed.

    A body may be closed piece by piece, or only as a whole if its materials meet along open rims.
    """
    volumes = [_enclosed(piece.mesh) for piece in pieces]
    if all(volumes):
        return [_turned(piece) if v < 0.0 else piece for piece, v in zip(pieces, volumes, strict=True)], True
    whole = _enclosed(welded(joined(piece.mesh for piece in pieces))) if len(pieces) > 1 else volumes[0]
    return [_turned(piece) for piece in pieces] if whole < 0.0 else pieces, whole != 0.0


def _enclosed(mesh: Mesh) -> float:
    """Return the volume of a closed mesh in mm³, negative where it faces inwards; 0 for an open one."""
    if not is_closed(mesh.faces):
        return 0.0
    # Relative to the mean vertex, so that a body far from its origin keeps its digits.
    a, b, c = np.moveaxis((mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _turned(piece: Piece) -> Piece:
    """Return the piece with every facet flipped."""
    return piece.with_mesh_turned(piece.mesh.flipped())
