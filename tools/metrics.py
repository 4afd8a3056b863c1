"""Size of the package in figures, each beside its goal.

    tools/metrics                          this tree
    tools/metrics ../other-checkout        another one
    tools/metrics --list functions         the functions, files or enumerations that a figure counts

Lines of code leave out docstrings, those of attributes included, comments and blank lines.
"""

import argparse
import ast
import io
import sys
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

LONG_FILE = 500
"""A file is long from one line more on."""

MANY_ARGUMENTS = 8

LARGEST_CODE = 16

ENUMERATIONS = {"Enum", "IntEnum", "StrEnum", "Flag", "IntFlag"}
LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Source:
    """A file of the package.

    Attributes
    ----------
    place : Path
        Relative to the package.
    text : str
    """

    place: Path
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """Its syntax tree."""
        return ast.parse(self.text)

    @property
    def lines_of_code(self) -> int:
        """Number of lines with code."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        lines = {
            number for token in tokens if token.type not in LAYOUT for number in range(token.start[0], token.end[0] + 1)
        }
        return len(lines - set(self._docstring_lines()))

    def _docstring_lines(self) -> Iterator[int]:
        for node in ast.walk(self.tree):
            if (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)

    @property
    def lines(self) -> int:
        """Number of all lines."""
        return len(self.text.splitlines())

    @property
    def classes(self) -> list[ast.ClassDef]:
        """Its classes."""
        return [node for node in ast.walk(self.tree) if isinstance(node, ast.ClassDef)]

    @property
    def functions(self) -> list[Function]:
        """Its functions and methods."""
        return [node for node in ast.walk(self.tree) if isinstance(node, Function)]

    def public_functions(self) -> Iterator[Function]:
        """Yield the functions of the module and the methods of its classes whose names begin with a letter."""
        holders: list[ast.Module | ast.ClassDef] = [self.tree]
        for holder in holders:
            for node in holder.body:
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    holders.append(node)
                elif isinstance(node, Function) and not node.name.startswith("_"):
                    yield node


def sources(package: Path) -> list[Source]:
    """Read all files of the package."""
    return [Source(path.relative_to(package), path.read_text("utf-8")) for path in sorted(package.rglob("*.py"))]


def within(found: list[Source], *parts: str) -> list[Source]:
    """Return the files of some of its parts."""
    return [source for source in found if source.place.parts[0] in parts]


def arguments(function: Function, *, bound: bool = False) -> list[str]:
    """Return the names of a function's arguments, with `bound` those of a caller of a method."""
    given = function.args
    more = [each for each in (given.vararg, given.kwarg) if each is not None]
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs, *more)]
    return [name for name in names if name not in ("self", "cls")] if bound else names


def members(enumeration: ast.ClassDef) -> list[str]:
    """Return the names of the members of an enumeration."""
    assigned = [target for node in enumeration.body if isinstance(node, ast.Assign) for target in node.targets]
    return [node.id for node in assigned if isinstance(node, ast.Name) and not node.id.startswith("_")]


def enumerated(found: list[Source]) -> list[str]:
    """List the members of all enumerations of `transport/`."""
    classes = [(source, each) for source in within(found, "transport") for each in source.classes]
    enums = [
        (source, each) for source, each in classes if ENUMERATIONS & {ast.unparse(b).split(".")[-1] for b in each.bases}
    ]
    return [f"{source.place}: {each.name}.{name}" for source, each in enums for name in members(each)]


def codes(found: list[Source]) -> list[str]:
    """List the small integers that modules of `transport/` name outside enumerations: codes, and a few sizes."""
    return [f"{source.place}: {name}" for source in within(found, "transport") for name in _small_integers(source.tree)]


def _small_integers(module: ast.Module) -> Iterator[str]:
    for node in module.body:
        if not isinstance(node, ast.Assign):
            continue
        (target,) = node.targets
        names = target.elts if isinstance(target, ast.Tuple) else [target]
        values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
        if all(map(_is_small_integer, values)) or ast.unparse(node.value).startswith("range("):
            yield from (name.id for name in names if isinstance(name, ast.Name) and name.id.isupper())


def _is_small_integer(value: ast.expr) -> bool:
    if isinstance(value, ast.UnaryOp):
        value = value.operand
    return isinstance(value, ast.Constant) and type(value.value) is int and value.value <= LARGEST_CODE


def options(found: list[Source]) -> list[str]:
    """List the fields of `Options`."""
    classes = [each for source in within(found, "transport") for each in source.classes if each.name == "Options"]
    return [ast.unparse(node.target) for each in classes for node in each.body if isinstance(node, ast.AnnAssign)]


def long_files(found: list[Source]) -> list[str]:
    """List the long files."""
    return [f"{source.place}: {source.lines}" for source in found if source.lines > LONG_FILE]


def wide_functions(found: list[Source]) -> list[str]:
    """List the functions with many arguments."""
    named = [(source, each, len(arguments(each))) for source in found for each in source.functions]
    return [f"{source.place}: {each.name} {count}" for source, each, count in named if count >= MANY_ARGUMENTS]


def undescribed(found: list[Source]) -> list[str]:
    """List the public functions with arguments whose docstrings have no section Parameters."""
    return [f"{source.place}: {each.name}" for source, each in _public(found) if not _describes(each)]


def _public(found: list[Source]) -> list[tuple[Source, Function]]:
    return [(source, each) for source in found for each in source.public_functions() if arguments(each, bound=True)]


def _describes(function: Function) -> bool:
    return "Parameters\n" in (ast.get_docstring(function) or "")


@dataclass(frozen=True)
class Figure:
    """A figure and its goal; None: without one.

    Attributes
    ----------
    name : str
    goal : int or None
    count : callable
        Of all sources.
    listed : callable, optional
        What is counted, one a line.
    """

    name: str
    goal: int | None
    count: Callable[[list[Source]], int]
    listed: Callable[[list[Source]], list[str]] | None = None


def _counted(name: str, goal: int | None, listed: Callable[[list[Source]], list[str]]) -> Figure:
    return Figure(name, goal, lambda found: len(listed(found)), listed)


FIGURES = {
    "enumerated": _counted("enumerated values in transport/", 40, enumerated),
    "codes": _counted("small integers named outside enumerations, transport/", None, codes),
    "options": _counted("fields of Options", 12, options),
    "transport": Figure(
        "lines of code, transport/ and kernels/", 13_500,
        lambda found: sum(source.lines_of_code for source in within(found, "transport", "kernels")),
    ),
    "package": Figure("lines of code, package", 47_000, lambda found: sum(source.lines_of_code for source in found)),
    "files": _counted(f"files of more than {LONG_FILE} lines", 5, long_files),
    "functions": _counted(f"functions with {MANY_ARGUMENTS} arguments or more", 100, wide_functions),
    "undescribed": _counted("public functions with arguments, without Parameters", None, undescribed),
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser("tools/metrics", description="Size of the package in figures, beside the goals.")
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT, help="of another checkout; default: this one")
    listed = [key for key, figure in FIGURES.items() if figure.listed is not None]
    parser.add_argument("--list", choices=listed, help="list what a figure counts in place of the figures")
    given = parser.parse_args()
    found = sources(given.folder / "lfmesh")
    if not found:
        parser.exit(2, f"tools/metrics: {given.folder} holds no package lfmesh\n")
    if given.list is not None and (lines := FIGURES[given.list].listed) is not None:
        print("\n".join(lines(found)))
        return
    width = max(len(figure.name) for figure in FIGURES.values())
    print(f"{'':{width}}  {'now':>7}  {'goal':>7}")
    for figure in FIGURES.values():
        goal = "–" if figure.goal is None else f"{figure.goal:,}"
        print(f"{figure.name:{width}}  {figure.count(found):7,}  {goal:>7}")


if __name__ == "__main__":
    sys.exit(main())
