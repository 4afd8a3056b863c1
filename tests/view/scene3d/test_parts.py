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


def test_lamps_with_a_size_are_drawn_as_large_as_they_are() -> None:
    """A tube about its line, a panel and a disk in their planes with an arrow along the light."""
    direction = [0.0, 0.0, -1.0]
    lights = [
        {"kind": "line", "start_mm": [50.0, -30.0, -480.0], "end_mm": [50.0, 30.0, -480.0], "power_w": 1.0},
        {"kind": "rectangle", "position_mm": [0.0, 90.0, -300.0], "direction": direction, "width_mm": 40.0,
         "height_mm": 20.0, "power_w": 1.0},
        {"kind": "disk", "position_mm": [0.0, -90.0, -300.0], "direction": direction, "radius_mm": 15.0,
         "power_w": 1.0},
    ]  # fmt: skip
    scene = lf.loads(SCENE).changed({"lights": lights})
    tube, panel, disk = (
        np.asarray(part.mesh.points, dtype=np.float64) for part in parts(lf.build(scene)) if part.kind == "light"
    )
    np.testing.assert_allclose([tube[:, 1].min(), tube[:, 1].max()], [-30.0, 30.0], atol=1e-4)
    np.testing.assert_allclose(tube.mean(axis=0), [50.0, 0.0, -480.0], atol=1e-3)
    for points, (x, y), middle in ((panel, (20.0, 10.0), 90.0), (disk, (15.0, 15.0), -90.0)):
        np.testing.assert_allclose(np.ptp(points, axis=0)[:2], [2.0 * x, 2.0 * y], atol=1e-3)
        assert abs(points[:, 1].min() + y - middle) < 1e-3
        assert points[:, 2].max() == pytest.approx(-300.0, abs=1e-3)
        assert points[:, 2].min() < -301.0


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
