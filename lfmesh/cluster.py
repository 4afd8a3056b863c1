"""Workers of dask.distributed, on this machine or behind a scheduler's address."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
        dask.distributed is not installed, or there is no scheduler at the address.
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
            yield client
        return
    try:
        client = Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise LfmeshError(f"--dask {address}: no scheduler answers there: {error}") from None
    with client:
        yield client


def threads_of(client: Any) -> int:
    """Return the number of threads of all workers, at least 1."""
    return max(1, sum(client.nthreads().values()))
