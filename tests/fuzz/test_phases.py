"""Phases of lens surfaces and arrays in scene files: bad ones are refused by name, harsh ones are read or refused."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import LfmeshError
from lfmesh.scene import loads
from tests.fuzz.test_scenes import SCENE, is_read_or_refused

RADIAL = 'kind = "radial", radius_mm = 5.0, coefficients_rad = [-90.0]'
GRATING = 'kind = "grating", lines_per_mm = 20.0'
METALENS = 'kind = "metalens", focal_length_mm = 9.0, design_nm = 550.0'
HOLOGRAM = 'kind = "hologram", construction_nm = 550.0, point_1_mm = [0.0, 0.0, -90.0], point_2_mm = [0.0, 0.0, 60.0]'
ZONES = (
    'kind = "zones", zones = [{ border_mm = 1.0, coefficients_rad = [-9.0], radius_mm = 1.0 }, '
    "{ coefficients_rad = [-40.0, 1.0], radius_mm = 2.5, offset_rad = 0.5 }]"
)
WHOLE = (RADIAL, GRATING, METALENS, HOLOGRAM, ZONES)

BAD = {
    "no table": "1",
    "no kind": "{ }",
    "an unknown kind": '{ kind = "ripple" }',
    "keys of another kind": '{ kind = "grating", lines_per_mm = 20.0, coefficients_rad = [1.0] }',
    "radial without coefficients": '{ kind = "radial", radius_mm = 5.0 }',
    "radial with an empty list": '{ kind = "radial", radius_mm = 5.0, coefficients_rad = [] }',
    "radial of NaN": '{ kind = "radial", radius_mm = 5.0, coefficients_rad = [nan] }',
    "radial of infinity": '{ kind = "radial", radius_mm = 5.0, coefficients_rad = [-90.0, inf] }',
    "radial with terms": '{ kind = "radial", radius_mm = 5.0, coefficients_rad = [[2, 0, 1.0]] }',
    "radial of no radius": '{ kind = "radial", radius_mm = 0.0, coefficients_rad = [-90.0] }',
    "xy without powers": '{ kind = "xy", radius_mm = 5.0, coefficients_rad = [1.0, 2.0] }',
    "xy of half a power": '{ kind = "xy", radius_mm = 5.0, coefficients_rad = [[0.5, 0, 1.0]] }',
    "xy of a negative power": '{ kind = "xy", radius_mm = 5.0, coefficients_rad = [[-1, 0, 1.0]] }',
    "xy of a high power": '{ kind = "xy", radius_mm = 5.0, coefficients_rad = [[1000000, 0, 1.0]] }',
    "xy with a term twice": '{ kind = "xy", radius_mm = 5.0, coefficients_rad = [[1, 0, 1.0], [1, 0, 2.0]] }',
    "grating without lines": '{ kind = "grating", lines_per_mm = 0.0 }',
    "grating of NaN": '{ kind = "grating", lines_per_mm = nan }',
    "grating of no direction": '{ kind = "grating", lines_per_mm = 20.0, direction_deg = inf }',
    "metalens without a design": '{ kind = "metalens", focal_length_mm = 9.0 }',
    "metalens of no focal length": '{ kind = "metalens", focal_length_mm = 0.0, design_nm = 550.0 }',
    "metalens of NaN": '{ kind = "metalens", focal_length_mm = nan, design_nm = 550.0 }',
    "hologram of one point": '{ kind = "hologram", construction_nm = 550.0, point_1_mm = [0.0, 0.0, -90.0] }',
    "hologram of points in its plane": "{ " + HOLOGRAM.replace("60.0", "0.0") + " }",
    "zones without a zone": '{ kind = "zones", zones = [] }',
    "zones without numbers": '{ kind = "zones", zones = [{}] }',
    "zones without an outer border": "{ " + ZONES.replace("border_mm = 1.0, ", "") + " }",
    "zones that end": "{ " + ZONES.replace("offset_rad = 0.5", "border_mm = 2.0") + " }",
    "zones of no width": "{ " + ZONES.replace("border_mm = 1.0", "border_mm = 0.0") + " }",
    "zones of NaN": "{ " + ZONES.replace("-40.0", "nan") + " }",
    "zones of an infinite offset": "{ " + ZONES.replace("= 0.5", "= inf") + " }",
    "grid without a file": '{ kind = "grid" }',
    "grid of no file": '{ kind = "grid", file = "nothing.npz" }',
    "grid of NUL": '{ kind = "grid", file = "\\u0000.npz" }',
    **{
        name: f"{{ {RADIAL}, {keys} }}"
        for name, keys in {
            "half an order": "order = 0.5",
            "a huge order": "order = 9223372036854775807",
            "order and orders": "order = 1, orders = [{ order = 1, share = 0.5 }]",
            "orders without shares": "orders = [{ order = 1 }, { order = 0 }]",
            "orders as numbers": "orders = [0, 1]",
            "an order twice": "orders = [{ order = 1, share = 0.4 }, { order = 1, share = 0.4 }]",
            "shares above 1": "orders = [{ order = 1, share = 0.7 }, { order = 0, share = 0.7 }]",
            "a share above 1": "orders = [{ order = 1, share = 1.1 }]",
            "a negative share": "orders = [{ order = 1, share = -0.1 }]",
            "a share of NaN": "orders = [{ order = 1, share = nan }]",
            "reflected shares above 1": "reflected_orders = [{ order = 1, share = 0.7 }, { order = 0, share = 0.7 }]",
            "a reflected order twice": "reflected_orders = [{ order = 0, share = 0.1 }, { order = 0, share = 0.2 }]",
            "an unknown efficiency": 'efficiency = "all"',
            "an efficiency above 1": "efficiency = 1.5",
            "an efficiency of NaN": "efficiency = nan",
            "an efficiency of unlike lists": "efficiency = { wavelengths_nm = [400.0, 700.0], values = [0.5] }",
            "an efficiency that gains": "efficiency = { wavelengths_nm = [400.0, 700.0], values = [0.5, 1.5] }",
            "a blaze without a design": 'efficiency = "blaze"',
            "a blaze of no wavelength": 'efficiency = "blaze", design_nm = 0.0',
            "a blaze of one level": 'efficiency = "blaze", design_nm = 550.0, levels = 1',
            "a blaze of the order 0": 'efficiency = "blaze", design_nm = 550.0, blaze_order = 0',
            "levels without a blaze": "levels = 4",
        }.items()
    },
}

PLACES = {"lens": "phase", "curved": "curved_phase", "flat": "flat_phase"}


def with_phase(phase: str, place: str) -> str:
    """Return the scene with a phase on a surface of the lens or on a face of the array."""
    text = SCENE.replace('diffraction = "lenslets"\n', "")
    old = "thickness_mm = 4.0, " if place == "lens" else "[camera.mla]\n"
    key = f"{PLACES[place]} = {phase}" + (", " if place == "lens" else "\n")
    assert text.count(old) == 1
    return text.replace(old, old + key)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("phase", WHOLE)
def test_the_phases_that_are_made_bad_are_good(phase: str, place: str) -> None:
    assert loads(with_phase(f"{{ {phase} }}", place)).camera


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("name", BAD)
def test_a_bad_phase_is_refused_by_its_key(name: str, place: str) -> None:
    with pytest.raises(LfmeshError) as refused:
        loads(with_phase(BAD[name], place), ".")
    assert PLACES[place] in str(refused.value)
    assert len(str(refused.value).splitlines()) <= 3
    is_read_or_refused(with_phase(BAD[name], place))


numbers = st.one_of(
    st.floats(-1e3, 1e3),
    st.sampled_from([0.0, 5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e15, -1e15, 1e200, -1e300, 1.7e308]),
)
whole = st.integers(-3, 40)
PHASES = st.one_of(
    st.fixed_dictionaries(
        {"kind": st.just("radial"), "coefficients_rad": st.lists(numbers, max_size=4), "radius_mm": numbers}
    ),
    st.fixed_dictionaries(
        {
            "kind": st.just("xy"),
            "coefficients_rad": st.lists(st.tuples(whole, whole, numbers).map(list), max_size=4),
            "radius_mm": numbers,
        }
    ),
    st.fixed_dictionaries({"kind": st.just("grating"), "lines_per_mm": numbers, "direction_deg": numbers}),
    st.fixed_dictionaries({"kind": st.just("metalens"), "focal_length_mm": numbers, "design_nm": numbers}),
    st.fixed_dictionaries(
        {
            "kind": st.just("hologram"),
            "construction_nm": numbers,
            **{f"point_{i}_mm": st.tuples(numbers, numbers, numbers).map(list) for i in (1, 2)},
            **{f"point_{i}": st.sampled_from(["real", "virtual"]) for i in (1, 2)},
        }
    ),
)
LIGHT = st.one_of(
    st.just({}),
    st.fixed_dictionaries({"order": st.one_of(whole, st.just(1000))}),
    st.fixed_dictionaries(
        {"orders": st.lists(st.fixed_dictionaries({"order": whole, "share": st.floats(0.0, 0.6)}), max_size=3)}
    ),
    st.fixed_dictionaries(
        {
            "efficiency": st.just("blaze"),
            "design_nm": numbers,
            "blaze_order": whole,
            "levels": st.sampled_from([2, 3, 65536, 65537]),
        }
    ),
)


def as_toml(value: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {as_toml(own)}' for key, own in value.items())} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(as_toml, value))}]"
    return repr(value) if isinstance(value, int | float) else f'"{value}"'


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(PHASES, LIGHT, st.sampled_from(sorted(PLACES)))
def test_a_harsh_phase_is_read_or_refused(shape: dict[str, Any], light: dict[str, Any], place: str) -> None:
    is_read_or_refused(with_phase(as_toml(shape | light), place))


@pytest.mark.long
@settings(max_examples=5_000, deadline=None, derandomize=True, database=None)
@given(PHASES, LIGHT, st.sampled_from(sorted(PLACES)))
def test_many_harsh_phases_are_read_or_refused(shape: dict[str, Any], light: dict[str, Any], place: str) -> None:
    is_read_or_refused(with_phase(as_toml(shape | light), place))
