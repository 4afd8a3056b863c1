"""A small camera whose parts and rays can be told apart in a picture."""

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.scene import Scene, loads
from lfmesh.view.rays import launch
from lfmesh.view.rays.paths import Rays
from lfmesh.view.scene3d.plotter import View

SIZE = (480, 300)

SCENE = """
schema_version = 1
name = "bench"
[camera]
focus_mm = 200.0
[camera.lens]
surfaces = [
  { radius_mm = 40.0, thickness_mm = 5.0, index = 1.5, semi_diameter_mm = 9.0 },
  { radius_mm = -40.0, thickness_mm = 2.0, semi_diameter_mm = 9.0 },
  { stop = true, thickness_mm = 2.0, semi_diameter_mm = 5.0 },
  { radius_mm = inf, thickness_mm = 3.0, index = 1.7, semi_diameter_mm = 8.0 },
  { radius_mm = -120.0, semi_diameter_mm = 8.0 },
]
[camera.mla]
count = [12, 10]
pitch_mm = 1.0
focal_length_mm = 3.0
index = 1.5
thickness_mm = 1.0
[camera.sensor]
pixels = [120, 100]
pixel_mm = 0.1
[[targets]]
name = "card"
shape = { kind = "box", size_mm = [30.0, 20.0, 2.0] }
position_mm = [0.0, 0.0, -201.0]
[[lights]]
kind = "point"
position_mm = [0.0, -40.0, -120.0]
power_w = 1.0
"""

CONVENTIONAL = SCENE[: SCENE.index("[camera.mla]")] + SCENE[SCENE.index("[camera.sensor]") :]


@pytest.fixture(scope="session")
def scene() -> Scene:
    return loads(SCENE)


@pytest.fixture(scope="session")
def world(scene: Scene) -> lf.World:
    return lf.build(scene)


@pytest.fixture(scope="session")
def conventional() -> lf.World:
    return lf.build(loads(CONVENTIONAL))


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    path = tmp_path / "bench.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture(scope="session")
def split_rays(world: lf.World) -> Rays:
    """Paths with all reflections, which share many segments."""
    return launch.from_field_point(world, [2.0, -8.0, -199.0], 40, split="both", weight_cutoff=1e-3)


@pytest.fixture(scope="session")
def one_ray(world: lf.World) -> Rays:
    """One path to the sensor, off every plane of symmetry, on the side of -x in the lens."""
    rays = launch.from_field_point(world, [2.0, -8.0, -199.0], 12, split="transmit")
    chosen = np.zeros(len(rays), np.bool_)
    into_lens = np.where(rays.arrives, rays.position[rays.offsets[:-1] + 1, 0], np.inf)
    chosen[np.argmin(into_lens)] = True
    return rays.keep(chosen)


@pytest.fixture
def views() -> Iterator[Callable[..., View]]:
    """Make views that are closed after the test."""
    made: list[View] = []

    def make(world: lf.World, picture: np.ndarray | None = None, **options: object) -> View:
        made.append(View(world, picture, size=SIZE, **options))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for view in made:
        view.plotter.close()


def shot(view: View) -> np.ndarray:
    """Return what a view shows as (height, width, 3)."""
    view.plotter.render()
    return np.asarray(view.plotter.screenshot(return_img=True)).astype(int)
