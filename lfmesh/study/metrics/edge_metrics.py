"""Metrics of an edge in the refocused picture: its sharpness, and the distance at which it is sharpest."""

import math
import warnings

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.photographs.refocus import refocus
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.decode import decode
from lfmesh.scene import Scene
from lfmesh.study.cameras.compare import measuring
from lfmesh.study.metrics.column import RESOLVED
from lfmesh.study.metrics.comparison import Comparison, from_replicates, reference_centres
from lfmesh.study.metrics.edge_focus import edge_shift_mm, why_unknown
from lfmesh.study.metrics.pictures import Films, edge_scene, image_of
from lfmesh.study.metrics.resolution import edge_mtf50
from lfmesh.study.sweeps.statistics import (
    Numbers,
    combined,
    mean_square,
)
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]
LEAST_LENSLETS = 10
"""Smallest number of lenslets along each axis whose middle, without cut-off micro-images, suffices for an MTF."""

SHARPEST = 0.6034
"""MTF50 of a box as wide as a sample, cycles per sample; the limit for samples that integrate over their width."""


def mtf50(pair: Comparison) -> Array:
    """Return pseudo-values of an edge's MTF50, decoded with the nominal camera and calibrated by the white image.

    Parameters
    ----------
    pair : Comparison
    """
    nominal = edge_scene(pair.reference)
    films, white = pair.films["edge"], pair.films["white"]

    def estimate(use: Numbers) -> Array:
        seen = estimate_centres(image_of(pair.reference.scene, white[use]), pair.reference.scene)
        image = image_of(nominal, films[use])
        return np.array([_sharpness(image, nominal, pair, centres) for centres in (pair.reference_chief_rays, seen)])

    found = from_replicates(estimate, pair)
    most = SHARPEST * pair.reference_chief_rays.centres_px.shape[0]
    for values in found.T:
        value, error = combined(values)
        # A value beyond the limit by noise is put at the limit; a value farther beyond is wrong.
        if value > most:
            values[:] += most - value if value <= most + RESOLVED * error else math.nan
    return found


def _sharpness(image: Image, nominal: Scene, pair: Comparison, centres: Calibration) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        photograph = refocus(decode(image, nominal, calibration=centres), pair.reference.edge_distance_mm)
    picture = photograph.mean.mean(axis=2)
    height, width = picture.shape
    # Micro-images at the border may be cut off, and some samples unknown.
    middle = picture[height // 10 : height - height // 10, width // 8 : width - width // 8]
    return edge_mtf50(middle) * height


def why_no_mtf50(scene: Scene) -> str:
    """Return the reason why a camera has no MTF50, or "".

    Parameters
    ----------
    scene : Scene
    """
    assert scene.camera.mla is not None
    columns, rows = scene.camera.mla.count
    if min(columns, rows) >= LEAST_LENSLETS:
        return ""
    return f"needs at least {LEAST_LENSLETS} × {LEAST_LENSLETS} lenslets, but the camera has {columns} × {rows}"


def refocus_distance(pair: Comparison) -> Array:
    """Return pseudo-values of the refocus distance of an edge, decoded with the nominal camera and calibrated.

    Parameters
    ----------
    pair : Comparison
    """
    nominal = pair.reference.scene

    def distances(films: Films, use: Numbers, seen: Calibration) -> Array:
        return np.array([_refocused_mm(films, use, nominal, each) for each in (pair.reference_chief_rays, seen)])

    def of_reference(use: Numbers) -> Array:
        return distances(pair.reference_films, use, reference_centres(pair, use))

    def estimate(use: Numbers) -> Array:
        own = distances(pair.films, use, estimate_centres(image_of(nominal, pair.films["white"][use]), nominal))
        return np.array([own[0], *(own - pair.of_reference("refocus", use, of_reference))])

    distance, *shifts = from_replicates(estimate, pair).T
    return np.column_stack([distance, *(column for shift in shifts for column in (shift, mean_square(shift)))])


def _refocused_mm(films: Films, use: Numbers, nominal: Scene, centres: Calibration) -> float:
    """Return the distance of the sharpest photograph of the edge; NaN if it is not a real distance."""
    edge, white = measuring(nominal), measuring(white_scene(nominal))
    light = decode(image_of(white, films["white"][use].sum(axis=3, keepdims=True)), white, calibration=centres)
    field = decode(image_of(edge, films["edge"][use]), edge, calibration=centres)
    distance = field.model.distance_mm(edge_shift_mm(field, light))
    return distance if 0.0 < distance < math.inf else math.nan


def why_no_refocus(scene: Scene) -> str:
    """Return the reason why a camera has no refocus distance, or "".

    Parameters
    ----------
    scene : Scene
    """
    assert scene.camera.mla is not None
    columns, rows = scene.camera.mla.count
    return why_unknown(rows, columns, RayModel.of(scene))
