"""The energy ledger: the fate of all energy of a run (in the adjoint method, of all importance)."""

from dataclasses import dataclass, field, fields
from typing import Any

from lfmesh.notebook import Shown

LOST_LIMIT = 1e-7
"""Share of the energy that may be lost to rounding without a warning."""

NAMED_BODIES = 4
"""Number of bodies that a warning about lost energy names."""


def loss_in_words(lost: float, lost_in: dict[str, float], emitted: float) -> str | None:
    """Return the message of a warning about lost energy; None if the loss is within `LOST_LIMIT`.

    Parameters
    ----------
    lost : float
        Lost energy, in the unit of `emitted`.
    lost_in : dict of str to float
        The same energy by body.
    emitted : float
    """
    if not lost > LOST_LIMIT * emitted:
        return None
    worst = sorted(lost_in.items(), key=lambda item: -item[1])
    bodies = [f"{value / emitted:.1e} in {name}" for name, value in worst[:NAMED_BODIES]]
    if len(worst) > NAMED_BODIES:
        bodies.append(f"the rest in {len(worst) - NAMED_BODIES} others")
    shares = f": {', '.join(bodies)}" if bodies else ""
    return f"{lost / emitted:.1e} of the energy was lost by the tracer{shares}"


@dataclass
class Ledger(Shown):
    """Sums over all packets of a run.

    `unit` is "W" in the forward method; the adjoint method accounts for importance, W per unit radiance (m² sr).

    The parts balance to rounding: emitted + roulette_added + sampling_added = sensor + sum(absorbed) + escaped +
    roulette_removed + sampling_removed + depth + sum(lost).
    """

    unit: str = "W"
    """Unit of all energies."""
    emitted: float = 0.0
    """Energy of the packets when they start."""
    sensor: float = 0.0
    """Energy of packets that ended on the sensor."""
    absorbed: dict[str, float] = field(default_factory=dict)
    """Absorbed energy by body: "stop", "lens[0] edge", "mount", "mla edge", "housing", "targets[0]", ..."""
    escaped: float = 0.0
    """Energy of packets that left the scene."""
    roulette_added: float = 0.0
    """Added to packets that survived Russian roulette."""
    roulette_removed: float = 0.0
    """Energy of packets that Russian roulette ended."""
    sampling_added: float = 0.0
    """Added by aimed sampling: at a scattering event, the weight of the child that is aimed at the pupil."""
    sampling_removed: float = 0.0
    """Removed by aimed sampling: scattered packets that reach the lens without being aimed, which would count twice."""
    depth: float = 0.0
    """Energy of packets cut by `max_events`."""
    lost: dict[str, float] = field(default_factory=dict)
    """Lost energy by reason. "miss": a ray that met nothing inside a closed space. "contradiction": a ray that met only
    facets that cannot bound its space. "stuck": a packet that moved on and on without an event."""
    lost_in: dict[str, float] = field(default_factory=dict)
    """The same energy by body: "targets[1]", "lens[0]", "mla", ..."""
    packets: int = 0
    """Packets started."""
    events: int = 0
    """Ray-surface events shaded."""
    fallbacks: int = 0
    """Surface level `patch`: hits on a flat facet because its curved patch was not met."""
    requeries: int = 0
    """Hits that the float64 test refused, each followed by another query."""
    reached_target: float = 0.0
    """Adjoint: importance that arrived at a target (before it is absorbed or scattered there)."""
    lit: float = 0.0
    """Adjoint: the part of `reached_target` at points that a light reaches or that emit."""
    untraced: float = 0.0
    """Light of particles on the sensor from their point spreads, without tracing, W. Not part of the sums."""
    lamps: "Ledger | None" = None
    """Ledger of packets from particles, from lamps towards a rough camera and, in the adjoint method, towards glass, in
    W. A lamp that sends both kinds counts twice in `emitted`. None without such packets."""

    def __repr__(self) -> str:
        # If only particles shine, all light is theirs.
        parts = [part for part in (self, self.lamps) if part is not None and part.emitted > 0.0] or [self]
        return f"<Ledger: {'; '.join(part._in_words() for part in parts)}>"

    def _in_words(self) -> str:
        return (
            f"{self.emitted:.6g} {self.unit} emitted, {self.sensor / (self.emitted or 1.0):.3%} on the sensor, "
            f"{self.lost_share:.1e} lost, {self.imbalance:.1e} not closed"
        )

    @property
    def total_in(self) -> float:
        """Sum of all energy that entered."""
        return self.emitted + self.roulette_added + self.sampling_added

    @property
    def total_out(self) -> float:
        """Sum of all energy that left or ended."""
        return (
            self.sensor
            + sum(self.absorbed.values())
            + self.escaped
            + self.roulette_removed
            + self.sampling_removed
            + self.depth
            + sum(self.lost.values())
        )

    @property
    def imbalance(self) -> float:
        """(in − out) / emitted: zero to rounding unless the tracer has an error."""
        return (self.total_in - self.total_out) / self.emitted if self.emitted else 0.0

    @property
    def lost_share(self) -> float:
        """Lost energy over emitted energy."""
        return sum(self.lost.values()) / self.emitted if self.emitted else 0.0

    def loss_in_words(self) -> str | None:
        """Return the message of a warning about the lost energy; None if the loss is within `LOST_LIMIT`.

        Returns
        -------
        str or None
        """
        return loss_in_words(sum(self.lost.values()), self.lost_in, self.emitted)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Ledger":
        """Return the ledger from the output of `as_dict`; fields missing in older reports keep their defaults.

        Parameters
        ----------
        values : dict
            From `as_dict`, or a run's report.

        Returns
        -------
        Ledger
        """
        own = {each.name: values[each.name] for each in fields(cls) if each.name in values}
        lamps = values.get("lamps")
        return cls(**own | {"lamps": None if lamps is None else cls.from_dict(lamps)})

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers for JSON, the derived ones included.

        Returns
        -------
        dict
        """
        return {
            **vars(self),
            "lamps": None if self.lamps is None else self.lamps.as_dict(),
            "total_in": self.total_in,
            "total_out": self.total_out,
            "imbalance": self.imbalance,
            "lost_share": self.lost_share,
        }
