"""Calls in a process of their own that is ended when it takes too long: a render that never ends is reported.

Processor time counts, so that a busy machine does not decide.
"""

import atexit
import math
import multiprocessing
import resource
import signal
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

WAITS = 50.0
"""How many times as long a call may take by the clock as of a processor: what waits for ever hangs as well."""


class TookTooLongError(Exception):
    """A call did not end within its time."""


class _Worker:
    """A process that calls one function after another; kernels that it has loaded serve the next call."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


_workers: list[_Worker] = []


def within(seconds: float, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function of a module returns, called in another process.

    Parameters
    ----------
    seconds : float
        Of a processor.
    function : callable
    *arguments : object

    Raises
    ------
    TookTooLongError
        It has not ended in time, and was ended.
    RuntimeError
        It raised; the message is its traceback.
    """
    if not _workers:
        _workers.append(_Worker())
    worker = _workers[0]
    worker.pipe.send((seconds, function, arguments))
    try:
        if not worker.pipe.poll(WAITS * seconds):
            raise EOFError
        result, error = worker.pipe.recv()
    except EOFError:
        worker.process.join(1.0)
        late = worker.process.exitcode in (None, -signal.SIGXCPU)
        _end()
        if late:
            raise TookTooLongError(
                f"{function.__name__}{arguments} has not ended after {seconds:g} s of a processor"
            ) from None
        raise
    if error is not None:
        raise RuntimeError(error)
    return result


@atexit.register
def _end() -> None:
    while _workers:
        _workers.pop().end()


def _serve(pipe: Connection) -> None:
    while True:
        try:
            seconds, function, arguments = pipe.recv()
        except EOFError:
            return
        spent = resource.getrusage(resource.RUSAGE_SELF)
        # Whole seconds; the signal of the limit ends the process.
        allowed = math.ceil(spent.ru_utime + spent.ru_stime + seconds)
        resource.setrlimit(resource.RLIMIT_CPU, (allowed, resource.RLIM_INFINITY))
        try:
            answer = (function(*arguments), None)
        except Exception:
            answer = (None, traceback.format_exc())
        pipe.send(answer)
