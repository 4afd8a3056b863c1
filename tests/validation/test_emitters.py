"""Light of emitting targets on matt ones against closed forms, and against scattered packets alone.

A polygon of radiance L gives a surface element that it faces E = L / 2 · Σ θᵢ Γᵢ · n: θᵢ is the angle under which the
element sees the i-th edge, Γᵢ the unit normal of the plane through the element and that edge (Lambert 1760; e.g.
Arvo, SIGGRAPH 1995). All polygons here lie above the element's horizon.
"""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.transport.tables.emitting_facets import no_emitters
from tests.instances import instances
from tests.renders import of_world
from tests.validation.test_every_path_once import GLOW, MIRROR, SCREEN, WHITE, accepted, folder, scene, sheet
from tests.validation.test_radiometry import (
    LEVEL,
    REFLECTANCE,
    assert_means,
    furnace,
    irradiances,
    patch,
    rectangle_factor,
)

__all__ = ["folder"]

Array = NDArray[np.float64]


def irradiance_of(corners: Array, at: Array, radiance: float) -> float:
    """Return what polygons (n, k, 3) that show their front give an element that faces +z."""
    to = corners - at
    to /= np.linalg.norm(to, axis=2, keepdims=True)
    following = np.roll(to, -1, axis=1)
    across = np.cross(to, following)
    sine = np.linalg.norm(across, axis=2)
    angle = np.arctan2(sine, (to * following).sum(axis=2))
    return float(0.5 * radiance * abs((angle * across[..., 2] / sine).sum(axis=1)).sum())


def by_chance(world: lf.World) -> lf.World:
    """Return a world in which scattered packets alone find the light of emitting targets."""
    objects = world.tables.objects._replace(emitters=no_emitters())
    world = copy(world)
    world.tables = world.tables._replace(objects=objects)
    return world


def powers(world: lf.World, seeds: range) -> Array:
    """Return the power on the sensor by so many seeds, W."""
    return np.array([image.mean.sum() for image in of_world(world, seeds)])


def glowing_square(side: float, x: float, y: float, z: float, **rest: Any) -> dict[str, Any]:
    """A sheet parallel to the patch, which it faces from above."""
    return {"shape": {"kind": "plane", "width_mm": side, "height_mm": side}, "position_mm": [x, y, z],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 7.0}} | rest  # fmt: skip


def test_polygons_agree_with_the_catalogue() -> None:
    square = np.array([[[10.0, -15.0, 15.0], [40.0, -15.0, 15.0], [40.0, 25.0, 15.0], [10.0, 25.0, 15.0]]])
    expected = np.pi * rectangle_factor(15.0, 10.0, 40.0, -15.0, 25.0)
    assert irradiance_of(square, np.zeros(3), 1.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("height", [4.0, 8.0, 20.0])
def test_a_glowing_sphere_lights_a_plane_by_its_height(height: float) -> None:
    """E = π L (R / d)² cos θ."""
    ball = {"shape": {"kind": "sphere", "radius_mm": 3.0}, "position_mm": [9.0, 0.0, height - 60.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 7.0}}  # fmt: skip
    distance = np.hypot(9.0, height)
    expected = np.pi * 7.0 * (3.0 / distance) ** 2 * height / distance
    found = irradiances(patch([], [ball]), 32)
    assert stats.sem(found) < 5e-3 * expected
    assert_means(found[:, None], np.array([expected]), 2e-4)


def test_many_small_emitters_beside_a_huge_one_count_as_much() -> None:
    """The small ones give nine tenths of the light and are a thousandth of the area: chance seldom meets one."""
    places = [(x, y) for x in (2.5, 4.0, 5.5, 7.0) for y in (-5.0, -3.0, -1.0, 1.0, 3.0, 5.0)]
    small = [glowing_square(0.4, x, y, -58.0) for x, y in places]
    for one in small:
        one["material"] = one["material"] | {"radiance_w_m2_sr": 800.0}
    huge = glowing_square(60.0, -42.0, 0.0, -50.0)
    expected, own = 0.0, 0.0
    for one in [*small, huge]:
        (x, y, z), half = one["position_mm"], 0.5 * one["shape"]["width_mm"]
        own = rectangle_factor(z + 60.0, x - half, x + half, y - half, y + half)
        own *= np.pi * one["material"]["radiance_w_m2_sr"]
        expected += own
    assert own < 0.11 * expected
    given = patch([], [*small, huge])
    found, lone = irradiances(given, 32), powers(by_chance(lf.build(given)), range(32))
    assert stats.sem(found) / found.mean() < 0.5 * stats.sem(lone) / lone.mean()
    assert stats.sem(found) < 0.015 * expected
    assert_means(found[:, None], np.array([expected]), 1e-3)


def test_an_emitter_that_stands_on_the_surface_has_a_finite_variance() -> None:
    """A glowing wall that touches the patch along its edge: 1 / r² is unbounded, the light is not.

    The camera sees the wall as well, which it sees alone where the patch is black.
    """
    wall = sheet((0.1, 8.1), (-60.0, -56.0), 10.0, {"reflectance": 0.0, "radiance_w_m2_sr": 7.0})
    corners = np.array([[[0.1, -5.0, 0.0], [0.1, 5.0, 0.0], [8.1, 5.0, 4.0], [8.1, -5.0, 4.0]]])
    nodes, weights = np.polynomial.legendre.leggauss(24)
    expected = sum(
        0.25 * p * q * irradiance_of(corners, np.array([0.1 * a, 0.1 * b, 0.0]), 7.0)
        for a, p in zip(nodes, weights, strict=True)
        for b, q in zip(nodes, weights, strict=True)
    )
    wide = {"camera.sensor.pixels": (12, 12)}
    given = patch([], [wall]).changed(wide)
    lit, alone, glow = (
        powers(lf.build(one), range(24))
        for one in (
            given, given.changed({"targets[0].material.reflectance": 0.0}), patch([], radiance=1.0).changed(wide)
        )
    )  # fmt: skip
    found = np.pi / REFLECTANCE * (lit - alone) / glow
    assert stats.sem(found) < 8e-3 * expected
    assert_means(found[:, None], np.array([expected]), 2e-3)
    # With an unbounded variance, a few of the images would carry much of it.
    assert np.abs(found - found.mean()).max() < 5.0 * found.std()


@pytest.mark.parametrize("reflectance", instances([0.5, 0.9], long=[0.9]))
def test_a_furnace_that_lights_itself_shows_no_walls(reflectance: float) -> None:
    """Walls that emit L and reflect ρ have the radiance L / (1 − ρ), less what leaves by the hole, see `furnace`."""
    seeds = range(24)
    walls = powers(lf.build(furnace(reflectance, 1.0).changed({"transport.samples": 384})), seeds)
    black = powers(lf.build(furnace(0.0, 1.0).changed({"transport.samples": 384})), seeds)
    ratio = walls / black * (1.0 - reflectance)
    lack = 0.002 * reflectance / (1.0 - reflectance)
    assert stats.sem(ratio) < 1e-3
    assert abs(ratio.mean() - (1.0 - 0.5 * lack)) < 3.0 * stats.sem(ratio) + 0.5 * lack


SEEDS = 24
COMPARISONS = 8


def assert_chance_agrees(given: lf.Scene, closer: float = 1.0) -> None:
    """Compare with scattered packets alone: Welch's t-test; and the errors of the two."""
    world = lf.build(given)
    found, lone = powers(world, range(SEEDS)), powers(by_chance(world), range(SEEDS, 2 * SEEDS))
    assert len(world.tables.objects.emitters.until)
    assert stats.ttest_ind(found, lone, equal_var=False).pvalue > LEVEL / COMPARISONS, (found, lone)
    assert stats.sem(lone) < 0.1 * lone.mean()
    assert stats.sem(found) < closer * stats.sem(lone)


@pytest.mark.parametrize("number", instances(range(5), long=[0, 1, 2, 4]))
def test_scenes_drawn_by_chance_are_lit_as_scattered_packets_find(number: int, folder: Path) -> None:
    """Panels, some of them glowing, glass round the screen, and a lamp."""
    targets, lights = accepted(number, folder)
    assert_chance_agrees(scene(folder, targets, lights, samples=2048, replicates=1, split="both"), 2.0)


def test_an_emitter_behind_glass_is_left_to_scattered_packets(folder: Path) -> None:
    """A sheet that the screen sees straight, and in a mirror: one path of its light is shared, the other is not."""
    glow = sheet((10.0, 10.0), (-40.0, -30.0), 10.0, GLOW)
    assert_chance_agrees(scene(folder, [SCREEN, MIRROR, glow], [], samples=4096, replicates=1), 0.7)


def test_a_textured_emitter_lights_as_scattered_packets_find(folder: Path) -> None:
    """A chart of black and white, near the screen."""
    from lfmesh.assets import asset_path

    chart = {"shape": {"kind": "plane", "width_mm": 16.0, "height_mm": 16.0}, "position_mm": [12.0, 0.0, -52.0],
             "rotation_deg": [0.0, -90.0, 0.0],
             "material": GLOW | {"texture": str(asset_path("charts/chart.png"))}}  # fmt: skip
    assert_chance_agrees(scene(folder, [SCREEN, chart], [], samples=2048, replicates=1), 0.7)


def test_emission_inside_a_room_with_glass_and_many_bounces_counts_once(folder: Path) -> None:
    walls = [sheet((-12.0, -6.0), (-40.0, -55.0), 20.0, GLOW | WHITE), sheet((8.0, 14.0), (-55.0, -45.0), 20.0, WHITE)]
    assert_chance_agrees(scene(folder, [SCREEN, MIRROR, *walls], [], samples=2048, replicates=1), 0.9)
