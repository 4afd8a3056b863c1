"""Particles that move leave streaks: each packet starts where its particle is at its time."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import lfmesh as lf
from lfmesh.errors import SceneError
from lfmesh.geometry import frame
from lfmesh.geometry.rigid_motion import steady
from lfmesh.kernels.decorators import kernel
from lfmesh.scene.light.particles import Particles
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECT_FRAME, WORLD_FRAME
from lfmesh.transport.sources.particles import at_present, direction_of_light
from lfmesh.transport.tables.particles import corners_round, refuse_particles_behind
from tests.cameras import camera_without_array
from tests.movers import pose_of_mover
from tests.transport.lights.test_moving_lights import at_moment, motions_with

Array = NDArray[np.float64]

SHEET = {"point_mm": [0.0, 0.0, -60.0], "normal": [0.0, 0.6, 0.8], "direction": [1.0, 0.0, 0.0], "thickness_mm": 1.0,
         "width_mm": 30.0, "power_w": 1.0}  # fmt: skip
CLOUD: dict[str, Any] = {
    "count": 4000, "bounds": {"kind": "box", "size_mm": [20.0, 20.0, 20.0]}, "position_mm": [0.0, 0.0, -60.0],
    "displacement": {"kind": "uniform", "vector_mm": [0.3, -4.0, 2.0]}, "frame_time_s": 0.5,
}  # fmt: skip
LIT = CLOUD | {"sheet": SHEET, "diameter_um": 20.0}


def world_of(group: dict[str, Any]) -> lf.World:
    scene = lf.Scene(camera=camera_without_array(), exposure={"duration_s": 1.0}, particles=[group])
    return lf.build(scene, aimed=False)


@kernel
def fill_places(table: Any, now: Any, frames: Array, found: Array) -> None:
    """Write strength and place of each particle."""
    for i in range(len(found)):
        strength, place = at_present(table.streaks, now, frames, table, i)
        found[i, 0], found[i, 1], found[i, 2], found[i, 3] = strength, place[0], place[1], place[2]


@pytest.mark.parametrize("time_s", [0.0, 0.37, 1.0])
def test_a_particle_in_a_light_sheet_shines_as_it_would_if_it_stood_there(time_s: float) -> None:
    world = world_of(LIT)
    (table,) = world.particles
    now, found = at_moment(world.tables.motions, time_s), np.empty((len(table.points), 4))
    fill_places(table, now, world.tables.frames, found)
    places = table.points + time_s * np.array([0.6, -8.0, 4.0])
    np.testing.assert_allclose(found[:, 1:], places, atol=1e-12)
    sheet = Particles(**LIT).sheet
    assert sheet is not None
    np.testing.assert_allclose(found[:, 0], sheet.irradiance_w_mm2(places), rtol=1e-10)
    # Particles that come into the sheet later are there, in the dark.
    assert (found[:, 0] > 0.1 * found[:, 0].max()).sum() < 0.5 * len(found)


def test_all_particles_that_cross_a_light_sheet_are_kept() -> None:
    group = Particles(**LIT)
    (table,), sheet = world_of(LIT).particles, group.sheet
    assert sheet is not None
    (whole,) = world_of(CLOUD | {"intensity_w_sr": 1.0}).particles
    lit = np.zeros(len(whole.points))
    for time_s in np.linspace(0.0, 1.0, 2001):
        lit = np.maximum(lit, sheet.irradiance_w_mm2(whole.points + time_s * np.array([0.6, -8.0, 4.0])))
    kept = np.isin(whole.points[:, 0], table.points[:, 0])
    assert 100 < kept.sum() == len(table.points) < 2000
    assert kept[lit > 2e-6 * lit.max()].all()


def test_a_moving_camera_sees_particles_where_they_are_then() -> None:
    world, time_s = world_of(CLOUD | {"intensity_w_sr": 1.0}), 0.6
    (table,), frames = world.particles, world.tables.frames
    still = steady((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    camera = steady((4.0, 1.0, -3.0), (9.0, -20.0, 30.0), (1.0, 2.0, 3.0))
    motions = motions_with([camera, still])._replace(resting=1, frames=frames)
    now, found = at_moment(motions, time_s), np.empty((len(table.points), 4))
    fill_places(table, now, frames, found)
    to_object, to_world = frames[WORLD_FRAME, OBJECT_FRAME], frames[OBJECT_FRAME, WORLD_FRAME]
    places = frame.points(to_object, table.points + time_s * np.array([0.6, -8.0, 4.0]))
    places = frame.points(to_world, frame.points(pose_of_mover(motions, 1, time_s), places))
    np.testing.assert_allclose(found[:, 1:], places, atol=1e-10)
    corners = corners_round((table,), motions)
    assert (found[:, 1:] >= corners.min(axis=0)).all()
    assert (found[:, 1:] <= corners.max(axis=0)).all()
    # Light of a sheet comes from another side as the camera turns.
    along = table.along @ pose_of_mover(motions, 1, time_s)[:, :3].T
    assert np.linalg.norm(along - table.along) > 0.1
    np.testing.assert_allclose(direction_of_light(now, table), along, atol=1e-12)


def test_particles_that_fly_behind_the_front_of_the_lens_are_refused() -> None:
    world = world_of(CLOUD | {"intensity_w_sr": 1.0})
    fast = world.particles[0]
    fast = fast._replace(streaks=fast.streaks._replace(velocities=np.full_like(fast.points, 90.0)))
    refuse_particles_behind((fast,), world.tables.frames, 0.0)
    with pytest.raises(SceneError, match=r"particles\[0\]: during the exposure one may come to z = \d"):
        refuse_particles_behind((fast,), world.tables.frames, 0.0, world.tables.motions)
    assert (frame.points(world.tables.frames[WORLD_FRAME, CAMERA_FRAME], fast.points)[:, 2] < 0.0).all()
