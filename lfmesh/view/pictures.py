"""Pictures as 8-bit arrays, for pages and notebooks, and as self-contained data URLs."""

import base64
import io
from typing import TYPE_CHECKING

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.files.preview import white_point

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNKNOWN = (221, 221, 221)
"""Colour of missing values, sRGB."""


def data_url(pixels: NDArray[np.uint8]) -> str:
    """Return an (H, W) or (H, W, 3) picture as a PNG in a data URL."""
    buffer = io.BytesIO()
    PIL.Image.fromarray(np.ascontiguousarray(pixels)).save(buffer, format="PNG", compress_level=1)
    return file_url(buffer.getvalue(), "image/png")


def file_url(content: bytes, kind: str) -> str:
    """Return file content as a data URL."""
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def exposed(light: NDArray[np.floating], wavelengths_nm: tuple[float, ...], white: float) -> NDArray[np.uint8]:
    """Return light as a picture for the eye; unknown values are black.

    Parameters
    ----------
    light : (H, W, wavelengths)
    wavelengths_nm : tuple of float, nm
    white : float
        Light shown as white.
    """
    shown = to_display(np.nan_to_num(light).astype(np.float64), wavelengths_nm)
    return srgb_encode(shown / white) if white > 0.0 else np.zeros(shown.shape, np.uint8)


def white_of(light: NDArray[np.floating], wavelengths_nm: tuple[float, ...]) -> float:
    """Return the light that `exposed` should show as white."""
    return white_point(to_display(np.nan_to_num(light).astype(np.float64), wavelengths_nm))


def coloured(values: NDArray[np.floating], low: float, high: float) -> NDArray[np.uint8]:
    """Return a map in viridis colours; grey where not finite.

    Parameters
    ----------
    values : (H, W)
    low, high : float
        Values at the ends of the colour scale.
    """
    from matplotlib import colormaps

    known = np.isfinite(values)
    scaled = np.clip((np.where(known, values, low) - low) / max(high - low, 1e-300), 0.0, 1.0)
    picture = np.rint(255.0 * colormaps["viridis"](scaled)[..., :3]).astype(np.uint8)
    picture[~known] = UNKNOWN
    return picture


def figure_url(figure: "Figure") -> str:
    """Return a matplotlib figure as an SVG in a data URL."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg")
    return file_url(buffer.getvalue(), "image/svg+xml")
