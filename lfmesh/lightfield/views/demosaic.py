"""Demosaicking: from one colour per pixel to three.

H. S. Malvar, L.-w. He, R. Cutler, "High-quality linear interpolation for demosaicing of Bayer-patterned color images",
ICASSP 2004: bilinear, corrected by the Laplacian of the colour measured at the pixel.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate

Array = NDArray[np.float64]

_GREEN = np.array([[0, 0, -1, 0, 0], [0, 0, 2, 0, 0], [-1, 2, 4, 2, -1], [0, 0, 2, 0, 0], [0, 0, -1, 0, 0]]) / 8.0
"""Green at red and blue pixels."""

_ALONG_ROW = (
    np.array([[0, 0, 1, 0, 0], [0, -2, 0, -2, 0], [-2, 8, 10, 8, -2], [0, -2, 0, -2, 0], [0, 0, 1, 0, 0]]) / 16.0
)
"""Red or blue at green pixels with this colour in the row; transposed, in the column."""

_ACROSS = np.array([[0, 0, -3, 0, 0], [0, 4, 0, 4, 0], [-3, 0, 12, 0, -3], [0, 4, 0, 4, 0], [0, 0, -3, 0, 0]]) / 16.0
"""Red at blue pixels, and blue at red ones."""


def demosaicked(mosaic: Array, pattern: str) -> Array:
    """Return three colours for each pixel of a mosaic.

    Parameters
    ----------
    mosaic : (H, W) float64
        Linear in the light.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}
        Colours of the first two pixels of the first row, then of the second.

    Returns
    -------
    (H, W, 3) float64
        Red, green and blue. Measured values are kept; interpolated ones may slightly exceed the range of their
        neighbours.
    """
    colours = np.empty(mosaic.shape, "U1")
    for place, colour in enumerate(pattern):
        colours[place // 2 :: 2, place % 2 :: 2] = colour
    rgb = np.repeat(mosaic[:, :, None], 3, axis=2)
    # "mirror" reflects about the outermost pixel, which keeps the pattern's parity.
    green, along_row, along_column, across = (
        correlate(mosaic, kernel, mode="mirror") for kernel in (_GREEN, _ALONG_ROW, _ALONG_ROW.T, _ACROSS)
    )
    rgb[:, :, 1] = np.where(colours == "G", mosaic, green)
    for channel, own, other in ((0, "R", "B"), (2, "B", "R")):
        in_row = (colours == "G") & (colours == own).any(axis=1)[:, None]
        rgb[:, :, channel] = np.select(
            [colours == own, colours == other, in_row], [mosaic, across, along_row], along_column
        )
    return rgb
