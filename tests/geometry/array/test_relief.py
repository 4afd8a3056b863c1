"""The relief of lenslets against areas."""

import numpy as np
import pytest

from lfmesh.geometry.array.lattice import Lattice
from lfmesh.geometry.array.lenslets import lenslets
from lfmesh.geometry.array.relief import fill_relief


@pytest.mark.parametrize("hexagonal", [False, True])
def test_round_apertures_pass_their_area(hexagonal: bool) -> None:
    """Of a mask over three by four cells, seen on a grid whose boxes fill the plane."""
    shape = lenslets(Lattice(hexagonal, 1.0, 3, 4), np.array([2.0]), 1.0)._replace(clear_radius=0.45)
    step = 0.04
    across = step * (np.arange(120) - 59.5)
    x, y = (np.ascontiguousarray(each.ravel()) for each in np.meshgrid(across, across))
    relief = np.zeros((4, len(x)))
    fill_relief(shape, x, y, step, relief)
    assert relief[3].sum() * step**2 == pytest.approx(12.0 * np.pi * 0.45**2, rel=1e-3)


def test_boxes_at_the_rim_of_an_array_have_the_height_of_their_part_on_it() -> None:
    """A third of the box lies on the lenslet, on a sphere of radius 2 mm."""
    shape = lenslets(Lattice(False, 1.0, 1, 1), np.array([2.0]), 1.0)
    box, relief = 0.03, np.zeros((4, 1))
    fill_relief(shape, np.array([0.5 + box / 6.0]), np.zeros(1), box, relief)
    within = 0.5 - box / 6.0
    assert relief[3, 0] == pytest.approx(1.0 / 3.0, abs=0.05)
    assert abs(relief[0, 0]) == pytest.approx(2.0 - np.sqrt(4.0 - within**2), rel=0.02)
    assert abs(relief[1, 0]) == pytest.approx(within / np.sqrt(4.0 - within**2), rel=0.02)
