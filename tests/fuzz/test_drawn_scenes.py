"""Drawn cameras and scenes with hostile values at any key that a scene file may have are read, or refused in few lines.

The keys are those of the JSON Schema, so that a new one is tried without a word here.
"""

import copy
import math
import random
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
import tomlkit
from hypothesis import given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.assets import asset_path
from tests.fuzz.test_scenes import is_read_or_refused
from tests.random_scenes.generator import draw

Schema = dict[str, Any]
Table = dict[str, Any]

DRAWS = 6
"""Drawn cameras, and as many scenes, that are changed."""

HOSTILE = (
    *(0, 1, -1, 2**63, 10**40, 0.0, -0.0, 5e-324, 1e-300, 1e-9, 0.5, 1e9, 1e200, -1e200, 1.7e308),
    *(
        math.nan,
        math.inf,
        -math.inf,
        True,
        "",
        "\0",
        "x" * 300,
        "lib:nothing",
        [],
        {},
        [0.0, 0.0],
        [1e300, -1e300, 0.0],
    ),
    *([[]], [{}], [{"": 0}], {"wavelengths_nm": [550.0], "values": [1e300]}, {"kind": "sphere", "radius_mm": -1.0}),
)

SCHEMA: Schema = lf.Scene.model_json_schema(by_alias=True)


def objects(schema: Schema) -> Iterator[Schema]:
    """Yield the tables that a schema allows, of list items too."""
    if "$ref" in schema:
        yield from objects(SCHEMA["$defs"][schema["$ref"].rpartition("/")[2]])
    for each in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("prefixItems", ())):
        yield from objects(each)
    if isinstance(schema.get("items"), dict):
        yield from objects(schema["items"])
    if isinstance(schema.get("additionalProperties"), dict):
        # Tables by names that the user gives.
        yield {"properties": {"own": schema["additionalProperties"]}}
    if "properties" in schema:
        yield schema


def places(node: Any, schema: Schema) -> Iterator[tuple[Table, str, Schema]]:
    """Yield every key that each table of a scene has or may have, with its schema."""
    if isinstance(node, list | tuple):
        for each in node:
            yield from places(each, schema)
    if not isinstance(node, dict):
        return
    for allowed in objects(schema):
        if node.keys() <= allowed["properties"].keys():
            for key, of in allowed["properties"].items():
                yield node, key, of
                if key in node:
                    yield from places(node[key], of)


def hostile(schema: Schema, dice: random.Random) -> Any:
    """Return a value of which a part is valid by its type, and the rest hostile; tables have what they require."""
    if dice.random() < 0.3:
        return dice.choice(HOSTILE)
    tables = list(objects(schema))
    if tables:
        table = dice.choice(tables)
        some = dice.sample(sorted(table["properties"]), min(len(table["properties"]), 2))
        made = {
            key: hostile(table["properties"][key], dice) for key in dict.fromkeys([*table.get("required", ()), *some])
        }
        return [made] if schema.get("type") == "array" else made
    leaves = list(words_or_types(schema))
    return plausible(*dice.choice(leaves), dice) if leaves else dice.choice(HOSTILE)


def words_or_types(schema: Schema) -> Iterator[tuple[str, Any]]:
    """Yield the words that a schema allows, and its types."""
    for each in schema.get("anyOf", ()):
        yield from words_or_types(each)
    for word in (*schema.get("enum", ()), *((schema["const"],) if "const" in schema else ())):
        yield "word", word
    if "enum" not in schema and isinstance(schema.get("type"), str):
        yield schema["type"], schema


def plausible(kind: str, of: Any, dice: random.Random) -> Any:
    """Return a value that is valid by its type."""
    if kind == "word":
        return of
    if kind == "array":
        items = of.get("prefixItems") or [of.get("items") or {}] * of.get("minItems", 2)
        return [hostile(item, dice) if item else 1.0 for item in items]
    return {"boolean": True, "string": "x", "null": 0.0}.get(kind, dice.choice([1, 2, 0.5, 1.5, 40.0, 1e-6, 500.0]))


@cache
def drawn(number: int) -> Table:
    """Return the tables of a camera, or of a scene."""
    return draw("camera" if number < DRAWS else "scene", number % DRAWS).tables


def changed(number: int, changes: int, seed: int) -> str:
    """Return a drawn scene with hostile values as text."""
    tables, dice = copy.deepcopy(drawn(number)), random.Random(seed)
    for _ in range(changes):
        table, key, schema = dice.choice(list(places(tables, SCHEMA)))
        table[key] = hostile(schema, dice)
    return tomlkit.dumps(tables)


numbers = st.integers(0, 2 * DRAWS - 1)
seeds = st.integers(0, 2**32)


def test_every_key_of_a_scene_file_may_be_changed() -> None:
    """Those of tables that some drawn scene has, and those of tables that a key may hold."""
    reached, seen = set(), set()

    def below(schema: Schema) -> None:
        for table in objects(schema):
            if id(table) not in seen:
                seen.add(id(table))
                reached.update(table["properties"])
                for of in table["properties"].values():
                    below(of)

    for number in range(2 * DRAWS):
        for _, key, schema in places(drawn(number), SCHEMA):
            reached.add(key)
            below(schema)
    assert {name for of in SCHEMA["$defs"].values() for name in of.get("properties", ())} <= reached


@pytest.mark.parametrize("number", range(2 * DRAWS))
def test_the_scenes_that_are_changed_are_read(number: int) -> None:
    assert lf.loads(changed(number, 0, 0), asset_path("."))


@settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(numbers, st.integers(1, 3), seeds)
def test_a_drawn_scene_with_hostile_values_is_read_or_refused(number: int, changes: int, seed: int) -> None:
    is_read_or_refused(changed(number, changes, seed), asset_path("."))


@pytest.mark.long
@settings(max_examples=10_000, deadline=None, derandomize=True, database=None)
@given(numbers, st.integers(1, 3), seeds)
def test_many_drawn_scenes_with_hostile_values_are_read_or_refused(number: int, changes: int, seed: int) -> None:
    is_read_or_refused(changed(number, changes, seed), asset_path("."))
