"""Parts of a scene in words."""

import numpy as np

import lfmesh as lf
from lfmesh.view.scene3d.describe import describe


def test_a_surface_with_another_section_in_x_has_the_keys_of_its_form() -> None:
    clear = {"thickness_mm": 3.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True}
    front = {"radius_mm": np.inf, "toroid": {"radius_x_mm": 40.0}, **clear}
    back = {"radius_mm": -30.0, "conic": 0.5, "biconic": {"radius_x_mm": -20.0, "conic_x": -1.0}}
    lens = {"surfaces": [front, {**back, "semi_diameter_mm": 4.0}]}
    sensor = {"pixels": [4, 4], "pixel_mm": 0.1, "distance_mm": 20.0}
    words = dict(describe(lf.build(lf.Scene(camera={"lens": lens, "sensor": sensor})), "lens[0]"))
    assert words["front"] == "surface 0, toroid of radius_x_mm = 40, in y flat, semi-diameter 4 mm"
    expected = "surface 1, biconic of radius_x_mm = -20 and conic_x = -1, in y R -30 mm, conic 0.5, semi-diameter 4 mm"
    assert words["back"] == expected
