"""A scene's settings as kernels take them."""

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.transport.settings import NEAR_LENS, options_of
from tests.transport.checks.test_picture_warnings import plane, scene

SHINES = {"reflectance": 0.9, "radiance_w_m2_sr": 1.0}
SPECK = {
    "shape": {"kind": "plane", "width_mm": 1e-3, "height_mm": 1e-3},
    "position_mm": (0.0, 0.0, -1e5),
    "material": {"reflectance": 0.0},
}


def test_a_sheet_near_the_lens_gets_light_back_from_it() -> None:
    """It is as bright alone as in a scene in which light goes from target to target anyway."""
    sheet = plane(-3.0) | {"material": SHINES}
    alone = scene(targets=[sheet], **{"transport.split": "both"})
    one, two = lf.render(alone), lf.render(alone.changed({"targets": [sheet, SPECK]}))
    np.testing.assert_allclose(one.mean.sum(), two.mean.sum(), rtol=1e-6)


@pytest.mark.parametrize(
    ("radii", "split", "followed"),
    [(0.9, "both", True), (1.1, "both", False), (0.9, "transmit", False)],
)
def test_light_is_followed_from_a_single_sheet_only_near_the_lens(radii: float, split: str, followed: bool) -> None:
    """The lens has a radius of 7 mm; without reflections none comes back."""
    sheet = plane(-radii * NEAR_LENS * 7.0) | {"material": SHINES}
    world = lf.build(scene(targets=[sheet], **{"transport.split": split}))
    assert options_of(world).bounce == followed
