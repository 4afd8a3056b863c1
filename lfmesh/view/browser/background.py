"""Jobs of a page in a thread beside it, so that the page shows their progress and answers meanwhile."""

import asyncio
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

from lfmesh.notebook import Say
from lfmesh.view.browser.replies import Replies

Result = TypeVar("Result")

SHOWN_SECONDS = 0.3
"""Time between two messages on a job."""


class _StoppedError(Exception):
    """The page no longer waits for the job."""


class _Ended(NamedTuple):
    """End of a job: its result, or what it raised."""

    result: Any
    raised: Exception | None


class Background:
    """One job at a time beside a page; a new one replaces the one before.

    Parameters
    ----------
    server : trame_server.Server
    replies : Replies
    """

    def __init__(self, server: Any, replies: Replies) -> None:
        self._state, self._replies = server.state, replies
        self._threads = ThreadPoolExecutor(1, "lfmesh page")
        self._stop = threading.Event()
        self._task: asyncio.Task[None] | None = None

    def begin(
        self, compute: Callable[[Say], Result], show: Callable[[str], None], finish: Callable[[Result], None]
    ) -> None:
        """Begin a job; its faults are shown in the page.

        Parameters
        ----------
        compute : callable
            Computes the result in the thread. Called with a function for the progress in words, which ends the job
            once the page no longer waits for it.
        show : callable
            Called in the page with the progress and the elapsed time in words, and with "" at the end.
        finish : callable
            Called in the page with the result.
        """
        self.stop()
        stop = self._stop = threading.Event()
        latest = ["waiting"]

        def say(words: str) -> None:
            if stop.is_set():
                raise _StoppedError
            latest[0] = words

        def job() -> _Ended:
            if stop.is_set():
                return _Ended(None, _StoppedError())
            try:
                return _Ended(compute(say), None)
            except Exception as fault:  # shown in the page
                return _Ended(None, fault)

        async def wait() -> None:
            began, ending = time.monotonic(), asyncio.get_running_loop().run_in_executor(self._threads, job)
            try:
                while not ending.done():
                    with self._state:
                        show(f"{latest[0]}, {time.monotonic() - began:.0f} s")
                    await asyncio.wait({ending}, timeout=SHOWN_SECONDS)
            finally:
                ending.cancel()
            with self._state:
                show("")
                result, raised = ending.result()
                if raised is None:
                    self._replies.attempt(finish, result)
                elif not stop.is_set():
                    self._replies.show(raised)

        self._task = asyncio.ensure_future(wait())

    def stop(self) -> None:
        """Stop the job, if any, at its next message."""
        self._stop.set()
        if self._task is not None:
            self._task.cancel()

    def close(self) -> None:
        """Stop the job and end the thread."""
        self.stop()
        self._threads.shutdown(wait=False, cancel_futures=True)
