"""A target of the scene as one mesh in the world frame, with the picture on it."""

from dataclasses import dataclass, replace

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.atlas import atlas
from lfmesh.geometry.frame import frame
from lfmesh.geometry.mesh import Array, Mesh, facet_normals, joined
from lfmesh.geometry.mesh_file import Piece, load_mesh
from lfmesh.geometry.primitives import box_of_glass, primitive
from lfmesh.geometry.refractors import solid_mesh
from lfmesh.geometry.texture import Texture, load_texture
from lfmesh.geometry.vertex_normals import is_closed
from lfmesh.geometry.weld import welded
from lfmesh.scene import Scene, Target


@dataclass
class TargetMesh:
    """What the rays meet.

    Attributes
    ----------
    mesh : Mesh
        World frame, mm; no facet is without area.
    uv : (m, 3, 2) float64 or None
        Place of each facet's corners in the texture, 0..1: (0, 0) is the bottom left of the picture, (0, 1)
        the top left, where row 0 is. Repeats are unrolled, so a look-up need not wrap.
    texture : (h, w, 3) float32 or None
        Linear light, 0 to 1, that multiplies reflectance and radiance.
    alpha : (h, w) float32 or None
        Opacity on the same picture, where the material asks for it.
    closed : bool
        Watertight, outward-oriented: the target scatters and emits from its outside only; an open sheet does
        from both sides.
    """

    mesh: Mesh
    uv: Array | None
    texture: Texture | None
    closed: bool
    alpha: Texture | None = None


def target_mesh(target: Target, scene: Scene) -> TargetMesh:
    """Build a target's mesh and load its picture.

    The texture of the target's material replaces whatever colours its mesh file brings.

    Raises
    ------
    MeshError
        The mesh file is not usable, or a texture is given for a mesh without texture coordinates.
    FileError
        The texture is no picture.
    """
    if target.refractor is not None:
        glass = target.refractor
        if glass.box_mm is not None:
            body = box_of_glass(glass.box_mm)
        else:
            body = solid_mesh(scene.resolve(str(glass.file)), glass.units, glass.crease_deg)
        return TargetMesh(body.moved(frame(target.rotation_deg, target.position_mm)), None, None, True)
    with_alpha = target.material.opacity == "texture_alpha"
    if target.shape is not None:
        name = str(target.shape.kind)
        pieces = [Piece(*primitive(target.shape))]
    else:
        name = str(target.file)
        pieces = load_mesh(scene.resolve(name), target.units, with_alpha)
    if target.material.texture is not None:
        picture = load_texture(scene.resolve(target.material.texture), with_alpha)
        pieces = [_covered(piece, picture, name) for piece in pieces]
    pieces, closed = _oriented([replace(piece, mesh=welded(piece.mesh)) for piece in pieces])
    placed, texture = atlas(name, pieces)
    alpha = None
    if with_alpha:
        if texture is None or texture.shape[2] < 4 or (texture[..., 3] == 1.0).all():
            which = target.material.texture or name
            raise MeshError(f'{which}: is opaque all over, and opacity = "texture_alpha" asks for its alpha; omit it')
        texture, alpha = np.ascontiguousarray(texture[..., :3]), np.ascontiguousarray(texture[..., 3])
    mesh = joined(piece.mesh for piece in pieces)
    solid = facet_normals(mesh)[1] > 0.0
    if not solid.any():
        raise MeshError(f"{name}: none of its {len(solid)} facets has an area")
    mesh = Mesh(mesh.vertices, mesh.faces[solid]).moved(frame(target.rotation_deg, target.position_mm))
    return TargetMesh(mesh, placed[solid] if placed is not None else None, texture, closed, alpha)


def named_target(scene: Scene, number: int) -> str:
    """Return the name of a target in messages: its path in the scene file, and its own name or file."""
    target = scene.targets[number]
    own = target.name or (target.refractor.file if target.refractor is not None else target.file)
    return f"targets[{number}]" + (f" ({own})" if own else "")


def _covered(piece: Piece, picture: Texture, name: str) -> Piece:
    """Return the piece with the material's picture in place of its own colours."""
    if piece.uv is None:
        raise MeshError(
            f"{name}: the mesh has no texture coordinates, so its material's texture has no place on it; "
            "leave the texture out or export the mesh with UVs (OBJ, PLY, GLB)"
        )
    return Piece(piece.mesh, piece.uv, picture, np.ones(picture.shape[2]))


def _oriented(pieces: list[Piece]) -> tuple[list[Piece], bool]:
    """Turn closed pieces so that they face outwards; tell whether the whole is closed.

    A body may be closed piece by piece, or only as a whole where its materials meet along open rims.
    """
    volumes = [_enclosed(piece.mesh) for piece in pieces]
    if all(volumes):
        return [_turned(piece) if v < 0.0 else piece for piece, v in zip(pieces, volumes, strict=True)], True
    whole = _enclosed(welded(joined(piece.mesh for piece in pieces)))
    return [_turned(piece) for piece in pieces] if whole < 0.0 else pieces, whole != 0.0


def _enclosed(mesh: Mesh) -> float:
    """Return the volume of a closed mesh in mm³, negative where it faces inwards; 0 for an open one."""
    if not is_closed(mesh.faces):
        return 0.0
    # From the middle, so that a body far from its origin keeps its digits.
    a, b, c = np.moveaxis((mesh.vertices - mesh.vertices.mean(axis=0))[mesh.faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _turned(piece: Piece) -> Piece:
    """Return the piece with every facet looking the other way."""
    return replace(piece, mesh=piece.mesh.flipped(), uv=piece.uv[:, ::-1] if piece.uv is not None else None)
