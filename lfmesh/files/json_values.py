"""Values that JSON can hold."""

import json
import math
from typing import Any

import numpy as np


def plain_json(value: Any) -> Any:
    """Return a value, and all that it holds, as plain JSON values: JSON has no NaN, no infinity and no numpy."""
    if isinstance(value, dict):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(item) for item in value]
    if isinstance(value, np.generic):
        return plain_json(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def parse_json(text: str | bytes) -> Any:
    """Return the value that a JSON text holds.

    Raises
    ------
    ValueError
        It is no JSON, or nested deeper than Python can read.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("its lists or objects stand too deep in one another") from None
