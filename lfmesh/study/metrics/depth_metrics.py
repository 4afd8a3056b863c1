"""Metric of the depth from the light field."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.calibration.centres import estimate_centres
from lfmesh.lightfield.calibration.white import white_scene
from lfmesh.lightfield.views.decode import decode
from lfmesh.lightfield.views.field import LightField
from lfmesh.scene import Scene
from lfmesh.study.metrics.comparison import Comparison, from_replicates
from lfmesh.study.metrics.depth_error import depth_errors_mm, textured, true_depth_mm
from lfmesh.study.metrics.pictures import Films, image_of
from lfmesh.study.sweeps.statistics import Numbers

Array = NDArray[np.float64]


def depth(pair: Comparison) -> Array:
    """Return pseudo-values of the depth error, decoded with the nominal camera and with its calibration.

    Parameters
    ----------
    pair : Comparison
    """
    nominal = pair.reference.scene
    where = pair.of_reference(
        "textured",
        pair.every,
        lambda use: textured(_divided(pair.reference_films, use, nominal, pair.reference_chief_rays)),
    )
    truth = true_depth_mm(pair.camera.scene)

    def estimate(use: Numbers) -> Array:
        seen = estimate_centres(image_of(nominal, pair.films["white"][use]), nominal)
        fields = (_divided(pair.films, use, nominal, centres) for centres in (pair.reference_chief_rays, seen))
        errors = [depth_errors_mm(field, truth, where) for field in fields]
        return np.array([value for error in errors for value in (np.median(error), np.median(np.abs(error)))])

    return from_replicates(estimate, pair)


def _divided(films: Films, use: Numbers, nominal: Scene, centres: Calibration) -> LightField:
    """Return the light field of the scene, divided by the white image's."""
    white = image_of(white_scene(nominal), films["white"][use])
    return decode(image_of(nominal, films["scene"][use]), nominal, white=white, calibration=centres)
