"""Tables for kernels of motion in time: who moves, when a pixel sees it, and each thread's present moment.

Things that share one motion relative to the camera are one *mover*. Mover 0 stands still relative to the camera. The
tables of lights, targets and media hold everything where it is at t = 0, in the object frame. The frame of a mover
coincides with the object frame at t = 0 and is carried along, so tables hold in it at all times.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]
Records = NDArray[np.void]

STILL = 0
"""Number of the mover that stands still relative to the camera."""

STALE = -1
"""Stands for a mover in `Moving.held` if the table of frames is of an earlier time."""


@by_address
class Motions(NamedTuple):
    """Motions of a scene, object frame, and the exposure."""

    segments: Records  # (n,) SEGMENT of all movers in the world; those of the camera first
    first: Numbers  # (movers + 1,) first segment of each mover, and the end; mover 0: the motion of the camera
    of_target: Numbers  # (targets + 1,) mover of each target, of glass too; the last: the housing, 0
    of_lamp: Numbers  # (lamps,)
    of_medium: Numbers  # (rows of `Volumes`, or more,)
    resting: int  # mover of all that rests in the world
    bounds: Array  # (movers, 4) mm: a sphere in the frame of the mover that holds its targets; radius −1: no targets
    begin_s: Array  # (rows of the sensor,) begin of the window of each row of pixels, s
    duration_s: float  # of the window of a row
    end_s: float  # end of the last window
    shutter: Array  # (3, k): times in the window, s; opening; its integral up to there, s
    camera_moves: bool
    frames: Array  # (6, 6, 3, 4) at t = 0, see `tables.frames`

    def of(self, mover: int) -> Records:
        """Return the motion of a mover in the world, of the camera for mover 0, (n,) SEGMENT."""
        return self.segments[self.first[mover] : self.first[mover + 1]]


@by_address
class Moving(NamedTuple):
    """The moment of the packet in hand: working memory of one thread."""

    motions: Motions
    known: NDArray[np.uint64]  # (2,) source and stream of the packet whose time is set
    time_s: Array  # (1,)
    times: Array  # (packets,) of the packets of a wave, s
    to: Array  # (movers, 3, 4) from the object frame to the frame of each mover
    back: Array  # (movers, 3, 4) and back
    scratch: Array  # (2, 3, 4) poses of the camera and of a body in the world
    frames: Array  # (6, 6, 3, 4) in which the frame of the mover `held` stands for the object frame
    held: Numbers  # (1,)
    all_frames: bool  # `frames` holds all moves; else, for paths from the sensor, only those to the camera
    rays: Array  # (movers, 6) ray of the packet in the frame of each mover
    # Queries of a wave, for the mesh of each mover from 1 on.
    origins: NDArray[np.float32]  # (movers, packets, 3)
    directions: NDArray[np.float32]  # (movers, packets, 3)
    queried: Numbers  # (movers,) number of queries
    packet: NDArray[np.int32]  # (movers, packets) packet of each query
    found: NDArray[np.int32]  # (movers, packets) facet found for each packet; −1: none; FAR: not queried


FAR = -2
"""Stands for a facet in `Moving.found` if the ray passes far from all targets of the mover."""


def moving(motions: Motions | None, packets: int, *, all_frames: bool = True) -> Any:
    """Return the working memory of a thread; None without motion.

    Parameters
    ----------
    motions : Motions or None
    packets : int
        Largest number of packets in a wave.
    all_frames : bool
        See `Moving`.
    """
    if motions is None:
        return None
    movers = len(motions.first) - 1
    still = np.repeat(np.eye(3, 4)[None], movers, axis=0)
    queries = np.zeros((movers, packets, 3), np.float32)
    facets = np.zeros((movers, packets), np.int32)
    return Moving(
        motions, _NOTHING_KNOWN.copy(), np.zeros(1), np.zeros(packets), still, still.copy(), np.zeros((2, 3, 4)),
        motions.frames.copy(), np.array([STILL]), all_frames, np.zeros((movers, 6)), queries, queries.copy(),
        np.zeros(movers, np.int64), facets, facets.copy(),
    )  # fmt: skip


_NOTHING_KNOWN = np.full(2, np.iinfo(np.uint64).max, np.uint64)


def forget_moment(moving: Any) -> None:
    """Forget the last packet's time, before packets start whose sources may have the same numbers.

    Parameters
    ----------
    moving : Moving or None
    """
    if moving is not None:
        moving.known[:] = _NOTHING_KNOWN
