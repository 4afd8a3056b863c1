"""Light that the forward method aims at the lens through glass: it shows what the adjoint method shows, or refuses."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

import lfmesh as lf
from lfmesh.transport.aims.mixture import aimed, aimed_density
from lfmesh.transport.aims.through_glass import cell_at, place_in_bundle
from lfmesh.transport.render.glass_aim import glass_aim
from lfmesh.transport.render.parts import parts_of
from tests.instances import instances
from tests.renders import by_seed

LEVEL = 1e-3
"""Of all comparisons of a test together, after Bonferroni."""

CAMERA = {
    "focus_mm": 60.0,
    "lens": {
        "surfaces": [
            {"radius_mm": 0.8, "thickness_mm": 0.08, "index": 1.5, "semi_diameter_mm": 0.08},
            {"radius_mm": -0.8, "semi_diameter_mm": 0.08, "stop": True},
        ]
    },
    "sensor": {"pixels": [4, 4], "pixel_mm": 0.03},
}
LAMP = {"kind": "point", "position_mm": [45.0, 0.0, -45.0], "power_w": 1.0}
WALL = {
    "shape": {"kind": "plane", "width_mm": 16.0, "height_mm": 16.0},
    "position_mm": [0.0, 0.0, -80.0],
    "material": {"reflectance": 0.8},
}


def glass(*size_mm: float, at: float = -50.0, turned: tuple[float, ...] = (0.0, 0.0, 0.0)) -> dict[str, Any]:
    return {
        "refractor": {"box_mm": list(size_mm), "index": 1.5},
        "position_mm": [0.0, 0.0, at],
        "rotation_deg": list(turned),
    }


def scene(*targets: dict[str, Any], **parts: Any) -> lf.Scene:
    settings = {"samples": 128, "replicates": 16} | parts.pop("transport", {})
    return lf.Scene(**{"camera": CAMERA, "targets": targets, "lights": [LAMP], "transport": settings} | parts)  # type: ignore[arg-type]


def sums(given: lf.Scene, seeds: range, **transport: Any) -> Any:
    """Return the whole and the four quarters of images, and the variance of the whole that they state, by seed."""
    changed = given.changed({f"transport.{key}": value for key, value in transport.items()})
    found = []
    for image in by_seed(changed, seeds):
        quarters = image.mean[..., 0].reshape(2, 2, 2, 2).sum(axis=(1, 3)).ravel()
        found.append([quarters.sum(), *quarters, np.nansum(image.stderr**2)])
    return np.array(found)


def assert_methods_agree(given: lf.Scene, seeds: int, forward: int, adjoint: int, sigma: float) -> None:
    """Compare the methods by the scatter of their sums over seeds, which must tell differences of a few `sigma`."""
    one = sums(given, range(seeds), method="forward", samples=forward)[:, :-1]
    other = sums(given, range(100, 100 + seeds), method="adjoint", samples=adjoint)[:, :-1]
    error = np.hypot(one.std(axis=0, ddof=1), other.std(axis=0, ddof=1)) / np.sqrt(seeds)
    assert error[0] < sigma * other[:, 0].mean()
    p = stats.ttest_ind(one, other, equal_var=False).pvalue
    assert p.min() > LEVEL / len(p), one.mean(axis=0) / other.mean(axis=0)


@pytest.mark.parametrize("thick_mm", instances([2.0, 20.0], long=[2.0]))
def test_a_wall_behind_a_plate_is_as_bright_as_in_the_adjoint_method(thick_mm: float) -> None:
    assert_methods_agree(scene(WALL, glass(20.0, 20.0, thick_mm)), seeds=6, forward=4096, adjoint=128, sigma=0.02)


TANK = {
    "size_mm": [30.0, 30.0, 30.0], "wall_mm": 2.0, "wall": {"index": 1.5}, "liquid": {"index": 1.333},
    "position_mm": [0.0, 0.0, -60.0], "rotation_deg": [10.0, 15.0, 0.0],
}  # fmt: skip
DROPPED = {"shape": {"kind": "sphere", "radius_mm": 5.0}, "position_mm": [0.5, 0.2, -62.0],
           "material": {"reflectance": 0.8}}  # fmt: skip
CASES = {
    "tilted plate": (scene(WALL, glass(40.0, 40.0, 10.0, turned=(0.0, 35.0, 0.0))), 16384, 1024, 0.02),
    "edges": (scene(WALL, glass(3.0, 4.0, 20.0, turned=(5.0, 8.0, 0.0))), 32768, 512, 0.02),
    "sphere in a tank": (scene(DROPPED, tanks=[TANK]), 16384, 4096, 0.04),
    "wall behind a tank": (scene(WALL, tanks=[TANK]), 32768, 2048, 0.04),
    "fog in a tank": (
        scene(tanks=[TANK], media=[{"inside": "tanks[0] liquid", "scattering_per_mm": 0.02}]), 4096, 512, 0.03,
    ),
}  # fmt: skip
"""Scenes, samples of a forward and of an adjoint image, and relative error that eight of each have."""


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::lfmesh.MissedLightWarning")
@pytest.mark.parametrize("case", CASES)
def test_methods_agree_behind_plates_edges_and_in_tanks(case: str) -> None:
    given, forward, adjoint, sigma = CASES[case]
    assert_methods_agree(given, 8, forward, adjoint, sigma)


@pytest.mark.long
@pytest.mark.parametrize("near_mm", [-50.0, -66.0])
def test_methods_agree_behind_a_ball(near_mm: float, tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=4, radius=4.0).export(tmp_path / "ball.ply")
    ball = {
        "refractor": {"file": str(tmp_path / "ball.ply"), "units": "mm", "index": 1.5},
        "position_mm": [0.3, 0.2, near_mm],
    }
    assert_methods_agree(scene(WALL, ball), 8, 32768, 512, 0.04)


@pytest.mark.long
@pytest.mark.parametrize("case", ["tilted plate", "edges", "sphere in a tank"])
def test_the_scatter_of_sums_over_seeds_is_the_stated_error(case: str) -> None:
    """Of 60 forward images, whose scatter is known to 9 %, by the chi-squared test."""
    found = sums(CASES[case][0], range(60), method="forward", samples=4096)
    ratio = found[:, 0].var(ddof=1) / found[:, -1].mean()
    freedom = len(found) - 1
    assert stats.chi2.sf(freedom * ratio / 1.25**2, freedom) > LEVEL
    assert stats.chi2.cdf(freedom * ratio / 0.8**2, freedom) > LEVEL


def test_directions_are_drawn_with_the_density_that_weights_them() -> None:
    """Of each bundle of a few cells: one over the density, averaged over its rays, is its size."""
    world = lf.build(scene(WALL, glass(3.0, 4.0, 20.0, turned=(5.0, 8.0, 0.0)), transport={"method": "forward"}))
    aim, _ = glass_aim(world)
    assert aim is not None
    at_lens, draw = world.aim.entrance._replace(glass=aim), np.random.default_rng(4)
    cells, bundles = aim.cells.view(np.recarray), aim.bundles.view(np.recarray)
    compared = 0
    for point in [(0.5, 0.5, -80.0), (-7.0, 0.5, -80.0), (-3.0, 6.0, -80.0)]:
        rays = np.array([aimed(at_lens, point, tuple(draw.random(3))) for _ in range(3000)])
        assert rays[0, 3] == pytest.approx(aimed_density(at_lens, point, tuple(rays[0, :3])), rel=1e-12)
        cell = cells[cell_at(cells, point)]
        for number in range(cell.first, cell.first + min(cell.bundles, 4)):
            place, along = np.array([place_in_bundle(bundles[number], point, tuple(ray[:3])) for ray in rays]).T
            area = np.where(place <= 1.0, 1.0 / (np.maximum(along, 1e-9) ** 3 * rays[:, 3]), 0.0)
            if (place <= 1.0).sum() > 200:
                error = area.std() / np.sqrt(len(area))
                assert abs(area.mean() - 1.0 / bundles[number].density) < 5.0 * error
                compared += 1
    assert compared >= 3


def test_a_scene_without_glass_has_no_aim_through_it() -> None:
    world = lf.build(scene(WALL, transport={"method": "forward"}))
    assert glass_aim(world) == (None, None)
    assert parts_of(world)[0].tables.aim.entrance.glass is None


def test_light_that_comes_in_too_many_ways_is_refused() -> None:
    """Down a light pipe it is reflected at four walls, any number of times in any order."""
    pipe = glass(0.2, 0.22, 50.0, at=-27.0, turned=(0.0, 0.0, 20.0))
    given = scene(WALL, pipe, transport={"method": "forward"})
    with pytest.raises(lf.SceneError, match=r'"forward" cannot aim (more than )?[\d.]+ % of .* use "adjoint"'):
        lf.render(given)


def test_light_that_is_hardly_aimed_at_is_told() -> None:
    given = scene(WALL, glass(3.0, 4.0, 20.0, turned=(5.0, 8.0, 0.0)), transport={"method": "forward", "samples": 1})
    with pytest.warns(lf.MissedLightWarning, match=r'^[\d.]+ % of the light reaches .* method = "adjoint"'):
        lf.render(given)
    with warnings.catch_warnings():
        warnings.simplefilter("error", lf.MissedLightWarning)
        lf.render(scene(WALL, glass(20.0, 20.0, 2.0), transport={"method": "forward", "samples": 1}))


def test_worlds_that_differ_in_their_seed_share_one_aim_through_glass() -> None:
    """Probe rays are traced once for all seeds, whichever world is rendered first."""
    world = lf.build(scene(WALL, glass(20.0, 20.0, 2.0), transport={"method": "forward"}))
    copies = [world.reseeded(seed) for seed in range(2)]
    found, proof = glass_aim(copies[0])
    assert found is not None
    assert proof is not None
    assert glass_aim(copies[1])[0] is found
