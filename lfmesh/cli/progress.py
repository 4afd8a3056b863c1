"""Progress on standard error: a status line on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STATUS_SECONDS = 10.0
"""Shortest time between two progress lines without a terminal."""


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Yield a function that reports progress: in a terminal's status line, elsewhere in a plain line now and then."""
    from rich.console import Console

    errors = Console(stderr=True)
    if errors.is_terminal:
        with errors.status("building") as line:
            yield line.update
        return
    printed_at = -STATUS_SECONDS

    def say(text: str) -> None:
        nonlocal printed_at
        if time.monotonic() - printed_at >= STATUS_SECONDS:
            printed_at = time.monotonic()
            print(text, file=sys.stderr, flush=True)

    yield say
