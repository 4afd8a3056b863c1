"""Conversion of image channels to a picture for the eye: grey, or linear sRGB if the channels span colours."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.cie import named_spectrum, observer
from lfmesh.scene.camera.bands import VISIBLE_NM, Centroids, Passband

Array = NDArray[np.float64]

_XYZ_TO_SRGB = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
"""IEC 61966-2-1."""

ALIKE = 1e-4
"""Smallest eigenvalue of the responses' correlation matrix at which channels still distinguish three colours."""

LEAST = 0.05
"""Smallest share of white in each primary; below it the picture is grey."""


def srgb_weights(wavelengths_nm: tuple[float, ...]) -> Array | None:
    """Return the (3, n) weights that turn n channels into linear sRGB, or None for a grey picture.

    For single wavelengths, equal power in every channel appears white, as a few samples do not determine the
    illuminant. For bands, illuminant D65 (the white of sRGB) appears white; the weights fit the band responses to the
    CIE 1931 observer by least squares under D65. For the bands "xyz" they are the matrix of the standard.

    The picture is grey with fewer than three channels or a nearly empty primary, as with infrared bands.

    Parameters
    ----------
    wavelengths_nm : tuple of float
        Wavelengths of the channels; for bands, their `Centroids`.
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
    """Return a description of the light that pictures show as white."""
    if srgb_weights(wavelengths_nm) is None:
        return "grey picture"
    return "D65" if isinstance(wavelengths_nm, Centroids) else "equal power in every channel"


def fitted_weights(signals: Array, wanted: Array, white: Array) -> Array | None:
    """Return the (3, n) weights that fit n signals to wanted colours, exactly for white.

    Parameters
    ----------
    signals : (n, m) float64
        Responses to m lights.
    wanted : (3, m) float64
        Colours of the lights.
    white : (m,) float64
        Amounts of the lights that together appear white: all primaries equal the mean signal.

    Returns
    -------
    (3, n) float64
        None if the signals do not distinguish three colours.
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
    """Return each channel's signal (n,), in arbitrary units, for the light that pictures show as white.

    Parameters
    ----------
    wavelengths_nm : tuple of float
        See `srgb_weights`.
    """
    if not isinstance(wavelengths_nm, Centroids):
        return np.ones(len(wavelengths_nm))
    _, light, responses = _under_d65(wavelengths_nm.bands)
    return np.asarray(responses @ light)


def _under_d65(bands: tuple[Passband, ...]) -> tuple[Array, Array, Array]:
    """Return visible wavelengths (m,), the power of D65 there (m,), and the responses of the bands (n, m)."""
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
    """Convert (H, W, channels) power to (H, W) grey or (H, W, 3) linear sRGB in the same unit."""
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
    """Return (n, 3) sRGB line colours, 0 to 1, for (n,) wavelengths in nm: the perceived hue at uniform brightness.

    Spectral colours lie outside the sRGB gamut, so white is added until no component is negative, plus a little to keep
    deep blue and red visible. Ultraviolet and infrared take the colours of the spectrum's ends.
    """
    visible = np.clip(wavelength_nm, 400.0, 680.0)
    rgb = (_XYZ_TO_SRGB @ observer(visible)).T
    rgb -= np.minimum(rgb.min(axis=1, keepdims=True), 0.0)
    rgb = rgb / rgb.max(axis=1, keepdims=True) * 0.96 + 0.04
    return np.asarray(srgb_encode(rgb) / 255.0)
