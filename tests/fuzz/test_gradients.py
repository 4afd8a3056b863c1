"""Gradients of lens and array in scene files: bad ones are refused by name, harsh ones are read or refused."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import LfmeshError
from lfmesh.scene import loads
from tests.fuzz.test_phases import as_toml
from tests.fuzz.test_scenes import SCENE, is_read_or_refused

RADIAL = 'kind = "radial_n2", index = 1.6, coefficients = [-3e-3]'
DISPERSION = "dispersion = { reference_nm = 587.6, strengths = [[1.0]], resonances_um2 = [[0.01]] }"
WHOLE = (
    RADIAL,
    f'kind = "radial_n", index = 1.6, coefficients = [-2e-3, 1e-6], axial_coefficients = [0.01], {DISPERSION}',
    'kind = "axial", index = 1.6, coefficients = [0.02, -1e-3]',
    'kind = "spherical", index = 1.6, radius_mm = -40.0, coefficients = [0.02]',
    'kind = "xyz", index = 1.6, x_coefficients = [0.0, -1e-3], z_coefficients = [0.01]',
    'kind = "selfoc", index = [1.5477, 6e-3], gradient_constant_per_mm = [0.03, 7e-4, 3e-5]',
    'kind = "gradium", coefficients = [1.7, -0.03, 0.2], blank_mm = 12.0, offset_mm = 5.0',
)
RODS = '{ kind = "radial_n2", index = 1.6, coefficients = [-3.0] }'
"""Of an array of 0.125 mm, 0.3 mm thick."""

BAD = {
    "no table": "1",
    "no kind": "{ }",
    "an unknown kind": '{ kind = "quadratic", index = 1.6 }',
    "keys of another kind": f"{{ {RADIAL}, radius_mm = 9.0 }}",
    "no index": '{ kind = "radial_n2", coefficients = [-3e-3] }',
    "an index of NaN": '{ kind = "radial_n2", index = nan, coefficients = [-3e-3] }',
    "an index below 1": '{ kind = "radial_n2", index = 0.9, coefficients = [-3e-3] }',
    "an index of glass": '{ kind = "radial_n2", index = "SCHOTT/N-BK7", coefficients = [-3e-3] }',
    "no coefficients": '{ kind = "radial_n2", index = 1.6 }',
    "an empty list": '{ kind = "radial_n2", index = 1.6, coefficients = [] }',
    "a number for a list": '{ kind = "radial_n2", index = 1.6, coefficients = -3e-3 }',
    "a coefficient of NaN": '{ kind = "radial_n2", index = 1.6, coefficients = [-3e-3, nan] }',
    "a coefficient of infinity": '{ kind = "radial_n2", index = 1.6, coefficients = [inf] }',
    "a coefficient of text": '{ kind = "radial_n2", index = 1.6, coefficients = ["-3e-3"] }',
    "terms with powers": '{ kind = "radial_n2", index = 1.6, coefficients = [[2, -3e-3]] }',
    "too many coefficients": f'{{ kind = "radial_n2", index = 1.6, coefficients = [{"1e-9, " * 99}] }}',
    "spherical without a radius": '{ kind = "spherical", index = 1.6, coefficients = [0.02] }',
    "spherical of no radius": '{ kind = "spherical", index = 1.6, radius_mm = 0.0, coefficients = [0.02] }',
    "spherical of NaN": '{ kind = "spherical", index = 1.6, radius_mm = nan, coefficients = [0.02] }',
    "xyz without terms": '{ kind = "xyz", index = 1.6 }',
    "selfoc of two constants": '{ kind = "selfoc", index = [1.5, 0.0], gradient_constant_per_mm = [0.3, 0.0] }',
    "selfoc by a name": f'{{ {WHOLE[5]}, material = "SLS-1.0" }}',
    "gradium without a blank": '{ kind = "gradium", coefficients = [1.7] }',
    "gradium of no length": '{ kind = "gradium", coefficients = [1.7], blank_mm = 0.0 }',
    "gradium of NaN": '{ kind = "gradium", coefficients = [1.7], blank_mm = 12.0, offset_mm = nan }',
    "a dispersion of one list": '{ kind = "axial", index = 1.6, coefficients = [0.0], dispersion = [1.0] }',
    "a dispersion without a wavelength": (
        '{ kind = "axial", index = 1.6, coefficients = [0.0], dispersion = '
        "{ strengths = [[1.0]], resonances_um2 = [[0.01]] } }"
    ),
    "a dispersion of unlike lists": (
        '{ kind = "axial", index = 1.6, coefficients = [0.0], dispersion = '
        "{ reference_nm = 587.6, strengths = [[1.0], [1.0]], resonances_um2 = [[0.01]] } }"
    ),
    "a gradient beside an index": f"{{ {RADIAL} }}, index = 1.5",
    "a gradient beside a glass": f'{{ {RADIAL} }}, glass = "SCHOTT/N-BK7"',
    "an index below 1 on the axis": '{ kind = "axial", index = 1.6, coefficients = [-3.0] }',
}


def with_gradient(gradient: str, place: str) -> str:
    """Return the scene with a gradient in the lens or in the plate of the array."""
    text = SCENE.replace('diffraction = "lenslets"\n', "")
    old, new = {
        "lens": ("glass = { nd = 1.5, vd = 60.0 }", f"gradient = {gradient}"),
        "array": ('focal_length_mm = 0.7\nglass = "SCHOTT/N-BK7"\n', f"gradient = {gradient}\n".replace("}, ", "}\n")),
    }[place]
    assert text.count(old) == 1
    return text.replace(old, new)


@pytest.mark.parametrize("gradient", WHOLE)
def test_the_gradients_that_are_made_bad_are_good(gradient: str) -> None:
    assert loads(with_gradient(f"{{ {gradient} }}", "lens")).camera


def test_the_rods_that_are_made_bad_are_good() -> None:
    assert loads(with_gradient(RODS, "array")).camera


@pytest.mark.parametrize("place", ["lens", "array"])
@pytest.mark.parametrize("name", BAD)
def test_a_bad_gradient_is_refused_by_its_key(name: str, place: str) -> None:
    with pytest.raises(LfmeshError) as refused:
        loads(with_gradient(BAD[name], place), ".")
    assert "gradient" in str(refused.value)
    assert len(str(refused.value).splitlines()) <= 3
    is_read_or_refused(with_gradient(BAD[name], place))


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("radius_mm = -50.0, ", 'radius_mm = -50.0, finish = "diffuse", ', "finish"),
        ("radius_mm = 50.0, ", 'radius_mm = 50.0, finish = { kind = "ground", roughness = 0.1 }, ', "finish"),
        ("radius_mm = -50.0, ", 'radius_mm = -50.0, phase = { kind = "grating", lines_per_mm = 9.0 }, ', "phase"),
        ("radius_mm = -50.0, ", 'radius_mm = -50.0, coating = "film", ', "coating"),
        ("[camera.mla]\n", "elements = [{ surfaces = [1], pose = { tilt_deg = [1.0, 0.0, 0.0] } }]\n[camera.mla]\n",
         "gradient"),
        ("thickness_mm = 0.0, ", f"thickness_mm = 0.0, gradient = {{ {RADIAL} }}, ", "gradient"),
        ("[transport]\n", '[transport]\nengine = "mesh"\n', "gradient"),
        ("[transport]\n", "[transport]\npolarisation = true\n", "polarisation"),
        ("[transport]\n", '[transport]\nsurface = "patch"\n', "gradient"),
    ],
)  # fmt: skip
def test_what_a_gradient_excludes_is_refused_by_its_key(old: str, new: str, key: str) -> None:
    text = with_gradient(f"{{ {RADIAL} }}", "lens")
    assert text.count(old) == 1
    films = "[coatings.film]\nlayers = [{ index = 1.38, thickness_nm = 106.5 }]\n"
    with pytest.raises(LfmeshError, match=key):
        loads(text.replace(old, new) + (films if "film" in new else ""), ".")


numbers = st.one_of(
    st.floats(-10.0, 10.0),
    st.sampled_from([0.0, 5e-324, 1e-300, 1e-30, 1e-9, 1e9, 1e15, -1e15, 1e200, -1e300, 1.7e308]),
)
lists = st.lists(numbers, max_size=4)
indices = st.one_of(st.floats(1.0, 10.0), numbers)
dispersions = st.one_of(
    st.none(),
    st.fixed_dictionaries(
        {
            "reference_nm": numbers,
            "strengths": st.lists(lists, max_size=3),
            "resonances_um2": st.lists(lists, max_size=3),
        }
    ),
)


def gradients(kind: str, **keys: Any) -> Any:
    return st.fixed_dictionaries({"kind": st.just(kind), **keys})


GRADIENTS = st.one_of(
    gradients("radial_n2", index=indices, coefficients=lists),
    gradients("radial_n", index=indices, coefficients=lists, axial_coefficients=lists, dispersion=dispersions),
    gradients("axial", index=indices, coefficients=lists, dispersion=dispersions),
    gradients("spherical", index=indices, radius_mm=numbers, coefficients=lists, dispersion=dispersions),
    gradients("xyz", index=indices, x_coefficients=lists, y_coefficients=lists, z_coefficients=lists),
    gradients(
        "selfoc",
        index=st.tuples(indices, numbers).map(list),
        gradient_constant_per_mm=st.tuples(numbers, numbers, numbers).map(list),
    ),
    gradients("gradium", coefficients=lists, blank_mm=numbers, offset_mm=numbers, dispersion=dispersions),
)


def as_text(gradient: dict[str, Any]) -> str:
    return as_toml({key: value for key, value in gradient.items() if value is not None})


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(GRADIENTS, st.sampled_from(["lens", "array"]))
def test_a_harsh_gradient_is_read_or_refused(gradient: dict[str, Any], place: str) -> None:
    is_read_or_refused(with_gradient(as_text(gradient), place))


@pytest.mark.long
@settings(max_examples=5_000, deadline=None, derandomize=True, database=None)
@given(GRADIENTS, st.sampled_from(["lens", "array"]))
def test_many_harsh_gradients_are_read_or_refused(gradient: dict[str, Any], place: str) -> None:
    is_read_or_refused(with_gradient(as_text(gradient), place))
