"""Bilinear interpolation of a raw image."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel

Array = NDArray[np.float64]


@kernel
def between_pixels(mean: Array, stderr: Array, x: float, y: float, channel: int) -> tuple[float, float]:
    """Interpolate a raw image bilinearly at column x and row y, with squared standard error; NaN outside the sensor.

    Parameters
    ----------
    mean, stderr : (H, W, c) float64
    """
    height, width, _ = mean.shape
    if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):
        return np.nan, np.nan
    column, row = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
    fx, fy = x - column, y - row
    value, square = 0.0, 0.0
    for j in range(2):
        for i in range(2):
            weight = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
            if weight > 0.0:
                value += weight * mean[row + j, column + i, channel]
                square += (weight * stderr[row + j, column + i, channel]) ** 2
    return value, square
