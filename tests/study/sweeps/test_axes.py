"""Axes and designs give the values that were asked for, and refuse what gives none."""

import numpy as np
import pytest
from scipy.stats import kstest, norm, uniform

import lfmesh as lf
from lfmesh.study.sweeps.axes import Axis
from tests.study.studies import SHIFT, small_scene

PATH = "camera.mla.pose.tilt_deg[0]"


def test_ranges_begin_and_end_where_they_say() -> None:
    assert Axis(path=PATH, range=(-1.0, 2.0), count=4).listed() == [-1.0, 0.0, 1.0, 2.0]
    values = Axis(path=PATH, log_range=(0.01, 10.0), count=4).listed()
    assert (values[0], values[-1]) == (0.01, 10.0)
    np.testing.assert_allclose(np.diff(np.log(values)), np.log(10.0), rtol=1e-12)


def test_draws_follow_their_seed_and_their_distribution() -> None:
    drawn = Axis(path=PATH, normal=(0.5, 0.1), count=2000, seed=7)
    assert drawn.listed() == drawn.listed()
    assert drawn.listed() != Axis(path=PATH, normal=(0.5, 0.1), count=2000, seed=8).listed()
    # Kolmogorov and Smirnov's test at the level of 0.1 %, with a seed that is fixed.
    assert kstest(drawn.listed(), norm(0.5, 0.1).cdf).pvalue > 1e-3
    flat = Axis(path=PATH, uniform=(-1.0, 3.0), count=2000, seed=7)
    assert kstest(flat.listed(), uniform(-1.0, 4.0).cdf).pvalue > 1e-3


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({}, "it has no values"),
        ({"values": (1.0,), "range": (0.0, 1.0)}, "values and range are given"),
        ({"values": ()}, "must not be empty"),
        ({"range": (1.0, 1.0), "count": 3}, "is empty"),
        ({"uniform": (2.0, 1.0), "count": 3}, "is empty"),
        ({"log_range": (0.0, 1.0), "count": 3}, "must be above 0"),
        ({"normal": (0.0, 0.0), "count": 3}, "standard deviation"),
        ({"values": ("both",), "relative": True}, "must be numbers"),
        ({"values": (1.0,), "count": 2}, "omit it"),
    ],
)
def test_an_axis_without_values_is_refused(given: dict[str, object], why: str) -> None:
    with pytest.raises(lf.LfmeshError, match=why):
        Axis(path=PATH, **given)


def test_a_grid_takes_every_combination_and_one_at_a_time_each_value_by_itself() -> None:
    axes = [{"path": SHIFT, "values": [0.01, 0.02]}, {"path": PATH, "values": [0.1, 0.2, 0.3]}]
    grid = lf.Study(small_scene(), axes=axes, design="grid", metrics=["light"]).plan
    assert [point.values for point in grid.points[1:]] == [(a, b) for a in (0.01, 0.02) for b in (0.1, 0.2, 0.3)]
    alone = lf.Study(small_scene(), axes=axes, metrics=["light"]).plan
    blank = None
    assert [point.values for point in alone.points] == [
        (blank, blank), (0.01, blank), (0.02, blank), (blank, 0.1), (blank, 0.2), (blank, 0.3),
    ]  # fmt: skip


@pytest.mark.parametrize("design", ["latin_hypercube", "sobol"])
def test_filling_designs_have_one_point_in_every_slice_of_every_axis(design: str) -> None:
    axes = [{"path": SHIFT, "uniform": (0.0, 1.0)}, {"path": PATH, "range": (-2.0, 2.0)}]
    plan = lf.Study(small_scene(), axes=axes, design=design, count=64, seed=5, metrics=["light"]).plan
    values = np.array([point.values for point in plan.points[1:]], dtype=float)
    shares = (values - [0.0, -2.0]) / [1.0, 4.0]
    for column in shares.T:
        assert sorted(np.floor(64 * column).astype(int)) == list(range(64))


def test_relative_values_are_added_to_those_of_the_reference() -> None:
    nominal = lf.solved(small_scene()).camera.mla
    assert nominal is not None
    assert nominal.distance_mm is not None
    axes = [{"path": "camera.mla.distance_mm", "values": [-0.1, 0.1], "relative": True}]
    plan = lf.Study(small_scene(), axes=axes, metrics=["light"]).plan
    distances = [plan.scene_of(point).camera.mla.distance_mm for point in plan.points]  # type: ignore[union-attr]
    assert distances == [nominal.distance_mm, nominal.distance_mm - 0.1, nominal.distance_mm + 0.1]
