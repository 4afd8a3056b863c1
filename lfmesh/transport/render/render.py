"""From a scene to an image: replicates, chunks, threads, film."""

import os
import threading
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene import Scene
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packets.ledger import Ledger, LostEnergyWarning
from lfmesh.transport.packets.packet import COUNTERS, DEPOSITS, EVENTS
from lfmesh.transport.packets.random import descendant, run_key
from lfmesh.transport.render.adaptive import Counts, Refinement, combine, samples_of, second_stage, total_samples
from lfmesh.transport.render.adjoint import launch_adjoint, launch_along_image_path
from lfmesh.transport.render.blind_check import CHUNK as BLIND_CHUNK
from lfmesh.transport.render.blind_check import BlindSamples, first_of_runs
from lfmesh.transport.render.forward import launch_forward
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.parts import BOOKS, LAMP_BOOK, OWN_BOOK, Part, blind_part, in_words, parts_of
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.settings import ledger_of
from lfmesh.transport.world import World, build


@dataclass
class Film:
    """What the replicate under way has gathered so far.

    Attributes
    ----------
    power : (pixels, wavelengths) float64, W
    hits : (pixels, wavelengths) uint32
        Samples that brought something; forward: packets.
    """

    power: NDArray[np.float64]
    hits: NDArray[np.uint32]

    @classmethod
    def empty(cls, pixels: int, waves: int) -> "Film":
        """Return one that has gathered nothing yet."""
        return cls(np.zeros((pixels, waves)), np.zeros((pixels, waves), np.uint32))

    def clear(self) -> None:
        """Begin a replicate."""
        self.power[:] = 0.0
        self.hits[:] = 0


PROGRESS_SECONDS = 0.2

PIXELS_SORTED = 1 << 20
"""Pixels of a second stage that are sorted by their samples at once."""


@dataclass(frozen=True)
class Chunk:
    """A run of sources of one replicate, part and wavelength: pixels (adjoint) or packets (forward).

    Of a second stage, single pixels that have as many samples each. `origin` is the pixel of the film's first row.
    """

    part: Part
    first: int
    count: int
    wave: int
    packets: int
    samples: int = 1
    pixels: NDArray[np.int64] | None = None
    origin: int = 0


@dataclass
class Tally:
    """What chunks add up to, apart from the film."""

    book: NDArray[np.float64]
    counts: NDArray[np.int64]
    embree_seconds: float = 0.0
    thread_seconds: float = 0.0
    queries: int = 0
    packets: int = 0

    def add(self, other: "Tally") -> None:
        """Add another tally to this one."""
        self.book += other.book
        self.counts += other.counts
        self.embree_seconds += other.embree_seconds
        self.thread_seconds += other.thread_seconds
        self.queries += other.queries
        self.packets += other.packets


Waiting = deque[tuple[Chunk, Future[tuple[Tally, NDArray[np.void]]]]]
"""Chunks handed to the pool, in order, with what they will return: tally and deposits."""


@dataclass
class Mean:
    """Running mean and sum of squared deviations over replicates (Welford 1962), and the sum of their hits."""

    mean: NDArray[np.float64]
    squares: NDArray[np.float64]
    hits: NDArray[np.uint32]
    count: int = 0
    told: bool = False

    @classmethod
    def empty(cls, shape: tuple[int, int, int]) -> "Mean":
        """Return one over no replicates yet."""
        return cls(np.zeros(shape), np.zeros(shape), np.zeros(shape, np.uint32))

    def add(self, sample: NDArray[np.float64], hits: NDArray[np.uint32]) -> None:
        """Add one replicate's film; `sample` is used up."""
        self.count += 1
        self.hits += hits
        # Row by row: the film may be large, and a temporary of its size per operation is memory for nothing.
        for mean, squares, row in zip(self.mean, self.squares, sample, strict=True):
            change = row - mean
            mean += change / self.count
            squares += change * (row - mean)

    def variance(self) -> NDArray[np.float64]:
        """Return the variance of the mean, in place of `squares`; NaN from fewer than two replicates."""
        if not self.told:
            self.squares /= self.count * (self.count - 1) if self.count > 1 else np.nan
            self.told = True
        return self.squares


@dataclass
class LampLight:
    """What lamps' own packets bring, kept apart where the pixels' samples are weighted by their number."""

    film: Film
    mean: Mean

    @classmethod
    def empty(cls, shape: tuple[int, int, int]) -> "LampLight":
        """Return none yet, for a sensor of (rows, columns, wavelengths)."""
        return cls(Film.empty(shape[0] * shape[1], shape[2]), Mean.empty(shape))

    def end_replicate(self) -> None:
        """Count the film in, and clear it for the next replicate."""
        shape = self.mean.mean.shape
        self.mean.add(self.film.power.reshape(shape), self.film.hits.reshape(shape))
        self.film.clear()


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

    Warns
    -----
    LostEnergyWarning
        More energy was lost than rounding explains; the warning names the bodies in which.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built.
    """
    image = Renderer(build(scene), progress).image()
    for ledger in (image.ledger, image.ledger.lamps):
        lost = ledger.loss_in_words() if ledger is not None else None
        if lost is not None:
            warnings.warn(lost, LostEnergyWarning, stacklevel=2)
    return image


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
    check : bool
        Compare the image with samples that are not aimed.
    """

    world: World
    progress: Callable[[Progress], None] | None = None
    chunk: int = CHUNK
    aimed: bool = True
    stratified: bool = True
    check: bool = True
    _lamp_light: "LampLight | None" = None
    _blind: BlindSamples | None = None
    _local: threading.local = field(default_factory=threading.local)
    _last_report: float = 0.0

    def __post_init__(self) -> None:
        scene = self.world.scene
        transport = scene.transport
        self.waves = len(transport.wavelengths_nm)
        self.pixels = self.world.tables.sensor.columns * self.world.tables.sensor.rows
        self.samples = transport.samples // transport.replicates
        self.adjoint = transport.method == "adjoint"
        self.parts = parts_of(self.world, aimed=self.aimed)
        self.threads = transport.threads or os.cpu_count() or 1
        self.seed = run_key(transport.seed)
        if self.check and self.aimed:
            self._blind = BlindSamples(*self._shape())

    def chunks(self, part: Part, levels: Counts | None = None) -> Iterator[Chunk]:
        """Yield a part's chunks of one replicate, always in the same order; `levels` (pixels,): of the second stage."""
        samples = part.samples(self.samples)
        for wave in range(self.waves):
            if levels is not None:
                yield from self._second_chunks(part, levels, wave)
                continue
            adjoint = part.options.adjoint
            per_chunk = max(1, self.chunk // samples) if adjoint else self.chunk
            total = self.pixels if adjoint else self.pixels * samples
            for first in range(0, total, per_chunk):
                count = min(per_chunk, total - first)
                yield Chunk(part, first, count, wave, count * samples if adjoint else count, samples)

    def _second_chunks(self, part: Part, levels: Counts, wave: int) -> Iterator[Chunk]:
        """Yield the chunks of a second-stage replicate: pixels with the same number of samples together."""
        if not part.options.adjoint:
            return
        for block in range(0, self.pixels, PIXELS_SORTED):
            sorted_here = levels[block : block + PIXELS_SORTED]
            for level in np.unique(sorted_here[sorted_here > 0]):
                samples = part.samples(1 << (int(level) - 1))
                pixels = block + np.flatnonzero(sorted_here == level)
                per_chunk = max(1, self.chunk // samples)
                for first in range(0, len(pixels), per_chunk):
                    some = pixels[first : first + per_chunk]
                    yield Chunk(part, int(some[0]), len(some), wave, len(some) * samples, samples, some)

    def image(self) -> Image:
        """Render all replicates, or as many as Ctrl-C leaves time for."""
        scene = self.world.scene
        began = time.perf_counter()
        film = Film.empty(self.pixels, self.waves)
        tally = self._tally()
        if self.adjoint and not all(part.options.adjoint for part in self.parts):
            self._lamp_light = LampLight.empty(self._shape())
        with ThreadPoolExecutor(self.threads, thread_name_prefix="lfmesh") as pool:
            mean = self._stage(pool, film, tally, began)
            finished = mean.count
            ledger = self._ledger(tally, finished)
            refinement = None
            if scene.transport.target_error is not None and finished == scene.transport.replicates:
                refinement = self._refine(pool, film, mean, tally, began)
        variance = mean.variance()
        # What lamps' own packets bring, no blind sample from a pixel finds.
        blind = self._blind.compared(mean.mean, variance) if self._blind is not None else None
        if self._lamp_light is not None:
            # No pixel has samples of its own of these packets: they are added once, as the first stage left them.
            mean.mean += self._lamp_light.mean.mean
            variance += self._lamp_light.mean.variance()
            mean.hits += self._lamp_light.mean.hits
        # The energy is that of the first stage, which treats all pixels alike; the work is that of both.
        ledger.packets, ledger.events = tally.packets, int(tally.counts[EVENTS])
        seconds = time.perf_counter() - began
        return Image(
            mean.mean,
            np.sqrt(variance, out=variance),
            scene,
            ledger,
            seconds,
            finished,
            float(self.samples * finished) if refinement is None else refinement.samples,
            in_words(scene, self.parts),
            {
                "tracing_seconds": seconds,
                "thread_seconds": tally.thread_seconds,
                "embree_seconds": tally.embree_seconds,
                "embree_queries": tally.queries,
                "threads": self.threads,
            },
            refinement,
            mean.hits,
            self.world.aim_proof,
            blind,
        )

    def _stage(
        self, pool: ThreadPoolExecutor, film: Film, tally: Tally, began: float, levels: Counts | None = None
    ) -> Mean:
        """Return the mean over the replicates of a stage, or of those that Ctrl-C leaves time for.

        Raises
        ------
        KeyboardInterrupt
            Not one replicate of the first stage is finished.
        """
        shape = self._shape()
        mean = Mean.empty(shape)
        replicates = self.world.scene.transport.replicates
        for number in range(replicates):
            film.clear()
            try:
                own = self._replicate(pool, number, film, began, levels)
            except KeyboardInterrupt:
                if levels is None and mean.count == 0:
                    raise
                break
            mean.add(film.power.reshape(shape), film.hits.reshape(shape))
            if levels is None and self._lamp_light is not None:
                self._lamp_light.end_replicate()
            tally.add(own)
            if levels is None and self._blind is not None:
                try:
                    self._look_blindly(pool, number)
                except KeyboardInterrupt:
                    break
        return mean

    def _look_blindly(self, pool: ThreadPoolExecutor, replicate: int) -> None:
        """Take a replicate's samples that are not aimed, by which the image is checked."""
        assert self._blind is not None
        part = blind_part(self.world)
        key = descendant(self.seed, replicate)
        chunk = min(BLIND_CHUNK, self.chunk)
        samples = min(self.samples, chunk)
        at_once = min(chunk // samples, self.pixels) if self.adjoint else chunk
        total = self.pixels * (1 if self.adjoint else samples)
        runs = first_of_runs(total, at_once, replicate)
        for wave in range(self.waves):
            stream = descendant(key, part.number * self.waves + wave)
            films = [Film.empty(at_once if self.adjoint else 0, self.waves) for _ in runs]
            each = at_once * (samples if self.adjoint else 1)
            chunks = [Chunk(part, first, at_once, wave, each, samples, origin=first) for first in runs]
            futures = [pool.submit(self._trace, *job) for job in zip(chunks, repeat(stream), films, strict=False)]
            deposits = [future.result()[1] for future in futures]
            if self.adjoint:
                for first, film in zip(runs, films, strict=True):
                    self._blind.add(np.arange(first, first + at_once), wave, film.power[:, wave])
            else:
                fallen = np.concatenate(deposits)
                part_of_all = at_once * len(runs) / total
                self._blind.add_image(fallen["pixel"], wave, fallen["weight"] / part_of_all)

    def _refine(self, pool: ThreadPoolExecutor, film: Film, mean: Mean, tally: Tally, began: float) -> Refinement:
        """Render the second stage and average it into the first one's mean."""
        transport = self.world.scene.transport
        assert transport.target_error is not None
        variance = mean.variance()
        seen = mean.mean
        if self._lamp_light is not None:
            seen = seen + self._lamp_light.mean.mean
        levels, capped = second_stage(seen, variance, self.world.scene)
        second = self._stage(pool, film, tally, began, levels.ravel())
        # One replicate has no spread: its error could not be told.
        replicates = second.count if second.count > 1 else 0
        more = samples_of(np.arange(levels.max() + 1, dtype=np.uint8)) * replicates
        first = self.samples * mean.count
        if replicates:
            combine(mean.mean, variance, second.mean, second.variance(), levels, more / (first + more))
            mean.hits += second.hits
        spent = first + total_samples(levels) * replicates / self.pixels
        return Refinement(
            transport.target_error, transport.max_samples, replicates, spent, float((levels > 0).mean()), capped
        )

    def _shape(self) -> tuple[int, int, int]:
        """Return rows and columns of the sensor, and wavelengths."""
        sensor = self.world.tables.sensor
        return sensor.rows, sensor.columns, self.waves

    def _tally(self) -> Tally:
        return Tally(np.zeros((BOOKS, len(self.world.slots))), np.zeros(COUNTERS, np.int64))

    def _replicate(
        self, pool: ThreadPoolExecutor, number: int, film: Film, began: float, levels: Counts | None = None
    ) -> Tally:
        """Trace one replicate of a stage onto an empty film; the chunks' results are merged in their order."""
        # The second stage's replicates are numbered on, so that they have random numbers of their own.
        replicate = number if levels is None else self.world.scene.transport.replicates + number
        key = descendant(self.seed, replicate)
        tally = self._tally()
        waiting: Waiting = deque()
        done = 0
        one = sum(self._packets(part, levels) for part in self.parts)
        try:
            for part in self.parts:
                for chunk in self.chunks(part, levels):
                    stream = descendant(key, part.number * self.waves + chunk.wave)
                    waiting.append((chunk, pool.submit(self._trace, chunk, stream, film)))
                    if len(waiting) > 2 * self.threads:
                        done += self._merge(waiting, tally, film)
                        self._report(replicate, done, one, began)
                # The next part adds to the same pixels.
                while waiting:
                    done += self._merge(waiting, tally, film)
                    self._report(replicate, done, one, began)
        except BaseException:
            for _, future in waiting:
                future.cancel()
            raise
        return tally

    def _packets(self, part: Part, levels: Counts | None) -> int:
        """Return how many packets a part of a replicate starts with."""
        if levels is None:
            return self.waves * self.pixels * part.samples(self.samples)
        if not part.options.adjoint:
            return 0
        return self.waves * total_samples(levels, part.samples)

    def _merge(self, waiting: Waiting, tally: Tally, film: Film) -> int:
        """Add the oldest chunk's result; return how many packets it started with."""
        chunk, future = waiting[0]
        own, deposits = future.result()
        waiting.popleft()
        tally.add(own)
        if self._lamp_light is not None and not chunk.part.options.adjoint:
            film = self._lamp_light.film
        np.add.at(film.power, (deposits["pixel"], deposits["wave"]), deposits["weight"])
        np.add.at(film.hits, (deposits["pixel"], deposits["wave"]), np.uint32(1))
        return chunk.packets

    def _trace(self, chunk: Chunk, key: np.uint64, film: Film) -> tuple[Tally, NDArray[np.void]]:
        """Trace one chunk in a thread of the pool."""
        began = time.perf_counter()
        space, part = self._workspace(chunk.part), chunk.part
        tables = part.tables
        if part.options.adjoint:
            if chunk.pixels is None:
                pixels = np.arange(chunk.first, chunk.first + chunk.count)
                rows = slice(chunk.first - chunk.origin, chunk.first - chunk.origin + chunk.count)
                space.begin(film.power[rows], chunk.first, film.hits[rows], chunk.packets)
            else:
                pixels = chunk.pixels
                space.begin(film.power, 0, film.hits, chunk.packets)
            # A pixel's samples start together, though they be more than a chunk.
            space.reserve(chunk.packets)
            if part.options.sequential:
                launch_along_image_path(
                    pixels, chunk.samples, self.stratified, key, chunk.wave, tables.sensor, tables.lens, tables.array,
                    tables.aim, tables.frames, space.bundle, space.numbers, space.options, space.flow(), space.start,
                )  # fmt: skip
            else:
                launch_adjoint(
                    pixels, chunk.samples, self.stratified, key, chunk.wave, tables.sensor, tables.array, tables.aim,
                    tables.frames, len(tables.lens.surfaces), space.bundle, space.flow(), space.start,
                )  # fmt: skip
        else:
            space.begin(film.power[:0])
            if len(tables.objects.sources):
                launch_forward(
                    chunk.first, chunk.count, self.pixels * chunk.samples, key, chunk.wave,
                    tables.objects, tables.aim, tables.frames, space.options, space.flow(), space.template,
                )  # fmt: skip
        space.run()
        tally = Tally(
            part.booked(space.book),
            space.counts.copy(),
            space.embree_seconds,
            time.perf_counter() - began,
            space.queries,
            chunk.packets,
        )
        return tally, space.deposits[: space.tops[DEPOSITS]].copy()

    def _workspace(self, part: Part) -> Workspace:
        """Return what this thread traces a part in."""
        spaces: dict[int, Workspace] = self._local.__dict__.setdefault("spaces", {})
        if part.number not in spaces:
            spaces[part.number] = Workspace(self.world, part.options, self.chunk, part.tables)
        return spaces[part.number]

    def _report(self, replicate: int, done: int, one: int, began: float) -> None:
        """Say how far a stage has come; `one`: packets a replicate."""
        now = time.perf_counter()
        if self.progress is None or now - self._last_report < PROGRESS_SECONDS:
            return
        self._last_report = now
        replicates = self.world.scene.transport.replicates
        stage = "tracing" if replicate < replicates else "refining"
        part = replicate % replicates
        self.progress(Progress(part * one + done, replicates * one, now - began, part, replicates, stage))

    def _ledger(self, tally: Tally, replicates: int) -> Ledger:
        book, unit = tally.book / max(replicates, 1), "m² sr" if self.adjoint else "W"
        ledger = ledger_of(book[OWN_BOOK], tally.counts, self.world, tally.packets, unit)
        if any(part.book == LAMP_BOOK for part in self.parts):
            ledger.lamps = ledger_of(book[LAMP_BOOK], np.zeros_like(tally.counts), self.world, 0, "W")
        return ledger
