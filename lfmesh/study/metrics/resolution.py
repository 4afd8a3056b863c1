"""Resolution of a picture: the MTF from a slanted edge, and the width of points."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.analysis.spots import half_contrast

Array = NDArray[np.float64]

OVERSAMPLING = 4
"""Bins of the edge profile a sample, as ISO 12233 has it."""

LEAST_CONTRAST = 0.05
"""A picture whose two sides differ by less, as a share of the brighter, shows no edge."""


def edge_mtf50(picture: Array) -> float:
    """Return the frequency, in cycles a sample, at which the MTF of a slanted, nearly upright edge falls to one half.

    The edge's place in every row comes from the centroid of the row's derivative, the profile from all rows projected
    along the edge (ISO 12233:2017, edge-based spatial frequency response). NaN where no edge is to be seen, or the MTF
    does not fall to one half.

    Parameters
    ----------
    picture : (t, s) float64
        Dark on one side, bright on the other.
    """
    profile = _edge_profile(np.asarray(picture, dtype=np.float64))
    if profile is None:
        return float("nan")
    spread = np.diff(profile)
    # Only the surroundings of the edge: what lies far off is noise.
    middle = int(np.abs(spread).argmax())
    half = min(middle, len(spread) - 1 - middle)
    spread = spread[middle - half : middle + half + 1] * np.hanning(2 * half + 3)[1:-1]
    padded = 8 * len(spread)
    mtf = np.abs(np.fft.rfft(spread, padded))
    if half < OVERSAMPLING or not mtf[0] > 0.0:
        return float("nan")
    frequency = np.asarray(np.fft.rfftfreq(padded, 1.0 / OVERSAMPLING), dtype=np.float64)
    # The difference of neighbouring bins is itself a filter.
    mtf = mtf / mtf[0] / np.maximum(np.sinc(frequency / OVERSAMPLING), 0.1)
    return half_contrast(frequency, mtf)


def _edge_profile(picture: Array) -> Array | None:
    """Return the mean brightness in bins of distance from the edge; None where there is no edge."""
    height, width = picture.shape
    if min(height, width) < 2 * OVERSAMPLING or not np.isfinite(picture).all():
        return None
    sides = picture[:, : width // 4].mean(), picture[:, -(width // 4) :].mean()
    if abs(sides[1] - sides[0]) < LEAST_CONTRAST * max(*sides, np.finfo(float).tiny):
        return None
    slope = np.diff(picture, axis=1) * np.sign(sides[1] - sides[0])
    column = np.arange(width - 1) + 0.5
    rows = np.arange(height)
    place = np.full(height, 0.5 * (width - 1))
    # Twice, the second time in a window about the edge: noise far from it pulls the centroid to the middle.
    for reach in (width, width / 4):
        near = np.abs(column[None, :] - place[:, None]) <= reach
        weight = np.where(near, slope, 0.0)
        step = weight.sum(axis=1)
        # In some rows of a noisy picture there may be no step to see.
        seen = step > 0.5 * np.median(step)
        if seen.sum() < 2 * OVERSAMPLING:
            return None
        centroid = (weight * column).sum(axis=1)[seen] / step[seen]
        place = np.polyval(np.polyfit(rows[seen], centroid, 1), rows)
    lean = np.arctan((place[-1] - place[0]) / (height - 1))
    distance = (np.arange(width)[None, :] - place[:, None]) * np.cos(lean)
    reach = int(OVERSAMPLING * np.abs(distance).max(axis=1).min()) - 1
    bins = np.round(distance * OVERSAMPLING).astype(np.int64) + reach
    inside = (bins >= 0) & (bins <= 2 * reach) & seen[:, None]
    counts = np.bincount(bins[inside], minlength=2 * reach + 1)
    sums = np.bincount(bins[inside], picture[inside], 2 * reach + 1)
    filled = counts > 0
    return np.interp(np.arange(2 * reach + 1), np.flatnonzero(filled), sums[filled] / counts[filled])


def point_width(picture: Array, place: tuple[float, float], reach: float) -> float:
    """Return the rms width along one axis of a point's picture, in samples, that of a sample included.

    Parameters
    ----------
    picture : (t, s) float64
    place : tuple of float
        Where the point is expected, (t, s).
    reach : float
        Samples round it that belong to it.

    Returns
    -------
    float
        NaN where there is no light.
    """
    t, s = np.indices(picture.shape)
    near = (np.abs(t - place[0]) <= reach) & (np.abs(s - place[1]) <= reach)
    light = np.where(near, np.nan_to_num(picture), 0.0)
    total = light.sum()
    if not total > 0.0:
        return float("nan")
    middle = (light * t).sum() / total, (light * s).sum() / total
    square = (light * ((t - middle[0]) ** 2 + (s - middle[1]) ** 2)).sum() / total
    return float(np.sqrt(0.5 * square + 1.0 / 12.0))
