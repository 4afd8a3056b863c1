"""The kinds of values that scene files hold, each with the check it can make by itself.

All are strict: a number in quotes or a boolean is a slip, not a number.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, PlainValidator, ValidationInfo, WithJsonSchema

from lfmesh.errors import GlassError
from lfmesh.optics.glass import find_glass
from lfmesh.optics.metals import find_metal

Number = Annotated[float, Field(strict=True)]
Positive = Annotated[float, Field(strict=True, gt=0)]
NonNegative = Annotated[float, Field(strict=True, ge=0)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Flag = Annotated[bool, Field(strict=True)]
Text = Annotated[str, Field(strict=True)]
FractionOfOne = Annotated[float, Field(strict=True, ge=0, le=1)]
Index = Annotated[float, Field(strict=True, ge=1, le=10)]
GlossIndex = Annotated[float, Field(strict=True, gt=1, le=10)]

Vector = tuple[Number, Number, Number]
Pair = tuple[Count, Count]


def _not_flat_by_zero(radius_mm: float) -> float:
    if math.isnan(radius_mm) or radius_mm == 0:
        raise ValueError("must be a number other than 0; inf is a flat surface")
    return radius_mm


def _bends(value: float) -> float:
    if value == 0:
        raise ValueError("must not be 0; positive converges, negative diverges")
    return value


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


def _existing(path: str, info: ValidationInfo) -> str:
    """Look for a file, where it is known which folder its path starts from."""
    folder = (info.context or {}).get("folder")
    if folder is not None and not (folder / path).is_file():
        raise ValueError(f"no such file; looked for {folder / path}")
    return path


def _share_or_alpha(value: Any) -> Any:
    number = isinstance(value, float | int) and not isinstance(value, bool)
    if value != "texture_alpha" and not (number and 0 <= value <= 1):
        raise ValueError('must be a number from 0 to 1, or "texture_alpha"')
    return float(value) if number else value


def _as_list(value: Any) -> Any:
    """Let a single number stand for a list of one."""
    return value if value is None or isinstance(value, list | tuple) else [value]


Radius = Annotated[float, Field(strict=True, allow_inf_nan=True), AfterValidator(_not_flat_by_zero)]
"""A radius of curvature in mm, of either sign; inf is flat."""

GlassName = Annotated[str, Field(strict=True), AfterValidator(_known_glass)]
"""A glass of the catalogue."""

MetalName = Annotated[str, Field(strict=True), AfterValidator(_known_metal)]
"""A metal of the catalogue."""

Opacity = Annotated[
    float | Literal["texture_alpha"],
    PlainValidator(_share_or_alpha),
    WithJsonSchema({"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, {"const": "texture_alpha"}]}),
]
"""A share from 0 to 1, or the name of where it stands."""

FilePath = Annotated[str, Field(strict=True), AfterValidator(_existing)]
"""A file, relative to the scene file."""

OneOrMore = Annotated[
    tuple[Annotated[Number, AfterValidator(_bends)], ...],
    Field(min_length=1, max_length=3),
    BeforeValidator(_as_list),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "number"},
                {"type": "array", "items": {"type": "number"}, "minItems": 1, "maxItems": 3},
            ]
        }
    ),
]
"""A number other than 0, or a list of up to three: one a lenslet type."""
