"""Facets of a glTF file's primitives, read from its accessors (glTF 2.0, section 3.7)."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.gltf_buffers import Buffers
from lfmesh.geometry.files.gltf_looks import Looks, Place
from lfmesh.geometry.files.gltf_nodes import FAN, STRIP, TRIANGLES
from lfmesh.geometry.files.obj_file import NO_PLACE
from lfmesh.geometry.files.off_file import check_corners
from lfmesh.geometry.files.pictures import Pictures
from lfmesh.geometry.files.piece import GlossPicture, Notes, Piece
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh

COMPRESSED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
"""Extensions that hold a primitive's numbers in place of its accessors."""


def load_primitives(
    path: Path, document: dict[str, Any], wanted: Iterable[tuple[int, int]], alpha: bool, notes: Notes
) -> dict[tuple[int, int], Piece]:  # fmt: skip
    """Return primitives by mesh and number, in the frame of their node, m; omit those without facets.

    Parameters
    ----------
    path : Path
    document : dict
    wanted : iterable of (int, int)
        Mesh and number of each primitive.
    alpha : bool
        Read the alpha of pictures and colours, too.
    notes : Notes

    Raises
    ------
    MeshError, ValueError
        The file is broken.
    """
    buffers = Buffers(path, document)
    looks = Looks(buffers, Pictures(path, alpha, notes))
    made: dict[tuple[int, int], Piece] = {}
    for mesh, number in dict.fromkeys(wanted):
        primitive = document["meshes"][mesh]["primitives"][number]
        piece = _piece(f"meshes[{mesh}].primitives[{number}]", primitive, buffers, looks, notes)
        if len(piece.mesh.faces):
            made[mesh, number] = piece
    return made


def _piece(where: str, primitive: dict[str, Any], buffers: Buffers, looks: Looks, notes: Notes) -> Piece:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise MeshError(f"{buffers.path}: broken: {where} has no POSITION among its attributes")
    positions = buffers.accessor(attributes["POSITION"], ("VEC3",))
    packed = [name for name in COMPRESSED if name in primitive.get("extensions", {})]
    if packed and "bufferView" not in buffers.document["accessors"][attributes["POSITION"]]:
        raise MeshError(f"{buffers.path}: {where} is stored by {packed[0]}, which is not read; export without it")
    if "indices" in primitive:
        corners = buffers.indices(primitive["indices"])
        check_corners(corners, len(positions))
    else:
        corners = np.arange(len(positions))
    faces = _faces(where, primitive.get("mode", TRIANGLES), corners, notes)

    def at_corners(name: str, *types: str) -> Array | None:
        if name not in attributes:
            return None
        values = buffers.accessor(attributes[name], types)
        if len(values) != len(positions):
            raise ValueError(f"{where} has {len(positions)} vertices, but {len(values)} entries of {name}")
        return values[faces]

    def in_picture(place: Place) -> Array | None:
        uv = at_corners(f"TEXCOORD_{place.uv_set}", "VEC2")
        return _in_picture(uv, place.to_picture) if uv is not None else None

    look, place, gloss, gloss_place = looks.of(primitive.get("material"))
    uv, gloss_uv = in_picture(place), in_picture(gloss_place)
    if uv is None and look.picture is not None:
        notes.count(len(faces), NO_PLACE)
        look = replace(look, picture=None)
    if uv is None and place.uv_set:
        uv = in_picture(place._replace(uv_set=0))
    if gloss is not None and gloss_uv is None:
        notes.count(len(faces), "{} of its facets have no texture coordinates for metallic and roughness")
    normals = at_corners("NORMAL", "VEC3")
    colours = at_corners("COLOR_0", "VEC3", "VEC4")
    return Piece(
        Mesh(positions, faces, normals),
        uv,
        GlossPicture(gloss, gloss_uv, gloss_place.wrap) if gloss is not None and gloss_uv is not None else None,
        np.clip(colours, 0.0, 1.0) if colours is not None else None,
        f"materials[{primitive['material']}]" if "material" in primitive else "",
        **vars(look),
    )


def _faces(where: str, mode: int, corners: Index, notes: Notes) -> Index:
    """Return the facets (m, 3) of a list, strip or fan (section 3.7.2.1)."""
    if mode == TRIANGLES:
        notes.count(len(corners) % 3, f"{{}} corners of {where} make no facet")
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    k = np.arange(len(corners) - 2)
    if mode == STRIP:
        return np.stack([corners[k], corners[k + 1 + k % 2], corners[k + 2 - k % 2]], axis=-1)
    assert mode == FAN
    return np.stack([corners[k + 1], corners[k + 2], np.full(len(k), corners[0])], axis=-1)


def _in_picture(uv: Array, to_picture: Array) -> Array:
    """Return texture coordinates with the origin at the picture's bottom left, from glTF's at the top left."""
    u, v = (to_picture[k, 0] * uv[..., 0] + to_picture[k, 1] * uv[..., 1] + to_picture[k, 2] for k in (0, 1))
    return np.stack([u, 1.0 - v], axis=-1)
