"""Straight segments of rays in object space, from the camera to their ends."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.transport.engine import Workspace
from lfmesh.transport.events.bodies import RANK
from lfmesh.transport.packets.packet import (
    BY_MESH,
    ENDED,
    LENS,
    MOVING_FRAME,
    OBJECT_FRAME,
    OBJECTS,
    OPTICAL,
    PIXEL_MASK,
    ROULETTE,
    S_ABSORBED,
    S_ESCAPED,
    S_TARGET,
    STATE,
    STATIONS,
    TRANSMIT,
    WORLD_FRAME,
    Options,
)
from lfmesh.transport.paths.automaton import COUNTS, STANDING
from lfmesh.transport.regions.objects import admit_to_objects
from lfmesh.transport.render.parts import Part
from lfmesh.transport.settings import with_thinning

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


class Segments(NamedTuple):
    """Straight segments of rays in object space.

    Attributes
    ----------
    origin, direction : (n, 3) float64
        World frame, mm; unit directions.
    length : (n,) float64, mm
    weight : (n,) float64, m² sr
        Divided by the square of the medium's index.
    pixel : (n,) int64
    colour : (n,) int64
        Index of the wavelength.
    place : (n,) int64
        Rank of the surrounding body of glass or liquid; 0 for air.
    per_mm : (n,) float64
        Absorption coefficient of that body, 1/mm.
    """

    origin: Array
    direction: Array
    length: Array
    weight: Array
    pixel: Numbers
    colour: Numbers
    place: Numbers
    per_mm: Array


def object_segments(work: Workspace, part: Part) -> Segments:
    """Trace packets from their pixels out of the camera, and return the segments of their paths in object space.

    Parameters
    ----------
    work : Workspace
        Holds the packets at their pixels.
    part : Part
        Selects the paths that count.
    """
    elsewhere = np.arange(STATIONS) != OBJECTS
    while (work.tops[:STATIONS] * elsewhere).any():
        work.advance(int(np.argmax(work.tops[:STATIONS] * elsewhere)))
    packets = work.stacks.waiting(OBJECTS)
    counts = STANDING[part.options.paths] == COUNTS
    if not work.world.targets and work.tables.objects.fields is None:
        segments = _pieces(packets, work, packets["frame"], counts)
        work.tops[OBJECTS] = 0
        return segments
    options = work.options
    work.options = _onward(options)
    try:
        return _followed(work, counts)
    finally:
        work.options, work.tops[ENDED] = options, 0


def _onward(options: Options) -> Options:
    """Return the options for packets in object space.

    One child of each interface survives with the whole weight, so that each segment has an end.
    """
    split = TRANSMIT if options.thinning.split == TRANSMIT else ROULETTE
    options = with_thinning(options, split=split)
    return options._replace(tracing=True, adjoint=False, faces=BY_MESH, bounce=False)


def _pieces(packets: NDArray[np.void], work: Workspace, frame: NDArray[Any], counts: NDArray[np.bool_]) -> Segments:
    """Return one ray without an end for each packet."""
    p = np.stack([packets[axis] for axis in ("x", "y", "z")], axis=-1)
    d = np.stack([packets[axis] for axis in ("dx", "dy", "dz")], axis=-1)
    # At t = 0 the frames of things that move are the object frame.
    frame = np.where(frame > MOVING_FRAME, OBJECT_FRAME, frame)
    for number in np.unique(frame):
        some = frame == number
        to_world = work.tables.frames[number, WORLD_FRAME]
        p[some], d[some] = frames.points(to_world, p[some]), frames.directions(to_world, d[some])
    index = work.tables.objects.media.indices[packets["medium"], packets["colour"]]
    if work.tables.objects.fields is not None:
        index = _in_fields(packets, index)
    weight = packets["weight"] / (index * index)
    # Other paths belong to other parts.
    weight = np.where(counts[packets["path"]], weight, 0.0)
    pixel, colour = packets["source"] & PIXEL_MASK, packets["colour"].astype(np.int64)
    absorption = work.tables.objects.media.absorption
    per_mm = np.zeros(len(p)) if absorption is None else absorption.per_mm[packets["medium"], packets["colour"]]
    # Only packets in object space are in bodies; elsewhere the field holds a cell of the array.
    place = np.where((frame == OBJECT_FRAME) & (packets["bodies"] >= 0), packets["bodies"] & RANK, 0)
    return Segments(p, d, np.full(len(p), np.inf), weight, pixel, colour, place.astype(np.int64), per_mm)


def _in_fields(packets: NDArray[np.void], around: Array) -> Array:
    """Return the index at packets, (n,): in a medium that bends light, the length of the optical ray vector."""
    inside = (packets["chord"][:, STATE] > 0.0) & (packets["chord"][:, OPTICAL] > 0.0)
    return np.where(inside, packets["chord"][:, OPTICAL], around)


def _followed(work: Workspace, counts: NDArray[np.bool_]) -> Segments:
    """Trace packets from target to target until they end, and return the segments of their paths.

    A packet's `node` numbers its segment. A packet that queries Embree again keeps its origin; a child starts at its
    parent's end. In a medium that bends light each chord is a segment.
    """
    found = _pieces(work.stacks.waiting(OBJECTS)[:0], work, np.zeros(0, np.int8), counts)
    # Origins of the segments in the object frame, as the packets hold them.
    starts = np.zeros((0, 3))
    known = 0
    while top := int(work.tops[OBJECTS]):
        fresh = work.stacks.waiting(OBJECTS)[known:]
        unused = np.empty((len(fresh), 3), np.float32)
        tables = work.tables
        admit_to_objects(
            fresh, unused, unused.copy(), tables.frames, tables.objects.fields, work.options, work.moving
        )  # fmt: skip
        p = np.stack([fresh[axis] for axis in ("x", "y", "z")], axis=-1)
        is_child = np.ones(len(fresh), np.bool_)
        if len(starts):
            parent = fresh["node"].copy()
            way = p - starts[parent]
            is_child = (way != 0.0).any(axis=1)
            found.length[parent[is_child]] = np.linalg.norm(way[is_child], axis=1)
        children = fresh[is_child]
        fresh["node"][is_child] = len(starts) + np.arange(len(children))
        own = _pieces(children, work, children["frame"], counts)
        found = Segments(*(np.concatenate(pair) for pair in zip(found, own, strict=True)))
        starts = np.concatenate([starts, p[is_child]])
        known = top - work.advance(OBJECTS)
        # Rays that return to the lens are dropped; the grid lies in front of it.
        work.tops[LENS] = 0
    ended = work.ended[: work.tops[ENDED]]
    stopped = np.isin(ended["status"], (S_TARGET, S_ABSORBED))
    if (volumes := work.tables.objects.volumes) is not None:
        # A medium that absorbs a packet entirely, like unbounded fog, ends it at its origin; the segment continues and
        # dims.
        faded = stopped & (ended["body"] == volumes.rows["slot"][0])
        found.length[ended["node"][faded]] = np.inf
        ended, stopped = ended[~faded], stopped[~faded]
    way = ended["position"] - found.origin[ended["node"]]
    found.length[ended["node"][stopped]] = np.linalg.norm(way[stopped], axis=1)
    # The last segment of lost packets, or of packets with too many events, has no known end and is left out.
    found.length[ended["node"][~stopped & (ended["status"] != S_ESCAPED)]] = 0.0
    return found
