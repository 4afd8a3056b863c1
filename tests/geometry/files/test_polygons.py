"""Polygons are cut into triangles of the same area and sense, whatever their shape."""

import numpy as np
import pytest

from lfmesh.geometry.files.polygons import cut

ELL = np.array([[10, -10], [10, 0], [0, 0], [0, 10], [-10, 10], [-10, -10]], float)
RING = np.array([[-2, -2], [2, -2], [2, 2], [-2, 2], [-2, -2], [-1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1]], float)
"""A square with a hole, reached by a cut."""


def shoelace(flat):
    x, y = flat.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def areas(points, triangles):
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def turned(flat, seed):
    """Return a polygon of the plane in a plane of space, and that plane's normal."""
    frame = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return flat @ frame[:2] + frame[2], np.cross(frame[0], frame[1])


def star(seed):
    """Return a polygon whose corners stand at random distances round its middle."""
    rng = np.random.default_rng(seed)
    count = 3 + seed % 12
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    return rng.uniform(0.2, 1.0, len(angles))[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("flat", [ELL, ELL[::-1], RING, RING[::-1], *(star(seed) for seed in range(40))])
def test_triangles_have_the_area_and_the_sense_of_their_polygon(flat):
    points, normal = turned(flat, len(flat))
    made = cut(points, np.arange(len(points)), np.array([len(points)]))
    found = areas(points, made.corners) @ normal
    truth = shoelace(flat)
    assert found.sum() == pytest.approx(truth, rel=1e-12)
    # None is turned, and so none lies twice on the same place.
    assert (found * np.sign(truth) >= 0.0).all()


def test_corners_on_a_straight_edge_stay_corners():
    """A neighbour that has the corner, too, would else stand open there."""
    flat = np.array([[0, 0], [1, 0], [2, 0], [2, 2], [0, 2]], float)
    points, _ = turned(flat, 1)
    made = cut(points, np.arange(5), np.array([5]))
    assert set(made.corners.ravel().tolist()) == set(range(5))
    assert (np.linalg.norm(areas(points, made.corners), axis=1) > 0.1).all()
    assert made.short == 0


def divided(flat, shares, edges):
    """Return a polygon with further corners on some of its edges."""
    places = [np.linspace(0.0, 1.0, shares + 1)[:-1] if k in edges else np.zeros(1) for k in range(len(flat))]
    ends = np.roll(flat, -1, axis=0)
    return np.concatenate([p + t[:, None] * (q - p) for p, q, t in zip(flat, ends, places, strict=True)])


TRIANGLE = np.array([[0, 0], [3, 0], [1, 2]], float)


@pytest.mark.parametrize("shape", [(TRIANGLE, 4, [0]), (TRIANGLE, 5, [0, 1, 2]), (ELL, 3, range(6)), (ELL, 7, [1, 2])])
def test_straight_corners_make_no_facet_without_area(shape):
    """As polygons have them beside finer neighbours: whichever way rounding turns them, every corner is used."""
    flat = divided(*shape)
    for seed in range(100):
        points, normal = turned(flat, seed)
        made = cut(points, np.arange(len(points)), np.array([len(points)]))
        found = areas(points, made.corners) @ normal * np.sign(shoelace(flat))
        assert found.min() > 1e-6 * found.max()
        assert found.sum() == pytest.approx(abs(shoelace(flat)), rel=1e-12)
        assert set(made.corners.ravel().tolist()) == set(range(len(flat)))
        assert made.short == 0


def test_polygons_of_all_kinds_keep_their_order():
    shapes = [ELL, star(3), ELL[:3], star(8), RING, ELL[:2], ELL[[0, 1, 3, 4]]]
    points = np.concatenate([turned(flat, number)[0] for number, flat in enumerate(shapes)])
    counts = np.array([len(flat) for flat in shapes])
    made = cut(points, np.arange(len(points)), counts)
    owner = np.repeat(np.arange(len(shapes)), counts)
    np.testing.assert_array_equal(owner[made.corners], np.repeat(made.polygon[:, None], 3, axis=1))
    assert (np.diff(made.polygon) >= 0).all()
    for number, flat in enumerate(shapes):
        total = np.linalg.norm(areas(points, made.corners[made.polygon == number]).sum(axis=0))
        assert total == pytest.approx(abs(shoelace(flat)), rel=1e-12)


def test_a_polygon_that_crosses_itself_is_told():
    bow = np.array([[0, 0, 0], [2, 2, 0], [2, 0, 0], [1, 3, 0], [0, 2, 0]], float)[[0, 1, 2, 2, 0]]
    assert cut(bow, np.arange(5), np.array([5])).short > 0
