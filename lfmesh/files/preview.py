"""Pictures of a run: the raw image exposed for the eye, and as 16-bit linear counts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.scene.camera.bands import channel_labels

WHITE_PERCENTILE = 99.5
"""Of the pixels that got light: a few glints must not darken the whole picture."""

KNOWN = 0.5
"""A pixel whose relative standard error is larger does not set the exposure: one rare heavy sample may have made it."""

COUNTS = 65535

BAND = 64
"""Rows that are made into a picture together: a large sensor leaves no room for copies of its whole film."""


def white_point(light: NDArray[np.float64], known: NDArray[np.bool_] | None = None) -> float:
    """Return the value that a preview shows as white; 0 for a black image.

    A percentile over the pixels that got any light, so that a small object in the dark is not burnt out; over the
    `known` ones (H, W) among them, if there are any.
    """
    lit = light > 0.0
    if known is not None:
        counted = lit & known.reshape(known.shape + (1,) * (light.ndim - known.ndim))
        lit = counted if counted.any() else lit
    values = light[lit]
    return float(np.percentile(values, WHITE_PERCENTILE, overwrite_input=True)) if values.size else 0.0


def bands(height: int) -> Iterator[slice]:
    """Yield the rows of a picture, `BAND` at a time."""
    for first in range(0, height, BAND):
        yield slice(first, min(first + BAND, height))


def well_known(power: NDArray[np.float64], stderr: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which pixels (H, W) are known well enough in every wavelength to set the exposure."""
    known = np.zeros(power.shape[:2], np.bool_)
    for rows in bands(len(power)):
        known[rows] = (stderr[rows] <= KNOWN * power[rows]).all(axis=2)
    return known


def write_preview(
    path: Path,
    power: NDArray[np.float64],
    wavelengths_nm: tuple[float, ...],
    stderr: NDArray[np.float64] | None = None,
) -> float:
    """Write an 8-bit sRGB PNG that exposes itself.

    Parameters
    ----------
    path : Path
    power : (H, W, wavelengths) float64, W
        Upright: see `lfmesh.lightfield.views.upright`.
    wavelengths_nm : tuple of float
    stderr : (H, W, wavelengths) float64, W, optional
        Of `power`; pixels that are hardly known do not set the exposure.

    Returns
    -------
    float
        The power shown as white, W (mean over the wavelengths for a grey picture); 0 if the picture is black.
    """
    picture, white = displayed(power, wavelengths_nm, stderr)
    PIL.Image.fromarray(picture).save(path, format="PNG")
    return white


def displayed(
    power: NDArray[np.float64], wavelengths_nm: tuple[float, ...], stderr: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.uint8], float]:
    """Return an 8-bit sRGB picture (H, W) or (H, W, 3) that exposes itself, and the power shown as white.

    Parameters
    ----------
    power, wavelengths_nm, stderr
        As for `write_preview`; the picture lies as the power does.
    """
    light = to_display(power, wavelengths_nm)
    known = None if stderr is None else well_known(power, stderr)
    white = white_point(light, known)
    picture = np.zeros(light.shape, np.uint8)
    if white > 0.0:
        for rows in bands(len(light)):
            picture[rows] = srgb_encode(light[rows] / white)
    return picture, white


def write_linear16(
    folder: Path, power: NDArray[np.float64], wavelengths_nm: tuple[float, ...]
) -> tuple[list[str], float]:
    """Write 16-bit grey PNGs of linear counts from an upright image.

    One wavelength gives ``linear16.png``, several give ``linear16_486.1nm.png`` and so on, bands ``linear16_R.png``,
    all to one scale.
    The brightest pixel has the count 65535, so nothing is clipped.

    Parameters
    ----------
    folder : Path
    power : (H, W, wavelengths) float64, W
    wavelengths_nm : sequence of float

    Returns
    -------
    names : list of str
    watts_per_count : float
        Power in W is count times this; 0 for a black image.
    """
    peak = float(power.max(initial=0.0))
    counts = np.zeros(power.shape, np.uint16)
    if peak > 0.0:
        for rows in bands(len(power)):
            counts[rows] = np.clip(np.rint(power[rows] * (COUNTS / peak)), 0, COUNTS)
    if len(wavelengths_nm) == 1:
        names = ["linear16.png"]
    else:
        labels = channel_labels(wavelengths_nm) or [f"{wavelength:.10g}nm" for wavelength in wavelengths_nm]
        names = [f"linear16_{label}.png" for label in labels]
    for channel, name in enumerate(names):
        plane = np.ascontiguousarray(counts[:, :, channel])
        PIL.Image.fromarray(plane).save(folder / name, format="PNG")
    return names, peak / COUNTS
