"""Filter expressions made at random are evaluated, or refused by a message that points at the place."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.scene import loads
from lfmesh.view.rays.filters import FilterError, parse
from lfmesh.view.rays.launch import from_field_point
from lfmesh.view.rays.paths import Rays
from tests.cameras import bench_camera

WORDS = [
    *["hits", "reflects", "transmits", "scatters", "ghost", "status", "last", "events", "power", "wavelength", "path"],
    *["pixel", "in", "and", "or", "not", "(", ")", ",", ":", "==", "!=", "<", ">=", "-", "+", "=", "&", "'", '"'],
    *[
        "mla",
        "lens",
        "sensor",
        "stop",
        "lens[0]",
        "lens[9]",
        "L0a",
        "lost",
        "1",
        "0",
        "1e-6",
        "1.5.2",
        "9" * 30,
        "٣",
        "\n",
    ],
    *["_", "__import__", "é", "\x00", "[", "]", ".", "0x10", "nan", "inf", "1" * 400],
]

expressions = st.one_of(
    st.lists(st.sampled_from(WORDS), max_size=30).map(" ".join),
    st.lists(st.sampled_from(WORDS), max_size=12).map("".join),
    st.text(max_size=60),
)


@pytest.fixture(scope="module")
def rays() -> Rays:
    return from_field_point(lf.build(loads(bench_camera(4, 4))), (0.0, 0.0, -500.0), 20)


def is_evaluated_or_refused(rays: Rays, expression: str) -> None:
    refusal = None
    try:
        kept = parse(expression, rays)
    except FilterError as error:
        refusal = error
    if refusal is None:
        assert kept.shape == (len(rays),)
        assert kept.dtype == np.bool_
    else:
        assert 0 <= refusal.position <= len(expression)
        assert refusal.reason


@settings(max_examples=500, deadline=None, derandomize=True, database=None)
@given(expressions)
def test_a_random_filter_is_evaluated_or_refused(rays: Rays, expression: str) -> None:
    is_evaluated_or_refused(rays, expression)


@pytest.mark.long
@settings(max_examples=20_000, deadline=None, derandomize=True, database=None)
@given(expressions)
def test_many_random_filters_are_evaluated_or_refused(rays: Rays, expression: str) -> None:
    is_evaluated_or_refused(rays, expression)
