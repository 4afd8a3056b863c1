"""Samples that are not aimed agree with the image, at the stated level, and tell when light is missing."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.transport.checks.blind_check import LEVEL, BlindCheck, BlindSamples, first_of_runs
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.tables.tables import AimTables

RUNS = 1000


def synthetic(seed: int, missing: float = 0.0) -> BlindCheck:
    """Compare a picture that lacks a share of its light with few heavy samples of the whole of it."""
    random = np.random.default_rng(seed)
    truth = np.add.outer(np.linspace(0.2, 2.0, 40), np.linspace(0.0, 1.0, 60))[..., None]
    samples = BlindSamples(40, 60, 1)
    pixels = random.integers(0, truth.size, 60_000)
    chance = 0.02
    weights = random.gamma(2.0, 0.5, len(pixels)) * (random.random(len(pixels)) < chance) / chance
    samples.add(pixels, 0, truth.reshape(-1)[pixels] * weights)
    return samples.compared((1.0 - missing) * truth, np.zeros_like(truth))


def test_a_picture_that_is_right_is_seldom_called_wrong() -> None:
    """Not more often than the level says, by a binomial test at 1e-3; hits are few and their weights uneven."""
    wrong = sum(not synthetic(seed).agrees for seed in range(RUNS))
    assert stats.binomtest(wrong, RUNS, 2.0 * LEVEL, alternative="greater").pvalue > 1e-3


def test_the_smallest_deficit_that_is_stated_is_found_in_half_of_the_blocks() -> None:
    """So a picture that lacks as much everywhere is called wrong."""
    check = synthetic(1)
    assert check.blocks == (3, 3)
    assert check.smallest_deficit is not None
    found = [synthetic(seed, missing=check.smallest_deficit) for seed in range(200)]
    assert np.mean([not one.agrees and one.worst > 0.0 for one in found]) > 0.9


@pytest.mark.parametrize("variance", [0.0, 0.01, np.nan])
def test_nothing_found_says_nothing(variance: float) -> None:
    samples = BlindSamples(10, 10, 1)
    samples.add(np.arange(100), 0, np.zeros(100))
    check = samples.compared(np.ones((10, 10, 1)), np.full((10, 10, 1), variance))
    assert check.hits == 0
    assert check.agrees
    assert check.smallest_deficit is None


def test_an_image_that_is_noisy_itself_is_not_called_wrong() -> None:
    """Its own error counts: here ten times that of the samples which are not aimed; binomial test at 1e-3."""
    wrong = 0
    for seed in range(200):
        random = np.random.default_rng(seed)
        samples = BlindSamples(20, 20, 1)
        pixels = random.integers(0, 400, 40_000)
        samples.add(pixels, 0, 50.0 * (random.random(len(pixels)) < 0.02))
        noise = 4.0
        mean = 1.0 + noise * random.standard_normal((20, 20, 1))
        wrong += not samples.compared(mean, np.full((20, 20, 1), noise**2)).agrees
    assert stats.binomtest(wrong, 200, 2.0 * LEVEL, alternative="greater").pvalue > 1e-3


def test_runs_of_pixels_lie_on_the_sensor_and_all_over_it() -> None:
    for count, at_once in ((409_600, 1024), (100, 100), (7, 7), (1000, 30)):
        firsts = [first for replicate in range(64) for first in first_of_runs(count, at_once, replicate)]
        assert min(firsts) >= 0
        assert max(firsts) + at_once <= count
        if count > 50 * at_once:
            assert np.histogram(firsts, 8, (0, count))[0].min() > 0


SMALL = {
    "camera.sensor.pixels": [160, 160],
    "camera.mla.count": [16, 16],
    "transport.samples": 64,
    "transport.replicates": 2,
    "transport.threads": 1,
    "lights": [],
    "targets": [{"shape": {"kind": "plane", "width_mm": 200.0, "height_mm": 200.0}, "position_mm": [0, 0, -500.0],
                 "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}],
}  # fmt: skip


def half_a_pupil(aim: AimTables) -> AimTables:
    """Views of half the size, and nothing that makes up for it."""
    disks = aim.entrance.opening.far
    return aim._replace(
        lenslets=aim.lenslets._replace(
            slope_radius2=np.where(aim.lenslets.slope_radius2 > 0.0, 0.25 * aim.lenslets.slope_radius2, -1.0)
        ),
        entrance=aim.entrance._replace(
            opening=aim.entrance.opening._replace(far=disks._replace(radius=0.5 * disks.radius)),
            wide_share=0.0,
            share_without_aim=0.0,
        ),
        exit=aim.exit._replace(wide_share=0.0, share_without_aim=0.0),
    )


FORWARD = {"camera.mla": None, "camera.sensor.distance_mm": None, "camera.sensor.pixels": [40, 40],
           "camera.sensor.pixel_mm": 0.05, "transport.method": "forward", "transport.samples": 640}  # fmt: skip


@pytest.mark.parametrize("changes", [{"transport.split": "transmit"}, FORWARD])
def test_a_run_whose_aim_misses_most_of_the_light_says_so(changes: dict[str, Any]) -> None:
    scene = lf.load(asset_path("scenes/first_light.toml")).changed(SMALL | changes)
    image = Renderer(lf.build(scene)).image()
    assert image.blind is not None
    assert image.blind.agrees
    assert image.blind.smallest_deficit is not None
    world = lf.build(scene)
    world.aim = half_a_pupil(world.aim)
    wrong = Renderer(world).image()
    assert wrong.mean.sum() < 0.5 * image.mean.sum()
    assert wrong.blind is not None
    assert not wrong.blind.agrees
    assert wrong.blind.worst > 0.0
