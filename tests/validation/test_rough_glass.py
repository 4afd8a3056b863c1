"""Rough glass: what each method shows of it is the same, nothing is lost in it, and its limits are those known.

Every scene has one pixel, and is rendered in REPLICATES replicates each way; means are compared by Welch's t-test.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from tests.cameras import biconvex
from tests.instances import instances
from tests.renders import unchecked

LEVEL = 1e-3
"""Chance that this file fails though all is right; shared by its COMPARISONS (Bonferroni)."""
COMPARISONS = 40

REPLICATES = 32
GLOW = {"reflectance": 0.0, "radiance_w_m2_sr": 1000.0}
WHITE = {"reflectance": 0.9}
DIFFUSE, FINE, COARSE = "diffuse", {"kind": "ground", "roughness": 0.3}, {"kind": "ground", "roughness": 1.0}
WAYS: dict[str, dict[str, Any]] = {
    "in parts": {},
    "mesh engine": {"transport.engine": "mesh"},
    "forward": {"transport.method": "forward"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("glass")
    trimesh.creation.box((10.0, 10.0, 3.0)).export(folder / "block.stl")
    trimesh.creation.box((30.0, 30.0, 2.0)).export(folder / "pane.stl")
    trimesh.creation.icosphere(2, 4.0).export(folder / "ball.stl")
    return folder


def glass(file: str, z_mm: float, finish: Any = "polished", index: float = 1.6, tilt_deg: float = 15.0) -> Any:
    refractor = {"file": file, "units": "mm", "index": index, "finish": finish}
    return {"refractor": refractor, "position_mm": (0.0, 0.0, z_mm), "rotation_deg": (0.0, tilt_deg, 0.0)}


def sheet(z_mm: float, width_mm: float, material: dict[str, Any]) -> dict[str, Any]:
    shape = {"kind": "plane", "width_mm": width_mm, "height_mm": width_mm}
    return {"shape": shape, "position_mm": (1.0, 0.0, z_mm), "material": material}


def point(*position_mm: float) -> dict[str, Any]:
    return {"kind": "point", "position_mm": position_mm, "power_w": 1.0}


DISK = {
    "kind": "disk", "position_mm": (6.0, 0.0, -75.0), "direction": (-0.3, 0.0, 1.0), "radius_mm": 3.0, "power_w": 1.0,
}  # fmt: skip
SUN = {"kind": "directional", "direction": (-0.2, 0.1, 1.0), "irradiance_w_m2": 100.0}
BLOCK = "block.stl"
SCENES: dict[str, tuple[list[Any], list[Any], int, int]] = {
    # targets, lights, samples of each replicate: adjoint, forward
    "diffuse block before a glow": ([glass(BLOCK, -50.0, DIFFUSE), sheet(-60.0, 8.0, GLOW)], [], 8192, 65536),
    "ground block before a glow": ([glass(BLOCK, -50.0, FINE), sheet(-60.0, 8.0, GLOW)], [], 2048, 65536),
    "diffuse block before a point lamp": ([glass(BLOCK, -50.0, DIFFUSE)], [point(3.0, 1.0, -70.0)], 2048, 65536),
    "ground block before a disk lamp": ([glass(BLOCK, -50.0, COARSE)], [DISK], 2048, 65536),
    "ground ball in the sun": ([glass("ball.stl", -50.0, FINE)], [SUN], 2048, 65536),
    "ground block lit from the front, before a screen": (
        [glass(BLOCK, -50.0, FINE), sheet(-60.0, 20.0, WHITE)], [point(12.0, 3.0, -30.0)], 8192, 262144,
    ),
    # A straight line to the lamp is blocked by smooth glass: that light is traced from the lamp.
    "diffuse block behind a polished pane": (
        [glass(BLOCK, -50.0, DIFFUSE), glass("pane.stl", -60.0)], [point(3.0, 1.0, -70.0)], 131072, 262144,
    ),
}  # fmt: skip


def scene(folder: Path, targets: list[Any], lights: list[Any], **transport: Any) -> lf.Scene:
    return lf.Scene(
        camera={"focus_mm": 60.0, "lens": biconvex(), "sensor": {"pixels": (1, 1), "pixel_mm": 3.0}},
        targets=targets,
        lights=lights,
        transport={"replicates": REPLICATES, "threads": 1, "split": "both", **transport},
    ).in_folder(folder)


def watts(given: lf.Scene) -> tuple[float, float]:
    """Return a one-pixel image's power and its standard error, W."""
    image = unchecked(given)
    assert abs(image.ledger.imbalance) < 1e-12
    return float(image.mean[0, 0, 0]), float(image.stderr[0, 0, 0])


def p_value(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Return how likely two means of REPLICATES replicates differ as much, Welch."""
    squares = np.array([one[1] ** 2, other[1] ** 2])
    freedom = squares.sum() ** 2 / (squares**2).sum() * (REPLICATES - 1)
    return float(2.0 * stats.t.sf(abs(one[0] - other[0]) / np.sqrt(squares.sum()), freedom))


LONG = [
    "diffuse block before a glow", "ground block before a glow", "diffuse block before a point lamp",
    "ground block before a disk lamp",
]  # fmt: skip
"""The suite has rough glass that the sun shines through, that is lit from its front, and that polished glass hides."""


@pytest.mark.parametrize("name", instances(SCENES, long=LONG))
def test_each_way_finds_all_light(name: str, folder: Path) -> None:
    targets, lights, adjoint, forward = SCENES[name]
    found = {}
    for way, changes in WAYS.items():
        samples = forward if way == "forward" else adjoint
        found[way] = watts(scene(folder, targets, lights, samples=samples).changed(changes))
    for way in ("mesh engine", "forward"):
        assert found[way][1] < 0.05 * found[way][0]
        assert p_value(found["in parts"], found[way]) > LEVEL / COMPARISONS, (way, found)


def furnace(folder: Path, body: list[Any]) -> lf.Scene:
    """A camera in a cube of walls that glow alike, at a body in its midst."""

    def wall(position_mm: tuple[float, ...], rotation_deg: tuple[float, ...]) -> dict[str, Any]:
        shape = {"kind": "plane", "width_mm": 400.0, "height_mm": 400.0}
        return {"shape": shape, "position_mm": position_mm, "rotation_deg": rotation_deg, "material": GLOW}

    sides = [((0, 0, -350), (0, 0, 0)), ((0, 0, 50), (0, 0, 0)), ((-200, 0, -150), (0, 90, 0)),
             ((200, 0, -150), (0, 90, 0)), ((0, -200, -150), (90, 0, 0)), ((0, 200, -150), (90, 0, 0))]  # fmt: skip
    given = scene(
        folder,
        [*(wall(*side) for side in sides), *body],
        [],
        samples=64,
        replicates=2,
        max_events=1000,
        split="transmit",
    )
    return given.changed({"camera.sensor.pixels": (3, 3), "camera.sensor.pixel_mm": 0.5})


@cache
def empty_furnace(folder: Path) -> lf.Image:
    return unchecked(furnace(folder, []))


@pytest.mark.parametrize("file", ["block.stl", "ball.stl"])
@pytest.mark.parametrize("index", instances([1.0, 1.01, 1.5, 4.0], long=[1.01]))
@pytest.mark.parametrize(
    "finish", [DIFFUSE, *({"kind": "ground", "roughness": r} for r in (1e-3, 0.1, 0.5, 1.0))], ids=str
)
def test_a_furnace_shows_no_rough_glass(folder: Path, finish: Any, index: float, file: str) -> None:
    """Each path ends on a wall in air with all its weight, but for what meets the camera's housing.

    So pixels agree to rounding with those of the empty furnace, or lack paths from the camera to its housing, which is
    seen from the body under some 1e-2 of all directions.
    """
    body = glass(file, -50.0, finish, index)
    image, empty = unchecked(furnace(folder, [body])), empty_furnace(folder)
    assert abs(image.ledger.imbalance) < 1e-12
    assert sum(image.ledger.lost.values()) == 0.0
    reached, all_of_it = image.ledger.reached_target, empty.ledger.reached_target
    # What reached the walls brought their radiance, which 1 / n² would have made less in glass.
    assert image.mean.sum() / empty.mean.sum() == pytest.approx(reached / all_of_it, rel=1e-9)
    assert 0.95 < reached / all_of_it < 1.0 + 1e-9


def test_a_path_that_leaves_glass_beside_an_edge_meets_a_facet(folder: Path) -> None:
    """With these random numbers one ray starts along a facet, so that its query begins beyond the next one.

    It would reach a wall as if in glass, and bring 1 / n² of its light.
    """
    body = glass("ball.stl", -50.0, DIFFUSE, 1.5)
    image, empty = (lf.render(furnace(folder, each).changed({"transport.seed": 4})) for each in ([body], []))
    expected = image.ledger.reached_target / empty.ledger.reached_target
    assert image.mean.sum() / empty.mean.sum() == pytest.approx(expected, rel=1e-9)


def test_fine_ground_glass_looks_polished(folder: Path) -> None:
    """To 3 sigma at a roughness that is traced as such; to the last bit below the one that counts as polished."""
    images = {}
    for roughness in (0.0, 0.99e-4, 2e-4):
        finish = {"kind": "ground", "roughness": roughness}
        targets = [glass(BLOCK, -50.0, finish, tilt_deg=25.0), sheet(-60.0, 3.0, GLOW)]
        images[roughness] = lf.render(scene(folder, targets, [], samples=4096))
    polished = lf.render(scene(folder, [glass(BLOCK, -50.0, tilt_deg=25.0), sheet(-60.0, 3.0, GLOW)], [], samples=4096))
    for roughness in (0.0, 0.99e-4):
        np.testing.assert_array_equal(images[roughness].mean, polished.mean)
    one, other = ((float(i.mean[0, 0, 0]), float(i.stderr[0, 0, 0])) for i in (images[2e-4], polished))
    assert other[1] < 0.02 * other[0]
    assert abs(one[0] - other[0]) < 3.0 * np.hypot(one[1], other[1])


def test_traced_rays_scatter_by_their_seed(folder: Path) -> None:
    world = lf.build(scene(folder, [glass(BLOCK, -50.0, FINE, tilt_deg=0.0), sheet(-60.0, 60.0, GLOW)], []))
    origins, directions = np.tile([0.0, 0.0, -30.0], (500, 1)), np.tile([0.0, 0.0, -1.0], (500, 1))
    paths, again = (lf.trace(world, origins, directions, record=True) for _ in range(2))
    np.testing.assert_array_equal(paths.direction, again.direction)
    assert len(np.unique(paths.direction[:, 0])) == len(paths.direction)
    on_sheet = paths.status == lf.Status.TARGET
    assert on_sheet.sum() > 300
    assert (paths.weight[on_sheet] == 1.0).all()
