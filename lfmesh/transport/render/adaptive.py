"""Samples where they are needed: from a first stage's noise, how many more each pixel gets in a second one.

What a pixel gets is decided by its neighbours alone: those around it, and those at the same place of the neighbouring
lenslets' micro-images. Pixels have random numbers of their own, so the decision is independent of the pixel's own first
stage, and both stages may be averaged by their samples without bias, and their variances added. Averaging with weights
from the pixel's own noise would favour the stage that missed the bright paths.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.solved_camera import solved_camera
from lfmesh.scene import Scene

Array = NDArray[np.float64]
Counts = NDArray[np.uint8]

DIM_SHARE = 0.05
"""Share of the bright pixels' power below which a pixel's error is held against that of one so bright."""

BRIGHT_PERCENTILE = 99.0

RING = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""(rows, columns) to the pixels around."""

ROWS_AT_ONCE = 256
"""Rows of the sensor that are decided together, for the memory."""


@dataclass(frozen=True)
class Refinement:
    """What adaptive sampling did.

    Attributes
    ----------
    target_error : float
        Relative standard error wished.
    max_samples : int
        Samples a pixel may have.
    replicates : int
        Replicates of the second stage that are finished.
    samples : float
        Samples a pixel in both stages, mean over the pixels.
    refined_share : float
        Share of the pixels that the second stage gave samples.
    capped_share : float
        Share of the pixels that would have needed more than `max_samples`.
    """

    target_error: float
    max_samples: int
    replicates: int
    samples: float
    refined_share: float
    capped_share: float


def samples_of(levels: Counts) -> NDArray[np.int64]:
    """Return the samples a replicate that levels stand for: none, 1, 2, 4, ..."""
    return np.where(levels > 0, np.int64(1) << np.maximum(levels.astype(np.int64) - 1, 0), 0)


def total_samples(levels: Counts, thinned: Callable[[int], int] = int) -> int:
    """Return the samples of all pixels of a replicate; `thinned`: how many a pixel of so many gets."""
    pixels = np.bincount(levels.ravel())
    samples = samples_of(np.arange(1, len(pixels), dtype=np.uint8))
    return sum(int(count) * thinned(int(each)) for count, each in zip(pixels[1:], samples, strict=True))


def second_stage(mean: Array, variance: Array, scene: Scene) -> tuple[Counts, float]:
    """Decide how many samples each pixel gets in a second stage.

    Parameters
    ----------
    mean, variance : (H, W, wavelengths) float64
        Of the first stage, and of its mean.
    scene : Scene
        With `transport.target_error`.

    Returns
    -------
    levels : (H, W) uint8
        See `samples_of`.
    capped_share : float
        Share of the pixels that would have needed more than `max_samples`.
    """
    transport = scene.transport
    assert transport.target_error is not None
    first = transport.samples // transport.replicates
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
        # The variance of a mean falls at least as fast as samples are added.
        needed = first * (noise / transport.target_error**2 - 1.0)
        wished = np.where(needed > 0.0, np.ceil(np.log2(np.maximum(needed, 1.0))) + 1.0, 0.0)
        capped += int((needed > room).sum())
        levels[low:high] = np.minimum(wished, top)
    return levels, capped / levels.size


def same_place(scene: Scene) -> list[tuple[tuple[int, int], ...]]:
    """Return the steps (rows, columns) to the same place in the neighbouring micro-images, if there are any."""
    mla, pitch = scene.camera.mla, solved_camera(scene).report.micro_image_pitch_px
    if mla is None or pitch is None or pitch < 2.0:
        return []
    angles = np.deg2rad(np.arange(0, 360, 60 if mla.layout == "hexagonal" else 90))
    return [tuple((round(pitch * np.sin(a)), round(pitch * np.cos(a))) for a in angles)]


def _bright_of_other_squares(mean: Array) -> Array:
    """Return what the bright pixels hold, (2, wavelengths): [0] for the black squares of a chessboard, by the white.

    So that no pixel's own value enters.
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
    """Return the largest relative variance that any group of neighbours of a pixel has, (high − low, W).

    At any wavelength; a group's is its mean variance over its squared mean, or that of a dim pixel where it is dimmer.
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
    """Average two stages in place of the first: `share` (levels,) is the second's part of the samples at each level."""
    for row in range(len(mean)):
        part = share[levels[row]][:, None]
        mean[row] += part * (second_mean[row] - mean[row])
        variance[row] *= (1.0 - part) ** 2
        variance[row] += part**2 * second_variance[row]
