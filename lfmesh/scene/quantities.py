"""Types of values in scene files, with the checks that need no other value.

All are strict: a boolean or a number in quotes is not a number.
"""

import math
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator, ValidationInfo, WithJsonSchema

from lfmesh.errors import GlassError
from lfmesh.optics.glass import find_glass
from lfmesh.optics.metals import find_metal
from lfmesh.regular_file import why_no_file

T = TypeVar("T")

LARGEST = 1e15
"""Largest magnitude of a number in a scene, in its unit; products of a few such numbers do not overflow."""
SMALLEST = 1e-30
"""Smallest positive number where 0 is not allowed; its squared reciprocal does not overflow."""
LARGEST_COUNT = 2**31 - 1
LARGEST_WHOLE = 2**63 - 1


def _not_vanishing(value: float) -> float:
    if abs(value) < SMALLEST:
        raise ValueError(f"must be {SMALLEST:g} or more")
    return value


Number = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, Field(strict=True, gt=0, le=LARGEST), AfterValidator(_not_vanishing)]
NonNegative = Annotated[float, Field(strict=True, ge=0, le=LARGEST)]
Whole = Annotated[int, Field(strict=True, ge=0, le=LARGEST_WHOLE)]
Count = Annotated[int, Field(strict=True, ge=1, le=LARGEST_COUNT)]
Coefficient = Annotated[float, Field(strict=True)]
"""A number of any magnitude, for coefficients of high powers, which may be tiny or huge."""
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
FractionOfOne = Annotated[float, Field(strict=True, ge=0, le=1)]
Index = Annotated[float, Field(strict=True, ge=1, le=10)]
MOST_INDEX = 10.0
"""Largest refractive index."""
FieldNumber = Annotated[float, Field(strict=True, gt=0, le=MOST_INDEX)]
"""An index relative to air; that of hot air is below 1."""
GlossIndex = Annotated[float, Field(strict=True, gt=1, le=10)]

Vector = tuple[Number, Number, Number]
Pair = tuple[Count, Count]


def _not_flat_by_zero(radius_mm: float) -> float:
    if math.isnan(radius_mm) or radius_mm == 0:
        raise ValueError("must be a number other than 0; inf is a flat surface")
    if math.isfinite(radius_mm) and not SMALLEST <= abs(radius_mm) <= LARGEST:
        raise ValueError(f"must lie between {SMALLEST:g} and {LARGEST:g} in magnitude; inf is a flat surface")
    return radius_mm


def _a_focal_length(value: float) -> float:
    if math.isnan(value) or value == 0:
        raise ValueError("must be a number other than 0; positive converges, negative diverges")
    if math.isfinite(value) and not SMALLEST <= abs(value) <= LARGEST:
        raise ValueError(f"must lie between {SMALLEST:g} and {LARGEST:g} in magnitude, or be inf")
    return value


def _a_distance_or_infinity(value: float) -> float:
    if not value > 0 or (math.isfinite(value) and not SMALLEST <= value <= LARGEST):
        raise ValueError(f"must be {LARGEST:g} or less, and above 0; inf is an object at infinity")
    return value


def not_vanishing_length(value: float) -> float:
    """Refuse a focal length or radius of 0."""
    if value == 0:
        raise ValueError("must not be 0; positive converges, negative diverges")
    if abs(value) < SMALLEST:
        raise ValueError(f"must be {SMALLEST:g} or more in magnitude")
    return value


def not_empty(values: tuple[T, ...]) -> tuple[T, ...]:
    """Refuse an empty list."""
    # Pydantic counts its minimum length without refused values, which would add a second fault.
    if not values:
        raise ValueError("must not be empty")
    return values


def _known_glass(name: str) -> str:
    try:
        find_glass(name)
    except GlassError as error:
        raise ValueError(str(error).removeprefix(f"glass {name!r}: ")) from None
    return name


def _known_metal(name: str) -> str:
    try:
        find_metal(name)
    except GlassError as error:
        raise ValueError(str(error).removeprefix(f"metal {name!r}: ").removeprefix(f"glass {name!r}: ")) from None
    return name


def path_fault(path: str) -> str | None:
    """Return the reason why no file can have this name, or None."""
    return "a file name must not contain a NUL character" if "\0" in path else None


def _existing(path: str, info: ValidationInfo) -> str:
    """Require the file to exist, if the folder that its path starts from is known."""
    if why := path_fault(path):
        raise ValueError(why)
    folder = (info.context or {}).get("folder")
    if folder is None:
        return path
    try:
        present = (folder / path).is_file()
    except OSError as error:
        raise ValueError(f"cannot be looked for: {error.strerror}") from None
    if not present:
        if (folder / path).exists():
            raise ValueError(f"{folder / path} {why_no_file(folder / path)}")
        raise ValueError(f"no such file; looked for {folder / path}")
    return path


def _share_or_alpha(value: Any) -> Any:
    number = isinstance(value, float | int) and not isinstance(value, bool)
    if value != "texture_alpha" and not (number and 0 <= value <= 1):
        raise ValueError('must be a number from 0 to 1, or "texture_alpha"')
    return float(value) if number else value


def as_list(value: Any) -> Any:
    """Accept a single number as a list of one."""
    return value if value is None or isinstance(value, list | tuple) else [value]


Radius = Annotated[float, Field(strict=True, allow_inf_nan=True), AfterValidator(_not_flat_by_zero)]
"""A radius of curvature in mm, of either sign; inf is flat."""

FocalLength = Annotated[float, Field(strict=True, allow_inf_nan=True), AfterValidator(_a_focal_length)]
"""A focal length in mm, of either sign; inf has no power."""

SignedLength = Annotated[Number, AfterValidator(not_vanishing_length)]
"""A length in mm, of either sign but not 0."""

ObjectDistance = Annotated[float, Field(strict=True, allow_inf_nan=True), AfterValidator(_a_distance_or_infinity)]
"""An object distance in mm, above 0; inf is at infinity."""

GlassName = Annotated[str, Field(strict=True), AfterValidator(_known_glass)]
"""A glass in the catalogue."""

MetalName = Annotated[str, Field(strict=True), AfterValidator(_known_metal)]
"""A metal in the catalogue."""

Opacity = Annotated[
    float | Literal["texture_alpha"],
    PlainValidator(_share_or_alpha),
    WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, {"const": "texture_alpha"}]}),
]
"""A fraction from 0 to 1, or the texture channel that holds it."""

NodeKey = Annotated[Text | Whole, Field(union_mode="left_to_right")]
"""A node of a glTF file, by name or by index from 0."""

FilePath = Annotated[str, Field(strict=True), AfterValidator(_existing)]
"""A file, relative to the scene file."""

number_per_type_schema = WithJsonSchema(
    {
        "anyOf": [
            {"type": "number"},
            {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 3},
        ]
    }
)
"""JSON Schema of a number, or a list of up to three: one per lenslet type."""

OneOrMore = Annotated[
    tuple[SignedLength, ...],
    Field(max_length=3),
    AfterValidator(not_empty),
    BeforeValidator(as_list),
    number_per_type_schema,
]
"""A nonzero number, or a list of up to three: one per lenslet type."""

SHORTEST, LONGEST = 1e-100, 1e100
"""Limits on the length of a direction vector, outside which its square overflows or underflows."""


def no_direction(vector: tuple[float, ...]) -> str:
    """Return the reason why a vector gives no direction, or "" if it does."""
    if not any(vector):
        return "must not be the zero vector"
    if not SHORTEST <= math.hypot(*vector) <= LONGEST:
        return f"must have a length from {SHORTEST:g} to {LONGEST:g}"
    return ""
