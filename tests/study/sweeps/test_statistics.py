"""Estimates from replicates are right on average, and so are their errors."""

import numpy as np
import pytest
from scipy.stats import binom

from lfmesh.study.sweeps.statistics import (
    Array,
    Numbers,
    chosen,
    combined,
    independent_product,
    inner_products,
    mean_square,
    of_products,
    pseudo_values,
    slope,
)


def test_the_jackknife_of_a_mean_is_the_mean_with_its_standard_error() -> None:
    draws = np.random.default_rng(1).normal(size=12)
    estimate = combined(pseudo_values(lambda use: np.array([draws[use].mean()]), 12)[:, 0])
    assert estimate.value == pytest.approx(draws.mean(), rel=1e-12)
    assert estimate.stderr == pytest.approx(draws.std(ddof=1) / np.sqrt(12), rel=1e-12)


def test_the_error_of_an_estimate_that_is_not_smooth_is_that_of_its_mean() -> None:
    """A mean of values rounded to steps, of 2000 draws: stated over true error 0.8 to 1.25, and no other mean."""
    draw = np.random.default_rng(7)
    found, plain = [], []
    for _ in range(2000):
        values = draw.normal(size=4)

        def rounded(use: Numbers, values: Array = values) -> Array:
            return np.array([np.round(values[use].mean() / 0.4) * 0.4])

        found.append(combined(pseudo_values(rounded, 4)[:, 0]))
        plain.append(float(rounded(np.arange(4))[0]))
    value, stated = np.transpose(found)
    assert value == pytest.approx(plain, abs=1e-12)
    assert 0.8 < np.sqrt((stated**2).mean()) / value.std(ddof=1) < 1.25


def test_noise_does_not_add_to_a_mean_square_over_places() -> None:
    """Displacements of 50 places with noise of twice their size: without bias, by a z-test at 3.3 sigma."""
    draw = np.random.default_rng(8)
    found = [mean_square(0.1 + 0.2 * draw.normal(size=(4, 50, 2))).mean() for _ in range(400)]
    assert abs(np.mean(found) - 0.01) < 3.3 * np.std(found, ddof=1) / np.sqrt(len(found))
    assert mean_square(np.full((1, 50, 2), 0.1)) == pytest.approx([0.01])


def test_noise_does_not_add_to_products_of_independent_images() -> None:
    """The mean square of a picture, from noisy copies: without bias, where the plain one is far off."""
    draw = np.random.default_rng(2)
    truth = np.full(400, 0.1)
    found = []
    for _ in range(200):
        copies = truth + draw.normal(size=(4, 400))
        found.append(independent_product(inner_products(list(copies))))
    error = np.std(found, ddof=1) / np.sqrt(len(found))
    # One z-test at 3.3 sigma, 0.1 %.
    assert abs(np.mean(found) - 0.01) < 3.3 * error
    plain = ((truth + draw.normal(size=(4, 400)).mean(axis=0)) ** 2).mean()
    assert plain > 0.1


def test_a_slope_has_the_interval_that_it_says() -> None:
    """Of 400 lines with noise, 95 % of the intervals hold the true slope (binomial test, 0.1 % to either side)."""
    draw = np.random.default_rng(3)
    x = np.linspace(-1.0, 1.0, 6)
    held = 0
    for _ in range(400):
        fit = slope(x, 2.0 + 3.0 * x + draw.normal(size=6), np.zeros(6))
        assert fit is not None
        held += fit.low <= 3.0 <= fit.high
    assert binom.ppf(0.001, 400, 0.95) <= held <= binom.ppf(0.999, 400, 0.95)


def test_a_slope_needs_three_points_that_differ() -> None:
    ones = np.ones(3)
    assert slope(ones[:2], ones[:2], ones[:2]) is None
    assert slope(ones, np.arange(3.0), ones) is None
    assert slope(np.arange(3.0), np.array([1.0, np.nan, 2.0]), ones) is None


@pytest.mark.parametrize("replicates", [4, 8])
@pytest.mark.parametrize("mean", [0.0, 0.1, 0.5, 5.0])
def test_the_error_of_a_mean_square_holds_whatever_noise_is_in_it(replicates: int, mean: float) -> None:
    """Stated over true error of 1000 draws of 100 noisy values: 0.9 to 1.2, where the jackknife's is up to 1.7."""
    draw = np.random.default_rng(4)
    found = []
    for _ in range(1000):
        products = inner_products(list(mean + draw.normal(size=(replicates, 100))))

        def square(use: Numbers, products: Array = products) -> Array:
            return np.array([independent_product(chosen(products, use))])

        found.append(combined(of_products(square, products)[:, 0]))
    value, stated = np.transpose(found)
    ratio = np.sqrt((stated**2).mean()) / value.std(ddof=1)
    assert 0.9 < ratio < 1.2
    # One z-test at 3.3 sigma, 0.1 %.
    assert abs(value.mean() - mean**2) < 3.3 * value.std(ddof=1) / np.sqrt(len(value))


@pytest.mark.parametrize("mean", [1.0, 2.0, 5.0])
def test_the_square_of_a_single_value_has_its_error(mean: float) -> None:
    """Stated over true error of 4000 draws of four replicates: 0.93 to 1.12, at 2 to 10 standard errors from none."""
    draw = np.random.default_rng(6)
    found = [combined(mean_square(mean + draw.normal(size=4))) for _ in range(4000)]
    value, stated = np.transpose(found)
    assert 0.93 < np.sqrt((stated**2).mean()) / value.std(ddof=1) < 1.12
    # One z-test at 3.3 sigma, 0.1 %.
    assert abs(value.mean() - mean**2) < 3.3 * value.std(ddof=1) / np.sqrt(len(value))
