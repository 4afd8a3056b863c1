"""Progress of a render, as reported to the caller of `render`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """One report of a running render.

    Attributes
    ----------
    done : int
        Packets started so far, over all replicates; before tracing, steps finished.
    total : int
        Packets in all; before tracing, steps, 0 while their number is not known.
    seconds : float
        Wall-clock time since tracing, or what comes before, began.
    replicate : int
        Replicates finished.
    replicates : int
        Replicates in all; 0 before tracing.
    stage : str
        Name of the stage: "tracing", "refining", or what a first render of an installation does before.
    """

    done: int
    total: int
    seconds: float
    replicate: int
    replicates: int
    stage: str

    @property
    def rate(self) -> float:
        """Packets, or steps, a second since the stage began; 0 before the first."""
        return self.done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Time left at this rate; None before the first packet is done."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else None
