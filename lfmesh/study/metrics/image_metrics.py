"""Metrics of the raw image: differences from the reference, light, ghosts, cross-talk and noise."""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.study.metrics.comparison import Comparison, from_replicates
from lfmesh.study.metrics.similarity import structural_similarity
from lfmesh.study.sweeps.statistics import (
    Numbers,
    chosen,
    independent_product,
    inner_products,
    of_products,
)

Array = NDArray[np.float64]


def psnr(pair: Comparison) -> Array:
    """Return pseudo-values of the peak signal-to-noise ratio.

    Parameters
    ----------
    pair : Comparison
    """
    differences = inner_products(list(pair.films["scene"] - pair.reference_films["scene"]))
    squares, light = pair.reference_products, pair.reference_light

    def estimate(use: Numbers) -> Array:
        return np.array([independent_product(chosen(differences, use)) / pair.peak(use) ** 2])

    square = independent_product(differences)
    mean, of_light = light.sum(axis=0).mean(), independent_product(squares)
    moved = (light[:, :, None] + light[:, None, :]) / mean - 2.0 * squares / of_light
    return of_products(estimate, differences + square * moved)


def ncc(pair: Comparison) -> Array:
    """Return pseudo-values of the normalised cross-correlation.

    Parameters
    ----------
    pair : Comparison
    """
    n, products = pair.replicates, pair.products
    own, other = products[:, :n, :n], products[:, n:, n:]
    both = 0.5 * (products[:, :n, n:] + products[:, n:, :n])

    def estimate(use: Numbers) -> Array:
        one, two, mixed = (independent_product(chosen(each, use)) for each in (own, other, both))
        return np.array([mixed / math.sqrt(one * two) if one > 0.0 and two > 0.0 else math.nan])

    one, two, mixed = map(independent_product, (own, other, both))
    return of_products(estimate, both / np.float64(mixed) - 0.5 * own / np.float64(one) - 0.5 * other / np.float64(two))


def ssim(pair: Comparison) -> Array:
    """Return pseudo-values of the structural similarity.

    Parameters
    ----------
    pair : Comparison
    """
    own, other = pair.films["scene"].sum(axis=3), pair.reference_films["scene"].sum(axis=3)
    channels = pair.films["scene"].shape[3]

    def estimate(use: Numbers) -> Array:
        peak = channels * pair.peak(use)
        return np.array([structural_similarity(own[use].mean(axis=0), other[use].mean(axis=0), peak)])

    # SSIM of the pictures with their noise; the larger noise of fewer replicates is not corrected for.
    return from_replicates(estimate, pair)


def light(pair: Comparison) -> Array:
    """Return pseudo-values of the light per pixel, absolute and relative to the reference.

    Parameters
    ----------
    pair : Comparison
    """
    own = pair.films["scene"].mean(axis=(1, 2, 3))
    other = pair.reference_films["scene"].mean(axis=(1, 2, 3))

    def estimate(use: Numbers) -> Array:
        mean = own[use].mean()
        return np.array([mean, mean / other[use].mean()])

    return from_replicates(estimate, pair)


def ghosts(pair: Comparison) -> Array:
    """Return pseudo-values of the fraction of light that was reflected on its path.

    Parameters
    ----------
    pair : Comparison
    """
    both = pair.films["scene"].mean(axis=(1, 2, 3))
    alone = pair.films["image path"].mean(axis=(1, 2, 3))

    def estimate(use: Numbers) -> Array:
        return np.array([1.0 - alone[use].mean() / both[use].mean()])

    return from_replicates(estimate, pair)


def noise(pair: Comparison) -> Array:
    """Return pseudo-values of the noise relative to the image.

    Parameters
    ----------
    pair : Comparison
    """
    products = inner_products(list(pair.films["scene"]))

    def estimate(use: Numbers) -> Array:
        signal = np.float64(independent_product(chosen(products, use)))
        # Noise of the mean of all replicates, whatever number the estimate is from.
        return np.array([(own[:, use].sum() / len(use) - signal) / pair.replicates / signal])

    own = products.diagonal(axis1=1, axis2=2)
    signal = np.float64(independent_product(products))
    mean = own.sum(axis=0).mean()
    return of_products(estimate, 0.5 * (own[:, :, None] + own[:, None, :]) - products * mean / signal)


def crosstalk(pair: Comparison) -> Array:
    """Return pseudo-values of the fraction of light through other lenslets.

    Parameters
    ----------
    pair : Comparison
    """
    own, others = (pair.films["lenslets"][..., i].sum(axis=(1, 2)) for i in (0, 1))

    def estimate(use: Numbers) -> Array:
        return np.array([others[use].sum() / (own[use] + others[use]).sum()])

    return from_replicates(estimate, pair)
