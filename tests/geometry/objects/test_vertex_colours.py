"""Vertex colours are shown as their linear interpolation over each facet."""

import numpy as np

from lfmesh.geometry.files.piece import Piece
from lfmesh.geometry.meshes.mesh import Mesh
from lfmesh.geometry.objects.vertex_colours import picture_of, with_colours_as_picture

TRIANGLE = Mesh(np.eye(3), np.array([[0, 1, 2]]))


def shown(picture, uv):
    """Return a picture's bilinear value at places, clamped at its edges."""
    height, width = picture.shape[:2]
    row, column = (1.0 - uv[:, 1]) * height - 0.5, uv[:, 0] * width - 0.5
    low, left = np.floor(row).astype(int), np.floor(column).astype(int)
    value = 0.0
    for j in range(2):
        for k in range(2):
            share = np.abs(1 - j - (row - low)) * np.abs(1 - k - (column - left))
            value += share[:, None] * picture[np.clip(low + j, 0, height - 1), np.clip(left + k, 0, width - 1)]
    return value


def test_a_picture_of_colours_shows_them_linearly():
    rng = np.random.default_rng(0)
    colours = rng.random((37, 3, 4))
    picture, uv = picture_of(colours)
    shares = rng.dirichlet([1.0, 1.0, 1.0], (37, 20))
    place = np.einsum("mks,msi->mki", shares, uv).reshape(-1, 2)
    truth = np.einsum("mks,msc->mkc", shares, colours).reshape(-1, 4)
    np.testing.assert_allclose(shown(picture, place), truth, atol=1e-6)


def test_equal_facets_share_their_place():
    colours = np.tile(np.random.default_rng(1).random((2, 3, 3)), (50, 1, 1))
    picture, uv = picture_of(colours)
    assert picture.shape[:2] == (2, 4)
    np.testing.assert_array_equal(uv[::2], np.broadcast_to(uv[0], uv[::2].shape))


def test_one_colour_is_a_factor():
    piece = with_colours_as_picture(Piece(TRIANGLE, factor=np.full(3, 0.5), colours=np.full((1, 3, 3), 0.4)))
    assert piece.picture is None
    np.testing.assert_allclose(piece.factor, 0.2)
