"""Functions take few arguments: what belongs together is handed over as one value."""

import ast
import dataclasses
import inspect
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

import lfmesh

PACKAGE = Path(lfmesh.__file__).parent
MOST = 10
KERNELS = {"kernel", "inlined", "pasted"}
"""Decorators of what numba compiles, which takes tables apart before it is called."""


def test_completion_offers_public_names_only() -> None:
    assert dir(lfmesh) == sorted(lfmesh.__all__)


@pytest.mark.parametrize("name", lfmesh.__all__)
def test_every_public_name_lists_its_parameters(name: str) -> None:
    public = getattr(lfmesh, name)
    # An enumeration is called with one of its values, whatever signature a version of Python shows for that.
    if not callable(public) or (isinstance(public, type) and issubclass(public, Exception | Enum)):
        return
    kinds = {parameter.kind for parameter in inspect.signature(public).parameters.values()}
    assert not kinds & {inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL}


def test_listed_options_are_those_that_are_taken() -> None:
    shown, traced = (inspect.signature(function).parameters for function in (lfmesh.show, lfmesh.trace))
    assert {"count", "preset", "screenshot"} <= shown.keys()
    assert shown["preset"].default == "whole"
    assert traced["engine"].default == "mesh"
    assert {name for name, each in traced.items() if each.kind is each.KEYWORD_ONLY} == {
        *["stokes", "seed", "threads"],
        *["surface", "engine", "max_events", "weight_cutoff", "reference"],
    }


def tables(annotation: Any) -> set[type[BaseModel]]:
    """Return the classes of the tables that a value of some type holds, to any depth."""
    inner = set().union(*map(tables, get_args(annotation)))
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return inner.union({annotation}, *(tables(field.annotation) for field in annotation.model_fields.values()))
    return inner


def test_every_table_of_a_scene_has_a_public_class() -> None:
    found = tables(lfmesh.Scene)
    assert {"Medium", "Coating", "Layer", "Cover"} <= {each.__name__ for each in found}
    assert [each.__name__ for each in found if getattr(lfmesh, each.__name__, None) is not each] == []


SCREEN = 80 * 24


def parts_of(model: BaseModel) -> Iterator[BaseModel]:
    """Yield a model and all models inside."""
    yield model
    for name in type(model).model_fields:
        value = getattr(model, name)
        inner = value.values() if isinstance(value, dict) else value if isinstance(value, tuple) else (value,)
        for each in inner:
            if isinstance(each, BaseModel):
                yield from parts_of(each)


@pytest.mark.parametrize("name", ["first_light", "color_checker", "coated", "particles"])
def test_the_repr_of_every_part_of_a_scene_fits_on_a_screen(name: str) -> None:
    scene = lfmesh.load(PACKAGE.parent / "assets" / "scenes" / f"{name}.toml")
    parts = list(parts_of(scene))
    assert len(parts) > 10
    assert max(len(repr(part)) for part in parts) < SCREEN


def test_the_repr_of_a_table_has_what_was_given_and_makes_it_again() -> None:
    gloss = lfmesh.Gloss(index=1.5, roughness=0.2)
    assert repr(lfmesh.Transport(samples=8, split="transmit")) == "Transport(split='transmit', samples=8)"
    assert eval(repr(gloss), {"Gloss": lfmesh.Gloss}) == gloss


def test_no_public_class_shows_whole_arrays() -> None:
    for name in lfmesh.__all__:
        public = getattr(lfmesh, name)
        # The repr that dataclass makes has all fields.
        if dataclasses.is_dataclass(public) and hasattr(public.__repr__, "__wrapped__"):
            held = {field.name for field in dataclasses.fields(public) if field.repr and "ndarray" in str(field.type)}
            assert held <= {"spacing_mm", "origin_mm", "position_mm", "rotation_deg"}, name


def crowded(source: str) -> Iterator[tuple[str, int]]:
    """Yield the functions with too many parameters, kernels excepted, and how many they have."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        decorators = {name.id for item in node.decorator_list for name in ast.walk(item) if isinstance(name, ast.Name)}
        given = node.args
        number = len(given.posonlyargs) + len(given.args) + len(given.kwonlyargs)
        number += (given.vararg is not None) + (given.kwarg is not None)
        if number > MOST and not decorators & KERNELS:
            yield node.name, number


def test_no_function_has_more_than_ten_parameters() -> None:
    names = ", ".join(f"p{i}" for i in range(MOST + 1))
    assert list(crowded(f"def wide({names}): pass")) == [("wide", MOST + 1)]
    assert list(crowded(f"@kernel(nogil=True)\ndef wide({names}): pass")) == []
    found = {path: list(crowded(path.read_text(encoding="utf-8"))) for path in PACKAGE.rglob("*.py")}
    assert found
    assert not {str(path): names for path, names in found.items() if names}


def undescribed(tree: ast.AST) -> Iterator[str]:
    """Yield the public functions of three parameters or more whose docstring does not describe them."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from undescribed(node)
        if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
            continue
        given = node.args
        names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
        described = "Parameters\n" in (ast.get_docstring(node) or "")
        if len([name for name in names if name not in ("self", "cls")]) >= 3 and not described:
            yield node.name


def test_public_functions_of_three_parameters_describe_them() -> None:
    """Commands excepted, whose options carry their own help."""
    source = 'def plain(a, b, c):\n    """Return a."""\ndef _own(a, b, c): pass\ndef two(a, b): pass\n'
    assert list(undescribed(ast.parse(source))) == ["plain"]
    paths = [path for path in PACKAGE.rglob("*.py") if path.parent.name != "cli"]
    found = {str(path): list(undescribed(ast.parse(path.read_text(encoding="utf-8")))) for path in paths}
    assert not {path: names for path, names in found.items() if names}
