"""Ray aiming: maps whose inverses are known in closed form, and rays that do not land."""

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.ray_aiming import ARRIVED, CORRECTIONS, MOST_STEPS, MOST_STRIDES, TOLERANCE, aim_rays, continue_rays

Array = NDArray[np.float64]
Which = NDArray[np.int64]


def distorted(start: Array, _: Which) -> Array:
    """A lens of focal length 50 with 30 % of barrel distortion, on an axis that is aside and turned."""
    turned = (start - 0.01) @ np.array([[0.8, -0.6], [0.6, 0.8]])
    r2 = np.square(turned).sum(axis=1, keepdims=True)
    return 50.0 * turned * (1.0 - 3.0 * r2)


def fan(count: int = 500, reach: float = 0.25) -> Array:
    return np.random.default_rng(4).uniform(-reach, reach, (count, 2)) / np.sqrt(2.0) + 0.01


def test_rays_land_where_they_are_aimed_from_a_first_order_guess() -> None:
    truth = fan()
    targets = distorted(truth, np.arange(len(truth)))
    guess = targets / 50.0
    aimed = aim_rays(distorted, targets, guess, np.broadcast_to(50.0 * np.eye(2), (len(truth), 2, 2)), 50.0)
    assert aimed.arrived.all()
    assert aimed.miss.max() <= TOLERANCE * 50.0
    np.testing.assert_allclose(aimed.miss, np.hypot(*(distorted(aimed.start, None) - targets).T), atol=1e-14)
    np.testing.assert_allclose(aimed.start, truth, atol=1e-11)


def test_few_rays_are_traced_and_none_that_has_arrived() -> None:
    """Three rays each for the derivative by differences, then some five."""
    truth, traced = fan(reach=0.15), np.zeros(500, np.int64)

    def counted(start: Array, which: Which) -> Array:
        np.add.at(traced, which, 1)
        return distorted(start, which)

    targets = distorted(truth, np.arange(500))
    guess = targets / 50.0
    aimed = aim_rays(counted, targets, guess, 1e-6, 50.0)
    assert aimed.arrived.all()
    assert traced.max() <= 12
    assert traced.mean() < 9.0
    exact = aim_rays(counted, targets, truth, 1e-6, 50.0)
    np.testing.assert_array_equal(exact.start, truth)


def test_a_step_into_the_dark_is_taken_back() -> None:
    """Beyond a radius no ray lands, and Newton's first step leads there."""

    def vignetted(start: Array, _: Which) -> Array:
        r = np.hypot(*start.T)[:, None]
        return np.where(r < 1.0, start / np.sqrt(1.2 - np.minimum(r, 1.0) ** 2), np.nan)

    direction = np.column_stack([np.cos(np.arange(60.0)), np.sin(np.arange(60.0))])
    truth = 0.95 * direction
    targets = vignetted(truth, np.arange(60))
    guess = 0.3 * direction
    aimed = aim_rays(vignetted, targets, guess, 1e-6, 1.0)
    assert aimed.arrived.all()
    np.testing.assert_allclose(aimed.start, truth, atol=1e-8)


def test_a_target_out_of_reach_gives_the_nearest_ray_that_was_found() -> None:
    def saturated(start: Array, _: Which) -> Array:
        return start / np.sqrt(1.0 + np.square(start).sum(axis=1, keepdims=True))

    targets = np.array([[0.5, 0.0], [1.5, 0.0]])
    aimed = aim_rays(saturated, targets, targets, np.broadcast_to(np.eye(2), (2, 2, 2)), 1.0)
    assert aimed.arrived.tolist() == [True, False]
    assert 0.5 <= aimed.miss[1] < np.hypot(*(saturated(targets[1:], None) - targets[1:])[0])
    assert np.isfinite(aimed.start).all()


def test_a_ray_whose_guess_does_not_land_is_nan_and_leaves_the_others_alone() -> None:
    def half_dark(start: Array, _: Which) -> Array:
        return np.where(start[:, :1] > 0.0, 2.0 * start, np.nan)

    guess = np.array([[1.0, 0.0], [-1.0, 0.0]])
    aimed = aim_rays(half_dark, np.array([[1.0, 1.0], [1.0, 1.0]]), guess, np.broadcast_to(np.eye(2), (2, 2, 2)), 1.0)
    assert aimed.arrived.tolist() == [True, False]
    np.testing.assert_allclose(aimed.start[0], [0.5, 0.5], atol=1e-12)
    assert np.isnan(aimed.start[1]).all()
    assert np.isnan(aimed.miss[1])


def test_over_facets_the_search_ends_at_the_nearest_step() -> None:
    """A stepped map, as facets make: nothing lands on the target, and the search must end."""
    calls = 0

    def stepped(start: Array, _: Which) -> Array:
        nonlocal calls
        calls += 1
        return np.round(start, 3)

    targets = np.full((1, 2), 0.12345)
    aimed = aim_rays(stepped, targets, np.zeros((1, 2)), np.eye(2)[None], 1.0)
    assert not aimed.arrived[0]
    assert ARRIVED < aimed.miss[0] < 1e-3
    assert calls <= MOST_STEPS + 1


@pytest.mark.parametrize("count", [0, 1])
def test_empty_and_single_searches_work(count: int) -> None:
    targets = np.ones((count, 2))
    aimed = aim_rays(lambda start, _: 2.0 * start, targets, targets, np.tile(np.eye(2), (count, 1, 1)), 1.0)
    np.testing.assert_allclose(aimed.start, 0.5 * targets, atol=1e-12)


def test_a_way_on_which_strides_stay_short_ends() -> None:
    """Newton's method contracts only over strides of a ripple's length: some ten thousand on this way."""
    calls = []

    def miss(start: Array, share: Array, _: Which) -> Array:
        calls.append(len(start))
        return start + 0.7e-3 * np.sin(1e3 * start) - 10.0 * share[:, None]

    found = continue_rays(miss, np.zeros((1, 2)), 1e-7, 1.0)
    assert not found.arrived[0]
    assert len(calls) <= 1 + MOST_STRIDES * (CORRECTIONS + 2)
