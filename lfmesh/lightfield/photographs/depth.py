"""Depth from a light field: the shift with the best agreement of the views, converted to distance.

Planes of equal shift are tried in turn; the views, shifted back, differ least at the right plane (a cost volume). Least
squares over the gradients, as in a structure tensor, then finds the residual slope of the epipolar-plane images (S.
Wanner, B. Goldluecke, "Variational light field analysis for disparity estimation and super-resolution", IEEE TPAMI 36
(2014) 606; from refocused planes: M. Diebold, B. Goldluecke, "Epipolar plane image refocusing for improved depth
estimation and occlusion handling", VMV 2013).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.errors import LfmeshError
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.rays.ray_model import ShiftMap
from lfmesh.lightfield.rays.view_rays import ViewRays, traced_shift
from lfmesh.lightfield.views.field import LightField, Samples
from lfmesh.notebook import Pictured, Say, announced
from lfmesh.scene.distance import reach_in_words

Array = NDArray[np.float64]

STEP = 0.05
"""Distance of the shifts tried, in samples."""

WINDOW = 1.5
"""Standard deviation of the Gaussian window for the comparison of views, in samples."""

BORDER = 0.7
"""Views closer to the pupil's rim than this, in pixels (about half a pixel's diagonal), are left out.

They are lit in part, so their centre of projection is off.
"""

LEAST_VIEWS = 3


@dataclass(frozen=True, eq=False)
class DepthMap(Pictured):
    """Depth from the middle of the exit pupil, for each sample of a view; NaN if unknown.

    Attributes
    ----------
    distance_mm : (t, s) float64
        Before the first vertex, along the axis.
    shift_mm : (t, s) float64
        Shift of the point on the array from view to view; positive nearer than the focus.
    confidence : (t, s) float64
        From 0 to 1: reduction of the difference between views, relative to the mean over all distances, times the
        fraction of texture in the variation over window and views. Near 0 for noise; low at occluding edges.
    range_mm : tuple of float
        Nearest and farthest distance tried.
    """

    distance_mm: Array
    shift_mm: Array
    confidence: Array
    range_mm: tuple[float, float]

    def __repr__(self) -> str:
        height, width = self.distance_mm.shape
        known = np.isfinite(self.distance_mm).mean()
        nearest, farthest = self.range_mm
        return f"<DepthMap: {width} × {height} samples, {known:.1%} known, searched {nearest:.5g} to {farthest:.5g} mm>"

    def error(self, truth_mm: NDArray[np.floating]) -> Array:
        """Return the relative error; NaN if either distance is unknown or infinite.

        Parameters
        ----------
        truth_mm : (t, s) float
            `DepthTruth.middle_mm`.

        Returns
        -------
        (t, s) float64

        Raises
        ------
        LfmeshError
            The truth has another size.
        """
        if truth_mm.shape != self.distance_mm.shape:
            raise LfmeshError(
                f"the truth has {truth_mm.shape[1]} × {truth_mm.shape[0]} samples, the depth map "
                f"{self.distance_mm.shape[1]} × {self.distance_mm.shape[0]}; take both from the same camera"
            )
        truth = np.where(np.isfinite(truth_mm), truth_mm.astype(np.float64), np.nan)
        return np.where(np.isfinite(self.distance_mm), self.distance_mm, np.nan) / truth - 1.0

    def in_words(self, truth_mm: NDArray[np.floating], without_depth: Sequence[str] = ()) -> str:
        """Return the error of the depth in words, for true depths in the searched range.

        Parameters
        ----------
        truth_mm : (t, s) float
            `DepthTruth.middle_mm`.
        without_depth : sequence of str, optional
            `DepthTruth.without_depth`.

        Returns
        -------
        str
        """
        near, far = self.range_mm
        within = (truth_mm >= near) & (truth_mm <= far)
        error = np.abs(self.error(truth_mm)[within])
        error = error[np.isfinite(error)]
        reach, names = reach_in_words(near, far), " and ".join(without_depth)
        if not error.size:
            none = f" ({names} {'has' if len(without_depth) == 1 else 'have'} none)" if names else ""
            return (
                f"No target surface that the camera sees lies in the range searched, {reach}: there is no true depth "
                f"to compare with{none}."
            )
        appear = "it appears" if len(without_depth) == 1 else "they appear"
        untold = f" Without true depth: {names}; where {appear}, the truth is the depth of the targets behind."
        middle, most = np.percentile(error, [50.0, 90.0])
        return (
            f"Depth is off by {middle:.2%} in the median and by less than {most:.2%} in nine of ten of the "
            f"{error.size} samples whose true depth lies in the range searched, {reach}.{untold if names else ''}"
        )


def estimate_depth(
    field: LightField, *, near_mm: float | None = None, far_mm: float | None = None,
    progress: Say | bool | None = None,
) -> DepthMap:  # fmt: skip
    """Estimate the distance of everything that a light field shows.

    Parameters
    ----------
    field : LightField
        Preferably divided by its white image.
    near_mm, far_mm : float, optional
        Range of the search (default: the refocus range).
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    DepthMap

    Raises
    ------
    LfmeshError
        No range to search, or fewer than 3 views along an axis.
    """
    with announced(progress) as say:
        return _estimated(field, near_mm, far_mm, say)


def _estimated(field: LightField, near_mm: float | None, far_mm: float | None, say: Say) -> DepthMap:
    data, usable = _even_views(field)
    geometry = traced_shift(ViewRays.of_camera(field.scene), usable)
    shifts = _shifts_to_try(field, geometry, near_mm, far_mm)
    spacing = field.spacing_mm
    cost, texture = np.full(data.shape[2:4], np.inf), np.zeros(data.shape[2:4])
    total, tried = np.zeros_like(cost), np.zeros_like(cost)
    shift = np.full(data.shape[2:4], np.nan)
    for number, plane in enumerate(shifts):
        say(f"depth: plane {number + 1} of {len(shifts)}")
        differ, contrast, residual = _compared(data, usable, plane, spacing)
        known = np.isfinite(differ)
        total, tried = total + np.where(known, differ, 0.0), tried + known
        better = known & (differ < cost)
        cost, texture = np.where(better, differ, cost), np.where(better, contrast, texture)
        # A residual of several steps means that there is no reliable slope.
        limit = 2.0 * STEP * max(spacing)
        shift = np.where(better, plane + np.clip(residual, -limit, limit), shift)
    with np.errstate(divide="ignore", invalid="ignore"):
        confidence = np.where(total > 0.0, (1.0 - cost * tried / total) * texture / (texture + cost), 0.0)
    near, far = _real(geometry.distance_mm(shifts[[-1, 0]]))
    return DepthMap(
        _real(geometry.distance_mm(shift)),
        shift,
        np.clip(np.nan_to_num(confidence), 0.0, 1.0),
        (float(near), float(far)),
    )


def _real(distance_mm: Array) -> Array:
    """Replace distances of virtual objects, which lie beyond infinity, by infinity."""
    return np.where(distance_mm < 0.0, np.inf, distance_mm)


def _shifts_to_try(field: LightField, geometry: ShiftMap, near_mm: float | None, far_mm: float | None) -> Array:
    """Return the shifts between views from the farthest plane to the nearest, mm."""
    near, far = field.model.paraxial.refocus_range_mm
    near, far = near if near_mm is None else near_mm, far if far_mm is None else far_mm
    if not 0.0 < near < far:
        raise LfmeshError(f"near_mm = {near:g}, far_mm = {far:g}: no range to search for depth in; give near below far")
    low, high = geometry.shift_mm(far), geometry.shift_mm(near)
    count = max(2, math.ceil((high - low) / (STEP * min(field.spacing_mm))) + 1)
    return np.linspace(low, high, count)


def _even_views(field: LightField) -> tuple[Samples, NDArray[np.bool_]]:
    """Return the samples with equal brightness in all views, and a mask (v, u) of views that the pupil fills."""
    rows, columns = field.views
    if min(rows, columns) < LEAST_VIEWS:
        raise LfmeshError(f"{columns} × {rows} views: depth needs at least {LEAST_VIEWS} views along each axis")
    off_axis = np.hypot(field.v_rad[:, None], field.u_rad[None, :])
    step = field.model.slope_step
    usable = off_axis + BORDER * step <= field.model.pupil_slope
    with np.errstate(invalid="ignore"):
        known = np.isfinite(field.data)
        sums = np.where(known, field.data, 0.0).sum(axis=(2, 3, 4), dtype=np.float64)
    brightness = sums / np.maximum(known.sum(axis=(2, 3, 4)), 1)
    usable &= brightness > 0.0
    if min(usable.any(axis=1).sum(), usable.any(axis=0).sum()) < LEAST_VIEWS:
        raise LfmeshError(
            f"only {usable.sum()} of {columns} × {rows} views are fully lit: depth needs at least {LEAST_VIEWS} along "
            "each axis"
        )
    level = brightness[usable].mean() / np.where(usable, brightness, 1.0)
    return (field.data * level[:, :, None, None, None]).astype(np.float32), usable


def _compared(
    data: Samples, usable: NDArray[np.bool_], shift_mm: float, spacing_mm: tuple[float, float]
) -> tuple[Array, Array, Array]:
    """Compare the views, shifted to one plane, in the window around every sample.

    Returns
    -------
    cost : (t, s) float64
        Variance over the views; NaN if unknown.
    contrast : (t, s) float64
        Variance of their mean over the window.
    residual : (t, s) float64, mm
        Remaining shift of the views.
    """
    mean = np.empty(data.shape[2:])
    slope_v, slope_u = np.empty_like(mean), np.empty_like(mean)
    variance = np.empty(data.shape[2:4])
    along_t, along_s = (shift_mm / spacing for spacing in spacing_mm)
    _regress_views(data, usable, along_t, along_s, mean, variance, slope_v, slope_u)
    gradient_t, gradient_s = (_gradient(mean, axis) / spacing for axis, spacing in enumerate(spacing_mm))
    with np.errstate(invalid="ignore"):
        moved = (slope_v * gradient_t + slope_u * gradient_s).sum(axis=2)
        steep = (gradient_t**2 + gradient_s**2).sum(axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        contrast = _windowed((mean**2).sum(axis=2))
        for channel in range(data.shape[4]):
            contrast = contrast - _windowed(mean[..., channel]) ** 2
        return _windowed(variance), np.maximum(contrast, 0.0), _windowed(moved) / _windowed(steep)


def _gradient(picture: Array, axis: int) -> Array:
    if picture.shape[axis] < 2:
        return np.zeros_like(picture)
    return np.asarray(np.gradient(picture, axis=axis))


def _windowed(values: Array) -> Array:
    """Return the mean of the known values in a Gaussian window around every sample."""
    known = np.isfinite(values)
    weight = ndimage.gaussian_filter(known.astype(np.float64), WINDOW, mode="constant")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), WINDOW, mode="constant")
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(known, total / weight, np.nan)


@kernel
def _regress_views(
    data: Samples, usable: NDArray[np.bool_], along_t: float, along_s: float,
    mean: Array, variance: Array, slope_v: Array, slope_u: Array,
) -> None:  # fmt: skip
    """Shift the views by given samples per view, and fit a plane over (v, u) at each sample.

    `variance` is about the mean, summed over channels; slopes are per view.
    """
    rows, columns, height, width, channels = data.shape
    for t in range(height):
        for s in range(width):
            variance[t, s] = 0.0
            for c in range(channels):
                n, total, square = 0.0, 0.0, 0.0
                sum_v, sum_u, sum_vv, sum_uu, sum_vl, sum_ul = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for v in range(rows):
                    for u in range(columns):
                        if not usable[v, u]:
                            continue
                        # Objects nearer than the focus move against the view.
                        dv, du = v - 0.5 * (rows - 1), u - 0.5 * (columns - 1)
                        y, x = t - along_t * dv, s - along_s * du
                        if not (0.0 <= x <= width - 1.0 and 0.0 <= y <= height - 1.0):
                            continue
                        column, row = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
                        fx, fy = x - column, y - row
                        value = 0.0
                        for j in range(2):
                            for i in range(2):
                                weight = (fx if i else 1.0 - fx) * (fy if j else 1.0 - fy)
                                if weight > 0.0:
                                    value += weight * data[v, u, row + j, column + i, c]
                        if np.isnan(value):
                            continue
                        n += 1.0
                        total += value
                        square += value * value
                        sum_v += dv
                        sum_u += du
                        sum_vv += dv * dv
                        sum_uu += du * du
                        sum_vl += dv * value
                        sum_ul += du * value
                across_v, across_u = n * sum_vv - sum_v * sum_v, n * sum_uu - sum_u * sum_u
                if not (across_v > 0.0 and across_u > 0.0):
                    mean[t, s, c], slope_v[t, s, c], slope_u[t, s, c] = np.nan, np.nan, np.nan
                    variance[t, s] = np.nan
                    continue
                mean[t, s, c] = total / n
                variance[t, s] += max(square / n - (total / n) ** 2, 0.0)
                slope_v[t, s, c] = (n * sum_vl - sum_v * total) / across_v
                slope_u[t, s, c] = (n * sum_ul - sum_u * total) / across_u
