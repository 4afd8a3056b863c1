"""Given rays as a source: a user's own rays, or rays from a field point."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.kernels.decorators import kernel
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.events.polarisation import across
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import (
    CAMERA,
    CAMERA_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    STATIONS,
    WORLD_FRAME,
    Flow,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.regions.glass_round import start_inside
from lfmesh.transport.sources.source import Source
from lfmesh.transport.tables.tables import Records

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RaySource(Source):
    """Given rays. Each starts one packet.

    Attributes
    ----------
    position : (n, 3) float64, mm, camera frame
    direction : (n, 3) float64, unit, camera frame
    station, space : (n,) int64
        Station where each ray waits, and the space of the lens where it starts.
    weight : (n,) float64
        Power of each ray.
    key : uint64
        Random key.
    away : float, mm
        Distance from the start within which the ray meets nothing.
    inside : (n,) int64, optional
        Glass bodies around the start of each ray, from `glass_round`; none for rays outside object space.
    stokes, reference : (n, 3) float64, optional
        In scenes with polarised light: Q, U and V over I, and the reference direction, world frame, square to the ray.
        If omitted, the rays are unpolarised.
    """

    position: Array
    direction: Array
    station: Numbers
    space: Numbers
    weight: Array
    key: np.uint64
    away: float = 0.0
    inside: Numbers | None = None
    stokes: Array | None = None
    reference: Array | None = None

    def __len__(self) -> int:
        return len(self.position)

    def launch(self, work: Workspace, part: range) -> None:
        """Queue some of the rays at their stations."""
        some = slice(part.start, part.stop)
        tables = work.tables
        reach = float(np.abs(tables.frames[CAMERA_FRAME, OBJECT_FRAME][:, 3]).sum())
        reach += float(tables.objects.facets["size"].max(initial=0.0))
        waiting = work.tops[:STATIONS].copy()
        launch_rays(
            part.start, self.position[some], self.direction[some], self.station[some], self.space[some],
            self.weight[some], self.away, reach, tables.lens.medium, self.key, work.flow(), work.template,
        )  # fmt: skip
        if self.inside is not None:
            started = work.stacks.waiting(OBJECTS)[waiting[OBJECTS] :]
            start_inside(started, self.inside[started["source"]], work.tables.objects)
        if work.tables.polarised is not None:
            for station in np.flatnonzero(work.tops[:STATIONS] > waiting):
                self._polarise(work.stacks.waiting(int(station))[waiting[station] :], work)

    def _polarise(self, started: Records, work: Workspace) -> None:
        """Set the polarisation states of queued rays."""
        number = started["source"]
        started["stokes"] = 0.0 if self.stokes is None else self.stokes[number]
        if self.reference is None:
            to_world = work.tables.frames[CAMERA_FRAME, WORLD_FRAME]
            started["reference"] = across(frame.directions(to_world, self.direction[number]))
        else:
            started["reference"] = self.reference[number]


@kernel
def launch_rays(
    first: int, p: Array, d: Array, station: Numbers, space: Numbers, weight: Array, away: float, reach: float,
    medium: Numbers, key: np.uint64, flow: Flow, template: NDArray[np.void],
) -> None:  # fmt: skip
    """Queue rays at their stations; the other parameters are attributes of `RaySource`.

    Parameters
    ----------
    first : int
        Number of the first ray.
    p, d : (n, 3) float64
        Position, mm, and direction, camera frame.
    reach : float, mm
        Bound on the increase of coordinates from camera frame to object space, plus the largest facet.
    medium : (K + 1,) int64
        Medium of each space of the lens.
    template : (1,) PACKET
        Working memory.
    """
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
        started = put(
            flow, station[i], packet, CAMERA_FRAME,
            p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2], weight[i], derived(key, first + i), away,
        )  # fmt: skip
        if station[i] == OBJECTS and away == 0.0:
            # In float32 a start just in front of a face may lie behind it.
            started.query_from = -FLOAT32_GRAIN * (abs(p[i, 0]) + abs(p[i, 1]) + abs(p[i, 2]) + reach)
