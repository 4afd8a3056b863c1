"""Numbers in the text of mesh files, many at a time."""

import warnings
from collections.abc import Sequence

import numpy as np

from lfmesh.geometry.meshes.mesh import Array, Index


def numbers(text: str | bytes, kind: type = np.float64) -> Array:
    """Return the numbers of a text that are separated by white space, (n,).

    Raises
    ------
    ValueError
        The text contains something else.
    """
    if isinstance(text, bytes):
        text = text.decode("latin-1")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, dtype=kind, sep=" ") if text.strip() else np.zeros(0, kind)
        except (DeprecationWarning, ValueError):
            pass
    wrong = next((word for word in text.split() if not _is_number(word, kind)), "?")
    raise ValueError(f"{wrong[:40]!r} is not a {'number' if kind is np.float64 else 'whole number'}")


def _is_number(word: str, kind: type) -> bool:
    try:
        float(word) if kind is np.float64 else int(word)
    except ValueError:
        return False
    return True


def table(rows: Sequence[str], least: int) -> tuple[Array, Index]:
    """Return the numbers of rows of text, filled with NaN to the longest row, and the number in each row.

    Parameters
    ----------
    rows : sequence of str
        Numbers separated by white space.
    least : int
        Least number per row.

    Returns
    -------
    values : (n, k) float64
    counts : (n,) int64

    Raises
    ------
    ValueError
        A row is too short, or contains something else.
    """
    counts = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    if len(rows) and counts.min() < least:
        raise ValueError(f"a row has {counts.min()} numbers, {rows[int(counts.argmin())][:40]!r}; {least} are needed")
    flat = numbers("\n".join(rows))
    if len(flat) != counts.sum():
        raise ValueError("numbers run into one another")
    width = int(counts.max(initial=least))
    if (counts == width).all():
        return flat.reshape(-1, width), counts
    values = np.full((len(rows), width), np.nan)
    values[np.arange(width) < counts[:, None]] = flat
    return values, counts
