"""Metallic and roughness pictures of a target: one atlas for all pieces, and the materials that they span."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.files.piece import Piece
from lfmesh.geometry.meshes.mesh import Array, Index
from lfmesh.geometry.objects.atlas import atlas
from lfmesh.geometry.objects.texture import Texture
from lfmesh.optics.gltf_material import GltfMaterial, GltfRange

ROUGHNESS, METALLIC = 1, 2
"""Channels of a glTF file's pictures (glTF 2.0, section 3.9.2)."""


class GlossOnFacets(NamedTuple):
    """Metallic and roughness of facets by a picture.

    Attributes
    ----------
    uv : (m, 3, 2) float64
        As `TargetMesh.uv`, in this picture.
    picture : (h, w, 2) float32
        glTF roughness, and metallic.
    ranges : tuple of GltfRange
    range_of : (m,) int64
        Index in `ranges` of each facet; −1 for a facet of uniform material.
    """

    uv: Array
    picture: Texture
    ranges: tuple[GltfRange, ...]
    range_of: Index

    def of(self, facets: NDArray[np.bool_]) -> "GlossOnFacets":
        """Return the entries of the facets in a mask (m,)."""
        return self._replace(uv=self.uv[facets], range_of=self.range_of[facets])


def without_even_gloss(piece: Piece) -> Piece:
    """Return a piece with a uniform picture of metallic and roughness moved into its material."""
    if piece.gloss is None or piece.material is None:
        return replace(piece, gloss=None)
    factors = piece.gloss.picture[0, 0].astype(np.float64)
    if (piece.gloss.picture[..., ROUGHNESS:] != piece.gloss.picture[0, 0, ROUGHNESS:]).any():
        return piece
    roughness, metallic = (float(factors[channel]) for channel in (ROUGHNESS, METALLIC))
    material = piece.material
    material = replace(material, metallic=material.metallic * metallic, roughness=material.roughness * roughness)
    return replace(piece, material=material, gloss=None)


def gloss_on_facets(name: str, pieces: list[Piece]) -> GlossOnFacets | None:
    """Return metallic and roughness of all pieces in one picture; None if no piece has a picture.

    Raises
    ------
    MeshError
        A picture repeats so often that it does not fit, see `atlas`; the message begins with `name`.
    """
    if all(piece.gloss is None for piece in pieces):
        return None
    pictures: dict[int, Texture] = {}
    spanned: list[GltfRange | None] = []
    shown = []
    for piece in pieces:
        if piece.gloss is None or piece.material is None:
            spanned.append(None)
            shown.append(Piece(piece.mesh, factor=np.zeros(2)))
            continue
        picture = pictures.setdefault(id(piece.gloss.picture), piece.gloss.picture[..., [ROUGHNESS, METALLIC]])
        spanned.append(_range_of(piece.material, picture))
        factor = np.array([piece.material.roughness, piece.material.metallic])
        shown.append(Piece(piece.mesh, piece.gloss.uv, picture=picture, factor=factor, wrap=piece.gloss.wrap))
    uv, sheet = atlas(name, shown)
    assert uv is not None
    assert sheet is not None
    ranges = tuple(dict.fromkeys(each for each in spanned if each is not None))
    number = {None: -1} | {each: i for i, each in enumerate(ranges)}
    of_facets = np.repeat([number[each] for each in spanned], [len(piece.mesh.faces) for piece in pieces])
    return GlossOnFacets(uv, sheet, ranges, of_facets)


def _range_of(material: GltfMaterial, picture: Texture) -> GltfRange:
    """Return the range of materials spanned by a picture (h, w, 2) of roughness and metallic factors."""
    ends = np.array([picture.min(axis=(0, 1)), picture.max(axis=(0, 1))], np.float64)
    return GltfRange.of(material.base, ends[:, 1] * material.metallic, ends[:, 0] * material.roughness)
