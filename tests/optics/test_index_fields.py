"""Cubic B-splines of index fields: exactness, order, derivatives, ends of the grid, wavelengths, refusals."""

from typing import Any

import numpy as np
import pytest
from numpy.polynomial import polynomial
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from lfmesh.errors import SceneError
from lfmesh.optics.index_fields import field_table, index_field, indices_at, spline_coefficients

Array = NDArray[np.float64]

SPACING, ORIGIN = np.array([0.5, 1.0, 2.0]), np.array([1.0, -2.0, 3.0])


def nodes(shape: tuple[int, ...], spacing: Any = SPACING, origin: Any = ORIGIN) -> Array:
    """Return the nodes of a grid, (nx, ny, nz, 3)."""
    return np.moveaxis(np.indices(shape), 0, -1) * spacing + origin


def inside_faces(shape: tuple[int, ...], count: int) -> Array:
    """Return random points between the faces of a grid, half a voxel beyond its outer nodes."""
    draw = np.random.default_rng(4)
    return draw.uniform(ORIGIN - 0.5 * SPACING, ORIGIN + SPACING * (np.array(shape) - 0.5), (count, 3))


@pytest.mark.parametrize("shape", [(9, 4, 12), (5, 6, 7), (1, 8, 2), (3, 1, 4), (1, 1, 1)])
def test_the_spline_passes_through_the_nodes(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).uniform(1.0, 2.0, shape)
    table = field_table([index_field(values, SPACING, ORIGIN)])
    np.testing.assert_allclose(indices_at(table, 0, nodes(shape))[:, 0], values.ravel(), rtol=3e-15)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_polynomials_are_exact_up_to_the_faces_and_beyond(degree: int) -> None:
    """Up to the third degree along each axis, the gradient included; of few nodes, up to one less than their number."""
    shape = (max(degree + 1, 1), 4, 9)
    draw = np.random.default_rng(2)
    factors = draw.uniform(-1.0, 1.0, (degree + 1, degree + 1, degree + 1))

    def value(at: Array, over: tuple[int, int, int] = (0, 0, 0)) -> Array:
        c = factors
        for axis, times in enumerate(over):
            c = polynomial.polyder(c, times, axis=axis)
        return polynomial.polyval3d(*np.moveaxis(0.1 * (at - ORIGIN), -1, 0), c)

    table = field_table([index_field(value(nodes(shape)), SPACING, ORIGIN, law=(100.0, 1.0))])
    points = np.vstack([inside_faces(shape, 40), ORIGIN - 1.5 * SPACING, ORIGIN + SPACING * np.add(shape, 1.0)])
    found = indices_at(table, 0, points)
    np.testing.assert_allclose(found[:, 0], 100.0 + value(points), rtol=1e-13)
    gradient = [0.1 * value(points, tuple(np.eye(3, dtype=int)[axis])) for axis in range(3)]
    np.testing.assert_allclose(found[:, 1:], np.transpose(gradient), rtol=0.0, atol=2e-11)


def test_values_and_gradients_are_those_of_scipys_splines() -> None:
    """Of `make_interp_spline`, which ends "not-a-knot" too and continues its outer polynomials."""
    shape = (9, 4, 12)
    values = np.random.default_rng(3).normal(size=shape)
    points = inside_faces(shape, 25)
    found = indices_at(field_table([index_field(values, SPACING, ORIGIN, law=(50.0, 1.0))]), 0, points)

    def truth(point: Array, over: tuple[int, ...]) -> float:
        part = values
        for axis in range(3):
            axis_nodes = ORIGIN[axis] + SPACING[axis] * np.arange(shape[axis])
            part = make_interp_spline(axis_nodes, part, k=3)(point[axis], nu=over[axis])
        return float(part)

    for column, over in enumerate([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]):
        wanted = np.array([truth(point, over) for point in points]) + (50.0 if column == 0 else 0.0)
        np.testing.assert_allclose(found[:, column], wanted, rtol=0.0, atol=1e-12)


def test_values_have_the_order_four_and_gradients_three_at_the_ends_too() -> None:
    """Mirrored ends would leave a gradient of order 0 there."""
    draw = np.random.default_rng(5)
    points = np.vstack([draw.uniform(0.0, 1.0, (300, 3)), [[0.0, 0.3, 0.7], [1.0, 1.0, 0.4], [0.9, 0.0, 0.0]]])
    wave = np.array([1.1, 0.7, -0.9])
    errors = []
    for n in (17, 33):
        at = nodes((n, n, n), 1.0 / (n - 1), 0.0)
        found = indices_at(
            field_table([index_field(np.sin(at @ wave + 0.4), 1.0 / (n - 1), 0.0 * wave, law=(3, 1))]), 0, points
        )
        slope = np.cos(points @ wave + 0.4)[:, None] * wave
        errors.append(
            [np.abs(found[:, 0] - 3.0 - np.sin(points @ wave + 0.4)).max(), np.abs(found[:, 1:] - slope).max()]
        )
    value, gradient = np.log2(np.divide(*errors))
    assert 3.7 < value < 4.4
    assert 2.7 < gradient < 3.4


def test_the_gradient_is_the_derivative_of_the_value() -> None:
    """By differences of a random field, so that rays conserve |T|² − n²."""
    table = field_table([index_field(np.random.default_rng(6).uniform(1.0, 2.0, (6, 7, 8)), SPACING, ORIGIN)])
    points, step = inside_faces((6, 7, 8), 50), 1e-5
    gradient = indices_at(table, 0, points)[:, 1:]
    for axis in range(3):
        aside = step * np.eye(3)[axis]
        ahead, behind = (indices_at(table, 0, points + sign * aside)[:, 0] for sign in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2.0 * step), gradient[:, axis], rtol=0.0, atol=1e-8)


def test_a_uniform_grid_bends_nothing() -> None:
    table = field_table([index_field(np.full((5, 6, 7), 1.0003), SPACING, ORIGIN)])
    found = indices_at(table, 0, inside_faces((5, 6, 7), 30))
    assert np.array_equal(found, np.tile([1.0003, 0.0, 0.0, 0.0], (30, 1)))


def test_one_grid_serves_all_wavelengths_and_a_table_several_grids() -> None:
    draw = np.random.default_rng(7)
    density, other = draw.uniform(0.3, 1.2, (5, 6, 7)), draw.uniform(1.0, 1.5, (4, 5, 3))
    offsets, scales = np.array([0.9997, 0.9998]), np.array([2.3e-4, 2.2e-4])
    first = index_field(density, SPACING, ORIGIN, law=(offsets, scales))
    second = index_field(other, 0.7, law=(0.0, [1.0, 1.01]))
    table, points = field_table([first, second]), inside_faces((5, 6, 7), 20)
    quantity = indices_at(field_table([index_field(density, SPACING, ORIGIN)]), 0, points)
    for number in range(2):
        wanted = quantity * scales[number] + offsets[number] * np.eye(4)[0]
        np.testing.assert_allclose(indices_at(table, number, points), wanted, rtol=1e-13, atol=1e-18)
    alone = field_table([second])
    for number in range(2):
        at = 0.3 * points
        assert np.array_equal(indices_at(table, 2 + number, at), indices_at(alone, number, at))
    assert len(table.rows) == 4
    assert len(field_table([]).rows) == 0


def test_a_grid_is_centred_and_its_bounds_are_its_faces() -> None:
    field = index_field(np.ones((4, 5, 6)), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(field.bounds_mm, [[-2.0, -5.0, -9.0], [2.0, 5.0, 9.0]])
    np.testing.assert_allclose(field.origin_mm, [-1.5, -4.0, -7.5])
    smaller = index_field(np.ones((4, 5, 6)), [1.0, 2.0, 3.0], bounds_mm=[[-1, -2, -3], [1, 2, 3]])
    np.testing.assert_allclose(smaller.bounds_mm, [[-1, -2, -3], [1, 2, 3]])


def test_coefficients_solve_the_equations_of_the_spline() -> None:
    values = np.random.default_rng(8).normal(size=(7, 5, 6))
    c = spline_coefficients(values)
    assert c.shape == (9, 7, 8)
    for axis in range(3):
        c = np.moveaxis(c, axis, 0)
        fourth = np.diff(c, 4, axis=0)
        assert np.abs(fourth[[0, -1]]).max() < 1e-13 * np.abs(c).max()
        c = np.moveaxis((c[:-2] + 4.0 * c[1:-1] + c[2:]) / 6.0, 0, axis)
    np.testing.assert_allclose(c, values, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.ones((3, 4)), {}, r"must be an array \[x, y, z\], but have the shape \(3, 4\)"),
        (np.ones((0, 4, 4)), {}, r"but have the shape \(0, 4, 4\)"),
        (np.full((2, 2, 2), np.nan), {}, "must be finite everywhere"),
        (np.full((2, 2, 2), -1.0), {}, r"the index is -1 at a voxel; it must be above 0"),
        (np.ones((2, 2, 2)), {"law": (1.0, [0.1, -2.0])}, r"the index is -1 at a voxel"),
        (np.ones((2, 2, 2)), {"bounds_mm": [[-1, -1, -1], [1, 1, 2]]}, "-1 to 2 mm along z, but its grid from -1 to 1"),
    ],
)
def test_what_is_no_index_field_is_refused(values: Array, options: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        index_field(values, 1.0, **options)
