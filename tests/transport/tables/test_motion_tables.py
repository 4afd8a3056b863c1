"""Movers, and the space that they pass through."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.geometry import frame
from lfmesh.transport.packets.packet import MOST_MOVERS, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.tables.motions import Motions
from lfmesh.transport.tables.swept import path_of_camera, reach_mm
from lfmesh.transport.world import World
from tests.movers import pose_of_mover

FORTH = {"velocity_mm_s": [10.0, 0.0, 5.0], "spin_deg_s": [0.0, 30.0, 60.0], "center_mm": [1.0, 2.0, -90.0]}
BACK = {"velocity_mm_s": [-10.0, 0.0, 0.0]}


def plane(x: float, motion: dict[str, Any] | None = None) -> dict[str, Any]:
    return {
        "shape": {"kind": "plane", "width_mm": 2.0, "height_mm": 1.0}, "position_mm": [x, 0.0, -100.0],
        "material": {"radiance_w_m2_sr": 1.0}, "motion": motion,
    }  # fmt: skip


def built(targets: list[dict[str, Any]], camera: dict[str, Any] | None = None, **more: Any) -> World:
    lens = [{"radius_mm": 50.0, "thickness_mm": 5.0, "index": 1.5, "semi_diameter_mm": 8.0, "stop": True},
            {"radius_mm": -50.0, "semi_diameter_mm": 8.0}]  # fmt: skip
    scene = {
        "camera": {"lens": {"surfaces": lens}, "focus_mm": 100.0, "sensor": {"pixels": [2, 2], "pixel_mm": 3.0},
                   "motion": camera},
        "targets": targets, "exposure": {"duration_s": 0.1},
    } | more  # fmt: skip
    return lf.build(lf.Scene(**scene), aimed=False)


def motions(world: World) -> Motions:
    tables = world.tables.motions
    assert tables is not None
    return tables


def test_things_with_one_motion_are_one_mover() -> None:
    table = motions(built([plane(0.0), plane(3.0, FORTH), plane(6.0, BACK), plane(-3.0, FORTH)]))
    assert table.of_target.tolist() == [0, 1, 2, 1, 0]
    assert table.resting == 0


def test_things_that_move_with_the_camera_stand_still() -> None:
    table = motions(built([plane(0.0), plane(3.0, FORTH), plane(6.0, BACK)], FORTH))
    assert table.of_target[1] == 0
    assert table.of_target[0] == table.resting != 0
    assert len({*table.of_target.tolist()}) == 3


def test_a_scene_in_which_nothing_moves_has_no_tables() -> None:
    assert built([plane(0.0)]).tables.motions is None
    assert built([plane(0.0, {"velocity_mm_s": [0.0, 0.0, 0.0]})]).tables.motions is None


def test_wall_and_liquid_of_a_tank_are_one_mover() -> None:
    turns = {"poses": [{"time_s": 0.0}, {"time_s": 0.1, "position_mm": [1.0, 0.0, -80.0], "rotation_deg": [3, 2, 1]}]}
    tank = {"size_mm": [9.0, 9.0, 9.0], "wall_mm": 1.0, "wall": {"index": 1.5}, "liquid": {"index": 1.3},
            "open": "top", "position_mm": [0.0, 0.0, -80.0], "motion": turns}  # fmt: skip
    assert motions(built([plane(0.0)], tanks=[tank])).of_target.tolist() == [0, 1, 1, 0]


def test_a_mover_is_seen_from_the_camera() -> None:
    world = built([plane(3.0, BACK)], FORTH)
    table, to_world = motions(world), world.tables.frames[OBJECT_FRAME, WORLD_FRAME]
    seen = frame.compose(frame.compose(to_world, pose_of_mover(table, 1, 0.05)), frame.inverse(to_world))
    # In the world: the camera's motion turns about a centre that moves along.
    turn = np.deg2rad(0.05 * np.array(FORTH["spin_deg_s"]))
    angle, axis = np.linalg.norm(turn), turn / np.linalg.norm(turn)
    cross = np.cross(axis, np.eye(3)).T
    rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    centre, shift = np.array(FORTH["center_mm"]), 0.05 * np.array(FORTH["velocity_mm_s"])
    camera = np.column_stack([rotation, centre + shift - rotation @ centre])
    body = frame.frame(origin_mm=0.05 * np.array(BACK["velocity_mm_s"]))
    np.testing.assert_allclose(seen, frame.compose(frame.inverse(camera), body), rtol=0.0, atol=1e-11)


def test_spheres_hold_everything_throughout() -> None:
    world = built([plane(0.0), plane(3.0, FORTH)])
    table, objects = motions(world), world.tables.objects
    corners = objects.facets["corners"][objects.facets["body"] == 1].reshape(-1, 3)
    assert (np.linalg.norm(corners - table.bounds[1, :3], axis=1) < table.bounds[1, 3]).all()
    for time in np.linspace(0.0, 0.1, 101):
        places = frame.points(pose_of_mover(table, 1, float(time)), corners)
        assert np.linalg.norm(places, axis=1).max() <= reach_mm(table, 1, corners) * (1.0 + 1e-12)
        assert np.linalg.norm(places, axis=1).max() <= objects.lit_radius * (1.0 + 1e-12)


def test_the_path_of_the_lens_past_a_body_is_known_to_its_distance() -> None:
    table = motions(built([plane(3.0, BACK | {"spin_deg_s": [0.0, 900.0, 0.0]})], FORTH))
    lens = np.array([0.0, 0.0, 50.0])
    places, distance = path_of_camera(table, 1, lens, 2.0)
    assert 0.0 < distance < 2.0
    for time in np.linspace(0.0, 0.1, 101):
        (place,) = frame.points(frame.inverse(pose_of_mover(table, 1, float(time))), lens[None])
        assert np.linalg.norm(places - place, axis=1).min() <= distance * (1.0 + 1e-12)


def test_more_motions_than_packets_can_tell_apart_are_refused() -> None:
    many = [plane(float(i), {"velocity_mm_s": [float(i + 1), 0.0, 0.0]}) for i in range(MOST_MOVERS + 1)]
    assert motions(built(many[:-1])).of_target.max() == MOST_MOVERS
    with pytest.raises(lf.SceneError, match=f"more than {MOST_MOVERS} things move differently"):
        built(many)
