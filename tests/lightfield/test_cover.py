"""Micro-images and pixel rays behind the sensor's cover: the closed form of a plate against traced rays."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.lightfield.rays.chief_rays import plate_of
from lfmesh.lightfield.rays.object_rays import object_rays
from lfmesh.lightfield.rays.pixel_slopes import pixel_slopes
from tests.cameras import close_up_camera
from tests.frames import motion

COVER = {"thickness_mm": 0.6, "gap_mm": 0.2, "index": 1.6}


def camera(cover=COVER):
    table = close_up_camera()
    table["sensor"] |= {"cover": cover, "pose": {"tilt_deg": [3.0, -2.0, 0.0]}}
    return lf.build(lf.Scene(camera=table))


def test_chief_rays_land_where_traced_rays_do():
    """From just behind the array, in the directions that chief rays have there."""
    world = camera()
    plate = plate_of(world.scene)
    random = np.random.default_rng(1)
    count = len(plate.apexes)
    slopes = np.column_stack([random.uniform(-0.3, 0.3, (count, 2)), np.ones(count)])
    directions = slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    to_world = motion(world, "array", "world")
    thickness = plate.lenslets.thickness
    inside = plate.inside(directions)
    behind = np.column_stack([plate.apexes + thickness * inside[:, :2] / inside[:, 2:], np.full(count, thickness)])
    behind += 1e-3 * directions
    paths = lf.trace(
        world, frame.points(to_world, behind), frame.directions(to_world, directions), split="transmit"
    )  # fmt: skip
    landed = frame.points(motion(world, "world", "sensor"), paths.position)[np.argsort(paths.source), :2]
    np.testing.assert_allclose(plate.landing(directions), landed, rtol=0.0, atol=1e-9)


def test_rays_of_pixels_are_the_way_back():
    """A ray from object space along a pixel's ray meets that pixel: lenslets at their apexes do not bend it."""
    world = camera()
    lenslets = np.array([[1, 1], [2, 1], [1, 2], [2, 2]])
    pixels = np.array([[6.2, 7.1], [12.0, 6.8], [7.4, 12.3], [13.0, 12.9]])
    rays = object_rays(world.scene, lenslets, pixels)
    paths = lf.trace(world, rays.origin + 5.0 * rays.direction, -rays.direction, split="transmit")
    assert (paths.status == lf.Status.SENSOR).all()
    landed = frame.points(motion(world, "world", "sensor"), paths.position)[np.argsort(paths.source), :2]
    sensor = world.scene.camera.sensor
    expected = (pixels - 0.5 * (np.array(sensor.pixels) - 1.0)) * sensor.pixel_mm
    np.testing.assert_allclose(landed, expected, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("curved_side", ["lens", "sensor"])
def test_derivatives_of_rays_through_the_cover_are_those_of_differences(curved_side):
    """Of a sensor tilted by up to 20 degrees: slopes by the point that the ray comes to, against the inverse."""
    table = close_up_camera()
    table["sensor"] |= {"cover": COVER, "pose": {"tilt_deg": [20.0, -14.0, 30.0]}}
    table["mla"] |= {"curved_side": curved_side}
    plate = plate_of(lf.build(lf.Scene(camera=table)).scene)
    random = np.random.default_rng(2)
    count = len(plate.apexes)
    on_sensor = plate.apexes + random.uniform(-0.2, 0.2, (count, 2))
    before = np.full(count, plate.lenslets.thickness if plate.curved_to_lens else 0.0)
    step = 1e-4

    def slopes(offset):
        return pixel_slopes(plate, on_sensor, plate.apexes + offset, before, before).slope

    there = pixel_slopes(plate, on_sensor, plate.apexes, before, before)
    by_place = np.stack([(slopes(h) - slopes(-h)) / (2.0 * step) for h in step * np.eye(2)], axis=2)
    np.testing.assert_allclose(by_place, np.linalg.inv(there.derivative), rtol=0.0, atol=1e-6)
