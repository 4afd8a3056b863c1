"""Ctrl-C and SIGTERM: held back while libraries are imported, and alike for a render, which keeps what is finished."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Terminated(KeyboardInterrupt):
    """SIGTERM, as a job scheduler sends it."""


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Let SIGTERM end the body as Ctrl-C does, where nobody else has taken that signal."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is _terminate:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextmanager
def defer_interrupt() -> Iterator[None]:
    """Hold interrupts back until the body is done: libraries that catch everything while they are imported eat them."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    ours = {
        number: handler for number, handler in before.items() if handler in (signal.default_int_handler, _terminate)
    }
    if not ours or threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    for number in ours:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in ours.items():
            signal.signal(number, handler)
    if came:
        raise Terminated if came[0] == signal.SIGTERM else KeyboardInterrupt


def _terminate(*_: Any) -> None:
    raise Terminated
