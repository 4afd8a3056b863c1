"""Pictures of a run: the raw image exposed for the eye, and as 16-bit linear counts."""

from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, to_display

WHITE_PERCENTILE = 99.5
"""Of the pixels that got light: a few glints must not darken the whole picture."""

KNOWN = 0.5
"""A pixel whose relative standard error is larger does not set the exposure: one rare heavy sample may have made it."""

COUNTS = 65535


def white_point(light: NDArray[np.float64], known: NDArray[np.bool_] | None = None) -> float:
    """Return the value that a preview shows as white; 0 for a black image.

    A percentile over the pixels that got any light, so that a small object in the dark is not burnt out; over the
    `known` ones (H, W) among them, if there are any.
    """
    if known is not None and light[known].any():
        light = light[known]
    lit = light[light > 0.0]
    return float(np.percentile(lit, WHITE_PERCENTILE)) if lit.size else 0.0


def write_preview(
    path: Path,
    power: NDArray[np.float64],
    wavelengths_nm: tuple[float, ...],
    stderr: NDArray[np.float64] | None = None,
) -> float:
    """Write an upright 8-bit sRGB PNG that exposes itself.

    Parameters
    ----------
    path : Path
    power : (H, W, wavelengths) float64, W
        In physical orientation; the lens inverts, so the picture is turned by 180°.
    wavelengths_nm : tuple of float
    stderr : (H, W, wavelengths) float64, W, optional
        Of `power`; pixels that are hardly known do not set the exposure.

    Returns
    -------
    float
        The power shown as white, W (mean over the wavelengths for a grey picture); 0 if the picture is black.
    """
    light = to_display(power, wavelengths_nm)
    known = None if stderr is None else np.asarray((stderr <= KNOWN * power).all(axis=2))
    white = white_point(light, known)
    exposed = light / white if white > 0.0 else np.zeros_like(light)
    PIL.Image.fromarray(srgb_encode(upright(exposed))).save(path, format="PNG")
    return white


def write_linear16(
    folder: Path, power: NDArray[np.float64], wavelengths_nm: tuple[float, ...]
) -> tuple[list[str], float]:
    """Write 16-bit grey PNGs of linear counts, in the physical orientation of the raw image.

    One wavelength gives ``linear16.png``, several give ``linear16_486.1nm.png`` and so on, all to one scale.
    The brightest pixel has the count 65535, so nothing is clipped.

    Returns
    -------
    names : list of str
    watts_per_count : float
        Power in W is count times this; 0 for a black image.
    """
    peak = float(power.max(initial=0.0))
    counts = np.rint(power * (COUNTS / peak)) if peak > 0.0 else np.zeros_like(power)
    counts16 = np.clip(counts, 0, COUNTS).astype(np.uint16)
    if len(wavelengths_nm) == 1:
        names = ["linear16.png"]
    else:
        names = [f"linear16_{wavelength:.10g}nm.png" for wavelength in wavelengths_nm]
    for channel, name in enumerate(names):
        plane = np.ascontiguousarray(counts16[:, :, channel])
        PIL.Image.fromarray(plane).save(folder / name, format="PNG")
    return names, peak / COUNTS


def upright(picture: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn an image by 180°, as the lens turned it."""
    return picture[::-1, ::-1]
