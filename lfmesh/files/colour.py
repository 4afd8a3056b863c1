"""From channels of an image to a picture for the eye: grey, or linear sRGB where the channels span colours."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.cie import named_spectrum, observer
from lfmesh.scene.camera.bands import VISIBLE_NM, Centroids, Passband

Array = NDArray[np.float64]

_XYZ_TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
"""IEC 61966-2-1."""

ALIKE = 1e-4
"""Responses whose correlations have an eigenvalue below this do not tell three colours apart."""

LEAST = 0.05
"""Least share of white that every primary must have, or the picture is grey."""


def srgb_weights(wavelengths_nm: tuple[float, ...]) -> Array | None:
    """Return the (3, n) weights that turn n channels into linear sRGB, or None for a grey picture.

    Of single wavelengths equal power in every sample comes out white: few samples say nothing of the illuminant, and a
    picture that is tinted by their choice would mislead. Of bands illuminant D65, the white of sRGB, comes out white,
    and the weights bring their responses as near as they can to the CIE 1931 observer, by least squares under that
    light; of the bands "xyz" they are the standard's matrix. Grey: fewer than three channels, or such as leave a
    primary empty, as infrared ones do.

    Parameters
    ----------
    wavelengths_nm : tuple of float
        Of the channels; of bands their `Centroids`.
    """
    if len(wavelengths_nm) < 3:
        return None
    if isinstance(wavelengths_nm, Centroids):
        return _of_bands(wavelengths_nm.bands)
    rgb = _XYZ_TO_SRGB @ observer(wavelengths_nm)
    white = rgb.sum(axis=1)
    if white.min() < LEAST:
        return None
    return np.asarray(rgb / white[:, None])


def white_in_words(wavelengths_nm: tuple[float, ...]) -> str:
    """Return what light pictures show as white."""
    if srgb_weights(wavelengths_nm) is None:
        return "grey picture"
    return "D65" if isinstance(wavelengths_nm, Centroids) else "equal power in every channel"


def fitted_weights(signals: Array, wanted: Array, white: Array) -> Array | None:
    """Return the (3, n) weights that bring n signals as near as they can to wanted colours, and exactly for white.

    Parameters
    ----------
    signals : (n, m) float64
        Responses to m lights.
    wanted : (3, m) float64
        Colours of these.
    white : (m,) float64
        Their amounts in a light that must come out white: all primaries as much as the mean signal.

    Returns
    -------
    (3, n) float64
        None if the signals do not tell three colours apart.
    """
    amounts = np.sqrt(white)
    s, t = signals * amounts, wanted * amounts
    size = np.sqrt((s * s).sum(axis=1))
    if not size.all():
        return None
    s = s / size[:, None]
    gram = s @ s.T
    spread = np.linalg.eigvalsh(gram)
    if len(spread) < 3 or spread[-3] < ALIKE:
        return None
    inverse = np.linalg.pinv(gram, rcond=1e-12)
    free = t @ s.T @ inverse
    of_white, meant = s @ amounts, (t @ amounts).mean()
    along = inverse @ of_white
    free += np.outer(meant - free @ of_white, along) / (of_white @ along)
    return np.asarray(free / size * (signals @ white).mean() / meant)


def white_signals(wavelengths_nm: tuple[float, ...]) -> Array:
    """Return what each channel detects of the light that pictures show as white, (n,), in any unit.

    Parameters
    ----------
    wavelengths_nm : tuple of float
        As for `srgb_weights`.
    """
    if not isinstance(wavelengths_nm, Centroids):
        return np.ones(len(wavelengths_nm))
    _, light, responses = _under_d65(wavelengths_nm.bands)
    return np.asarray(responses @ light)


def _under_d65(bands: tuple[Passband, ...]) -> tuple[Array, Array, Array]:
    """Return visible wavelengths (m,), the power of D65 there, and the responses of bands, (n, m)."""
    w = np.arange(VISIBLE_NM[0], VISIBLE_NM[1] + 1.0)
    responses = [
        np.interp(w, band.response.wavelengths_nm, band.response.values, left=0.0, right=0.0) for band in bands
    ]
    return w, np.interp(w, *named_spectrum("D65")), np.array(responses)


def _of_bands(bands: tuple[Passband, ...]) -> Array | None:
    w, light, responses = _under_d65(bands)
    seen = (responses > 0.0).any(axis=1)
    if seen.sum() < 3:
        return None
    found = fitted_weights(responses[seen], _XYZ_TO_SRGB @ observer(w), light)
    if found is None:
        return None
    weights = np.zeros((3, len(bands)))
    weights[:, seen] = found
    return weights


def to_display(power: NDArray[np.float64], wavelengths_nm: tuple[float, ...]) -> NDArray[np.float64]:
    """Turn (H, W, channels) power into (H, W) grey or (H, W, 3) linear sRGB in the same unit."""
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
