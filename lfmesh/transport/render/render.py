"""Rendering: from a scene by its plan, the tallies of replicates and their sum to an image."""

import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lfmesh.notebook import watched
from lfmesh.scene import Scene
from lfmesh.scene.advice import too_dark
from lfmesh.transport.packets.ledger import Ledger, LostEnergyWarning
from lfmesh.transport.packets.packet import EVENTS
from lfmesh.transport.render.adaptive import Counts, Refinement, combine, samples_of, second_stage, total_samples
from lfmesh.transport.render.compile_ahead import compiled_ahead
from lfmesh.transport.render.glass_aim import hardly_aimed
from lfmesh.transport.render.image import Image
from lfmesh.transport.render.parts import LAMP_BOOK, OWN_BOOK, in_words
from lfmesh.transport.render.progress import Progress
from lfmesh.transport.render.tally import RenderState, StageSum, Tally
from lfmesh.transport.render.tracer import Tracer
from lfmesh.transport.settings import ledger_of
from lfmesh.transport.tables.interfaces import coating_errors
from lfmesh.transport.world import build

PROGRESS_SECONDS = 0.2

Tallies = Callable[[int, Counts | None], Iterator[Tally]]
"""Yields the tallies of a stage's replicates in order, given the first number and, for the second stage, `levels`."""


class MissedLightWarning(UserWarning):
    """Light is found so seldom that the picture may be darker than its error says; the message says what to change."""


class Keeper(Protocol):
    """Saves a render's state for another process to continue; copies what it needs before it returns."""

    def __call__(self, state: RenderState, *, last: bool) -> None:
        """Save the state after another replicate, or the `last` one before the render stops early."""


def render(
    scene: Scene,
    progress: Callable[[Progress], None] | bool | None = None,
    *,
    saved: Mapping[str, NDArray[Any]] | None = None,
    keep: Keeper | None = None,
) -> Image:
    """Trace a scene's raw sensor image.

    Parameters
    ----------
    scene : Scene
    progress : callable or bool, optional
        Called a few times a second, in the calling thread. True shows a bar (on standard error, or below a notebook's
        cell), False nothing; left out, there is a bar in a notebook alone.
    saved : dict of arrays, optional
        State of an interrupted render of this scene, from `lfmesh.transport.render.tally.arrays_of`. The render
        continues from there, and its image is bitwise that of an uninterrupted one.
    keep : Keeper, optional
        Called with the state after every replicate.

    Returns
    -------
    Image
        After Ctrl-C, of the finished replicates.

    Warns
    -----
    LostEnergyWarning
        More energy was lost than rounding explains; the warning names the bodies in which.
    MissedLightWarning
        The picture may be too dark by more than its standard error.

    Raises
    ------
    KeyboardInterrupt
        Interrupted before the first replicate was finished.
    LfmeshError
        The scene cannot be built, or `saved` is of another one.
    """
    for line in too_dark(scene):
        warnings.warn(line, MissedLightWarning, stacklevel=2)
    with compiled_ahead(scene) as ahead:
        world = build(scene)
        ahead.join(world)
    with watched(progress) as report:
        renderer = Renderer(world, progress=report)
        for line in hardly_aimed(world):
            warnings.warn(line, MissedLightWarning, stacklevel=2)
        image = renderer.image(saved, keep)
    for ledger in (image.ledger, image.ledger.lamps):
        lost = ledger.loss_in_words() if ledger is not None else None
        if lost is not None:
            warnings.warn(lost, LostEnergyWarning, stacklevel=2)
    return image


@dataclass
class Renderer(Tracer):
    """A render under way in this process.

    Attributes
    ----------
    progress : callable, optional
    """

    progress: Callable[[Progress], None] | None = None
    _last_report: float = 0.0

    def image(self, saved: Mapping[str, NDArray[Any]] | None = None, keep: Keeper | None = None) -> Image:
        """Render all replicates, or until Ctrl-C; see `render`."""
        state = self.layout.state(saved)
        clock = Clock(state)
        with self.pool() as pool:
            return folded(self, state, lambda first, levels: self._tallies(pool, clock, first, levels), clock, keep)

    def _tallies(self, pool: ThreadPoolExecutor, clock: "Clock", first: int, levels: Counts | None) -> Iterator[Tally]:
        """Trace a stage's replicates one after the other, in the memory of a single tally."""
        replicates = self.world.scene.transport.replicates
        tally = (self.layout if levels is None else replace(self.layout, lamps=False)).tally()
        one = self.plan.packets(levels)
        for number in range(first, replicates):
            tally.restart(number_of(number, replicates, levels))
            with closing(
                self.traced(pool, tally.replicate, self.plan.chunks(tally.replicate, levels), tally.film)
            ) as chunks:
                for chunk in chunks:
                    tally.add(chunk)
                    self._report(number, tally.work.packets, one, clock, levels)
            if levels is None and self.layout.blind:
                tally.blind = self.blind_samples(pool, tally.replicate)
            yield tally

    def _report(self, number: int, done: int, one: int, clock: "Clock", levels: Counts | None) -> None:
        """Report the progress of a stage.

        Parameters
        ----------
        number : int
            Replicates finished.
        done, one : int
            Packets done in this replicate, and packets in all of it.
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
    """Return the replicate at a place of a stage; those of the second stage have other random numbers.

    Parameters
    ----------
    number : int
        Place in the stage.
    replicates : int
        Replicates of a stage.
    levels : (pixels,) uint8, or None
        None: the first stage.
    """
    return number if levels is None else replicates + number


def folded(tracer: Tracer, state: RenderState, tallies: Tallies, clock: Clock, keep: Keeper | None = None) -> Image:
    """Fold the tallies of both stages into the state, and return its image.

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
        Interrupted before the first replicate of the first stage was finished.
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
            # Inside `add` the sum may hold part of a replicate, and is not valid.
            if not between or not state.first.count:
                raise
            if keep is not None:
                keep(state, last=True)

    add(state.first, None)
    refinement = None
    if transport.target_error is not None and state.first.count == transport.replicates:
        seen = state.first.mean.mean
        if state.first.lamps is not None:
            seen = seen + state.first.lamps.mean
        levels, capped = second_stage(seen, state.first.mean.variance(), tracer.world.scene)
        state.second = state.second or tracer.layout.second()
        add(state.second, levels.ravel())
        refinement = _refined(tracer, state.first, state.second, levels, capped)
    state.seconds = clock.seconds
    return _image(tracer, state, refinement)


def _refined(tracer: Tracer, first: StageSum, second: StageSum, levels: Counts, capped: float) -> Refinement:
    """Average the second stage into the first one's mean."""
    transport = tracer.world.scene.transport
    assert transport.target_error is not None
    # A single replicate has no spread and so no error.
    replicates = second.count if second.count > 1 else 0
    more = samples_of(np.arange(levels.max() + 1, dtype=np.uint8)) * replicates
    before = tracer.samples * first.count
    if replicates:
        mean, variance = first.mean.mean, first.mean.variance()
        combine(mean, variance, second.mean.mean, second.mean.variance(), levels, more / (before + more))
        first.mean.hits += second.mean.hits
    spent = before + total_samples(levels) * replicates / tracer.pixels
    share = float((levels > 0).mean())
    return Refinement(transport.target_error, transport.max_samples, replicates, spent, share, capped)


def _image(tracer: Tracer, state: RenderState, refinement: Refinement | None) -> Image:
    """Make the image of a state, reusing the state's memory."""
    first, mean = state.first, state.first.mean
    variance = mean.variance()
    # Compared before the light of lamps' own packets is added, which samples from pixels cannot find.
    blind = first.blind.compared(mean.mean, variance) if first.blind is not None else None
    if first.lamps is not None:
        # These packets do not start from pixels, so the second stage has none: the first stage's are added.
        mean.mean += first.lamps.mean
        variance += first.lamps.variance()
        mean.hits += first.lamps.hits
    ledger = _ledger(tracer, first)
    # The energy is of the first stage, in which all pixels have the same samples; the work is of both stages.
    work = first.work
    if state.second is not None:
        work.add(state.second.work)
    ledger.packets, ledger.events = work.packets, int(work.counts[EVENTS])
    return Image(
        mean=mean.mean,
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
        hits=mean.hits,
        aim=tracer.world.aim_proof,
        blind=blind,
        order=tracer.order,
        coatings=coating_errors(tracer.world.scene),
    )


def _ledger(tracer: Tracer, first: StageSum) -> Ledger:
    book, unit = first.book / max(first.count, 1), "m² sr" if tracer.adjoint else "W"
    counts = first.work.counts
    ledger = ledger_of(book[OWN_BOOK], counts, tracer.world, first.work.packets, unit)
    if any(part.book == LAMP_BOOK for part in tracer.parts):
        ledger.lamps = ledger_of(book[LAMP_BOOK], np.zeros_like(counts), tracer.world, 0, "W")
    return ledger
