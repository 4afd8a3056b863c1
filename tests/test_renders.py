"""Pictures that tests make of many seeds: those of `lf.render`, pixel by pixel and watt by watt."""

import numpy as np
import pytest

import lfmesh as lf
from tests.cameras import camera_without_array, close_up_camera
from tests.renders import by_seed

GLOW = {
    "shape": {"kind": "plane", "width_mm": 60.0, "height_mm": 60.0},
    "position_mm": [0.0, 0.0, -60.0],
    "material": {"reflectance": 0.3, "radiance_w_m2_sr": 1.0},
}


@pytest.mark.parametrize("method", ["adjoint", "forward"])
@pytest.mark.parametrize("camera", [close_up_camera(), camera_without_array(pixels=8)], ids=["array", "no array"])
def test_many_seeds_give_the_pictures_of_single_renders(camera: dict[str, object], method: str) -> None:
    settings = {"method": method, "samples": 4, "replicates": 2, "split": "both"}
    scene = lf.Scene(camera=camera, targets=[GLOW], transport=settings)  # type: ignore[arg-type]
    for seed, image in zip((3, 8, 11), by_seed(scene, (3, 8, 11)), strict=True):
        alone = lf.render(scene.changed({"transport.seed": seed}))
        np.testing.assert_array_equal(image.mean, alone.mean)
        np.testing.assert_array_equal(image.stderr, alone.stderr)
        assert image.ledger == alone.ledger
