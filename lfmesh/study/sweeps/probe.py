"""Time and memory of a study, estimated before it is run."""

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
from lfmesh.study.sweeps.unit import Unit, reference_films, run_unit, unpacked


@dataclass(frozen=True)
class Probe:
    """Time and memory of a study, estimated from short traces of some of its cameras.

    Attributes
    ----------
    points, units : int
    workers : int
    unit_seconds, start_seconds, seconds : float
        Of one camera in one process, of starting the processes, and of all.
    bytes : float
        Memory, of all processes.
    unknown : tuple of str
        Metrics that cannot be had of the reference, and why, a line each.
    """

    points: int
    units: int
    workers: int
    unit_seconds: float
    start_seconds: float
    seconds: float
    bytes: float
    unknown: tuple[str, ...]


REPLICATES = (4, 2)
"""Replicates of a camera that are traced for a probe: the difference is the time of each more."""

PROCESS_BYTES = 4e8
"""Of a process that has traced something, without its films."""


@dataclass(frozen=True)
class _Stopwatch:
    """A unit of work that takes the time of another one."""

    unit: Unit
    point: int = 0
    batch: int = 0

    def compute(self, _: bytes | Path) -> bytes:
        """Return seconds, and why metrics of the reference are not known.

        Seconds of all, of a process's first camera, of another one, and of that with each of `REPLICATES`. A camera
        that was traced before takes less, as its tables are there.
        """
        times = [time.perf_counter()]
        cameras = [replace(self.unit, replicates=range(count)) for count in REPLICATES]
        films = [reference_films(cameras[0])]
        unit = replace(cameras[0], point=0)
        of_reference = unpacked(run_unit(unit, films[0]), unit.study, 0, unit.batch, unit.metrics)
        times.append(time.perf_counter())
        films.append(reference_films(cameras[1]))
        for camera, reference in zip((cameras[0], *cameras), (films[0], *films), strict=True):
            began = time.perf_counter()
            run_unit(camera, reference)
            times.append(time.perf_counter() - began)
        first = times[1] - times[0]
        seconds = [time.perf_counter() - times[0], first, *times[2:]]
        return json.dumps([*seconds, unknown_of_reference(of_reference)]).encode()


def probe(plan: Plan, workers: int | None = None) -> Probe:
    """Estimate time and memory of a study from short traces of its cameras, in a process of their own.

    Raises
    ------
    LfmeshError
        They cannot be traced.
    """
    workers = default_workers(len(plan.units)) if workers is None else workers
    at_once = max(workers, 1)
    unit = _first_unit(plan, max(1, cores() // at_once))
    # Kernels that have to be compiled are no part of a study: from now on they are kept.
    reference_films(replace(unit, replicates=range(1)))
    began = time.perf_counter()
    (result,) = in_pool([(_Stopwatch(unit), Path())], 1)
    elapsed = time.perf_counter() - began
    if result.content is None:
        raise LfmeshError(f"the study cannot be tried: {result.reason}")
    busy, first, fresh, again, with_fewer, unknown = json.loads(result.content)
    start = max(0.0, elapsed - busy + first - fresh)
    each = max(0.0, (again - with_fewer) / (REPLICATES[0] - REPLICATES[1]))
    replicates = len(unit.replicates)
    one = max(0.0, fresh + each * (replicates - REPLICATES[0]))
    columns, rows = plan.base.camera.sensor.pixels
    film = 8.0 * columns * rows * plan.base.channels * replicates * len(pictures_of(plan.metrics))
    # The camera's own films, the reference's, and what comparing them takes.
    memory = at_once * (PROCESS_BYTES + 4.0 * film)
    cameras = sum(plan.cameras_of(point) for point in plan.points) * plan.study.batches
    # The process that traces the reference is started before those of the pool.
    starts = start * (1 if workers == 0 else 2)
    seconds = starts + one * cameras / at_once
    return Probe(len(plan.points), len(plan.units), at_once, one, starts, seconds, memory, tuple(unknown))


def _first_unit(plan: Plan, threads: int) -> Unit:
    """Return a unit of the first camera beside the reference, which is neither searched nor adjusted."""
    reference, camera = (plan.camera_of(point) for point in (plan.points[0], plan.points[:2][-1]))
    return Unit(plan.digest, 1, 0, camera, reference, plan.metrics, plan.replicates_of(0), threads)
