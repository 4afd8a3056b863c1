"""What is known of a pixel: errors pooled with like neighbours, and bounds that hold as often as they say."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.errors import LfmeshError
from lfmesh.transport.render import certainty
from lfmesh.transport.render.certainty import Estimate

AROUND = np.array([(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)])

LEVEL = 1e-3

Array = NDArray[Any]


def replicated(truth: Array, samples: int, replicates: int, chance: float | Array, seed: int = 0) -> tuple[Array, ...]:
    """Return mean, standard error and hits of pixels of which a sample brings truth / chance, with that chance."""
    rng = np.random.default_rng(seed)
    hits = rng.binomial(samples // replicates, chance, (replicates, *truth.shape))
    each = truth / chance * hits / (samples // replicates)
    stderr = each.std(axis=0, ddof=1) / np.sqrt(replicates) if replicates > 1 else np.full(truth.shape, np.nan)
    return each.mean(axis=0), stderr, hits.sum(axis=0).astype(np.uint32)


def test_the_error_is_half_a_pixels_own_and_half_that_of_neighbours_as_bright_and_as_steep() -> None:
    mean = np.ones((3, 6, 1))
    stderr = np.zeros((3, 6, 1))
    mean[:, 3:] = 1.6
    stderr[1, 1], stderr[0, 0] = 3.0, 1.0
    # Along the border between bright and dark, on either side.
    stderr[1, 2], stderr[1, 3] = 100.0, 50.0
    known = Estimate(mean, stderr, np.full(mean.shape, 100, np.uint32), 100)
    error, pooled = certainty.pooled_error(known, AROUND)
    # The pixel and the five around it that do not touch the border.
    assert pooled[1, 1, 0] == 6
    assert error[1, 1, 0] == pytest.approx(np.sqrt(0.5 * (9.0 + 10.0 / 6.0)))
    assert error[2, 0, 0] == pytest.approx(np.sqrt(0.5 * 9.0 / 4.0))
    # On the border: the pixel and the two above and below it.
    assert pooled[1, 2, 0] == 3
    assert error[1, 2, 0] == pytest.approx(100.0 * np.sqrt(0.5 * (1.0 + 1.0 / 3.0)))
    rows, _ = certainty.pooled_error(known, AROUND, slice(1, 3))
    np.testing.assert_array_equal(rows, error[1:])


def test_the_error_holds_the_truth_where_a_pixel_has_two_hits_on_average() -> None:
    """One in seven has none, as have some of its neighbours: as dark as it, they would say that nothing was missed."""
    lit = np.repeat([1.0, 1 / 8], 40)[:, None] * np.ones((60, 1, 1))
    chance = lit / 32
    mean, stderr, hits = replicated(lit, 512, 8, chance)
    error, _ = certainty.pooled_error(Estimate(mean, stderr, hits, 512), AROUND)
    for dim in (slice(0, 40), slice(40, 80)):
        off, known = (mean - lit)[:, dim], error[:, dim]
        within = abs(off) <= stats.t.ppf(0.975, 7) * known
        assert stats.binomtest(int(within.sum()), within.size, 0.92, "less").pvalue > LEVEL, within.mean()
        assert (known**2).mean() == pytest.approx((off**2).mean(), rel=0.1)


def test_steps_go_to_the_same_place_in_the_next_micro_images() -> None:
    scene = lf.load("assets/scenes/first_light.toml")
    pitch = lf.first_order(scene).micro_image_pitch_px
    steps = {tuple(step) for step in certainty.neighbours(scene).tolist()}
    assert pitch is not None
    assert steps == {tuple(step) for step in AROUND.tolist()} | {
        (0, round(pitch)), (0, -round(pitch)), (round(pitch), 0), (-round(pitch), 0),
    }  # fmt: skip
    assert len(certainty.neighbours(lf.load("assets/scenes/conventional.toml"))) == 8


@pytest.mark.parametrize("replicates", [2, 4])
def test_the_pooled_error_is_the_scatter_in_every_quarter_of_itself(replicates: int) -> None:
    """Where a sample in twenty brings nothing, 16 samples leave 44 % of the pixels without any spread of their own."""
    truth = np.ones((100, 100, 1))
    mean, stderr, hits = replicated(truth, 16, replicates, 0.95)
    error, _ = certainty.pooled_error(Estimate(mean, stderr, hits, 16), AROUND)
    own, pooled = [], []
    for claimed, ratios in ((stderr, own), (error, pooled)):
        quarter = np.digitize(claimed, np.quantile(claimed, [0.25, 0.5, 0.75]))
        for k in range(4):
            here = quarter == k
            if here.any():
                ratios.append(np.sqrt((claimed[here] ** 2).mean() / ((mean - truth)[here] ** 2).mean()))
    assert min(own) < 0.3
    assert min(pooled) > 0.4
    assert max(pooled) < 2.5
    # And on the whole: the spread of 10⁴ pixels' variances is 5 % at most.
    assert (error**2).mean() == pytest.approx(((mean - truth) ** 2).mean(), rel=0.1)


@pytest.mark.parametrize("replicates", [2, 3, 8])
@pytest.mark.parametrize("pooled", [1, 2, 9, 13])
def test_the_median_of_pooled_errors_is_corrected(replicates: int, pooled: int) -> None:
    rng = np.random.default_rng(5)
    each = rng.chisquare(replicates - 1, (200_000, pooled)) / (replicates - 1)
    typical = np.median(np.sqrt(0.5 * (each[:, 0] + each.mean(axis=1))))
    factor = certainty.typical_over_rms(np.array([pooled]), replicates)[0]
    assert factor == pytest.approx(typical, rel=0.03)
    assert factor < 0.98


@pytest.mark.parametrize("chance", [0.001, 0.01, 0.05, 0.2, 0.9])
@pytest.mark.parametrize("replicates", [1, 4])
def test_the_upper_bound_holds_in_95_of_100_pixels(chance: float, replicates: int) -> None:
    """A binomial test that it holds in no less; one beside brighter pixels, whose samples bring half as much again."""
    truth = np.ones((60, 100, 1)) * chance
    mean, stderr, hits = replicated(truth, 64, replicates, chance)
    mean[0], stderr[0], hits[0] = 1.5, 0.01, 64
    bound = certainty.upper_bound([Estimate(mean, stderr, hits, 64)], [stderr], AROUND, replicates)[1:]
    below = int((bound < truth[1:]).sum())
    if replicates > 1 and chance > 0.5:
        # Student's quantile of a binomial: its skewness leaves a little more outside.
        assert below / bound.size < 0.08
    else:
        assert stats.binomtest(below, bound.size, 0.05, "greater").pvalue > LEVEL
    # A bound worth having: within the chance limits of five hits more.
    assert np.median(bound) < chance + 8.0 / 64


def test_without_a_hit_the_bound_is_the_rule_of_three_times_what_the_brightest_pixel_brings() -> None:
    mean, stderr, hits = np.zeros((2, 3, 2)), np.zeros((2, 3, 2)), np.zeros((2, 3, 2), np.uint32)
    mean[0, 0], hits[0, 0] = (8.0, 2.0), (50, 100)
    bound = certainty.upper_bound([Estimate(mean, stderr, hits, 100)], [stderr], AROUND, 4)
    chance = 1.0 - 0.05 ** (1.0 / 100)
    np.testing.assert_allclose(bound[1], np.tile([16.0 * chance, 2.0 * chance], (3, 1)), rtol=1e-12)


def of_parts(scene: lf.Scene, replicates: int, *parts: Estimate) -> certainty.Certainty:
    return certainty.Certainty.of(parts, scene, replicates)


def test_rare_light_is_bounded_beside_light_that_every_sample_finds() -> None:
    """One of 40 samples brings a fifth of the light; hits of both parts together would leave every fifth pixel out."""
    scene = lf.load("assets/scenes/conventional.toml")
    common, rare = np.full((60, 100, 1), 0.8), np.full((60, 100, 1), 0.2)
    one, other = replicated(common, 64, 4, 0.95), replicated(rare, 64, 4, 1 / 40, seed=1)
    truth = common + rare
    by_part = of_parts(scene, 4, *(Estimate(*each, 64) for each in (one, other))).upper
    both = Estimate(one[0] + other[0], np.hypot(one[1], other[1]), one[2] + other[2], 128)
    together = certainty.upper_bound([both], [both.stderr], AROUND, 4)
    assert (together < truth).mean() > 0.15
    assert stats.binomtest(int((by_part < truth).sum()), truth.size, 0.05, "greater").pvalue > LEVEL


def test_the_error_of_rare_light_is_right_on_average_and_not_zero_where_it_was_missed() -> None:
    """One sample in 200 brings a tenth of the light: of 64 samples three pixels in four miss it."""
    scene = lf.load("assets/scenes/conventional.toml")
    common, rare = np.full((60, 100, 1), 0.9), np.full((60, 100, 1), 0.1)
    one, other = replicated(common, 64, 8, 0.95), replicated(rare, 64, 8, 1 / 200, seed=1)
    error = of_parts(scene, 8, *(Estimate(*each, 64) for each in (one, other))).error
    off = one[0] + other[0] - 1.0
    missed = other[2] == 0
    for here in (missed, ~missed):
        assert np.sqrt((error[here] ** 2).mean() / (off[here] ** 2).mean()) == pytest.approx(1.0, abs=0.35)
    # Of 6000 pixels with a relative variance of 3 the mean square is known to 2 %.
    assert (error**2).mean() == pytest.approx((off**2).mean(), rel=0.1)
    within = abs(off) < stats.t.ppf(0.975, 7) * error
    assert within.mean() > 0.92
    own = np.hypot(one[1], other[1])
    assert (abs(off) < stats.t.ppf(0.975, 7) * own)[missed].mean() < within[missed].mean() - 0.1


def test_errors_of_parts_add_by_their_squares() -> None:
    scene = lf.load("assets/scenes/conventional.toml")
    one, other = (replicated(np.full((8, 8, 1), level), 640, 8, 0.5, seed=seed) for level, seed in ((1.0, 0), (0.3, 1)))
    parts = [Estimate(*each, 640) for each in (one, other)]
    alone = [certainty.pooled_error(part, AROUND)[0] for part in parts]
    np.testing.assert_allclose(of_parts(scene, 8, *parts).error, np.hypot(*alone), rtol=1e-12)
    np.testing.assert_allclose(of_parts(scene, 8, parts[0]).error, alone[0], rtol=1e-12)
    margins = [of_parts(scene, 8, part).upper - part.mean for part in parts]
    upper = parts[0].mean + parts[1].mean + np.hypot(*margins)
    np.testing.assert_allclose(of_parts(scene, 8, *parts).upper, upper, rtol=1e-12)


def test_an_image_says_its_error_and_its_bound() -> None:
    scene = lf.load("assets/scenes/first_light.toml").changed({"camera.sensor.pixels": (6, 4)})
    mean = np.zeros((4, 6, 1))
    image = lf.Image(mean, mean.copy(), scene, lf.Ledger(), 1.0, 8, 32.0, "by hand")
    assert image.error.shape == mean.shape
    with pytest.raises(LfmeshError, match="image without hits"):
        _ = image.upper
    image.hits = np.zeros(mean.shape, np.uint32)
    image.hits[1, 1], image.mean[1, 1] = 32, 1.0
    assert image.upper[0, 0, 0] == pytest.approx(1.0 - 0.05 ** (1.0 / 32))


def test_the_weight_around_a_pixel_is_that_of_the_heaviest_paths_but_for_a_single_pixel() -> None:
    mean, error = np.full((3, 5, 1), 8.0), np.full((3, 5, 1), 2.0)
    weight = certainty.weight_around(mean, error, AROUND)
    np.testing.assert_array_equal(weight, 0.5)
    # Of one path that brings all the light, known no better than that; around it, one pixel is none.
    mean[1, 1], error[1, 1] = 100.0, 200.0
    np.testing.assert_array_equal(certainty.weight_around(mean, error, AROUND), weight)
    mean[0, 1], error[0, 1] = 60.0, 60.0
    np.testing.assert_array_equal(certainty.weight_around(mean, error, AROUND)[:, 0, 0], [60.0, 60.0, 0.5])
    np.testing.assert_array_equal(certainty.weight_around(mean, error, AROUND, slice(1, 2))[0, :, 0],
                                  [60.0, 0.5, 60.0, 0.5, 0.5])  # fmt: skip
    assert not certainty.weight_around(mean, np.full_like(mean, np.nan), AROUND).any()


def test_the_upper_bound_holds_heavy_light_that_a_pixel_missed_among_many_light_paths() -> None:
    """Beside bright columns every tenth pixel of a dim one meets a path that brings a hundred times its other light."""
    scene = lf.load("assets/scenes/conventional.toml")
    light = replicated(np.full((600, 3, 1), 1e-3), 64, 8, 0.5)
    heavy_truth = np.tile(np.array([0.4, 0.4, 0.01])[:, None], (600, 1, 1))
    heavy = replicated(heavy_truth, 64, 8, heavy_truth / 6.4, seed=1)
    both = Estimate(light[0] + heavy[0], np.hypot(light[1], heavy[1]), light[2] + heavy[2], 64)
    below = of_parts(scene, 8, both).upper < 1e-3 + heavy_truth
    assert stats.binomtest(int(below[:, 2].sum()), 600, 0.05, "greater").pvalue > LEVEL
    # Where all paths are alike nothing is added to Student's quantile.
    alike = replicated(np.full((60, 100, 1), 1.0), 64, 8, 0.5)
    part = Estimate(*alike, 64)
    error = of_parts(scene, 8, part).error
    np.testing.assert_allclose(of_parts(scene, 8, part).upper, part.mean + stats.t.ppf(0.95, 7) * error, rtol=1e-9)
