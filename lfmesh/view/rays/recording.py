"""Sources traced in chunks, with every vertex of their paths recorded."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.packets.packet import CAMERA_FRAME, OBJECTS, WORLD_FRAME, Options
from lfmesh.transport.regions.glass_round import glass_round
from lfmesh.transport.sources.rays import RaySource
from lfmesh.transport.sources.source import Launcher, Source
from lfmesh.transport.tables.tables import Records, Tables
from lfmesh.transport.trace import joined_records
from lfmesh.transport.world import World

Floats = NDArray[np.float64]

OWN_SURFACE = 32.0 * FLOAT32_GRAIN
"""Largest distance of a field point from the target containing it, relative to its coordinates."""


def traced(world: World, tables: Tables, options: Options, source: Source, colour: int) -> tuple[Records, Records]:
    """Trace a source in chunks; return the ends of packets and all vertices.

    Parameters
    ----------
    world : World
    tables : Tables
    options : Options
    source : Source
    colour : int
        Index of the wavelength in the launch.
    """
    launcher = Launcher(lambda: Workspace(world, options, tables=tables))
    parts = []
    for part in source.parts():
        work = launcher.trace(source, part)
        parts.append((work.ends(), work.vertices()))
        work.recorded += len(parts[-1][1])
    ended, nodes = joined_records(parts)
    ended["colour"] = colour
    return ended, nodes


def from_point(world: World, point: Floats, d: Floats, watts: Floats, key: np.uint64) -> RaySource:
    """Return rays from a point before the lens.

    Parameters
    ----------
    world : World
    point : (3,) float64, mm, camera frame
    d : (n, 3) float64, unit, camera frame
    watts : (n,) float64, W
    key : uint64
        Key of the random numbers.
    """
    rays = len(d)
    place = frame.points(world.tables.frames[CAMERA_FRAME, WORLD_FRAME], point[None])
    inside = glass_round(world.tables.objects, world.targets, place)
    return RaySource(
        np.tile(point, (rays, 1)), d, np.full(rays, OBJECTS), np.zeros(rays, np.int64), watts, key,
        OWN_SURFACE * float(np.abs(point).sum()), np.full(rays, inside[0]),
    )  # fmt: skip
