"""Standard errors of single pixels cover the truth as often as Student's t says, over random cameras."""

from collections.abc import Callable

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.accuracy.reported_error import coverage, sampled

RandomCamera = Callable[[int], lf.Scene]

CAMERAS = 100
SIDE = 26
"""Pixels, in the middle of each camera's sensor."""

SAMPLES, LONG = 512, 4096
"""Of the images that are examined, and of their references."""

WITHIN = 0.02
"""How far the share of pixels may be from what Student says."""

SIGMAS = 3.5
"""Of a share's own error, over cameras, in nine shares: one run in 200 would fail by chance."""


@pytest.mark.long
@pytest.mark.parametrize("replicates", [2, 4, 8])
def test_pixels_of_random_cameras_are_covered_as_student_says(replicates: int, random_camera: RandomCamera) -> None:
    """Pixels with 100 hits or more and noise of more than one hit; 1, 2 and 3 standard errors."""
    found = []
    for seed in range(CAMERAS):
        scene = random_camera(seed).changed({"camera.sensor.pixels": [SIDE, SIDE]})
        image, reference = sampled(scene, SAMPLES, replicates, 1), sampled(scene, LONG, 8, 0)
        covered = coverage(image, reference)
        if covered[0].pixels:
            found.append(covered)
    # In the others no pixel gets light from 100 of its samples.
    assert len(found) > CAMERAS // 5
    for one_camera in zip(*found, strict=True):
        pixels = np.array([covered.pixels for covered in one_camera])
        inside = np.array([covered.pixels * covered.found for covered in one_camera])
        share, expected = inside.sum() / pixels.sum(), one_camera[0].expected
        # Pixels of a camera may go together, cameras do not.
        chance = np.sqrt(((inside - share * pixels) ** 2).sum()) / pixels.sum()
        assert abs(share - expected) <= WITHIN + SIGMAS * chance, (one_camera[0].sigmas, share, expected, chance)
