"""Progress of a command on standard error: a status line on a terminal, elsewhere plain lines."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

STATUS_SECONDS = 10.0
"""Shortest time between two lines of progress without a terminal."""


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints what is being done: on a terminal in one status line, elsewhere now and then."""
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
