"""Renders on a cluster, through the scheduler of dask.distributed.

Workers trace blocks of replicates and join the pieces in a tree, so that one piece per replicate comes back. They read
the scene's files at the same paths as this process, and refuse files that differ.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import groupby
from queue import SimpleQueue
from typing import Any

from numpy.typing import NDArray

from lfmesh.cluster import LOCAL, RETRIES, connected, next_done, threads_of
from lfmesh.errors import LfmeshError
from lfmesh.scene import Scene
from lfmesh.transport.build import build
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.jobs import Job, reduced, traced
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.render import Keeper, Untraced
from lfmesh.transport.render.tally import Piece, joined
from lfmesh.transport.render.tracer import Tracer

JOBS = 2
"""Approximate jobs of a stage per worker thread: with more of them, the slowest delays the others less."""

AHEAD = 4
"""Jobs given to the scheduler per worker thread: it need not wait for us, and memory stays flat."""

WIDTH = 4
"""Number of pieces that a worker joins at a time."""


def render_on_cluster(
    scene: Scene, address: str = LOCAL, workers: int | None = None, *,
    progress: Callable[[Progress], None] | None = None, saved: Mapping[str, NDArray[Any]] | None = None,
    keep: Keeper | None = None, untraced: Untraced | None = None,
) -> Image:  # fmt: skip
    """Render a scene with dask; the image is bitwise that of `lf.render`.

    Parameters
    ----------
    scene : Scene
        Its files have the digests that `Scene.pinned` records, if it was called.
    address : str
        Address of a scheduler, such as "tcp://10.0.0.1:8786", or "local".
    workers : int, optional
        Processes of a local cluster. Default: number of cores of this machine.
    progress : callable, optional
        Called after every replicate.
    saved, keep, untraced
        As for `lfmesh.transport.render.render.render`.

    Raises
    ------
    LfmeshError
        dask.distributed is not installed, no scheduler answers or it is gone, or a worker cannot trace the scene.
    """
    with connected(address, workers or os.cpu_count() or 1) as client:
        threads = threads_of(client)
        blocks = max(1, -(-JOBS * threads // scene.transport.replicates))
        pieces = partial(_pieces, client)
        return reduced(
            Tracer(build(scene)), pieces, blocks, keep=keep, saved=saved, progress=progress, untraced=untraced
        )


def _pieces(client: Any, jobs: Iterable[Job]) -> Iterator[Piece]:
    """Yield one piece per replicate."""
    waiting: deque[tuple[Any, int]] = deque()
    submit = partial(client.submit, pure=False, retries=RETRIES)
    for _, own in groupby(jobs, key=lambda job: job.replicate):
        # A worker's thread is a core.
        tree = [submit(traced, replace(job, threads=1)) for job in own]
        count = len(tree)
        while len(tree) > 1:
            tree = [submit(_joined, *tree[i : i + WIDTH]) for i in range(0, len(tree), WIDTH)]
        waiting.append((tree[0], count))
        while sum(count for _, count in waiting) > AHEAD * threads_of(client):
            yield _result(client, waiting.popleft()[0])
    while waiting:
        yield _result(client, waiting.popleft()[0])


def _joined(*pieces: Piece) -> Piece:
    return joined(pieces)


def _result(client: Any, future: Any) -> Piece:
    done: SimpleQueue[Any] = SimpleQueue()
    future.add_done_callback(done.put)
    next_done(client, done)
    try:
        piece: Piece = future.result()
    except LfmeshError:
        raise
    except Exception as error:
        raise LfmeshError(f"a worker could not trace its part: {type(error).__name__}: {error}") from error
    future.release()
    return piece
