"""Shares of the orders of blazed profiles."""

import math

import numpy as np
import pytest

from lfmesh.optics.blaze import blaze_share


@pytest.mark.parametrize("levels", [0, 2, 3, 4, 8, 16])
@pytest.mark.parametrize("alpha", [0.0, 0.37, 1.0, 1.3, 2.0, -0.8])
def test_the_shares_of_a_blaze_sum_to_one(alpha: float, levels: int) -> None:
    """Beyond order M, the share is at most 1/(π (|m| − |α|))² (continuous), or 1/(π m)² times N² (levels)."""
    most = 200
    total = sum(blaze_share(alpha, order, levels) for order in range(-most, most + 1))
    tail = 2.0 * (max(levels, 1) / math.pi) ** 2 / (most - abs(alpha))
    assert 1.0 - tail <= total <= 1.0 + 1e-12


@pytest.mark.parametrize("order", [-3, 1, 2, 7])
def test_at_the_design_wavelength_a_continuous_blaze_sends_all_light_into_its_order(order: int) -> None:
    assert blaze_share(float(order), order, 0) == 1.0
    assert all(blaze_share(float(order), other, 0) < 1e-30 for other in range(-10, 11) if other != order)


@pytest.mark.parametrize(("levels", "share"), [(2, 0.405285), (4, 0.810569), (8, 0.949641), (16, 0.987215)])
def test_steps_have_the_published_efficiencies(levels: int, share: float) -> None:
    """sinc²(1/N): 40.5, 81.1, 95.0 and 98.7 per cent (Swanson 1989)."""
    assert blaze_share(1.0, 1, levels) == pytest.approx(share, abs=1e-6)


@pytest.mark.parametrize("levels", [2, 3, 5, 8])
def test_steps_have_the_shares_of_their_fourier_series(levels: int) -> None:
    """The squared Fourier coefficients of the staircase, by a sum over its steps."""
    steps = np.arange(levels)
    for alpha in (0.0, 0.6, 1.0, 2.5):
        for order in range(-6, 7):
            edges = np.exp(-2j * np.pi * order * np.arange(levels + 1) / levels)
            pieces = np.full(levels, 1.0 / levels) if order == 0 else 1j * np.diff(edges) / (2.0 * np.pi * order)
            wanted = abs(np.sum(np.exp(2j * np.pi * alpha * steps / levels) * pieces)) ** 2
            assert blaze_share(alpha, order, levels) == pytest.approx(wanted, abs=1e-14)


def test_many_levels_approach_the_continuous_blaze() -> None:
    for alpha in (0.3, 0.9, 1.6):
        for order in (-1, 0, 1, 2):
            assert blaze_share(alpha, order, 10_000) == pytest.approx(blaze_share(alpha, order, 0), abs=1e-6)
