"""Tilted and decentred elements move the light's way through the lens, and the aim follows."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.aims.fitting import ALLOWED
from tests.transport.checks.test_aim_proof import missed, with_opening


@pytest.mark.parametrize("scene", ["first_light", "conventional"])
def test_openings_are_decentred_rather_than_widened(scene: str) -> None:
    """A stop 1.3 mm off the axis: the aim is as narrow as before, and without its decentre it would lose light."""
    changes: dict[str, Any] = {
        "targets": [
            {
                "shape": {"kind": "plane", "width_mm": 80.0, "height_mm": 80.0},
                "position_mm": [0.0, 0.0, -500.0],
                "material": {"radiance_w_m2_sr": 1.0},
            }
        ],
        "lights": [],
    }
    plain = lf.load(asset_path(f"scenes/{scene}.toml")).changed(changes)
    stop = plain.camera.lens.stop_index
    pose = {"surfaces": [stop], "pose": {"shift_mm": [1.3, 0.4, 0.0], "tilt_deg": [0.0, 3.0, 0.0]}}
    world = lf.build(plain.changed({"camera.lens.elements": [pose]}))
    assert world.aim_proof is not None
    assert world.aim_proof.holds
    before, after = lf.build(plain).aim, world.aim
    for side in ("entrance", "exit"):
        assert getattr(after, side).opening.far.radius.max() < 1.03 * getattr(before, side).opening.far.radius.max()
    assert max(missed(world, after)) <= 2.0 * ALLOWED
    centred = np.zeros((2, 2))
    back = after._replace(entrance=with_opening(after.entrance, decentre=centred))
    if not world.tables.mla.present:
        back = back._replace(exit=with_opening(after.exit, decentre=centred))
        assert missed(world, back)[0] > 100 * ALLOWED
    assert missed(world, back)[1] > 100 * ALLOWED


def test_a_lens_without_poses_has_centred_openings() -> None:
    aim = lf.build(lf.load(asset_path("scenes/first_light.toml"))).aim
    assert not aim.entrance.opening.far.decentre.any()
    assert not aim.exit.opening.far.decentre.any()
