"""Demosaicking, against pictures that linear interpolation gives back exactly."""

import numpy as np
import pytest

from lfmesh.lightfield.detector import PATTERNS
from lfmesh.lightfield.views.demosaic import demosaicked


def mosaic_of(rgb: np.ndarray, pattern: str) -> np.ndarray:
    mosaic = np.empty(rgb.shape[:2])
    for place, colour in enumerate(pattern):
        pixels = np.s_[place // 2 :: 2, place % 2 :: 2]
        mosaic[pixels] = rgb[(*pixels, "RGB".index(colour))]
    return mosaic


@pytest.mark.parametrize("pattern", PATTERNS)
def test_planes_of_light_come_back_exactly(pattern: str) -> None:
    """Any linear gradient whose colours differ by constants, away from the mirrored edges; random ones."""
    random = np.random.default_rng(3)
    rows, columns = np.mgrid[:17, :22]
    for _ in range(20):
        level, across, down = random.normal(size=3), random.normal(), random.normal()
        rgb = level + (across * columns + down * rows)[:, :, None]
        found = demosaicked(mosaic_of(rgb, pattern), pattern)
        np.testing.assert_allclose(found[2:-2, 2:-2], rgb[2:-2, 2:-2], atol=1e-12)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_an_even_colour_is_even_to_the_edges_and_measured_values_stay(pattern: str) -> None:
    rgb = np.broadcast_to([0.7, 0.4, 0.1], (6, 9, 3))
    np.testing.assert_allclose(demosaicked(mosaic_of(rgb, pattern), pattern), rgb, atol=1e-15)
    mosaic = np.random.default_rng(1).random((8, 8))
    assert (demosaicked(mosaic, pattern) == mosaic[:, :, None]).any(axis=2).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (2, 2)])
def test_a_sensor_of_a_few_pixels_is_no_error(size: tuple[int, int]) -> None:
    assert demosaicked(np.ones(size), "RGGB").shape == (*size, 3)
