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
