"""Threads that trace for the main one, and stop when that no longer waits for them."""

import threading
from concurrent.futures import ThreadPoolExecutor

_own = threading.local()


class TracingStopped(Exception):  # noqa: N818  # no error: nobody waits for what was being traced
    """The main thread no longer waits for what this thread traces."""


class Threads(ThreadPoolExecutor):
    """A pool of threads to trace in, as a context manager: what they trace when its body is left, they stop.

    So Ctrl-C and SIGTERM, which the main thread receives while it waits for a result, end a run at once, however long
    a chunk of packets would take.

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
    """End what the calling thread traces, if nobody waits for that any more.

    Raises
    ------
    TracingStopped
    """
    stop = getattr(_own, "stop", None)
    if stop is not None and stop.is_set():
        raise TracingStopped


def _work_until(stop: threading.Event) -> None:
    _own.stop = stop
