"""Media that bend light, of random keys, grids and places: refused in one line, or sound fields in boxes apart."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import LfmeshError
from lfmesh.geometry.index_media import boxes_overlap, index_media
from lfmesh.scene import Scene, loads
from tests.cameras import as_text, camera_without_array
from tests.fuzz.test_media import HARSH, in_one_line

LINES = (450.0, 650.0)


def rarely(harsh: Any, mild: Any) -> Any:
    """Return a strategy that draws a harsh value now and then, so that most media are sound but for one."""
    return st.integers(0, 39).flatmap(lambda k: harsh if k == 0 else mild)


def between(low: float, high: float) -> Any:
    return rarely(st.sampled_from(HARSH), st.floats(low, high))


lengths, turns = between(1.0, 60.0), st.tuples(*[st.floats(-400.0, 400.0)] * 3)
places = st.tuples(between(-40.0, 40.0), between(-40.0, 40.0), between(-500.0, -50.0))
near_one, small = between(0.9995, 1.0005), between(-1e-6, 1e-6)
formulas = st.one_of(
    st.builds(lambda c: {"kind": "radial_n", "index": 1.0, "coefficients": [c]}, small),
    st.builds(lambda n, c: {"kind": "radial_n2", "index": n, "coefficients": [c]}, between(1.0, 1.0003), small),
    st.builds(lambda c: {"kind": "axial", "index": 1.0, "coefficients": [c, c]}, small),
    st.builds(lambda c, r: {"kind": "spherical", "index": 1.0, "coefficients": [c], "radius_mm": r}, small, lengths),
    st.just({"kind": "axial"}),
)
density, constant, kpa, kelvin = between(0.0, 2.0), between(1e-5, 4e-4), between(0.0, 200.0), between(200.0, 2000.0)
boxes = st.builds(lambda *s: {"kind": "box", "size_mm": list(s)}, lengths, lengths, lengths)
bounds = rarely(st.just({"kind": "sphere", "radius_mm": 5.0}), boxes)
laws = st.one_of(
    st.fixed_dictionaries({"index": near_one}),
    st.fixed_dictionaries({"density_kg_m3": density}, optional={"gladstone_dale_m3_kg": constant}),
    st.fixed_dictionaries({"temperature_k": kelvin, "pressure_kpa": kpa}),
)
shapes = rarely(
    st.sampled_from([(), (3,), (0, 2, 2), (2, 2, 2, 2)]), st.tuples(*[st.integers(1, 6)] * 3)
)  # fmt: skip
others = st.fixed_dictionaries(
    {"position_mm": places},
    optional={"absorption_per_mm": between(0.0, 1.0), "rotation_deg": turns, "bounds": bounds},
)
by_keys = st.builds(
    lambda law, bounds, other: {"bounds": bounds} | other | law,
    st.one_of(laws, st.fixed_dictionaries({"index": formulas})), bounds, others,
)  # fmt: skip
in_grid = st.builds(
    lambda law, shape, spacing, kept, other: (
        # Some quantities are arrays of the grid, the others keys.
        other
        | {key: value for key, value in law.items() if key in kept}
        | {"grid": {"shape": shape, "spacing_mm": spacing} | {k: v for k, v in law.items() if k not in kept}}
    ),
    laws, shapes, lengths, st.sets(st.sampled_from(["gladstone_dale_m3_kg", "pressure_kpa", "temperature_k"])), others,
)  # fmt: skip
media = st.builds(
    lambda medium, more: medium | more, st.one_of(by_keys, in_grid), rarely(laws, st.just({}))
)  # fmt: skip


def written(medium: dict[str, Any], folder: Path, number: int) -> dict[str, Any]:
    """Return a medium with its grid in a file; its arrays vary from node to node."""
    if "grid" not in medium:
        return medium
    held = dict(medium["grid"])
    shape = held.pop("shape")
    waves = 1.0 + 1e-4 * np.random.default_rng(number).random(shape)
    arrays = {key: np.asarray(value) * (1.0 if key.endswith("_mm") else waves) for key, value in held.items()}
    np.savez(folder / f"g{number}.npz", **arrays)
    return medium | {"grid": f"g{number}.npz"}


def is_sound_or_refused(drawn: list[dict[str, Any]]) -> bool:
    """Insist on one refusal, or on fields of positive indices near that of air; return True for fields."""
    with tempfile.TemporaryDirectory() as name, np.errstate(all="ignore"):
        folder = Path(name)
        try:
            given = [written(medium, folder, k) for k, medium in enumerate(drawn)]
            scene = Scene(camera=camera_without_array(), media=given).in_folder(folder)  # type: ignore[arg-type]
            found = index_media(scene, LINES)
        except LfmeshError as error:
            in_one_line(error)
            return False
    draw = np.random.default_rng(0)
    for field in found:
        low, high = field.bounds_mm
        assert (low < high).all()
        assert np.isfinite(field.corners_mm()).all()
        on_face = low + (high - low) * draw.random((20, 3))
        on_face[:, 2] = high[2]
        for column in range(len(LINES)):
            assert (np.abs(field.indices(column, on_face) - 1.0) < 1.2e-3).all()
    assert not any(boxes_overlap(one, other) for i, one in enumerate(found) for other in found[:i])
    return bool(found)


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(st.lists(media, min_size=1, max_size=2))
def test_random_fields_are_sound_or_refused(drawn: list[dict[str, Any]]) -> None:
    is_sound_or_refused(drawn)


@pytest.mark.long
@settings(max_examples=10_000, deadline=None, derandomize=True, database=None)
@given(st.lists(media, min_size=1, max_size=3))
def test_many_random_fields_are_sound_or_refused(drawn: list[dict[str, Any]]) -> None:
    is_sound_or_refused(drawn)


BOX = {"kind": "box", "size_mm": [10.0, 10.0, 10.0]}
GOOD: list[dict[str, Any]] = [
    {"index": 1.0002},
    {"index": {"kind": "radial_n", "index": 1.0, "coefficients": [-1e-6]}},
    {"density_kg_m3": 1.1},
    {"density_kg_m3": 0.2, "gladstone_dale_m3_kg": 1.96e-4},
    {"temperature_k": 350.0, "pressure_kpa": 101.3},
]
WRONG = ["true", '"1.0"', "nan", "inf", "-inf", "[1.0]", "[]", "{ }", "-1.0", "1e400", "2020-01-01"]


@pytest.mark.parametrize("medium", GOOD)
def test_the_media_that_are_made_bad_are_good(medium: dict[str, Any]) -> None:
    assert is_sound_or_refused([medium | {"bounds": BOX, "position_mm": [0.0, 0.0, -100.0]}])


@pytest.mark.parametrize("value", WRONG)
@pytest.mark.parametrize("key", ["index", "density_kg_m3", "gladstone_dale_m3_kg", "pressure_kpa", "temperature_k"])
def test_a_value_of_another_kind_is_refused_by_its_key(key: str, value: str) -> None:
    """In a file whose other keys are right."""
    rest = next(medium for medium in reversed(GOOD) if isinstance(medium.get(key), float))
    text = as_text(camera=camera_without_array(), media=[rest | {"bounds": BOX}])
    lines = [f"{key} = {value}" if line.startswith(f"{key} = ") else line for line in text.splitlines()]
    assert f"{key} = {value}" in lines
    with pytest.raises(LfmeshError, match=rf"media\[0\]\.{key}|{key}") as caught:
        loads("\n".join(lines))
    in_one_line(caught.value)
