"""A part of a mesh file with one material, and the notes of its reader."""

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
        As coded, 0..1: factors of roughness in the second channel, of metallic in the third.
    uv : (m, 3, 2) float64
        See `Piece.uv`.
    wrap : tuple of str
        See `Look.wrap`.
    """

    picture: Texture
    uv: Array
    wrap: tuple[str, str]


@dataclass(frozen=True, kw_only=True)
class Look:
    """Colours and material of facets in a mesh file.

    Attributes
    ----------
    picture : (h, w, 3) float32 or None
        Base colour texture, linear light; (h, w, 4) with its alpha.
    factor : (3,) float64
        Linear base colour that multiplies the picture; (4,) with its alpha.
    material : GltfMaterial or None
        Other properties of the surface in a glTF file.
    alpha_mode : str
        "OPAQUE": alpha is ignored; "MASK": the surface exists where alpha is at least `alpha_cutoff`; "BLEND": alpha is
        the opacity.
    wrap : tuple of str
        Continuation of the picture outside 0..1, across and down: "repeat", "mirror" (every other repeat is mirrored)
        or "clamp" (its edge continues).
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
        In the file's frame, mm. It has corner normals only if the file has them (OBJ, PLY, OFF, GLB), with the file's
        length and sense.
    uv : (m, 3, 2) float64 or None
        Texture coordinates of each facet's corners. (0, 0) is the bottom left of the picture; see `wrap` for values
        outside 0..1.
    gloss : GlossPicture or None
        Multiplies metallic and roughness of `material`.
    colours : (m, 3, 3) float64 or None
        Linear colours at each facet's corners that multiply the factor; (m, 3, 4) with their alpha.
    called : str
        The material in the file; "" if it has none.
    """

    mesh: Mesh
    uv: Array | None = None
    gloss: GlossPicture | None = None
    colours: Array | None = None
    called: str = ""

    def placed(self, transform: Array, scale: float) -> "Piece":
        """Return the piece placed as in its file's scene, in mm.

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
            # By coordinates: a matrix product may round equal vertices differently and open their seam.
            with np.errstate(invalid="ignore", over="ignore"):
                vertices = transform[:3, 3] + sum(vertices[:, [k]] * transform[:3, k] for k in range(3))
            if normals is not None and not np.array_equal(linear, np.eye(3)):
                # The cofactors keep normals perpendicular to the transformed tangents, but not their length. A
                # reflection reverses the cofactors, while the outside of the body stays outside.
                cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
                with np.errstate(invalid="ignore", over="ignore"):
                    normals = np.copysign(1.0, np.linalg.det(linear)) * normals @ cofactors.T
        made = replace(self, mesh=Mesh(vertices * scale, faces, normals))
        return made.turned() if np.linalg.det(linear) < 0.0 else made

    def with_channels(self, channels: int) -> "Piece":
        """Return the piece with 3 colour channels, or 4 with alpha; missing alpha is opaque."""
        colours = self.colours
        if colours is not None and colours.shape[2] != channels:
            colours = np.concatenate([colours, np.ones((*colours.shape[:2], 1))], axis=2)[..., :channels]
        return replace(self, factor=np.append(self.factor, 1.0)[:channels], colours=colours)

    def turned(self) -> "Piece":
        """Return the piece with the corners of each facet in the opposite order; its normals stay unchanged."""
        mesh = self.mesh
        normals = mesh.corner_normals[:, ::-1] if mesh.corner_normals is not None else None
        return self.with_mesh_turned(Mesh(mesh.vertices, mesh.faces[:, ::-1], normals))

    def with_mesh_turned(self, mesh: Mesh) -> "Piece":
        """Return the piece on a mesh with reversed facets.

        Parameters
        ----------
        mesh : Mesh
            Its own mesh, with the corners of each facet in the opposite order.
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
    """Differences between a mesh file and its pieces, in words, without repetition, in reading order."""

    texts: dict[str, None] = field(default_factory=dict)

    def add(self, text: str) -> None:
        """Add a difference: a clause that follows the file's name."""
        self.texts[text] = None

    def count(self, number: int, text: str) -> None:
        """Add a difference with the number of things that have it; nothing if 0.

        Parameters
        ----------
        number : int
        text : str
            With `{}` for the number.
        """
        if number:
            self.add(text.format(f"{number:,}"))
