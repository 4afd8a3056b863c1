"""Refocusing on an edge: the shift from view to view by which its views lie on one another.

An edge that view u shows at place x0 − a u is sharp in the photograph that moves the views by a samples each. The
straight line through its places, by least squares, is the photograph in which the rms of its blur is least.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.views.field import LightField

Array = NDArray[np.float64]

LEAST_CONTRAST = 0.2
"""Views whose dark side is brighter than this share less than their bright one show no edge."""

DARK = 0.1
"""A view is unknown where a column of its white image has less than this share of the light of its brightest one."""

LEAST_VIEWS = 3
"""Different u, of which a slope has an error."""


def edge_shift_mm(edge: LightField, white: LightField) -> float:
    """Return by how much a nearly upright edge, bright on its right, moves on the array from one view to the next.

    Positive nearer than the focus, as `RayModel.shift_mm`. NaN where too few views show the edge, or it leaves the
    middle of the picture. Whole columns are divided by those of the white image: samples by themselves hold too little
    light, and noise would decide which of them are dark.

    Parameters
    ----------
    edge, white : LightField
        Of the edge and of a white plane, from the same samples.
    """
    if len(edge.u_rad) < LEAST_VIEWS:
        return float("nan")
    off_axis = np.hypot(edge.v_rad[:, None], edge.u_rad[None, :])
    columns, bright = (_columns(field) for field in (edge, white))
    # A view at the border of the pupil is not seen from its middle.
    whole = 0.5 / edge.model.f_number - abs(edge.u_rad[1] - edge.u_rad[0])
    known = np.isfinite(columns).all(axis=2) & (off_axis <= whole)
    known &= bright.min(axis=2) > DARK * np.nanmax(bright, axis=2)
    v, u = np.nonzero(known)
    if len(np.unique(u)) < LEAST_VIEWS:
        return float("nan")
    lit, inside = _bright_samples(columns[known] / bright[known])
    if not inside:
        return float("nan")
    # A slanted edge also moves with v.
    design = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64)
    design = design if len(np.unique(v)) > 1 else design[:, ::2]
    slope, *_ = np.linalg.lstsq(design, lit)[0]
    return float(slope) * edge.spacing_mm[1]


def _columns(field: LightField) -> Array:
    """Return the mean light of each column in the middle of each view, (v, u, s)."""
    height, width = field.data.shape[2:4]
    # Micro-images at the border may be cut off.
    middle = field.data[:, :, height // 10 : height - height // 10, width // 8 : width - width // 8]
    return np.asarray(middle.mean(axis=(2, 4), dtype=np.float64))


def _bright_samples(rows: Array) -> tuple[Array, bool]:
    """Return how many samples of the mean row of each view are bright, and whether that is known.

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
