"""Sobol' points: the published sequence, scrambled so that each is uniform and every set as even as the plain one."""

import numba
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

import lfmesh as lf
from lfmesh.transport.packets.random import derived, descendant
from lfmesh.transport.packets.sobol import COLUMNS, DIMENSIONS, TIME, of_event, owen_sobol, sobol
from lfmesh.transport.render.render import Renderer

LEVEL = 1e-3
"""Chance that a test fails though the law holds, shared by its comparisons (Bonferroni)."""

BINS = 16

Array = NDArray[np.float64]

ROOT = descendant(0x736F626F6C, 1)


@numba.njit
def plain(count: int) -> NDArray[np.uint32]:
    """Return the first points, unscrambled, as integers, (count, TIME + 1)."""
    points = np.empty((count, TIME + 1), np.uint32)
    for i in range(count):
        for d in range(TIME + 1):
            points[i, d] = sobol(i, d)
    return points


@numba.njit
def scrambled(root: np.uint64, sets: int, count: int) -> Array:
    """Return the first points of neighbouring keys' sets, (sets, count, DIMENSIONS)."""
    points = np.empty((sets, count, DIMENSIONS))
    for k in range(sets):
        key = derived(root, k)
        for i in range(count):
            for d in range(DIMENSIONS):
                points[k, i, d] = owen_sobol(key, i, d)
    return points


def p_of_independent(u: Array, v: Array) -> float:
    """Return the chi-square p-value of pairs that should fill a square of BINS x BINS alike."""
    return float(stats.chisquare(np.histogram2d(u, v, BINS, [[0, 1], [0, 1]])[0].ravel()).pvalue)


def test_points_are_the_published_ones() -> None:
    """Against scipy's, which come in the order of Gray's code; bit by bit, 32 bits."""
    count = 1 << 12
    theirs = stats.qmc.Sobol(max(COLUMNS) + 1, scramble=False, bits=32).random(count)[:, COLUMNS] * 2.0**32
    number = np.arange(count)
    np.testing.assert_array_equal(plain(count)[number ^ (number >> 1)], theirs.astype(np.uint32))


def test_each_point_is_uniform() -> None:
    """Over 2¹⁵ scramblings, every point and dimension: Kolmogorov and Smirnov."""
    points = scrambled(ROOT, 1 << 15, 9)
    assert points.min() >= 0.0
    assert points.max() < 1.0
    p = [stats.kstest(points[:, i, d], "uniform").pvalue for i in range(9) for d in range(DIMENSIONS)]
    assert min(p) > LEVEL / len(p)


@pytest.mark.parametrize("m", [1, 2, 4, 6, 9])
def test_every_dimension_has_one_point_in_each_stratum(m: int) -> None:
    """Of 2^m equal intervals each holds one of the first 2^m points, and of every later run of as many."""
    for points in scrambled(ROOT, 20, 4 << m):
        for run in np.split(points, 4):
            for coordinate in run.T:
                np.testing.assert_array_equal(np.sort((coordinate * (1 << m)).astype(int)), np.arange(1 << m))


@pytest.mark.parametrize("m", [2, 4, 6, 8])
def test_the_point_of_the_lenslet_is_a_net(m: int) -> None:
    """A (0, m, 2)-net: every box of area 2^−m, of every shape, holds one of the first 2^m points."""
    for points in scrambled(ROOT, 20, 1 << m):
        assert is_net(points[:, 0], points[:, 1], m, 0)


@pytest.mark.parametrize(("m", "t"), [(3, 0), (4, 1), (5, 0), (6, 1)])
def test_the_place_in_the_pixel_is_nearly_a_net(m: int, t: int) -> None:
    """A (t, m, 2)-net: every box of area 2^(t − m) holds 2^t of the first 2^m points."""
    for points in scrambled(ROOT, 20, 1 << m):
        assert is_net(points[:, 2], points[:, 3], m, t)


def is_net(u: Array, v: Array, m: int, t: int) -> bool:
    """Tell whether 2^m points are a (t, m, 2)-net."""
    boxes = 1 << (m - t)
    for a in range(m - t + 1):
        box = (u * (1 << a)).astype(int) * (boxes >> a) + (v * (boxes >> a)).astype(int)
        if (np.bincount(box, minlength=boxes) != 1 << t).any():
            return False
    return True


def test_sets_and_dimensions_are_independent_of_each_other() -> None:
    """Over 2¹⁶ keys: the same point of neighbouring sets, and two coordinates of one point (chi-square)."""
    points = scrambled(ROOT, 1 << 16, 3)
    p = [p_of_independent(points[::2, i, d], points[1::2, i, d]) for i in range(3) for d in range(DIMENSIONS)]
    p += [
        p_of_independent(points[:, 2, a], points[:, 2, b]) for a in range(DIMENSIONS) for b in range(a + 1, DIMENSIONS)
    ]
    assert min(p) > LEVEL / len(p)


def test_averages_are_unbiased_and_less_scattered_than_of_random_points() -> None:
    """A quarter disk times a triangle: t-test of the mean; chi-square test that the variance is below half."""
    points = scrambled(ROOT, 4000, 64)
    inside = (points[:, :, 0] ** 2 + points[:, :, 1] ** 2 < 1.0) & (points[:, :, 2] + points[:, :, 3] < 1.0)
    means = inside.mean(axis=1)
    share = np.pi / 8.0
    assert stats.ttest_1samp(means, share).pvalue > LEVEL
    random = share * (1.0 - share) / 64
    assert stats.chi2.cdf(means.var(ddof=1) * (len(means) - 1) / (0.5 * random), len(means) - 1) < LEVEL


SCENE = lf.Scene(
    camera={
        "lens": {
            "surfaces": [
                {"radius_mm": 20.0, "thickness_mm": 2.0, "index": 1.5, "semi_diameter_mm": 4.0, "stop": True},
                {"radius_mm": -20.0, "semi_diameter_mm": 4.0},
            ]
        },
        "sensor": {"pixels": [16, 16], "pixel_mm": 0.1},
        "focus_mm": 60.0,
    },
    targets=[
        {"shape": {"kind": "plane", "width_mm": 3.0, "height_mm": 3.0}, "position_mm": [0.4, 0.7, -60.0],
         "rotation_deg": [0.0, 0.0, 20.0], "material": {"reflectance": 0.0, "radiance_w_m2_sr": 1.0}}
    ],
    transport={"samples": 16, "replicates": 1, "threads": 1, "split": "transmit"},
)  # fmt: skip


def images(stratified: bool, first: int) -> Array:
    """Return 24 images of a tilted glowing square, (24, rows, columns)."""
    world = lf.build(SCENE)
    found = []
    for seed in range(first, first + 24):
        renderer = Renderer(world, stratified=stratified)
        renderer.seed = descendant(0x6C666D657368, seed)
        found.append(renderer.image().mean[..., 0])
    return np.array(found)


def test_images_from_sobol_points_have_the_mean_of_random_ones_and_less_noise() -> None:
    """Welch's t-test of the images' sums; one-sided paired t-test of the lit pixels' variances."""
    even, random = images(True, 0), images(False, 100)
    assert stats.ttest_ind(even.sum(axis=(1, 2)), random.sum(axis=(1, 2)), equal_var=False).pvalue > LEVEL
    lit = random.mean(axis=0) > 0.1 * random.mean()
    less = (random.var(axis=0, ddof=1) - even.var(axis=0, ddof=1))[lit]
    assert stats.ttest_1samp(less, 0.0, alternative="greater").pvalue < LEVEL


def test_points_of_an_event_make_a_net_of_their_own() -> None:
    """Every elementary interval of 64 cells holds one of 64 points, whatever the event; sets of two events differ."""
    sets = np.array([[of_event(ROOT, number, sample) for sample in range(64)] for number in (5, 21)])
    for points in sets:
        for a in range(7):
            cells = (points * [1 << a, 1 << (6 - a)]).astype(int)
            assert len(np.unique(cells, axis=0)) == 64
    assert not np.isin(sets[0], sets[1]).any()


def test_points_of_different_events_are_independent() -> None:
    """Over 4,000 pixels, the product of two numbers, less its expectation, has mean zero: a t-test of each pair."""
    keys = [descendant(ROOT, pixel) for pixel in range(4000)]
    points = np.array([[*of_event(k, 5, 3), *of_event(k, 21, 3)] for k in keys]) - 0.5
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    for i, j in pairs:
        assert stats.ttest_1samp(points[:, i] * points[:, j], 0.0).pvalue > LEVEL / len(pairs)
