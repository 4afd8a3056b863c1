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
