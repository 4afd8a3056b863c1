"""Changes to a scene by key paths, such as "targets[0].position_mm"."""

import re
from functools import lru_cache
from typing import Any

from lfmesh.scene.model import Model

_NUMBER = re.compile(r"[0-9]{1,18}")
"""List index in a path; no list is longer."""


@lru_cache(maxsize=4096)
def steps_of(path: str) -> tuple[str | int, ...]:
    """Return the keys and indices of a path such as "targets[0].position_mm"."""
    return tuple(int(s) if _NUMBER.fullmatch(s) else s for s in path.replace("]", "").replace("[", ".").split("."))


def changed_table(table: dict[str, Any] | None, values: dict[str, Any]) -> dict[str, Any] | None:
    """Return the table of a lens with a file after changes, or None if a change reaches into the file's contents."""
    table = None if table is None else dict(table)
    for path, value in values.items():
        steps = steps_of(path)
        if table is None or steps[:2] != ("camera", "lens")[: len(steps)]:
            continue
        if len(steps) != 3:
            return None
        table |= {str(steps[2]): value}
    return table


def opened(value: Any) -> Any:
    """Open one level: return a model as a table of its fields, a tuple as a list, a table as a copy.

    Defaults derived from other fields are left out, as they change with those.
    """
    if isinstance(value, Model):
        fields = type(value).model_fields.items()
        return {
            key: getattr(value, key)
            for key, field in fields
            if key in value.model_fields_set or not field.default_factory_takes_validated_data
        }
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value
