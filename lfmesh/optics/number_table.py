"""Tables of numbers in CSV files with a header line."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import FileError
from lfmesh.regular_file import open_text

Array = NDArray[np.float64]


def read_table(path: Path, columns: Sequence[str]) -> tuple[Array, ...]:
    """Read columns of numbers from a CSV file.

    Parameters
    ----------
    path : Path
        UTF-8 text; the first line names the columns, in any order.
    columns : sequence of str
        Names of all columns.

    Returns
    -------
    tuple of (n,) float64
        In the order of `columns`; numbers may be infinite or NaN.

    Raises
    ------
    FileError
        The file cannot be read, its columns are wrong, or a cell is not a number.
    """
    try:
        with open_text(path) as file:
            head = [name.strip() for name in file.readline().split(",")]
            _refuse_other_columns(path, head, columns)
            with warnings.catch_warnings():
                # Empty tables are left to the caller.
                warnings.simplefilter("ignore", UserWarning)
                rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: byte {error.start} is not UTF-8; a table is UTF-8 text") from None
    except ValueError as error:
        why = " ".join(str(error).split(";")[0].split())
        raise FileError(f"{path}: below its first line, {why}") from None
    if not rows.size:
        return tuple(np.zeros(0) for _ in columns)
    if rows.shape[1] != len(head):
        raise FileError(f"{path}: its rows have {rows.shape[1]} numbers; its first line names {len(head)} columns")
    return tuple(np.ascontiguousarray(rows[:, head.index(name)]) for name in columns)


def _refuse_other_columns(path: Path, head: list[str], columns: Sequence[str]) -> None:
    needed = f"its first line must name the columns {', '.join(columns)}"
    missing = [name for name in columns if name not in head]
    if missing:
        raise FileError(f"{path}: has no column {' and no column '.join(missing)}; {needed}")
    if sorted(head) != sorted(columns):
        extra = [name for k, name in enumerate(head) if name not in columns or name in head[:k]]
        raise FileError(f"{path}: column {extra[0][:40]!r} is unknown or given twice; {needed}, and no others")
