"""A camera whose parts stand in each other's way is refused: it would take a black picture without a word."""

from typing import Any

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path


def first_light(changes: dict[str, Any]) -> lf.Scene:
    return lf.load(asset_path("scenes/first_light.toml")).changed(changes | {"targets": [], "lights": []})


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"camera.mla.pose.tilt_deg": [10.0, 0.0, 0.0]}, "camera.sensor.pose"),
        ({"camera.mla.pose.shift_mm": [0.0, 0.0, 0.4]}, "camera.sensor.pose"),
        ({"camera.sensor.pose.shift_mm": [0.0, 0.0, -0.4]}, "camera.sensor.pose"),
        ({"camera.sensor.pose.tilt_deg": [0.0, -8.0, 0.0]}, "camera.sensor.pose"),
        ({"camera.mla.pose.shift_mm": [0, 0, -45.0], "camera.sensor.pose.shift_mm": [0, 0, -45.0]}, "into the lens"),
        ({"camera.mla": None, "camera.sensor.distance_mm": None, "camera.sensor.pose.shift_mm": [0, 0, -50.0]},
         "into the lens"),
    ],
)  # fmt: skip
def test_parts_that_reach_into_each_other_are_refused(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(lf.SceneError, match=field):
        lf.build(first_light(changes))


HOLLOW = [
    {"radius_mm": 20.0, "thickness_mm": 6.0, "index": 1.5, "semi_diameter_mm": 8.0, "stop": True},
    {"radius_mm": 10.0, "semi_diameter_mm": 8.0},
]
"""A lens whose last surface is a bowl 4 mm deep, open towards the sensor."""


@pytest.mark.parametrize(
    ("changes", "fits"),
    [
        ({"distance_mm": 1.76}, True),  # the bowl is 1.754 mm deep at the corners of the sensor
        ({"distance_mm": 1.75}, False),
        ({"distance_mm": 1.0}, False),
        # An edge that dips by 0.7 mm, and one that is shifted out of the middle of the bowl.
        ({"distance_mm": 2.4, "pose": {"tilt_deg": [0.0, 10.0, 0.0]}}, False),
        ({"distance_mm": 2.8, "pose": {"tilt_deg": [0.0, 10.0, 0.0]}}, True),
        ({"distance_mm": 2.0, "pose": {"shift_mm": [1.0, 0.0, 0.0]}}, False),
    ],
)
def test_a_sensor_in_the_hollow_of_the_last_surface_must_clear_the_surface(changes: dict[str, Any], fits: bool) -> None:
    """The sag of a sphere of 10 mm at the height h is 10 − √(100 − h²); the corners of 8 mm × 8 mm are at h = 5.66."""
    sensor = {"pixels": [8, 8], "pixel_mm": 1.0} | changes
    scene = lf.Scene(camera={"lens": {"surfaces": HOLLOW}, "sensor": sensor})
    if fits:
        lf.build(scene)
        return
    with pytest.raises(lf.SceneError, match="into the lens"):
        lf.build(scene)


@pytest.mark.parametrize(
    "changes",
    [
        {"camera.mla.pose.tilt_deg": [3.0, 0.0, 0.0]},
        {"camera.mla.pose.shift_mm": [0.0, 0.0, 0.25]},
        {"camera.sensor.pose.tilt_deg": [0.0, 0.0, 45.0]},
        # Behind the array's edge, where there is nothing of the array.
        {"camera.mla.count": [8, 8], "camera.sensor.pose.tilt_deg": [8.0, 0.0, 0.0]},
    ],
)
def test_parts_that_are_clear_of_each_other_are_not(changes: dict[str, Any]) -> None:
    lf.build(first_light(changes))
