"""Blocks of pixels that few heavy paths make bright are told from those whose light is well known."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.transport.checks.tails import tails

REPLICATES, SAMPLES = 8, 32


def picture(seed: int, law: str, chance: float = 0.3) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return mean, error and hits of 4 × 4 blocks of 8 × 8 pixels whose hits weigh by a law."""
    random = np.random.default_rng(seed)
    size = REPLICATES, SAMPLES, 32, 32
    weights = {
        "even": lambda: np.ones(size),
        "exponential": lambda: random.exponential(size=size),
        "heavy": lambda: (1.0 - random.random(size)) ** (-1.0 / 0.9),
    }[law]()
    met = random.random(size) < chance
    each = (weights * met).mean(axis=1)
    # A gradient, and an edge through the blocks' middle.
    each *= np.linspace(0.2, 1.0, 32) * np.where(np.arange(32) < 20, 1.0, 0.1)[:, None]
    stderr = each.std(axis=0, ddof=1) / np.sqrt(REPLICATES)
    return each.mean(axis=0)[..., None], stderr[..., None], met.sum(axis=(0, 1))[..., None].astype(np.uint32)


@pytest.mark.parametrize("chance", [0.01, 0.3])
@pytest.mark.parametrize("law", ["even", "exponential"])
def test_light_of_many_paths_has_no_tails(law: str, chance: float) -> None:
    """Over 20 pictures of 16 blocks; with few hits, too few samples are what is wrong."""
    assert not [seed for seed in range(20) if tails(*picture(seed, law, chance)) is not None]


def test_weights_without_a_mean_are_told() -> None:
    """Weights of Pareto's law with an exponent of 0.9: every picture has such blocks."""
    for seed in range(20):
        found = tails(*picture(seed, "heavy"))
        assert found is not None
        assert found.share > 0.1
        assert found.held > 0.1
        assert found.heavier > 5.0


def test_a_bright_point_that_all_samples_meet_is_no_tail() -> None:
    mean, stderr, hits = picture(0, "even")
    mean[5, 5] = 1000.0
    stderr[5, 5] = 1.0
    assert tails(mean, stderr, hits) is None


def test_borders_and_colours_count() -> None:
    mean, stderr, hits = (np.concatenate([each, each], axis=2)[:27, :29] for each in picture(0, "even"))
    assert tails(mean, stderr, hits) is None
    mean[26, 28, 1] = stderr[26, 28, 1] = 100.0
    found = tails(mean, stderr, hits)
    assert found is not None
    assert found.share == 1.0 / 16.0
    assert found.held == pytest.approx(mean[26, 28, 1] / mean[24:, 24:, 1].sum())
