"""Units in processes of this machine, any of which may die without ending the study."""

import multiprocessing as mp
import os
import signal
import time
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

TRIES = 2
"""Largest number of attempts for a unit when its process dies."""

ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Settings for linear-algebra libraries: their last bits may depend on threads, which would also add to ours."""


class Work(Protocol):
    """A picklable unit of work, identified by two numbers and computed from a file or its bytes."""

    @property
    def point(self) -> int:
        """First number."""

    @property
    def batch(self) -> int:
        """Second number."""

    def compute(self, given: bytes | Path) -> bytes:
        """Return the outcome."""


@dataclass(frozen=True)
class Result:
    """A unit that is finished or given up.

    Attributes
    ----------
    unit : Work
    content : bytes or None
        Outcome; None if there is none.
    reason : str
        Reason if there is none, or "".
    deaths : int
        Number of processes that died while computing it.
    seconds : float
        Time from asking for the unit to its outcome.
    is_first : bool
        True for the first unit of a process, whose time has the start of the process and the compiling of kernels.
    """

    unit: Work
    content: bytes | None
    reason: str = ""
    deaths: int = 0
    seconds: float = 0.0
    is_first: bool = False


def here(units: Iterable[tuple[Work, Path]]) -> Iterator[Result]:
    """Compute units in this process, one after the other."""
    began, is_first = time.perf_counter(), True
    for unit, reference in units:
        content, reason = computed(unit, reference)
        yield Result(unit, content, reason, seconds=time.perf_counter() - began, is_first=is_first)
        began, is_first = time.perf_counter(), False


def computed(unit: Work, reference: Path | bytes) -> tuple[bytes | None, str]:
    """Return a unit's outcome and "", or None and the reason."""
    try:
        return unit.compute(reference), ""
    except Exception as error:
        # An exception of any library at one point must not stop the others.
        return None, f"{type(error).__name__}: {' '.join(str(error).split())}"


@dataclass
class _Worker:
    process: Any
    pipe: Connection
    unit: tuple[Work, Path] | None = None
    began: float = 0.0
    is_new: bool = True


def in_pool(units: Iterable[tuple[Work, Path]], workers: int) -> Iterator[Result]:
    """Compute units in processes, and yield them as they finish.

    Parameters
    ----------
    units : iterable of (Work, Path)
        Units with their input files; taken as workers become free.
    workers : int
        Number of processes.
    """
    waiting = iter(units)
    again: deque[tuple[Work, Path]] = deque()
    deaths: dict[tuple[int, int], int] = {}
    team: list[_Worker] = []

    def next_job() -> tuple[Work, Path] | None:
        return again.popleft() if again else next(waiting, None)

    def give_work(worker: _Worker) -> None:
        worker.began = time.perf_counter()
        worker.unit = next_job()
        if worker.unit is not None:
            # If the process has died meanwhile, this is noticed below.
            with suppress(OSError):
                worker.pipe.send(worker.unit)

    try:
        idle = workers
        while True:
            for worker in team:
                if worker.unit is None:
                    give_work(worker)
            while idle and (job := next_job()) is not None:
                again.appendleft(job)
                team.append(_started())
                give_work(team[-1])
                idle -= 1
            busy = [worker for worker in team if worker.unit is not None]
            if not busy:
                return
            ready = wait([worker.pipe for worker in busy])
            for worker in busy:
                if worker.pipe not in ready:
                    continue
                assert worker.unit is not None
                job, worker.unit = worker.unit, None
                key = job[0].point, job[0].batch
                try:
                    content, reason = worker.pipe.recv()
                except (EOFError, OSError):
                    worker.process.join()
                    team.remove(worker)
                    idle += 1
                    deaths[key] = deaths.get(key, 0) + 1
                    if deaths[key] < TRIES:
                        again.append(job)
                    else:
                        yield Result(job[0], None, _death_in_words(worker.process.exitcode), deaths[key])
                    continue
                seconds, is_first = time.perf_counter() - worker.began, worker.is_new
                worker.is_new = False
                give_work(worker)
                yield Result(job[0], content, reason, deaths.get(key, 0), seconds, is_first)
    finally:
        for worker in team:
            _end(worker)


def _started() -> _Worker:
    context = mp.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs,), daemon=True, name="lfmesh study")
    with _environment(ONE_THREAD):
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _end(worker: _Worker) -> None:
    """Terminate a process started by this one, whatever it is doing."""
    worker.pipe.close()
    if worker.process.is_alive():
        worker.process.terminate()
    worker.process.join()


def _serve(pipe: Connection) -> None:
    """Compute units until the other end of the pipe is closed."""
    # Ctrl-C in a terminal reaches all processes; the parent decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    while True:
        try:
            unit, reference = pipe.recv()
            pipe.send(computed(unit, reference))
        except (EOFError, OSError):
            return


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _death_in_words(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        hint = ": perhaps memory ran out" if -code == signal.SIGKILL else ""
        return f"its process was ended by {name}, {TRIES} times{hint}"
    return f"its process ended with exit code {code}, {TRIES} times"
