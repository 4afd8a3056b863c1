"""The base of every scene model: strict, frozen, and reporting all faults of a file at once.

`faults` yields the faults that pydantic cannot find. They travel upwards in one list with pydantic's, so that the
outermost caller can give the whole path of each: `camera.lens.surfaces[3].radius_mm`.
"""

import difflib
import re
import reprlib
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    model_validator,
)
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from lfmesh.errors import SceneError
from lfmesh.scene.key_places import ENTRY, NAME, KeyPlace, key_places
from lfmesh.scene.literals import literal, shown_path

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

MOST_FAULTS = 20
"""Maximum number of faults in one message."""

LONGEST_KEY = 60
"""Maximum number of characters of a key in a message."""

MOST_PLACES = 4
"""Maximum number of places of a key in a message."""

NOT_TRIED = "default_factory_not_called"
"""Pydantic's error type for a default that depends on a faulty field; that field has a fault of its own."""

Location = tuple[str | int, ...]


_CUT = reprlib.Repr()
_CUT.maxlevel, _CUT.maxtuple, _CUT.maxdict, _CUT.maxstring, _CUT.maxother = 20, 16, 16, 100, 10_000


class _Verbatim(str):
    """Text that is its own repr."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class Fault(NamedTuple):
    """One fault of a model: its location, the value found, and what would be valid."""

    where: Location
    value: Any
    valid: str


class _ModelClass(ModelMetaclass):
    """Turns invalid calls from Python into a `SceneError`, as for files, without touching nested validation."""

    def __call__(cls, *args: Any, **values: Any) -> Any:  # noqa: N805
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            # A `Study` in Python has the contents of a `StudyFile`.
            prefix = cls.__name__.removesuffix("File")
            raise SceneError("\n".join(listed(fault_lines(error, values, prefix=prefix)))) from None


class Model(BaseModel, metaclass=_ModelClass):
    """A part of the scene: immutable, without unknown keys or NaN, and finite unless a field allows infinity."""

    elsewhere: ClassVar[Mapping[str, str]] = {}
    """Hints for keys that belong to another part but are often put here, by key."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        ser_json_inf_nan="constants",
    )

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields that differ from their defaults, as in a scene file, with long lists shortened."""
        for name, value in super().__repr_args__():
            field = type(self).model_fields.get(str(name))
            if field is None or value != field.get_default(call_default_factory=True, validated_data=self.__dict__):
                yield name, _Verbatim(_CUT.repr(value))

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields that are valid on their own."""
        return iter(())

    @model_validator(mode="wrap")
    @classmethod
    def _collect_faults(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if isinstance(data, cls):
            return data
        try:
            model = handler(_plain(data))
        except ValidationError as error:
            raise _as_error(
                cls, [_restated(detail, cls) for detail in error.errors() if not _follows(detail)]
            ) from None
        faults = list(model.faults())
        if faults:
            raise _as_error(cls, faults)
        return model


def fault_lines(
    error: ValidationError, data: Any, prefix: str = "", origin: Mapping[str, str] | None = None
) -> list[str]:
    """Return one line per fault: its path, the value, and valid values.

    Parameters
    ----------
    error : ValidationError
    data : object
        The validated data, which tells keys of the file from pydantic's tags of unions.
    prefix : str
        Beginning of every path.
    origin : mapping of path to file, optional
        File that everything under a path was read from.
    """
    lines = []
    for detail in error.errors():
        path = format_path(_without_tags(detail["loc"], data), prefix)
        source = next((f" ({file})" for start, file in (origin or {}).items() if path.startswith(start)), "")
        unknown = detail.get("ctx", {}).get("unknown")
        end = unknown.in_words(detail["loc"], data, prefix) if unknown is not None else ""
        lines.append(f"{path or 'scene'}{source}{detail['msg']}{end}")
    return lines


def listed(lines: list[str]) -> list[str]:
    """Return the first faults of a list and the number of the remaining ones."""
    more = len(lines) - MOST_FAULTS
    return [*lines[:MOST_FAULTS], f"and {more} more"] if more > 0 else lines


def format_path(location: Iterable[str | int], prefix: str = "") -> str:
    """Write a location as a reader of the file would: `targets[0].shape.radius_mm`."""
    path = prefix
    for step in location:
        key = step if isinstance(step, int) else _short_key(step)
        path += f"[{key}]" if isinstance(step, int) else f".{key}" if path else str(key)
    return path


def _short_key(key: str) -> str:
    text = shown_path(key)
    return text if len(text) <= LONGEST_KEY else f"{text[: LONGEST_KEY - 3]}..."


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" if a valid name is close to `name`, else an empty string."""
    close = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.6)
    return f" (did you mean {close[0]!r}?)" if close else ""


def dead_end(place: Any, step: str | int, location: Iterable[str | int]) -> str | None:
    """Return the reason why a path cannot continue from a value, or None if it can.

    Parameters
    ----------
    place : object
        The value.
    step : str or int
        Next key or index of the path.
    location : iterable of str or int
        Path to the value.
    """
    where = format_path(location)
    if isinstance(place, list | tuple):
        if not isinstance(step, int):
            return f"{where} is a list: a whole number from 0 must follow, such as {where}[0]"
        if step < len(place):
            return None
        entries = "1 entry" if len(place) == 1 else f"{len(place)} entries"
        return f"{where} has {entries}, numbered from 0: there is no [{step}]"
    return None if isinstance(place, Mapping | Model) else f"{where} is a single value, {place!r}: nothing can follow"


def _plain(data: Any) -> Any:
    """Turn NumPy scalars and arrays into numbers and lists, so that scripts may pass them."""
    if isinstance(data, Mapping):
        return {key: _plain_value(value) for key, value in data.items()}
    return data


def _plain_value(value: Any) -> Any:
    # Most values of a changed scene are models, on which a failing hasattr is slow.
    return value.tolist() if not isinstance(value, Model) and hasattr(value, "tolist") else value


def _as_error(cls: type[Model], faults: Iterable[Fault]) -> ValidationError:
    details = [
        InitErrorDetails(
            type=PydanticCustomError(
                "fault", "{text}", {"text": _sentence(fault), "unknown": getattr(fault.valid, "unknown", None)}
            ),
            loc=fault.where,
            input=fault.value,
        )
        for fault in faults
    ]
    return ValidationError.from_exception_data(cls.__name__, details)


class UnknownKey(NamedTuple):
    """An unknown key, with its places in the innermost model around it that has any.

    Attributes
    ----------
    key : str
    valid : tuple of str
        Keys of the table.
    depth : int
        Number of steps from that model to the key.
    places : tuple of KeyPlace
    """

    key: str
    valid: tuple[str, ...]
    depth: int = 0
    places: tuple[KeyPlace, ...] = ()

    def sought_in(self, cls: type[Model], depth: int) -> "UnknownKey":
        """Return the key with its places in a model around it, unless they are known."""
        return self if self.places else self._replace(depth=depth, places=key_places(cls).get(self.key, ()))

    def in_words(self, location: Location, data: Any, prefix: str) -> str:
        """Return the end of a message: the places where the key is valid, from the root, and the keys of the table.

        Parameters
        ----------
        location : tuple of str and int
            Location of the key.
        data, prefix
            As for `fault_lines`.
        """
        around = _without_tags(location[: len(location) - self.depth], data)
        own = _without_tags(location, data)[len(around) :]
        here = next((place for place in self.places if place.kinds and _is_at(place.steps, own)), None)
        if here is not None:
            words = f"; it is valid with kind = {_either(map(literal, here.kinds))}"
        elif self.places:
            start = format_path(around, prefix)
            paths = [_joined(start, place.steps) for place in self.places[:MOST_PLACES]]
            more = ["in other tables"] if len(self.places) > MOST_PLACES else []
            words = f"; it is valid as {_either([*paths, *more])}"
        else:
            words = ""
        return f"{words}; valid here: {', '.join(self.valid)}"


class _Worded(str):
    """Whole text of a fault, and the unknown key that it is about."""

    __slots__ = ("unknown",)
    unknown: UnknownKey | None

    def __new__(cls, text: str, unknown: UnknownKey | None = None) -> Self:
        worded = super().__new__(cls, text)
        worded.unknown = unknown
        return worded


def _joined(path: str, steps: Iterable[str]) -> str:
    for step in steps:
        path += step if step == ENTRY or not path else f".{step}"
    return path


def _is_at(steps: tuple[str, ...], location: Location) -> bool:
    """Tell whether a location is one of a place's."""
    return len(steps) == len(location) and all(
        step == NAME or (isinstance(key, int) if step == ENTRY else key == step)
        for step, key in zip(steps, location, strict=True)
    )


def _either(words: Iterable[str]) -> str:
    """Return words as a list: "a, b or c"."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last


def _sentence(fault: Fault) -> str:
    if isinstance(fault.valid, _Worded):
        return fault.valid
    return f"{_shown(fault.value)}: {fault.valid}"


def _shown(value: Any) -> str:
    """Return " = 3.0" for a value worth printing, and nothing for a missing one or a whole table."""
    if value is None or isinstance(value, Mapping | BaseModel):
        return ""
    text = literal(value)
    return f" = {text}" if len(text) <= 60 else f" = {text[:57]}..."


def _short(limit: Any) -> str:
    if isinstance(limit, int):
        return f"{limit:,}" if abs(limit) >= 10_000 else str(limit)
    return f"{limit:g}" if isinstance(limit, float) else str(limit)


def _follows(detail: ErrorDetails) -> bool:
    """Tell whether this fault only follows from another one, which pydantic reports too.

    Defaults that depend on a faulty field are not made, and faulty entries do not count in a list's length.
    """
    if detail["type"] == "too_short":
        return len(detail["input"]) >= detail["ctx"]["min_length"]
    return detail["type"] == NOT_TRIED


def _first_sentence(text: str) -> str:
    return re.split(r"\.(?=\s|$)", " ".join(text.split()), maxsplit=1)[0]


def _restated(detail: ErrorDetails, cls: type[Model]) -> Fault:
    """Restate a pydantic error in the scene's terms, or pass on the fault of a nested model."""
    where, value, kind, limits = detail["loc"], detail["input"], detail["type"], detail.get("ctx", {})
    if kind == "fault":
        unknown = limits.get("unknown")
        return Fault(where, value, _Worded(detail["msg"], unknown and unknown.sought_in(cls, len(where))))
    if kind in ("extra_forbidden", "invalid_key"):
        key = str(where[-1])
        keys = list(cls.model_fields)
        if key in cls.elsewhere:
            return Fault(where, None, f"unknown key; {cls.elsewhere[key]}")
        unknown = UnknownKey(key, tuple(keys)).sought_in(cls, len(where))
        return Fault(where, None, _Worded(f": unknown key{nearest(key, keys)}", unknown))
    field = cls.model_fields.get(str(where[0])) if len(where) == 1 else None
    meaning = _first_sentence(field.description) if field is not None and field.description else ""
    if kind == "missing":
        return Fault(where, None, f"missing{meaning and f': {meaning}'}")
    if kind == "tuple_type":
        if isinstance(value, Mapping):
            heading = str(where[0]) if "schema_version" in cls.model_fields else f"...{where[0]}"
            return Fault(where, None, f"must be a list of tables: write [[{heading}]] above each of them")
        return Fault(where, value, f"must be a list{meaning and f': {meaning}'}")
    if kind == "union_tag_not_found":
        return Fault(where, value, "needs a key `kind` that names its type")
    if kind == "union_tag_invalid":
        tags = [tag.strip(" '") for tag in str(limits["expected_tags"]).split(",")]
        tag = str(limits["tag"])
        return Fault((*where, "kind"), tag, f"valid kinds are {', '.join(tags)}{nearest(tag, tags)}")
    if kind == "literal_error":
        expected = str(limits["expected"])
        words = [word.strip() for word in expected.replace(" or ", ",").split(",")]
        names = [word.strip("'") for word in words if word.startswith("'")]
        near = nearest(value, names) if isinstance(value, str) else ""
        return Fault(where, value, f"must be {expected}{near}")
    message = detail["msg"].removeprefix("Input should be ")
    valid = {
        "float_type": "must be a number",
        "int_type": "must be a whole number, without quotes or a decimal point",
        "string_type": "must be text in quotes",
        "bool_type": "must be true or false",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "finite_number": "must be a finite number",
        "greater_than": f"must be above {_short(limits.get('gt'))}",
        "greater_than_equal": f"must be {_short(limits.get('ge'))} or more",
        "less_than": f"must be below {_short(limits.get('lt'))}",
        "less_than_equal": f"must be {_short(limits.get('le'))} or less",
        "too_short": "must not be empty",
        "too_long": f"may have at most {limits.get('max_length')} entries",
        "value_error": str(limits.get("error")),
    }.get(kind, f"must be {message}")
    return Fault(where, value, valid)


def kind_of(table: Mapping[str, Any]) -> Any:
    """Return the `kind` of a table; without one, "mesh" if the table names a file."""
    return table.get("kind", "mesh" if "file" in table else None)


def _without_tags(location: Location, data: Any) -> Location:
    """Drop the tags of discriminated unions, which are not keys of the file."""
    kept: list[str | int] = []
    for step in location:
        if isinstance(step, str) and step.startswith("<"):
            continue
        if isinstance(data, Mapping) and step not in data and kind_of(data) == step:
            continue
        kept.append(step)
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            data = None
    return tuple(kept)
