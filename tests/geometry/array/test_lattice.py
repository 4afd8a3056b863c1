"""The lattice: Voronoi cells, and walks from cell to cell that agree with them."""

import numpy as np
import pytest

from lfmesh.geometry.array.lattice import (
    Lattice,
    cell_of,
    centre,
    columns_near,
    is_inside,
    leaves_at,
    neighbour,
    rows_near,
)

LATTICES = {
    "square": Lattice(False, 0.125, 7, 6),
    "square odd": Lattice(False, 0.014, 5, 5),
    "hexagonal": Lattice(True, 0.125, 7, 6),
    "hexagonal odd": Lattice(True, 0.014, 6, 5),
    "one row": Lattice(True, 1.0, 4, 1),
}


@pytest.fixture(params=LATTICES.values(), ids=LATTICES)
def lattice(request):
    return request.param


def test_centres_are_the_cells_centres_about_the_origin(lattice):
    centres = lattice.centres()
    assert centres.shape == (lattice.rows, lattice.columns, 2)
    for row, column in np.ndindex(centres.shape[:2]):
        np.testing.assert_allclose(centre(lattice, column, row), centres[row, column], atol=1e-15)
    low, high = centres.min(axis=(0, 1)), centres.max(axis=(0, 1))
    np.testing.assert_allclose(low, -high, atol=1e-15)


def test_neighbouring_centres_are_one_pitch_apart(lattice):
    sides = 6 if lattice.hexagonal else 4
    for side in range(sides):
        for row in (1, 2):
            to = np.subtract(centre(lattice, *neighbour(lattice, 2, row, side)), centre(lattice, 2, row))
            turn = np.deg2rad(360 / sides * side)
            np.testing.assert_allclose(to, lattice.pitch * np.array([np.cos(turn), np.sin(turn)]), atol=1e-15)


@pytest.mark.parametrize("distance", [0.0, 0.3, 0.5, 1.7, 20.0, np.inf])
def test_rows_and_columns_near_a_place_are_those_of_the_centres_near_it(lattice, distance):
    far = distance * lattice.pitch
    centres = lattice.centres()
    for x, y in np.random.default_rng(3).uniform(-6.0, 6.0, (50, 2)) * lattice.pitch:
        first, end = rows_near(lattice, y, far)
        near = np.flatnonzero(abs(centres[:, 0, 1] - y) <= far)
        assert list(range(first, end)) == near.tolist()
        for row in range(lattice.rows):
            first, end = columns_near(lattice, row, x, far)
            near = np.flatnonzero(abs(centres[row, :, 0] - x) <= far)
            assert list(range(first, end)) == near.tolist()


def test_cells_are_those_of_the_nearest_centre(lattice):
    rng = np.random.default_rng(4)
    half = np.array(lattice.half_extent)
    centres = lattice.centres().reshape(-1, 2)
    points = rng.uniform(-half, half, size=(4000, 2))
    near = np.linalg.norm(points[:, None] - centres, axis=2)
    compared = 0
    for p, distances in zip(points, near, strict=True):
        column, row = cell_of(lattice, *p)
        if not is_inside(lattice, column, row):
            # Outside the array: then no centre is within the circle inscribed in its cell.
            assert distances.min() >= 0.5 * lattice.pitch * (1 - 1e-12)
            continue
        compared += 1
        mine = np.linalg.norm(p - np.array(centre(lattice, column, row)))
        assert mine <= distances.min() * (1 + 1e-12)
    assert compared > 2500


def test_cells_outside_the_array_are_told_from_those_inside(lattice):
    for column, row in ((-1, 0), (0, -1), (lattice.columns, 0), (0, lattice.rows)):
        assert not is_inside(lattice, column, row)
        assert cell_of(lattice, *centre(lattice, column, row)) == (column, row)
    assert is_inside(lattice, 0, 0)
    assert is_inside(lattice, lattice.columns - 1, lattice.rows - 1)


def test_corners_enclose_the_cell_area_counter_clockwise(lattice):
    x, y = lattice.corners().T
    area = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    assert area == pytest.approx(lattice.cell_area, rel=1e-14)
    np.testing.assert_allclose(np.hypot(x, y), lattice.circumradius, rtol=1e-15)


def test_half_extent_bounds_all_cells_tightly(lattice):
    corners = (lattice.centres()[:, :, None] + lattice.corners()).reshape(-1, 2)
    np.testing.assert_allclose(np.abs(corners).max(axis=0), lattice.half_extent, rtol=1e-14)


def test_a_ray_leaves_its_cell_into_the_neighbour_where_it_says(lattice):
    rng = np.random.default_rng(5)
    step = 1e-9 * lattice.pitch
    column, row = 2, rng.integers(0, 6)
    here = np.array(centre(lattice, column, row))
    for _ in range(2000):
        p = rng.uniform(-1, 1, size=2) * lattice.circumradius
        if cell_of(lattice, *(p + here)) != (column, row):
            continue
        turn = rng.uniform(0, 2 * np.pi)
        d = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(0.1, 1.0)
        t, side = leaves_at(lattice, *p, *d)
        assert t >= 0
        assert cell_of(lattice, *(here + p + d * t - step * d)) == (column, row)
        assert cell_of(lattice, *(here + p + d * t + step * d)) == neighbour(lattice, column, row, side)


def test_a_ray_along_the_axis_never_leaves(lattice):
    assert leaves_at(lattice, 0.0, 0.0, 0.0, 0.0) == (np.inf, -1)


def test_a_ray_a_rounding_error_outside_leaves_at_once(lattice):
    x = 0.5 * lattice.pitch * (1 + 1e-15)
    t, side = leaves_at(lattice, x, 0.0, 1.0, 0.1)
    assert side == 0
    assert -1e-14 < t <= 0.0
