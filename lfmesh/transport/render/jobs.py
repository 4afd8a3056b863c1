"""Jobs: pieces of a render for other processes, folded to the bits of a single process."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import groupby
from typing import Any

from numpy.typing import NDArray

from lfmesh.provenance import program, refuse_other
from lfmesh.scene import Scene, loads
from lfmesh.transport.build import build
from lfmesh.transport.engine import CHUNK
from lfmesh.transport.render.adaptive import Counts
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.plan import Block
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.render import Clock, Keeper, Untraced, folded, number_of, untraced_light, warned
from lfmesh.transport.render.tally import Piece, Tally
from lfmesh.transport.render.tracer import Tracer


@dataclass(frozen=True)
class Job:
    """Block of one replicate of a scene, for another process; can be pickled.

    Attributes
    ----------
    scene : str
        The scene as TOML.
    folder : str
        Base folder of paths in the scene.
    digests : tuple of (str, str)
        Files that the scene reads, and their required SHA-256.
    replicate : int
        Numbered consecutively over both stages.
    block : Block
    chunk : int
        Number of packets that start a chunk.
    levels : (pixels,) uint8, or None
        Samples of each pixel in a second stage, see `lfmesh.transport.render.adaptive.samples_of`.
    threads : int, optional
        Overrides the scene's.
    program : dict of str
        Program that requests the job, see `lfmesh.provenance.program`.
    """

    scene: str
    folder: str
    digests: tuple[tuple[str, str], ...]
    replicate: int
    block: Block
    chunk: int
    levels: Counts | None = None
    threads: int | None = None
    program: dict[str, str] = field(default_factory=program)


Reduce = Callable[[Iterable[Job]], Iterable[Piece]]
"""Traces jobs, which come replicate by replicate, and returns the pieces of each replicate before those of the next."""

Report = Callable[[Progress], None]


def traced(job: Job) -> Piece:
    """Trace a job; a process builds its world once for several jobs of a scene.

    Raises
    ------
    LfmeshError
        The program that requests the job differs from this one.
    """
    refuse_other(job.program)
    tracer = _tracer(job.scene, job.folder, job.digests, job.chunk, job.threads)
    return tracer.piece(job.replicate, job.block, job.levels)


@lru_cache(maxsize=1)
def _tracer(scene: str, folder: str, digests: tuple[tuple[str, str], ...], chunk: int, threads: int | None) -> Tracer:
    loaded = loads(scene, folder).with_digests(dict(digests))
    return Tracer(build(loaded if threads is None else loaded.changed({"transport.threads": threads})), chunk)


def jobs_of(
    scene: Scene, replicates: Iterable[int], cut: Sequence[Block], chunk: int = CHUNK, levels: Counts | None = None
) -> Iterator[Job]:
    """Yield the jobs of some replicates, all blocks of one before the next.

    Parameters
    ----------
    scene : Scene
    replicates : iterable of int
        Numbered consecutively over both stages.
    cut : sequence of Block
        Blocks that make up the sensor.
    chunk : int
        Number of packets that start a chunk; the bits of the image depend on it.
    levels : (pixels,) uint8, optional
        Levels of the second stage.
    """
    text, folder, digests = scene.dump_toml(), str(scene.folder.resolve()), tuple(sorted(scene.digests.items()))
    for replicate in replicates:
        for block in cut:
            yield Job(text, folder, digests, replicate, block, chunk, levels)


def reduced(
    tracer: Tracer, reduce: Reduce, blocks: int = 1, *, keep: Keeper | None = None,
    saved: Mapping[str, NDArray[Any]] | None = None, progress: Report | None = None, untraced: Untraced | None = None,
) -> Image:  # fmt: skip
    """Render a scene in jobs that may return joined pieces; the image is bitwise that of `lf.render`.

    Parameters
    ----------
    tracer : Tracer
        Tracer of the scene; the bits of the image depend on its chunk.
    reduce : callable
        See `Reduce`.
    blocks : int
        Approximate number of jobs per replicate.
    keep : Keeper, optional
        Called with the state after every replicate.
    saved : dict of arrays, optional
        State from `keep`, to continue from.
    progress : callable, optional
        Called after every replicate.
    untraced : callable, optional
        As for `lfmesh.transport.render.render.render`.
    """
    light = untraced_light(tracer.world, untraced, progress)
    scene = tracer.world.scene
    replicates = scene.transport.replicates
    state = tracer.layout.state(saved)
    clock = Clock(state)

    def tallies(first: int, levels: Counts | None) -> Iterator[Tally]:
        cut = tracer.plan.blocks(blocks, second=levels is not None)
        numbers = [number_of(number, replicates, levels) for number in range(first, replicates)]
        tally = tracer.layout.tally(second=levels is not None)
        pieces = reduce(jobs_of(scene, numbers, cut, tracer.chunk, levels))
        for number, of_replicate in groupby(pieces, lambda piece: piece.replicate):
            tally.restart(number)
            tally.merge(of_replicate)
            yield tally
            if progress is not None:
                one, done = tracer.plan.packets(levels), number % replicates + 1
                stage = "tracing" if levels is None else "refining"
                progress(Progress(done * one, replicates * one, clock.seconds, done, replicates, stage))

    image = warned(tracer, lambda: folded(tracer, state, tallies, clock, keep))
    return image if light is None else image.with_light(light)
