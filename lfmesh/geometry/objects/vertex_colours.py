"""Vertex colours as a picture: interpolated over each facet as linearly as a texture of its own shows them.

A texture is interpolated between the middles of its texels. Four texels, in a square, whose fourth has the value that
makes them a plane, so show on the triangle of the other three what lies linearly between three colours.
"""

from dataclasses import replace

import numpy as np

from lfmesh.geometry.files.piece import REPEAT, Piece
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.texture import Texture


def with_colours_as_picture(piece: Piece) -> Piece:
    """Return a piece whose vertex colours, if it has any, are its factor or a picture with its places in it."""
    if piece.colours is None:
        return piece
    first = piece.colours[0, 0]
    if (piece.colours == first).all():
        return replace(piece, colours=None, factor=piece.factor * first[: len(piece.factor)])
    picture, uv = picture_of(piece.colours)
    return replace(piece, colours=None, picture=picture, uv=uv, wrap=REPEAT)


def picture_of(colours: Array) -> tuple[Texture, Array]:
    """Return a picture of the colours of facets, and the place of each facet's corners in it.

    Parameters
    ----------
    colours : (m, 3, c) float64
        At the corners of facets, linear.

    Returns
    -------
    picture : (h, w, c) float32
        Beyond the facets' triangles its values may lie outside 0..1; no facet shows them.
    uv : (m, 3, 2) float64
    """
    channels = colours.shape[2]
    # Facets of one colour are many, and each needs a place but once.
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
