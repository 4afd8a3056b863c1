"""Pixel-to-ray: light that comes in along the ray of a pixel and a lenslet lands on that pixel."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.lightfield.rays.object_rays import object_rays
from lfmesh.scene import Scene
from tests.frames import motion

BUILT_BADLY = {
    "camera.mla.pose": {"shift_mm": [0.03, -0.02, 0.01], "tilt_deg": [0.6, -0.4, 1.0]},
    "camera.sensor.pose": {"shift_mm": [-0.02, 0.01, 0.02], "tilt_deg": [-0.3, 0.2, 0.5]},
    "camera.mla.form": {"pitch_error": 0.002, "decenter_mm": 0.002, "radius_error": 0.01, "seed": 3},
    "camera.pose": {"shift_mm": [40.0, 30.0, -20.0], "tilt_deg": [10.0, 20.0, 30.0]},
}

PRISM = {"kind": "xy", "coefficients_rad": [[1, 0, 30.0], [0, 1, -20.0], [2, 0, -8.0]], "radius_mm": 0.0625}
"""A phase that deflects the rays through the apexes."""


@pytest.mark.parametrize("phase", [None, PRISM], ids=["glass", "phase"])
@pytest.mark.parametrize("sensor_mm", [None, 0.45], ids=["in the focal plane", "focused plenoptic"])
@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
@pytest.mark.parametrize("layout", ["square", "hexagonal"])
def test_light_along_the_ray_of_a_pixel_lands_on_it(
    camera: Callable[..., Scene], layout: str, curved_side: str, sensor_mm: float | None,
    phase: dict[str, object] | None,
) -> None:  # fmt: skip
    scene = camera(layout, curved_side).changed(BUILT_BADLY | {"camera.mla.curved_phase": phase})
    if sensor_mm is not None:
        scene = scene.changed({"camera.sensor.distance_mm": sensor_mm})
    calibration = lf.calibrate(scene)
    column, row = (index.ravel() for index in np.meshgrid(np.arange(14), np.arange(12)))
    pixels = calibration.centres_px[row, column] + np.random.default_rng(2).uniform(-2.0, 2.0, (168, 2))
    there = ((pixels >= -0.5) & (pixels <= np.asarray(scene.camera.sensor.pixels) - 0.5)).all(axis=1)
    assert there.sum() > 160
    pixels, column, row = pixels[there], column[there], row[there]
    rays = object_rays(scene, np.column_stack([column, row]), pixels)
    assert np.isfinite(rays.origin).all()
    world = lf.build(scene)
    paths = lf.trace(world, rays.origin + rays.direction, -rays.direction, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    landed = frame.points(motion(world, "world", "sensor"), paths.position)[:, :2]
    expected = (pixels - 0.5 * (np.asarray(scene.camera.sensor.pixels) - 1.0)) * scene.camera.sensor.pixel_mm
    np.testing.assert_allclose(landed, expected[paths.source], rtol=0, atol=1e-10)


def test_beyond_the_pupil_there_is_no_ray(camera: Callable[..., Scene]) -> None:
    scene = camera()
    centre = lf.calibrate(scene).centres_px[6, 7]
    rays = object_rays(scene, np.array([[7, 6], [7, 6]]), np.add(centre, [[0.0, 0.0], [6.0, 0.0]]))
    assert np.isfinite(rays.direction[0]).all()
    assert np.isnan(rays.direction[1]).all()


def test_a_lenslet_that_is_not_there_is_refused(camera: Callable[..., Scene]) -> None:
    with pytest.raises(lf.LfmeshError, match="the array has columns 0 to 13 and rows 0 to 11"):
        object_rays(camera(), np.array([[14, 0]]), np.array([[3.0, 4.0]]))
