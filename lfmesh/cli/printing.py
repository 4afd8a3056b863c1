"""Printing: warnings and notes on standard error, lists of files written."""

import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfmesh.errors import PictureWarning, warn_caller
from lfmesh.wrapping import wrapped

if TYPE_CHECKING:
    from lfmesh.scene import FirstOrder


@contextmanager
def warnings_in_words() -> Iterator[None]:
    """Print each warning once on standard error as it comes: picture warnings as warnings, others as notes.

    The name in brackets is the class that assets/docs/warnings explains.
    """
    told: set[str] = set()
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if not issubclass(category, UserWarning):
            usual(message, category, *rest, **options)
        elif str(message) not in told:
            told.add(str(message))
            kind = "Warning" if issubclass(category, PictureWarning) else "Note"
            name = f" [{category.__name__}]" if category.__module__ == PictureWarning.__module__ else ""
            print(wrapped(f"{kind}: {message}{name}"), file=sys.stderr, flush=True)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show
        yield


def say_note(note: object) -> None:
    """Print a note on standard error."""
    print(wrapped(f"Note: {note}"), file=sys.stderr)


def say_warnings(found: Sequence[PictureWarning], report: "FirstOrder") -> None:
    """Warn of possible faults of a picture, and print the remaining notes of a first-order report.

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
    """Print the files written, one per line."""
    for path in paths:
        print(f"  {path}")
