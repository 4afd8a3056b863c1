"""Progress of a study or dataset."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from lfmesh.files.words import duration
from lfmesh.notebook import announced, silent
from lfmesh.scene.literals import counted


@dataclass(frozen=True)
class Progress:
    """Progress of a study.

    Attributes
    ----------
    done, total : int
        Numbers of units.
    new : int
        Units finished in this run.
    failed : int
        Points that cannot be traced.
    seconds : float
        Duration of this run.
    best, worst : str
        Best and worst point by the first metric, in words, or "".
    size_left : float
        Mean number of cameras in the remaining units, over that in the units of this run.
    start_seconds : float
        Part of `seconds` in which processes started and kernels were compiled, which the remaining units do not need.
    """

    done: int
    total: int
    new: int
    failed: int
    seconds: float
    best: str = ""
    worst: str = ""
    size_left: float = 1.0
    start_seconds: float = 0.0

    @property
    def unit_seconds(self) -> float | None:
        """Time of this run per unit without its start; None if the units took no other time."""
        working = self.seconds - self.start_seconds
        return working / self.new if self.new and working > 0.0 else None

    @property
    def seconds_left(self) -> float | None:
        """Remaining time at the rate of this run."""
        each = self.unit_seconds
        return each * (self.total - self.done) * self.size_left if each is not None else None

    def in_words(self, things: str, failing: str) -> str:
        """Return the progress in words.

        Parameters
        ----------
        things, failing : str
            Noun for the units counted, in the plural, and for one that may fail.
        """
        words = f"{self.done} of {self.total} {things}"
        if self.unit_seconds is not None:
            words += f", {60.0 / self.unit_seconds:.3g} per minute"
        if self.seconds_left is not None:
            words += f", {duration(self.seconds_left)} left"
        if self.failed:
            words += f", {counted(self.failed, failing)} failed"
        return words + (f"; best {self.best}; worst {self.worst}" if self.best else "")


Report = Callable[[Progress], None]


@contextmanager
def reported(progress: Report | bool | None, things: str = "units", failing: str = "point") -> Iterator[Report | None]:
    """Yield the function that receives a study's progress, or None.

    Parameters
    ----------
    progress : callable, bool or None
        A callable is used itself; otherwise as for `lfmesh.notebook.announced`.
    things, failing : str
        As for `Progress.in_words`.
    """
    if callable(progress):
        with announced(False):
            yield progress
        return
    with announced(progress) as say:
        yield None if say is silent else lambda now: say(now.in_words(things, failing))
