"""Search in ascending numbers, against numpy."""

import numpy as np
import pytest

from lfmesh.kernels.search import count_up_to


@pytest.mark.parametrize("length", [0, 1, 2, 3, 7, 64, 1000])
def test_as_numpy_searches(length: int) -> None:
    draw = np.random.default_rng(length)
    # Rounded, so that some are equal to each other, and some wanted are equal to some there.
    numbers = np.sort(np.round(draw.normal(size=length), 1))
    wanted = [*np.round(draw.normal(size=200), 1), *draw.normal(size=200), -np.inf, np.inf, np.nan, -0.0, 0.0]
    assert [count_up_to(numbers, x) for x in wanted] == np.searchsorted(numbers, wanted, side="right").tolist()


def test_as_numpy_searches_among_infinities() -> None:
    numbers = np.array([-np.inf, -1.0, 0.0, np.inf, np.inf])
    for x in (-np.inf, -2.0, 0.0, 5.0, np.inf, np.nan):
        assert count_up_to(numbers, x) == np.searchsorted(numbers, x, side="right")
