"""Symbols of a scene's parts stand where they show what they mean and hide nothing."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.view.scene3d.parts import parts

pytestmark = pytest.mark.drawing

SCENE = """
schema_version = 1
camera.focus_mm = 500.0
camera.lens = { file = "lib:double_gauss_50mm", stop_semi_diameter_mm = 4.77 }
camera.mla = { count = [4, 4], pitch_mm = 0.125, focal_length_mm = 0.5, index = 1.5, thickness_mm = 0.3 }
camera.sensor = { pixels = [40, 40], pixel_mm = 0.0125 }
lights = [{ kind = "directional", direction = [0.3, -0.4, -1.0], irradiance_w_m2 = 1.0 }]
targets = [{ shape = { kind = "sphere", radius_mm = 10.0 }, position_mm = [20.0, 0.0, -500.0] }]
"""


def test_the_arrows_of_parallel_light_point_at_the_targets_and_leave_the_lens_free() -> None:
    scene = lf.loads(SCENE)
    (symbol,) = [part for part in parts(lf.build(scene)) if part.name == "lights[0]"]
    points = np.asarray(symbol.mesh.points, dtype=np.float64)
    along = np.array([0.3, -0.4, -1.0]) / np.linalg.norm([0.3, -0.4, -1.0])
    off = points - np.array([20.0, 0.0, -500.0])
    assert (off @ along).max() < -10.0, "they end before the ball"
    assert (off @ along).min() > -150.0
    aside = off - (off @ along)[:, None] * along
    assert np.allclose(0.5 * (aside.min(axis=0) + aside.max(axis=0)), 0.0, atol=1.0)
    assert np.linalg.norm(points, axis=1).min() > 300.0, "far from the lens, whose first vertex is the origin"
