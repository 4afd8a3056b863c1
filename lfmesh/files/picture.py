"""Upright pictures of views and photographs for the eye, single or animated."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.files.preview import white_point

LEAST_PX = 480
"""Pictures with a shorter longest side are enlarged to about this."""

FRAME_MS = 120


def write_picture(path: Path, light: NDArray[np.floating], wavelengths_nm: tuple[float, ...]) -> None:
    """Write an upright (H, W, wavelengths) picture as 8-bit sRGB PNG; unknown samples are black.

    Parameters
    ----------
    path : Path
    light : (H, W, wavelengths) float
        NaN where unknown.
    wavelengths_nm : sequence of float
    """
    _frames([light], wavelengths_nm)[0].save(path, format="PNG")


def write_animation(path: Path, lights: Sequence[NDArray[np.floating]], wavelengths_nm: tuple[float, ...]) -> None:
    """Write upright pictures, at one exposure, as an animated PNG that runs forwards and backwards.

    Parameters
    ----------
    path : Path
    lights : sequence of (H, W, wavelengths) float
    wavelengths_nm : sequence of float
    """
    frames = _frames(lights, wavelengths_nm)
    frames += frames[-2:0:-1]
    frames[0].save(path, format="PNG", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0)


def _frames(lights: Sequence[NDArray[np.floating]], wavelengths_nm: tuple[float, ...]) -> list[PIL.Image.Image]:
    shown = [to_display(np.nan_to_num(light).astype(np.float64), wavelengths_nm) for light in lights]
    white = max(white_point(light) for light in shown) or 1.0
    frames = [PIL.Image.fromarray(srgb_encode(light / white)) for light in shown]
    larger = max(1, round(LEAST_PX / max(frames[0].size)))
    size = (larger * frames[0].width, larger * frames[0].height)
    return [frame.resize(size, PIL.Image.Resampling.BICUBIC) if larger > 1 else frame for frame in frames]
