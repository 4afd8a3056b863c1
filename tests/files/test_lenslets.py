"""The picture a plenoptic camera saw: every pixel belongs to its lenslet, and the picture keeps its shape."""

import numpy as np
import pytest

from lfmesh.files.lenslets import lenslet_means, paint
from lfmesh.geometry.array.lattice import Lattice


def centres(grid: Lattice) -> np.ndarray:
    """Centres of the micro-images, (rows·columns, 2) pixels from the middle, written out one by one."""
    points = []
    for row in range(grid.rows):
        for column in range(grid.columns):
            x = (column - (grid.columns - 1) / 2) * grid.pitch
            y = (row - (grid.rows - 1) / 2) * grid.pitch
            if grid.hexagonal:
                x += (0.25 if row % 2 else -0.25) * grid.pitch
                y *= np.sqrt(3) / 2
            points.append((x, y))
    return np.array(points)


@pytest.mark.parametrize("hexagonal", [False, True], ids=["square", "hexagonal"])
@pytest.mark.parametrize("rows", [7, 8])
def test_every_pixel_belongs_to_the_nearest_micro_image(hexagonal: bool, rows: int) -> None:
    grid = Lattice(hexagonal, 5.03, 9, rows)
    height, width = 24, 31
    y, x = np.mgrid[:height, :width] - np.array([(height - 1) / 2, (width - 1) / 2])[:, None, None]
    distance2 = (x[..., None] - centres(grid)[:, 0]) ** 2 + (y[..., None] - centres(grid)[:, 1]) ** 2
    owner = np.argmin(distance2, axis=2)
    power = np.random.default_rng(3).random((height, width, 1))
    pixels = np.bincount(owner.ravel(), minlength=9 * rows)
    sums = np.bincount(owner.ravel(), weights=power.ravel(), minlength=9 * rows)
    np.testing.assert_allclose(lenslet_means(power, grid).ravel(), sums / np.maximum(pixels, 1))


def test_light_beyond_the_array_belongs_to_no_lenslet() -> None:
    power = np.ones((30, 30, 1))
    power[5:25, 5:25] = 0.0
    assert lenslet_means(power, Lattice(False, 10.0, 2, 2)).max() == 0.0


@pytest.mark.parametrize("hexagonal", [False, True], ids=["square", "hexagonal"])
def test_one_bright_micro_image_is_one_bright_lenslet(hexagonal: bool) -> None:
    grid = Lattice(hexagonal, 8.0, 6, 5)
    power = np.zeros((40, 52, 2))
    x, y = centres(grid)[3 * 6 + 4]
    column, row = round(x + 25.5), round(y + 19.5)
    power[row - 1 : row + 2, column - 1 : column + 2, 1] = 1.0
    means = lenslet_means(power, grid)
    assert means.shape == (5, 6, 2)
    assert np.argwhere(means).tolist() == [[3, 4, 1]]


def test_uniform_light_gives_a_uniform_picture_whatever_the_pitch() -> None:
    """A sum over micro-images would show bars where a pitch of 10.37 pixels takes 10 or 11 of them."""
    power = np.full((300, 300, 1), 2e-12)
    for hexagonal in (False, True):
        grid = Lattice(hexagonal, 10.37, 20, 20)
        np.testing.assert_allclose(lenslet_means(power, grid), 2e-12)
        np.testing.assert_allclose(paint(lenslet_means(power, grid), grid), 2e-12)


@pytest.mark.parametrize("hexagonal", [False, True], ids=["square", "hexagonal"])
def test_a_ramp_stays_a_ramp(hexagonal: bool) -> None:
    """Linear light along x and y must come out linear in the picture's coordinates, so nothing is sheared."""
    grid = Lattice(hexagonal, 9.0, 30, 24)
    x, y = centres(grid).T
    means = (1000.0 + 2.0 * x + 3.0 * y).reshape(24, 30, 1)
    picture = paint(means, grid)[:, :, 0]
    assert max(picture.shape) == 640
    width, height = (2 * half for half in grid.half_extent)
    py, px = np.mgrid[: picture.shape[0], : picture.shape[1]]
    scale = max(width, height) / 640
    expected = 1000.0 + scale * (2.0 * (px - (picture.shape[1] - 1) / 2) + 3.0 * (py - (picture.shape[0] - 1) / 2))
    inner = (slice(60, -60), slice(60, -60))
    np.testing.assert_allclose(picture[inner], expected[inner], atol=2.5)
