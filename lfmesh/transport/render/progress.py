"""Progress of a render, as reported to the caller of `render`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """Report of a running render.

    Attributes
    ----------
    done : int
        Packets started so far, over all replicates; before tracing, finished steps.
    total : int
        Total packets; before tracing, steps, 0 while unknown.
    seconds : float
        Wall-clock time since the start of tracing, or of the stage before it.
    replicate : int
        Finished replicates.
    replicates : int
        Total replicates; 0 before tracing.
    stage : str
        Name of the stage: "tracing", "refining", or the work before an installation's first render.
    """

    done: int
    total: int
    seconds: float
    replicate: int
    replicates: int
    stage: str

    @property
    def rate(self) -> float:
        """Packets, or steps, per second in the stage; 0 before the first."""
        return self.done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def seconds_left(self) -> float | None:
        """Time left at this rate; None before the first packet."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else None
