"""Values in messages: TOML literals, counts, percentages and rounded numbers."""

import json
import math
from collections.abc import Mapping
from typing import Any

LONGEST_BITS = 1024
"""Integers with more bits are described rather than written out."""


DEEPEST = 8
"""Lists and tables nested deeper are not written out."""


MOST_PLAIN = 1e6
"""Numbers below this are written without an exponent."""


def shown_path(path: object) -> str:
    """Return a path as one printable line, whatever characters it holds."""
    return "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in str(path))


def literal(value: Any, depth: int = 0) -> str:
    """Return a number, text, list or inline table as TOML, and anything else as its repr."""
    if depth > DEEPEST and isinstance(value, Mapping | list | tuple):
        return "..."
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # JSON escapes text as TOML does, except for the delete character.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if isinstance(value, int) and abs(value).bit_length() > LONGEST_BITS:
        # Python refuses to write integers of thousands of decimal digits.
        return f"an integer of about {round(abs(value).bit_length() * math.log10(2))} digits"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {literal(item, depth + 1)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(literal(item, depth + 1) for item in value)}]"
    return repr(value)


def counted(number: int, noun: str) -> str:
    """Write a count with its noun and a plural s: ``1 path``, ``2,000 paths``."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def percent(share: float) -> str:
    """Write a fraction as a percentage of three digits. Only exact values become 0 % or 100 %."""
    if 0.0 < share < 1e-6:
        return "less than 0.0001 %"
    if 0.9995 <= share < 1.0:
        return "more than 99.9 %"
    return f"{plain(100.0 * share, 3)} %"


def plain(value: float, digits: int) -> str:
    """Write a number to so many digits, preferably without an exponent: ``100``, not ``1e+02``."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < MOST_PLAIN else text


def at_least(value: float) -> str:
    """Write a lower limit to six digits, rounded up so that the written number satisfies it."""
    return _rounded(value, math.inf)


def at_most(value: float) -> str:
    """Write an upper limit to six digits, rounded down so that the written number satisfies it."""
    return _rounded(value, -math.inf)


def _rounded(value: float, towards: float) -> str:
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    text = f"{value:.6g}"
    if float(text) >= value if towards > 0 else float(text) <= value:
        return text
    step = 10.0 ** (math.floor(math.log10(abs(value))) - 5)
    return f"{value + math.copysign(step, towards):.6g}"
