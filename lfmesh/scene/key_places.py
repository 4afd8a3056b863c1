"""Places where a key is valid, derived from the fields of the models."""

from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any, NamedTuple, get_args, get_origin

from pydantic import BaseModel

ENTRY, NAME = "[i]", "NAME"
"""Steps of a place into any entry of a list, and into any entry of a table of names."""


class KeyPlace(NamedTuple):
    """A place where a key is valid.

    Attributes
    ----------
    steps : tuple of str
        Keys, `ENTRY` and `NAME` from the model, the key itself last.
    kinds : tuple of str
        Values of `kind` of the table that has the key; empty if the table has no kinds.
    """

    steps: tuple[str, ...]
    kinds: tuple[str, ...] = ()


@cache
def key_places(model: type[BaseModel]) -> Mapping[str, tuple[KeyPlace, ...]]:
    """Return the places of all keys in a model and the models inside it, the nearest places first.

    Parameters
    ----------
    model : type of BaseModel

    Returns
    -------
    mapping of str to tuple of KeyPlace
    """
    kinds: dict[str, dict[tuple[str, ...], list[str]]] = {}
    for way, kind, keys in _tables(model):
        for key in keys:
            kinds.setdefault(key, {}).setdefault((*way, key), []).extend(kind)
    return {
        key: tuple(KeyPlace(steps, tuple(dict.fromkeys(found))) for steps, found in places.items())
        for key, places in kinds.items()
    }


def _tables(model: type[BaseModel]) -> Iterator[tuple[tuple[str, ...], list[str], list[str]]]:
    """Yield the way to every table in a model, its kind if it has one, and its keys; outer tables come first."""
    level: list[tuple[tuple[str, ...], tuple[type[BaseModel], ...]]] = [((), (model,))]
    while level:
        inside: list[tuple[tuple[str, ...], tuple[type[BaseModel], ...]]] = []
        for way, line in level:
            fields = line[-1].model_fields
            yield (
                way,
                [str(kind) for kind in get_args(fields["kind"].annotation)] if "kind" in fields else [],
                [*fields],
            )
            for key, field in fields.items():
                # A model that contains itself would never end.
                inside += [
                    ((*way, key, *steps), (*line, found))
                    for steps, found in _models_in(field.annotation)
                    if found not in line
                ]
        level = inside


def _models_in(annotation: Any) -> Iterator[tuple[tuple[str, ...], type[BaseModel]]]:
    """Yield the models of a type, with the steps that lead into its lists and tables of names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield (), annotation
        return
    origin = get_origin(annotation)
    step = {tuple: (ENTRY,), list: (ENTRY,), dict: (NAME,)}.get(origin, ()) if origin is not None else ()
    for inner in get_args(annotation):
        for steps, model in _models_in(inner):
            yield (*step, *steps), model
