"""Metrics of the centres of micro-images, from white images and from traced chief rays."""

import math

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.study.metrics.comparison import Comparison, from_replicates, reference_centres
from lfmesh.study.metrics.pictures import image_of
from lfmesh.study.sweeps.statistics import (
    Numbers,
    mean_square,
)

Array = NDArray[np.float64]
TRACED_DECIMALS = 9
"""Decimals of traced movements in pixels and degrees; the rest is rounding error."""


def centres(pair: Comparison) -> Array:
    """Return pseudo-values of the movement of the centres between both white images.

    Parameters
    ----------
    pair : Comparison
    """
    scene, nominal = pair.camera.scene, pair.reference.scene

    def estimate(use: Numbers) -> Array:
        own = estimate_centres(image_of(scene, pair.films["white"][use]), nominal)
        return _moved(own, reference_centres(pair, use))

    values = from_replicates(estimate, pair)
    pair.maps["centres"] = _displacements(values, pair.reference_chief_rays)
    return _movements(values)


def chief_rays(pair: Comparison) -> Array:
    """Return the movement of the chief rays on the sensor between both cameras, which is not random.

    Parameters
    ----------
    pair : Comparison
    """
    moved = _moved(pair.chief_rays, pair.reference_chief_rays)
    values = np.round(moved, TRACED_DECIMALS)[None, :] + 0.0
    pair.maps["chief_rays"] = _displacements(values, pair.reference_chief_rays)
    found = _movements(values)
    # Displacements that cancel leave a rounding error in their sum.
    found[:, :2] = np.round(found[:, :2], TRACED_DECIMALS) + 0.0
    return found


def _moved(own: Calibration, other: Calibration) -> Array:
    """Return the movement of each centre, x and y in pixels, NaN where unknown; then pitch ratio and rotation."""
    both = (own.known & other.known)[..., None]
    moved = np.where(both, own.centres_px - other.centres_px, np.nan)
    turn = math.degrees(own.rotation_rad - other.rotation_rad)
    return np.array([*moved.ravel(), own.pitch_px / other.pitch_px, turn])


def _displacements(values: Array, centres: Calibration) -> Array:
    """Return the mean displacement of each centre, (rows, columns, 2) pixels, from pseudo-values of `_moved`."""
    return np.asarray(values[:, :-2].mean(axis=0).reshape(centres.centres_px.shape))


def _movements(values: Array) -> Array:
    """Return a metric's columns from pseudo-values of `_moved`, without a noise bias of the square."""
    moved = values[:, :-2].reshape(len(values), -1, 2)
    moved = moved[:, np.isfinite(moved).all(axis=(0, 2))]
    if not moved.size:
        raise LfmeshError("no micro-image is whole in all replicates of this camera and of the reference")
    return np.column_stack([moved.mean(axis=1), 2.0 * mean_square(moved), values[:, -2:]])
