"""Steps by probe rays, and the check of the grid, against exact deflections by a ball."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.optics.index_field_path import deflections, entries, traced
from lfmesh.optics.index_field_steps import (
    COARSEST,
    FINEST,
    PROBES,
    FieldProbe,
    halved,
    probe_rays,
    probed,
    with_steps,
)
from lfmesh.optics.index_fields import LEAPFROG, RUNGE_KUTTA, IndexField, field_table, index_field, indices_at
from tests.optics.closed_fields import ball_deflection

Array = NDArray[np.float64]

WEAK, STRONG = 2e-4, 0.1


@cache
def ball(delta: float, width: float, count: int) -> IndexField:
    """Return a Gaussian ball on a grid of voxels of 1 mm."""
    x2 = (np.arange(count) - 0.5 * (count - 1)) ** 2
    return index_field(1.0 + delta * np.exp(-(x2[:, None, None] + x2[:, None] + x2) / width**2), 1.0)


@cache
def exact(delta: float, width: float) -> tuple[Array, Array]:
    """Return impact parameters and exact deflections."""
    impacts = width * np.linspace(0.15, 1.5, 10)
    return impacts, np.array([ball_deflection(delta, width, impact) for impact in impacts])


def errors(field: IndexField, delta: float, width: float, *, along_z: bool) -> Array:
    """Return the errors of the deflection by a ball, over the largest deflection, in random directions or along z."""
    impacts, truth = exact(delta, width)
    draw = np.random.default_rng(3)
    along = np.tile([0.0, 0.0, 1.0], (len(impacts), 1)) if along_z else draw.normal(size=(len(impacts), 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, draw.normal(size=along.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    table = field_table([field])
    rays = entries(table, 0, impacts[:, None] * across - 20.0 * width * along, along)
    return np.abs(deflections(rays, traced(table, 0, rays)[1]) - truth) / truth.max()


def finely(field: IndexField) -> IndexField:
    return dataclasses.replace(field, scheme=RUNGE_KUTTA, step_cells=0.5)


@pytest.mark.parametrize("delta", [WEAK, STRONG])
def test_the_error_of_the_grid_of_a_ball_of_eight_voxels(delta: float) -> None:
    """By interpolation alone, of n = 1 + δ exp(−r²/w²): of r = w/√2 the standard deviation of a side."""
    field = finely(ball(delta, 8.0, 93))
    within = np.sqrt((errors(field, delta, 8.0, along_z=False) ** 2).mean())
    assert within < 4e-5
    assert errors(field, delta, 8.0, along_z=True).max() < 2.5e-4
    wider = finely(ball(delta, 8.0 * 2.0**0.5, 129))
    assert np.sqrt((errors(wider, delta, 8.0 * 2.0**0.5, along_z=False) ** 2).mean()) < 1.1e-5


def test_the_error_of_the_grid_has_the_third_order_along_an_axis() -> None:
    coarse, fine = (errors(finely(ball(WEAK, w, n)), WEAK, w, along_z=True).max() for w, n in ((6.0, 71), (12.0, 141)))
    assert 2.6 < np.log2(coarse / fine) < 3.6


@pytest.mark.parametrize("delta", [WEAK, STRONG])
@pytest.mark.parametrize(("width", "count"), [(5.0, 61), (8.0, 93)])
def test_steps_add_no_larger_error_than_the_grid_has(delta: float, width: float, count: int) -> None:
    """Against the closed form, with the chosen steps: within the stated errors of grid and integration."""
    field = ball(delta, width, count)
    probe = probed(field)
    assert probe.integration_error <= max(probe.grid_error, FINEST)
    assert probe.trapped == 0
    _, truth = exact(delta, width)
    assert probe.deflection == pytest.approx(truth.max(), rel=0.05)
    stated = probe.grid_error + probe.integration_error
    for along_z in (True, False):
        assert errors(with_steps(field, probe), delta, width, along_z=along_z).max() < 1.05 * stated


def test_weak_fields_take_leapfrog_steps_and_strong_ones_runge_kuttas() -> None:
    weak, strong = probed(ball(WEAK, 8.0, 93)), probed(ball(STRONG, 8.0, 93))
    assert (weak.scheme, weak.step_cells) == (LEAPFROG, 4.0)
    assert (strong.scheme, strong.step_cells) == (RUNGE_KUTTA, 2.0)


def test_a_coarse_grid_is_named_and_a_fine_one_is_not() -> None:
    coarse, fine = probed(ball(WEAK, 3.0, 37)), probed(ball(WEAK, 12.0, 141))
    assert fine.halving_change < COARSEST < coarse.halving_change
    assert fine.fault() is None
    message = coarse.fault()
    assert message is not None
    assert message.startswith("a grid with half as many voxels along each axis bends light by up to ")
    assert message.endswith("; give smaller voxels")
    assert errors(finely(ball(WEAK, 3.0, 37)), WEAK, 3.0, along_z=True).max() < 1.2 * coarse.grid_error


def test_the_check_halves_the_grid() -> None:
    """Its change is the difference between the deflections by the grid and by every second voxel of it."""
    field = ball(WEAK, 5.0, 61)
    values = indices_at(field_table([field]), 0, np.indices((61, 61, 61)).reshape(3, -1).T - 30.0)[:, 0]
    second = index_field(values.reshape(61, 61, 61)[::2, ::2, ::2], 2.0, bounds_mm=field.bounds_mm)
    by_hand = halved(field)
    np.testing.assert_allclose(by_hand.coefficients + by_hand.offsets, second.coefficients + second.offsets, rtol=1e-14)
    np.testing.assert_allclose(by_hand.spacing_mm, 2.0)
    rays = probe_rays(field)
    ends = []
    for each, step in ((field, 0.5), (second, 0.25)):
        table = field_table([dataclasses.replace(each, scheme=RUNGE_KUTTA, step_cells=step)])
        starts = entries(table, 0, rays[:, 0], rays[:, 1])
        ends.append(traced(table, 0, starts)[1])
    largest = deflections(starts, ends[0]).max()
    assert probed(field).halving_change >= deflections(*ends).max() / largest * (1.0 - 1e-6)


def test_grids_keep_their_outer_nodes_when_halved() -> None:
    for shape in ((8, 9, 4), (1, 5, 6), (2, 3, 1)):
        field = index_field(np.random.default_rng(1).uniform(1.0, 1.1, shape), 1.0)
        less = halved(field)
        assert np.array_equal(less.bounds_mm, field.bounds_mm)
        assert np.array_equal(less.origin_mm, field.origin_mm)
        nodes = np.array(field.coefficients.shape) - 2
        fewer = np.array(less.coefficients.shape) - 2
        np.testing.assert_allclose(less.spacing_mm * (fewer - 1), nodes - 1.0)
        corners = np.array([field.origin_mm, field.origin_mm + nodes - 1.0])
        table, same = (indices_at(field_table([each]), 0, corners)[:, 0] for each in (less, field))
        np.testing.assert_allclose(table, same, rtol=1e-14)


def test_a_field_that_the_spline_holds_exactly_has_no_error_of_the_grid() -> None:
    height = np.arange(20.0)
    probe = probed(index_field(np.broadcast_to((1.0 + 1e-3 * height)[:, None, None], (20, 20, 20)), 1.0))
    assert probe.halving_change < 1e-10
    assert probe.fault() is None
    assert probe.integration_error <= FINEST


def test_a_uniform_field_has_no_probe_rays_and_the_cheapest_steps() -> None:
    field = index_field(np.full((5, 6, 7), 1.3), 1.0)
    assert probe_rays(field).shape == (0, 2, 3)
    assert probed(field) == FieldProbe(LEAPFROG, 4.0, 0.0, 0.0, 0.0, 0)


def test_probe_rays_find_a_small_ball_in_a_large_box() -> None:
    """They pass within its width, though a random line would seldom meet it."""
    at = np.moveaxis(np.indices((80, 70, 90)), 0, -1) - [60.0, 20.0, 33.0]
    field = index_field(1.0 + 1e-3 * np.exp(-(at**2).sum(axis=-1) / 9.0), 1.0, origin_mm=[-60.0, -20.0, -33.0])
    rays = probe_rays(field)
    assert rays.shape == (PROBES, 2, 3)
    nearest = np.linalg.norm(np.cross(rays[:, 0], rays[:, 1]), axis=1)
    assert np.quantile(nearest, 0.9) < 5.0
    assert np.array_equal(rays, probe_rays(field))


def test_the_strongest_wavelength_decides_and_given_rays_are_taken() -> None:
    one = ball(WEAK, 5.0, 61)
    both = dataclasses.replace(one, offsets=np.array([1.0, 1.0]), scales=np.array([0.5, 1.0]))
    alone = dataclasses.replace(one, offsets=np.array([1.0]), scales=np.array([1.0]))
    assert probed(both) == probed(alone)
    aside = np.array([[[25.0, 0.0, -60.0], [0.0, 0.0, 1.0]], [[0.0, 25.0, -60.0], [0.0, 0.0, 1.0]]])
    assert probed(one, aside).deflection < 1e-3 * probed(one).deflection
