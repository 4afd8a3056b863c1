"""Cameras that the tests of this folder share."""

from collections.abc import Callable
from typing import Any

import pytest

import lfmesh as lf
from tests.random_scenes.generator import draw

RandomCamera = Callable[[int], lf.Scene]

LEFT_OUT = ("camera_pose", "ground_surface", "polarisation", "two_wavelengths")
"""Features that tests of the aim do not take: these know the camera's frame and one wavelength alone, and an aim."""

TARGET = {"shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0, 0, -300.0],
          "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip


@pytest.fixture(scope="session")
def emitting_plane() -> dict[str, Any]:
    """Return a target that shines evenly, as a scene's table."""
    return TARGET


@pytest.fixture(scope="session")
def random_camera() -> RandomCamera:
    """Return the camera of a number, with polished lenses and by its image path alone."""
    return lambda number: draw("camera", number, LEFT_OUT).scene.changed({"transport.split": "transmit"})
