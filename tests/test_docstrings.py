"""Public names are documented to the end: parameters, results, errors and fields, in numpydoc's sections."""

import ast
import builtins
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cached_property
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel

import lfmesh

HIDDEN = {"faults", *dir(BaseModel)}
"""Members that users do not call: pydantic's, and what it calls."""

Sections = dict[str, list[str]]


def sections(doc: str) -> Sections:
    """Return the lines of each section of a docstring, by its head."""
    found: Sections = {}
    lines = inspect.cleandoc(doc).splitlines()
    for head, rule, number in zip(lines, lines[1:], range(len(lines)), strict=False):
        if re.fullmatch("-{3,}", rule):
            body = lines[number + 2 :]
            ends = [i for i, line in enumerate(body[1:]) if re.fullmatch("-{3,}", line)]
            found[head] = body[: ends[0]] if ends else body
    return found


def named(lines: list[str]) -> set[str]:
    """Return the names that the lines of a section explain."""
    heads = [line.split(" : ")[0] for line in lines if line and not line.startswith(" ")]
    return {name.strip().lstrip("*") for head in heads for name in head.split(",")}


def missing(function: Callable[..., Any], *, bound: bool) -> Iterator[str]:
    """Yield what the docstring of a function should say and does not."""
    parts = sections(function.__doc__ or "")
    parameters = list(inspect.signature(function).parameters)[bound:]
    told = named(parts.get("Parameters", [])) | named(parts.get("Other Parameters", []))
    yield from (f"parameter {name}" for name in parameters if name not in told and not name.startswith("_"))
    yield from (f"unknown parameter {name}" for name in sorted(told - set(parameters)))
    returned = inspect.signature(function).return_annotation
    if returned not in (None, "None") and not parts.keys() & {"Returns", "Yields"}:
        yield "result"
    raised = set(re.findall(r"^    +raise (\w+)\(", inspect.getsource(inspect.unwrap(function)), flags=re.MULTILINE))
    raised -= {"TypeError"}  # of Python's own call syntax: a keyword that the signature does not list
    explained = named(parts.get("Raises", []))
    known = {**vars(builtins), **inspect.unwrap(function).__globals__}
    yield from (
        f"error {name}" for name in sorted(raised) if not explained & {base.__name__ for base in known[name].__mro__}
    )


def undocumented_fields(kind: type) -> Iterator[str]:
    """Yield the fields of a dataclass that neither its docstring nor a text below them explains."""
    parts = sections(kind.__doc__ or "")
    told = named(parts.get("Attributes", [])) | named(parts.get("Parameters", []))
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
    assert isinstance(tree, ast.ClassDef)
    for field, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        name = field.target.id
        explained = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        if not name.startswith("_") and name not in told and not explained:
            yield name


def members(kind: type) -> Iterator[tuple[str, Any]]:
    """Yield the public members of a class that lfmesh has written."""
    for name in sorted(set(dir(kind)) - HIDDEN):
        member = inspect.getattr_static(kind, name)
        getter = getattr(member, "fget", None) or getattr(member, "func", None) or getattr(member, "__func__", member)
        if not name.startswith("_") and (getattr(getter, "__module__", None) or "").startswith("lfmesh"):
            yield name, member


def faults_of_member(member: Any) -> Iterator[str]:
    if isinstance(member, (property, cached_property)):
        getter = member.fget if isinstance(member, property) else member.func
        first = (getter.__doc__ or "").split(maxsplit=1)[:1]
        if first in ([], ["Return"], ["Returns"]):
            yield "a noun phrase"
    elif isinstance(member, (classmethod, staticmethod)):
        yield from missing(member.__func__, bound=isinstance(member, classmethod))
    elif inspect.isfunction(member):
        yield from missing(member, bound=True)


def faults_of_class(kind: type) -> Iterator[str]:
    if not kind.__doc__:
        yield "a docstring"
    if issubclass(kind, BaseModel):
        # `kind` tells one shape, light or medium from another, by its only value.
        yield from (name for name, field in kind.model_fields.items() if name != "kind" and not field.description)
    elif dataclasses.is_dataclass(kind):
        yield from undocumented_fields(kind)
    elif not issubclass(kind, (Enum, Exception)):
        told = named(sections(kind.__doc__ or "").get("Parameters", []))
        # `**settings` are the keys of a file, which its own model explains.
        listed = inspect.signature(kind).parameters if "settings" not in told else ()
        yield from (name for name in listed if name not in told)


@pytest.mark.parametrize("name", [name for name in lfmesh.__all__ if not name.startswith("_")])
def test_public_names_are_documented_to_the_end(name: str) -> None:
    public = getattr(lfmesh, name)
    if not isinstance(public, type):
        assert list(missing(public, bound=False)) == []
        return
    assert list(faults_of_class(public)) == []
    wanting = {member: list(faults_of_member(value)) for member, value in members(public)}
    assert {member: faults for member, faults in wanting.items() if faults} == {}


def asking(source: str) -> Iterator[str]:
    """Yield the texts of a module, docstrings and what stands below a field, that begin as a question does."""
    for node in ast.walk(ast.parse(source)):
        text = node.value.value if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) else None
        if isinstance(text, str) and re.match(r"(What|Where|How|Whether|Which|Why)\b", text):
            yield text.splitlines()[0]


def test_no_docstring_begins_as_a_question_does() -> None:
    package = Path(lfmesh.__file__).parent
    files = [*package.rglob("*.py"), *(package.parent / "tools").glob("*.py")]
    found = {str(path): list(asking(path.read_text(encoding="utf-8"))) for path in files}
    assert {path: texts for path, texts in found.items() if texts} == {}


def test_what_is_missing_is_explained_by_the_first_sentence_of_its_docstring() -> None:
    with pytest.raises(lfmesh.SceneError, match=r"power_w: missing: Power into all directions together, in W$"):
        lfmesh.PointLight(position_mm=(0.0, 0.0, 0.0))  # type: ignore[call-arg]


def test_a_point_inside_a_word_ends_no_sentence() -> None:
    with pytest.raises(lfmesh.SceneError, match=r"grid\.file: missing: Grid file, .* `\.npz`, .* data, `\.vti`$"):
        lfmesh.Medium(grid={})


def test_a_question_is_found_in_every_place() -> None:
    module = '"""What it is."""\n\nclass Thing:\n    """How it is."""\n\n    x: int\n    """Where."""\n'
    assert list(asking(module)) == ["What it is.", "How it is.", "Where."]


LACKS = ["parameter number", "result", "error ValueError"]
COMPLETE = "Do.\n\nParameters\n----------\nnumber : int\n\nReturns\n-------\nint\n"


@pytest.mark.parametrize(
    ("text", "wanting"),
    [
        ("Return it.", LACKS),
        (
            "Return it.\n\nParameters\n----------\nnumbers : int\n",
            [*LACKS[:1], "unknown parameter numbers", *LACKS[1:]],
        ),
        (COMPLETE, ["error ValueError"]),
        (f"{COMPLETE}\nRaises\n------\nValueError\n    It is negative.\n", []),
    ],
)
def test_what_a_docstring_lacks_is_found(text: str, wanting: list[str]) -> None:
    def example(number: int) -> int:
        if number < 0:
            raise ValueError(number)
        return number

    example.__doc__ = text
    assert list(missing(example, bound=False)) == wanting
