"""Time and memory of a study, estimated before it is run."""

import time
from dataclasses import dataclass, replace

from lfmesh.study.metrics.metrics import pictures_of
from lfmesh.study.sweeps.plan import Plan
from lfmesh.study.sweeps.study import cores, default_workers
from lfmesh.study.sweeps.unit import Unit, reference_films, run_unit


@dataclass(frozen=True)
class Probe:
    """Time and memory of a study, estimated from a short trace of the reference.

    Attributes
    ----------
    points, units : int
    workers : int
    unit_seconds, seconds : float
        Of one unit in one process, and of all.
    bytes : float
        Memory, of all processes.
    """

    points: int
    units: int
    workers: int
    unit_seconds: float
    seconds: float
    bytes: float


PROBE_SHARES = (1, 3)
"""Replicates of the reference that are traced for a probe: the difference is the time of each more."""

PROCESS_BYTES = 4e8
"""Of a process that has traced something, without its films."""


def probe(plan: Plan, workers: int | None = None) -> Probe:
    """Estimate time and memory of a study from a short trace of its reference."""
    workers = default_workers(len(plan.units)) if workers is None else max(workers, 1)
    unit = _reference_unit(plan, max(1, cores() // workers))
    reference_films(replace(unit, replicates=range(1)))
    times, content = [], b""
    for count in PROBE_SHARES:
        began = time.perf_counter()
        content = reference_films(replace(unit, replicates=range(count)))
        times.append(time.perf_counter() - began)
    # The metrics of so few replicates; the jackknife takes one estimate for each, and one more.
    few = replace(unit, replicates=range(PROBE_SHARES[1]))
    run_unit(few, content)
    began = time.perf_counter()
    run_unit(few, content)
    compared = (time.perf_counter() - began) * (len(unit.replicates) + 1) / (PROBE_SHARES[1] + 1)
    each = max(0.0, (times[1] - times[0]) / (PROBE_SHARES[1] - PROBE_SHARES[0]))
    one = max(times[0] - each, 0.0) + each * len(unit.replicates) + compared
    columns, rows = plan.base.camera.sensor.pixels
    film = 8.0 * columns * rows * plan.base.channels * len(unit.replicates) * len(pictures_of(plan.metrics))
    # The camera's own films, the reference's, and what comparing them takes.
    memory = workers * (PROCESS_BYTES + 4.0 * film)
    seconds = one * sum(plan.cameras_of(point) for point in plan.points) * plan.study.batches / workers
    return Probe(len(plan.points), len(plan.units), workers, one, seconds, memory)


def _reference_unit(plan: Plan, threads: int) -> Unit:
    reference = plan.camera_of(plan.points[0])
    return Unit(plan.digest, 0, 0, reference, reference, plan.metrics, plan.replicates_of(0), threads)
