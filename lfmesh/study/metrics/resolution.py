"""Resolution of a picture: MTF from a slanted edge, and width of points."""

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.linalg import solveh_banded
from scipy.sparse import diags_array

from lfmesh.analysis.spots import half_contrast

Array = NDArray[np.float64]

LEAST_CONTRAST = 0.05
"""Difference between both sides of a picture, relative to the brighter, below which it shows no edge."""

LEAST_ROWS = 8
"""Smallest number of rows in which the edge is visible."""

KNOTS = 4
"""Spline knots per sample of the edge's profile, as many as ISO 12233 has bins."""

STIFFNESS = 1e-4
"""Weight of the third differences of the profile's coefficients, relative to the samples'; it bridges gaps."""

ROUNDS = 3
"""Alternating fits of profile and line; the second changes the line by less than 0.001 samples."""

FINE = 16
"""Points per sample at which the profile's slope is summed."""


def edge_mtf50(picture: Array) -> float:
    """Return the MTF50 of a slanted, nearly upright edge, in cycles per sample.

    A straight line and a cubic-spline profile across it are fitted to all samples by least squares; bins would have
    borders that shift the result. The MTF is the Fourier transform of the profile's slope in a window about the edge.
    Frequencies are across the edge. The MTF includes the sampling; above 0.5 cycles per sample, only the slant resolves
    it (ISO 12233:2017, edge-based spatial frequency response). NaN if no edge is visible, or the MTF does not fall to
    one half.

    Parameters
    ----------
    picture : (t, s) float64
        Picture, dark on one side and bright on the other.
    """
    picture = np.asarray(picture, dtype=np.float64)
    found = _edge_line(picture)
    profile = None if found is None else _edge_profile(picture, *found)
    if profile is None:
        return float("nan")
    reach = profile.t[-4]
    x = np.arange(-reach + 0.5 / FINE, reach, 1.0 / FINE)
    slope = profile.derivative()(x)
    total = slope.sum()
    if total == 0.0:
        return float("nan")
    middle, low, high = np.interp([0.5, 0.05, 0.95], np.maximum.accumulate(np.cumsum(slope) / total), x)
    # Use only the surroundings of the edge: the rest is noise.
    half = min(middle + reach, reach - middle, 3.0 * (high - low) + 2.0)
    if not half > 1.0:
        return float("nan")
    near = np.abs(x - middle) < half
    x, slope = x[near], slope[near]
    away = np.maximum(2.0 * np.abs(x - middle) / half - 1.0, 0.0)
    frequency = np.linspace(0.0, 2.0, 1001)
    mtf = np.abs(np.exp(-2j * np.pi * frequency[:, None] * x) @ (slope * 0.5 * (1.0 + np.cos(np.pi * away))))
    return half_contrast(frequency, mtf / mtf[0])


def _edge_line(picture: Array) -> tuple[Array, NDArray[np.bool_]] | None:
    """Return the edge's slope and column in row 0, and a mask of the rows that show it; None without an edge.

    Its position in each row is the centroid of the row's differences.
    """
    height, width = picture.shape
    if min(height, width) < LEAST_ROWS or not np.isfinite(picture).all():
        return None
    sides = picture[:, : width // 4].mean(), picture[:, -(width // 4) :].mean()
    if abs(sides[1] - sides[0]) < LEAST_CONTRAST * max(*sides, np.finfo(float).tiny):
        return None
    slope = np.diff(picture, axis=1) * np.sign(sides[1] - sides[0])
    column = np.arange(width - 1) + 0.5
    rows = np.arange(height)
    place = np.full(height, 0.5 * (width - 1))
    # Two passes, the second in a window about the edge: distant noise pulls the centroid to the middle.
    for reach in (width, width / 4):
        near = np.abs(column[None, :] - place[:, None]) <= reach
        weight = np.where(near, slope, 0.0)
        step = weight.sum(axis=1)
        # In a noisy picture some rows may show no step.
        seen = step > 0.5 * np.median(step)
        if seen.sum() < LEAST_ROWS:
            return None
        centroid = (weight * column).sum(axis=1)[seen] / step[seen]
        line = np.polyfit(rows[seen], centroid, 1)
        place = np.polyval(line, rows)
    return line, seen


def _edge_profile(picture: Array, line: Array, seen: NDArray[np.bool_]) -> BSpline | None:
    """Fit a spline of brightness by distance from the edge, in samples, and the edge's line; None: too few data."""
    width = picture.shape[1]
    rows, values = np.flatnonzero(seen), picture[seen]
    lean, start = line
    profile = None
    for _ in range(ROUNDS):
        distance = (np.arange(width) - start - lean * rows[:, None]) / np.hypot(1.0, lean)
        count = int(KNOTS * np.abs(distance).max(axis=1).min())
        if count < 2 * KNOTS:
            return None
        inside = np.abs(distance) < count / KNOTS
        at, given = distance[inside], values[inside]
        knots = np.arange(-count - 3, count + 4) / KNOTS
        basis = BSpline.design_matrix(at, knots, 3)
        normal = basis.T @ basis
        size = normal.shape[0]
        thirds = diags_array([-1.0, 3.0, -3.0, 1.0], offsets=[0, 1, 2, 3], shape=(size - 3, size))
        normal = normal + STIFFNESS * normal.trace() / size * (thirds.T @ thirds)
        bands = np.stack([np.append(normal.diagonal(-k), np.zeros(k)) for k in range(4)])
        profile = BSpline(knots, solveh_banded(bands, basis.T @ given, lower=True), 3)
        fall = -profile.derivative()(at) / np.hypot(1.0, lean)
        row = np.broadcast_to(rows[:, None], distance.shape)[inside]
        move, *_ = np.linalg.lstsq(np.stack([fall, fall * row], axis=1), given - profile(at), rcond=None)
        start, lean = start + move[0], lean + move[1]
    return profile


def point_width(picture: Array, place: tuple[float, float], reach: float) -> float:
    """Return the rms width of a point's picture along one axis, in samples, including the sample's own width.

    Parameters
    ----------
    picture : (t, s) float64
    place : tuple of float
        Expected position of the point, (t, s).
    reach : float
        Half-side of the square of samples that belong to it.

    Returns
    -------
    float
        NaN without light.
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
