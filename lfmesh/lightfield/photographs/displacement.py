"""Displacements between two pictures of one pattern, window by window, with standard errors.

Digital image correlation: in each window, the picture f and the reference g obey

    f(p) = a g(p + d(p − c)) + b

with a gain a, an offset b, and a shift d that is a quadratic polynomial of the distance from the window's centre c. A
linear one would be wrong by half the window's variance times the second derivative (H. W. Schreier and M. A. Sutton,
Exp. Mech. 42, 303, 2002). A search over whole samples starts Gauss and Newton's method (M. A. Sutton, J.-J. Orteu and
H. Schreier, Image Correlation for Shape, Motion and Deformation Measurements, Springer 2009, chapter 5). The reference
is interpolated by cubic B-splines. Both pictures are smoothed first. White noise would otherwise depend on the fraction
of a sample by which the spline is shifted, and draw the shifts to halves.

The standard errors follow from those of the samples: with the Jacobian J, the weights W and the covariance C of the
smoothed pictures, the parameters have the covariance A⁻¹ B A⁻¹, A = Jᵀ W J and B = Jᵀ W C W J. The residual then has
the expectation tr(W C) − tr(A⁻¹ B).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.kernels.decorators import inlined, kernel

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHING = 0.8
"""Standard deviation of the Gaussian that smooths both pictures, in samples."""

REACH = 3
"""Samples on each side that the Gaussian reaches; the rest, below 1e-3 of its middle, is left out."""

MARGIN = REACH + 2
"""Samples beside unknown ones, or beside the border, that are unknown after smoothing and interpolation."""

TERMS = 6
"""Terms of a quadratic polynomial of two variables."""

GAIN, OFFSET = 2 * TERMS, 2 * TERMS + 1
PARAMETERS = 2 * TERMS + 2
"""Shift along columns, shift along rows, gain, offset; the shift at a window's centre is 0 and `TERMS`."""

WIDTHS = 4.0
"""Width of a window over the standard deviation of its weights."""

FILLED = 0.5
"""Smallest fraction of a window's weight on known samples."""

SIGNIFICANT = 8.0
"""Gain over its standard error from which on a window shows a common pattern: the best of many shifts of mere noise
reaches 4, and a few more for the deformation."""

NEIGHBOURS = 5
"""Smallest number of known neighbours, out of eight, with which a window is compared."""

OUTLYING, FLOOR_PX = 2.0, 0.1
"""A shift outlies if it is off the median of its neighbours by twice their own distance from it, a tenth of a sample,
and `SIGMAS` of its standard errors. The test is that of J. Westerweel and F. Scarano (Exp. Fluids 39, 1096, 2005), with
the second largest distance of a neighbour in place of the median one, which keeps crests between coarse windows."""

SIGMAS = 4.0

MOST_STEPS = 40
SETTLED = 1e-6
"""Steps of Gauss and Newton's method, and the last one, in samples, at which it ends."""


class Displacement(NamedTuple):
    """Displacements in windows; NaN if the windows show no common pattern, or another one than all windows beside.

    Attributes
    ----------
    shift : (rows, columns, 2) float64
        d, in samples along columns and rows: the window of the picture shows the reference at its centre + d.
    error : (rows, columns, 2) float64
        Standard error by the samples' noise, times the misfit if that is above 1.
    misfit : (rows, columns) float64
        Root of the squared residual over its expectation by the noise; NaN without noise.
    """

    shift: Array
    error: Array
    misfit: Array


class _Pictures(NamedTuple):
    """Picture and reference, smoothed."""

    picture: Array  # (H, W)
    reference: Array  # (H, W)
    coefficients: Array  # (H, W) of the reference's B-splines
    known: NDArray[np.uint8]  # (2, H, W) 1 where picture and reference are known, with their neighbours
    variance: Array  # (2, H, W) of the samples' noise
    smoothed: Array  # (2, H, W) of the noise that is left after smoothing


class _Window(NamedTuple):
    """Weights of a window, and working memory for it."""

    weights: Array  # (2 half + 1, 2 half + 1)
    taps: Array  # (2 REACH + 1,) of the smoothing
    reach: int  # largest shift, in samples
    normal: Array  # (PARAMETERS, PARAMETERS) A, and its Cholesky factor
    noise: Array  # (PARAMETERS, PARAMETERS) B
    vectors: Array  # (6, PARAMETERS) parameters, Jacobian, step, two for the errors, terms
    spread: (
        Array  # (2, PARAMETERS, side, side) W J, smoothed along one axis and along both; side = 2 half + 1 + 2 REACH
    )


def displacements(
    pictures: tuple[Array, Array], errors: tuple[Array, Array], centres: tuple[Any, Any], *, window: int, reach: int
) -> Displacement:
    """Measure the displacements of windows.

    Parameters
    ----------
    pictures : pair of (H, W) float64
        Picture and reference; NaN where unknown.
    errors : pair of (H, W) float64
        Standard errors of their samples, independent of one another.
    centres : pair of (rows,) and (columns,) int
        Row and column of the windows' middle samples.
    window : int
        Width of a window in samples, odd.
    reach : int
        Largest displacement along each axis, in samples.
    """
    rows, columns = (np.asarray(each, np.int64) for each in centres)
    shift, error = np.full((2, len(rows), len(columns), 2), np.nan)
    misfit = np.full(shift.shape[:2], np.nan)
    _measure(_smoothed(pictures, errors), _window(window // 2, reach), rows, columns, shift, error, misfit)
    false = _outlying(shift, error)
    shift[false], error[false], misfit[false] = np.nan, np.nan, np.nan
    return Displacement(shift, error, misfit)


def _outlying(shift: Array, error: Array) -> Mask:
    """Return a mask of windows with a shift unlike those of their neighbours, (rows, columns): false matches."""
    rows, columns = shift.shape[:2]
    padded = np.pad(shift, ((1, 1), (1, 1), (0, 0)), constant_values=np.nan)
    beside = [(j, i) for j in range(3) for i in range(3) if (j, i) != (1, 1)]
    around = np.stack([padded[j : j + rows, i : i + columns] for j, i in beside])
    compared = np.isfinite(around[..., 0]).sum(axis=0) >= NEIGHBOURS
    around = np.where(compared[..., None], around, 0.0)
    middle = np.nanmedian(around, axis=0)
    spread = np.sort(np.nan_to_num(np.abs(around - middle)), axis=0)[-2]
    off = np.abs(shift - middle) > OUTLYING * (spread + FLOOR_PX) + SIGMAS * error
    return np.asarray(compared & off.any(axis=-1))


def window_centres(length: int, window: int, step: int) -> NDArray[np.int64]:
    """Return the middle samples of windows along an axis, centred on it; none if no window fits.

    Parameters
    ----------
    length, window, step : int
        Samples along the axis, across a window, and between neighbouring windows.
    """
    room = length - window - 2 * MARGIN
    count = room // step + 1 if room >= 0 else 0
    return (length - 1 - step * (count - 1)) // 2 + step * np.arange(count)


def _taps() -> Array:
    taps = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / SMOOTHING) ** 2)
    return np.asarray(taps / taps.sum())


def _smoothed(pictures: tuple[Array, Array], errors: tuple[Array, Array]) -> _Pictures:
    """Return pictures with a common mean of 0 and standard deviation of 1, smoothed."""
    known = [np.isfinite(picture) & np.isfinite(error) for picture, error in zip(pictures, errors, strict=True)]
    of_reference = pictures[1][known[1]]
    middle, scale = (float(of_reference.mean()), float(of_reference.std())) if of_reference.size else (0.0, 1.0)
    scale = scale or 1.0
    taps = _taps()
    smooth = [
        _convolved(_filled((each - middle) / scale, own), taps) for each, own in zip(pictures, known, strict=True)
    ]
    variance = np.stack([np.where(own, each / scale, 0.0) ** 2 for each, own in zip(errors, known, strict=True)])
    around = np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), bool)
    return _Pictures(
        smooth[0],
        smooth[1],
        np.ascontiguousarray(ndimage.spline_filter(smooth[1], order=3, mode="mirror")),
        np.stack([ndimage.binary_erosion(own, around) for own in known]).astype(np.uint8),
        variance,
        np.stack([_convolved(each, taps * taps) for each in variance]),
    )


def _filled(picture: Array, known: Mask) -> Array:
    """Return a picture with the nearest known sample in place of unknown ones."""
    if known.all() or not known.any():
        return np.where(known, picture, 0.0)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.asarray(picture[tuple(nearest)])


def _convolved(picture: Array, taps: Array) -> Array:
    for axis in (0, 1):
        picture = ndimage.correlate1d(picture, taps, axis=axis, mode="nearest")
    return np.ascontiguousarray(picture)


def _window(half: int, reach: int) -> _Window:
    along = np.arange(-half, half + 1)
    weights = np.exp(-0.5 * (along * WIDTHS / (2 * half + 1)) ** 2)
    side = 2 * half + 1 + 2 * REACH
    return _Window(
        np.outer(weights, weights),
        _taps(),
        reach,
        np.zeros((PARAMETERS, PARAMETERS)),
        np.zeros((PARAMETERS, PARAMETERS)),
        np.zeros((6, PARAMETERS)),
        np.zeros((2, PARAMETERS, side, side)),
    )


@kernel
def _measure(
    pictures: _Pictures, window: _Window, rows: NDArray[np.int64], columns: NDArray[np.int64],
    shift: Array, error: Array, misfit: Array,
) -> None:  # fmt: skip
    """Fill in the displacements of all windows."""
    parameters = window.vectors[0]
    for m in range(len(rows)):
        for n in range(len(columns)):
            start_x, start_y, known = _search(pictures, window, columns[n], rows[m])
            if not known:
                continue
            parameters[:] = 0.0
            parameters[0], parameters[TERMS], parameters[GAIN] = start_x, start_y, 1.0
            if not _converged(pictures, window, columns[n], rows[m]):
                continue
            squares, expected, of_gain = _errors(pictures, window, columns[n], rows[m], error[m, n])
            if parameters[GAIN] <= SIGNIFICANT * of_gain:
                error[m, n] = np.nan
                continue
            shift[m, n, 0], shift[m, n, 1] = parameters[0], parameters[TERMS]
            if expected > 0.0:
                misfit[m, n] = np.sqrt(squares / expected)
                for k in range(2):
                    error[m, n, k] *= max(misfit[m, n], 1.0)


@kernel
def _search(pictures: _Pictures, window: _Window, column: int, row: int) -> tuple[float, float, bool]:
    """Return the whole shift with the largest correlation of picture and reference, and if there is one."""
    half, reach = len(window.weights) // 2, window.reach
    height, width = pictures.picture.shape
    best, best_x, best_y = 0.0, 0.0, 0.0
    whole = window.weights.sum()
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            total, f1, g1, ff, gg, fg = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(-half, half + 1):
                y, there = row + j, row + j + dy
                if y < 0 or y >= height or there < 0 or there >= height:
                    continue
                for i in range(-half, half + 1):
                    x, beside = column + i, column + i + dx
                    if x < 0 or x >= width or beside < 0 or beside >= width:
                        continue
                    if pictures.known[0, y, x] == 0 or pictures.known[1, there, beside] == 0:
                        continue
                    w = window.weights[j + half, i + half]
                    f, g = pictures.picture[y, x], pictures.reference[there, beside]
                    total += w
                    f1 += w * f
                    g1 += w * g
                    ff += w * f * f
                    gg += w * g * g
                    fg += w * f * g
            if total < FILLED * whole:
                continue
            across = (ff - f1 * f1 / total) * (gg - g1 * g1 / total)
            if across > 0.0:
                correlation = (fg - f1 * g1 / total) / np.sqrt(across)
                if correlation > best:
                    best, best_x, best_y = correlation, float(dx), float(dy)
    return best_x, best_y, best > 0.0


@inlined
def _spline(t: float) -> tuple[float, float, float, float]:
    """Return the four cubic B-splines at a fraction t behind a sample."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        2.0 / 3.0 + t * t * (0.5 * t - 1.0),
        2.0 / 3.0 + s * s * (0.5 * s - 1.0),
        t * t * t / 6.0,
    )


@inlined
def _slopes(t: float) -> tuple[float, float, float, float]:
    """Return the derivatives of the four B-splines."""
    s = 1.0 - t
    return -0.5 * s * s, t * (1.5 * t - 2.0), s * (2.0 - 1.5 * s), 0.5 * t * t


@kernel
def _reference_at(c: Array, x: float, y: float) -> tuple[float, float, float]:
    """Return the reference at a point, and its derivatives along columns and rows."""
    column, row = int(np.floor(x)), int(np.floor(y))
    u, du = _spline(x - column), _slopes(x - column)
    v, dv = _spline(y - row), _slopes(y - row)
    value, by_x, by_y = 0.0, 0.0, 0.0
    for j in range(4):
        line = c[row - 1 + j]
        c0, c1, c2, c3 = line[column - 1], line[column], line[column + 1], line[column + 2]
        along = u[0] * c0 + u[1] * c1 + u[2] * c2 + u[3] * c3
        value += v[j] * along
        by_y += dv[j] * along
        by_x += v[j] * (du[0] * c0 + du[1] * c1 + du[2] * c2 + du[3] * c3)
    return value, by_x, by_y


@kernel
def _sample(
    pictures: _Pictures, window: _Window, column: int, row: int, i: int, j: int, jacobian: Array
) -> tuple[float, int, int, bool]:
    """Fill in the Jacobian at a sample of a window; return its residual, its nearest sample there, and if known."""
    p, terms, half = window.vectors[0], window.vectors[5], len(window.weights) // 2
    height, width = pictures.picture.shape
    x, y = column + i, row + j
    if x < 0 or x >= width or y < 0 or y >= height or pictures.known[0, y, x] == 0:
        return 0.0, 0, 0, False
    along, down = i / half, j / half
    terms[0], terms[1], terms[2] = 1.0, along, down
    terms[3], terms[4], terms[5] = along * along, along * down, down * down
    there_x, there_y = float(x), float(y)
    for k in range(TERMS):
        there_x += p[k] * terms[k]
        there_y += p[TERMS + k] * terms[k]
    # Not so for NaN either.
    if not (0.0 <= there_x <= width - 1.0 and 0.0 <= there_y <= height - 1.0):
        return 0.0, 0, 0, False
    nearest_x, nearest_y = int(there_x + 0.5), int(there_y + 0.5)
    if pictures.known[1, nearest_y, nearest_x] == 0:
        return 0.0, 0, 0, False
    value, by_x, by_y = _reference_at(pictures.coefficients, there_x, there_y)
    gain = p[GAIN]
    for k in range(TERMS):
        jacobian[k] = gain * by_x * terms[k]
        jacobian[TERMS + k] = gain * by_y * terms[k]
    jacobian[GAIN], jacobian[OFFSET] = value, 1.0
    return pictures.picture[y, x] - gain * value - p[OFFSET], nearest_x, nearest_y, True


@kernel
def _converged(pictures: _Pictures, window: _Window, column: int, row: int) -> bool:
    """Improve the parameters of a window until they settle; tell whether they do, within reach."""
    half, a = len(window.weights) // 2, window.normal
    p, jacobian, step = window.vectors[0], window.vectors[1], window.vectors[2]
    whole = window.weights.sum()
    for _ in range(MOST_STEPS):
        a[:] = 0.0
        step[:] = 0.0
        total = 0.0
        for j in range(-half, half + 1):
            for i in range(-half, half + 1):
                residual, _, _, known = _sample(pictures, window, column, row, i, j, jacobian)
                if not known:
                    continue
                w = window.weights[j + half, i + half]
                total += w
                for k in range(PARAMETERS):
                    step[k] += w * jacobian[k] * residual
                    for m in range(k + 1):
                        a[k, m] += w * jacobian[k] * jacobian[m]
        if total < FILLED * whole or not _factored(a):
            return False
        _solve(a, step)
        for k in range(PARAMETERS):
            p[k] += step[k]
        largest = max(abs(p[0]), abs(p[TERMS]))
        if not largest <= window.reach + 1.0:
            return False
        if abs(step[0]) + abs(step[TERMS]) <= SETTLED:
            return largest <= window.reach and p[GAIN] > 0.0
    return False


@kernel
def _factored(a: Array) -> bool:
    """Replace the lower half of a matrix by its Cholesky factor; tell whether it has one."""
    for k in range(PARAMETERS):
        whole = a[k, k]
        for m in range(k + 1):
            left = a[k, m]
            for n in range(m):
                left -= a[k, n] * a[m, n]
            if m < k:
                a[k, m] = left / a[m, m]
            elif left > 1e-12 * whole:
                a[k, k] = np.sqrt(left)
            else:
                return False
    return True


@kernel
def _solve(factor: Array, b: Array) -> None:
    """Replace b by the solution of A x = b, given the Cholesky factor of A."""
    for k in range(PARAMETERS):
        for m in range(k):
            b[k] -= factor[k, m] * b[m]
        b[k] /= factor[k, k]
    for k in range(PARAMETERS - 1, -1, -1):
        for m in range(k + 1, PARAMETERS):
            b[k] -= factor[m, k] * b[m]
        b[k] /= factor[k, k]


@kernel
def _errors(pictures: _Pictures, window: _Window, column: int, row: int, error: Array) -> tuple[float, float, float]:
    """Fill in the errors of a window's shift; return its squared residual, that one's expectation, the gain's error.

    The Cholesky factor is that of the last step.
    """
    half = len(window.weights) // 2
    p, jacobian, solution, product = window.vectors[0], window.vectors[1], window.vectors[3], window.vectors[4]
    gain2 = p[GAIN] * p[GAIN]
    spread = window.spread
    spread[0] = 0.0
    squares, expected, of_gain = 0.0, 0.0, 0.0
    for j in range(-half, half + 1):
        for i in range(-half, half + 1):
            residual, x, y, known = _sample(pictures, window, column, row, i, j, jacobian)
            if not known:
                continue
            w = window.weights[j + half, i + half]
            squares += w * residual * residual
            expected += w * (pictures.smoothed[0, row + j, column + i] + gain2 * pictures.smoothed[1, y, x])
            for k in range(PARAMETERS):
                spread[0, k, j + half + REACH, i + half + REACH] = w * jacobian[k]
    _smooth(spread, window.taps)
    _sum_noise(pictures, window, column, row)
    for k in range(PARAMETERS):
        solution[:] = 0.0
        solution[k] = 1.0
        _solve(window.normal, solution)
        for m in range(PARAMETERS):
            product[m] = 0.0
            for n in range(PARAMETERS):
                product[m] += window.noise[m, n] * solution[n]
        expected -= product[k]
        if k % TERMS == 0:
            variance = 0.0
            for m in range(PARAMETERS):
                variance += solution[m] * product[m]
            if k < GAIN:
                error[k // TERMS] = np.sqrt(variance)
            else:
                of_gain = np.sqrt(variance)
    return squares, expected, of_gain


@kernel
def _smooth(spread: Array, taps: Array) -> None:
    """Smooth each picture of `spread`[0] along both axes, in place; the border is 0."""
    side = spread.shape[2]
    for k in range(PARAMETERS):
        for j in range(side):
            for i in range(side):
                total = 0.0
                for n in range(max(-REACH, -i), min(REACH, side - 1 - i) + 1):
                    total += taps[n + REACH] * spread[0, k, j, i + n]
                spread[1, k, j, i] = total
        for j in range(side):
            low, high = max(-REACH, -j), min(REACH, side - 1 - j)
            for i in range(side):
                total = 0.0
                for n in range(low, high + 1):
                    total += taps[n + REACH] * spread[1, k, j + n, i]
                spread[0, k, j, i] = total


@kernel
def _sum_noise(pictures: _Pictures, window: _Window, column: int, row: int) -> None:
    """Fill in B, from W J smoothed and the variances of the samples."""
    p, spread, noise = window.vectors[0], window.spread, window.noise
    height, width = pictures.picture.shape
    gain2, middle = p[GAIN] * p[GAIN], len(window.weights) // 2 + REACH
    noise[:] = 0.0
    for j in range(spread.shape[2]):
        for i in range(spread.shape[3]):
            x, y = column + i - middle, row + j - middle
            if x < 0 or x >= width or y < 0 or y >= height:
                continue
            there_x = min(max(int(x + p[0] + 0.5), 0), width - 1)
            there_y = min(max(int(y + p[TERMS] + 0.5), 0), height - 1)
            variance = pictures.variance[0, y, x] + gain2 * pictures.variance[1, there_y, there_x]
            for k in range(PARAMETERS):
                for m in range(k + 1):
                    noise[k, m] += variance * spread[0, k, j, i] * spread[0, m, j, i]
    for k in range(PARAMETERS):
        for m in range(k):
            noise[m, k] = noise[k, m]
