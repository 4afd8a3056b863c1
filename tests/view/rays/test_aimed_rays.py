"""Rays of field points through points of the stop."""

import math

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.view.rays.aimed_rays import Aim


@pytest.mark.parametrize("off_mm", [0.0, 1e-3])
def test_rays_are_refused_only_where_the_stop_is_imaged_onto_the_object(off_mm: float) -> None:
    """Parallel light, and a stop in the focus of the first of two lenses: no other point of it can be aimed at."""
    surfaces = [
        {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 10.0, "thickness_mm": 50.0 + off_mm},
        {"stop": True, "semi_diameter_mm": 5.0, "thickness_mm": 100.0 - off_mm},
        {"paraxial": True, "focal_length_mm": 50.0, "semi_diameter_mm": 20.0},
    ]
    sensor = {"pixels": [8, 8], "pixel_mm": 0.5}
    camera = {"focus_mm": math.inf, "lens": {"surfaces": surfaces}, "sensor": sensor}
    scene = lf.solved(lf.Scene.model_validate({"schema_version": 1, "camera": camera}))
    aim, target = Aim(lf.build(scene.camera_alone()), math.inf), [[0.0, 1.0, 200.0]]
    if off_mm:
        assert math.isfinite(aim.slopes_to(target)[0, 1])
    else:
        with pytest.raises(lf.LfmeshError, match="the stop is imaged onto the object plane"):
            aim.slopes_to(target)


def test_a_ray_that_turns_back_before_the_stop_does_not_meet_it() -> None:
    """It meets the front face twice, and no other. One of less momentum across the axis arrives."""
    fading = {"kind": "axial", "index": 1.5, "coefficients": [-0.24]}
    surfaces = [
        {"thickness_mm": 2.0, "gradient": fading, "semi_diameter_mm": 20.0},
        {"stop": True, "semi_diameter_mm": 20.0},
    ]
    camera = {"lens": {"surfaces": surfaces}, "object_medium": {"index": 1.5},
              "sensor": {"pixels": [8, 8], "pixel_mm": 0.5, "distance_mm": 5.0}}  # fmt: skip
    aim = Aim(lf.build(lf.Scene.model_validate({"schema_version": 1, "camera": camera})), math.inf)
    slopes = np.array([[0.0, -math.tan(math.asin(momentum / 1.5))] for momentum in (1.1, 0.5)])
    turns, passes = aim.trace(slopes, np.zeros((2, 2)))
    assert np.isnan(turns.at_stop).all()
    assert np.isnan(turns.leaving).all()
    assert turns.face.tolist().count(0) == 2
    # x grows by p ∫ dz / √(n² − p²).
    assert passes.at_stop[1] == pytest.approx(0.5 / 0.24 * (math.acosh(3.0) - math.acosh(2.04)), abs=1e-8)
