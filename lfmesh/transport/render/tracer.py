"""Tracing of a replicate or a block of it: chunks in a thread pool, results in order."""

import os
import time
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.aims.kept import Kept, digest_of
from lfmesh.transport.checks.blind_check import CHUNK as BLIND_CHUNK
from lfmesh.transport.checks.blind_check import BlindSamples, first_of_runs
from lfmesh.transport.checks.ghost_check import compare_ghosts
from lfmesh.transport.checks.order_check import SAMPLE, STARTS, OrderCheck, compare
from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import BY_ORDER_OR_MESH, COUNTERS, DEPOSITS
from lfmesh.transport.packets.random import descendant, run_key
from lfmesh.transport.paths.automaton import GHOSTS
from lfmesh.transport.render.adaptive import Counts
from lfmesh.transport.render.allocation import Measured, measured, shared
from lfmesh.transport.render.groups import Groups
from lfmesh.transport.render.parts import BOOKS, LAMP_BOOK, OWN_BOOK, Part, blind_part, parts_of
from lfmesh.transport.render.plan import Block, Chunk, Plan
from lfmesh.transport.render.tally import ChunkTally, Film, Layout, Piece, Work
from lfmesh.transport.settings import ledger_of
from lfmesh.transport.sources.lights import LightSource
from lfmesh.transport.sources.particles import ParticleSource
from lfmesh.transport.sources.pixels import PixelSource
from lfmesh.transport.sources.source import Launcher, Source
from lfmesh.transport.sources.wavelengths import ALONE, Turn
from lfmesh.transport.tables.lines import Nodes
from lfmesh.transport.threads import Threads
from lfmesh.transport.world import World
from lfmesh.transport.world_cache import key_of

ORDER_STREAM, SHARES_STREAM = 1 << 20, 1 << 21
"""Stream numbers of the random numbers for the check of the surface order and for the parts' shares of the samples,
outside those of replicates."""

Waiting = deque[Future[ChunkTally]]
"""Future results of chunks given to the pool, in order."""

_orders: Kept[OrderCheck | None] = Kept()

NO_FILM = Film.empty(0, 1)
"""Film for packets that do not start from pixels."""


@dataclass
class Tracer:
    """Tracer of a world's replicates.

    Attributes
    ----------
    world : World
    chunk : int
        Number of packets that start a chunk.
    aimed : bool
        Forward: aim scattered light at the entrance pupil. If not, packets scatter at random and most miss the lens:
        the paper's method without aiming, to measure the gain.
    stratified : bool
        Adjoint: start paths from scrambled Sobol' points instead of random ones.
    check : bool
        Compare the image with blind samples.
    independent : bool
        Each replicate takes its own wavelengths of bands, so that any two are independent. If not, a group shares them,
        see `render.groups`.
    """

    world: World
    chunk: int = CHUNK
    aimed: bool = True
    stratified: bool = True
    check: bool = True
    independent: bool = False
    _launchers: dict[int, Launcher] = field(default_factory=dict)

    def __post_init__(self) -> None:
        transport = self.world.scene.transport
        sensor = self.world.tables.sensor
        self.shape = sensor.rows, sensor.columns, self.world.lines.channels
        self.adjoint = transport.method == "adjoint"
        self.samples = transport.samples_each
        self.parts = parts_of(self.world, aimed=self.aimed)
        self.threads = transport.threads or os.cpu_count() or 1
        self.seed = run_key(transport.seed)
        if (kept := f"order of surfaces, aimed: {self.aimed}") not in self.world.kept:
            self.world.kept[kept] = self._check_order()
        self.order: OrderCheck | None = self.world.kept[kept]
        if self.order is not None and not self.order.holds:
            self.parts = parts_of(self.world, aimed=self.aimed, by_meshes=True)
        if self.adjoint:
            self.parts = shared(self.parts, self.pixels, self.samples, transport.replicates, self._measured)
            # This thread traces nothing more.
            self._launchers.clear()

    @property
    def pixels(self) -> int:
        """Number of pixels of the sensor."""
        return self.shape[0] * self.shape[1]

    @property
    def channels(self) -> int:
        """Number of channels of the image: wavelengths or bands."""
        return self.shape[2]

    @property
    def plan(self) -> Plan:
        """The chunks of the replicates."""
        replicates = self.world.scene.transport.replicates
        return Plan(self.parts, self.pixels, self.world.lines, self.samples, self.chunk, replicates)

    @property
    def groups(self) -> Groups:
        """Groups of the replicates."""
        return (Groups.single if self.independent else Groups.of)(self.world.scene)

    @property
    def layout(self) -> Layout:
        """Sizes of all sums of the render."""
        from_pixels = sum(part.options.adjoint for part in self.parts)
        books = BOOKS, len(self.world.slots)
        groups = self.groups.count if self.groups.joined else None
        return Layout(self.shape, books, COUNTERS, len(self.parts), from_pixels, self.check and self.aimed, groups)

    @cached_property
    def _blind_part(self) -> Part:
        part = blind_part(self.world)
        return part if self.order is None or self.order.holds else part.by_meshes()

    def ledger(self, book: NDArray[np.float64], work: Work, replicates: int) -> Ledger:
        """Return the mean ledger of replicates.

        Parameters
        ----------
        book : (BOOKS, slots) float64
            Sum over the replicates.
        work : Work
            Total work of the replicates.
        replicates : int
        """
        mean, unit = book / max(replicates, 1), "m² sr" if self.adjoint else "W"
        ledger = ledger_of(mean[OWN_BOOK], work.counts, self.world, work.packets, unit)
        if any(part.book == LAMP_BOOK for part in self.parts):
            ledger.lamps = ledger_of(mean[LAMP_BOOK], np.zeros_like(work.counts), self.world, 0, "W")
        return ledger

    def pool(self) -> Threads:
        """Return the pool of tracing threads."""
        return Threads(self.threads)

    def piece(self, replicate: int, block: Block, levels: Counts | None = None) -> Piece:
        """Trace a block of a replicate; the first pixel's block also takes the samples without aim.

        Parameters
        ----------
        replicate : int
        block : Block
        levels : (pixels,) uint8, optional
            Levels of the second stage.
        """
        mine = [chunk for chunk in self.plan.chunks(replicate, levels) if block.touches(chunk)]
        started = [chunk.pixel_numbers() for chunk in mine if chunk.part.options.adjoint]
        # A chunk across the border also lights pixels of the neighbouring block, which are cut off at the end.
        low = min([block.first, *(int(pixels[0]) for pixels in started)])
        high = max([block.last, *(int(pixels[-1]) + 1 for pixels in started)])
        films = tuple(Film.empty(high - low, self.channels, low) for _ in range(self.layout.from_pixels))
        with self.pool() as pool:
            done = list(self.traced(pool, replicate, iter(mine), films))
            blind = None
            if levels is None and block.first == 0 and self.layout.blind:
                blind = self.blind_samples(pool, replicate)
        own = [tally for chunk, tally in zip(mine, done, strict=True) if block.owns(chunk)]
        cut = tuple(film.part(block.first, block.last) for film in films)
        return Piece(replicate, block.first, block.last, cut, own, blind)

    def traced(
        self, pool: Threads, replicate: int, chunks: Iterator[Chunk], films: Sequence[Film]
    ) -> Generator[ChunkTally]:
        """Trace chunks; add their pixels' light to empty films, and yield the other results in order.

        Parameters
        ----------
        pool : Threads
        replicate : int
        chunks : iterator of Chunk
        films : sequence of Film
            Films of the parts that start from pixels.
        """
        first, turn = self.groups.place(replicate)
        key = descendant(self.seed, first)
        waiting: Waiting = deque()
        try:
            for chunk in chunks:
                while len(waiting) > 2 * self.threads:
                    yield self._oldest(waiting)
                stream = descendant(key, chunk.part.number * self.channels + chunk.channel)
                film = films[chunk.place] if chunk.part.options.adjoint else NO_FILM
                waiting.append(pool.submit(self._trace, chunk, stream, film, turn))
            while waiting:
                yield self._oldest(waiting)
        finally:
            for future in waiting:
                future.cancel()

    @staticmethod
    def _oldest(waiting: Waiting) -> ChunkTally:
        tally = waiting[0].result()
        waiting.popleft()
        return tally

    def blind_samples(self, pool: Threads, replicate: int) -> BlindSamples:
        """Trace a replicate's blind samples, which check the image."""
        found = BlindSamples(*self.shape)
        part = self._blind_part
        key = descendant(self.seed, replicate)
        chunk = min(BLIND_CHUNK, self.chunk)
        samples = min(self.samples, chunk)
        at_once = min(chunk // samples, self.pixels)
        runs = first_of_runs(self.pixels, at_once, replicate)
        for channel in range(self.channels):
            stream = descendant(key, part.number * self.channels + channel)
            chunks = [Chunk(0, part, first, at_once, channel, at_once * samples, samples) for first in runs]
            films = [Film.empty(at_once, 1, first) for first in runs]
            list(pool.map(self._trace, chunks, repeat(stream), films))
            for film in films:
                found.add(np.arange(film.origin, film.origin + at_once), channel, film.power[:, 0])
        return found

    def _trace(self, chunk: Chunk, key: np.uint64, film: Film, turn: Turn = ALONE) -> ChunkTally:
        """Trace one chunk in a thread of the pool."""
        began = time.perf_counter()
        source = self._source(chunk, key, 0 if film.power.shape[1] == 1 else chunk.channel, turn=turn)
        space = self._launcher(chunk.part).trace(source, film=film if chunk.part.options.adjoint else None)
        work = Work(
            space.counts.copy(), chunk.packets, space.queries, space.embree_seconds, time.perf_counter() - began
        )
        deposits: NDArray[np.void] = space.deposits[: space.tops[DEPOSITS]].copy()
        deposits["colour"] = chunk.channel
        return ChunkTally(chunk.number, chunk.part.booked(space.book), work, deposits, chunk.place)

    def _check_order(self) -> OrderCheck | None:
        """Compare some packets at the lens, and some ghosts, with the meshes; None without any.

        Done once per camera, as the order of surfaces depends neither on the seed nor on the scene before the camera.
        The forward method does it for each scene, because the scene decides the lamp light that reaches the camera.
        """

        def compared() -> OrderCheck | None:
            order, ghosts = self._compared_in_order(), self._compared_ghosts()
            return ghosts if order is None else order.joined(ghosts)

        tables = self.world.tables
        camera = tables.lens, tables.mla, tables.sensor, tables.cover, tables.polarised
        before = None if self.adjoint else key_of(self.world.scene)
        options = tuple((part.options, part.from_lamps) for part in self.parts)
        return _orders.of(digest_of(camera, before, options, self.world.lines.middle), compared)

    def _compared_ghosts(self) -> OrderCheck | None:
        """Compare some ghosts with the meshes; None without their own estimator."""
        part = next((part for part in self.parts if part.options.paths == GHOSTS), None)
        if part is None:
            return None
        work, _ = self._sampled(part, many=True)
        # No packet waits if no pixel sees an opening of the lens.
        return compare_ghosts(self.world, work)

    def _compared_in_order(self) -> OrderCheck | None:
        """Compare packets at the lens with the meshes; None if no part finds surfaces by their order.

        The sample comes from the part that follows all reflections, or from the only part.
        """
        asking = [part for part in self.parts if part.options.faces == BY_ORDER_OR_MESH]
        if not asking:
            return None
        part = max(asking, key=lambda each: not each.from_lamps)
        work, draw = self._sampled(part)
        work.sampled = []
        work.run()
        packets = np.concatenate([*work.sampled, np.zeros(0, work.stacks.record)])
        some = draw.choice(len(packets), min(SAMPLE, len(packets)), replace=False)
        return compare(self.world, part.options, part.tables, packets[np.sort(some)])

    def _measured(self, part: Part, count: int, samples: int) -> Measured:
        """Measure the variance and cost of a part by some samples of some pixels."""
        key = descendant(self.seed, SHARES_STREAM)
        pixels = np.unique(np.random.default_rng(int(key)).integers(0, self.pixels, count))
        chunk = Chunk(0, part, 0, len(pixels), 0, len(pixels) * samples, samples, pixels)
        sets, counts, queries = np.zeros((2, len(pixels))), np.zeros(COUNTERS, np.int64), 0
        for number, light in enumerate(sets):
            film = Film.empty(self.pixels, 1, 0)
            source = self._source(chunk, descendant(descendant(key, number), part.number), 0)
            work = self._launcher(part).trace(source, film=film)
            light[:] = film.power[pixels, 0]
            counts, queries = counts + work.counts, queries + work.queries
        return measured(part, sets, samples, counts, queries)

    def _sampled(self, part: Part, *, many: bool = False) -> tuple[Workspace, np.random.Generator]:
        """Start some packets of a part; return their workspace and the random generator used.

        Parameters
        ----------
        part : Part
        many : bool
            Start several per pixel if there are few pixels.
        """
        key = descendant(self.seed, ORDER_STREAM)
        draw = np.random.default_rng(int(key))
        pixels = np.unique(draw.integers(0, self.pixels, STARTS)) if part.options.adjoint else None
        count = STARTS if pixels is None else len(pixels)
        samples = max(1, STARTS // count) if many else 1
        chunk = Chunk(0, part, 0, count, 0, count * samples, samples, pixels)
        work = Workspace(self.world, part.options, STARTS, part.tables)
        work.begin(Film.empty(self.pixels if part.options.adjoint else 0, 1, 0), count * samples)
        # One wavelength, because the compared packets are followed in one wave.
        self._source(chunk, key, 0, self.world.lines.middle).launch(work, range(count))
        return work, draw

    def _source(
        self, chunk: Chunk, key: np.uint64, channel: int, nodes: Nodes | None = None, turn: Turn = ALONE
    ) -> Source:
        """Return the source of a chunk's packets; `channel`: film column; `nodes` override the channel's."""
        nodes = nodes or self.world.lines.nodes[chunk.channel]
        if chunk.part.particles is not None:
            return ParticleSource(chunk.part.particles, chunk.first, chunk.count, chunk.samples, key, nodes, turn)
        if not chunk.part.options.adjoint:
            return LightSource(chunk.first, chunk.count, self.pixels * chunk.samples, key, nodes, turn)
        return PixelSource(chunk.pixel_numbers(), chunk.samples, key, nodes, self.stratified, channel, turn)

    def _launcher(self, part: Part) -> Launcher:
        """Return a part's launcher, made at the first call."""
        new = partial(Workspace, self.world, part.options, self.chunk, part.tables)
        return self._launchers.setdefault(part.number, Launcher(new))
