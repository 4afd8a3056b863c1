"""Rendering: from a scene through its plan and tallies to an image."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import reduce
from itertools import islice
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError, PictureWarning, in_order, warn_caller
from lfmesh.notebook import watched
from lfmesh.scene import Scene
from lfmesh.transport.build import world_of
from lfmesh.transport.checks.foreseen import foreseen
from lfmesh.transport.checks.found import found, proofs
from lfmesh.transport.packets.packet import EVENTS
from lfmesh.transport.render.adaptive import Counts, Refinement, combine, samples_of, second_stage, total_samples
from lfmesh.transport.render.certainty import Certainty, Estimate
from lfmesh.transport.render.compile_ahead import compiled_ahead
from lfmesh.transport.render.image import Image, UntracedLight
from lfmesh.transport.render.parts import adds_particles, finds_all, in_words
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.tally import RenderState, StageSum, Tally
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.tables.interfaces import coating_errors
from lfmesh.transport.threads import Threads
from lfmesh.transport.world import World

Array = NDArray[np.float64]

PROGRESS_SECONDS = 0.2

Tallies = Callable[[int, Counts | None], Iterator[Tally]]
"""Yields the tallies of a stage's replicates in order, from the first number and, for the second stage, `levels`."""


Untraced = Callable[[World, Callable[[Progress], None] | None], UntracedLight]
"""Computes light that is not traced, of particles in scenes with diffraction. Called with the world and a receiver of
progress."""


class Keeper(Protocol):
    """Saves a render's state for another process to continue; copies it before returning."""

    def __call__(self, state: RenderState, *, last: bool) -> None:
        """Save the state after a replicate, or the `last` one before an early stop."""


def render(
    scene: Scene,
    progress: Callable[[Progress], None] | bool | None = None,
    *,
    saved: Mapping[str, NDArray[Any]] | None = None,
    keep: Keeper | None = None,
    untraced: Untraced | None = None,
    world: World | None = None,
) -> Image:
    """Trace a scene's raw sensor image.

    Parameters
    ----------
    scene : Scene
    progress : callable or bool, optional
        Called a few times per second, in the calling thread. True shows a bar (on standard error, or below a notebook's
        cell), False nothing. Default: a bar in notebooks only.
    saved : dict of arrays, optional
        State of an interrupted render of this scene, from `lfmesh.transport.render.tally.arrays_of`. The render
        continues from there, and its image is bitwise that of an uninterrupted one.
    keep : Keeper, optional
        Called with the state after every replicate.
    untraced : callable, optional
        See `Untraced`; needed by particles with diffraction.
    world : World, optional
        The scene's, from `lf.build`. If omitted, the scene is built, unless this process already has its world.

    Returns
    -------
    Image
        After Ctrl-C, of the finished replicates.

    Warns
    -----
    PictureWarning
        The picture is or may be wrong. The warning's class says how, and `Image.warnings` keeps it. Errors known in
        advance are warned of before the first ray.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built, or `saved` or `world` belongs to another scene.
    """
    with watched(progress) as report:
        with compiled_ahead(scene, report) as ahead:
            world = world_of(scene, world)
            ahead.join(world)
        renderer = Renderer(world, progress=report, light=untraced_light(world, untraced, report))
        return warned(renderer, lambda: renderer.image(saved, keep))


def untraced_light(
    world: World, untraced: Untraced | None, progress: Callable[[Progress], None] | None = None
) -> UntracedLight | None:
    """Return untraced light to add to an image; None without any.

    Parameters
    ----------
    world : World
    untraced : callable, optional
        Computes it.
    progress : callable, optional
        Receives its progress.

    Raises
    ------
    LfmeshError
        There is such light, but no `untraced`.
    """
    if not adds_particles(world):
        return None
    if untraced is None:
        raise LfmeshError(
            f'transport.diffraction = "{world.scene.transport.diffraction}": particles are pictured by point spreads, '
            "which only lf.render computes"
        )
    return untraced(world, progress)


def warned(tracer: Tracer, image: Callable[[], Image]) -> Image:
    """Make an image; warn of its known and possible errors as early as possible.

    Parameters
    ----------
    tracer : Tracer
    image : callable
        Makes the image, by `folded`.
    """
    before = warn_beforehand(tracer)
    made = image()
    warn_caller(each for each in made.warnings if each not in before)
    return made


def warn_beforehand(tracer: Tracer) -> tuple[PictureWarning, ...]:
    """Warn of errors of a picture known before tracing; return the warnings.

    Parameters
    ----------
    tracer : Tracer
    """
    world = tracer.world
    before = in_order([*foreseen(world), *proofs(world.scene, world.aim_proof, tracer.order)])
    # `build` has already issued the warnings of the world.
    warn_caller(each for each in before if each not in world.warnings)
    return before


@dataclass
class Renderer(Tracer):
    """Render in progress in this process.

    Attributes
    ----------
    progress : callable, optional
    light : UntracedLight, optional
        Light to add, see `untraced_light`.
    """

    progress: Callable[[Progress], None] | None = None
    light: UntracedLight | None = None
    _last_report: float = 0.0

    def image(self, saved: Mapping[str, NDArray[Any]] | None = None, keep: Keeper | None = None) -> Image:
        """Render all replicates, or until Ctrl-C; see `render`."""
        if self.light is None:
            untraced_light(self.world, None)
        state = self.layout.state(saved)
        clock = Clock(state)
        with self.pool() as pool:

            def tallies(first: int, levels: Counts | None) -> Iterator[Tally]:
                one = self.plan.packets(levels)
                for tally, number in self._begun(state, first, levels):
                    for _ in self._chunks_folded(pool, state, tally, levels):
                        state.seconds = clock.seconds
                        if keep is not None:
                            keep(state, last=False)
                        self._report(number, tally.work.packets, one, clock, levels)
                    if levels is None and self.layout.blind:
                        tally.blind = self.blind_samples(pool, tally.replicate)
                    state.partial = None
                    yield tally

            image = folded(self, state, tallies, clock, keep)
        return image if self.light is None else image.with_light(self.light)

    def _begun(self, state: RenderState, first: int, levels: Counts | None) -> Iterator[tuple[Tally, int]]:
        """Yield a stage's unfinished replicates with their places, in the memory of one tally.

        An interrupted replicate is continued: light of chunks that were not folded is removed from its films.
        """
        replicates = self.world.scene.transport.replicates
        tally = state.partial or self.layout.tally(second=levels is not None)
        for number in range(first, replicates):
            replicate = number_of(number, replicates, levels)
            if state.partial is not None and tally.replicate == replicate:
                for chunk in islice(self.plan.chunks(replicate, levels), tally.chunks, None):
                    if chunk.part.options.adjoint:
                        tally.films[chunk.place].clear_pixels(chunk.pixel_numbers(), chunk.channel)
            else:
                # The kept part belongs to a replicate that others have finished since.
                state.partial = None
                tally.restart(replicate)
            yield tally, number

    def _chunks_folded(
        self, pool: Threads, state: RenderState, tally: Tally, levels: Counts | None
    ) -> Iterator[None]:  # fmt: skip
        """Trace the missing chunks of a replicate; yield after each one folded in."""
        left = islice(self.plan.chunks(tally.replicate, levels), tally.chunks, None)
        with closing(self.traced(pool, tally.replicate, left, tally.films)) as chunks:
            for chunk in chunks:
                # While a chunk is being added, the tally cannot be continued.
                state.partial = None
                tally.add(chunk)
                state.partial = tally
                yield

    def _report(self, number: int, done: int, one: int, clock: "Clock", levels: Counts | None) -> None:
        """Report the progress of a stage.

        Parameters
        ----------
        number : int
            Finished replicates.
        done, one : int
            Packets done in this replicate, and its total.
        """
        now = time.perf_counter()
        if self.progress is None or now - self._last_report < PROGRESS_SECONDS:
            return
        self._last_report = now
        replicates = self.world.scene.transport.replicates
        stage = "tracing" if levels is None else "refining"
        self.progress(Progress(number * one + done, replicates * one, clock.seconds, number, replicates, stage))


class Clock:
    """Wall-clock time of a render, including the time before an interruption."""

    def __init__(self, state: RenderState) -> None:
        self._began = time.perf_counter() - state.seconds

    @property
    def seconds(self) -> float:
        """Time spent so far."""
        return time.perf_counter() - self._began


def number_of(number: int, replicates: int, levels: Counts | None) -> int:
    """Return the replicate at a place of a stage; second-stage random numbers differ.

    Parameters
    ----------
    number : int
        Place in the stage.
    replicates : int
        Replicates per stage.
    levels : (pixels,) uint8, or None
        None: the first stage.
    """
    return number if levels is None else replicates + number


def folded(tracer: Tracer, state: RenderState, tallies: Tallies, clock: Clock, keep: Keeper | None = None) -> Image:
    """Fold both stages' tallies into the state, and return its image.

    Parameters
    ----------
    tracer : Tracer
    state : RenderState
    tallies : callable
        See `Tallies`.
    clock : Clock
    keep : Keeper, optional

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate of the first stage was finished; `keep` saves the part traced so far.
    """
    transport = tracer.world.scene.transport

    def add(stage: StageSum, levels: Counts | None) -> None:
        between = True
        try:
            if stage.count < transport.replicates:
                for tally in tallies(stage.count, levels):
                    between = False
                    stage.add(tally)
                    between = True
                    state.seconds = clock.seconds
                    if keep is not None:
                        keep(state, last=False)
        except KeyboardInterrupt:
            # Inside `add` the sum may hold part of a replicate and be invalid.
            if not between:
                raise
            state.seconds = clock.seconds
            if keep is not None and (state.first.count or state.partial is not None):
                keep(state, last=True)
            if not state.first.count:
                raise

    add(state.first, None)
    refinement = None
    if transport.target_error is not None and state.first.count == transport.replicates:
        layout, means = tracer.layout, state.first.means
        seen = reduce(np.add, [mean.mean for mean in means])
        noise = reduce(np.add, [mean.variance() for mean in means[: layout.from_pixels]])
        levels, capped = second_stage(seen, noise, tracer.world.scene)
        state.second = state.second or layout.stage(second=True)
        add(state.second, levels.ravel())
        refinement = _refined(tracer, state.first, state.second, levels, capped)
    state.seconds = clock.seconds
    return _image(tracer, state, refinement)


def _refined(tracer: Tracer, first: StageSum, second: StageSum, levels: Counts, capped: float) -> Refinement:
    """Average the second stage into the first stage's mean."""
    transport = tracer.world.scene.transport
    assert transport.target_error is not None
    # A single replicate has no spread and so no error.
    replicates = second.count if second.count > 1 else 0
    more = samples_of(np.arange(levels.max() + 1, dtype=np.uint8)) * replicates
    before = tracer.samples * first.count
    if replicates:
        # Packets of lamps do not start from pixels, so the second stage has none: the first stage's are kept.
        for mean, other in zip(first.means, second.means, strict=False):
            combine(mean.mean, mean.variance(), other.mean, other.variance(), levels, more / (before + more))
            mean.hits += other.hits
    spent = before + total_samples(levels) * replicates / tracer.pixels
    share = float((levels > 0).mean())
    return Refinement(transport.target_error, transport.max_samples, replicates, spent, share, capped)


def _image(tracer: Tracer, state: RenderState, refinement: Refinement | None) -> Image:
    """Make the image of a state in its memory."""
    first = state.first
    certainty = _certainty(tracer, first)
    # The parts that samples without aim cannot find come last.
    own = sum(not part.from_lamps for part in tracer.parts)
    total = first.means[0]
    for mean in first.means[1:own]:
        total.add_estimate(mean)
    light, noise = (total.mean, total.variance()) if own else np.zeros((2, *tracer.shape))
    blind = None
    if first.blind is not None:
        blind = first.blind.compared(light, noise, all_light=finds_all(tracer.world))
    for mean in first.means[max(own, 1) :]:
        total.add_estimate(mean)
    variance = total.variance()
    ledger = tracer.ledger(first.book, first.work, first.count)
    # Energy is from the first stage, with equal samples for all pixels; work is from both stages.
    work = first.work
    if state.second is not None:
        work.add(state.second.work)
    ledger.packets, ledger.events = work.packets, int(work.counts[EVENTS])
    image = Image(
        mean=total.mean,
        stderr=np.sqrt(variance, out=variance),
        scene=tracer.world.scene,
        ledger=ledger,
        seconds=state.seconds,
        replicates=first.count,
        samples=float(tracer.samples * first.count) if refinement is None else refinement.samples,
        engine=in_words(tracer.world.scene, tracer.parts),
        timings={
            "tracing_seconds": state.seconds,
            "thread_seconds": work.thread_seconds,
            "embree_seconds": work.embree_seconds,
            "embree_queries": work.queries,
            "threads": tracer.threads,
        },
        refinement=refinement,
        hits=total.hits,
        aim=tracer.world.aim_proof,
        blind=blind,
        order=tracer.order,
        coatings=coating_errors(tracer.world.scene),
        certainty=certainty,
    )
    image.warnings = in_order([*foreseen(tracer.world), *found(image)])
    return image


def _certainty(tracer: Tracer, first: StageSum) -> Certainty | None:
    """Return the errors and bounds of a multi-part image; None for a single part, which gives them itself."""
    if len(tracer.parts) == 1:
        return None
    scene = tracer.world.scene
    estimates = [
        Estimate(
            mean.mean,
            np.sqrt(mean.variance()),
            mean.hits,
            first.count * part.draws(tracer.pixels, tracer.samples, scene.transport.replicates),
        )
        for mean, part in zip(first.means, tracer.parts, strict=True)
    ]
    return Certainty.of(estimates, scene, tracer.groups.begun(first.count))
