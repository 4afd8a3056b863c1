"""Given rays: a user's, or those from a field point."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import kernel
from lfmesh.transport.engine import Workspace
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import CAMERA, CAMERA_FRAME, NO_SURFACE, Flow, put
from lfmesh.transport.packets.random import derived
from lfmesh.transport.sources.source import Source

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RaySource(Source):
    """Rays, each of which is a packet.

    Attributes
    ----------
    position, direction : (n, 3) float64, mm, unit, camera frame
    station, space : (n,) int64
        What each ray waits for, and the space of the lens in which it starts.
    weight : (n,) float64
        Power of each.
    key : uint64
        Of the random numbers.
    away : float, mm
        Distance from the start within which nothing is met.
    """

    position: Array
    direction: Array
    station: Numbers
    space: Numbers
    weight: Array
    key: np.uint64
    away: float = 0.0

    def __len__(self) -> int:
        return len(self.position)

    def launch(self, work: Workspace, part: range) -> None:
        """Put some of the rays on the stacks of their stations."""
        some = slice(part.start, part.stop)
        launch_rays(
            part.start, self.position[some], self.direction[some], self.station[some], self.space[some],
            self.weight[some], self.away, work.tables.lens.medium, self.key, work.flow(), work.template,
        )  # fmt: skip


@kernel
def launch_rays(
    first: int, p: Array, d: Array, station: Numbers, space: Numbers, weight: Array, away: float,
    medium: Numbers, key: np.uint64, flow: Flow, template: NDArray[np.void],
) -> None:  # fmt: skip
    """Put rays given in the camera frame on the stacks of their stations."""
    packet = template[0]
    packet.colour = 0
    packet.kind = CAMERA
    packet.facet = NO_SURFACE
    packet.last = NO_SURFACE
    packet.column = NO_SURFACE
    packet.events = 0
    for i in range(len(p)):
        packet.source = first + i
        packet.space, packet.medium = space[i], medium[space[i]]
        packet.node = NO_SURFACE
        packet.start = weight[i]
        flow.book[EMITTED] += weight[i]
        put(
            flow, station[i], packet, CAMERA_FRAME,
            p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2], weight[i], derived(key, first + i), away,
        )  # fmt: skip
