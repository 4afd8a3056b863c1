"""Tables of object space."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry.lens.lens_shape import lens_shape
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.transport.tables.objects import housing_mesh


@pytest.mark.parametrize("tilts_deg", [(30.0, 0.0), (20.0, 11.0), (-7.0, 27.0), (3.0, -30.0)])
def test_no_rim_of_a_tilted_lens_stands_behind_the_plate_of_the_housing(tilts_deg: tuple[float, float]) -> None:
    """The rim of a tilted disk reaches r sin θ farther along the axis than its middle, whichever way it is turned."""
    surfaces = [
        {"thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 10.0, "stop": True},
        {"semi_diameter_mm": 10.0},
    ]
    scene = lf.Scene.model_validate({
        "schema_version": 1,
        "camera": {
            "focus_mm": 500.0,
            "lens": {"surfaces": [{**surfaces[0], "radius_mm": 50.0}, surfaces[1]],
                     "elements": [{"surfaces": [0, 1], "pose": {"tilt_deg": [*tilts_deg, 0.0]}}]},
            "sensor": {"pixels": [8, 8], "pixel_mm": 0.01},
        },
    })  # fmt: skip
    camera = solved_camera(scene).scene
    shape = lens_shape(camera)
    surface, rim = shape.surfaces[0], shape.rims[0]
    cosine = float(surface["pose"][2, 2])
    assert cosine < 0.95
    sag = 50.0 - np.sqrt(50.0**2 - rim**2)
    highest = sag * cosine + rim * np.sqrt(1.0 - cosine**2)
    plate = housing_mesh(camera, shape).vertices[:, 2].min()
    assert highest <= plate * (1.0 + 1e-15)
    assert plate < highest + 1e-3 * rim
