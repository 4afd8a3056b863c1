"""Printing: wrapped lines, warnings and notes on standard error, lists of the files written."""

import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfmesh.errors import PictureWarning, warn_caller

if TYPE_CHECKING:
    from lfmesh.scene import FirstOrder

COLUMNS = 80
"""Width of what is printed, on a terminal or not."""


def wrapped(text: str) -> str:
    """Break a text into lines of at most `COLUMNS` characters; all but the first are indented."""
    return textwrap.fill(text, COLUMNS, subsequent_indent="  ")


@contextmanager
def warnings_in_words() -> Iterator[None]:
    """Print warnings on standard error as they come, each once: of pictures as warnings, others as notes."""
    told: set[str] = set()
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if not issubclass(category, UserWarning):
            usual(message, category, *rest, **options)
        elif str(message) not in told:
            told.add(str(message))
            kind = "Warning" if issubclass(category, PictureWarning) else "Note"
            print(wrapped(f"{kind}: {message}"), file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def say_note(note: object) -> None:
    """Print a note on standard error."""
    print(wrapped(f"Note: {note}"), file=sys.stderr)


def say_warnings(found: Sequence[PictureWarning], report: "FirstOrder") -> None:
    """Warn of what may be wrong with a picture, and print the notes of a first-order report that say something else.

    Parameters
    ----------
    found : sequence of PictureWarning
    report : FirstOrder
    """
    warn_caller(found)
    known = set(map(str, found))
    for note in report.warnings:
        if note not in known:
            say_note(note)


def list_files(paths: Sequence[Path]) -> None:
    """Print the files that were written, one a line."""
    for path in paths:
        print(f"  {path}")
