"""Write a scene as TOML that loads to the same scene."""

from typing import Any

import tomlkit

from lfmesh.scene.model import Model

# Keys that say how to read the others are written even with their default.
_ALWAYS = ("schema_version", "kind")

# Tables written inline, and lists of tables with one line per table.
_IN_LINE = ("shape",)
_A_LINE_EACH = ("surfaces", "layers")


def table(model: Model) -> dict[str, Any]:
    """Return a model as plain tables, lists and values, in file order, without defaults.

    Defaults derived from other fields are written, in case their rule changes.
    """
    entries: dict[str, Any] = {}
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        always = key in _ALWAYS or field.default_factory_takes_validated_data
        if value is None or (not always and value == field.get_default(call_default_factory=True)):
            continue
        entries[key] = _entry(value)
    return entries


def dump(model: Model) -> str:
    """Return a model as TOML."""
    document = tomlkit.document()
    _fill(document, table(model))
    return tomlkit.dumps(document)


def _entry(value: Any) -> Any:
    if isinstance(value, Model):
        return table(value)
    if isinstance(value, tuple):
        return [_entry(item) for item in value]
    if isinstance(value, dict):
        return {key: _entry(item) for key, item in value.items()}
    return value


def _fill(block: Any, entries: dict[str, Any]) -> None:
    """Fill a tomlkit document or table, values before sub-tables as TOML demands."""
    tables = {key: value for key, value in entries.items() if _is_table(value, key) or _is_tables(value, key)}
    for key, value in entries.items():
        if key not in tables:
            block.add(key, in_line(value))
            if key in _A_LINE_EACH and isinstance(value[0], dict):
                block[key].multiline(True)
    for key, value in tables.items():
        block.add(key, _array_of_tables(value) if isinstance(value, list) else _table(value))


def _table(entries: dict[str, Any]) -> Any:
    block = tomlkit.table()
    _fill(block, entries)
    return block


def _array_of_tables(items: list[dict[str, Any]]) -> Any:
    array = tomlkit.aot()
    for entries in items:
        array.append(_table(entries))
    return array


def in_line(value: Any) -> Any:
    """Return a value, list or table in inline form."""
    if isinstance(value, dict):
        line = tomlkit.inline_table()
        for key, item in value.items():
            line.add(key, in_line(item))
        return line
    if isinstance(value, list):
        array = tomlkit.array()
        for item in value:
            array.append(in_line(item))
        return array
    return tomlkit.item(value)


def _is_table(value: Any, key: str) -> bool:
    return isinstance(value, dict) and key not in _IN_LINE


def _is_tables(value: Any, key: str) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict) and key not in _A_LINE_EACH
