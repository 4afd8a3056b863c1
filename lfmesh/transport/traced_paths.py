"""Paths of given rays: their ends, and every vertex if recorded."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.notebook import Shown
from lfmesh.transport.packets.ledger import Ledger
from lfmesh.transport.packets.packet import Event, Status
from lfmesh.transport.world import World


@dataclass(frozen=True)
class Vertex:
    """Recorded point of a path."""

    position: NDArray[np.float64]
    """(3,) mm, world frame."""
    surface: str
    """Name of the surface: "lens surface 3", "mla curved face", "stop", ..."""
    event: Event
    weight: float
    """Weight of the packet after the event."""


@dataclass(frozen=True)
class Paths(Shown):
    """Ends of all packets of a trace, one row per packet, in the order of the input rays.

    Attributes
    ----------
    position : (n, 3) float64, mm, world frame
    direction : (n, 3) float64, unit
    weight : (n,) float64
        Share of the ray's power in the packet.
    status : (n,) int64
        `Status` of each packet.
    source : (n,) int64
        Index of the input ray.
    events : (n,) int64
        Number of interfaces met.
    body : list of str
        Body that each packet ended on.
    ledger : Ledger
    stokes : (n, 4) float64, optional
        I, Q, U and V of the packets in a scene with `transport.polarisation`; I is the weight. For the conventions see
        `optics.polarisation`.
    reference : (n, 3) float64, unit, world frame, optional
        Reference direction of Q and U, perpendicular to `direction`.
    """

    position: NDArray[np.float64]
    direction: NDArray[np.float64]
    weight: NDArray[np.float64]
    status: NDArray[np.int64]
    source: NDArray[np.int64]
    events: NDArray[np.int64]
    ledger: Ledger
    _slot: NDArray[np.integer]
    _node: NDArray[np.int64]
    _nodes: NDArray[np.void]
    _world: World
    stokes: NDArray[np.float64] | None = None
    reference: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.weight)

    def __repr__(self) -> str:
        ends = [(status.name.lower(), int((self.status == status).sum())) for status in Status]
        said = ", ".join(f"{number:,} {name}" for name, number in ends if number)
        return f"<Paths: {len(self):,} packets{': ' if said else ''}{said}>"

    @cached_property
    def body(self) -> list[str]:
        """Name of the body that each packet ended on, computed at the first use."""
        names: list[str] = np.array(self._world.slots, dtype=object)[self._slot].tolist()
        return names

    def vertices(self, packet: int) -> list[Vertex]:
        """Return the recorded path of a packet, from its ray's start to its end.

        Parameters
        ----------
        packet : int
            Row of the packet in the result.

        Returns
        -------
        list of Vertex

        Raises
        ------
        LfmeshError
            The trace was made without `record`.
        """
        if not len(self._nodes):
            raise LfmeshError("nothing was recorded; call trace(..., record=True)")
        path = []
        node = int(self._node[packet])
        while node >= 0:
            row = self._nodes[node]
            name = self._world.surface_name(int(row["surface"]))
            path.append(Vertex(row["position"].copy(), name, Event(int(row["event"])), float(row["weight"])))
            node = int(row["parent"])
        return path[::-1]
