"""Figures of a solved camera, as terms of a design."""

import pytest

import lfmesh as lf
from lfmesh.study.optimise.figures import CAMERA_FIGURES
from tests.cameras import close_up_camera


@pytest.mark.parametrize("name", ["edge_thickness_mm", "centre_thickness_mm", "air_space_mm"])
def test_a_medium_outside_the_lens_is_no_element(name: str) -> None:
    """The stop stands behind the last surface; the medium reaches to the sensor, and has no thickness."""
    dry = lf.Scene(camera=close_up_camera())
    figures = []
    for scene in (dry, dry.changed({"camera.image_medium": {"index": 1.3}})):
        solved = lf.solved(scene)
        figures.append(CAMERA_FIGURES[name].of(solved, lf.first_order(solved)))
    assert figures[1] == figures[0]
    assert len(figures[0]) > 0
