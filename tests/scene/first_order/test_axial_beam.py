"""The axial beam of lenses that are none of revolution, and the warning of apertures that clip it."""

import math
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene.first_order.axial_beam import beam_mm
from lfmesh.scene.first_order.meridional import edge_of_stop_mm
from lfmesh.waves.bundle import LensRays, pupil_grid


def scene_of(front: dict[str, Any], back_mm: float) -> lf.Scene:
    """A thick lens with its stop on the strong front, and a clear aperture of `back_mm` on its flat back."""
    first = {"thickness_mm": 30.0, "index": 1.6, "semi_diameter_mm": 12.0, "stop": True, **front}
    lens = {"surfaces": [first, {"semi_diameter_mm": back_mm}]}
    camera = {"focus_mm": math.inf, "lens": lens, "sensor": {"pixels": [8, 8], "pixel_mm": 0.01}}
    return lf.Scene.model_validate({"schema_version": 1, "camera": camera})


def anamorphic(back_mm: float) -> lf.Scene:
    return scene_of({"radius_mm": 30.0, "biconic": {"radius_x_mm": -60.0, "conic_x": 0.0}}, back_mm)


def test_the_beam_of_a_sphere_is_as_wide_as_its_meridional_ray_is_high() -> None:
    lens = scene_of({"radius_mm": 30.0}, 12.0).camera.lens
    same = scene_of({"radius_mm": 30.0, "biconic": {"radius_x_mm": 30.0, "conic_x": 0.0}}, 12.0).camera.lens
    truth = np.abs(edge_of_stop_mm(lens, 587.6, 200.0, 12.0)[1])
    assert beam_mm(lens, 587.6, 200.0).found_mm == pytest.approx(truth, rel=1e-8)
    assert beam_mm(same, 587.6, 200.0).found_mm == pytest.approx(truth, rel=1e-8)


@pytest.mark.parametrize(("excess", "warned"), [(0.9998, True), (1.0002, False)])
def test_an_anamorphic_lens_is_warned_of_if_and_only_if_real_rays_are_clipped(excess: float, warned: bool) -> None:
    wide = beam_mm(anamorphic(30.0).camera.lens, 587.6, math.inf).found_mm[1]
    scene = anamorphic(wide * excess)
    rays = LensRays(lf.build(lf.solved(scene).camera_alone()), math.inf, 40.0)
    assert bool(rays.bundle(0.0, pupil_grid(16, rim=True), 587.6).passes.all()) is not warned
    assert any("clear aperture" in warning for warning in lf.first_order(scene).warnings) is warned
