"""Least-squares positions of checkerboard corners, where four squares meet.

A corner's image is the product of two edges. Each is a step blurred by the area of a sample and by a Gaussian, so that
the position does not depend on the sampling phase.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.float64]

ROUNDS = 25
"""Largest number of Levenberg-Marquardt iterations."""

STEP = 1e-5
"""Finite-difference step of each parameter."""

LEAST_BLUR, MOST_BLUR = 0.05, 2.0
"""Standard deviation of the blur, in samples: a smaller one has no visible effect, a larger one is not an edge."""

WIDEST = 5.0
"""Largest distance from a corner at which its edges count as straight, in samples."""


class FittedCorners(NamedTuple):
    """Fitted corners.

    Attributes
    ----------
    place : (n, 2) float64
        Sample along s and t; NaN if the search left the window or found no corner.
    contrast : (n,) float64
        Half the difference between bright and dark squares; positive if the square between the two axes is bright.
    residual : (n,) float64
        Rms residual over the contrast.
    """

    place: Array
    contrast: Array
    residual: Array


def fit_corners(view: Array, start: Array, axes: Array, reach: float) -> FittedCorners:
    """Fit corners of one or more views.

    Parameters
    ----------
    view : (n, t, s) float64
        View of each corner; NaN: unknown.
    start : (n, 2) float64
        Sample along s and t, accurate to one sample.
    axes : (n, 2, 2) float64
        Unit vectors (s, t) along the edges: [:, 0] towards the next column, [:, 1] towards the next row.
    reach : float
        Distance to the next edges along the edges, in samples.
    """
    offsets, values, inside = _windows(view, start, axes, reach)
    count = len(start)
    normal = np.stack([axes[:, 1, 1], -axes[:, 1, 0]], axis=1), np.stack([axes[:, 0, 1], -axes[:, 0, 0]], axis=1)
    # The normal of each edge points along the other axis.
    angles = []
    for this, along in zip(normal, (axes[:, 0], axes[:, 1]), strict=True):
        turned = this * np.where(np.einsum("ni,ni->n", this, along) < 0.0, -1.0, 1.0)[:, None]
        angles.append(np.arctan2(turned[:, 1], turned[:, 0]))
    shape = np.zeros((count, 5))
    shape[:, :2] = start - np.rint(start)
    shape[:, 2], shape[:, 3], shape[:, 4] = angles[0], angles[1], 0.3
    enough = inside.sum(axis=1) >= LEAST_SAMPLES
    shape, level, residual = _search(shape, offsets, np.where(inside, values, 0.0), inside)
    moved = np.abs(shape[:, :2] - (start - np.rint(start))).max(axis=1)
    good = enough & (moved < FARTHEST) & (shape[:, 4] < MOST_BLUR)
    place = np.where(good[:, None], np.rint(start) + shape[:, :2], np.nan)
    with np.errstate(all="ignore"):
        return FittedCorners(place, level[:, 1], np.where(good, residual / np.abs(level[:, 1]), np.nan))


LEAST_SAMPLES = 12
"""Smallest number of samples in a window, for a fit of seven numbers."""

FARTHEST = 1.2
"""Distance from the start, in samples, beyond which a search has found something else."""


def _windows(view: Array, start: Array, axes: Array, reach: float) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return offsets from the nearest sample, (n, w, 2), values, (n, w), and a mask of the usable ones, (n, w)."""
    half = int(min(reach, WIDEST)) + 1
    one = np.arange(-half, half + 1)
    grid = np.stack(np.meshgrid(one, one), axis=-1).reshape(-1, 2)
    nearest = np.rint(start).astype(np.int64)
    at = nearest[:, None] + grid
    height, width = view.shape[1:]
    on = (at >= 0).all(axis=2) & (at[..., 0] < width) & (at[..., 1] < height)
    values = view[np.arange(len(start))[:, None], np.clip(at[..., 1], 0, height - 1), np.clip(at[..., 0], 0, width - 1)]
    along = np.einsum("nwi,nij->nwj", grid - (start - nearest)[:, None], np.linalg.inv(axes))
    # A sample extends half its width farther, and the next edge has the same blur.
    inside = (np.abs(along).max(axis=2) <= min(reach - 1.0, WIDEST)) & on & np.isfinite(values)
    # Usable samples come first, to keep the arrays as narrow as possible.
    first = np.argsort(~inside, axis=1, kind="stable")[:, : max(int(inside.sum(axis=1).max(initial=0)), 1)]
    pick = np.take_along_axis
    return grid.astype(np.float64)[first], pick(values, first, axis=1), pick(inside, first, axis=1)


def _edge(distance: Array, angle: Array, blur: Array) -> Array:
    """Return a step from −1 to 1 as seen by samples.

    Along an edge, a square sample projects to a trapezium: the box of its longer side (|cos| or |sin| of the angle),
    blurred with the variance of its shorter one.
    """
    cosine, sine = np.abs(np.cos(angle)), np.abs(np.sin(angle))
    half = 0.5 * np.maximum(cosine, sine)
    sigma = np.sqrt(blur**2 + np.minimum(cosine, sine) ** 2 / 12.0)

    def integral(x: Array) -> Array:
        scaled = x / (np.sqrt(2.0) * sigma)
        return np.asarray(x * erf(scaled) + np.sqrt(2.0 / np.pi) * sigma * np.exp(-(scaled**2)))

    return np.asarray((integral(distance + half) - integral(distance - half)) / (2.0 * half))


def _pattern(shape: Array, offsets: Array) -> Array:
    """Return the product of two edges, (n, w), for x, y, the angles of the normals and the blur, (n, 5)."""
    away = offsets - shape[:, None, :2]
    product = np.ones(offsets.shape[:2])
    for angle in (shape[:, 2:3], shape[:, 3:4]):
        distance = away[..., 0] * np.cos(angle) + away[..., 1] * np.sin(angle)
        product = product * _edge(distance, angle, shape[:, 4:5])
    return product


def _levels(pattern: Array, values: Array, inside: NDArray[np.bool_]) -> Array:
    """Return the mean and contrast of the best fit, (n, 2)."""
    count = np.maximum(inside.sum(axis=1), 1)
    mean_pattern = np.where(inside, pattern, 0.0).sum(axis=1) / count
    mean = np.where(inside, values, 0.0).sum(axis=1) / count
    beside = np.where(inside, pattern - mean_pattern[:, None], 0.0)
    square = np.maximum((beside**2).sum(axis=1), np.finfo(np.float64).tiny)
    contrast = (beside * values).sum(axis=1) / square
    return np.stack([mean - contrast * mean_pattern, contrast], axis=1)


def _search(shape: Array, offsets: Array, values: Array, inside: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Fit all corners at once; the linear parameters, mean and contrast, follow from the shape at each step.

    Returns
    -------
    shape : (n, 5) float64
    levels : (n, 2) float64
    residual : (n,) float64
        Root mean square.
    """
    active = np.flatnonzero(inside.any(axis=1))
    shape = shape.copy()
    damping = np.full(len(shape), 1e-3)
    for _ in range(ROUNDS):
        if not len(active):
            break
        own = offsets[active], values[active], inside[active]
        left, _ = _left(shape[active], *own)
        slopes = np.stack([(_left(shape[active] + STEP * unit, *own)[0] - left) / STEP for unit in np.eye(5)], axis=-1)
        square = np.einsum("nwp,nwq->npq", slopes, slopes)
        size = np.einsum("npp->np", square)
        size = np.maximum(size, STEP**2 * size.max(axis=1, keepdims=True) + np.finfo(np.float64).tiny)
        damped = square + (damping[active][:, None] * size)[:, :, None] * np.eye(5)
        step = np.linalg.solve(damped, np.einsum("nwp,nw->np", slopes, left)[..., None])[..., 0]
        moved = shape[active] - step
        moved[:, 4] = np.clip(np.abs(moved[:, 4]), LEAST_BLUR, 2.0 * MOST_BLUR)
        better = (_left(moved, *own)[0] ** 2).sum(axis=1) < (left**2).sum(axis=1)
        shape[active] = np.where(better[:, None], moved, shape[active])
        damping[active] *= np.where(better, 0.2, 10.0)
        active = active[(np.abs(step[:, :2]).max(axis=1) > SETTLED) & (np.abs(shape[active, :2]).max(axis=1) < LOST)]
    left, levels = _left(shape, offsets, values, inside)
    residual = np.sqrt((left**2).sum(axis=1) / np.maximum(inside.sum(axis=1), 1))
    return shape, levels, residual


SETTLED = 1e-4
"""Step, in samples, below which a search has converged."""

LOST = 3.0
"""Distance from the start, in samples, beyond which a search is abandoned."""


def _left(shape: Array, offsets: Array, values: Array, inside: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the residuals of shapes, (n, w), and their mean and contrast, (n, 2)."""
    pattern = _pattern(shape, offsets)
    levels = _levels(pattern, values, inside)
    return np.where(inside, values - levels[:, :1] - levels[:, 1:] * pattern, 0.0), levels
