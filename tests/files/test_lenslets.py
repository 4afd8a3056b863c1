"""The picture a plenoptic camera saw: every pixel belongs to its lenslet, and the picture keeps its shape."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

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
def test_every_part_of_a_pixel_belongs_to_the_nearest_micro_image(hexagonal: bool, rows: int) -> None:
    """By the distances of some 50 places in each pixel from all centres: means of 25 pixels, within a place or two."""
    grid, places = Lattice(hexagonal, 5.03, 9, rows), 7
    height, width = 24, 31
    y, x = (np.mgrid[: places * height, : places * width] + 0.5) / places
    apart = np.stack([x - 0.5 * width, y - 0.5 * height], axis=-1).reshape(-1, 2)
    owner = cKDTree(centres(grid)).query(apart)[1]
    power = np.random.default_rng(3).random((height, width, 1))
    parts = np.kron(power[..., 0], np.ones((places, places))).ravel()
    sums = np.bincount(owner, weights=parts, minlength=9 * rows)
    means = (sums / np.maximum(np.bincount(owner, minlength=9 * rows), 1)).reshape(rows, 9)
    # Beyond the outermost lenslets' cells the nearest one is not the one that the place belongs to.
    inside = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(lenslet_means(power, grid)[..., 0][inside], means[inside], rtol=0.02)


def test_round_micro_images_that_touch_show_no_bars() -> None:
    """Disks 10.08 pixels wide cover 10 or 11 rows of pixels; by whole pixels the means differ by 12 %."""
    grid, pixels, fine = Lattice(False, 10.08, 20, 20), 200, 8
    y, x = (np.mgrid[: fine * pixels, : fine * pixels] + 0.5) / fine - 0.5 * pixels
    apart = cKDTree(centres(grid)).query(np.stack([x, y], axis=-1).reshape(-1, 2))[0]
    power = (apart < 0.5 * grid.pitch).reshape(pixels, fine, pixels, fine).mean(axis=(1, 3))[..., None]
    means = lenslet_means(power, grid)[2:-2, 2:-2]
    assert means.min() > 0.97 * means.max()


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
