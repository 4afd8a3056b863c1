"""Figures of a solved camera, as terms of a design."""

import pytest

import lfmesh as lf
from lfmesh.study.optimise.figures import CAMERA_FIGURES
from tests.cameras import close_up_camera


@pytest.mark.parametrize("name", ["edge_thickness_mm", "centre_thickness_mm", "air_space_mm"])
def test_a_medium_outside_the_lens_is_no_element(name: str) -> None:
    """The stop stands behind the last surface; the medium reaches to the sensor, and has no thickness."""
    dry = lf.Scene(camera=close_up_camera())
    cameras = [lf.solved(dry), lf.solved(dry.changed({"camera.image_medium": {"index": 1.3}}))]
    of_air, of_oil = (CAMERA_FIGURES[name].of(camera, lf.first_order(camera)) for camera in cameras)
    assert of_oil == of_air
    assert of_air
