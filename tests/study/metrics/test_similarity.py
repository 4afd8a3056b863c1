"""Structural similarity is Wang's."""

import numpy as np
import pytest
from skimage import metrics

from lfmesh.study.metrics.similarity import structural_similarity


def pictures() -> tuple[np.ndarray, np.ndarray]:
    draw = np.random.default_rng(4)
    one = np.hypot(*(np.indices((48, 40)) - 20.0)) / 30.0
    return one, one + 0.1 * draw.normal(size=one.shape)


def test_equal_pictures_have_similarity_one_and_noise_lowers_it() -> None:
    one, noisy = pictures()
    assert structural_similarity(one, one, 1.0) == 1.0
    assert structural_similarity(one, noisy, 1.0) < 0.7


def test_a_change_of_brightness_alone_costs_what_the_formula_says() -> None:
    """Of flat pictures a and b, (2ab + C1)/(a² + b² + C1)."""
    a, b, c1 = 0.8, 0.4, 1e-4
    expected = (2.0 * a * b + c1) / (a * a + b * b + c1)
    found = structural_similarity(np.full((32, 32), a), np.full((32, 32), b), 1.0)
    assert found == pytest.approx(expected, rel=1e-9)


def test_it_agrees_with_scikit_image() -> None:
    one, noisy = pictures()
    expected = metrics.structural_similarity(
        one, noisy, data_range=1.3, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert structural_similarity(one, noisy, 1.3) == pytest.approx(expected, rel=1e-12)
