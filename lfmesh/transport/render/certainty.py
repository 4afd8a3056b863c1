"""How well a pixel is known: its error, pooled with that of like neighbours, and a bound on what it may hold.

The spread over a few replicates says little about one pixel: of four, a quarter of the pixels agree by chance to a
third of their error, and a pixel of which all samples but rare ones bring the same agrees exactly until it meets one of
those. Its neighbours have met them. So the error reported for a pixel is half its own and half that of the pixels that
are as bright and stand in as steep a part of the picture, around it and at its place in the neighbouring micro-images:
an edge is known less well than what it bounds. Over any group of pixels that is not chosen by its noise it stays what
the spread is on average.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import kernel
from lfmesh.scene import Scene
from lfmesh.transport.render.adaptive import RING, same_place

Array = NDArray[np.float64]

AS_BRIGHT = 1.5
"""Ratio up to which a neighbour is as bright."""

AS_STEEP = 2.0
"""Ratio up to which the picture is as steep there: the largest step to one of the eight pixels around."""

CONFIDENCE = 0.95

RARE = 1e-3
"""Share of the pixels whose hits bring more than what is taken for the most that one brings."""

FEW_HITS = 10
"""Below so many the spread of a pixel is not trusted to know what its paths bring."""


def neighbours(scene: Scene) -> NDArray[np.int64]:
    """Return the steps (n, 2) (rows, columns) to the pixels around, and to the same place in the next micro-images."""
    steps = [*RING, *(step for group in same_place(scene) for step in group)]
    return np.array(steps, np.int64)


def pooled_error(
    mean: Array, stderr: Array, steps: NDArray[np.int64], rows: slice = slice(None)
) -> tuple[Array, NDArray[np.int64]]:
    """Return the standard error of each pixel, its own variance pooled with that of neighbours as bright and as steep.

    Parameters
    ----------
    mean, stderr : (H, W, wavelengths) float64, W
    steps : (n, 2) int64
        See `neighbours`.
    rows : slice
        Of the pixels that are asked for.

    Returns
    -------
    error : (rows, W, wavelengths) float64, W
        NaN where `stderr` is.
    pooled : (rows, W, wavelengths) int64
        Pixels in each pool, itself counted.
    """
    mean, stderr = np.ascontiguousarray(mean), np.ascontiguousarray(stderr)
    low, high, _ = rows.indices(len(mean))
    error = np.empty((high - low, *mean.shape[1:]))
    pooled = np.empty(error.shape, np.int64)
    _pool(mean, stderr, steps, low, error, pooled)
    return error, pooled


@kernel
def _pool(
    mean: Array, stderr: Array, steps: NDArray[np.int64], low: int, error: Array, pooled: NDArray[np.int64]
) -> None:
    """Write `pooled_error` of the rows from `low` on."""
    rows, columns, colours = mean.shape
    for row in range(low, low + len(error)):
        for column in range(columns):
            for colour in range(colours):
                level, own = mean[row, column, colour], stderr[row, column, colour] ** 2
                total, count, steep = own, 1, _steepness(mean, row, column, colour)
                for k in range(len(steps)):
                    r, c = row + steps[k, 0], column + steps[k, 1]
                    if 0 <= r < rows and 0 <= c < columns:
                        other = mean[r, c, colour]
                        if other <= AS_BRIGHT * level and level <= AS_BRIGHT * other:
                            there = _steepness(mean, r, c, colour)
                            if there <= AS_STEEP * steep and steep <= AS_STEEP * there:
                                total += stderr[r, c, colour] ** 2
                                count += 1
                error[row - low, column, colour] = np.sqrt(0.5 * (own + total / count))
                pooled[row - low, column, colour] = count


@kernel
def _steepness(mean: Array, row: int, column: int, colour: int) -> float:
    """Return the largest difference between a pixel and those around it."""
    rows, columns, _ = mean.shape
    largest = 0.0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            largest = max(largest, abs(mean[r, c, colour] - mean[row, column, colour]))
    return largest


def typical_over_rms(pooled: NDArray[np.int64], replicates: int) -> Array:
    """Return the median of `pooled_error` over its rms, for normal replicates: a median would be too small by it.

    Half of the variance is χ² with the replicates' degrees of freedom ν, of which the median is (1 − 2/(9 ν))³ (Wilson
    & Hilferty 1931); the other half is the mean over the pool, which is soon as good as the truth: within 3 % of what
    random numbers give, from one pixel to a large pool.
    """
    own = (1.0 - 2.0 / (9.0 * (replicates - 1))) ** 3
    return np.sqrt(0.5 * (own + 1.0 - (1.0 - own) / pooled**2))


def upper_bound(mean: Array, stderr: Array, hits: NDArray[np.uint32], replicates: int, samples: int) -> Array:
    """Return what each pixel holds at most, with a confidence of 95 % pixel by pixel.

    With many hits that is the mean and Student's one-sided quantile of standard errors. With less than `FEW_HITS` the
    share of the samples that bring light is not known well: it is below the limit of Clopper & Pearson (1934), for no
    hit of n samples 1 - 0.05^(1/n), about 3/n. Such a sample is taken to bring what those of the pixel did, together
    with one that brings the most: as much as a hit does on average in the pixel of a thousand where hits bring the
    most. Without a hit in the pixel itself that is all there is to go by. Paths heavier than that, too rare for a pixel
    to tell how rare, are added as what they bring to all pixels on average. The larger of the two bounds holds.

    It is no bound on light of a kind that no sample of the whole image has met.

    Parameters
    ----------
    mean, stderr : (H, W, wavelengths) float64, W
    hits : (H, W, wavelengths) uint32
    replicates : int
    samples : int
        That every pixel got at least; forward: packets in all.
    """
    from scipy import special

    bound = np.empty_like(mean)
    quantile = float(special.stdtrit(replicates - 1, CONFIDENCE)) if replicates > 1 else np.nan
    # Without a spread, hits are all there is to go by.
    few = np.arange(FEW_HITS if replicates > 1 else int(hits.max(initial=0)) + 1)
    # With as many hits as samples there may be one in each.
    limit = np.where(few < samples, special.betaincinv(few + 1.0, np.maximum(samples - few, 1.0), CONFIDENCE), 1.0)
    most, beyond = _largest_hit(mean, hits)
    for row in range(len(mean)):
        bound[row] = mean[row] + quantile * stderr[row]
        unsure = hits[row] < len(few)
        count = np.minimum(hits[row], len(few) - 1)
        one_path = samples * (mean[row] + most) / (count + 1.0)
        bound[row] = np.where(unsure, np.fmax(bound[row], limit[count] * one_path + beyond), bound[row])
    return bound


def _largest_hit(mean: Array, hits: NDArray[np.uint32]) -> tuple[Array, Array]:
    """Return the most that a hit brings in all but rare pixels, as a part of a pixel's mean, and the mean of the rare.

    Returns
    -------
    most, beyond : (wavelengths,) float64, W
    """
    most, beyond = np.zeros((2, mean.shape[2]))
    for colour in range(mean.shape[2]):
        power, count = mean[:, :, colour], hits[:, :, colour]
        lit = count > 0
        if lit.any():
            each = power[lit] / count[lit]
            most[colour] = np.quantile(each, 1.0 - RARE, method="higher")
            beyond[colour] = power[lit][each > most[colour]].sum() / power.size
    return most, beyond
