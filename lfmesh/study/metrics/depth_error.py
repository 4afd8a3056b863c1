"""Depth error of a camera's light field against the traced scene."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.photographs.depth import estimate_depth
from lfmesh.lightfield.photographs.depth_truth import middle_depth_mm
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import Scene

Array = NDArray[np.float64]

LEAST_CONFIDENCE = 0.5
"""Confidence in the reference's light field below which depth is not judged, for lack of texture."""


def textured(field: LightField) -> NDArray[np.bool_]:
    """Return the samples of the reference's light field, (t, s), with enough texture for depth.

    Raises
    ------
    LfmeshError
        As for `estimate_depth`.
    """
    found = estimate_depth(field)
    return (found.confidence >= LEAST_CONFIDENCE) & np.isfinite(found.distance_mm)


def true_depth_mm(scene: Scene) -> Array:
    """Return the true distance along each lenslet's chief ray, (t, s) mm; NaN: unknown."""
    truth = middle_depth_mm(scene).astype(np.float64)
    return np.where(np.isfinite(truth), truth, np.nan)


def depth_errors_mm(field: LightField, truth_mm: Array, where: NDArray[np.bool_]) -> Array:
    """Return the depth errors, estimate minus truth, at samples where both are known, (n,) mm.

    The result is a single NaN if depth is unknown at half or more of the samples with a known truth: the rest would be
    the easy ones. Depth estimated beyond infinity has an infinite error.

    Parameters
    ----------
    field : LightField
        Light field divided by its white image.
    truth_mm : (t, s) float64
    where : (t, s) bool

    Raises
    ------
    LfmeshError
        As for `estimate_depth`.
    """
    error = (estimate_depth(field).distance_mm - truth_mm)[where & ~np.isnan(truth_mm)]
    known = error[~np.isnan(error)]
    return known if 2 * known.size > error.size else np.array([np.nan])
