"""Reference pages that the program writes of itself: the keys of the files that it reads, and the commands.

Keys and commands are objects of the site (`docs_site`), which its search finds by name.
"""

import json
import re
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from io import StringIO
from typing import Any

from rich.console import Console

from lfmesh.cli import app
from lfmesh.scene import Scene
from lfmesh.scene.model import Model
from lfmesh.study.datasets.dataset_file import DatasetFile
from lfmesh.study.metrics.metrics import METRICS
from lfmesh.study.optimise.design_file import DesignFile
from lfmesh.study.optimise.figures import FIGURES
from lfmesh.study.sweeps.study_file import StudyFile

Schema = dict[str, Any]

GUIDE = "../../../lfmesh/study/README.md"
"""To studies, designs and datasets, from a page of the reference."""

COMMANDS = "../../../lfmesh/cli/README.md"


def file_pages() -> dict[str, str]:
    """Return the reference of each kind of file that lfmesh reads, one section a table, by the name of the page."""
    return {
        "scene": _file_page(
            Scene,
            "Keys of a scene file",
            "A scene file is TOML. Every number carries its unit in its name. `lfmesh schema` prints this page as JSON "
            "Schema, by which editors complete; [The scene file](../../../lfmesh/scene/README.md) explains by example.",
        ),
        "study": _file_page(
            StudyFile,
            "Keys of a study file",
            f"A study file is TOML, and `lfmesh study` takes it. [Studies]({GUIDE}#the-study-file) explain by example.",
            *("Metrics and their columns", _metrics()),
        ),
        "design": _file_page(
            DesignFile,
            "Keys of a design file",
            f"A design file is TOML, and `lfmesh optimise` takes it. [Designs]({GUIDE}#designs) explain by example.",
            *("Metrics of merit and constraints", _figures()),
        ),
        "dataset": _file_page(
            DatasetFile,
            "Keys of a dataset file",
            f"A dataset file is TOML, and `lfmesh dataset` takes it. [Datasets]({GUIDE}#datasets) explain by example.",
        ),
    }


def _file_page(
    model: type[Model], title: str, about: str, named: str = "", names: Iterable[tuple[str, str]] = ()
) -> str:
    """Return the page of a kind of file, with a table of the names that one of its keys takes."""
    schema = model.model_json_schema()
    tables = schema.pop("$defs", {})
    lines = [f"# {title}", "", about, "", *_section(model.__name__, schema)]
    for name in sorted(tables):
        lines += _section(name, tables[name])
    if named:
        lines += [f"## {named}", "", "| name | what it is |", "|---|---|"]
        lines += [f"| {name} | {plain(words)} |" for name, words in names]
    return "\n".join(lines) + "\n"


def _metrics() -> Iterator[tuple[str, str]]:
    """Yield the metrics of studies with the columns that each brings to the table."""
    for name, metric in METRICS.items():
        columns = "; ".join(f"`{column.name}`: {column.title}" for column in metric.columns)
        yield f"`{name}`", columns or "in `times.csv`, as times differ from run to run"


def _figures() -> Iterator[tuple[str, str]]:
    """Yield the figures that a merit may name, those of one title together."""
    names: dict[str, list[str]] = defaultdict(list)
    for name, figure in FIGURES.items():
        names[figure.title].append(f"`{name}`")
    for title, each in names.items():
        yield ", ".join(each), title


def _section(name: str, table: Schema) -> Iterator[str]:
    yield f"(table-{name.lower()})="
    yield f"## {name}"
    yield ""
    yield plain(table.get("description", ""))
    yield ""
    required = table.get("required", ())
    for key, field in table.get("properties", {}).items():
        fixed = f"`{json.dumps(field['const'])}`" if "const" in field else ""
        type_ = fixed or type_in_words(field)
        default = "" if field.get("default") in (None, [], {}) or fixed else f", default `{toml(field['default'])}`"
        yield f"```{{key}} {name}.{key}"
        yield f"{type_}{', required' if key in required else default}"
        yield ""
        yield plain(field.get("description", "")) or "(no description)"
        yield "```"
        yield ""


def _section_link(name: str) -> str:
    return f"[{name}](#table-{name.lower()})"


def type_in_words(field: Schema, link: Callable[[str], str] = _section_link) -> str:
    """Return the values that a schema allows, with links to tables.

    Parameters
    ----------
    field : dict
        JSON Schema of the value.
    link : callable, optional
        Returns the link to the table of a model, by the model's name.
    """
    if "$ref" in field:
        return link(field["$ref"].rsplit("/", 1)[1])
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return " or ".join(f"`{json.dumps(value)}`" for value in field["enum"])
    for key in ("anyOf", "oneOf"):
        if key in field:
            kinds = [type_in_words(each, link) for each in field[key] if each.get("type") != "null"]
            return " or ".join(dict.fromkeys(kinds))
    kind = field.get("type")
    if kind == "array":
        return _list_in_words(field, link)
    if kind == "object":
        values = field.get("additionalProperties")
        return f"table of {type_in_words(values, link)} by name" if isinstance(values, dict) else "table"
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "`true` or `false`"}
    return words.get(str(kind), "any value") + _limits(field)


def _list_in_words(field: Schema, link: Callable[[str], str]) -> str:
    items = field.get("prefixItems")
    if items is not None:
        kinds = list(dict.fromkeys(type_in_words(each, link) for each in items))
        return f"list of {len(items)}: {kinds[0] if len(kinds) == 1 else ', '.join(kinds)}"
    return f"list of {type_in_words(field['items'], link)}" if "items" in field else "list"


def _limits(field: Schema) -> str:
    signs = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
    said = [f"{sign} {field[key]:g}" for key, sign in signs.items() if key in field and abs(field[key]) < 1e9]
    return f" ({', '.join(said)})" if said else ""


def toml(value: Any) -> str:
    """Return a default as a file would have it.

    Parameters
    ----------
    value : object
    """
    return "inf" if value == float("inf") else json.dumps(value, ensure_ascii=False)


def plain(text: str) -> str:
    """Return a description on one line, with nothing that Markdown would take for markup."""
    parts = re.split(r"(`[^`]*`)", " ".join(text.split()))
    return "".join(part if part.startswith("`") else re.sub(r"([*_<>\[\]{}$])", r"\\\1", part) for part in parts)


def commands_page() -> str:
    """Return the reference of the command line, from the help of each command."""
    lines = ["# Options of the commands", "", "Each command prints this with `--help`."]
    lines += [f"`lfmesh --help` lists the commands by task; [The commands]({COMMANDS}) explains them.", ""]
    for words in commands(app):
        name = " ".join(words)
        lines += [f"## lfmesh {name}", "", f"```{{command}} {name}", ":no-typesetting:", "```", ""]
        lines += ["```text", _help(words), "```", ""]
    return "\n".join(lines)


def commands(program: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words that call each command, in alphabetical order."""
    for name in sorted(name for name in program if not name.startswith("-")):
        command = program[name]
        if any(not inner.startswith("-") for inner in command):
            yield from commands(command, (*words, name))
        else:
            yield (*words, name)


def _help(words: tuple[str, ...]) -> str:
    out = StringIO()
    app.help_print(list(words), console=Console(file=out, width=88, color_system=None))
    return "\n".join(line.rstrip() for line in out.getvalue().strip().splitlines())
