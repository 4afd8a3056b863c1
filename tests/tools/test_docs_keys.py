"""The tables of keys in the guide to the scene file: whole, of the models' own words, one line for each key."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from lfmesh.scene import Scene
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.model import Model
from lfmesh.scene.objects.gltf_keys import GltfFile

ROOT = Path(__file__).resolve().parents[2]
GUIDE = (ROOT / "lfmesh" / "scene" / "README.md").read_text(encoding="utf-8")

LONGEST_CELL = 200
"""Characters of a cell that still reads as a line."""


@pytest.fixture
def keys(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("docs_keys")


def tables() -> Iterator[tuple[list[str], list[list[str]]]]:
    """The names of the models of each table, and its rows."""
    marked = r"^<!-- keys: ([^>]+) -->$(.*?)^<!-- end of keys -->$"
    for names, text in re.findall(marked, GUIDE, re.MULTILINE | re.DOTALL):
        lines = [line for line in text.splitlines() if line]
        yield names.split(", "), [re.split(r"(?<!\\)\|", line)[1:-1] for line in lines]


def models(*roots: type[Model]) -> dict[str, type[Model]]:
    """Every class of a scene file by its name, without those that only others derive from."""
    found: dict[str, type[Model]] = {}
    for root in roots:
        for kind in root.__subclasses__():
            found |= {kind.__name__: kind} | models(kind)
    return found


def test_keys_in_the_guide_are_written_from_the_models(keys: ModuleType) -> None:
    assert keys.filled(GUIDE) == GUIDE, "run tools/docs_keys.py"


def test_every_key_of_a_model_has_one_line_in_the_guide() -> None:
    known = models(Model)
    for names, (head, _, *rows) in tables():
        key = [cell.strip() for cell in head].index("key")
        lines = [row[key].strip(" `") for row in rows]
        assert set(lines) == {field for name in names for field in known[name].model_fields}, names
        assert len(names) > 1 or len(lines) == len(set(lines)), names


def test_tables_of_the_scene_file_that_are_no_schema_of_their_own_are_in_the_guide() -> None:
    in_guide = {name for names, _ in tables() for name in names}
    assert {kind.__name__ for kind in GltfFile.__subclasses__()} | {Finish.__name__, Scene.__name__} <= in_guide


def test_no_cell_of_the_guide_holds_a_paragraph() -> None:
    cells = [cell for line in GUIDE.splitlines() if line.startswith("|") for cell in re.split(r"(?<!\\)\|", line)]
    assert max(map(len, cells)) <= LONGEST_CELL, max(cells, key=len)


def test_a_row_that_is_lost_or_edited_comes_back(keys: ModuleType) -> None:
    (meaning,) = [line for line in GUIDE.splitlines() if line.startswith("| `gap_mm` |")]
    assert keys.filled(GUIDE.replace(f"{meaning}\n", "")) == GUIDE
    assert keys.filled(GUIDE.replace(meaning, meaning.replace("required", "0.1"))) == GUIDE


def test_an_omitted_key_stands_in_the_column_of_defaults(keys: ModuleType) -> None:
    field = {
        "type": "number",
        "description": 'Width by edge_deg, in mm. More of it. Needs bands. Omitted: "none" and { a = 1 }.',
    }
    (row,) = keys.rows_of({"properties": {"edge_mm": field}}, {})
    assert row == ("edge_mm", "number", "mm", '`"none"` and `{ a = 1 }`', "Width by `edge_deg`. Needs bands.")


@pytest.mark.parametrize(
    ("change", "message"),
    [(("<!-- keys: Cover -->", ""), "no table of keys for: Cover"), (("keys: Cover", "keys: Air"), "Air is no model")],
)
def test_a_model_without_a_table_of_its_own_is_refused(keys: ModuleType, change: tuple[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        keys.filled(GUIDE.replace(*change))
