"""Structural similarity of two pictures."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIGMA_PX = 1.5
REACH = 3.5
"""Half-width of the Gaussian window in sigmas, so that it is 11 pixels wide."""
K1, K2 = 0.01, 0.03


def structural_similarity(one: Array, other: Array, brightest: float) -> float:
    """Return the mean structural similarity (SSIM) of two pictures; 1 for equal ones.

    Z. Wang et al., IEEE Trans. Image Process. 13 (2004) 600: Gaussian window of 1.5 pixels, K1 = 0.01, K2 = 0.03,
    population covariances, without a border of 5 pixels.

    Parameters
    ----------
    one, other : (H, W) float64
    brightest : float
        Range of the data.
    """
    from scipy.ndimage import gaussian_filter

    def smooth(picture: Array) -> Array:
        return np.asarray(gaussian_filter(picture, SIGMA_PX, truncate=REACH))

    mean, mean_other = smooth(one), smooth(other)
    variance, variance_other = smooth(one * one) - mean**2, smooth(other * other) - mean_other**2
    covariance = smooth(one * other) - mean * mean_other
    c1, c2 = (K1 * brightest) ** 2, (K2 * brightest) ** 2
    top = (2.0 * mean * mean_other + c1) * (2.0 * covariance + c2)
    bottom = (mean**2 + mean_other**2 + c1) * (variance + variance_other + c2)
    edge = int(REACH * SIGMA_PX + 0.5)
    inside = (slice(edge, -edge),) * 2 if min(one.shape) > 2 * edge else (slice(None),) * 2
    return float((top / bottom)[inside].mean())
