"""Scene files with values put in at random are read and reported on, or refused by a `SceneError`."""

import math
import re
import tomllib
from pathlib import Path

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import LfmeshError
from lfmesh.geometry.objects.placement import placements
from lfmesh.scene import loads
from lfmesh.scene.first_order.compute import first_order
from tests.cameras import bench_camera
from tests.processor_time import processor_seconds

BENCH = bench_camera(4, 4).replace(
    "thickness_mm = 4.0, index = 1.5", "thickness_mm = 4.0, glass = { nd = 1.5, vd = 60.0 }"
)
BENCH = BENCH.replace("\nindex = 1.5", '\nglass = "SCHOTT/N-BK7"')
BENCH = BENCH.replace("focus_mm = 500.0", "focus_mm = 500.0\nobject_medium = { index = 1.333 }")
BENCH = BENCH.replace("[camera.lens]", "image_medium = { index = 1.2 }\n[camera.lens]")

SCENE = f"""name = "bench"
{BENCH}reflectance = 0.1
cover = {{ thickness_mm = 0.2, gap_mm = 0.1, index = 1.5, coating = "none" }}
[camera.mla.pose]
shift_mm = [0.0, 0.0, 0.0]
[[targets]]
shape = {{ kind = "plane", width_mm = 60.0, height_mm = 60.0 }}
position_mm = [0.0, 0.0, -540.0]
rotation_deg = [0.0, 0.0, 0.0]
[targets.material]
reflectance = 0.8
[[tanks]]
size_mm = [20.0, 20.0, 20.0]
wall_mm = 2.0
position_mm = [0.0, 0.0, -300.0]
wall = {{ glass = {{ sellmeier_b = [1.1, 0.2], sellmeier_c_um2 = [0.01, 100.0] }} }}
liquid = {{ glass = {{ wavelengths_nm = [400.0, 550.0, 700.0], values = [1.34, 1.33, 1.32] }} }}
[[lights]]
kind = "point"
position_mm = [100.0, -100.0, -50.0]
power_w = 1.0
[[lights]]
kind = "line"
start_mm = [90.0, -100.0, -50.0]
end_mm = [90.0, 100.0, -50.0]
power_w = 1.0
[[lights]]
kind = "rectangle"
position_mm = [-90.0, 0.0, -50.0]
direction = [0.5, 0.0, -1.0]
width_mm = 20.0
height_mm = 30.0
turn_deg = 10.0
power_w = 1.0
[[tanks]]
size_mm = [20.0, 20.0, 20.0]
wall_mm = 1.0
position_mm = [0.0, 0.0, -300.0]
wall = {{ index = 1.52, absorption_per_mm = 0.01 }}
liquid = {{ index = 1.333, absorption_per_mm = {{ wavelengths_nm = [400.0, 700.0], values = [0.0, 0.1] }} }}
[[particles]]
count = 10
bounds = {{ kind = "sphere", radius_mm = 3.0 }}
position_mm = [0.0, 0.0, -500.0]
diameter_um = 10.0
phase = {{ kind = "henyey_greenstein", g = 0.5 }}
displacement = {{ kind = "uniform", vector_mm = [0.1, 0.0, 0.0] }}
frame = 1
samples = 4
[particles.sheet]
point_mm = [0.0, 0.0, -500.0]
normal = [0.0, 0.0, 1.0]
direction = [1.0, 0.0, 0.0]
thickness_mm = 1.0
width_mm = 9.0
power_w = 1.0
[transport]
samples = 2
replicates = 2
max_events = 64
weight_cutoff = 0.3
wavelengths_nm = [587.6]
seed = 0
threads = 0
diffraction = "lenslets"
"""

VALUES = [
    (match.start(1), match.end(1))
    for match in re.finditer(r"(?<=[=\[,{ ]) *(-?[0-9]+(?:\.[0-9]+)?|\"[^\"]*\")(?=[\n,}\] ])", SCENE)
]
"""Where numbers and texts stand in it."""

HARSH = [
    *["0", "0.0", "-0.0", "1", "-1", "1e-300", "5e-324", "1e-40", "1e-9", "1e9", "1e15", "1e16", "1e200", "-1e200"],
    *["1e300", "1.7e308", "nan", "inf", "-inf", "true", '""', '"\\u0000"', '"a\\nb"', f'"{"n" * 300}"', "[]", "{}"],
    *["1979-05-27", "9223372036854775807", "9223372036854775808", "9" * 4000, "9" * 5000, f"0x{'f' * 9000}"],
    *["[" * 5000 + "]" * 5000, f"[{{ {'a.' * 3000}b = 1 }}]", "[1, [2, [3]]]", "'''x'''"],
    *["{ nd = 10.0, vd = 1e-300 }", "{ nd = 1.0, vd = 1000.0 }", "{ nd = 1.5, vd = nan }", '{ table = "\\u0000" }'],
    *["{ sellmeier_b = [1e15, -1e15], sellmeier_c_um2 = [0.0, 1e15] }", "{ wavelengths_nm = [], values = [] }"],
]

KEYS = [
    *["asphere_mm = [1e300, -1e300]", "asphere_mm = [0.0, 1e200]", "conic = 1e15", "conic = -1e15", "file = '\\0'"],
    "qcon = { norm_radius_mm = 1e-9, coefficients_mm = [1.0, -1e9] }",
    "qcon = { norm_radius_mm = 5.0, coefficients_mm = [0.1, 1e300] }",
    "qbfs = { norm_radius_mm = 1e-9, coefficients_mm = [1.0, -1e9] }",
    "qbfs = { norm_radius_mm = 1e9, coefficients_mm = [1e-9] }",
    "qbfs = { norm_radius_mm = 30.0, coefficients_mm = [0.1, 1e300] }",
    *["odd_asphere_mm = [1e300, -1e300]", "odd_asphere_mm = [0.0, 0.0, 1e-9]"],
    *["biconic = { radius_x_mm = 1e-9 }", "biconic = { radius_x_mm = -30.0, conic_x = 1e15 }", "toroid = {}"],
    *["toroid = { radius_x_mm = inf }", "toroid = { radius_x_mm = -1e-9 }", "toroid = { radius_x_mm = 25.0 }"],
    *["outer_zone = {}", "outer_zone = { border_mm = 1e-9, radius_mm = 20.0 }"],
    "outer_zone = { border_mm = 2.0, radius_mm = -1e-9, conic = 1e15 }",
    "outer_zone = { border_mm = 2.0, radius_mm = inf, asphere_mm = [1e300, -1e300] }",
    "outer_zone = { border_mm = 1e15, radius_mm = 20.0, asphere_mm = [1e-3] }",
    "outer_zone = { border_mm = 2.0, radius_mm = 20.0, conic = -1.0 }",
]

numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-100.0, 100.0).map(repr),
    st.integers().map(str),
)
literals = st.one_of(st.sampled_from(HARSH), numbers)
edits = st.lists(st.tuples(st.sampled_from(VALUES), literals), min_size=1, max_size=4, unique_by=lambda edit: edit[0])


def changed(edits: list[tuple[tuple[int, int], str]]) -> str:
    text = SCENE
    for (start, end), value in sorted(edits, reverse=True):
        text = text[:start] + value + text[end:]
    return text


def is_read_or_refused(text: str, folder: str | Path = ".") -> None:
    """Insist on a report, or on one refusal of bounded length."""
    try:
        scene = loads(text, folder)
        lines = first_order(scene).lines()
        for placement in placements(scene):
            lines += placement.lines()
    except LfmeshError as error:
        message = str(error)
        assert message
        assert len(message.splitlines()) <= 22
        assert all(len(line) < 1000 for line in message.splitlines())
    else:
        assert lines


def test_the_scene_that_is_changed_at_random_is_valid() -> None:
    assert len(VALUES) > 40
    assert tomllib.loads(SCENE)
    assert SCENE.count("glass = ") == 4
    assert first_order(loads(SCENE)).lines()


@settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(edits)
def test_a_scene_with_random_values_is_read_or_refused(edits: list[tuple[tuple[int, int], str]]) -> None:
    is_read_or_refused(changed(edits))


@pytest.mark.long
@settings(max_examples=20_000, deadline=None, derandomize=True, database=None)
@given(edits)
def test_many_scenes_with_random_values_are_read_or_refused(edits: list[tuple[tuple[int, int], str]]) -> None:
    began = processor_seconds()
    is_read_or_refused(changed(edits))
    assert processor_seconds() - began < 20.0


@pytest.mark.parametrize("key", KEYS)
def test_a_lens_surface_with_a_harsh_key_is_read_or_refused(key: str) -> None:
    assert "thickness_mm = 4.0, " in SCENE
    is_read_or_refused(SCENE.replace("thickness_mm = 4.0, ", f"thickness_mm = 4.0, {key}, ", 1))


@pytest.mark.parametrize(
    "medium",
    [
        *["1.2", '"water"', "[]", "{}", "{ index = 1.0 }", "{ index = 0.5 }", "{ index = 10.0 }", "{ index = nan }"],
        *['{ glass = "SCHOTT/N-BK7" }', '{ glass = "main/H2O/Daimon-20.0C" }', "{ glass = { nd = 1.0, vd = 1e-300 } }"],
        *["{ index = 1.2, glass = 'SCHOTT/F2' }", "{ index = 1.5168000345005885 }", "{ index = 1.516800034500588 }"],
        "{ glass = { sellmeier_b = [1e15, -1e15], sellmeier_c_um2 = [0.0, 1e15] } }",
    ],
)
def test_a_harsh_medium_behind_the_lens_is_read_or_refused(medium: str) -> None:
    assert SCENE.count("image_medium = { index = 1.2 }") == 1
    is_read_or_refused(SCENE.replace("image_medium = { index = 1.2 }", f"image_medium = {medium}"))


def test_lenslets_of_a_glass_that_bends_no_light_are_refused() -> None:
    text = BENCH.replace('glass = "SCHOTT/N-BK7"', "glass = { nd = 1.0, vd = 60.0 }")
    assert text != BENCH
    with pytest.raises(LfmeshError, match=r"camera\.mla\.glass: has the index 1 beside the medium behind"):
        loads(text)


lengths = st.one_of(st.integers(1, 200).map(lambda n: n / 8), st.floats(0.01, 60.0))


def with_array(mla: dict[str, object], sensor_mm: float, pixel_mm: float) -> str:
    """Return the scene with an array in another place."""
    tables = tomllib.loads(SCENE)
    tables["camera"]["mla"] = mla
    tables["camera"]["sensor"] |= {"distance_mm": sensor_mm, "pixel_mm": pixel_mm}
    del tables["camera"]["focus_mm"]
    text = tomlkit.dumps(tables)
    assert tomllib.loads(text) == tables
    return text


@settings(max_examples=100, deadline=None, derandomize=True, database=None)
@given(*[lengths] * 6, st.sampled_from(["lens", "sensor"]), st.floats(1.0, 10.0))
def test_ordinary_arrays_and_sensors_are_reported_on_or_refused(
    pitch: float, focal: float, thickness: float, distance: float, sensor: float, pixel: float, side: str, index: float
) -> None:
    mla = {"count": [4, 4], "pitch_mm": pitch, "focal_length_mm": focal, "index": index, "thickness_mm": thickness}
    is_read_or_refused(with_array(mla | {"distance_mm": distance, "curved_side": side}, sensor, pixel))


numbers = st.one_of(st.floats(-3.0, 1.0), st.sampled_from([1e15, -1e15, 1e300, math.inf, 0.0]))
coefficients = st.lists(st.one_of(numbers, st.floats(-1e6, 1e6)), max_size=4)


@settings(max_examples=100, deadline=None, derandomize=True, database=None)
@given(
    st.lists(lengths, min_size=1, max_size=3),
    st.one_of(numbers, st.lists(numbers, max_size=4)),
    st.one_of(coefficients, st.lists(coefficients, max_size=4)),
    st.sampled_from([None, "x", "y", "z"]),
    st.sampled_from(["square", "hexagonal"]),
    st.floats(0.0, 0.2),
)
def test_lenslets_of_any_profile_are_reported_on_or_refused(
    radii: list[float], conic: object, terms: object, axis: str | None, layout: str, error: float
) -> None:
    mla = {"count": [4, 4], "pitch_mm": 2.0, "radius_mm": radii, "index": 1.5, "thickness_mm": 1.0, "layout": layout}
    mla |= {"conic": conic, "asphere_mm": terms, "distance_mm": 60.0, "form": {"radius_error": error}}
    is_read_or_refused(with_array(mla | ({"cylinder_axis": axis} if axis else {}), 3.0, 0.5))


focal_lengths = st.one_of(
    lengths, lengths.map(lambda f: -f), st.sampled_from([1e-29, -1e15, 1e300, 0.0, math.inf, -math.inf])
)


@settings(max_examples=40, deadline=None, derandomize=True, database=None)
@given(st.lists(st.tuples(focal_lengths, lengths, lengths), min_size=1, max_size=3), st.booleans(), lengths)
def test_thin_lenses_are_reported_on_or_refused(
    lenses: list[tuple[float, float, float]], with_stop: bool, focus: float
) -> None:
    tables = tomllib.loads(SCENE)
    surfaces: list[dict[str, object]] = [
        {"paraxial": True, "focal_length_mm": f, "thickness_mm": gap, "semi_diameter_mm": radius}
        for f, gap, radius in lenses
    ]
    if with_stop:
        surfaces.insert(0, {"stop": True, "thickness_mm": 1.0, "semi_diameter_mm": 4.0})
    else:
        surfaces[0]["stop"] = True
    surfaces[-1].pop("thickness_mm")
    tables["camera"] |= {"lens": {"surfaces": surfaces}, "focus_mm": 10.0 * focus}
    is_read_or_refused(tomlkit.dumps(tables))
