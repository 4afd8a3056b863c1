"""A part of a mesh file with one material, and what its reader says of the file."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.texture import Texture
from lfmesh.optics.gltf_material import GltfMaterial

REPEAT = ("repeat", "repeat")


class GlossPicture(NamedTuple):
    """Picture of metallic and roughness on a piece.

    Attributes
    ----------
    picture : (h, w, 3) float32
        As coded, 0..1: the factors of roughness in its second channel, of metallic in its third.
    uv : (m, 3, 2) float64
        As `Piece.uv`.
    wrap : tuple of str
        As `Look.wrap`.
    """

    picture: Texture
    uv: Array
    wrap: tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Look:
    """Colours and material that a mesh file gives facets.

    Attributes
    ----------
    picture : (h, w, 3) float32 or None
        Base colour texture, linear light; (h, w, 4) with its alpha.
    factor : (3,) float64
        Base colour, linear, that multiplies the picture; (4,) with its alpha.
    material : GltfMaterial or None
        What else a glTF file says of the surface.
    alpha_mode : str
        "OPAQUE": the alpha does not count; "MASK": the surface is there where it is at least `alpha_cutoff`; "BLEND":
        it is the surface's opacity.
    wrap : tuple of str
        Across and down, what the picture shows outside 0..1: "repeat", "mirror" (every other repeat is mirrored) or
        "clamp" (its edge goes on).
    """

    picture: Texture | None = None
    factor: Array = field(default_factory=lambda: np.ones(3))
    material: GltfMaterial | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    wrap: tuple[str, str] = REPEAT


@dataclass(frozen=True)
class Piece(Look):
    """A part of a mesh file with one material.

    Attributes
    ----------
    mesh : Mesh
        In the file's frame, mm; with corner normals only where the file itself gives them (OBJ, PLY, OFF, GLB), of
        whatever length and sense it gives.
    uv : (m, 3, 2) float64 or None
        Place in the picture of each facet's corners; (0, 0) is its bottom left; `wrap` tells what lies outside 0..1.
    gloss : GlossPicture or None
        Multiplies metallic and roughness of `material`.
    colours : (m, 3, 3) float64 or None
        Colours at each facet's corners, linear, that multiply the factor; (m, 3, 4) with their alpha.
    called : str
        The material in the file; "" where it has none.
    """

    mesh: Mesh
    uv: Array | None = None
    gloss: GlossPicture | None = None
    colours: Array | None = None
    called: str = ""

    def placed(self, transform: Array, scale: float) -> "Piece":
        """Return the piece where its file's scene places it, in mm.

        Parameters
        ----------
        transform : (4, 4) float64
            Affine, in the file's unit.
        scale : float
            The file's unit, mm.
        """
        vertices, faces, normals = self.mesh.vertices, self.mesh.faces, self.mesh.corner_normals
        linear = transform[:3, :3]
        if not np.array_equal(transform, np.eye(4)):
            # Coordinate by coordinate: a matrix product may round equal vertices differently and open their seam.
            with np.errstate(invalid="ignore", over="ignore"):
                vertices = transform[:3, 3] + sum(vertices[:, [k]] * transform[:3, k] for k in range(3))
            if normals is not None and not np.array_equal(linear, np.eye(3)):
                # Normals stand square to what the transform makes of the tangents: the cofactors carry them, but for
                # their length. A mirror turns the cofactors' sense, and leaves the outside of the body outside.
                cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
                with np.errstate(invalid="ignore", over="ignore"):
                    normals = np.copysign(1.0, np.linalg.det(linear)) * normals @ cofactors.T
        made = replace(self, mesh=Mesh(vertices * scale, faces, normals))
        return made.turned() if np.linalg.det(linear) < 0.0 else made

    def with_channels(self, channels: int) -> "Piece":
        """Return the piece with colours of so many channels: with the alpha or without it, opaque where it has none.

        Parameters
        ----------
        channels : int
            3 or 4.
        """
        colours = self.colours
        if colours is not None and colours.shape[2] != channels:
            colours = np.concatenate([colours, np.ones((*colours.shape[:2], 1))], axis=2)[..., :channels]
        return replace(self, factor=np.append(self.factor, 1.0)[:channels], colours=colours)

    def turned(self) -> "Piece":
        """Return the piece with the corners of each facet in the opposite order; its normals stay as they are."""
        mesh = self.mesh
        normals = mesh.corner_normals[:, ::-1] if mesh.corner_normals is not None else None
        return self.with_mesh_turned(Mesh(mesh.vertices, mesh.faces[:, ::-1], normals))

    def with_mesh_turned(self, mesh: Mesh) -> "Piece":
        """Return the piece on its mesh with the corners of each facet in the opposite order.

        Parameters
        ----------
        mesh : Mesh
            In that order.
        """
        return replace(
            self,
            mesh=mesh,
            uv=self.uv[:, ::-1] if self.uv is not None else None,
            gloss=self.gloss._replace(uv=self.gloss.uv[:, ::-1]) if self.gloss is not None else None,
            colours=self.colours[:, ::-1] if self.colours is not None else None,
        )


@dataclass
class Notes:
    """Differences between a mesh file and its pieces, in words, each said once, in the order of reading."""

    texts: dict[str, None] = field(default_factory=dict)

    def add(self, text: str) -> None:
        """Enter a difference: a clause that follows the file's name."""
        self.texts[text] = None

    def count(self, number: int, text: str) -> None:
        """Enter a difference that so many things have; nothing where none has it.

        Parameters
        ----------
        number : int
        text : str
            With `{}` in place of the number.
        """
        if number:
            self.add(text.format(f"{number:,}"))
