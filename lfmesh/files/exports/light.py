"""Light fields as linear RGB and as counts."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.files.colour import to_display
from lfmesh.lightfield.views.field import LightField, Samples, from_mosaic

COUNTS = 65535


def linear_rgb(field: LightField) -> tuple[Samples, NDArray[np.bool_]]:
    """Return the samples as linear RGB in the light field's unit, and a mask of the known samples.

    Returns
    -------
    rgb : (v, u, t, s, 3) float32
        Three equal values if the wavelengths span no colours; 0 where unknown.
    known : (v, u, t, s) bool
    """
    known = np.asarray(np.isfinite(field.data).all(axis=-1))
    rgb = picture_rgb(field.views_mosaic(), field.wavelengths_nm)
    return from_mosaic(rgb, field.views), known


def picture_rgb(light: NDArray[np.floating], wavelengths_nm: tuple[float, ...]) -> Samples:
    """Return (H, W, wavelengths) light as (H, W, 3) linear RGB in the same unit; 0 where unknown."""
    shown = to_display(np.nan_to_num(light).astype(np.float64), wavelengths_nm)
    rgb = shown if shown.ndim == 3 else np.repeat(shown[:, :, None], 3, axis=2)
    return rgb.astype(np.float32)


def to_counts(light: NDArray[np.floating]) -> tuple[NDArray[np.uint16], float]:
    """Return linear 16-bit counts, with the peak at 65535, and the amount of light per count."""
    peak = float(light.max(initial=0.0))
    if not peak > 0.0:
        return np.zeros(light.shape, np.uint16), 0.0
    return np.rint(np.clip(light / peak, 0.0, 1.0) * COUNTS).astype(np.uint16), peak / COUNTS
