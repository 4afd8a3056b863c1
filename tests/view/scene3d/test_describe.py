"""Parts of a scene in words."""

import numpy as np

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.scene3d.describe import describe
from tests.view.conftest import SCENE


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


def test_diffractive_surfaces_are_described_by_kind_orders_and_smallest_period() -> None:
    """A grating's period is that of its lines; a metalens is finest at the rim, d = λ √(r² + f²) / r."""
    grating = {"kind": "grating", "lines_per_mm": 100.0, "orders": [{"order": 0, "share": 0.5}]}
    metalens = {"kind": "metalens", "focal_length_mm": 3.0, "design_nm": 500.0}
    front = {"thickness_mm": 1.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True, "phase": grating}
    surfaces = [front, {"thickness_mm": 2.0, "semi_diameter_mm": 4.0}, {"semi_diameter_mm": 4.0, "phase": metalens}]
    sensor = {"pixels": [4, 4], "pixel_mm": 0.1, "distance_mm": 20.0}
    world = lf.build(lf.Scene(camera={"lens": {"surfaces": surfaces}, "sensor": sensor}))
    words = dict(describe(world, "lens[0]"))
    assert words["phase of surface 0"] == "grating, order 0, smallest period 10 µm"
    alone = dict(describe(world, "surface[2]"))
    assert alone["surface"] == "surface 2, flat, semi-diameter 4 mm"
    assert alone["phase of surface 2"] == "metalens, order 1, smallest period 0.625 µm"


def test_phases_of_an_array_are_described() -> None:
    metalens = {"kind": "metalens", "focal_length_mm": 0.5, "design_nm": 550.0}
    mla = {"count": [8, 8], "pitch_mm": 0.125, "index": 1.5, "thickness_mm": 0.3, "curved_phase": metalens}
    lens = {"surfaces": [{"paraxial": True, "focal_length_mm": 50.0, "stop": True, "semi_diameter_mm": 6.0}]}
    camera = {"focus_mm": 500.0, "lens": lens, "mla": mla, "sensor": {"pixels": [80, 80], "pixel_mm": 0.0125}}
    words = dict(describe(lf.build(lf.Scene(camera=camera)), "mla"))
    assert words["curved_phase"].startswith("metalens, order 1, smallest period 3.1")
    assert words["thickness"] == "0.3 mm, diffractive side to the lens"


def test_zeros_have_no_sign() -> None:
    target = {"shape": {"kind": "sphere", "radius_mm": 2.0}, "position_mm": [-0.0, 0.0, -300.0]}
    world = lf.build(loads(SCENE).changed({"targets": [target], "lights[0].position_mm": [-0.0, -40.0, -120.0]}))
    assert dict(describe(world, "targets[0]"))["position"] == "0 0 -300 mm"
    assert dict(describe(world, "lights[0]"))["position_mm"] == "0 -40 -120"
