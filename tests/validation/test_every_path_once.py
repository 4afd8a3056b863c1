"""Light that is there only by way of glass, and after or before a matt target: each way to trace it finds all of it.

The camera sees a screen, and nothing shines at it but what glass beside it, or the lens, sends there. So whatever a
method leaves out, or counts twice, is most of the picture.

Every scene has one pixel, and is rendered in REPLICATES replicates each way; means are compared by Welch's t-test.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.transport.paths.automaton import EVERY
from lfmesh.transport.render.parts import Part, parts_of
from lfmesh.transport.render.render import Renderer
from tests.instances import instances
from tests.renders import unchecked

LEVEL = 1e-3
"""Chance that this file fails though all is right; shared by its comparisons (Bonferroni)."""

REPLICATES = 32
WAYS: dict[str, dict[str, Any]] = {
    "in parts": {},
    "mesh engine": {"transport.engine": "mesh"},
    "forward": {"transport.method": "forward"},
}

LENS = {
    "surfaces": [
        {"radius_mm": 48.0, "thickness_mm": 3.0, "index": 2.2, "semi_diameter_mm": 5.0},
        {"radius_mm": -48.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
        {"stop": True, "semi_diameter_mm": 4.0},
    ]
}
STRONG_LENS = {
    "surfaces": [
        {"radius_mm": 24.0, "thickness_mm": 3.0, "index": 1.6, "semi_diameter_mm": 5.0},
        {"radius_mm": -24.0, "thickness_mm": 1.0, "semi_diameter_mm": 5.0},
        {"stop": True, "semi_diameter_mm": 4.0},
    ]
}
GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}
BLACK = {"reflectance": 0.0}
WHITE = {"reflectance": 0.9}


def sheet(x: tuple[float, float], z: tuple[float, float], width: float, material: dict[str, Any]) -> dict[str, Any]:
    """A sheet along y that goes from one point of the xz plane to another."""
    along = np.array([x[1] - x[0], z[1] - z[0]])
    return {
        "shape": {"kind": "plane", "width_mm": float(np.hypot(*along)), "height_mm": width},
        "position_mm": (0.5 * sum(x), 0.0, 0.5 * sum(z)),
        "rotation_deg": (0.0, float(np.rad2deg(np.arctan2(-along[1], along[0]))), 0.0),
        "material": material,
    }


SCREEN = sheet((-2.5, 2.5), (-60.0, -60.0), 5.0, WHITE)
WALL = sheet((5.9, 5.9), (-52.5, -25.0), 40.0, BLACK)
LID = sheet((5.9, 40.0), (-25.0, -25.0), 60.0, BLACK)
"""They keep what is beside the screen, at larger x, out of its sight and the camera's, but for what lies low."""

MIRROR = {"refractor": {"file": "mirror.stl", "units": "mm", "index": 1.8}, "position_mm": (16.0, 0.0, -45.0)}
"""Shows the screen, below the wall, what is behind the wall."""
SMALL_MIRROR = {"refractor": MIRROR["refractor"] | {"file": "small_mirror.stl"}, "position_mm": (16.0, 0.0, -47.0)}
PANE = {"refractor": {"file": "pane.stl", "units": "mm", "index": 1.8}, "position_mm": (8.0, 0.0, -45.0)}
"""Stands between the screen and the lamps."""
BEHIND_THE_WALL = ((6.0, 6.0), (-45.0, -35.0), 10.0)
DISK_AT_THE_WALL = {
    "kind": "disk", "position_mm": (13.0, 0.0, -33.0), "direction": (-1.0, 0.0, 0.0), "radius_mm": 1.0,
    "power_w": 1.0,
}  # fmt: skip


def point(*position_mm: float) -> dict[str, Any]:
    return {"kind": "point", "position_mm": position_mm, "power_w": 1.0}


ENCLOSED = [SCREEN, WALL, LID]
GLOWING_BEHIND_THE_WALL = sheet(*BEHIND_THE_WALL, GLOW)
SCENES: dict[str, tuple[list[dict[str, Any]], list[dict[str, Any]], int, int]] = {
    # targets, lights, samples of each replicate: adjoint, forward
    "screen, glass, glowing sheet": ([*ENCLOSED, MIRROR, GLOWING_BEHIND_THE_WALL], [], 2048, 16384),
    "screen, glass, sheet that a lamp lights": (
        [*ENCLOSED, MIRROR, sheet(*BEHIND_THE_WALL, WHITE)], [DISK_AT_THE_WALL], 3072, 98304,
    ),
    "screen, pane, point lamp": ([SCREEN, PANE, LID], [point(14.0, 1.0, -45.0)], 4096, 4096),
    "screen, pane, disk lamp": (
        [SCREEN, PANE, LID],
        [{"kind": "disk", "position_mm": (14.0, 1.0, -45.0), "direction": (-1.0, 0.0, -1.0), "radius_mm": 2.0,
          "power_w": 1.0}],
        4096,
        4096,
    ),
    "screen, pane, directional lamp": (
        [SCREEN, PANE, LID],
        [{"kind": "directional", "direction": (-1.0, 0.1, -0.9), "irradiance_w_m2": 1.0}],
        4096,
        16384,
    ),
    "screen, glass, point lamp": ([*ENCLOSED, SMALL_MIRROR], [point(9.0, 1.0, -42.0)], 4096, 32768),
}  # fmt: skip
COMPARISONS = 60


def scene(
    folder: Path, targets: list[dict[str, Any]], lights: list[dict[str, Any]],
    focus_mm: float = 60.0, lens: dict[str, Any] = LENS, pixel_mm: float = 2.0, **transport: Any,
) -> lf.Scene:  # fmt: skip
    return lf.Scene(
        camera={"focus_mm": focus_mm, "lens": lens, "sensor": {"pixels": (1, 1), "pixel_mm": pixel_mm}},
        targets=targets,
        lights=lights,
        transport={"replicates": REPLICATES, "threads": 1, **transport},
    ).in_folder(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("glass")
    trimesh.creation.box((2.0, 30.0, 36.0)).export(folder / "pane.stl")
    trimesh.creation.box((5.0, 5.0, 5.0)).export(folder / "cube.stl")
    trimesh.creation.icosphere(2, 3.0).export(folder / "ball.stl")
    trimesh.creation.box((40.0, 40.0, 2.0)).export(folder / "window.stl")
    trimesh.creation.box((2.0, 16.0, 20.0)).export(folder / "mirror.stl")
    trimesh.creation.box((2.0, 6.0, 6.0)).export(folder / "small_mirror.stl")
    return folder


def watts(given: lf.Scene) -> tuple[float, float]:
    """Return a one-pixel image's power and its standard error, W."""
    image = unchecked(given)
    return float(image.mean[0, 0, 0]), float(image.stderr[0, 0, 0])


def p_value(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return how likely two means of REPLICATES replicates differ as much, Welch."""
    squares = np.array([one[1] ** 2, other[1] ** 2])
    freedom = squares.sum() ** 2 / (squares**2).sum() * (REPLICATES - 1)
    return float(2.0 * stats.t.sf(abs(one[0] - other[0]) / np.sqrt(squares.sum()), freedom))


def assert_same(found: dict[str, tuple[float, float]]) -> None:
    names = list(found)
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            p = p_value(found[one], found[other])
            assert p > LEVEL / COMPARISONS, (one, other, found, p)


def found_by_all(
    folder: Path, targets: list[Any], lights: list[Any], samples: int, forward: int, **settings: Any
) -> dict[str, tuple[float, float]]:
    """Return what each way finds, with random numbers of its own."""
    given = scene(folder, targets, lights, samples=samples * REPLICATES, **settings)
    found = {}
    for seed, (way, changes) in enumerate(WAYS.items()):
        own = {"transport.seed": seed, **changes}
        if way == "forward":
            own["transport.samples"] = forward * REPLICATES
        found[way] = watts(given.changed(own))
    return found


LONG = [
    "screen, pane, directional lamp", "screen, pane, point lamp", "screen, glass, glowing sheet",
    "screen, glass, point lamp",
]  # fmt: skip
"""The suite has a lamp behind the pane, and a sheet that a lamp lights by way of glass that bends."""


@pytest.mark.parametrize("name", instances(SCENES, long=LONG))
def test_all_ways_find_the_light_that_comes_by_way_of_glass(name: str, folder: Path) -> None:
    found = found_by_all(folder, *SCENES[name])
    assert_same(found)
    for way, (mean, error) in found.items():
        assert mean > 10.0 * error, (way, found)


def test_all_ways_find_the_light_that_the_lens_reflects_onto_the_screen(folder: Path) -> None:
    """From a sheet in the screen's own plane; a black screen leaves only the sheet's ghosts."""
    near = sheet((3.0, 25.0), (-30.0, -30.0), 30.0, GLOW)
    white, black = (sheet((-2.5, 2.5), (-30.0, -30.0), 5.0, material) for material in (WHITE, BLACK))
    camera: dict[str, Any] = {"focus_mm": 30.0, "lens": STRONG_LENS, "pixel_mm": 8.0}
    found = found_by_all(folder, [white, near], [], 16384, 131072, **camera)
    ghosts = watts(scene(folder, [black, near], [], samples=16384 * REPLICATES, seed=9, **camera))
    assert_same(found)
    for way, (mean, error) in found.items():
        assert mean - ghosts[0] > 10.0 * np.hypot(error, ghosts[1]), (way, found, ghosts)


WINDOW = {"refractor": {"file": "window.stl", "units": "mm", "index": 1.5}, "position_mm": (0.0, 0.0, -20.0)}


@pytest.mark.parametrize(
    ("targets", "lights", "samples", "precision"),
    [([SCREEN | {"material": GLOW}], [], 1024, 0.03), ([SCREEN], [point(8.0, 2.0, -12.0)], 8192, 0.15)],
    ids=["glowing", "lit through the window"],
)
def test_targets_behind_a_window_are_found_as_well_as_others(
    targets: list[Any], lights: list[Any], samples: int, precision: float, folder: Path
) -> None:
    """What goes through glass to the lens is aimed at it too: by chance alone one in a thousand would meet it."""
    found = found_by_all(folder, [*targets, WINDOW], lights, samples, samples)
    assert_same(found)
    for way, (mean, error) in found.items():
        assert error < precision * mean, (way, found)


def at_random(number: int) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return targets and lights of a scene drawn by chance: panels that shine or not, and glass, round the screen."""
    draw = np.random.default_rng(number)

    def place() -> dict[str, Any]:
        """Off the axis, so that the camera sees the screen."""
        angle, radius = draw.uniform(0.0, 2.0 * np.pi), draw.uniform(9.0, 13.0)
        position = (radius * np.cos(angle), radius * np.sin(angle), draw.uniform(-55.0, -40.0))
        return {"position_mm": position, "rotation_deg": tuple(draw.uniform(0.0, 360.0, 3))}

    panels = [
        {
            "shape": {"kind": "plane", "width_mm": draw.uniform(4.0, 12.0), "height_mm": draw.uniform(4.0, 12.0)},
            "material": {"reflectance": draw.uniform(0.3, 0.9), "radiance_w_m2_sr": 1000.0 * draw.integers(0, 2)},
            **place(),
        }
        for _ in range(draw.integers(1, 4))
    ]
    glass = [
        {"refractor": {"file": draw.choice(["cube.stl", "ball.stl"]), "units": "mm", "index": draw.uniform(1.4, 2.0)}}
        | place()
        for _ in range(2)
    ]
    way = draw.normal(size=3)
    away = 40.0 * way / np.linalg.norm(way)
    position = (float(away[0]), float(away[1]), float(-50.0 + abs(away[2])))
    lamps = [
        point(*position),
        {"kind": "disk", "position_mm": position, "direction": tuple(-away), "radius_mm": 3.0, "power_w": 1.0},
        {"kind": "directional", "direction": tuple(-away), "irradiance_w_m2": 100.0},
    ]
    return [SCREEN, *panels, *glass], [lamps[draw.integers(0, 3)]]


def accepted(number: int, folder: Path) -> tuple[list[Any], list[Any]]:
    """Return the first of a row of scenes whose glass is apart, and clear of what emits, as the forward method asks."""
    for draw in range(number, 1000, 100):
        targets, lights = at_random(draw)
        try:
            lf.build(scene(folder, targets, lights, method="forward"))
        except lf.LfmeshError:
            continue
        return targets, lights
    raise AssertionError("every scene was refused")


@pytest.mark.parametrize("number", instances(range(4), long=[1, 2, 3]))
def test_all_ways_agree_on_scenes_drawn_by_chance(number: int, folder: Path) -> None:
    found = found_by_all(folder, *accepted(number, folder), 1024, 4096)
    assert_same(found)
    for way, (mean, error) in found.items():
        assert error < 0.15 * mean, (way, found)


# Two lamps, one of them behind the pane, a glowing sheet, and a side wall that throws light to and fro.
MANY_WAYS = [SCREEN, PANE, LID, sheet((-12.0, -6.0), (-40.0, -55.0), 20.0, GLOW | WHITE)]
TWO_LAMPS = [point(14.0, 1.0, -45.0), point(-10.0, 5.0, -30.0) | {"power_w": 2.0}]


@pytest.mark.parametrize("split", instances(["both", "roulette", "transmit"], long=["roulette", "transmit"]))
def test_light_that_comes_in_many_ways_counts_once(split: str, folder: Path) -> None:
    found = found_by_all(folder, MANY_WAYS, TWO_LAMPS, 2048, 16384, split=split)
    assert_same(found)
    for mean, error in found.values():
        assert error < 0.06 * mean


def test_to_count_a_lamps_light_twice_would_be_seen(folder: Path) -> None:
    """Were all light of the lamps traced from them, and not what met glass alone, the scene above would show it."""
    given = scene(folder, MANY_WAYS, TWO_LAMPS, samples=2048 * REPLICATES)
    world = lf.build(given)
    whole = parts_of(world)
    *of_pixels, of_lamps = whole
    assert [part.options.adjoint for part in whole] == [True, True, True, False]
    every = replace(of_lamps, options=of_lamps.options._replace(paths=EVERY))
    right, wrong = watts_of(world, whole), watts_of(world, (*of_pixels, every))
    assert p_value(right, wrong) < LEVEL / COMPARISONS


def watts_of(world: lf.World, parts: tuple[Part, ...]) -> tuple[float, float]:
    """Return the power of some parts of an image, and its standard error."""
    renderer = Renderer(world)
    renderer.parts = parts
    image = renderer.image()
    return float(image.mean[0, 0, 0]), float(image.stderr[0, 0, 0])
