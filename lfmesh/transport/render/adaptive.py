"""Adaptive sampling: samples of each pixel in a second stage, by the noise of the first.

Only neighbours decide: the pixels around, and at the same place in the micro-images of neighbouring lenslets. As pixels
have independent random numbers, the decision is independent of the pixel's own first stage. The stages can therefore be
averaged by their samples without bias, and their variances added. Weights from the pixel's own noise would favour the
stage that missed the bright paths.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.scene import Scene

Array = NDArray[np.float64]
Counts = NDArray[np.uint8]

DIM_SHARE = 0.05
"""Floor of a pixel's power in its relative error, as a share of the bright pixels' power."""

BRIGHT_PERCENTILE = 99.0

RING = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""Steps (rows, columns) to the eight pixels around."""

ROWS_AT_ONCE = 256
"""Rows of the sensor processed together, to bound the memory."""


@dataclass(frozen=True)
class Refinement:
    """Result of adaptive sampling.

    Attributes
    ----------
    target_error : float
        Target relative standard error.
    max_samples : int
        Largest number of samples per pixel.
    replicates : int
        Number of finished replicates of the second stage.
    samples : float
        Samples per pixel in both stages, mean over the pixels.
    refined_share : float
        Share of the pixels with samples in the second stage.
    capped_share : float
        Share of the pixels that would need more than `max_samples`.
    """

    target_error: float
    max_samples: int
    replicates: int
    samples: float
    refined_share: float
    capped_share: float


def samples_of(levels: Counts) -> NDArray[np.int64]:
    """Return the samples in a replicate for levels: none, 1, 2, 4, ..."""
    return np.where(levels > 0, np.int64(1) << np.maximum(levels.astype(np.int64) - 1, 0), 0)


def total_samples(levels: Counts, thinned: Callable[[int], int] = int) -> int:
    """Return the samples of all pixels in a replicate; `thinned` maps a pixel's samples to a part's."""
    pixels = np.bincount(levels.ravel())
    samples = samples_of(np.arange(1, len(pixels), dtype=np.uint8))
    return sum(int(count) * thinned(int(each)) for count, each in zip(pixels[1:], samples, strict=True))


def second_stage(mean: Array, variance: Array, scene: Scene) -> tuple[Counts, float]:
    """Return the samples of each pixel in a second stage, as levels.

    Parameters
    ----------
    mean, variance : (H, W, wavelengths) float64
        Mean of the first stage, and its variance.
    scene : Scene
        With `transport.target_error`.

    Returns
    -------
    levels : (H, W) uint8
        See `samples_of`.
    capped_share : float
        Share of the pixels that would need more than `max_samples`.
    """
    transport = scene.transport
    assert transport.target_error is not None
    first = transport.samples_each
    room = transport.max_samples // transport.replicates - first
    top = room.bit_length() if room > 0 else 0
    rows, columns = mean.shape[:2]
    levels = np.zeros((rows, columns), np.uint8)
    capped = 0
    groups = [RING, *same_place(scene)]
    bright = _bright_of_other_squares(mean)
    for low in range(0, rows, ROWS_AT_ONCE):
        high = min(low + ROWS_AT_ONCE, rows)
        noise = _relative_variance(mean, variance, groups, low, high, bright)
        # The variance of a mean falls at least in proportion to the number of samples.
        needed = first * (noise / transport.target_error**2 - 1.0)
        wished = np.where(needed > 0.0, np.ceil(np.log2(np.maximum(needed, 1.0))) + 1.0, 0.0)
        capped += int((needed > room).sum())
        levels[low:high] = np.minimum(wished, top)
    return levels, capped / levels.size


def same_place(scene: Scene) -> list[tuple[tuple[int, int], ...]]:
    """Return the steps (rows, columns) to the same place in neighbouring micro-images, if any."""
    mla, pitch = scene.camera.mla, solved_camera(scene).facts.micro_image_pitch_px
    if mla is None or pitch is None or pitch < 2.0:
        return []
    angles = np.deg2rad(np.arange(0, 360, 60 if mla.layout == "hexagonal" else 90))
    return [tuple((round(pitch * np.sin(a)), round(pitch * np.cos(a))) for a in angles)]


def _bright_of_other_squares(mean: Array) -> Array:
    """Return the bright pixels' power, (2, wavelengths), for each chessboard colour from the other.

    A pixel's own value therefore does not enter.
    """
    bright = np.zeros((2, mean.shape[2]))
    for square in range(2):
        for colour in range(mean.shape[2]):
            values = np.concatenate([mean[row, (row + square + 1) % 2 :: 2, colour] for row in range(len(mean))])
            values = values[values > 0.0]
            bright[square, colour] = np.percentile(values, BRIGHT_PERCENTILE) if values.size else 0.0
    return bright


def _relative_variance(
    mean: Array, variance: Array, groups: list[tuple[tuple[int, int], ...]], low: int, high: int, bright: Array
) -> Array:
    """Return the largest relative variance of a pixel's neighbour groups at any wavelength, (high − low, W).

    The relative variance of a group is its mean variance over its squared mean. The mean counts as at least `DIM_SHARE`
    of the bright pixels' power.
    """
    rows, columns, colours = mean.shape
    black = (np.arange(low, high)[:, None] + np.arange(columns)) % 2
    worst = np.zeros((high - low, columns))
    for group in groups:
        total = np.zeros((high - low, columns, colours))
        spread = np.zeros_like(total)
        count = np.zeros((high - low, columns, 1))
        for step_row, step_column in group:
            r0, r1 = max(low, -step_row), min(high, rows - step_row)
            c0, c1 = max(0, -step_column), min(columns, columns - step_column)
            if r0 >= r1 or c0 >= c1:
                continue
            here = np.s_[r0 - low : r1 - low, c0:c1]
            there = np.s_[r0 + step_row : r1 + step_row, c0 + step_column : c1 + step_column]
            total[here] += mean[there]
            spread[here] += variance[there]
            count[here] += 1.0
        count = np.maximum(count, 1.0)
        level = np.maximum(total / count, DIM_SHARE * bright[black])
        relative = np.divide(spread / count, level**2, out=np.zeros_like(level), where=level > 0.0)
        worst = np.maximum(worst, relative.max(axis=2))
    return worst


def combine(
    mean: Array, variance: Array, second_mean: Array, second_variance: Array, levels: Counts, share: Array
) -> None:
    """Average two stages, weighted by their samples, in place of the first.

    Parameters
    ----------
    mean, variance, second_mean, second_variance : (H, W, wavelengths) float64
    levels : (H, W) uint8
    share : (levels,) float64
        The second stage's share of the samples at each level.
    """
    for row in range(len(mean)):
        part = share[levels[row]][:, None]
        mean[row] += part * (second_mean[row] - mean[row])
        variance[row] *= (1.0 - part) ** 2
        variance[row] += part**2 * second_variance[row]
