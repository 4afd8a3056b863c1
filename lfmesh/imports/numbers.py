"""Parsing of numbers in lens files, which must be finite."""

import math
from decimal import Decimal


def number(word: str) -> float:
    """Return a finite number.

    Raises
    ------
    ValueError
        The word is not a finite number; the message says so.
    """
    try:
        value = float(word)
    except ValueError:
        raise ValueError(f"{word[:30]!r} is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{word[:30]!r} is not finite")
    return value


def numbers(words: list[str]) -> list[float]:
    """Return words as numbers; raise the errors of `number`."""
    return [number(word) for word in words]


def nanometres(word: str) -> float:
    """Convert a word in µm to nm, rounded once; raise the errors of `number`."""
    number(word)
    return float(Decimal(word).scaleb(3))


def micrometres(nm: float) -> str:
    """Return a length in nm as a word in µm that `nanometres` converts back exactly."""
    return str(Decimal(repr(nm)).scaleb(-3))


def is_number(word: str) -> bool:
    """Tell whether a word is a number, finite or not."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def may_matter(word: str) -> bool:
    """Tell whether a word is anything but a zero."""
    return not is_number(word) or float(word) != 0.0
