"""Adaptive sampling: unbiased, its error bars honest, its effort where the noise is, and none where all is dark."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import LfmeshError
from lfmesh.files import words
from lfmesh.transport.render import adaptive
from lfmesh.transport.render.render import Renderer
from tests.cameras import close_up_camera
from tests.renders import by_seed

Array = NDArray[np.float64]

LEVEL = 1e-3
"""Chance that a statistical test fails though the law holds; shared by its comparisons (Bonferroni)."""

RUNS = 72

SCENE: dict[str, Any] = {
    "camera": close_up_camera(20, 16),
    "targets": [{"shape": {"kind": "plane", "width_mm": 2.0, "height_mm": 6.0}, "position_mm": [0.5, 0, -60.0],
                 "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1e3}}],
    "transport": {"split": "transmit", "samples": 8, "replicates": 4, "threads": 1, "target_error": 0.1,
                  "max_samples": 256},
}  # fmt: skip
"""A bright strip that fills a part of the view: pixels at its border are noisy, those beside it dark."""


def scene(**transport: Any) -> lf.Scene:
    return lf.Scene(**SCENE | {"transport": SCENE["transport"] | transport})


def runs(first: int = 0) -> tuple[Array, Array]:
    """Return mean and stderr of RUNS adaptive renders, (RUNS, H, W)."""
    images = list(by_seed(scene(), range(first, first + RUNS)))
    return np.array([i.mean[..., 0] for i in images]), np.array([i.stderr[..., 0] for i in images])


@pytest.fixture(scope="module")
def adaptive_runs() -> tuple[Array, Array]:
    return runs()


@pytest.fixture(scope="module")
def truth() -> tuple[Array, Array]:
    """Return a long render without adaptive sampling, and its standard error."""
    image = lf.render(scene(samples=1 << 12, replicates=16, target_error=None, seed=10**6))
    return image.mean[..., 0], image.stderr[..., 0]


def p_of_bias(means: Array, truth: tuple[Array, Array]) -> float:
    """Return the p-value, times the number of comparisons, that rows of pixels have the mean of the truth.

    A row of pixels together is nearly normal; rows are compared by a z-test.
    """
    rows = means.sum(axis=2)
    lit = truth[0].sum(axis=1) > 0.0
    spread = rows.var(axis=0, ddof=1) / len(rows) + (truth[1] ** 2).sum(axis=1)
    z = (rows.mean(axis=0) - truth[0].sum(axis=1))[lit] / np.sqrt(spread[lit])
    total = rows.sum(axis=1)
    own = total.var(ddof=1) / len(total) + (truth[1] ** 2).sum()
    p = [*(2.0 * stats.norm.sf(np.abs(z))), 2.0 * stats.norm.sf(abs(total.mean() - truth[0].sum()) / np.sqrt(own))]
    return float(min(p)) * len(p)


def test_the_mean_is_that_of_a_long_render(adaptive_runs: tuple[Array, Array], truth: tuple[Array, Array]) -> None:
    assert p_of_bias(adaptive_runs[0], truth) > LEVEL


def test_the_comparison_sees_weights_from_the_pixels_own_noise(
    truth: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both stages weighted by the inverse of the variances that they themselves show: dimmer, and found out."""

    def naive(mean: Array, variance: Array, second_mean: Array, second_variance: Array, *_: Any) -> None:
        ours, theirs = 1.0 / np.maximum(variance, 1e-300), 1.0 / np.maximum(second_variance, 1e-300)
        mean[:] = (ours * mean + theirs * second_mean) / (ours + theirs)

    monkeypatch.setattr("lfmesh.transport.render.render.combine", naive)
    assert p_of_bias(runs()[0], truth) < LEVEL


def test_the_stated_error_is_the_scatter(adaptive_runs: tuple[Array, Array]) -> None:
    """Pixel by pixel, variance over the runs minus the mean squared stderr, in its units: a t-test over the pixels."""
    means, stderr = adaptive_runs
    claimed, found = (stderr**2).mean(axis=0), means.var(axis=0, ddof=1)
    bright = means.mean(axis=0) > 0.25 * means.mean()
    excess = (found[bright] - claimed[bright]) / claimed[bright]
    # An error bar that is 10 % off makes an excess of 20 %, which would be seen.
    assert stats.sem(excess) < 0.04
    assert stats.ttest_1samp(excess, 0.0).pvalue > LEVEL


def test_a_pixels_own_first_stage_does_not_decide_its_second() -> None:
    """Whatever stands in a pixel, its own level stays, and those of its neighbours change."""
    draw = np.random.default_rng(3)
    small = scene()
    mean, variance = draw.uniform(1.0, 2.0, (16, 20, 1)), draw.uniform(0.01, 0.02, (16, 20, 1))
    before, _ = adaptive.second_stage(mean, variance, small)
    for row, column in ((7, 9), (0, 0), (15, 19)):
        other_mean, other_variance = mean.copy(), variance.copy()
        other_mean[row, column], other_variance[row, column] = 1.9, 40.0
        after, _ = adaptive.second_stage(other_mean, other_variance, small)
        assert after[row, column] == before[row, column]
        assert (after != before).any()


def small_target(**transport: Any) -> lf.Scene:
    """A conventional camera whose view is dark but for a small bright square in its middle."""
    square = SCENE["targets"][0] | {"shape": {"kind": "plane", "width_mm": 3.0, "height_mm": 3.0}}
    sensor = {"pixels": [40, 40], "pixel_mm": 0.1}
    return scene(**transport).changed(
        {"camera.mla": None, "camera.sensor": sensor, "camera.sensor.distance_mm": None, "targets": [square]}
    )


def test_noisy_pixels_get_the_samples_and_dark_ones_none() -> None:
    first = lf.render(small_target(samples=64, replicates=8, target_error=None))
    levels, _ = adaptive.second_stage(first.mean, first.stderr**2, small_target(samples=64, replicates=8))
    lit = first.mean[..., 0] > 0.0
    reached = np.zeros_like(lit)
    for row, column in (*adaptive.RING, (0, 0)):
        reached |= np.roll(lit, (row, column), (0, 1))
    assert lit.mean() < 0.5
    assert (levels[~reached] == 0).all()
    noise = np.divide(first.stderr, first.mean, out=np.zeros_like(first.mean), where=first.mean > 0.0)[..., 0]
    assert levels[noise > 0.2].mean() > levels[lit & (noise < 0.05)].mean() + 1.0


def test_the_wished_error_is_reached_with_fewer_samples_than_alike_everywhere() -> None:
    """Four in five lit pixels are known as wished; as many samples spread evenly leave more of them above it."""
    image = lf.render(small_target(samples=32, target_error=0.02, max_samples=1 << 14))
    assert image.refinement is not None
    alike = lf.render(small_target(samples=4 * round(image.samples / 4), target_error=None))
    lit = image.mean > 0.05 * np.percentile(image.mean[image.mean > 0.0], 99.0)
    above, evenly = ((i.stderr[lit] / i.mean[lit] > 0.02).mean() for i in (image, alike))
    assert above <= 0.2
    assert above < 0.5 * evenly


def test_no_pixel_gets_more_than_the_cap() -> None:
    image = lf.render(scene(target_error=1e-4, max_samples=100))
    assert image.refinement is not None
    assert 8 < image.samples <= 100
    assert image.refinement.capped_share > 0.5
    spent = image.ledger.packets / (20 * 16)
    assert spent == pytest.approx(image.samples)


def test_threads_and_chunks_change_nothing() -> None:
    one, two = (Renderer(lf.build(scene(threads=threads)), chunk=500).image() for threads in (1, 2))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.stderr, two.stderr)
    assert one.refinement == two.refinement
    np.testing.assert_array_equal(one.hits, two.hits)
    large = lf.render(scene())
    np.testing.assert_allclose(one.mean, large.mean, rtol=1e-12, atol=1e-15 * large.mean.max())


@pytest.mark.parametrize("finished", [1, 2, 3])
def test_ctrl_c_in_the_second_stage_keeps_what_is_finished(finished: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """One replicate of the second stage cannot tell its error and is left out; more are averaged in."""
    monkeypatch.setattr("lfmesh.transport.render.render.PROGRESS_SECONDS", 0.0)

    def interrupt(progress: lf.Progress) -> None:
        if progress.stage == "refining" and progress.replicate == finished:
            raise KeyboardInterrupt

    image = lf.render(scene(), interrupt)
    first = lf.render(scene(target_error=None))
    assert not image.complete
    assert image.refinement is not None
    assert image.refinement.replicates == (finished if finished > 1 else 0)
    assert np.isfinite(image.stderr).all()
    same = (image.mean == first.mean).all()
    assert same == (finished == 1)
    # Samples of the second stage count with the light that they brought, and not before.
    assert image.hits is not None
    assert first.hits is not None
    assert (image.hits >= first.hits).all()
    assert (image.hits == first.hits).all() == (finished == 1)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"method": "forward"}, "target_error"),
        ({"target_error": 1.0}, "target_error"),
        ({"target_error": 0.0}, "target_error"),
        ({"replicates": 1}, "replicates"),
        ({"max_samples": 4}, "max_samples"),
    ],
)
def test_what_cannot_be_refined_is_refused(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(LfmeshError, match=field):
        scene(**changes)


def test_a_run_folder_keeps_what_was_reached(tmp_path: Path) -> None:
    image = lf.render(scene())
    lf.save(image, tmp_path / "run")
    again = lf.open_run(tmp_path / "run")
    assert again.refinement == image.refinement
    assert again.complete
    said = " ".join(words.summary(image))
    assert f"{image.samples:.3g} per pixel on average" in said
    assert "standard error of 10 %" in said


def test_the_command_line_takes_the_target(tmp_path: Path) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(scene(target_error=None).dump_toml(), encoding="utf-8")
    assert main(["render", str(file), "-o", str(tmp_path / "run"), "--target-error", "0.2", "--max-samples", "64"]) == 0
    refinement = lf.open_run(tmp_path / "run").refinement
    assert refinement is not None
    assert (refinement.target_error, refinement.max_samples) == (0.2, 64)
