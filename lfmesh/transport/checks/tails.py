"""Heavy tails: blocks of pixels with much light from few paths, found from light, errors and hits.

A pixel met by one heavy path holds much of its block's light. Its error is about as large as its light, and it has no
more hits than its neighbours. The neighbours lack that light, and their error estimates do not show it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDE = 8
"""Pixels along each side of a block."""

HELD = 0.1
"""Share of a block's light in one pixel above which the pixel counts as heavy."""

FEW_PATHS = 0.5
"""Relative error of a pixel's light above which few paths brought it."""

HEAVIER = 5.0
"""Light per hit of that pixel over the light per hit of a bright pixel of its block (`OTHERS`)."""

OTHERS = 0.9
"""Quantile of light per hit that defines a bright pixel of a block: it stays bright beside an edge."""

ENOUGH_HITS = 64
"""Hits of a block that would determine its light well if all were alike."""

BRIGHT = 1e-3
"""Light of a block over the light of the brightest one, below which the block is ignored."""


class Tails(NamedTuple):
    """Blocks with heavy paths.

    Attributes
    ----------
    share : float
        Share of the blocks that are not dark with such a pixel.
    held : float
        Largest share of a block's light in one pixel.
    heavier : float
        Light per hit there, over that of a bright pixel of its block.
    """

    share: float
    held: float
    heavier: float


def tails(mean: Array, stderr: Array, hits: NDArray[np.uint32]) -> Tails | None:
    """Return the blocks with heavy paths, for the channel with the largest share of them; None if there are none.

    Parameters
    ----------
    mean, stderr : (H, W, wavelengths) float64, W
    hits : (H, W, wavelengths) uint32
    """
    found = [_of_channel(mean[..., k], stderr[..., k], hits[..., k]) for k in range(mean.shape[2])]
    return max((each for each in found if each is not None), default=None)


def _of_channel(mean: Array, stderr: Array, hits: NDArray[np.uint32]) -> Tails | None:
    light, error, count = (_blocks(np.asarray(values, np.float64)) for values in (mean, stderr, hits))
    total, all_hits = light.sum(axis=1), count.sum(axis=1)
    each = np.arange(len(light))
    brightest = light.argmax(axis=1)
    most = light[each, brightest]
    of_hit = light / np.maximum(count, 1.0)
    others = np.partition(of_hit, int(OTHERS * of_hit.shape[1]), axis=1)[:, int(OTHERS * of_hit.shape[1])]
    heavier = of_hit[each, brightest] / np.maximum(others, np.finfo(np.float64).tiny)
    seen = total > BRIGHT * total.max(initial=0.0)
    heavy = (
        seen
        & (all_hits >= ENOUGH_HITS)
        & (others > 0.0)
        & (most > HELD * total)
        & (error[each, brightest] > FEW_PATHS * most)
        & (heavier > HEAVIER)
    )
    if not heavy.any():
        return None
    worst = int(np.argmax(np.where(heavy, most / np.maximum(total, np.finfo(np.float64).tiny), 0.0)))
    return Tails(float(heavy.sum() / seen.sum()), float(most[worst] / total[worst]), float(heavier[worst]))


def _blocks(values: Array) -> Array:
    """Return the pixels of each block, (blocks, SIDE²), padded with dark pixels beyond the border."""
    rows, columns = (-(-size // SIDE) for size in values.shape)
    padded = np.zeros((rows * SIDE, columns * SIDE))
    padded[: values.shape[0], : values.shape[1]] = values
    return padded.reshape(rows, SIDE, columns, SIDE).swapaxes(1, 2).reshape(-1, SIDE * SIDE)
