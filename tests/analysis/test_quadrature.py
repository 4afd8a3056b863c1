"""The integral over a region with an edge, against closed forms, and what it says of its error."""

import numpy as np
import pytest
from scipy.special import iv

from lfmesh.analysis.quadrature import CELLS, SHIFT, integral

RADIUS = 14.0


def on_ellipse(x, y, a, b, growth=0.0):
    """A function that is exp(growth · x) on an ellipse and zero beyond; and its integral."""

    def function(p):
        u, v = p[:, 0] - x, p[:, 1] - y
        return np.where((u / a) ** 2 + (v / b) ** 2 <= 1.0, np.exp(growth * u), 0.0)

    return function, np.pi * a * b * (2.0 * iv(1, growth * a) / (growth * a) if growth else 1.0)


@pytest.mark.parametrize(
    "ellipse",
    [(0.1, 0.2, 5.0, 3.0), (1.03, -0.7, 2.2, 6.0, 0.1), (3.0, 3.0, 0.7, 0.9, 0.05), (0.0, 0.0, 9.0, 1.3, 0.2)],
)
def test_an_ellipse_is_integrated_to_the_stated_error(ellipse):
    function, true = on_ellipse(*ellipse)
    found = integral(function, RADIUS)
    assert abs(found.value - true) < found.error
    assert found.error < 2e-3 * true


def test_the_stated_error_is_no_exaggeration():
    """Over many places of an ellipse the errors' root mean square is more than a twentieth of what is stated."""
    draw = np.random.default_rng(5)
    off, stated = [], []
    for _ in range(20):
        function, true = on_ellipse(*draw.uniform(-1.0, 1.0, 2), *draw.uniform(2.0, 5.0, 2))
        found = integral(function, RADIUS)
        off.append(found.value - true)
        stated.append(found.error)
    assert 0.05 < np.sqrt(np.mean(np.square(off)) / np.mean(np.square(stated))) < 1.0


def test_straight_edges_along_the_axes_are_known_as_well_as_others():
    """As those of a sensor that a ghost overfills: 200 rectangles of all sizes and places."""
    draw = np.random.default_rng(11)
    off = []
    for _ in range(200):
        low, high = -draw.uniform(0.5, 9.0, 2), draw.uniform(0.5, 9.0, 2)
        found = integral(lambda p, a=low, b=high: ((p >= a) & (p <= b)).all(axis=1).astype(float), RADIUS)
        off.append((found.value - np.prod(high - low)) / found.error)
    assert 0.02 < np.sqrt(np.mean(np.square(off))) < 1.0
    assert np.abs(off).max() < 4.0


def test_a_hole_in_the_middle_of_a_cell_is_found():
    side = 2.0 * RADIUS / (CELLS - 1)
    x, y = (side * (30.53 - shift) - RADIUS for shift in SHIFT)
    hole, area = on_ellipse(x, y, 0.3 * side, 0.3 * side)
    disk, all_of_it = on_ellipse(0.3, 0.2, 10.0, 10.0)
    found = integral(lambda p: disk(p) - hole(p), RADIUS)
    whole = integral(disk, RADIUS)
    assert abs(whole.value - found.value - area) < 0.08 * area
    assert abs(found.value - (all_of_it - area)) < found.error


def strip(width, turn, off):
    """A strip through the disk, and beside it two ways to be dark; and its area."""
    along = np.array([np.cos(turn), np.sin(turn)])

    def function(p):
        across = p @ along - off
        inside = (p**2).sum(axis=1) < (0.9 * RADIUS) ** 2
        return np.where((np.abs(across) < 0.5 * width) & inside, 1.0, np.where(across > 0.0, -1.0, -2.0))

    return function, 2.0 * width * np.sqrt((0.9 * RADIUS) ** 2 - off * off)


def test_strips_narrower_than_cells_are_integrated_to_the_stated_error():
    """Down to a 16th of a cell, where they pass between all points of the first cells and most of the smallest."""
    draw = np.random.default_rng(3)
    cell = 2.0 * RADIUS / (CELLS - 1)
    for width in 2.0 ** draw.uniform(-4.0, 2.0, 60) * cell:
        function, area = strip(width, draw.uniform(0.0, np.pi), draw.uniform(-5.0, 5.0))
        found = integral(function, RADIUS)
        assert abs(found.value - area) < found.error + 0.01 * area, width / cell
        assert found.error < (0.1 if width > 0.25 * cell else 2.0) * area, width / cell


def test_a_spot_within_a_cell_is_found_where_ways_to_be_dark_meet():
    draw = np.random.default_rng(4)
    cell = 2.0 * RADIUS / (CELLS - 1)
    for _ in range(30):
        middle, spot = draw.uniform(-5.0, 5.0, 2), draw.uniform(0.15, 0.45) * cell

        def function(p, middle=middle, spot=spot):
            u = p - middle
            return np.where((u**2).sum(axis=1) < spot * spot, 1.0, -1.0 - (u > 0.0) @ [1.0, 2.0])

        found = integral(function, RADIUS)
        assert abs(found.value - np.pi * spot * spot) < found.error
        assert found.error < 0.1 * found.value


def test_what_is_found_between_the_smallest_cells_counts_as_error():
    function, area = strip(2.0 * RADIUS / (CELLS - 1) / 30.0, 0.0, 0.123)
    found = integral(function, RADIUS)
    assert abs(found.value - area) < found.error


def test_nothing_is_nothing():
    assert integral(lambda p: np.zeros(len(p)), RADIUS) == (0.0, 0.0)
