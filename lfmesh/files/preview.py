"""Pictures of a run: the raw image exposed for the eye, and linear 16-bit counts."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from lfmesh.files.colour import srgb_encode, to_display
from lfmesh.scene.camera.bands import channel_labels

WHITE_PERCENTILE = 99.5
"""Percentile over the lit pixels: a few glints must not darken the whole picture."""

KNOWN = 0.5
"""Largest relative standard error of a pixel that sets the exposure; a single heavy sample may cause larger ones."""

COUNTS = 65535

BAND = 64
"""Rows converted at a time: memory may not hold a copy of a large sensor's whole film."""


def white_point(light: NDArray[np.float64], known: NDArray[np.bool_] | None = None) -> float:
    """Return the value that a preview shows as white; 0 for a black image.

    It is a percentile over the lit pixels, so that a small object in the dark is not overexposed; over the `known` ones
    (H, W) if there are any.
    """
    lit = light > 0.0
    if known is not None:
        counted = lit & known.reshape(known.shape + (1,) * (light.ndim - known.ndim))
        lit = counted if counted.any() else lit
    values = light[lit]
    return float(np.percentile(values, WHITE_PERCENTILE, overwrite_input=True)) if values.size else 0.0


def bands(height: int) -> Iterator[slice]:
    """Yield slices of `BAND` rows."""
    for first in range(0, height, BAND):
        yield slice(first, min(first + BAND, height))


def well_known(power: NDArray[np.float64], stderr: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which pixels (H, W) are known well enough at every wavelength to set the exposure."""
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
    """Write an automatically exposed 8-bit sRGB PNG.

    Parameters
    ----------
    path : Path
    power : (H, W, wavelengths) float64, W
        Upright, see `lfmesh.lightfield.views.upright`.
    wavelengths_nm : tuple of float
    stderr : (H, W, wavelengths) float64, W, optional
        Noisy pixels do not set the exposure.

    Returns
    -------
    float
        Power shown as white, W (mean over the wavelengths if grey); 0 for a black picture.
    """
    picture, white = displayed(power, wavelengths_nm, stderr)
    PIL.Image.fromarray(picture).save(path, format="PNG")
    return white


def displayed(
    power: NDArray[np.float64], wavelengths_nm: tuple[float, ...], stderr: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.uint8], float]:
    """Return an automatically exposed 8-bit sRGB picture, (H, W) or (H, W, 3), and the power shown as white.

    Parameters
    ----------
    power, wavelengths_nm, stderr
        As for `write_preview`; the picture has the orientation of the power.
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
    """Write an upright image as 16-bit grey PNGs of linear counts.

    One wavelength gives ``linear16.png``, several ``linear16_486.1nm.png`` etc., and bands ``linear16_R.png`` etc., on
    a common scale. The brightest pixel has the count 65535, so nothing is clipped.

    Parameters
    ----------
    folder : Path
    power : (H, W, wavelengths) float64, W
    wavelengths_nm : sequence of float

    Returns
    -------
    names : list of str
    watts_per_count : float
        Power in W per count; 0 for a black image.
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
