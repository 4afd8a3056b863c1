"""Printing: wrapped lines, notes on standard error, lists of the files written."""

import sys
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lfmesh.errors import LensFileWarning

COLUMNS = 80
"""Width of what is printed, on a terminal or not."""


def wrapped(text: str) -> str:
    """Break a text into lines of at most `COLUMNS` characters; all but the first are indented."""
    return textwrap.fill(text, COLUMNS, subsequent_indent="  ")


@contextmanager
def warnings_as_notes(kind: type[UserWarning] = UserWarning) -> Iterator[None]:
    """Print the library's warnings of one kind as notes, after the body; drop the others."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore", UserWarning)
        warnings.simplefilter("always", kind)
        yield
    for warning in caught:
        say_note(warning.message)


@contextmanager
def lens_files_as_notes() -> Iterator[None]:
    """Print what is doubtful in lens files as notes, when they are read; other warnings go their usual way."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *rest: Any, **options: Any) -> None:
        if issubclass(category, LensFileWarning):
            say_note(message)
        else:
            usual(message, category, *rest, **options)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def say_note(note: object) -> None:
    """Print a note on standard error."""
    print(wrapped(f"Note: {note}"), file=sys.stderr)


def list_files(paths: Sequence[Path]) -> None:
    """Print the files that were written, one a line."""
    for path in paths:
        print(f"  {path}")
