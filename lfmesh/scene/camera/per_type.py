"""Values of a microlens array given once for all lenslet types, or once per type."""

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS
from lfmesh.scene.quantities import (
    LARGEST,
    Coefficient,
    Number,
    as_list,
    not_empty,
    not_vanishing_length,
    number_per_type_schema,
)


def as_list_of_lists(value: Any) -> Any:
    """Accept a list of numbers as a list of one list."""
    if isinstance(value, list | tuple) and not any(isinstance(item, list | tuple) for item in value):
        return [value]
    return value


def _bends_or_is_flat(radius_mm: float) -> float:
    if math.isinf(radius_mm):
        return math.inf
    if not abs(radius_mm) <= LARGEST:
        raise ValueError(f"must be {LARGEST:g} or less, or inf, which is flat")
    return not_vanishing_length(radius_mm)


RadiusPerType = Annotated[
    tuple[Annotated[float, Field(strict=True, allow_inf_nan=True), AfterValidator(_bends_or_is_flat)], ...],
    Field(max_length=3),
    AfterValidator(not_empty),
    BeforeValidator(as_list),
    number_per_type_schema,
]
"""A radius of either sign, or inf, or a list of up to three: one per lenslet type."""

ConicPerType = Annotated[
    tuple[Number, ...],
    Field(max_length=3),
    AfterValidator(not_empty),
    BeforeValidator(as_list),
    number_per_type_schema,
]
"""A conic constant, or a list of up to three: one per lenslet type."""

TermsPerType = Annotated[
    tuple[Annotated[tuple[Coefficient, ...], Field(max_length=MOST_ASPHERE_TERMS)], ...],
    Field(max_length=3),
    AfterValidator(not_empty),
    BeforeValidator(as_list_of_lists),
    WithJsonSchema(
        {
            "anyOf": [
                {"type": "array", "items": {"type": "number"}, "maxItems": MOST_ASPHERE_TERMS},
                {
                    "type": "array",
                    "items": {"type": "array", "items": {"type": "number"}, "maxItems": MOST_ASPHERE_TERMS},
                    "minItems": 1,
                    "maxItems": 3,
                },
            ]
        }
    ),
]
"""Even aspheric coefficients, or a list of up to three lists of them: one per lenslet type."""
