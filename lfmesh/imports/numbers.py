"""Numbers in lens files: finite, and said to be wrong with their line where they are not."""

import math
from decimal import Decimal


def number(word: str) -> float:
    """Return a finite number.

    Raises
    ------
    ValueError
        The word is none; the message says so.
    """
    try:
        value = float(word)
    except ValueError:
        raise ValueError(f"{word[:30]!r} is no number") from None
    if not math.isfinite(value):
        raise ValueError(f"{word[:30]!r} is no finite number")
    return value


def numbers(words: list[str]) -> list[float]:
    """Return some words as numbers; errors as in `number`."""
    return [number(word) for word in words]


def nanometres(word: str) -> float:
    """Return a length that a word gives in µm, in nm, rounded once; errors as in `number`."""
    number(word)
    return float(Decimal(word).scaleb(3))


def micrometres(nm: float) -> str:
    """Return a length in nm as a word in µm, from which `nanometres` makes the same number."""
    return str(Decimal(repr(nm)).scaleb(-3))


def is_number(word: str) -> bool:
    """Return whether a word is a number, finite or not."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def may_matter(word: str) -> bool:
    """Return whether a word is anything but a number that is zero."""
    return not is_number(word) or float(word) != 0.0
