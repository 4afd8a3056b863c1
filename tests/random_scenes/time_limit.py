"""Calls in a process of their own that is ended when it takes too long: a render that never ends is reported."""

import atexit
import multiprocessing
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any


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
    worker.pipe.send((function, arguments))
    try:
        if not worker.pipe.poll(seconds):
            raise TookTooLongError(f"{function.__name__}{arguments} has not ended after {seconds:g} s")
        result, error = worker.pipe.recv()
    except (TookTooLongError, EOFError):
        _end()
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
            function, arguments = pipe.recv()
        except EOFError:
            return
        try:
            answer = (function(*arguments), None)
        except Exception:
            answer = (None, traceback.format_exc())
        pipe.send(answer)
