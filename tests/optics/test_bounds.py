"""Ranges: sums of terms that have no bound."""

import numpy as np
import pytest

from lfmesh.optics.bounds import Range, plus

INF = np.inf


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("one", "other", "low", "high"),
    [
        ((1.0, 2.0), (3.0, 5.0), 4.0, 7.0),
        ((INF, INF), (0.0, 1.0), -INF, INF),
        ((-INF, 1.0), (0.0, 1.0), -INF, 2.0),
        ((-INF, -INF), (0.0, INF), -INF, INF),
        ((-INF, INF), (-INF, INF), -INF, INF),
    ],
)
def test_a_sum_is_within_its_range_or_has_no_bound(
    one: tuple[float, float], other: tuple[float, float], low: float, high: float
) -> None:
    ranges: list[Range] = [(np.array([each[0]]), np.array([each[1]])) for each in (one, other)]
    found = plus(*ranges)
    assert found[0][0] <= low
    assert found[1][0] >= high
    assert found[0][0] == pytest.approx(low, rel=1e-9)
    assert found[1][0] == pytest.approx(high, rel=1e-9)
