"""Arguments of point spreads and wavefronts of every kind: computed, or refused by one message."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import lfmesh as lf
from tests.cameras import camera_without_array
from tests.fuzz.test_renders import Table, in_few_lines

strange = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=3), st.lists(st.floats(), max_size=4),
    st.sampled_from([10**400, -(10**6000), 1j, b"both", {}, object, [[1.0]], float("nan")]),
)  # fmt: skip
places = st.lists(st.floats(-30.0, 30.0), min_size=2, max_size=2)
points = st.builds(lambda xy, z: [*xy, z], places, st.sampled_from([-150.0, -149.0, -1e7]) | st.floats(-400.0, 5.0))
SPREAD = ("wavelengths_nm", "weights", "window", "oversample", "tolerance")
WAVEFRONT = ("height_mm", "wavelength_nm", "object_mm", "image_z_mm", "across")


def options_of(names: tuple[str, ...]) -> st.SearchStrategy[Table]:
    return st.dictionaries(st.sampled_from(names), strange, max_size=2)


@pytest.fixture(scope="module")
def scene() -> lf.Scene:
    """A lens of f/20, whose waves small grids hold."""
    camera = camera_without_array(pixel_mm=0.01)
    camera["lens"]["stop_semi_diameter_mm"] = 0.8
    return lf.Scene(camera=camera)


def is_computed_or_refused(scene: lf.Scene, point: Any, options: Table) -> bool:
    """Insist on a point spread of finite power, not more than what entered, or on one refusal."""
    try:
        found = lf.point_spread(scene, point, **options)
    except lf.LfmeshError as error:
        in_few_lines(error)
        return False
    assert np.isfinite(found.mean).all()
    assert (found.mean >= 0.0).all()
    assert 0.0 < found.mean.sum() <= found.power_w * 1.01
    assert found.power_w <= found.entered_w * 1.01
    return True


def has_a_wavefront_or_is_refused(scene: lf.Scene, options: Table) -> None:
    try:
        found = lf.wavefront(scene, **options)
    except lf.LfmeshError as error:
        in_few_lines(error)
        return
    assert np.isfinite(found.opd_waves).all()
    assert 0.0 <= found.strehl <= 1.0 + 1e-12


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(points | strange, options_of(SPREAD))
def test_point_spreads_with_strange_arguments_are_computed_or_refused(
    scene: lf.Scene, point: Any, options: Table
) -> None:
    is_computed_or_refused(scene, point, options)


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(options_of(WAVEFRONT))
def test_wavefronts_with_strange_arguments_are_computed_or_refused(scene: lf.Scene, options: Table) -> None:
    has_a_wavefront_or_is_refused(scene, options)


@pytest.mark.long
@settings(max_examples=400, deadline=None, derandomize=True, database=None)
@given(points | strange, options_of(SPREAD), options_of(WAVEFRONT))
def test_many_strange_arguments_are_computed_or_refused(
    scene: lf.Scene, point: Any, options: Table, others: Table
) -> None:
    is_computed_or_refused(scene, point, options)
    has_a_wavefront_or_is_refused(scene, others)
