"""Write the tables of keys in the guide to the scene file, from the models that read the file.

    .venv/bin/python tools/docs_keys.py

A line `<!-- keys: Model, Model -->` in the guide begins a table of the keys of these models, and `<!-- end of keys -->`
ends it. Text between the two is replaced. A row holds the first sentence of the key's description, and the short ones
after it that name an alternative or a condition; the sentence "Omitted: ..." becomes the default.
"""

import re
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from docs_reference import Schema, plain, toml, type_in_words

from lfmesh.scene import Scene
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.objects.gltf_keys import GltfKeys

GUIDE = Path(__file__).resolve().parents[1] / "lfmesh" / "scene" / "README.md"

BEGIN, END = "<!-- keys: ", "<!-- end of keys -->"

UNITS = {
    "asphere_mm": "mm⁻³, mm⁻⁵, ...",
    "odd_asphere_mm": "mm⁻², mm⁻⁴, ...",
    "_w_mm3_sr": "W/(mm³ sr)",
    "_w_m2_sr": "W/(m² sr)",
    "_w_m2": "W/m²",
    "_w_sr": "W/sr",
    "_w": "W",
    "_per_mm": "1/mm",
    "_mm2": "mm²",
    "_mm_s": "mm/s",
    "_mm": "mm",
    "_um2": "µm²",
    "_um": "µm",
    "_nm": "nm",
    "_mrad": "mrad",
    "_rad": "rad",
    "_deg_s": "degrees/s",
    "_deg": "degrees",
    "_s": "s",
    "_kpa": "kPa",
    "_kg_m3": "kg/m³",
    "_m3_kg": "m³/kg",
    "_k": "K",
    "temperature_c": "°C",
}
"""Unit by the end of a key's name; the longest end counts."""

SHORT_SENTENCES = ("Or give ", "Needs ")
"""Beginnings of sentences that stay in the row, after the first one."""


class Row(NamedTuple):
    """Cells of a key: its name, type, unit, default and meaning."""

    key: str
    type: str
    unit: str
    default: str
    meaning: str


def models() -> dict[str, Schema]:
    """Return the JSON Schema of every table of a scene file, by the name of its model."""
    found: dict[str, Schema] = {}
    for model in (Scene, GltfKeys, Finish):
        schema = model.model_json_schema()
        found |= schema.pop("$defs", {})
        if model is not GltfKeys:
            found[model.__name__] = schema
    return found


def filled(guide: str) -> str:
    """Return the guide with its tables of keys as the models have them.

    Parameters
    ----------
    guide : str
        Its text, with a table for every model once.

    Raises
    ------
    ValueError
        A model has no table, has two, or does not exist.
    """
    schemas, headings, heading = models(), dict[str, str](), ""
    for line in guide.splitlines():
        heading = line.lstrip("#").strip() if line.startswith("##") else heading
        for name in _named(line):
            if name not in schemas or name in headings:
                raise ValueError(f"{GUIDE.name}: {name} is no model of the scene file, or has two tables")
            headings[name] = heading
    if missing := sorted(schemas.keys() - headings.keys()):
        raise ValueError(f"{GUIDE.name} has no table of keys for: {', '.join(missing)}; write <!-- keys: NAME -->")

    def table(found: re.Match[str]) -> str:
        names = _named(found[0].splitlines()[0])
        rows = "\n".join(_table({name: schemas[name] for name in names}, headings))
        return f"{BEGIN}{', '.join(names)} -->\n\n{rows}\n\n{END}"

    return re.sub(rf"^{BEGIN}.*?^{END}$", table, guide, flags=re.MULTILINE | re.DOTALL)


def _named(line: str) -> list[str]:
    return line.removeprefix(BEGIN).removesuffix(" -->").split(", ") if line.startswith(BEGIN) else []


def _table(tables: dict[str, Schema], headings: dict[str, str]) -> list[str]:
    """Return the lines of a table; rows that several models share stand once."""
    owners: dict[Row, list[str]] = defaultdict(list)
    for name, table in tables.items():
        kind = table.get("properties", {}).get("kind", {}).get("const")
        for row in rows_of(table, headings):
            owners[row].append(name.lower().removeprefix("gltf") if kind is None else f'"{kind}"')
    owners = {row: owners[row] for row in sorted(owners, key=lambda row: row.key != "kind")}
    lines = [list(Row._fields), ["---"] * len(Row._fields), *([f"`{row.key}`", *row[1:]] for row in owners)]
    if len(tables) > 1:
        head = "kind" if any(row.key == "kind" for row in owners) else "table"
        kinds = ["all" if len(of) == len(tables) else ", ".join(f"`{each}`" for each in of) for of in owners.values()]
        lines = [[cell, *line] for cell, line in zip((head, "---", *kinds), lines, strict=True)]
    return [f"| {' | '.join(line)} |" for line in lines]


def rows_of(table: Schema, headings: dict[str, str]) -> list[Row]:
    """Return the rows of a table, with the kind first: its meaning is that of the model.

    Parameters
    ----------
    table : dict
        JSON Schema of the model.
    headings : dict of str
        Heading of the section of each model, by the model's name.
    """
    fields, required = dict(table.get("properties", {})), list(table.get("required", ()))
    kind = fields.pop("kind", None)
    if kind is not None and "const" in kind:
        kind = {**kind, "description": f"{_sentences(table)[0]} {kind['description']}", "default": None}
        required += [] if "Omitted: " in kind["description"] else ["kind"]
    fields = fields if kind is None else {"kind": kind, **fields}
    return [_row(key, field, headings, required=key in required) for key, field in fields.items()]


def _row(key: str, field: Schema, headings: dict[str, str], *, required: bool) -> Row:
    unit = next((UNITS[end] for end in sorted(UNITS, key=len, reverse=True) if key.endswith(end)), "")
    sentences = _sentences(field)
    omitted = next((each for each in sentences if each.startswith("Omitted: ")), "")
    told = [sentences[0], *(each for each in sentences[1:] if each.startswith(SHORT_SENTENCES))]
    meaning = " ".join(told).replace(f", in {unit}" if unit else " (no unit)", "")
    default = "required" if required else _default(field.get("default")) or omitted[len("Omitted: ") : -1]
    return Row(
        key, _cell(_type(field, headings)), unit, *(_cell(plain(_with_code(text))) for text in (default, meaning))
    )


def _sentences(described: Schema) -> list[str]:
    return re.split(r"(?<=\.)\s+(?=[A-Z`\"])", " ".join(described.get("description", "").split()))


def _with_code(text: str) -> str:
    """Return a text whose values, tables and names of columns are marked as code."""
    parts = re.split(r"(`[^`]*`)", text)
    code = r'(\{[^{}]*\}|"[^"]*"|\b[a-z]+(?:_[a-z0-9]+)+\b)'
    return "".join(part if part.startswith("`") else re.sub(code, r"`\1`", part) for part in parts)


def _default(value: object) -> str:
    if isinstance(value, dict) and "kind" in value:
        value = value["kind"]
    return "" if value in (None, [], {}, [[]], "") else f"`{toml(value)}`"


def _type(field: Schema, headings: dict[str, str]) -> str:
    def link(name: str) -> str:
        heading = re.sub(r"[`\[\]]", "", headings[name])
        anchor = re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")
        return f"[{heading}](#{anchor})"

    return type_in_words(field, link)


def _cell(text: str) -> str:
    return text.replace("|", r"\|")


if __name__ == "__main__":
    GUIDE.write_text(filled(GUIDE.read_text(encoding="utf-8")), encoding="utf-8")
