"""Computation of units on a dask.distributed cluster."""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from lfmesh.cluster import ENDS_SECONDS, RETRIES, connected, next_done, threads_of, wait_for_worker
from lfmesh.regular_file import read_bytes
from lfmesh.study.sweeps.pool import Result, computed
from lfmesh.study.sweeps.unit import Unit

AHEAD = 2
"""Units submitted per worker thread: the scheduler never waits for this process, and memory stays constant."""


def in_dask(units: Iterable[tuple[Unit, Path]], address: str, workers: int) -> Iterator[Result]:
    """Compute units with dask, and yield them as they finish.

    Results return to this process, which writes them: workers need no shared folder.

    Parameters
    ----------
    units : iterable of (Unit, Path)
    address : str
        Address of a scheduler, such as "tcp://10.0.0.1:8786", or "local".
    workers : int
        Number of processes of a local cluster.

    Raises
    ------
    LfmeshError
        dask.distributed is not installed, no scheduler answers at the address, it has no workers, or it is lost.
    """
    with connected(address, workers) as client:
        yield from _through(client, units)


def _through(client: Any, units: Iterable[tuple[Unit, Path]]) -> Iterator[Result]:
    references: dict[Path, Any] = {}
    done: SimpleQueue[Any] = SimpleQueue()
    running: dict[str, _Job] = {}
    waiting = (_Job(unit, path) for unit, path in units)
    again: deque[_Job] = deque()

    def submit() -> bool:
        job = next(waiting, None)
        if job is None and again and not running:
            job = again.popleft()
        if job is None:
            return False
        if job.path not in references:
            references[job.path] = _sent(client, job.path)
        future = client.submit(computed, job.unit, references[job.path], pure=False, retries=RETRIES)
        running[future.key] = job
        future.add_done_callback(done.put)
        return True

    wait_for_worker(client)
    for _ in range(AHEAD * threads_of(client)):
        if not submit():
            break
    while running:
        future = next_done(client, done)
        job = running.pop(future.key)
        content, reason, is_lost = _outcome(future)
        future.release()
        if is_lost and not job.is_alone:
            again.append(replace(job, is_alone=True))
        submit()
        if not is_lost or job.is_alone:
            yield Result(job.unit, content, reason)


@dataclass(frozen=True)
class _Job:
    """A unit with its input file.

    Attributes
    ----------
    is_alone : bool
        Retried alone after its worker was lost: if a worker ends again, this unit is the cause.
    """

    unit: Unit
    path: Path
    is_alone: bool = False


def _sent(client: Any, path: Path) -> Any:
    """Send the content of a file to the cluster; return its future.

    It is a task's result, which the scheduler can recreate after workers are lost, unlike scattered data.
    """
    import dask

    # The scheduler must keep it, whatever its size.
    with dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"}):
        return client.submit(bytes, read_bytes(path), pure=False, retries=RETRIES)


def _outcome(future: Any) -> tuple[bytes | None, str, bool]:
    """Return the outcome of a unit, the reason if there is none, and whether the unit was lost with its worker."""
    try:
        return *future.result(timeout=ENDS_SECONDS), False
    except Exception as error:
        # Catch everything that ends a task from outside; dask has an exception for each case.
        said = f"its worker died or the unit was cancelled: {type(error).__name__}: {error}"
        return None, said, True
