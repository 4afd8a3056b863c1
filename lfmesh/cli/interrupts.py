"""Ctrl-C, SIGTERM and SIGHUP: deferred during imports, and handled alike, so that a render keeps its work."""

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that end a command as Ctrl-C does: SIGTERM from a job scheduler, SIGHUP from a terminal that is closed."""

AGAIN_S = 0.05
"""Seconds after which a signal is sent again, if Python has dropped the exception of its handler."""

_last = [signal.SIGINT]


class Terminated(KeyboardInterrupt):
    """One of `ENDING`."""


def code_of_last() -> int:
    """Return the exit code for the last signal, 128 plus its number; Ctrl-C's if none came."""
    return 128 + _last[0]


@contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """Let the signals of `ENDING` end the body as Ctrl-C does, unless they have other handlers already.

    If the handler happens to run in a destructor or a callback of the garbage collector, Python drops its exception;
    the signal is then sent again.
    """
    _last[0] = signal.SIGINT
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    ours = [number for number in ENDING if signal.getsignal(number) == signal.SIG_DFL]
    for number in ours:
        signal.signal(number, _terminate)
    usual, timers = sys.unraisablehook, list[threading.Timer]()

    def send_again(unraisable: Any) -> None:
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            usual(unraisable)
            return
        number = _last[0] if issubclass(unraisable.exc_type, Terminated) else signal.SIGINT
        timers.append(threading.Timer(AGAIN_S, _thread.interrupt_main, [number]))
        timers[-1].daemon = True
        timers[-1].start()

    sys.unraisablehook = send_again
    try:
        yield
    finally:
        sys.unraisablehook = usual
        for timer in timers:
            timer.cancel()
        for number in ours:
            if signal.getsignal(number) is _terminate:
                signal.signal(number, signal.SIG_DFL)


@contextmanager
def defer_interrupt() -> Iterator[None]:
    """Defer interrupts until the body is done: libraries that catch every exception on import swallow them."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDING)}
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
    if came and came[0] in ENDING:
        _terminate(came[0])
    if came:
        raise KeyboardInterrupt


def _terminate(number: int, *_: Any) -> None:
    _last[0] = signal.Signals(number)
    raise Terminated
