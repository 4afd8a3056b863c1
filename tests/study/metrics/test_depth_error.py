"""The error of depth is that of the samples whose depth can be told, not of those that happen to be known."""

from types import SimpleNamespace

import numpy as np
import pytest

from lfmesh.study.metrics import depth_error
from lfmesh.study.metrics.depth_error import depth_errors_mm


@pytest.mark.parametrize(("lost", "known"), [(0, True), (4, True), (5, False), (10, False)])
def test_an_error_of_depth_is_not_that_of_a_minority_that_is_known(
    lost: int, known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of twelve samples ten have texture and truth; the easy ones are right, and those that are lost would not be."""
    depth = np.full((3, 4), 500.0)
    depth.ravel()[:lost] = np.nan
    truth = np.full((3, 4), 500.0)
    truth[2, 2] = np.nan
    where = np.ones((3, 4), dtype=np.bool_)
    where[2, 3] = False
    monkeypatch.setattr(depth_error, "estimate_depth", lambda _: SimpleNamespace(distance_mm=depth))
    errors = depth_errors_mm(None, truth, where)  # type: ignore[arg-type]
    assert np.isfinite(errors).all() == known
    assert len(errors) == (10 - lost if known else 1)
