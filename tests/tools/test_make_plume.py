"""The plume of the assets is the one of the formula, and its voxels are fine enough."""

import numpy as np

from lfmesh.geometry.index_media import index_media
from lfmesh.geometry.voxels import read_voxels
from lfmesh.optics.index_field_steps import probed
from lfmesh.scene import load
from tools.make_plume import HALF_SIZE_MM, MANTISSA, PLACE, ROOM_K, SPACING_MM, temperature_k

SCENE = PLACE.parents[1] / "scenes" / "schlieren_plume.toml"


def test_the_grid_in_assets_follows_the_formula() -> None:
    grid = read_voxels(PLACE)
    assert (grid.spacing_mm == SPACING_MM).all()
    x, y, z = np.moveaxis(grid.centres_mm(), -1, 0)
    np.testing.assert_allclose(grid.values["temperature_k"], temperature_k(x, y, z), rtol=1.0 / MANTISSA, atol=0.0)


def test_the_plume_of_the_scene_needs_no_finer_voxels() -> None:
    (plume,) = index_media(load(SCENE), (550.0,))
    assert plume.field is not None
    found = probed(plume.field)
    assert found.fault() is None
    assert found.trapped == 0
    # Rays along the slot are bent most: by no more than the steepest slope above its middle, over the whole length.
    x_mm = np.linspace(0.0, HALF_SIZE_MM[0], 3001)
    index = 2.72e-4 * ROOM_K / temperature_k(x_mm, 0.0, 0.0)
    bound = np.abs(np.gradient(index, x_mm)).max() * 2.0 * HALF_SIZE_MM[1]
    assert 0.5 * bound < found.deflection < bound
