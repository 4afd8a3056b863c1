"""The plume of the assets is the one of the formula, and its voxels are fine enough."""

import numpy as np

from lfmesh.geometry.index_media import index_media
from lfmesh.geometry.voxels import read_voxels
from lfmesh.optics.index_field_steps import probed
from lfmesh.scene import load
from tools.make_plume import MANTISSA, PLACE, SPACING_MM, temperature_k

SCENE = PLACE.parents[1] / "scenes" / "schlieren_plume.toml"


def test_the_grid_in_assets_follows_the_formula() -> None:
    grid = read_voxels(PLACE)
    assert (grid.spacing_mm == SPACING_MM).all()
    x, y, z = np.moveaxis(grid.centres_mm(), -1, 0)
    np.testing.assert_allclose(
        grid.values["temperature_k"], temperature_k(np.hypot(x, z), y), rtol=1.0 / MANTISSA, atol=0.0
    )


def test_the_plume_of_the_scene_needs_no_finer_voxels() -> None:
    (plume,) = index_media(load(SCENE), (550.0,))
    assert plume.field is not None
    found = probed(plume.field)
    assert found.fault() is None
    assert found.trapped == 0
    # Rays along the plume are bent most: by no more than the steepest slope of a Gaussian, over its whole length.
    assert 3e-4 < found.deflection < 1.7e-4 * np.sqrt(2.0 / np.e) / 10.0 * 91.25
