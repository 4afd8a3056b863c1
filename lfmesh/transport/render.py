"""From a scene to an image: replicates, chunks, threads, film."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.adjoint import launch_adjoint, launch_along_image_path
from lfmesh.transport.choice import engine_of
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.forward import launch_forward
from lfmesh.transport.image import Image
from lfmesh.transport.ledger import Ledger
from lfmesh.transport.packet import COUNTERS, DEPOSITS
from lfmesh.transport.progress import Progress
from lfmesh.transport.random import descendant
from lfmesh.transport.settings import ledger_of, options_of
from lfmesh.transport.world import World, build

PROGRESS_SECONDS = 0.2


@dataclass(frozen=True)
class Chunk:
    """A run of sources of one replicate and wavelength: pixels (adjoint) or packets (forward)."""

    first: int
    count: int
    wave: int
    packets: int


@dataclass
class Tally:
    """What chunks add up to, apart from the film."""

    book: NDArray[np.float64]
    counts: NDArray[np.int64]
    embree_seconds: float = 0.0
    thread_seconds: float = 0.0
    queries: int = 0

    def add(self, other: "Tally") -> None:
        """Add another tally to this one."""
        self.book += other.book
        self.counts += other.counts
        self.embree_seconds += other.embree_seconds
        self.thread_seconds += other.thread_seconds
        self.queries += other.queries


Waiting = deque[tuple[Chunk, Future[tuple[Tally, NDArray[np.void]]]]]
"""Chunks handed to the pool, in order, with what they will return: tally and deposits."""


@dataclass
class Mean:
    """Running mean and sum of squared deviations over replicates (Welford 1962)."""

    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    count: int = 0

    def add(self, sample: NDArray[np.float64]) -> None:
        """Add one replicate's film; `sample` is used up."""
        self.count += 1
        # Row by row: the film may be large, and a temporary of its size per operation is memory for nothing.
        for mean, squares, row in zip(self.mean, self.squares, sample, strict=True):
            change = row - mean
            mean += change / self.count
            squares += change * (row - mean)

    def stderr(self) -> NDArray[np.float64]:
        """Return the standard error of the mean; NaN from fewer than two replicates. Uses up `squares`."""
        if self.count < 2:
            self.squares[:] = np.nan
            return self.squares
        self.squares /= self.count * (self.count - 1)
        return np.sqrt(self.squares, out=self.squares)


def render(scene: Scene, progress: Callable[[Progress], None] | None = None) -> Image:
    """Trace a scene's raw sensor image.

    Parameters
    ----------
    scene : Scene
    progress : callable, optional
        Called a few times a second, in the calling thread.

    Returns
    -------
    Image
        Of the finished replicates, where Ctrl-C cut the run short.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built.
    """
    return Renderer(build(scene), progress).image()


@dataclass
class Renderer:
    """A render under way.

    Attributes
    ----------
    world : World
    progress : callable, optional
    chunk : int
        Packets a chunk starts with.
    aimed : bool
        Forward: aim scattered light at the entrance pupil. Without, each packet is scattered by chance and most miss
        the lens: the paper's chain without its aiming, to measure what that brings.
    stratified : bool
        Adjoint: start paths from scrambled Sobol' points instead of random ones.
    """

    world: World
    progress: Callable[[Progress], None] | None = None
    chunk: int = CHUNK
    aimed: bool = True
    stratified: bool = True
    _local: threading.local = field(default_factory=threading.local)
    _last_report: float = 0.0

    def __post_init__(self) -> None:
        scene = self.world.scene
        transport = scene.transport
        self.waves = len(transport.wavelengths_nm)
        self.pixels = self.world.tables.sensor.columns * self.world.tables.sensor.rows
        self.samples = transport.samples // transport.replicates
        self.adjoint = transport.method == "adjoint"
        self.options = options_of(self.world, aimed=self.aimed)
        self.threads = transport.threads or os.cpu_count() or 1
        self.seed = descendant(0x6C666D657368, transport.seed)

    def chunks(self) -> Iterator[Chunk]:
        """Yield the chunks of one replicate, always in the same order."""
        per_chunk = max(1, self.chunk // self.samples) if self.adjoint else self.chunk
        total = self.pixels if self.adjoint else self.pixels * self.samples
        for wave in range(self.waves):
            for first in range(0, total, per_chunk):
                count = min(per_chunk, total - first)
                yield Chunk(first, count, wave, count * self.samples if self.adjoint else count)

    def image(self) -> Image:
        """Render all replicates, or as many as Ctrl-C leaves time for."""
        scene = self.world.scene
        tables = self.world.tables
        began = time.perf_counter()
        shape = (tables.sensor.rows, tables.sensor.columns, self.waves)
        film = np.zeros((self.pixels, self.waves))
        mean = Mean(np.zeros(shape), np.zeros(shape))
        tally = self._tally()
        with ThreadPoolExecutor(self.threads, thread_name_prefix="lfmesh") as pool:
            for replicate in range(scene.transport.replicates):
                film[:] = 0.0
                try:
                    part = self._replicate(pool, replicate, film, began)
                except KeyboardInterrupt:
                    if mean.count == 0:
                        raise
                    break
                mean.add(film.reshape(shape))
                tally.add(part)
        seconds = time.perf_counter() - began
        ledger = self._ledger(tally, mean.count)
        return Image(
            mean.mean,
            mean.stderr(),
            scene,
            ledger,
            seconds,
            mean.count,
            float(self.samples * mean.count),
            ": ".join(engine_of(scene)),
            {
                "tracing_seconds": seconds,
                "thread_seconds": tally.thread_seconds,
                "embree_seconds": tally.embree_seconds,
                "embree_queries": tally.queries,
                "threads": self.threads,
            },
        )

    def _tally(self) -> Tally:
        return Tally(np.zeros(len(self.world.slots)), np.zeros(COUNTERS, np.int64))

    def _replicate(self, pool: ThreadPoolExecutor, replicate: int, film: NDArray[np.float64], began: float) -> Tally:
        """Trace one replicate onto an empty film; the chunks' results are merged in their order."""
        key = descendant(self.seed, replicate)
        tally = self._tally()
        waiting: Waiting = deque()
        done = 0
        try:
            for chunk in self.chunks():
                waiting.append((chunk, pool.submit(self._trace, chunk, descendant(key, chunk.wave), film)))
                if len(waiting) > 2 * self.threads:
                    done += self._merge(waiting, tally, film)
                    self._report(replicate, done, began)
            while waiting:
                done += self._merge(waiting, tally, film)
                self._report(replicate, done, began)
        except BaseException:
            for _, future in waiting:
                future.cancel()
            raise
        return tally

    def _merge(
        self, waiting: Waiting, tally: Tally, film: NDArray[np.float64]
    ) -> int:  # fmt: skip
        """Add the oldest chunk's result; return how many packets it started with."""
        chunk, future = waiting[0]
        part, deposits = future.result()
        waiting.popleft()
        tally.add(part)
        np.add.at(film, (deposits["pixel"], deposits["wave"]), deposits["weight"])
        return chunk.packets

    def _trace(self, chunk: Chunk, key: np.uint64, film: NDArray[np.float64]) -> tuple[Tally, NDArray[np.void]]:
        """Trace one chunk in a thread of the pool."""
        began = time.perf_counter()
        if not hasattr(self._local, "workspace"):
            self._local.workspace = Workspace(self.world, self.options, self.chunk)
        space: Workspace = self._local.workspace
        tables = self.world.tables
        if self.adjoint:
            space.begin(film[chunk.first : chunk.first + chunk.count], chunk.first)
            if self.options.sequential:
                launch_along_image_path(
                    chunk.first, chunk.count, self.samples, self.stratified, key, chunk.wave, tables.sensor,
                    tables.lens, tables.array, tables.aim, tables.frames, space.bundle, space.numbers, space.options,
                    space.flow(), space.start,
                )  # fmt: skip
            else:
                launch_adjoint(
                    chunk.first, chunk.count, self.samples, self.stratified, key, chunk.wave, tables.sensor,
                    tables.array, tables.aim, tables.frames, len(tables.lens.surfaces), space.bundle, space.flow(),
                    space.start,
                )  # fmt: skip
        else:
            space.begin(film[:0])
            if len(tables.objects.sources):
                launch_forward(
                    chunk.first, chunk.count, self.pixels * self.samples, key, chunk.wave,
                    tables.objects, tables.aim, tables.frames, space.options, space.flow(), space.template,
                )  # fmt: skip
        space.run()
        part = Tally(
            space.book.copy(),
            space.counts.copy(),
            space.embree_seconds,
            time.perf_counter() - began,
            space.queries,
        )
        return part, space.deposits[: space.tops[DEPOSITS]].copy()

    def _report(self, replicate: int, done: int, began: float) -> None:
        now = time.perf_counter()
        if self.progress is None or now - self._last_report < PROGRESS_SECONDS:
            return
        self._last_report = now
        replicates = self.world.scene.transport.replicates
        one = self.waves * self.pixels * self.samples
        self.progress(Progress(replicate * one + done, replicates * one, now - began, replicate, replicates, "tracing"))

    def _ledger(self, tally: Tally, replicates: int) -> Ledger:
        started = self.waves * self.pixels * self.samples * replicates
        return ledger_of(
            tally.book / max(replicates, 1),
            tally.counts,
            self.world,
            started,
            "m² sr" if self.adjoint else "W",
        )
