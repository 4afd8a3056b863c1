"""Texture atlas of a target: the pictures and plain colours of its pieces, stacked, with repeats unrolled."""

from typing import NamedTuple

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.piece import Piece
from lfmesh.geometry.meshes.mesh import Array, Index
from lfmesh.geometry.objects.texture import Texture

MAX_TEXELS = 2**27
"""Largest size of an atlas: 1.6 GB of linear light."""

_NOISE = 1e-6
"""Overshoot of a uv, in pictures, that counts as rounding and adds no repeat."""


PERIODS = {"repeat": 1, "mirror": 2}
"""Period of each wrap mode, in pictures."""


def atlas(name: str, pieces: list[Piece]) -> tuple[Array | None, Texture | None]:
    """Return the uv (m, 3, 2) of the facets of all pieces, within 0..1, and the texture that they share.

    (None, None) for pieces without uv and colour, (uv, None) for uv without colour. `name` is for error messages.

    Raises
    ------
    MeshError
        The unrolled repeats of the pictures exceed `MAX_TEXELS`.
    """
    if all(piece.picture is None and np.all(piece.factor == 1.0) for piece in pieces):
        if any(piece.uv is None for piece in pieces):
            return None, None
        return np.concatenate([piece.uv for piece in pieces if piece.uv is not None]), None
    kinds: dict[tuple[int | str, ...], list[int]] = {}
    for number, piece in enumerate(pieces):
        picture = id(piece.picture) if piece.uv is not None else 0
        kinds.setdefault((picture, *piece.wrap, *piece.factor.view(np.int64)), []).append(number)

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
    """Return the picture of pieces that share one, coloured and unrolled, and their corners in its texels (x, y)."""
    first = pieces[0]
    if first.picture is None or first.uv is None:
        plain = first.factor.astype(np.float32).reshape(1, 1, -1)
        return plain, [np.full((len(piece.mesh.faces), 3, 2), 0.5) for piece in pieces]
    # Rows run down, v runs up.
    turned = [uv * [1.0, -1.0] + [0.0, 1.0] for uv in (piece.uv for piece in pieces) if uv is not None]
    height, width = first.picture.shape[:2]
    across, down = (_unrolled([xy[..., k] for xy in turned], first.wrap[k]) for k in (0, 1))
    columns, rows = width * (across.stop - across.start), height * (down.stop - down.start)
    if columns * rows > MAX_TEXELS:
        raise _too_large(name, (rows, columns))
    # A picture that is used as it is, as most are, is not copied.
    picture = first.picture if (first.factor == 1.0).all() else first.picture * first.factor.astype(np.float32)
    if (across.start, across.stop, down.start, down.stop) != (0, 1, 0, 1):
        picture = picture[_texels(down, height, first.wrap[1])][:, _texels(across, width, first.wrap[0])]
    return picture, [
        np.stack([x * width, y * height], axis=-1) for x, y in zip(across.folded, down.folded, strict=True)
    ]


class _Unrolled(NamedTuple):
    """Places along one axis, in pictures from the first one shown, and the range of pictures shown."""

    folded: list[Array]
    start: int
    stop: int


def _unrolled(places: list[Array], wrap: str) -> _Unrolled:
    """Return places, (m, 3) for each piece, folded by the period of the picture without tearing a facet.

    A clamped picture has no period: everything that a facet shows of it is unrolled.
    """
    least = [np.floor(place.min(axis=1, keepdims=True) + _NOISE) for place in places]
    if wrap == "clamp":
        start = int(min((first.min(initial=0.0) for first in least), default=0.0))
        folded = [place - start for place in places]
    else:
        start, period = 0, PERIODS[wrap]
        folded = [place - period * np.floor(first / period) for place, first in zip(places, least, strict=True)]
    furthest = max((place.max(initial=0.0) for place in folded), default=0.0)
    count = max(1, int(np.ceil(furthest - _NOISE)))
    return _Unrolled([np.clip(place, 0.0, count) for place in folded], start, start + count)


def _texels(shown: _Unrolled, size: int, wrap: str) -> Index:
    """Return the picture's texel at each place shown along an axis of `size` texels."""
    number = np.arange(shown.start * size, shown.stop * size)
    if wrap == "clamp":
        return np.clip(number, 0, size - 1)
    number = number % (PERIODS[wrap] * size)
    return np.minimum(number, 2 * size - 1 - number) if wrap == "mirror" else number


def _stacked(tiles: list[Texture]) -> tuple[Texture, list[Index]]:
    """Stack tiles from the top down; return the sheet and each tile's corner (x, y) in it.

    Copies of its border widen each tile, so that interpolation does not reach the next tile.
    """
    if len(tiles) == 1:
        return tiles[0], [np.zeros(2, dtype=np.int64)]
    width = max(tile.shape[1] for tile in tiles) + 2
    padded = [np.pad(tile, ((1, 1), (1, width - tile.shape[1] - 1), (0, 0)), mode="edge") for tile in tiles]
    tops = np.cumsum([0, *(len(tile) for tile in padded)])
    return np.concatenate(padded), [np.array([1, top + 1]) for top in tops[:-1]]


def _too_large(name: str, size: tuple[int, int]) -> MeshError:
    return MeshError(
        f"{name}: its pictures, repeated as the mesh requires, need {size[1]} x {size[0]} texels; "
        f"the limit is {MAX_TEXELS:,} in all"
    )
