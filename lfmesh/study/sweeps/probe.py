"""Estimates of a study's time and memory before it runs."""

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path

from lfmesh.errors import LfmeshError
from lfmesh.study.metrics.metrics import pictures_of
from lfmesh.study.sweeps.plan import Plan
from lfmesh.study.sweeps.pool import in_pool
from lfmesh.study.sweeps.sentences import unknown_of_reference
from lfmesh.study.sweeps.study import cores, default_workers
from lfmesh.study.sweeps.unit import Outcome, Unit, reference_films, run_unit, unpacked


@dataclass(frozen=True)
class Probe:
    """Time and memory of a study, estimated from short traces of some cameras.

    Attributes
    ----------
    points, units : int
    workers : int
    unit_seconds, start_seconds, seconds : float
        Time of one camera in one process, of starting the processes, and of the whole study.
    bytes : float
        Memory of all processes.
    unknown : tuple of str
        Unknown metrics of the reference, and cameras that cannot be traced, with reasons, one line each.
    """

    points: int
    units: int
    workers: int
    unit_seconds: float
    start_seconds: float
    seconds: float
    bytes: float
    unknown: tuple[str, ...]


MOST_TRIED = 8
"""Largest number of cameras tried until one can be traced and timed; otherwise the reference is timed."""

REPLICATES = (4, 2)
"""Replicates per camera traced in a probe: the difference gives the time per replicate."""

PROCESS_BYTES = 4e8
"""Memory of a process that has traced something, without its films."""


@dataclass(frozen=True)
class _Stopwatch:
    """A unit of work that times others: the first of some that can be traced."""

    units: tuple[Unit, ...]
    point: int = 0
    batch: int = 0

    def compute(self, _: bytes | Path) -> bytes:
        """Return times, reasons for unknown metrics of the reference, and reasons for failures of tried units.

        Times, in seconds: total, a process's first camera, another camera, and that camera with each of `REPLICATES`. A
        camera traced before takes less time because its tables exist. A camera that fails is not timed.
        """
        began = time.perf_counter()
        films = [reference_films(replace(self.units[0], replicates=range(REPLICATES[0])))]
        unknown = unknown_of_reference(_timed(replace(self.units[0], point=0), REPLICATES[0], films[0])[1])
        first = time.perf_counter() - began
        films.append(reference_films(replace(self.units[0], replicates=range(REPLICATES[1]))))
        failed: list[tuple[int, str]] = []
        for unit in self.units:
            fresh, outcome = _timed(unit, REPLICATES[0], films[0])
            # The reference comes last and is timed even if all of its metrics are unknown.
            if not outcome.fault or unit is self.units[-1]:
                break
            failed.append((unit.point, outcome.fault))
        again = [_timed(unit, count, film)[0] for count, film in zip(REPLICATES, films, strict=True)]
        return json.dumps([time.perf_counter() - began, first, fresh, *again, unknown, failed]).encode()


def _timed(unit: Unit, replicates: int, films: bytes) -> tuple[float, Outcome]:
    """Trace some replicates of a unit; return the time in seconds and the outcome."""
    unit = replace(unit, replicates=range(replicates))
    began = time.perf_counter()
    content = run_unit(unit, films)
    return time.perf_counter() - began, unpacked(content, unit.study, unit.point, unit.batch, unit.metrics)


def probe(plan: Plan, workers: int | None = None) -> Probe:
    """Estimate time and memory of a study from short traces of its cameras in a separate process.

    Raises
    ------
    LfmeshError
        The cameras cannot be traced.
    """
    workers = default_workers(len(plan.units)) if workers is None else workers
    at_once = max(workers, 1)
    units = _first_units(plan, max(1, cores() // at_once))
    # Compiling kernels is not part of a study: compile and cache them first.
    reference_films(replace(units[0], replicates=range(1)))
    began = time.perf_counter()
    (result,) = in_pool([(_Stopwatch(units), Path())], 1)
    elapsed = time.perf_counter() - began
    if result.content is None:
        raise LfmeshError(f"the study cannot be tried: {result.reason}")
    busy, first, fresh, again, with_fewer, unknown, failed = json.loads(result.content)
    unknown += [f"point {number} ({plan.label(plan.points[number])}) cannot be traced: {why}" for number, why in failed]
    start = max(0.0, elapsed - busy + first - fresh)
    each = max(0.0, (again - with_fewer) / (REPLICATES[0] - REPLICATES[1]))
    replicates = len(units[0].replicates)
    one = max(0.0, fresh + each * (replicates - REPLICATES[0]))
    columns, rows = plan.base.camera.sensor.pixels
    film = 8.0 * columns * rows * plan.base.channels * replicates * len(pictures_of(plan.metrics))
    # Films of the camera and of the reference, and working memory to compare them.
    memory = at_once * (PROCESS_BYTES + 4.0 * film)
    cameras = sum(plan.cameras_of(point) for point in plan.points) * plan.study.batches
    # The process for the reference starts before the pool's.
    starts = start * (1 if workers == 0 else 2)
    seconds = starts + one * cameras / at_once
    return Probe(len(plan.points), len(plan.units), at_once, one, starts, seconds, memory, tuple(unknown))


def _first_units(plan: Plan, threads: int) -> tuple[Unit, ...]:
    """Return units of the first cameras and of the reference, without searches or adjustments.

    The reference is traced like any other camera.
    """
    reference = plan.camera_of(plan.points[0])
    some = [(point.number, plan.camera_of(point)) for point in plan.points[1 : 1 + MOST_TRIED]]
    return tuple(
        Unit(plan.digest, number, 0, camera, reference, plan.metrics, plan.replicates_of(0), threads)
        for number, camera in (*some, (len(plan.points), reference))
    )
