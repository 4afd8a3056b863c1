"""Arguments of `lf.trace` of every kind are traced or refused by one message."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.scene import loads
from tests.cameras import bench_camera

strange = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3), st.lists(st.floats(), max_size=4),
    st.sampled_from([10**400, -(10**6000), 1j, b"both", {}, object]),
)  # fmt: skip
numbers = st.one_of(st.floats(), st.floats(-100.0, 100.0), st.sampled_from([1e200, -1e200, 1e-300, 0.0]))
rows = st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=1, max_size=3)
SETTINGS = ("wavelength_nm", "split", "seed", "threads", "surface", "engine", "max_events", "weight_cutoff")
changes = st.dictionaries(st.sampled_from(SETTINGS), strange, max_size=3)


@pytest.fixture(scope="module")
def world() -> lf.World:
    return lf.build(loads(bench_camera(4, 4)))


def is_traced_or_refused(world: lf.World, origins: Any, directions: Any, options: dict[str, Any]) -> None:
    refusal = ""
    try:
        paths = lf.trace(world, origins, directions, **options)
    except lf.LfmeshError as error:
        refusal = str(error)
        paths = None
    assert paths is not None or (refusal and len(refusal.splitlines()) == 1 and len(refusal) < 500)
    if paths is not None:
        assert paths.ledger.lost_share < 1e-7


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.one_of(rows, strange), st.one_of(rows, strange), changes)
def test_a_call_with_strange_arguments_is_traced_or_refused(
    world: lf.World, origins: Any, directions: Any, options: dict[str, Any]
) -> None:
    is_traced_or_refused(world, origins, directions, options)


@pytest.mark.long
@settings(max_examples=1_000, deadline=None, derandomize=True, database=None)
@given(st.one_of(rows, strange), st.one_of(rows, strange), changes)
def test_many_calls_with_strange_arguments_are_traced_or_refused(
    world: lf.World, origins: Any, directions: Any, options: dict[str, Any]
) -> None:
    is_traced_or_refused(world, origins, directions, options)
