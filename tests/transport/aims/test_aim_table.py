"""The aim of a camera is found once, and again for whatever changes it."""

from typing import Any

import pytest

import lfmesh as lf
from lfmesh.assets import asset_path

LAMP = {"kind": "point", "position_mm": [50.0, 0.0, -100.0], "power_w": 1.0}


@pytest.fixture(scope="module")
def scene() -> lf.Scene:
    return lf.load(asset_path("scenes/emitting_plane.toml"))


@pytest.mark.parametrize(
    "changes",
    [
        {"transport.seed": 9},
        {"transport.samples": 16},
        {"lights": [LAMP]},
        {"targets[0].material.radiance_w_m2_sr": 3.0},
    ],
)
def test_what_does_not_change_where_rays_go_leaves_the_aim_as_it_is(scene: lf.Scene, changes: dict[str, Any]) -> None:
    first, second = lf.build(scene), lf.build(scene.changed(changes))
    assert second.aim is first.aim
    assert second.aim_proof is first.aim_proof


@pytest.mark.parametrize(
    "changes",
    [
        {"camera.focus_mm": 600.0},
        {"camera.lens.stop_semi_diameter_mm": 3.0},
        {"camera.mla.pose.tilt_deg": (0.0, 0.1, 0.0)},
        {"camera.mla.form.radius_error": 0.01},
        {"camera.sensor.pose.shift_mm": (0.1, 0.0, 0.0)},
        {"camera.sensor.pixels": (64, 64)},
        {"targets[0].position_mm": (0.0, 1.0, -500.0)},
        {"transport.split": "transmit"},
        {"transport.wavelengths_nm": (450.0, 650.0)},
    ],
)
def test_what_may_change_where_rays_go_has_an_aim_of_its_own(scene: lf.Scene, changes: dict[str, Any]) -> None:
    first, second = lf.build(scene), lf.build(scene.changed(changes))
    assert second.aim is not first.aim


def test_cameras_without_end_do_not_fill_the_memory(scene: lf.Scene) -> None:
    from lfmesh.transport.aims.kept import KEPT
    from lfmesh.transport.checks import aim_proof

    for k in range(KEPT + 3):
        lf.build(scene.changed({"camera.focus_mm": 500.0 + k}))
    assert len(aim_proof._kept._found) == KEPT
