"""From wavelength samples to a picture for the eye: grey, or linear sRGB where the samples span colours."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.cie import observer

_XYZ_TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
"""IEC 61966-2-1."""


def srgb_weights(wavelengths_nm: tuple[float, ...]) -> NDArray[np.float64] | None:
    """Return the (3, n) weights that turn n wavelength samples into linear sRGB, or None for a grey picture.

    Equal power in every sample comes out white: few samples say nothing of the illuminant, and a picture
    that is tinted by their choice would mislead. Grey: fewer than three samples, or samples that leave a
    primary empty, as infrared ones do.
    """
    if len(wavelengths_nm) < 3:
        return None
    rgb = _XYZ_TO_SRGB @ observer(wavelengths_nm)
    white = rgb.sum(axis=1)
    if white.min() < 0.05:
        return None
    return np.asarray(rgb / white[:, None])


def to_display(power: NDArray[np.float64], wavelengths_nm: tuple[float, ...]) -> NDArray[np.float64]:
    """Turn (H, W, wavelengths) power into (H, W) grey or (H, W, 3) linear sRGB in the same unit."""
    if len(wavelengths_nm) == 1:
        return power[:, :, 0]
    weights = srgb_weights(wavelengths_nm)
    if weights is None:
        return np.asarray(power.mean(axis=2))
    return np.clip(power @ weights.T, 0.0, None)


def srgb_encode(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Encode linear light, 0 to 1 (clipped), as 8-bit sRGB (IEC 61966-2-1)."""
    light = np.clip(linear, 0.0, 1.0)
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * encoded).astype(np.uint8)


def spectral_srgb(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 3) sRGB from 0 to 1 for lines in a picture, (n,) wavelengths in nm: hue as seen, all alike bright.

    Spectral colours lie outside what a screen can show, so white is added until none is negative, and a little more so
    that deep blue and red stay visible. Ultraviolet and infrared are shown as the ends of the spectrum.
    """
    visible = np.clip(wavelength_nm, 400.0, 680.0)
    rgb = (_XYZ_TO_SRGB @ observer(visible)).T
    rgb -= np.minimum(rgb.min(axis=1, keepdims=True), 0.0)
    rgb = rgb / rgb.max(axis=1, keepdims=True) * 0.96 + 0.04
    return np.asarray(srgb_encode(rgb) / 255.0)
