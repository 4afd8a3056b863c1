"""One picture for a whole target: the pictures and plain colours of its pieces, stacked, repeats unrolled."""

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.mesh_file import Piece
from lfmesh.geometry.meshes.mesh import Array, Index
from lfmesh.geometry.objects.texture import Texture

MAX_TEXELS = 2**27
"""1.6 GB of linear light."""

_NOISE = 1e-6
"""How far a uv may overshoot the picture by rounding, in pictures, without asking for another repeat."""


def atlas(name: str, pieces: list[Piece]) -> tuple[Array | None, Texture | None]:
    """Return the uv (m, 3, 2) of all pieces' facets, within 0..1, and the one texture they point into.

    (None, None) for pieces without uv and colour, (uv, None) for uv without colour.

    Parameters
    ----------
    name : str
        Of the mesh file, for the error message.
    pieces : list of Piece

    Raises
    ------
    MeshError
        A picture repeats so often over the mesh that unrolling it would not fit `MAX_TEXELS`.
    """
    if all(piece.picture is None and np.all(piece.factor == 1.0) for piece in pieces):
        if any(piece.uv is None for piece in pieces):
            return None, None
        return np.concatenate([piece.uv for piece in pieces if piece.uv is not None]), None
    kinds: dict[tuple[int, ...], list[int]] = {}
    for number, piece in enumerate(pieces):
        picture = id(piece.picture) if piece.uv is not None else 0
        kinds.setdefault((picture, *piece.factor.view(np.int64)), []).append(number)

    placed: dict[int, Array] = {}
    tiles: list[Texture] = []
    for members in kinds.values():
        tile, texels = _tile(name, [pieces[number] for number in members])
        tiles.append(tile)
        placed.update(zip(members, texels, strict=True))
    size = sum(len(tile) + 2 for tile in tiles), max(tile.shape[1] for tile in tiles) + 2
    if size[0] * size[1] > MAX_TEXELS:
        raise _too_large(name, size)
    sheet, origins = _stacked(tiles)
    for members, origin in zip(kinds.values(), origins, strict=True):
        for number in members:
            placed[number] = placed[number] + origin
    height, width = sheet.shape[:2]
    corners_of_all = np.concatenate([placed[number] for number in range(len(pieces))])
    return np.stack([corners_of_all[..., 0] / width, 1.0 - corners_of_all[..., 1] / height], axis=-1), sheet


def _tile(name: str, pieces: list[Piece]) -> tuple[Texture, list[Array]]:
    """Return the coloured picture that pieces share, unrolled, and their corners in its texels (x, y)."""
    first = pieces[0]
    if first.picture is None or first.uv is None:
        plain = first.factor.astype(np.float32).reshape(1, 1, -1)
        return plain, [np.full((len(piece.mesh.faces), 3, 2), 0.5) for piece in pieces]
    # Rows run down, v runs up.
    turned = [uv * [1.0, -1.0] + [0.0, 1.0] for uv in (piece.uv for piece in pieces) if uv is not None]
    folded = [xy - np.floor(xy.min(axis=1, keepdims=True) + _NOISE) for xy in turned]
    furthest = np.max([xy.max(axis=(0, 1), initial=0.0) for xy in folded], axis=0)
    repeats = np.maximum(1, np.ceil(furthest - _NOISE)).astype(np.int64)
    height, width = first.picture.shape[:2]
    if height * width * int(repeats.prod()) > MAX_TEXELS:
        raise _too_large(name, (height * int(repeats[1]), width * int(repeats[0])))
    # A picture that is used as it is, as most are, is not copied.
    picture = first.picture if (first.factor == 1.0).all() else first.picture * first.factor.astype(np.float32)
    if repeats.prod() > 1:
        picture = np.tile(picture, (repeats[1], repeats[0], 1))
    size = np.array([width, height], dtype=np.float64)
    return picture, [np.clip(xy, 0.0, repeats) * size for xy in folded]


def _stacked(tiles: list[Texture]) -> tuple[Texture, list[Index]]:
    """Stack tiles from the top down; return the sheet and each tile's corner (x, y) in it.

    Each tile is widened by copies of its border, so that interpolating there does not see its neighbour.
    """
    if len(tiles) == 1:
        return tiles[0], [np.zeros(2, dtype=np.int64)]
    width = max(tile.shape[1] for tile in tiles) + 2
    padded = [np.pad(tile, ((1, 1), (1, width - tile.shape[1] - 1), (0, 0)), mode="edge") for tile in tiles]
    tops = np.cumsum([0, *(len(tile) for tile in padded)])
    return np.concatenate(padded), [np.array([1, top + 1]) for top in tops[:-1]]


def _too_large(name: str, size: tuple[int, int]) -> MeshError:
    return MeshError(
        f"{name}: its pictures, repeated as the mesh asks, need {size[1]} x {size[0]} texels; "
        f"valid are {MAX_TEXELS:,} in all"
    )
