"""Units on a cluster, through the scheduler of dask.distributed."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from lfmesh.cluster import RETRIES, connected, next_done, threads_of, wait_for_worker
from lfmesh.regular_file import read_bytes
from lfmesh.study.sweeps.pool import Result, computed
from lfmesh.study.sweeps.unit import Unit

AHEAD = 2
"""Units given to the scheduler for each thread of its workers: it need not wait for us, and memory stays flat."""


def in_dask(units: Iterable[tuple[Unit, Path]], address: str, workers: int) -> Iterator[Result]:
    """Compute units with dask, and yield them as they are done.

    Outcomes come back to this process, which writes them: workers need no folder in common with it.

    Parameters
    ----------
    units : iterable of (Unit, Path)
    address : str
        Of a scheduler, such as "tcp://10.0.0.1:8786", or "local".
    workers : int
        Number of processes of a local cluster.

    Raises
    ------
    LfmeshError
        dask.distributed is not installed, there is no scheduler at the address, it has no worker, or it is gone.
    """
    with connected(address, workers) as client:
        yield from _through(client, units)


def _through(client: Any, units: Iterable[tuple[Unit, Path]]) -> Iterator[Result]:
    references: dict[Path, Any] = {}
    done: SimpleQueue[Any] = SimpleQueue()
    owners: dict[str, Unit] = {}
    waiting = iter(units)

    def spread(path: Path) -> Any:
        while True:
            wait_for_worker(client)
            try:
                return client.scatter(read_bytes(path), broadcast=True, hash=False)
            except TimeoutError:
                # The last worker left in between.
                continue

    def submit() -> bool:
        job = next(waiting, None)
        if job is None:
            return False
        unit, path = job
        if path not in references:
            references[path] = spread(path)
        future = client.submit(computed, unit, references[path], pure=False, retries=RETRIES)
        owners[future.key] = unit
        future.add_done_callback(done.put)
        return True

    wait_for_worker(client)
    for _ in range(AHEAD * threads_of(client)):
        if not submit():
            break
    while owners:
        future = next_done(client, done)
        unit = owners.pop(future.key)
        if future.status == "finished":
            content, reason = future.result()
        else:
            error = future.exception()
            content, reason = None, f"its worker died or the unit was cancelled: {type(error).__name__}: {error}"
        future.release()
        submit()
        yield Result(unit, content, reason)
