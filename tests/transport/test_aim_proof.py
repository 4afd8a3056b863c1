"""Rays from the stop tell what the aim misses: for cameras of all kinds nothing that matters; and if it does."""

from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.geometry.lattice import ROW_SPACING
from lfmesh.transport.aim_proof import ALLOWED, Openings, _beyond_object_aim, _beyond_sensor_aim, _drawn, _reach
from lfmesh.transport.pupil import outlook
from lfmesh.transport.tables import Aim
from lfmesh.transport.world import World

TARGET = {"shape": {"kind": "plane", "width_mm": 120.0, "height_mm": 120.0}, "position_mm": [0, 0, -300.0],
          "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}  # fmt: skip


def random_camera(seed: int) -> lf.Scene:
    """Draw a lens, a stop before, inside or behind it, and an array of any kind, near hemispheres among them."""
    draw = np.random.default_rng(seed)
    focal, index = draw.uniform(20.0, 80.0), draw.uniform(1.45, 1.9)
    widest = focal / draw.uniform(2.2, 6.0) / 2.0
    radius = 4.0 * focal * (index - 1.0) * draw.uniform(0.95, 1.05)
    glass = {"index": index, "semi_diameter_mm": 1.15 * widest}
    conic = {"conic": draw.uniform(-1.5, 0.5)} if draw.random() < 0.4 else {}
    thick = widest**2 / radius * 1.5 + 1.0
    element = [
        {"radius_mm": radius, "thickness_mm": thick} | glass | conic,
        {"radius_mm": -radius, "thickness_mm": draw.uniform(1.0, 8.0), "semi_diameter_mm": 1.15 * widest},
    ]
    stop = {"stop": True, "thickness_mm": draw.uniform(1.0, 8.0),
            "semi_diameter_mm": widest * 10.0 ** draw.uniform(-2.0, 0.0)}  # fmt: skip
    where = int(draw.integers(0, 3))
    surfaces = [*element, *element]
    surfaces.insert(2 * where, stop)
    surfaces[-1] = {key: value for key, value in surfaces[-1].items() if key != "thickness_mm"}
    hexagonal, to_lens = draw.random() < 0.5, draw.random() < 0.5
    pitch = 10.0 ** draw.uniform(-1.7, -0.3)
    corner = pitch / np.sqrt(3.0 if hexagonal else 2.0)
    curved = draw.choice([0.1, 0.3, 0.6, 0.9, 0.98])
    mla: dict[str, Any] = {
        "layout": "hexagonal" if hexagonal else "square",
        "count": [20, 20],
        "pitch_mm": pitch,
        "radius_mm": corner / curved,
        "index": draw.uniform(1.4, 1.9),
        "thickness_mm": corner * draw.uniform(1.1, 3.0),
        "curved_side": "lens" if to_lens else "sensor",
    }
    if draw.random() < 0.4:
        shift = draw.uniform(-0.3, 0.3, 3) * pitch * [1.0, 1.0, 0.1]
        mla["pose"] = {"tilt_deg": list(draw.uniform(-1.0, 1.0, 3)), "shift_mm": list(shift)}
    if curved < 0.9 and draw.random() < 0.4:
        mla["form"] = {"decenter_mm": 0.01 * pitch, "radius_error": 0.005, "seed": seed}
    rows = ROW_SPACING if hexagonal else 1.0
    pixel = pitch / draw.uniform(6.0, 15.0)
    sensor = {"pixels": [int(20 * pitch / pixel), int(20 * rows * pitch / pixel)], "pixel_mm": pixel}
    if curved > 0.2:
        # Steep lenslets in a thick plate have their focal plane inside it; any distance is as good here.
        sensor["distance_mm"] = corner * draw.uniform(0.8, 3.0)
    return lf.Scene(
        camera={"focus_mm": 300.0, "lens": {"surfaces": surfaces}, "mla": mla, "sensor": sensor},
        targets=[TARGET],
        transport={"split": "transmit"},
    )


def missed(world: World, aim: Aim, seed: int = 99) -> tuple[float, float]:
    """Return the shares of the throughput outside an aim's two sides, by new rays."""
    random = np.random.default_rng(seed)
    tables = world.tables
    through = Openings(tables.lens, tables.array, tables.sensor, tables.frames)
    rays = _drawn(through, _reach(through, random), random)
    corners = world.targets[0].mesh.vertices
    seen = outlook(aim.entrance.plane_z, aim.front_radius, corners, to_sensor=True)
    found = _beyond_sensor_aim(aim, through, rays), _beyond_object_aim(aim, seen, rays, random)
    return tuple(float(rays.throughput[of > 1.0].sum() / rays.throughput.sum()) for of in found)  # type: ignore[return-value]


@pytest.mark.parametrize("seed", range(12))
def test_the_aim_of_a_random_camera_holds_all_light(seed: int) -> None:
    """By rays other than those to which it was fitted; a factor of two for their number."""
    world = lf.build(random_camera(seed))
    assert world.aim_proof.holds, world.aim_proof
    assert max(missed(world, world.tables.aim)) <= 2.0 * ALLOWED


@pytest.mark.long
@pytest.mark.parametrize("seed", range(12, 300))
def test_the_aim_of_many_random_cameras_holds_all_light(seed: int) -> None:
    world = lf.build(random_camera(seed))
    assert world.aim_proof.holds, world.aim_proof
    assert max(missed(world, world.tables.aim)) <= 2.0 * ALLOWED


NARROWER = {
    "lenslets' views": lambda aim: aim._replace(slope_radius2=0.8 * aim.slope_radius2),
    "lenslets' faces": lambda aim: aim._replace(cell_margin=-1e-3, sure2=-1.0),
    "fewer cells": lambda aim: aim._replace(slope_radius2=np.where(np.arange(64 * 64) % 500 == 7, -1.0, 1.0)
                                            * aim.slope_radius2),
    "the entrance pupil": lambda aim: aim._replace(entrance=aim.entrance._replace(radius=0.97 * aim.entrance.radius)),
}  # fmt: skip


@pytest.mark.parametrize("name", NARROWER)
def test_rays_from_the_stop_find_what_a_narrower_aim_misses(name: str) -> None:
    world = lf.build(lf.load(asset_path("scenes/first_light.toml")).changed({"targets": [TARGET], "lights": []}))
    assert max(missed(world, world.tables.aim)) <= ALLOWED
    assert max(missed(world, NARROWER[name](world.tables.aim))) > 5.0 * ALLOWED


def test_rays_from_the_stop_find_what_a_narrower_pupil_misses_without_an_array() -> None:
    scene = lf.load(asset_path("scenes/conventional.toml")).changed({"targets": [TARGET], "lights": []})
    world = lf.build(scene)
    narrower = world.tables.aim._replace(
        exit=world.tables.aim.exit._replace(radius=0.97 * world.tables.aim.exit.radius)
    )
    assert missed(world, world.tables.aim)[0] <= ALLOWED
    assert missed(world, narrower)[0] > 5.0 * ALLOWED


def test_lenslets_near_hemispheres_are_searched_among_few_cells() -> None:
    """Rays that leave a lenslet at grazing angles say nothing of what it shows: they would have all be searched."""
    mla = {"layout": "square", "count": [64, 64], "pitch_mm": 0.125, "radius_mm": 0.08930, "index": 1.5,
           "thickness_mm": 0.0938}  # fmt: skip
    scene = lf.load(asset_path("scenes/first_light.toml")).changed(
        {"camera.mla": mla, "camera.sensor.distance_mm": None, "camera.lens.stop_semi_diameter_mm": 10.0}
    )
    world = lf.build(scene)
    assert world.aim_proof.holds
    assert world.tables.aim.search <= 6
