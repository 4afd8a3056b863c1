"""Rays of field points through points of the stop."""

import math

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
