"""Writing a scene as TOML: what a script built becomes a file that loads to the same scene."""

from typing import Any

from lfmesh.scene.literals import literal
from lfmesh.scene.model import Model

# Keys that say how to read the rest stand in the file even where they have their default.
_ALWAYS = ("schema_version", "kind")


def table(model: Model) -> dict[str, Any]:
    """Return a model as plain tables, lists and values, in file order, without what has its default."""
    entries: dict[str, Any] = {}
    for key, field in type(model).model_fields.items():
        value = getattr(model, key)
        if value is None or (key not in _ALWAYS and value == field.get_default(call_default_factory=True)):
            continue
        entries[key] = _entry(value)
    return entries


def dump(model: Model) -> str:
    """Return a model as TOML."""
    return "\n".join(_lines(table(model), "")).lstrip("\n") + "\n"


def _entry(value: Any) -> Any:
    if isinstance(value, Model):
        return table(value)
    if isinstance(value, tuple):
        return [_entry(item) for item in value]
    return value


def _lines(entries: dict[str, Any], path: str) -> list[str]:
    """Write values first, then sub-tables, as TOML demands."""
    lines = []
    for key, value in entries.items():
        if not (_is_table(value, key) or _is_tables(value, key)):
            lines.append(f"{key} = {_value(value, key)}")
    for key, value in entries.items():
        inner = f"{path}.{key}" if path else key
        if _is_table(value, key):
            lines += ["", f"[{inner}]", *_lines(value, inner)]
        elif _is_tables(value, key):
            for item in value:
                lines += ["", f"[[{inner}]]", *_lines(item, inner)]
    return lines


def _is_table(value: Any, key: str) -> bool:
    return isinstance(value, dict) and key != "shape"


def _is_tables(value: Any, key: str) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], dict) and key != "surfaces"


def _value(value: Any, key: str) -> str:
    if key == "surfaces":
        return "[\n" + "".join(f"  {literal(item)},\n" for item in value) + "]"
    return literal(value)
