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

LEAST_VIEWS = 3
"""Different u, of which a slope has an error."""


def edge_shift_mm(field: LightField) -> float:
    """Return by how much a nearly upright edge, bright on its right, moves on the array from one view to the next.

    Positive nearer than the focus, as `RayModel.shift_mm`. NaN where too few views show the edge, or it leaves the
    middle of the picture.

    Parameters
    ----------
    field : LightField
        Divided by its white image; what the pupil does not fill is unknown there.
    """
    if len(field.u_rad) < LEAST_VIEWS:
        return float("nan")
    off_axis = np.hypot(field.v_rad[:, None], field.u_rad[None, :])
    pictures = field.data.mean(axis=4, dtype=np.float64)
    _, _, height, width = pictures.shape
    # Micro-images at the border may be cut off.
    pictures = pictures[:, :, height // 10 : height - height // 10, width // 8 : width - width // 8]
    # A view at the border of the pupil is not seen from its middle.
    whole = 0.5 / field.model.f_number - abs(field.u_rad[1] - field.u_rad[0])
    known = np.isfinite(pictures).all(axis=(2, 3)) & (off_axis <= whole)
    v, u = np.nonzero(known)
    seen = pictures[known]
    if len(np.unique(u)) < LEAST_VIEWS or not seen.size:
        return float("nan")
    lit, inside = _bright_samples(seen)
    if not inside:
        return float("nan")
    # A slanted edge also moves with v.
    design = np.column_stack([u, v, np.ones(len(u))]).astype(np.float64)
    design = design if len(np.unique(v)) > 1 else design[:, ::2]
    slope, *_ = np.linalg.lstsq(design, lit)[0]
    return float(slope) * field.spacing_mm[1]


def _bright_samples(pictures: Array) -> tuple[Array, bool]:
    """Return how many samples of a row are bright, on average over the rows of each view, and whether that is known.

    Parameters
    ----------
    pictures : (n, t, s) float64
    """
    width = pictures.shape[2]
    side = max(1, width // 8)
    rows = pictures.mean(axis=1)
    dark, bright = rows[:, :side].mean(axis=1), rows[:, -side:].mean(axis=1)
    step = bright - dark
    if not (step > LEAST_CONTRAST * bright).all():
        return np.full(len(pictures), np.nan), False
    lit = (rows - dark[:, None]).sum(axis=1) / step
    return lit, bool(lit.min() > 2 * side and lit.max() < width - 2 * side)
