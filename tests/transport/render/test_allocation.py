"""The parts of an image get the samples that their variances and costs ask for, and the image keeps its mean.

The z-test's level is stated beside it.
"""

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.packets.packet import COUNTERS, EVENTS
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.render.allocation import LEAST_SAMPLES, Measured, measured, shared
from lfmesh.transport.render.parts import Part, parts_of
from lfmesh.transport.render.render import Renderer

LEVEL = 1e-3


def parts() -> tuple[Part, ...]:
    """Return the parts of a camera with ghosts: image path, other strays, ghosts."""
    return Renderer(lf.build(small("first_light", 8)), check=False).parts


def small(name: str, pixels: int, **transport: object) -> lf.Scene:
    """Return a scene of the assets with few pixels."""
    scene = lf.load(asset_path(f"scenes/{name}.toml"))
    pitch = scene.camera.sensor.pixel_mm * min(scene.camera.sensor.pixels) / pixels
    changes = {"camera.sensor.pixels": [pixels, pixels], "camera.sensor.pixel_mm": pitch}
    return scene.changed(changes | {f"transport.{name}": value for name, value in transport.items()})


def given(path: Measured, own: Measured, samples: int = LEAST_SAMPLES) -> list[int]:
    """Return by how much each part is thinned, from what is measured of the image path and of every other part."""
    every = parts()
    found = shared(every, 1, samples, 1, lambda part, count, each: path if part is every[0] else own)
    return [part.thinned for part in found]


@pytest.mark.parametrize("fewer", [1, 2, 4, 8])
@pytest.mark.parametrize("cost", [1.0, 3.0])
def test_samples_go_as_the_root_of_variance_over_cost(fewer: int, cost: float) -> None:
    """n ∝ √(V / c) has the smallest Σ V / n of a given Σ n c (Lagrange)."""
    path, own = Measured(5.0, 100.0), Measured(5.0 * cost / fewer**2, 100.0 * cost)
    assert given(path, own) == [1, fewer, fewer]


def test_a_part_never_gets_fewer_samples_than_it_would_without_measuring() -> None:
    usual = [part.thinned for part in parts()]
    assert given(Measured(1.0, 1.0), Measured(1e-12, 1.0)) == usual
    assert given(Measured(1.0, 1.0), Measured(0.0, 1.0)) == usual
    # Nor more, where nothing is known of the image path.
    assert given(Measured(0.0, 1.0), Measured(1.0, 1.0)) == usual
    assert given(Measured(1.0, 1.0), Measured(1e6, 1.0)) == [1, 1, 1]


def test_of_small_images_nothing_is_measured() -> None:
    assert given(Measured(1.0, 1.0), Measured(1e6, 1.0), LEAST_SAMPLES - 1) == [part.thinned for part in parts()]


def test_the_variance_of_a_sample_is_that_of_its_distribution() -> None:
    """Of exponential weights, whose variance is 1, within the error that is taken off it."""
    draw, part, counts = np.random.default_rng(1), parts()[0], np.zeros(COUNTERS, np.int64)
    pixels, samples = 20_000, 4
    counts[EVENTS] = 10 * 2 * pixels * samples
    found = measured(part, draw.exponential(size=(2, pixels, samples)).mean(axis=2), samples, counts, 0)
    # Σ (a - b)² / 2 over the pixels has a relative error of some √(5 / pixels), and as much is taken off.
    assert found.variance == pytest.approx(1.0, abs=6.0 * np.sqrt(5.0 / pixels))
    assert found.cost == pytest.approx(150.0)


def test_one_heavy_path_decides_nothing() -> None:
    sets = np.zeros((2, 500))
    sets[0, 7] = 1e6
    assert measured(parts()[0], sets, 2, np.zeros(COUNTERS, np.int64), 0).variance == 0.0


def test_a_sensor_that_reflects_gets_more_ghosts_and_the_same_image() -> None:
    """Of the whole light, by Welch's t-test over the replicates."""
    scene = small("cover_glass", 64, samples=128, replicates=16)
    world = lf.build(scene)
    measuring = Renderer(world, check=False)
    usual = Renderer(world.reseeded(5), check=False)
    usual.parts = parts_of(world)
    more = {part.options.paths: part.thinned for part in measuring.parts}
    assert more[GHOSTS] < {part.options.paths: part.thinned for part in usual.parts}[GHOSTS]
    one, other = measuring.image(), usual.image()
    variances = [float(np.square(image.stderr).sum()) for image in (one, other)]
    z = (one.mean.sum() - other.mean.sum()) / np.sqrt(sum(variances))
    assert abs(z) < stats.norm.isf(0.5 * LEVEL)
    assert variances[0] < variances[1]


def test_shares_do_not_depend_on_threads() -> None:
    scene = small("cover_glass", 64, samples=64)
    one, three = (Renderer(lf.build(scene.changed({"transport.threads": n}))).parts for n in (1, 3))
    assert [part.thinned for part in one] == [part.thinned for part in three]
