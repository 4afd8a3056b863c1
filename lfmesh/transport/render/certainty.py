"""Certainty of a pixel: standard error, pooled with similar neighbours, and upper bound.

Parts of an image are estimated independently, some by many samples that nearly all carry light, some by a few heavy
ones. Each part has its own error and margin, and their squares are added. A pixel with many direct hits is thus no more
certain than the rarest of its light.

The spread over a few replicates is a poor estimate for a single pixel. With four replicates, a quarter of the pixels
have a third of their true error or less by chance. If only rare samples differ, a pixel has no spread until it meets
one; its neighbours have met them. The reported variance of a pixel is therefore the mean of its own and that of a pool:
pixels around it and at its place in the neighbouring micro-images that are as bright and lie where the picture is as
steep, because an edge is less certain than areas beside it. The mean variance of any group of pixels not selected by
noise stays unchanged. Few hits do not determine brightness: pixels dark by chance would confirm to each other that
nothing was missed. Pixels with few hits are therefore pooled if their hits differ by no more than chance.

A pixel next to much brighter ones may see their light through a corner that none of its samples has met. Its own spread
and that of equally dark pixels do not show this, but the weight of paths met by its neighbours does. It enters the
upper bound (see `weight_around`).
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.scene import Scene
from lfmesh.transport.render.adaptive import RING, ROWS_AT_ONCE, same_place

Array = NDArray[np.float64]

AS_BRIGHT = 1.5
"""Largest ratio of brightness within a pool."""

AS_STEEP = 2.0
"""Largest ratio of steepness within a pool; steepness is the largest step to one of the eight pixels around."""

CONFIDENCE = 0.95

RARE = 1e-3
"""Share of the pixels with hits above the value taken as the largest."""

FEW_HITS = 10
"""Number of hits below which the spread of a pixel is not used alone."""

BY_CHANCE = np.sqrt(2.0)
"""Difference of the roots of two pixels' hits, each plus 3/8 (Anscombe 1948), that is within chance: two standard
deviations, as each root has one of 1/2."""


def neighbours(scene: Scene) -> NDArray[np.int64]:
    """Return the steps (n, 2) (rows, columns) to the pixels around, and to the same place in adjacent micro-images."""
    steps = [*RING, *(step for group in same_place(scene) for step in group)]
    return np.array(steps, np.int64)


def pooled_error(
    part: "Estimate", steps: NDArray[np.int64], rows: slice = slice(None)
) -> tuple[Array, NDArray[np.int64]]:
    """Return each pixel's standard error, with variance pooled over neighbours as bright and as steep.

    If both have few hits, neighbours are alike if their hits are.

    Parameters
    ----------
    part : Estimate
    steps : (n, 2) int64
        See `neighbours`.
    rows : slice
        Rows of the result.

    Returns
    -------
    error : (rows, W, wavelengths) float64, W
        NaN where `stderr` is.
    pooled : (rows, W, wavelengths) int64
        Number of pixels in each pool, the pixel itself included.
    """
    mean, stderr, hits = np.ascontiguousarray(part.mean), np.ascontiguousarray(part.stderr), part.hits
    low, high, _ = rows.indices(len(mean))
    error = np.empty((high - low, *mean.shape[1:]))
    pooled = np.empty(error.shape, np.int64)
    reach = int(np.abs(steps[:, 0]).max(initial=0))
    first, last = max(low - reach, 0), min(high + reach, len(mean))
    steepness = np.empty((last - first, *mean.shape[1:]))
    few = _are_few(hits[first:last], part.samples)
    _pool(mean, stderr, np.ascontiguousarray(hits), few, steps, low, first, steepness, error, pooled)
    return error, pooled


@kernel
def _pool(
    mean: Array, stderr: Array, hits: NDArray[np.uint32], few: NDArray[np.bool_], steps: NDArray[np.int64], low: int,
    first: int, steepness: Array, error: Array, pooled: NDArray[np.int64],
) -> None:  # fmt: skip
    """Write `pooled_error` of the rows from `low` on.

    Parameters
    ----------
    few : (some rows, W, wavelengths) bool
        Pixels with few hits, from the row `first` on.
    steepness : (some rows, W, wavelengths) float64
        Working memory for the same rows.
    """
    rows, columns, colours = mean.shape
    for row in range(len(steepness)):
        for column in range(columns):
            for colour in range(colours):
                steepness[row, column, colour] = _steepness(mean, first + row, column, colour)
    for row in range(low, low + len(error)):
        for column in range(columns):
            for colour in range(colours):
                level, own = mean[row, column, colour], stderr[row, column, colour] ** 2
                total, count, steep = own, 1, steepness[row - first, column, colour]
                root = np.sqrt(hits[row, column, colour] + 0.375)
                for k in range(len(steps)):
                    r, c = row + steps[k, 0], column + steps[k, 1]
                    if 0 <= r < rows and 0 <= c < columns:
                        if few[row - first, column, colour] and few[r - first, c, colour]:
                            alike = abs(np.sqrt(hits[r, c, colour] + 0.375) - root) <= BY_CHANCE
                        else:
                            there = steepness[r - first, c, colour]
                            alike = _are_within(AS_BRIGHT, mean[r, c, colour], level)
                            alike = alike and _are_within(AS_STEEP, there, steep)
                        if alike:
                            total += stderr[r, c, colour] ** 2
                            count += 1
                error[row - low, column, colour] = np.sqrt(0.5 * (own + total / count))
                pooled[row - low, column, colour] = count


@inlined
def _are_within(factor: float, one: float, other: float) -> bool:
    """Tell whether two values differ by no more than a factor."""
    return one <= factor * other and other <= factor * one


@kernel
def _steepness(mean: Array, row: int, column: int, colour: int) -> float:
    """Return the largest difference between a pixel and the pixels around it."""
    rows, columns, _ = mean.shape
    largest = 0.0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            largest = max(largest, abs(mean[r, c, colour] - mean[row, column, colour]))
    return largest


def typical_over_rms(pooled: NDArray[np.int64], groups: int) -> Array:
    """Return the median of `pooled_error` over its rms, for normal groups, to correct medians of errors.

    Half of the variance follows χ² with the groups' degrees of freedom ν and has the median (1 − 2/(9 ν))³ (Wilson &
    Hilferty 1931). The other half is the mean over the pool, which soon equals the true value. Accurate to 3 % against
    random numbers, from one pixel to a large pool.

    Parameters
    ----------
    pooled : int64
        Number of pixels in each pool.
    groups : int
        Independent groups of replicates.
    """
    own = (1.0 - 2.0 / (9.0 * (groups - 1))) ** 3
    return np.sqrt(0.5 * (own + 1.0 - (1.0 - own) / pooled**2))


class Estimate(NamedTuple):
    """Independent estimate of some of an image's light: a part of it, or a single-part image.

    Attributes
    ----------
    mean, stderr : (H, W, wavelengths) float64, W
    hits : (H, W, wavelengths) uint32
    samples : int
        Least number of samples per pixel; forward: total number of packets.
    """

    mean: Array
    stderr: Array
    hits: NDArray[np.uint32]
    samples: int


class Certainty(NamedTuple):
    """Certainty of every pixel of an image.

    Attributes
    ----------
    error : (H, W, wavelengths) float64, W
        Standard error, see `error_of`: the root of the sum of all parts' squares.
    upper : (H, W, wavelengths) float64, W
        Upper bound with a confidence of 95 %; see `upper_bound`.
    """

    error: Array
    upper: Array

    @classmethod
    def of(cls, parts: Sequence[Estimate], scene: Scene, groups: int) -> "Certainty":
        """Return the certainty of an image, the sum of some parts.

        Parameters
        ----------
        parts : sequence of Estimate
        scene : Scene
        groups : int
            Independent groups of replicates.
        """
        steps = neighbours(scene)
        errors = [error_of(part, steps) for part in parts]
        upper = upper_bound(parts, errors, steps, groups)
        for error in errors[1:]:
            np.hypot(errors[0], error, out=errors[0])
        return cls(errors[0], upper)


def error_of(part: Estimate, steps: NDArray[np.int64]) -> Array:
    """Return each pixel's standard error in a part, (H, W, wavelengths) float64, W; see `errors_by_rows`."""
    error = np.empty_like(part.mean)
    for rows, some, _ in errors_by_rows(part, steps):
        error[rows] = some
    return error


def errors_by_rows(part: Estimate, steps: NDArray[np.int64]) -> Iterator[tuple[slice, Array, NDArray[np.int64]]]:
    """Yield each pixel's standard error in a part some rows at a time, to save memory.

    It is `pooled_error`, unless most of the part's hits fall on pixels with few hits. Neighbours may then have missed
    most of the light too, so the pool is all such pixels of the image, weighted by their hits plus one.

    Parameters
    ----------
    part : Estimate
    steps : (n, 2) int64
        See `neighbours`.

    Yields
    ------
    rows : slice
    error : (rows, W, wavelengths) float64, W
    pooled : (rows, W, wavelengths) int64
        Number of pixels in each pool of neighbours.
    """
    rare, square = _square_of_rare_hits(part)
    for low in range(0, len(part.mean), ROWS_AT_ONCE):
        rows = slice(low, low + ROWS_AT_ONCE)
        error, pooled = pooled_error(part, steps, rows)
        for colour in np.flatnonzero(rare):
            hits = part.hits[rows, :, colour]
            few = _are_few(hits, part.samples)
            own = part.stderr[rows, :, colour][few] ** 2
            error[few, colour] = np.sqrt(0.5 * (own + square[colour] * (hits[few] + 1.0)))
        yield rows, error, pooled


def _square_of_rare_hits(part: Estimate) -> tuple[NDArray[np.bool_], Array]:
    """Tell whether most hits fall on pixels with few; return the variance there over hits plus pixels.

    Returns
    -------
    rare : (wavelengths,) bool
    square : (wavelengths,) float64, W²
    """
    in_few, in_all, variance, places = np.zeros((4, part.mean.shape[2]))
    for own, hits in zip(part.stderr, part.hits, strict=True):
        few = _are_few(hits, part.samples)
        in_all += hits.sum(axis=0)
        in_few += hits.sum(axis=0, where=few)
        variance += (own**2).sum(axis=0, where=few)
        places += few.sum(axis=0)
    return 2.0 * in_few > in_all, variance / np.maximum(in_few + places, 1.0)


def _are_few(hits: NDArray[np.uint32], samples: int) -> NDArray[np.bool_]:
    """Tell for each pixel whether it has few hits of enough samples."""
    return (hits < FEW_HITS) & (2 * hits < samples)


def weight_around(mean: Array, error: Array, steps: NDArray[np.int64], rows: slice = slice(None)) -> Array:
    """Return the second largest light of one path among each pixel's neighbours.

    Paths of equal weight w met by chance have a variance of w times their mean, so w is error² / mean: the weight of
    the heaviest paths, however many light ones are met beside them. It is at most the mean. The largest is ignored: a
    single pixel with an extremely rare path says nothing about its surroundings.

    Parameters
    ----------
    mean, error : (H, W, wavelengths) float64, W
        An error of NaN gives no weight.
    steps : (n, 2) int64
        See `neighbours`.
    rows : slice
        Rows of the result.

    Returns
    -------
    (rows, W, wavelengths) float64, W
    """
    low, high, _ = rows.indices(len(mean))
    weight = np.empty((high - low, *mean.shape[1:]))
    _weigh(np.ascontiguousarray(mean), np.ascontiguousarray(error), steps, low, weight)
    return weight


@kernel
def _weigh(mean: Array, error: Array, steps: NDArray[np.int64], low: int, weight: Array) -> None:
    """Write `weight_around` of the rows from `low` on."""
    rows, columns, colours = mean.shape
    for row in range(low, low + len(weight)):
        for column in range(columns):
            for colour in range(colours):
                largest, second = 0.0, 0.0
                for k in range(len(steps)):
                    r, c = row + steps[k, 0], column + steps[k, 1]
                    if 0 <= r < rows and 0 <= c < columns and error[r, c, colour] > 0.0 and mean[r, c, colour] > 0.0:
                        there = mean[r, c, colour] * min(1.0, (error[r, c, colour] / mean[r, c, colour]) ** 2)
                        largest, second = max(largest, there), max(second, min(largest, there))
                weight[row - low, column, colour] = second


def upper_bound(parts: Sequence[Estimate], errors: Sequence[Array], steps: NDArray[np.int64], groups: int) -> Array:
    """Return each pixel's upper bound, (H, W, wavelengths) float64, W, with a confidence of 95 % each.

    Each part has a margin above its mean. Parts are independent, so the squares of the margins are added. A part's
    margin is the largest of these:

    - Student's one-sided quantile of errors;
    - with fewer than `FEW_HITS` hits, the Clopper & Pearson (1934) limit on the share of samples that carry light,
      1 − 0.05^(1/n) or about 3/n without a hit in n samples, times the light of such a sample: the mean of the pixel's
      own hits and one further hit of the largest value, the 99.9 % quantile of the pixels' average hits. Heavier paths,
      too rare to be bounded in one pixel, add their mean over all pixels;
    - the limit without a hit times the weight of paths met by neighbours, which the pixel may have missed however many
      hits it has.

    It does not bound light along kinds of paths that no sample of the whole image has found.

    Parameters
    ----------
    parts : sequence of Estimate
        Their sum is the image.
    errors : sequence of (H, W, wavelengths) float64, W
        Error of each part, see `error_of`.
    steps : (n, 2) int64
        See `neighbours`.
    groups : int
        Independent groups of replicates.
    """
    from scipy import special

    quantile = float(special.stdtrit(groups - 1, CONFIDENCE)) if groups > 1 else np.nan
    bound, squares = np.zeros((2, *parts[0].mean.shape))
    for part, error in zip(parts, errors, strict=True):
        # Without a spread, the bound rests on the hits alone.
        few = np.arange(FEW_HITS if groups > 1 else int(part.hits.max(initial=0)) + 1)
        # With as many hits as samples, the limit on the share is 1.
        missed = np.maximum(part.samples - few, 1.0)
        limit = np.where(few < part.samples, special.betaincinv(few + 1.0, missed, CONFIDENCE), 1.0)
        most, beyond = _largest_hit(part.mean, part.hits)
        for row, hits in enumerate(part.hits):
            own, margin = part.mean[row], quantile * error[row]
            unmet = part.samples * limit[0] * weight_around(part.mean, error, steps, slice(row, row + 1))[0]
            margin = np.fmax(margin, unmet)
            count = np.minimum(hits, len(few) - 1)
            one_path = part.samples * (own + most) / (count + 1.0)
            by_hits = limit[count] * one_path + beyond - own
            bound[row] += own
            squares[row] += np.where(hits < len(few), np.fmax(margin, by_hits), margin) ** 2
    bound += np.sqrt(squares, out=squares)
    return bound


def _largest_hit(mean: Array, hits: NDArray[np.uint32]) -> tuple[Array, Array]:
    """Return the largest value of a hit in all but rare pixels, and the rare ones' mean light over all pixels.

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
