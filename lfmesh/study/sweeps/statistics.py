"""Estimates from replicates: jackknife, products of independent images, lines with confidence intervals."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
"""Numbers of replicates."""


def pseudo_values(estimate: Callable[[Numbers], Array], replicates: int) -> Array:
    """Return one value per replicate, with the estimate as mean and the jackknife's standard error.

    They are Tukey's pseudo-values (1958), shifted to the estimate. Their own mean has less bias, but the correction
    (Quenouille 1956) is the difference of two noisy numbers times n − 1: an estimate that is not smooth would scatter
    by a quarter more than the jackknife says. The noise bias of squares is removed by products.

    Parameters
    ----------
    estimate : callable
        Returns (columns,) float64 for the numbers of the replicates to use, (n,) int64.
    replicates : int

    Returns
    -------
    (replicates, columns) float64
    """
    numbers = np.arange(replicates)
    whole = np.asarray(estimate(numbers), dtype=np.float64)
    without = np.stack([np.asarray(estimate(np.delete(numbers, k)), dtype=np.float64) for k in numbers])
    return whole + (replicates - 1) * (without.mean(axis=0) - without)


PARTS = 64
"""Parts of a picture, used to estimate the error component specific to each pair of replicates."""


def in_parts(image: Array) -> Array:
    """Divide an image into contiguous parts of equal size, (PARTS, n) float64; the last ones end in zeros."""
    flat = image.reshape(-1)
    length = -(-flat.size // PARTS)
    return np.pad(flat, (0, PARTS * length - flat.size)).reshape(PARTS, length)


def inner_products(images: Sequence[Array]) -> Array:
    """Return the contributions of each part to the mean products of images, symmetric, (PARTS, n, n).

    No matrix product is used: its bits may depend on the number of threads.
    """
    parts, size = [in_parts(image) for image in images], images[0].size
    products = np.empty((PARTS, len(parts), len(parts)))
    for i, one in enumerate(parts):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = (one * parts[j]).sum(axis=1) / size
    return products


def independent_product(products: Array) -> float:
    """Return the mean product of different (independent) replicates from the products by parts."""
    whole = products.sum(axis=0)
    n = len(whole)
    return float((whole.sum() - np.trace(whole)) / (n * (n - 1)))


def chosen(products: Array, use: Numbers) -> Array:
    """Return the products of some replicates, (PARTS, len(use), len(use))."""
    return products[:, use[:, None], use]


def of_products(estimate: Callable[[Numbers], Array], kernel: Array) -> Array:
    """Return the jackknife pseudo-values of an estimate from products of pairs of replicates, (n, 1).

    The jackknife overestimates the variance component specific to pairs by a factor of 2(n − 1)/(n − 2), or 3 for four
    replicates (Efron and Stein 1981). The component follows from the part of the kernel that is not a sum over the two
    replicates of a pair, and the pseudo-values are scaled accordingly. Four replicates alone have too few degrees of
    freedom (two); the parts of a picture, with independent noise, provide enough.

    Parameters
    ----------
    estimate : callable
        As for `pseudo_values`; one column.
    kernel : (parts, n, n) float64
        Effect of each pair on the estimate in each part of the picture, up to a factor; symmetric, diagonals are
        ignored.
    """
    pseudo = pseudo_values(estimate, kernel.shape[-1])
    mean = pseudo.mean(axis=0)
    return np.asarray(mean + math.sqrt(_share_without_excess(kernel)) * (pseudo - mean))


def mean_square(values: Array) -> Array:
    """Return pseudo-values of the mean square of an estimate, (n,), from its own, without a bias from noise.

    For a single value the error follows by first-order propagation.

    Parameters
    ----------
    values : (n, ...) float64
        The square is averaged over all axes but the first; values with n = 1 are exact.
    """
    n, mean = len(values), values.mean(axis=0)
    if n == 1:
        return np.array([(values**2).mean()])
    if mean.size == 1:
        single = values.reshape(n)
        return np.asarray(mean.item() ** 2 - single.var(ddof=1) / n + 2.0 * mean.item() * (single - mean.item()))
    products = inner_products(list(values))
    return of_products(lambda use: np.array([independent_product(chosen(products, use))]), products)[:, 0]


def _share_without_excess(kernel: Array) -> float:
    """Return the variance of a mean over pairs, as a fraction of the jackknife's."""
    n = kernel.shape[-1]
    if n < LEAST_PAIRED or not np.isfinite(kernel).all():
        return 1.0
    pairs = np.where(np.eye(n, dtype=np.bool_), 0.0, kernel)
    sums = pairs.sum(axis=2)
    totals = sums.sum(axis=1)
    jackknife = 4.0 * ((sums - totals[:, None] / n) ** 2).sum(axis=1) / (n * (n - 1) * (n - 2) ** 2)
    total = float(jackknife.sum())
    if not total > 0.0:
        return 1.0
    # Effective number of parts of equal weight.
    parts = 1.0 / float(((jackknife / total) ** 2).sum())
    mean = totals[:, None, None] / ((n - 1) * (n - 2))
    rest = pairs - (sums[:, :, None] + sums[:, None, :]) / (n - 2) + mean
    first, second = np.triu_indices(n, 1)
    # Variance specific to pairs, from the rest; the prior, worth one degree of freedom, is all of the jackknife's.
    excessive, degrees = 4.0 / (n * (n - 2)), 0.5 * n * (n - 3)
    own = (excessive * float((rest[:, first, second] ** 2).sum()) + total / parts) / (degrees + 1.0 / parts)
    # The component cannot exceed the whole.
    least = 0.5 * (n - 2) / (n - 1)
    return max(1.0 - (1.0 - least) * own / total, least)


LEAST_PAIRED = 4
"""Smallest number of replicates that separates the component specific to pairs."""


class Estimate(NamedTuple):
    """A value and its standard error; NaN if unknown."""

    value: float
    stderr: float


def combined(pseudo: Array) -> Estimate:
    """Return the mean of pseudo-values and its standard error; 0 for a single value, which is exact.

    Parameters
    ----------
    pseudo : (n,) float64
    """
    if len(pseudo) == 1:
        return Estimate(float(pseudo[0]), 0.0)
    return Estimate(float(pseudo.mean()), float(pseudo.std(ddof=1) / math.sqrt(len(pseudo))))


class Slope(NamedTuple):
    """Derivative of a quantity by a parameter, with its 95 % confidence interval."""

    value: float
    low: float
    high: float
    points: int


LEAST_POINTS = 3
"""Smallest number of points for a slope with an interval."""


def slope(x: Array, y: Array, stderr: Array) -> Slope | None:
    """Return the slope of a least-squares line.

    The interval uses Student's quantile and covers the points' standard errors and any larger scatter about the line.

    Parameters
    ----------
    x, y, stderr : (n,) float64
    """
    from scipy.stats import t as student

    known = np.isfinite(x) & np.isfinite(y) & np.isfinite(stderr)
    x, y, stderr = x[known], y[known], stderr[known]
    n = len(x)
    if n < LEAST_POINTS or not np.ptp(x) > 0.0:
        return None
    off = x - x.mean()
    spread = float((off**2).sum())
    # Exactly 0 for equal values.
    from_mean = y - y.mean()
    value = float((off * from_mean).sum() / spread)
    residual = from_mean - value * off
    scatter = float((residual**2).sum()) / (n - 2) / spread
    noise = float(((off * stderr) ** 2).sum()) / spread**2
    reach = float(student.ppf(0.975, n - 2)) * math.sqrt(max(scatter, noise))
    return Slope(value, value - reach, value + reach, n)


class Share(NamedTuple):
    """Fraction of successful trials, with its 95 % confidence interval (Clopper and Pearson 1934)."""

    good: int
    trials: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The fraction itself."""
        return self.good / self.trials if self.trials else math.nan


def share_of(good: int, trials: int) -> Share:
    """Return the fraction of successes in independent trials, with the interval of their probability."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, good, trials - good + 1)) if good else 0.0
    high = float(beta.ppf(0.975, good + 1, trials - good)) if good < trials else 1.0
    return Share(good, trials, low, high)
