"""Picture of a plenoptic camera from one value per lenslet, drawn smoothly."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import Lattice, cell_of, centre, is_inside
from lfmesh.kernels.decorators import kernel

Array = NDArray[np.float64]

BLUR = 0.5
"""Standard deviation, in pitches, of the Gaussian that blends lenslets into a picture."""


PARTS = 8
"""Subdivisions along each side of a pixel that lies in several micro-images."""


def lenslet_means(power: Array, micro_images: Lattice) -> Array:
    """Average the light of each micro-image over its area.

    Border pixels count in proportion to their area inside. Whole pixels would give some micro-images a dark row that
    their neighbours lack, and the picture bars.

    Parameters
    ----------
    power : (H, W, wavelengths) float64
    micro_images : Lattice
        Nominal lattice on the sensor, its pitch in pixels.

    Returns
    -------
    (rows, columns, wavelengths) float64
        0 for lenslets without pixels.
    """
    sums = np.zeros((micro_images.rows, micro_images.columns, power.shape[2]))
    areas = np.zeros(sums.shape[:2])
    _add_to_lenslets(np.ascontiguousarray(power, dtype=np.float64), micro_images, sums, areas)
    return np.asarray(np.divide(sums, areas[..., None], out=np.zeros_like(sums), where=areas[..., None] > 0.0))


def paint(means: Array, micro_images: Lattice, longest_px: int = 640) -> Array:
    """Draw one value per lenslet as a smooth picture, in the orientation of the sensor.

    Each point is the Gaussian-weighted mean of the surrounding lenslets, for square and hexagonal arrays alike.

    Parameters
    ----------
    means : (rows, columns, wavelengths) float64
    micro_images : Lattice
    longest_px : int
        Longer side of the picture.

    Returns
    -------
    (H, W, wavelengths) float64
    """
    half_width, half_height = micro_images.half_extent
    step = 2.0 * max(half_width, half_height) / longest_px
    height, width = (max(1, round(2.0 * half / step)) for half in (half_height, half_width))
    picture = np.zeros((height, width, means.shape[2]))
    _blend(np.ascontiguousarray(means, dtype=np.float64), micro_images, step, picture)
    return picture


@kernel
def _add_to_lenslets(power: Array, lattice: Lattice, sums: Array, areas: Array) -> None:
    """Add each pixel, or its parts, to the sum and area (in pixels) of the lenslet behind which it lies."""
    height, width, channels = power.shape
    for r in range(height):
        for c in range(width):
            x, y = c - 0.5 * width, r - 0.5 * height
            column, row = cell_of(lattice, x, y)
            is_whole = True
            for corner in range(1, 4):
                other_column, other_row = cell_of(lattice, x + corner % 2, y + corner // 2)
                is_whole = is_whole and other_column == column and other_row == row
            each = 1 if is_whole else PARTS
            for part in range(each * each):
                if not is_whole:
                    column, row = cell_of(lattice, x + (part % each + 0.5) / each, y + (part // each + 0.5) / each)
                if is_inside(lattice, column, row):
                    areas[row, column] += 1.0 / (each * each)
                    for channel in range(channels):
                        sums[row, column, channel] += power[r, c, channel] / (each * each)


@kernel
def _blend(means: Array, lattice: Lattice, step: float, picture: Array) -> None:
    """Fill the picture, with points `step` apart, with weighted means of the surrounding lenslets."""
    height, width, channels = picture.shape
    for r in range(height):
        for c in range(width):
            x, y = (c - 0.5 * (width - 1)) * step, (r - 0.5 * (height - 1)) * step
            near_column, near_row = cell_of(lattice, x, y)
            total = 0.0
            # Two columns to either side, as the rows of a hexagonal lattice are offset.
            for row in range(near_row - 1, near_row + 2):
                for column in range(near_column - 2, near_column + 3):
                    if is_inside(lattice, column, row):
                        centre_x, centre_y = centre(lattice, column, row)
                        distance2 = (x - centre_x) ** 2 + (y - centre_y) ** 2
                        weight = np.exp(-0.5 * distance2 / (BLUR * lattice.pitch) ** 2)
                        total += weight
                        for channel in range(channels):
                            picture[r, c, channel] += weight * means[row, column, channel]
            for channel in range(channels):
                picture[r, c, channel] /= max(total, 1e-300)
