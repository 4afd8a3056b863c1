"""Groups of replicates: with bands more replicates of the same samples add no noise, and the error stays right."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lfmesh as lf
from lfmesh.transport.render.groups import GROUPS, Groups
from lfmesh.transport.render.render import Renderer
from lfmesh.transport.render.tally import Film, Mean
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.sources.wavelengths import ALONE
from tests.cameras import camera_without_array
from tests.renders import by_seed, unchecked

REPLICATES = [1, 2, 7, 8, 9, 16, 24, 61, 64]

SLOPING = {"wavelengths_nm": [300.0, 900.0], "values": [0.2, 0.9]}
PLANE = {"shape": {"kind": "plane", "width_mm": 9.0, "height_mm": 9.0}, "position_mm": [0.0, 0.0, -60.0],
         "material": {"reflectance": SLOPING}}  # fmt: skip
LAMP = {"kind": "point", "position_mm": [20.0, -15.0, -25.0], "power_w": 1.0}


def scene(**transport: Any) -> lf.Scene:
    camera = camera_without_array(60.0, 6, 0.3)
    camera["sensor"]["bands"] = "xyz"
    settings = {"samples": 48, "split": "transmit", "threads": 1} | transport
    return lf.Scene(camera=camera, targets=[PLANE], lights=[LAMP], transport=settings)


@pytest.mark.parametrize("method", ["adjoint", "forward"])
def test_more_replicates_of_the_same_samples_are_the_same_picture_of_bands(method: str) -> None:
    """With 16 and 48 replicates the light, the errors and the bounds of 8 are found again, to rounding."""
    few = unchecked(scene(method=method, replicates=8))
    for replicates in (16, 48):
        many = unchecked(scene(method=method, replicates=replicates))
        assert (many.replicates, many.groups) == (replicates, few.groups)
        np.testing.assert_array_equal(many.hits, few.hits)
        np.testing.assert_allclose(many.mean, few.mean, rtol=1e-12)
        np.testing.assert_allclose(many.stderr, few.stderr, rtol=1e-9)
        np.testing.assert_allclose(many.upper, few.upper, rtol=1e-9)


def test_without_bands_every_replicate_is_independent() -> None:
    one = scene(replicates=24).changed({"camera.sensor.bands": None})
    groups = Groups.of(one)
    assert not groups.joined
    assert [groups.place(replicate) for replicate in range(48)] == [(replicate, ALONE) for replicate in range(48)]


@pytest.mark.parametrize("replicates", REPLICATES)
def test_every_sample_of_a_group_is_taken_once(replicates: int) -> None:
    groups = Groups.of(scene(replicates=replicates))
    assert groups.count == min(replicates, GROUPS)
    assert {groups.place(replicate) for replicate in range(min(replicates, GROUPS))} == {
        (replicate, groups.place(replicate)[1]) for replicate in range(min(replicates, GROUPS))
    }
    for stage in range(2):
        taken: dict[int, list[int]] = {}
        for replicate in range(stage * replicates, (stage + 1) * replicates):
            first, turn = groups.place(replicate)
            taken.setdefault(first, []).extend(range(turn.first, 60 * turn.step, turn.step))
        assert len(taken) == groups.count
        for samples in taken.values():
            assert sorted(samples) == list(range(len(samples)))


def test_a_render_that_stops_early_has_samples_all_over_the_band() -> None:
    """The replicates of a group that are traced first lie apart: no two of the first half follow each other."""
    groups = Groups.of(scene(replicates=64))
    half = sorted(groups.place(replicate)[1].first for replicate in range(0, 32, GROUPS))
    assert half == [0, 2, 4, 6]


@pytest.mark.parametrize("replicates", [2, 9, 11, 16, 61])
def test_the_variance_of_groups_has_no_bias_where_replicates_are_independent(replicates: int) -> None:
    """Of normal numbers with a variance of one; a z-test at 1e-3, also of groups that differ in size."""
    rng = np.random.default_rng(replicates)
    mean = Mean.empty((50, 80, 1), min(replicates, GROUPS))
    for _ in range(replicates):
        mean.add(Film(rng.normal(7.0, 1.0, (4000, 1)), np.zeros((4000, 1), np.uint32)))
    found = mean.variance() * replicates
    z = (found.mean() - 1.0) / (found.std(ddof=1) / np.sqrt(found.size))
    assert abs(z) < stats.norm.isf(5e-4)


def test_a_single_group_has_no_error() -> None:
    mean = Mean.empty((1, 2, 1), GROUPS)
    mean.add(Film(np.ones((2, 1)), np.ones((2, 1), np.uint32)))
    assert np.isnan(mean.variance()).all()


def test_replicates_that_a_study_compares_are_independent() -> None:
    world = lf.build(scene(replicates=16))
    assert Tracer(world, check=False, independent=True).groups.place(8) == (8, ALONE)
    assert Renderer(world, check=False).groups.place(8)[0] == 0


SEEDS = 60
HONEST = 0.8, 1.3
"""True over reported error."""


@pytest.mark.long
@pytest.mark.parametrize("adaptive", [False, True])
@pytest.mark.parametrize("replicates", [2, 8, 16, 64])
def test_the_error_of_pixels_blocks_and_totals_of_bands_is_the_scatter_over_seeds(
    replicates: int, adaptive: bool
) -> None:
    """No ratio of variances is beyond the bounds by more than χ² of as many seeds allows, at 1e-3 in all."""
    settings: dict[str, Any] = {"samples": 64, "replicates": replicates}
    if adaptive:
        settings |= {"target_error": 0.01, "max_samples": 256}
    images = list(by_seed(scene(**settings), range(SEEDS)))
    light, square = (np.array([getattr(image, name) for image in images]) for name in ("mean", "stderr"))
    for side in (1, 3, 6):
        blocks = -1, 6 // side, side, 6 // side, side, 3
        true = light.reshape(blocks).sum(axis=(2, 4)).var(axis=0, ddof=1)
        reported = (square**2).reshape(blocks).sum(axis=(2, 4)).mean(axis=0)
        ratio = true.sum(axis=(0, 1)) / reported.sum(axis=(0, 1))
        low, high = stats.chi2.ppf([5e-4 / 9.0, 1.0 - 5e-4 / 9.0], SEEDS - 1) / (SEEDS - 1)
        assert (ratio > HONEST[0] ** 2 * low).all()
        assert (ratio < HONEST[1] ** 2 * high).all()
