"""The flame of the assets is the one of the formulas."""

import numpy as np

from lfmesh.geometry.voxels import read_voxels
from tools.make_flame import PLACE, SPACING_MM, soot_and_temperature


def test_the_grid_in_assets_follows_the_formulas() -> None:
    grid = read_voxels(PLACE)
    assert (grid.spacing_mm == SPACING_MM).all()
    x, y, z = np.moveaxis(grid.centres_mm(), -1, 0)
    soot, _ = soot_and_temperature(np.hypot(x, z), y)
    absorption = grid.values["absorption_per_mm"]
    assert absorption.max() > 0.0
    np.testing.assert_allclose(absorption, 6e6 * np.pi * 0.26 * soot / 589.0, rtol=2.0**-11, atol=0.0)  # eleven bits
