"""The table of what points close before the lens see: against rays traced through the lens, and where it has to end."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.scene import load_lens
from lfmesh.transport.aims.near_points import near_viewpoints
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.checks.aim_proof import proven
from lfmesh.transport.sequences.stop_rays import CameraTables

FAR: dict[str, Any] = {
    "shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0},
    "position_mm": [0.0, 0.0, -500.0],
    "material": {"radiance_w_m2_sr": 1.0},
}
NEAR = FAR | {
    "shape": {"kind": "plane", "width_mm": 22.0, "height_mm": 22.0},
    "position_mm": [0.0, 0.0, -7.79],
    "rotation_deg": [45.0, 0.0, 0.0],
}
"""From 0.01 to 15.6 mm before the lens, whose front has a radius of 12.6 mm."""


def world_of(targets: list[dict[str, Any]], lens: str = "double_gauss_50mm", **changes: Any) -> lf.World:
    taken = load_lens(asset_path(f"lenses/{lens}.toml")).model_copy(update=changes)
    camera = lf.Camera(lens=taken, focus_mm=500.0, sensor=lf.Sensor(pixels=(12, 12), pixel_mm=1.5))
    return lf.build(lf.Scene(camera=camera, targets=targets, transport={"split": "transmit"}))


@pytest.mark.parametrize("stop_mm", [0.5, 3.0, 8.5])
def test_rays_that_come_through_from_near_points_are_held_by_their_disks(stop_mm: float) -> None:
    """Uniform rays about each disk, half as wide again: of those that come through none crosses outside the disk."""
    world = world_of([NEAR, FAR], stop_semi_diameter_mm=stop_mm)
    random, held, sent = np.random.default_rng(3), 0, 0
    opening = world.aim.entrance.opening
    assert opening.near_depth > 0.0
    for distance in (0.02, 0.1, 0.3, 0.9, 2.0, 5.0, 9.0, 12.0):
        for height in random.uniform(0.0, 9.0, 4):
            point = np.array([0.6 * height, 0.8 * height, opening.plane_z - distance])
            cx, cy, radius = opening_from(opening, tuple(point))
            assert radius > 0.0
            r, turn = 1.5 * radius * np.sqrt(random.random(800)), 2.0 * np.pi * random.random(800)
            to = np.column_stack([cx + r * np.cos(turn), cy + r * np.sin(turn), np.full(800, opening.plane_z)])
            d = to - point
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            paths = lf.trace(world, np.tile(point, (800, 1)), d, split="transmit", engine="sequential")
            # Past the last surface of the lens.
            through = paths.source[paths.position[:, 2] > world.tables.lens.box_high[2] + 1e-6]
            assert (r[through] <= radius).all(), (distance, height)
            held, sent = held + len(through), sent + int((r < radius).sum())
    # The disks are not much wider than they have to be.
    assert held > 0.2 * sent, (held, sent)


def test_far_targets_keep_their_table_where_nothing_is_near() -> None:
    alone, beside = (world_of(t).aim.entrance.opening for t in ([FAR], [FAR, FAR | {"position_mm": [0.0, 0.0, -13.0]}]))
    assert alone.near_depth == beside.near_depth == 0.0


def test_a_near_target_that_ends_before_the_others_leaves_their_table_as_it_was() -> None:
    flat = NEAR | {"rotation_deg": [0.0, 0.0, 0.0], "position_mm": [0.0, 0.0, -0.5]}
    alone, beside = (world_of(targets).aim.entrance.opening for targets in ([FAR], [FAR, flat]))
    assert beside.near_depth > 0.0
    # To a hundredth, to which openings are measured.
    assert alone.far.radius.shape == beside.far.radius.shape
    assert beside.far.radius == pytest.approx(alone.far.radius, rel=0.02)


def test_a_wall_from_behind_the_camera_to_afar_is_near_only_where_it_passes_the_lens() -> None:
    """Its corners are not near; where its edges cross the lens's plane they are."""
    points = np.array([[300.0, 0.0, 100.0], [300.0, 0.0, -900.0], [300.0, 50.0, -900.0]])
    seen = near_viewpoints(0.0, 12.0, [(points, np.array([[0, 1], [1, 2], [2, 0]]))])
    assert seen is not None
    assert (seen.distance[0], seen.distance[-1]) == (0.0, 12.0)
    assert seen.extends_beyond
    assert 300.0 <= seen.height[-1] < 301.0


def test_rays_from_the_stop_prove_the_near_disks_with_and_without_poses() -> None:
    """Elements that stand aside move the disks. Disks a fifth too small are found, and widened again."""
    pose = {"surfaces": [0, 1], "pose": {"shift_mm": [0.3, -0.2, 0.0], "tilt_deg": [0.5, 0.0, 0.0]}}
    posed = lf.Scene.model_validate(world_of([NEAR, FAR]).scene.model_dump()).changed({"camera.lens.elements": [pose]})
    for world in (world_of([NEAR, FAR]), lf.build(posed)):
        assert world.aim.entrance.opening.near_depth > 0.0
        assert world.aim_proof is not None
        assert world.aim_proof.holds
        narrow = world.aim.entrance.opening.near._replace(radius=0.8 * world.aim.entrance.opening.near.radius)
        opening = world.aim.entrance.opening._replace(near=narrow)
        aim = world.aim._replace(entrance=world.aim.entrance._replace(opening=opening))
        through = CameraTables(world.tables.lens, world.tables.mla, world.tables.sensor, world.tables.frames)
        corners = world.targets[0].mesh.vertices
        edges = world.targets[0].mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        near = near_viewpoints(opening.plane_z, opening.near_depth, [(corners, edges)])
        mended, proof = proven(aim, through, None, near)
        assert proof is not None
        assert proof.fitted > 0
        assert proof.holds
        assert mended.entrance.opening.near.radius.max() > narrow.radius.max()
