"""Workers of dask.distributed, on this machine or behind a scheduler's address."""

import threading
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Any

from lfmesh import provenance
from lfmesh.errors import LfmeshError

LOCAL = "local"
"""Address that stands for a cluster on this machine."""

RETRIES = 1
"""Number of retries of a task whose worker died."""

SAID_SECONDS, ENDS_SECONDS = 10.0, 300.0
"""Time before a warning about a cluster without a worker or a responding scheduler, and time before giving up."""

GONE = "the scheduler is gone"
"""Message for a scheduler that no longer answers."""

_ANSWER_SECONDS = 5.0
"""Time within which a living scheduler reports its workers."""


class ClusterWarning(UserWarning):
    """A cluster has no worker, or its scheduler does not answer."""


@contextmanager
def connected(address: str, workers: int) -> Iterator[Any]:
    """Yield a client of a scheduler.

    Parameters
    ----------
    address : str
        Address of a scheduler, such as "tcp://10.0.0.1:8786", or "local".
    workers : int
        Number of processes of a local cluster, with one thread each.

    Raises
    ------
    LfmeshError
        dask.distributed is not installed, no scheduler answers, a worker runs another program, or the scheduler is lost
        during a message.
    """
    try:
        from distributed import Client, LocalCluster
        from distributed.client import ClosedClientError
        from distributed.comm import CommClosedError
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in ("distributed", "dask")
        why = "" if missing else f", which cannot be imported: {error}"
        raise LfmeshError(f'--dask needs dask.distributed{why}: pip install "lfmesh[cluster]"') from None
    if address == LOCAL:
        with (
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            _refuse_other_programs(client)
            yield client
        return
    try:
        client = Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise LfmeshError(f"--dask {address}: no scheduler answers there: {error}") from None
    with client:
        try:
            _refuse_other_programs(client)
            yield client
        except (CommClosedError, ClosedClientError) as error:
            raise _ended(GONE) from error


def next_done(client: Any, done: "SimpleQueue[Any]") -> Any:
    """Return the next future from a queue filled by the callbacks of finished ones.

    Parameters
    ----------
    client : distributed.Client
    done : SimpleQueue

    Raises
    ------
    LfmeshError
        The scheduler is lost, or for `ENDS_SECONDS` did not answer or had no worker.

    Warns
    -----
    ClusterWarning
        A worker or the scheduler is missing; waiting continues.
    """
    lacks = _lacks(client)
    while True:
        try:
            future = done.get(timeout=1.0)
            if future.status != "cancelled" or client.status == "running":
                return future
            # A lost scheduler cancels all futures; the client looks for it for a while.
            done.put(future)
            time.sleep(0.5)
        except Empty:
            pass
        next(lacks)


def wait_for_worker(client: Any) -> None:
    """Wait until a cluster has a worker.

    Parameters
    ----------
    client : distributed.Client

    Raises
    ------
    LfmeshError
        As for `next_done`.

    Warns
    -----
    ClusterWarning
        A worker or the scheduler is missing; waiting continues.
    """
    for lack in _lacks(client):
        if not lack:
            return
        time.sleep(0.5)


def _lacks(client: Any) -> Iterator[str]:
    """Yield the reason why a cluster cannot compute, or ""; warn if it persists, raise if it does not end."""
    since, said = time.monotonic(), False
    while True:
        lack = _lack_of(client)
        now = time.monotonic()
        if not lack:
            since, said = now, False
        elif client.status == "closed" or now - since > ENDS_SECONDS:
            raise _ended(lack)
        elif now - since > SAID_SECONDS and not said:
            said = True
            warnings.warn(f"--dask: {lack}: waiting for up to {ENDS_SECONDS:.0f} s", ClusterWarning, stacklevel=3)
        yield lack


def _ended(lack: str) -> LfmeshError:
    """Return the error that ends a run for lack of a worker or scheduler."""
    return LfmeshError(f"--dask: {lack}; finished work is kept, and the same command continues it")


def _lack_of(client: Any) -> str:
    """Return the reason why a cluster cannot compute, or ""."""
    if client.status != "running":
        return GONE
    found: SimpleQueue[dict[str, int]] = SimpleQueue()
    threading.Thread(target=lambda: found.put(client.nthreads()), daemon=True).start()
    try:
        return "" if found.get(timeout=_ANSWER_SECONDS) else "no worker has joined the scheduler"
    except Empty:
        return "the scheduler does not answer"


def _refuse_other_programs(client: Any) -> None:
    """Refuse workers with another lfmesh or other bit-determining libraries than this process."""
    from distributed.comm import CommClosedError

    for worker, theirs in client.run(_program, on_error="return").items():
        if isinstance(theirs, CommClosedError):
            # The worker has left, but the scheduler does not know it yet.
            continue
        if isinstance(theirs, Exception):
            raise theirs
        if said := provenance.difference(theirs):
            raise LfmeshError(f"--dask: worker {worker} runs another program: {said}")


def _program() -> dict[str, str]:
    """Return the program of the process that runs this function."""
    return provenance.program()


def threads_of(client: Any) -> int:
    """Return the number of threads of all workers, at least 1."""
    return max(1, sum(client.nthreads().values()))
