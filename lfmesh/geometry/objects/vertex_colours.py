"""Vertex colours as a picture that shows them interpolated linearly over each facet.

Textures are interpolated between texel centres. Four texels in a square, the fourth chosen so that all lie on a plane,
therefore interpolate three colours linearly on the triangle of the first three.
"""

from dataclasses import replace

import numpy as np

from lfmesh.geometry.files.piece import REPEAT, Piece
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.texture import Texture


def with_colours_as_picture(piece: Piece) -> Piece:
    """Return a piece with its vertex colours, if any, moved into its factor or into a picture."""
    if piece.colours is None:
        return piece
    first = piece.colours[0, 0]
    if (piece.colours == first).all():
        return replace(piece, colours=None, factor=piece.factor * first[: len(piece.factor)])
    picture, uv = picture_of(piece.colours)
    return replace(piece, colours=None, picture=picture, uv=uv, wrap=REPEAT)


def picture_of(colours: Array) -> tuple[Texture, Array]:
    """Return a picture of the linear colours (m, 3, c) at the corners of facets, and the corners' texture coordinates.

    Returns
    -------
    picture : (h, w, c) float32
        Values may lie outside 0..1 beyond the facets' triangles, where no facet shows them.
    uv : (m, 3, 2) float64
    """
    channels = colours.shape[2]
    # Many facets have equal colours; each set of colours needs only one place.
    kinds, which = np.unique(colours.reshape(len(colours), -1), axis=0, return_inverse=True)
    first, across, down = np.moveaxis(kinds.reshape(-1, 3, channels), 1, 0)
    columns = int(np.ceil(np.sqrt(len(kinds))))
    rows = -(-len(kinds) // columns)
    tiles = np.zeros((rows * columns, 2, 2, channels), np.float32)
    tiles[: len(kinds)] = np.stack([np.stack([first, across], 1), np.stack([down, across + down - first], 1)], 1)
    picture = tiles.reshape(rows, columns, 2, 2, channels).swapaxes(1, 2).reshape(2 * rows, 2 * columns, channels)
    row, column = np.divmod(which.reshape(-1), columns)
    x = 2 * column[:, None] + [0.5, 1.5, 0.5]
    y = 2 * row[:, None] + [0.5, 0.5, 1.5]
    return np.ascontiguousarray(picture), np.stack([x / (2 * columns), 1.0 - y / (2 * rows)], axis=-1)
