"""Estimates from replicates: jackknife, products of independent images, lines with confidence intervals."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
"""Of replicates."""


def pseudo_values(estimate: Callable[[Numbers], Array], replicates: int) -> Array:
    """Return values of replicates whose mean is an estimate and whose standard error is the jackknife's.

    They are Tukey's pseudo-values (1958), moved to have the estimate for a mean. Their own mean has less bias, but that
    correction (Quenouille 1956) is the difference of two noisy numbers, (n − 1) times over: where an estimate is not
    smooth it scatters by a quarter more than the jackknife says. Noise that adds to squares is taken off by products.

    Parameters
    ----------
    estimate : callable
        Given the numbers of the replicates to use, (n,) int64, returns (columns,) float64.
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
"""Of a picture, from which it is told what of an error each pair of replicates has of its own."""


def in_parts(image: Array) -> Array:
    """Return an image as contiguous parts of equal size, (PARTS, n) float64; the last ones end in zeros."""
    flat = image.reshape(-1)
    length = -(-flat.size // PARTS)
    return np.pad(flat, (0, PARTS * length - flat.size)).reshape(PARTS, length)


def inner_products(images: Sequence[Array]) -> Array:
    """Return what each part of images adds to the means of their products, symmetric matrices, (PARTS, n, n).

    Without a matrix product: the bits of that may depend on the number of threads.
    """
    parts, size = [in_parts(image) for image in images], images[0].size
    products = np.empty((PARTS, len(parts), len(parts)))
    for i, one in enumerate(parts):
        for j in range(i + 1):
            products[:, i, j] = products[:, j, i] = (one * parts[j]).sum(axis=1) / size
    return products


def independent_product(products: Array) -> float:
    """Return the mean product of different replicates, whose noise is independent, from the products by parts."""
    whole = products.sum(axis=0)
    n = len(whole)
    return float((whole.sum() - np.trace(whole)) / (n * (n - 1)))


def chosen(products: Array, use: Numbers) -> Array:
    """Return the products of some replicates, (PARTS, len(use), len(use))."""
    return products[:, use[:, None], use]


def of_products(estimate: Callable[[Numbers], Array], kernel: Array) -> Array:
    """Return the jackknife pseudo-values of an estimate that follows from products of pairs of replicates, (n, 1).

    The jackknife takes the part of the variance that each pair has of its own 2(n − 1)/(n − 2) times: of four
    replicates three times (Efron and Stein 1981). How much of it that is, is found from what of the kernel is no sum
    over the two replicates of a pair, and the pseudo-values are drawn together to the variance without the excess. Two
    degrees of freedom of four replicates would not tell; those of all parts of a picture do, as the noise of different
    parts is independent.

    Parameters
    ----------
    estimate : callable
        As for `pseudo_values`; one column.
    kernel : (parts, n, n) float64
        By how much each pair moves the estimate in each part of the picture, up to a factor; symmetric, the diagonals
        do not count.
    """
    pseudo = pseudo_values(estimate, kernel.shape[-1])
    mean = pseudo.mean(axis=0)
    return np.asarray(mean + math.sqrt(_share_without_excess(kernel)) * (pseudo - mean))


def mean_square(values: Array) -> Array:
    """Return pseudo-values of the mean square of an estimate, (n,), from its own pseudo-values; noise does not add.

    That of a single value has the error of the value, by first-order propagation.

    Parameters
    ----------
    values : (n, ...) float64
        The square is averaged over all axes but the first; with n = 1 they are exact.
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
    """Return the variance of a mean over pairs over the jackknife's."""
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
    # Of equal weight.
    parts = 1.0 / float(((jackknife / total) ** 2).sum())
    mean = totals[:, None, None] / ((n - 1) * (n - 2))
    rest = pairs - (sums[:, :, None] + sums[:, None, :]) / (n - 2) + mean
    first, second = np.triu_indices(n, 1)
    # The pairs' own variance by the rest, with a degree of freedom for that it is all that the jackknife has.
    excessive, degrees = 4.0 / (n * (n - 2)), 0.5 * n * (n - 3)
    own = (excessive * float((rest[:, first, second] ** 2).sum()) + total / parts) / (degrees + 1.0 / parts)
    # No more than all of it is the pairs' own.
    least = 0.5 * (n - 2) / (n - 1)
    return max(1.0 - (1.0 - least) * own / total, least)


LEAST_PAIRED = 4
"""Replicates from whose pairs the part of each pair is told."""


class Estimate(NamedTuple):
    """A value and its standard error; NaN where it has none."""

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
    """The derivative of a quantity by a parameter, with its 95 % confidence interval."""

    value: float
    low: float
    high: float
    points: int


LEAST_POINTS = 3
"""Points of a line whose slope has an interval."""


def slope(x: Array, y: Array, stderr: Array) -> Slope | None:
    """Fit a straight line by least squares, and return its slope.

    The interval has Student's quantile and covers both the standard errors of the points and, where they scatter more
    than these explain, how far they lie beside the line.

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
    # Of equal values exactly 0.
    from_mean = y - y.mean()
    value = float((off * from_mean).sum() / spread)
    residual = from_mean - value * off
    scatter = float((residual**2).sum()) / (n - 2) / spread
    noise = float(((off * stderr) ** 2).sum()) / spread**2
    reach = float(student.ppf(0.975, n - 2)) * math.sqrt(max(scatter, noise))
    return Slope(value, value - reach, value + reach, n)


class Share(NamedTuple):
    """A share of trials that went well, with its 95 % confidence interval (Clopper and Pearson 1934)."""

    good: int
    trials: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share itself."""
        return self.good / self.trials if self.trials else math.nan


def share_of(good: int, trials: int) -> Share:
    """Return how many of some independent trials went well, with the interval of their probability."""
    from scipy.stats import beta

    low = float(beta.ppf(0.025, good, trials - good + 1)) if good else 0.0
    high = float(beta.ppf(0.975, good + 1, trials - good)) if good < trials else 1.0
    return Share(good, trials, low, high)
