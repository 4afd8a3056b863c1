"""Refocusing on an edge: the shift between views that aligns them.

An edge at x0 − a u in view u is sharp in the photograph that shifts the views by a samples each. The least-squares line
through its positions gives the photograph with the smallest rms blur.
"""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.field import LightField
from lfmesh.study.cameras.compare import EDGE_DEG

Array = NDArray[np.float64]

LEAST_CONTRAST = 0.2
"""Contrast of a view, relative to its bright side, below which it shows no edge."""

DARK = 0.1
"""Fraction of a view's brightest white-image column below which another column makes the view unknown."""

UNLIKE = 0.04
"""Relative difference of a view's light from the brightest view in the middle of the pupil above which its direction is
uncertain: darker views are vignetted, brighter ones hold light of neighbouring lenslets."""

LEAST_VIEWS = 3
"""Smallest number of different u for a slope with an error."""

CROSSING_ROWS = 1.0 / math.tan(math.radians(EDGE_DEG))
"""Rows of samples in which the slanted edge moves by one sample."""

LEAST_ROWS = math.ceil(CROSSING_ROWS)
"""Rows of samples that show every position of the edge within a sample."""

LEAST_WIDTH_PX = 5.2
"""Width of a micro-image that gives this many views, with or without a middle one."""


def edge_shift_mm(edge: LightField, white: LightField) -> float:
    """Return the shift on the array, from view to view, of a nearly upright edge that is bright on its right.

    It is positive nearer than the focus, as in `RayModel.shift_mm`; NaN if too few views show the edge in the middle of
    the picture. Whole columns are divided by the white image's: single samples are so noisy that chance would decide
    which are dark.

    Parameters
    ----------
    edge, white : LightField
        Light fields of the edge and of a white plane, from the same samples.
    """
    if min(edge.data.shape[2:4]) < LEAST_ROWS:
        return float("nan")
    inner = _inner_views(edge.v_rad, edge.u_rad, edge.model)
    if not inner.any():
        return float("nan")
    columns, bright = (_columns(field) for field in (edge, white))
    known = inner & np.isfinite(columns).all(axis=2) & np.isfinite(bright).all(axis=2)
    known &= bright.min(axis=2) > DARK * bright.max(axis=2)
    # The pupil may lie elsewhere than in the nominal camera, for example if the array has moved along the axis.
    light = bright.mean(axis=2)
    middle = known & (np.hypot(edge.v_rad[:, None], edge.u_rad[None, :]) <= 0.5 * edge.model.pupil_slope)
    usual = light[middle].max(initial=0.0)
    known &= np.abs(light - usual) <= UNLIKE * usual
    v, u = np.nonzero(known)
    if len(np.unique(u)) < LEAST_VIEWS:
        return float("nan")
    lit, inside = _bright_samples(columns[known] / bright[known])
    if not inside:
        return float("nan")
    # A slanted edge also shifts with v.
    design = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64)
    design = design if len(np.unique(v)) > 1 else design[:, ::2]
    slope, *_ = np.linalg.lstsq(design, lit)[0]
    return float(slope) * edge.spacing_mm[1]


def why_unknown(rows: int, columns: int, model: RayModel) -> str:
    """Return the reason why a camera cannot measure the refocus distance, or "".

    Parameters
    ----------
    rows, columns : int
        Numbers of lenslets.
    model : RayModel
    """
    if min(rows, columns) < LEAST_ROWS:
        return f"needs at least {LEAST_ROWS} × {LEAST_ROWS} lenslets, but the camera has {columns} × {rows}"
    count = max(1, math.floor(model.micro_image_pitch_px))
    directions = np.asarray(model.slope_step * (np.arange(count) - 0.5 * (count - 1)), dtype=np.float64)
    seen = int(_inner_views(directions, directions, model).any(axis=0).sum())
    if seen >= LEAST_VIEWS:
        return ""
    width = 2.0 * model.lenslet_to_sensor_mm * model.pupil_slope / model.pixel_mm
    return (
        f"needs at least {LEAST_VIEWS} columns of views that the pupil does not cut, but the camera has {seen}: its "
        f"micro-images are {width:.3g} pixels wide; {LEAST_WIDTH_PX:g} would be enough"
    )


def _inner_views(v_rad: Array, u_rad: Array, model: RayModel) -> NDArray[np.bool_]:
    """Tell which views lie inside the pupil's border, so that their light comes from their middle."""
    if len(u_rad) < LEAST_VIEWS:
        return np.zeros((len(v_rad), len(u_rad)), dtype=bool)
    return np.asarray(np.hypot(v_rad[:, None], u_rad[None, :]) <= model.pupil_slope - abs(u_rad[1] - u_rad[0]))


def _columns(field: LightField) -> Array:
    """Return the mean light of each column in the middle of each view, (v, u, s)."""
    height, width = field.data.shape[2:4]
    # Micro-images at the border may be cut off.
    skipped = max(0, min(height // 10, (height - LEAST_ROWS) // 2))
    middle = field.data[:, :, skipped : height - skipped, width // 8 : width - width // 8]
    weights = _row_weights(middle.shape[2])
    return np.asarray(np.tensordot(middle.mean(axis=4, dtype=np.float64), weights, axes=(2, 0)))


def _row_weights(count: int) -> Array:
    """Return row weights that weight all positions of the edge within a sample equally.

    Lenslets not focused on the pupil have overlapping footprints, so that the light of one row is not linear in the
    edge's position. A component periodic in samples drops out of a mean weighted by a box of one crossing, convolved
    with a box of the other rows.
    """
    from_border = 0.5 + np.minimum(np.arange(count), np.arange(count)[::-1])
    ramp = min(CROSSING_ROWS, count - CROSSING_ROWS)
    weights = np.minimum(1.0, from_border / ramp) if ramp > 0.0 else np.ones(count)
    return np.asarray(weights / weights.sum())


def _bright_samples(rows: Array) -> tuple[Array, bool]:
    """Return the number of bright samples in each view's mean row, and whether it is known.

    Parameters
    ----------
    rows : (n, s) float64
    """
    side = max(1, rows.shape[1] // 8)
    dark, bright = rows[:, :side].mean(axis=1), rows[:, -side:].mean(axis=1)
    step = bright - dark
    if not (step > LEAST_CONTRAST * bright).all():
        return np.full(len(rows), np.nan), False
    lit = (rows - dark[:, None]).sum(axis=1) / step
    return lit, bool(lit.min() > 2 * side and lit.max() < rows.shape[1] - 2 * side)
