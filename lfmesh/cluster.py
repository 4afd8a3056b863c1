"""Workers of dask.distributed, on this machine or behind a scheduler's address."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from lfmesh import provenance
from lfmesh.errors import LfmeshError

LOCAL = "local"
"""In place of a scheduler's address: a cluster on this machine."""

RETRIES = 1
"""A task whose worker dies is tried again so many times."""


@contextmanager
def connected(address: str, workers: int) -> Iterator[Any]:
    """Yield a client of a scheduler.

    Parameters
    ----------
    address : str
        Of a scheduler, such as "tcp://10.0.0.1:8786", or "local".
    workers : int
        Number of processes of a local cluster, of one thread each.

    Raises
    ------
    LfmeshError
        dask.distributed is not installed, there is no scheduler at the address, or a worker runs another program.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise LfmeshError('--dask needs dask.distributed: pip install "lfmesh[cluster]"') from None
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
        _refuse_other_programs(client)
        yield client


def _refuse_other_programs(client: Any) -> None:
    """Refuse workers whose lfmesh, or whose libraries that decide bits, are not those of this process."""
    for worker, theirs in client.run(_program).items():
        if said := provenance.difference(theirs):
            raise LfmeshError(f"--dask: worker {worker} runs another program: {said}")


def _program() -> dict[str, str]:
    """Return the program of the process that this is called in: a worker calls its own."""
    return provenance.program()


def threads_of(client: Any) -> int:
    """Return the number of threads of all workers, at least 1."""
    return max(1, sum(client.nthreads().values()))
