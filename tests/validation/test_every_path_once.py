"""Light that is there only by way of glass, and after or before a matt target: each way to trace it finds all of it.

The camera sees a screen, and nothing shines at it but what glass beside it, or the lens, sends there. So whatever a
method leaves out, or counts twice, is most of the picture.

Every scene has one pixel, and is rendered in REPLICATES replicates each way; means are compared by Welch's t-test.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.transport.parts import parts_of

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

LOW_MIRROR = {"refractor": {"file": "plate.stl", "units": "mm", "index": 1.8}, "position_mm": (16.0, 0.0, -45.0)}
"""Shows the screen, below the wall, what is behind the wall."""
PANE = {"refractor": {"file": "plate.stl", "units": "mm", "index": 1.8}, "position_mm": (8.0, 0.0, -45.0)}
BEHIND_THE_WALL = ((6.0, 6.0), (-45.0, -35.0), 10.0)
DISK_AT_THE_WALL = {
    "kind": "disk", "position_mm": (13.0, 0.0, -33.0), "direction": (-1.0, 0.0, 0.0), "radius_mm": 1.0,
    "power_w": 1.0,
}  # fmt: skip


def point(*position_mm: float) -> dict[str, Any]:
    return {"kind": "point", "position_mm": position_mm, "power_w": 1.0}


ENCLOSED = [SCREEN, WALL, LID]
SCENES: dict[str, tuple[list[dict[str, Any]], list[dict[str, Any]], int]] = {
    # targets, lights, samples of each replicate
    "screen, glass, glowing sheet": ([*ENCLOSED, LOW_MIRROR, sheet(*BEHIND_THE_WALL, GLOW)], [], 4096),
    "screen, glass, sheet that a lamp lights": (
        [*ENCLOSED, LOW_MIRROR, sheet(*BEHIND_THE_WALL, WHITE)], [DISK_AT_THE_WALL], 8192,
    ),
    "screen, pane, point lamp": ([SCREEN, PANE, LID], [point(14.0, 1.0, -45.0)], 2048),
    "screen, pane, disk lamp": (
        [SCREEN, PANE, LID],
        [{"kind": "disk", "position_mm": (14.0, 1.0, -45.0), "direction": (-1.0, 0.0, -1.0), "radius_mm": 2.0,
          "power_w": 1.0}],
        2048,
    ),
    "screen, pane, directional lamp": (
        [SCREEN, PANE, LID], [{"kind": "directional", "direction": (-1.0, 0.1, -0.9), "irradiance_w_m2": 1.0}], 2048,
    ),
    "screen, glass, point lamp": ([*ENCLOSED, LOW_MIRROR], [point(9.0, 1.0, -32.0)], 2048),
    "screen, lens, glowing sheet": ([SCREEN, sheet((5.0, 25.0), (-60.0, -60.0), 20.0, GLOW)], [], 16384),
}  # fmt: skip
COMPARISONS = 40


def scene(folder: Path, targets: list[dict[str, Any]], lights: list[dict[str, Any]], **transport: Any) -> lf.Scene:
    return lf.Scene(
        camera={"focus_mm": 60.0, "lens": LENS, "sensor": {"pixels": (1, 1), "pixel_mm": 2.0}},
        targets=targets,
        lights=lights,
        transport={"replicates": REPLICATES, "threads": 1, **transport},
    ).in_folder(folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("glass")
    trimesh.creation.box((2.0, 30.0, 36.0)).export(folder / "plate.stl")
    return folder


def watts(given: lf.Scene) -> tuple[float, float]:
    """Return a one-pixel image's power and its standard error, W."""
    image = lf.render(given)
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


@pytest.mark.parametrize("name", SCENES)
def test_all_ways_find_the_light_that_comes_by_way_of_glass(name: str, folder: Path) -> None:
    targets, lights, samples = SCENES[name]
    given = scene(folder, targets, lights, samples=samples * REPLICATES)
    found = {way: watts(given.changed(changes)) for way, changes in WAYS.items()}
    assert_same(found)
    for way, (mean, error) in found.items():
        assert mean > 10.0 * error, (way, found)
