"""Progress of a render, as reported to the caller of `render`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One report of a running render.

    Attributes
    ----------
    done : int
        Packets started so far, over all replicates.
    total : int
        Packets in all.
    seconds : float
        Wall-clock time since tracing began.
    replicate : int
        Replicates finished.
    replicates : int
        Replicates in all.
    stage : str
        Name of the stage: "building", "tracing", ...
    """

    done: int
    total: int
    seconds: float
    replicate: int
    replicates: int
    stage: str

    @property
    def rate(self) -> float:
        """Packets a second since tracing began; 0 before the first."""
        return self.done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Time left at this rate; None before the first packet is done."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else None
