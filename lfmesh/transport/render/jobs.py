"""Jobs: pieces of a render that other processes trace, folded to the same bits as in a single process."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

from lfmesh.scene import Scene, loads
from lfmesh.transport.engine import CHUNK
from lfmesh.transport.render.adaptive import Counts
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.plan import Block
from lfmesh.transport.render.render import Clock, folded, number_of
from lfmesh.transport.render.tally import Piece, Tally
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.world import build


@dataclass(frozen=True)
class Job:
    """A block of one replicate of a scene, for another process; it can be pickled.

    Attributes
    ----------
    scene : str
        The scene as TOML.
    folder : str
        Folder that paths in the scene are relative to.
    replicate : int
        Numbered through, from the first stage to the second.
    block : Block
    chunk : int
        Number of packets that start a chunk.
    levels : (pixels,) uint8, or None
        Samples of each pixel in a second stage, see `lfmesh.transport.render.adaptive.samples_of`.
    """

    scene: str
    folder: str
    replicate: int
    block: Block
    chunk: int
    levels: Counts | None = None


Map = Callable[[Callable[[Job], Piece], Iterable[Job]], Iterable[Piece]]
"""Python's own `map`, or that of an executor: results in the order of the jobs."""


def traced(job: Job) -> Piece:
    """Trace a job; a process that traces several jobs of a scene builds its world once."""
    return _tracer(job.scene, job.folder, job.chunk).piece(job.replicate, job.block, job.levels)


@lru_cache(maxsize=1)
def _tracer(scene: str, folder: str, chunk: int) -> Tracer:
    return Tracer(build(loads(scene, folder)), chunk)


def render_in_jobs(scene: Scene, mapped: Map, blocks: int = 1, chunk: int = CHUNK) -> Image:
    """Render a scene in jobs; the image is bitwise that of `lf.render`.

    Parameters
    ----------
    scene : Scene
    mapped : callable
        `map`, the `map` of a process pool, or its like on a cluster.
    blocks : int
        Approximate number of jobs for each replicate.
    chunk : int
        Number of packets that start a chunk; the bits of the image depend on it.
    """
    tracer = Tracer(build(scene), chunk)
    text, folder = scene.dump_toml(), str(scene.folder)
    replicates = scene.transport.replicates

    def tallies(first: int, levels: Counts | None) -> Iterator[Tally]:
        cut = tracer.plan.blocks(blocks, second=levels is not None)
        numbers = [number_of(number, replicates, levels) for number in range(first, replicates)]
        jobs = (Job(text, folder, number, block, chunk, levels) for number in numbers for block in cut)
        tally = tracer.layout.tally()
        for number, pieces in groupby(mapped(traced, jobs), lambda piece: piece.replicate):
            tally.restart(number)
            tally.merge(pieces)
            yield tally

    state = tracer.layout.state()
    return folded(tracer, state, tallies, Clock(state))
