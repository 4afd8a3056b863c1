"""Printing: wrapped lines, warnings and notes on standard error, lists of the files written."""

import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lfmesh.errors import PictureWarning

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


def list_files(paths: Sequence[Path]) -> None:
    """Print the files that were written, one a line."""
    for path in paths:
        print(f"  {path}")
