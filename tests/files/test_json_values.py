"""JSON from a folder that its user brings: too deep a nesting is damage like any other."""

import ast
from collections.abc import Callable
from pathlib import Path

import pytest

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import matrix, shares
from lfmesh.files.json_values import parse_json
from lfmesh.files.run import prepare
from lfmesh.study.sweeps import study_folder

PACKAGE = Path(lf.__file__).parent

DEEP = "[" * 100_000
"""Brackets that Python's reader gives up on."""


def test_json_that_is_nested_too_deep_is_no_json() -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_json(DEEP)
    assert parse_json('{"a": [1, 2.5]}') == {"a": [1, 2.5]}


@pytest.mark.parametrize("name", ["report.json", "manifest.json"])
def test_a_folder_whose_json_is_nested_too_deep_is_not_taken_for_a_run(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(DEEP)
    with pytest.raises(FileError) as refused:
        prepare(tmp_path)
    assert "\n" not in str(refused.value)
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize(
    ("name", "read"),
    [
        (study_folder.FACTS, study_folder.read_facts),
        (shares.FACTS, shares._facts),
        (matrix.FACTS, lambda folder: matrix._begin(folder, {"a": 1}, 1)),
    ],
)
def test_facts_that_are_nested_too_deep_are_damaged(name: str, read: Callable[[Path], object], tmp_path: Path) -> None:
    (tmp_path / name).write_text(DEEP)
    with pytest.raises(FileError, match="damaged"):
        read(tmp_path)


def test_json_of_folders_is_parsed_in_one_place() -> None:
    own = {"files/json_values.py", "study/sweeps/probe.py"}  # the latter reads the words of its own process
    calls = [
        f"{path}: {ast.unparse(call)}"
        for part in ("files", "study")
        for path in sorted((PACKAGE / part).rglob("*.py"))
        if path.relative_to(PACKAGE).as_posix() not in own
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and ast.unparse(call.func) in ("json.loads", "json.load")
    ]
    assert not calls
