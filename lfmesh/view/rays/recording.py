"""Packets put on the stacks, traced chunk by chunk, and every vertex of their paths kept."""

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.engine import CHUNK, Workspace
from lfmesh.transport.events.crossing import FLOAT32_GRAIN
from lfmesh.transport.packets.packet import ENDED, NODES, OBJECTS, Options
from lfmesh.transport.render.adjoint import launch_adjoint
from lfmesh.transport.render.forward import launch_forward
from lfmesh.transport.tables.tables import Records, Tables
from lfmesh.transport.trace import joined_records, launch_rays
from lfmesh.transport.world import World

Floats = NDArray[np.float64]

Start = Callable[[Workspace], None]
"""Puts a chunk's packets on the stacks of a workspace."""

OWN_SURFACE = 32.0 * FLOAT32_GRAIN
"""How far a field point may lie off a target to be a point of it, relative to its coordinates."""


def traced(
    world: World, tables: Tables, options: Options, starts: Iterator[Start], wave: int
) -> tuple[Records, Records]:
    """Trace chunk by chunk; return the ends of packets and all vertices.

    Parameters
    ----------
    world : World
    tables : Tables
    options : Options
    starts : iterator of Start
        One for each chunk.
    wave : int
        Number of the wavelength among the launch's.
    """
    work = Workspace(world, options, tables=tables)
    parts = []
    for start in starts:
        work.begin(np.zeros((0, 1)))
        start(work)
        work.record_starts()
        work.run()
        parts.append((work.ended[: work.tops[ENDED]].copy(), work.nodes[: work.tops[NODES]].copy()))
        work.recorded += int(work.tops[NODES])
    ended, nodes = joined_records(parts)
    ended["wave"] = wave
    return ended, nodes


def from_point(point: Floats, d: Floats, watts: Floats, key: np.uint64) -> Iterator[Start]:
    """Yield the chunks of rays from a point before the lens.

    Parameters
    ----------
    point : (3,) float64, mm, camera frame
    d : (n, 3) float64, unit, camera frame
    watts : (n,) float64, W
    key : uint64
        Of the random numbers.
    """
    away = OWN_SURFACE * float(np.abs(point).sum())
    for first in range(0, len(d), CHUNK):
        part = slice(first, first + CHUNK)

        def start(work: Workspace, first: int = first, part: slice = part) -> None:
            rays = len(d[part])
            launch_rays(
                first, np.tile(point, (rays, 1)), np.ascontiguousarray(d[part]), np.full(rays, OBJECTS),
                np.zeros(rays, np.int64), work.tables.lens.medium, key, work.flow(), work.template,
            )  # fmt: skip
            packets = work.stacks[work.rows[OBJECTS], :rays]
            packets["weight"] = packets["start"] = watts[part]
            packets["query_from"] = packets["limit"] = away

        yield start


def at_pixels(pixels: NDArray[np.int64], samples: int, key: np.uint64) -> Iterator[Start]:
    """Yield the chunks of some pixels' samples, pixel by pixel.

    Parameters
    ----------
    pixels : (n,) int64
        Their numbers, row by row.
    samples : int
        Of each pixel.
    key : uint64
        Of the random numbers.
    """
    # A chunk holds whole pixels; one with more samples than a chunk is launched in one all the same.
    per_chunk = max(1, CHUNK // samples)
    for first in range(0, len(pixels), per_chunk):
        some = pixels[first : first + per_chunk]

        def start(work: Workspace, some: NDArray[np.int64] = some) -> None:
            work.reserve(len(some) * samples)
            tables = work.tables
            launch_adjoint(
                some, samples, True, key, 0, tables.sensor, tables.array, tables.aim, tables.frames,
                len(tables.lens.surfaces), work.bundle, work.flow(), work.start,
            )  # fmt: skip

        yield start


def from_sources(first: int, count: int, total: int, key: np.uint64, wave: int) -> Iterator[Start]:
    """Yield the chunks of packets `first` to `first + count` of a forward replicate, which share `total` of the power.

    Parameters
    ----------
    total : int
        Packets that the whole power of the sources is shared among.
    key : uint64
        Of the replicate at this wavelength.
    """
    for begin in range(first, first + count, CHUNK):
        rays = min(CHUNK, first + count - begin)

        def start(work: Workspace, begin: int = begin, rays: int = rays) -> None:
            tables = work.tables
            launch_forward(
                begin, rays, total, key, wave, tables.objects, tables.aim, tables.frames, work.options, work.flow(),
                work.template,
            )  # fmt: skip

        yield start
