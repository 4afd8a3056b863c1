"""Threads that trace for the main thread, and stop when it no longer waits for them."""

import threading
from concurrent.futures import ThreadPoolExecutor

_own = threading.local()


class TracingStopped(Exception):  # noqa: N818  # no error: nobody waits for what was being traced
    """The main thread no longer waits for what this thread traces."""


class Threads(ThreadPoolExecutor):
    """Pool of tracing threads, as a context manager; on leaving its body, all tracing stops.

    So Ctrl-C and SIGTERM, received by the waiting main thread, end a run at once.

    Parameters
    ----------
    count : int
    """

    def __init__(self, count: int) -> None:
        self._stop = threading.Event()
        super().__init__(count, "lfmesh", _work_until, (self._stop,))

    def __exit__(self, *raised: object) -> None:
        self._stop.set()
        self.shutdown(cancel_futures=True)


def stop_if_unwanted() -> None:
    """Stop the calling thread's tracing if the main thread no longer waits for it.

    Raises
    ------
    TracingStopped
    """
    stop = getattr(_own, "stop", None)
    if stop is not None and stop.is_set():
        raise TracingStopped


def _work_until(stop: threading.Event) -> None:
    _own.stop = stop
