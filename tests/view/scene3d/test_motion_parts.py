"""Motions in a 3D view and in drawings: ways, and bodies where they are at the end of the exposure."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.layout.content import layout
from lfmesh.view.scene3d.describe import describe
from lfmesh.view.scene3d.parts import Part, parts
from tests.view.conftest import SCENE

pytestmark = pytest.mark.drawing

BALL = {"shape": {"kind": "sphere", "radius_mm": 4.0}, "position_mm": [0.0, 0.0, -150.0]}
UP = {"velocity_mm_s": [0.0, 3000.0, 0.0]}
STEP = np.array([0.0, 30.0, 0.0])


def moving(camera: Any = None, **parts: Any) -> lf.World:
    changes = {"targets": (), "lights": (), "exposure": {"duration_s": 0.01}} | parts
    return lf.build(loads(SCENE).changed(changes | ({"camera.motion": camera} if camera else {})))


def signs(world: lf.World) -> dict[str, Part]:
    return {part.label: part for part in parts(world)}


def test_a_body_has_a_way_and_a_ghost_at_its_end() -> None:
    drawn = signs(moving(targets=(BALL | {"motion": UP},)))
    way = np.asarray(drawn["targets[0] way"].mesh.points)
    assert way.max(axis=0) - way.min(axis=0) == pytest.approx(STEP, rel=1e-9)
    body, ghost = (np.asarray(drawn[label].mesh.points) for label in ("targets[0]", "targets[0] at the end"))
    assert ghost.mean(axis=0) - body.mean(axis=0) == pytest.approx(STEP, abs=0.05)
    assert drawn["targets[0] arrow"].kind == "sign"


def test_lamps_media_and_the_camera_have_ways_and_what_rests_has_none() -> None:
    lamp = {"kind": "point", "position_mm": [0.0, 9.0, -50.0], "power_w": 1.0}
    smoke = {"bounds": {"kind": "sphere", "radius_mm": 4.0}, "absorption_per_mm": 0.1, "position_mm": [0, 0, -90.0]}
    world = moving(UP, targets=(BALL,), lights=(lamp | {"motion": UP},), media=(smoke | {"motion": UP},))
    ways = {label for label in signs(world) if label.endswith("way")}
    assert ways == {"camera way", "lights[0] way", "media[0] way"}
    assert dict(describe(world, "lights[0]"))["motion"] == "0 3000 0 mm/s"
    assert dict(describe(world, "media[0]"))["motion"] == "0 3000 0 mm/s"


def test_a_polarised_lamp_is_described_by_its_state() -> None:
    lamp = {"kind": "point", "position_mm": [0.0, 9.0, -50.0], "power_w": 1.0}
    lamp["polarisation"] = {"kind": "linear", "angle_deg": 30.0}
    world = moving(targets=(BALL,), lights=(lamp,), **{"transport.polarisation": True, "exposure": None})
    assert dict(describe(world, "lights[0]"))["polarisation"] == "linear 30"


def test_a_drawing_shows_bodies_at_the_end_as_the_camera_then_sees_them() -> None:
    bodies = (BALL, BALL | {"motion": UP})
    still, alone = (layout(moving(targets=bodies).scene).targets[k] for k in (0, 1))
    assert still.at_end == []
    assert np.concatenate(alone.at_end).mean(axis=0)[1] == pytest.approx(30.0, abs=0.1)
    behind, along = layout(moving(UP, targets=bodies).scene).targets
    assert np.concatenate(behind.at_end).mean(axis=0)[1] == pytest.approx(-30.0, abs=0.1)
    assert np.concatenate(along.at_end).mean(axis=0)[1] == pytest.approx(0.0, abs=0.1)


def test_a_still_scene_is_the_moving_one_at_its_begin() -> None:
    dust = {
        "count": 3, "bounds": {"kind": "sphere", "radius_mm": 9.0}, "intensity_w_sr": 1.0, "frame_time_s": 0.1,
        "displacement": {"kind": "uniform", "vector_mm": [1.0, 0.0, 0.0]},
    }  # fmt: skip
    scene = loads(SCENE).changed({"targets": (BALL,), "particles": ({**dust, "frame_time_s": None},)})
    moved = scene.changed({
        "exposure": {"duration_s": 0.01}, "camera.motion": UP, "targets[0].motion": UP, "particles[0].frame_time_s": 0.1
    })  # fmt: skip
    assert moved.moves
    assert moved.still() == scene
    assert scene.still() is scene
