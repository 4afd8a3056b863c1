"""Error of the depth from a camera's light field, against the points that its rays meet."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.photographs.depth import estimate_depth
from lfmesh.lightfield.photographs.depth_truth import middle_depth_mm
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import Scene

Array = NDArray[np.float64]

LEAST_CONFIDENCE = 0.5
"""Depth that is known less well in the reference's light field is not judged: there is no texture to find it by."""


def textured(field: LightField) -> NDArray[np.bool_]:
    """Return the samples of the reference's light field, (t, s), whose depth can be told.

    Raises
    ------
    LfmeshError
        As `estimate_depth`.
    """
    found = estimate_depth(field)
    return (found.confidence >= LEAST_CONFIDENCE) & np.isfinite(found.distance_mm)


def true_depth_mm(scene: Scene) -> Array:
    """Return the distance of what each lenslet of a camera sees along its chief ray, (t, s) mm; NaN where unknown."""
    truth = middle_depth_mm(scene).astype(np.float64)
    return np.where(np.isfinite(truth), truth, np.nan)


def depth_errors_mm(field: LightField, truth_mm: Array, where: NDArray[np.bool_]) -> Array:
    """Return by how much depth is too large at samples where both it and the truth are known, (n,) mm.

    A single NaN where depth is unknown at half or more of the samples with a known truth: of the rest alone the error
    would be that of the samples that are easy. Samples whose depth is estimated beyond infinity are infinitely wrong.

    Parameters
    ----------
    field : LightField
        Divided by its white image.
    truth_mm : (t, s) float64
    where : (t, s) bool

    Raises
    ------
    LfmeshError
        As `estimate_depth`.
    """
    error = (estimate_depth(field).distance_mm - truth_mm)[where & ~np.isnan(truth_mm)]
    known = error[~np.isnan(error)]
    return known if 2 * known.size > error.size else np.array([np.nan])
