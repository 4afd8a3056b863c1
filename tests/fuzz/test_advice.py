"""Values that refusals advise are accepted when they are taken."""

import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfmesh.errors import SceneError
from lfmesh.scene import Scene, solved
from tests.cameras import biconvex

ADVICE = re.compile(
    r"(?:give|here|must be|plate of) (?P<least>-?[0-9.e+-]+)(?: mm)? or (?:more|less)(?! in magnitude)"
    r"|give (?P<most>[0-9.e+-]+) at most|thickness_mm at most (?P<below>[0-9.e+-]+)"
)

PATHS = {
    "camera.focus_mm": st.floats(1.0, 300.0),
    "camera.lens.surfaces[0].radius_mm": st.floats(3.0, 60.0),
    "camera.lens.surfaces[1].radius_mm": st.floats(-60.0, -3.0),
    "camera.lens.surfaces[0].conic": st.floats(-3.0, 5.0),
    "camera.lens.surfaces[0].thickness_mm": st.floats(0.0, 6.0),
    "camera.lens.surfaces[0].asphere_mm": st.lists(st.floats(-1e-3, 1e-3), max_size=2),
    "camera.lens.surfaces[0].semi_diameter_mm": st.floats(1.0, 12.0),
    "camera.lens.surfaces[1].semi_diameter_mm": st.floats(1.0, 12.0),
    "camera.lens.surfaces[1].thickness_mm": st.floats(0.0, 6.0),
    "camera.mla.focal_length_mm": st.lists(st.floats(-4.0, 4.0), min_size=1, max_size=3),
    "camera.mla.index": st.floats(1.2, 2.0),
    "camera.mla.pitch_mm": st.floats(0.01, 3.0),
    "camera.mla.thickness_mm": st.floats(0.01, 6.0),
    "camera.sensor.distance_mm": st.floats(-1.0, 3.0),
    "transport.weight_cutoff": st.floats(-1.0, 2.0),
    "transport.max_events": st.integers(-5, 100_000),
}


def tables(values: dict[str, object]) -> dict[str, object]:
    """Return the tables of a scene with these values, which need not be valid."""
    camera = {
        "focus_mm": 60.0,
        "lens": biconvex(),
        "mla": {"count": [4, 4], "pitch_mm": 0.5, "focal_length_mm": [2.6], "index": 1.5, "thickness_mm": 0.5},
        "sensor": {"pixels": [8, 8], "pixel_mm": 0.1},
    }
    data: dict[str, object] = {"camera": camera, "transport": {}}
    for path, value in values.items():
        put(data, path, value)
    return data


def put(data: dict[str, object], path: str, value: object) -> None:
    *parents, last = (int(s) if s.isdigit() else s for s in re.findall(r"\w+", path))
    place: object = data
    for step in parents:
        place = place[step]  # type: ignore[index]
    place[last] = value  # type: ignore[index]


def refusals(data: dict[str, object]) -> list[str]:
    try:
        solved(Scene(**data))
    except SceneError as error:
        return [line.strip().removeprefix("Scene.") for line in str(error).splitlines()]
    return []


def kind(line: str) -> str:
    """Return a refusal without its numbers, but for those of its path."""
    path, text = re.split(r"(?= = |: )", line, maxsplit=1)
    return path + re.sub(r"-?[0-9][0-9.e+-]*", "#", text)


def taken(line: str) -> list[tuple[str, object]]:
    """Return the values that a refusal advises, with the fields that they are for."""
    path, *_ = re.split(r" = |: ", line, maxsplit=1)
    changes: list[tuple[str, object]] = []
    for found in ADVICE.finditer(line):
        value = float(next(text for text in found.groups() if text is not None))
        if found["below"] or "plate of" in found[0]:
            changes.append(("camera.mla.thickness_mm", value))
        elif path.startswith("camera.mla.focal_length_mm"):
            changes.append(("camera.mla.focal_length_mm", [value]))
        else:
            changes.append((path, int(value) if path == "transport.max_events" else value))
    return changes


def insist_that_advice_holds(values: dict[str, object]) -> int:
    """Take every value that a scene's refusals advise, one by one; return how many there were."""
    count = 0
    for line in refusals(tables(values)):
        for path, value in taken(line):
            again = tables(values)
            put(again, path, value)
            # Of a list of focal lengths one is advised upon; any other may be refused for its own sake.
            assert kind(line) not in map(kind, refusals(again)), f"{line}\n  with {path} = {value!r}"
            count += 1
    return count


choices = st.lists(st.sampled_from(list(PATHS)), min_size=1, max_size=4, unique=True)
scenes = choices.flatmap(lambda paths: st.fixed_dictionaries({path: PATHS[path] for path in paths}))


@settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(scenes)
def test_advised_values_are_accepted(values: dict[str, object]) -> None:
    insist_that_advice_holds(values)


@pytest.mark.long
@settings(max_examples=5_000, deadline=None, derandomize=True, database=None)
@given(scenes)
def test_advised_values_are_accepted_in_many_scenes(values: dict[str, object]) -> None:
    insist_that_advice_holds(values)


@pytest.mark.parametrize(
    "values",
    [
        {"camera.focus_mm": 10.0},
        {"camera.lens.surfaces[0].semi_diameter_mm": 31.0},
        {"camera.lens.surfaces[0].thickness_mm": 0.1, "camera.lens.surfaces[0].radius_mm": 11.0},
        {"camera.mla.thickness_mm": 3.91},
        {"camera.mla.focal_length_mm": [0.3]},
        {"camera.mla.focal_length_mm": [-0.3]},
        {"camera.mla.thickness_mm": 0.01},
    ],
)
def test_the_refusals_that_advise_are_found(values: dict[str, object]) -> None:
    assert insist_that_advice_holds(values) > 0
