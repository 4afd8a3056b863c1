"""The base of every scene model: strict, frozen, and reporting all faults of a file at once.

Each model says what pydantic cannot know about it in `faults`. Those and pydantic's own findings travel
upwards as one list, so that the outermost caller can name the whole path of each:
`camera.lens.surfaces[3].radius_mm`.
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
from lfmesh.scene.literals import literal, shown_path

if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)

MOST_FAULTS = 20
"""Faults that one message lists."""

LONGEST_KEY = 60
"""Characters of a key that a message shows."""

NOT_TRIED = "default_factory_not_called"
"""Pydantic's type of error for a default that depends on a faulty field, which is reported by itself."""

Location = tuple[str | int, ...]


_CUT = reprlib.Repr()
_CUT.maxlevel, _CUT.maxtuple, _CUT.maxdict, _CUT.maxstring, _CUT.maxother = 20, 16, 16, 100, 10_000


class _Verbatim(str):
    """Text that is its own repr."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class Fault(NamedTuple):
    """One thing wrong with a model: where in the model, the value found, and what would be valid."""

    where: Location
    value: Any
    valid: str


class _ModelClass(ModelMetaclass):
    """Makes a call from Python end in a `SceneError`, as a file does, without touching nested validation."""

    def __call__(cls, *args: Any, **values: Any) -> Any:  # noqa: N805
        try:
            return super().__call__(*args, **values)
        except ValidationError as error:
            # Python gives the content of a `StudyFile` to a `Study`.
            prefix = cls.__name__.removesuffix("File")
            raise SceneError("\n".join(listed(fault_lines(error, values, prefix=prefix)))) from None


class Model(BaseModel, metaclass=_ModelClass):
    """A part of the scene: immutable, no unknown keys, no NaN, no infinity unless a field allows it."""

    elsewhere: ClassVar[Mapping[str, str]] = {}
    """Hints on keys that belong to another part and are looked for in this one, by the key."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        ser_json_inf_nan="constants",
    )

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """Yield the fields that differ from their defaults, as a scene file would hold them; long lists are cut."""
        for name, value in super().__repr_args__():
            field = type(self).model_fields.get(str(name))
            if field is None or value != field.get_default(call_default_factory=True, validated_data=self.__dict__):
                yield name, _Verbatim(_CUT.repr(value))

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between fields that are right by themselves."""
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
    """Return one line a fault: its path, the value, what is valid.

    Parameters
    ----------
    error : ValidationError
    data : object
        What was validated; tells the keys of the file from the tags that pydantic puts into a union's
        location.
    prefix : str
        What the paths start with.
    origin : mapping of path to file, optional
        Names the file that everything under a path was read from.
    """
    lines = []
    for detail in error.errors():
        path = format_path(_without_tags(detail["loc"], data), prefix)
        source = next((f" ({file})" for start, file in (origin or {}).items() if path.startswith(start)), "")
        lines.append(f"{path or 'scene'}{source}{detail['msg']}")
    return lines


def listed(lines: list[str]) -> list[str]:
    """Return the first faults of a list, and how many more there are."""
    more = len(lines) - MOST_FAULTS
    return [*lines[:MOST_FAULTS], f"and {more} more"] if more > 0 else lines


def format_path(location: Iterable[str | int], prefix: str = "") -> str:
    """Write a location the way a reader of the file would: `targets[0].shape.radius_mm`."""
    path = prefix
    for step in location:
        key = step if isinstance(step, int) else _short_key(step)
        path += f"[{key}]" if isinstance(step, int) else f".{key}" if path else str(key)
    return path


def _short_key(key: str) -> str:
    text = shown_path(key)
    return text if len(text) <= LONGEST_KEY else f"{text[: LONGEST_KEY - 3]}..."


def nearest(name: str, valid: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" if a valid name is close to `name`, else nothing."""
    close = difflib.get_close_matches(name, list(valid), n=1, cutoff=0.6)
    return f" (did you mean {close[0]!r}?)" if close else ""


def dead_end(place: Any, step: str | int, location: Iterable[str | int]) -> str | None:
    """Return why a path cannot go on from a value; None from tables and where it can.

    Parameters
    ----------
    place : object
        The value.
    step : str or int
        Key or number by which the path goes on.
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
    """Turn NumPy scalars and arrays into numbers and lists, so that scripts may pass either."""
    if isinstance(data, Mapping):
        return {key: _plain_value(value) for key, value in data.items()}
    return data


def _plain_value(value: Any) -> Any:
    # Models, of which most values are in a scene that is changed, are slow to say that they have no such method.
    return value.tolist() if not isinstance(value, Model) and hasattr(value, "tolist") else value


def _as_error(cls: type[Model], faults: Iterable[Fault]) -> ValidationError:
    details = [
        InitErrorDetails(
            type=PydanticCustomError("fault", "{text}", {"text": _sentence(fault)}),
            loc=fault.where,
            input=fault.value,
        )
        for fault in faults
    ]
    return ValidationError.from_exception_data(cls.__name__, details)


class _Worded(str):
    """The text of a fault that already carries its value, from a model further inside."""

    __slots__ = ()


def _sentence(fault: Fault) -> str:
    if isinstance(fault.valid, _Worded):
        return fault.valid
    return f"{_shown(fault.value)}: {fault.valid}"


def _shown(value: Any) -> str:
    """Return " = 3.0" for a value worth printing, nothing for a missing one or a whole table."""
    if value is None or isinstance(value, Mapping | BaseModel):
        return ""
    text = literal(value)
    return f" = {text}" if len(text) <= 60 else f" = {text[:57]}..."


def _short(limit: Any) -> str:
    if isinstance(limit, int):
        return f"{limit:,}" if abs(limit) >= 10_000 else str(limit)
    return f"{limit:g}" if isinstance(limit, float) else str(limit)


def _follows(detail: ErrorDetails) -> bool:
    """Tell whether pydantic found this fault only because of another one, which it reports too.

    A default that depends on a faulty field is not made, and faulty entries of a list do not count in its length.
    """
    if detail["type"] == "too_short":
        return len(detail["input"]) >= detail["ctx"]["min_length"]
    return detail["type"] == NOT_TRIED


def _first_sentence(text: str) -> str:
    return re.split(r"\.(?=\s|$)", " ".join(text.split()), maxsplit=1)[0]


def _restated(detail: ErrorDetails, cls: type[Model]) -> Fault:
    """Say in the scene's terms what pydantic found, or pass on what a nested model has said already."""
    where, value, kind, limits = detail["loc"], detail["input"], detail["type"], detail.get("ctx", {})
    if kind == "fault":
        return Fault(where, value, _Worded(detail["msg"]))
    if kind in ("extra_forbidden", "invalid_key"):
        key = str(where[-1])
        keys = list(cls.model_fields)
        if key in cls.elsewhere:
            return Fault(where, None, f"unknown key; {cls.elsewhere[key]}")
        return Fault(where, None, f"unknown key{nearest(key, keys)}; valid here: {', '.join(keys)}")
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
        return Fault(where, value, "needs a key `kind` that says what it is")
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
        "too_long": f"may have {limits.get('max_length')} entries at most",
        "value_error": str(limits.get("error")),
    }.get(kind, f"must be {message}")
    return Fault(where, value, valid)


def kind_of(table: Mapping[str, Any]) -> Any:
    """Return what the `kind` of a table says; of one with a file and without `kind`, "mesh"."""
    return table.get("kind", "mesh" if "file" in table else None)


def _without_tags(location: Location, data: Any) -> Location:
    """Drop the tags of discriminated unions, which are no keys of the file."""
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
