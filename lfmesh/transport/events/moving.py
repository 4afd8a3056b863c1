"""Moving frames: a packet's time, and its moves between the frames of bodies that move.

An event at a body takes place in the frame of its mover, in which the body rests and all its tables hold: the packet's
ray is moved there, and its `frame` says so. In the thread's table of frames, `Moving.frames`, that frame stands for
the object frame, so code that goes from the object frame to the camera or the world need not know of motion. Children
stay in the frame of their parent (`packets.packet.put`). A packet's time follows from its source and its sample, so all
packets of a sample have one time and no packet stores it.

The world of the table of frames at a later time is the one that the camera has carried along.

`moving` is None in a scene without motion; numba then compiles nothing here.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.rigid_motion import fill_pose, fill_relative
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.exposure import drawn_time
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    MOVING_FRAME,
    OBJECT_FRAME,
    WORLD_FRAME,
    Options,
    mover_of_frame,
)
from lfmesh.transport.tables.motions import STALE, STILL

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


@inlined
def begin(moving: Any, options: Options, packet: Any) -> None:
    """Make the moment and the frame of a packet the present ones, before its event.

    Parameters
    ----------
    moving : Moving or None
    options : Options
    packet : PACKET
    """
    if moving is None:
        return
    if _is_new(moving, options, packet):
        _set_time(moving, drawn_time(moving.motions, options, packet))
    _hold_frames(moving, mover_of_frame(packet.frame))


@inlined
def begin_query(moving: Any, options: Options, packet: Any, i: int) -> None:
    """Make the moment of a packet the present one, before its query, and note it for `begin_hit`.

    Parameters
    ----------
    moving : Moving or None
    options : Options
    packet : PACKET
    i : int
        Number of the packet in its wave.
    """
    if moving is None:
        return
    if _is_new(moving, options, packet):
        _set_time(moving, drawn_time(moving.motions, options, packet))
    moving.times[i] = moving.time_s[0]


@inlined
def begin_hit(moving: Any, options: Options, packet: Any, i: int) -> None:
    """Make the moment of a packet the present one, after its query; `hold_frame` follows before its event.

    Parameters
    ----------
    moving : Moving or None
    options : Options
    packet : PACKET
    i : int
        Number of the packet in its wave.
    """
    if moving is None:
        return
    if _is_new(moving, options, packet):
        _set_time(moving, moving.times[i])


@inlined
def _is_new(moving: Any, options: Options, packet: Any) -> bool:
    """Tell whether a packet has another time than the last one, by its source, which becomes the known one."""
    source = np.uint64(packet.source)
    if moving.known[0] == source and moving.known[1] == options.stream:
        return False
    moving.known[0], moving.known[1] = source, options.stream
    if moving.held[0] != STILL:
        moving.held[0] = STALE
    return True


@kernel
def _set_time(moving: Any, time_s: float) -> None:
    """Set the present time, and the frames of all movers at that time."""
    motions = moving.motions
    moving.time_s[0] = time_s
    segments, first, there = motions.segments, motions.first, moving.scratch[1]
    if motions.camera_moves:
        fill_pose(segments, first[0], first[1], time_s, moving.scratch[0])
    for mover in range(1, len(first) - 1):
        fill_pose(segments, first[mover], first[mover + 1], time_s, there)
        if motions.camera_moves:
            fill_relative(moving.scratch[0], there, moving.back[mover])
        else:
            for i in range(3):
                for k in range(4):
                    moving.back[mover, i, k] = there[i, k]
        _invert(moving.back[mover], moving.to[mover])


@kernel
def _invert(pose: Array, found: Array) -> None:
    """Fill the inverse of a pose, (3, 4)."""
    for i in range(3):
        shift = 0.0
        for j in range(3):
            found[i, j] = pose[j, i]
            shift += pose[j, i] * pose[j, 3]
        found[i, 3] = -shift


@inlined
def mover_of(moving: Any, body: int) -> int:
    """Return the mover of a target; of the housing for −1.

    Parameters
    ----------
    moving : Moving or None
    body : int
    """
    if moving is None:
        return 0
    return int(moving.motions.of_target[body])


@inlined
def mover_of_medium(moving: Any, number: int) -> int:
    """Return the mover of a medium.

    Parameters
    ----------
    moving : Moving or None
    number : int
        Row of `Volumes`.
    """
    if moving is None:
        return 0
    return int(moving.motions.of_medium[number])


@inlined
def movers(moving: Any) -> int:
    """Return the number of movers; `moving` : Moving or None."""
    if moving is None:
        return 1
    return len(moving.motions.first) - 1


@inlined
def start_in_mover(moving: Any, options: Options, packet: Any, mover: int) -> None:
    """Begin a new packet, with its source known, in the frame of a mover; 0: the object frame.

    Parameters
    ----------
    moving : Moving or None
    options : Options
    packet : PACKET
    mover : int
    """
    if moving is None:
        return
    packet.frame = OBJECT_FRAME if mover == STILL else MOVING_FRAME + mover
    begin(moving, options, packet)


@inlined
def enter_mover(moving: Any, packet: Any, mover: int) -> None:
    """Move the ray of the packet in hand into the frame of a mover; 0: the object frame.

    Parameters
    ----------
    moving : Moving or None
    packet : PACKET
        In the object frame, or in that of a mover.
    mover : int
    """
    if moving is None:
        return
    here = mover_of_frame(packet.frame)
    if here == mover:
        return
    packet.x, packet.y, packet.z = point_between(moving, here, mover, packet.x, packet.y, packet.z)
    packet.dx, packet.dy, packet.dz = direction_between(moving, here, mover, packet.dx, packet.dy, packet.dz)
    packet.frame = OBJECT_FRAME if mover == STILL else MOVING_FRAME + mover
    _hold_frames(moving, mover)


@inlined
def set_rays(moving: Any, packet: Any) -> None:
    """Note the ray of the packet in hand in the frames of all movers, for `take_ray`.

    Parameters
    ----------
    moving : Moving or None
    packet : PACKET
        In the object frame, or in that of a mover.
    """
    if moving is None:
        return
    here = mover_of_frame(packet.frame)
    for mover in range(len(moving.rays)):
        ray = moving.rays[mover]
        ray[0], ray[1], ray[2] = point_between(moving, here, mover, packet.x, packet.y, packet.z)
        ray[3], ray[4], ray[5] = direction_between(moving, here, mover, packet.dx, packet.dy, packet.dz)


@inlined
def take_ray(moving: Any, packet: Any, mover: int) -> None:
    """Give the packet in hand its ray in the frame of a mover, from `set_rays`; `hold_frame` follows before an event.

    Parameters
    ----------
    moving : Moving or None
    packet : PACKET
    mover : int
    """
    if moving is None:
        return
    ray = moving.rays[mover]
    packet.x, packet.y, packet.z = ray[0], ray[1], ray[2]
    packet.dx, packet.dy, packet.dz = ray[3], ray[4], ray[5]
    packet.frame = OBJECT_FRAME if mover == STILL else MOVING_FRAME + mover


@inlined
def hold_frame(moving: Any, packet: Any) -> None:
    """Let the frame of the packet in hand stand for the object frame in the table of frames.

    Parameters
    ----------
    moving : Moving or None
    packet : PACKET
    """
    if moving is None:
        return
    _hold_frames(moving, mover_of_frame(packet.frame))


@inlined
def point_between(moving: Any, here: int, there: int, x: float, y: float, z: float) -> Vector:
    """Return a point, mm, moved from the frame of one mover into that of another.

    Parameters
    ----------
    moving : Moving or None
    here, there : int
        Movers; of a packet: `mover_of_frame(packet.frame)`.
    x, y, z : float, mm
    """
    if moving is None:
        return x, y, z
    if here == there:
        return x, y, z
    if here > 0:
        x, y, z = point_through(moving.back[here], x, y, z)
    if there > 0:
        x, y, z = point_through(moving.to[there], x, y, z)
    return x, y, z


@inlined
def direction_between(moving: Any, here: int, there: int, x: float, y: float, z: float) -> Vector:
    """Return a direction moved as `point_between` does.

    Parameters
    ----------
    moving : Moving or None
    here, there : int
    x, y, z : float
    """
    if moving is None:
        return x, y, z
    if here == there:
        return x, y, z
    if here > 0:
        x, y, z = direction_through(moving.back[here], x, y, z)
    if there > 0:
        x, y, z = direction_through(moving.to[there], x, y, z)
    return x, y, z


@inlined
def ray_between(moving: Any, here: int, there: int, ray: Ray) -> Ray:
    """Return a ray moved as `point_between` does.

    Parameters
    ----------
    moving : Moving or None
    here, there : int
    ray : Ray
    """
    if moving is None:
        return ray
    x, y, z = point_between(moving, here, there, ray.x, ray.y, ray.z)
    dx, dy, dz = direction_between(moving, here, there, ray.dx, ray.dy, ray.dz)
    return Ray(x, y, z, dx, dy, dz)


@inlined
def _hold_frames(moving: Any, mover: int) -> None:
    """Let the frame of a mover stand for the object frame in the table of frames."""
    if moving.held[0] != mover:
        _fill_frames(moving, moving.motions.frames, mover)
        moving.held[0] = mover


@kernel
def _fill_frames(moving: Any, frames: Array, mover: int) -> None:
    """Fill the moves between the frame of a mover, in place of the object frame, and camera and world."""
    into = moving.frames
    for other in (CAMERA_FRAME, WORLD_FRAME):
        if mover == STILL:
            for i in range(3):
                for k in range(4):
                    into[OBJECT_FRAME, other, i, k] = frames[OBJECT_FRAME, other, i, k]
                    into[other, OBJECT_FRAME, i, k] = frames[other, OBJECT_FRAME, i, k]
        else:
            _compose(frames[OBJECT_FRAME, other], moving.back[mover], into[OBJECT_FRAME, other])
            if moving.all_frames:
                _compose(moving.to[mover], frames[other, OBJECT_FRAME], into[other, OBJECT_FRAME])
        if not moving.all_frames:
            # The camera comes first.
            break


@kernel
def _compose(outer: Array, inner: Array, found: Array) -> None:
    """Fill the frame that applies `inner` first, then `outer`; all (3, 4)."""
    for i in range(3):
        for k in range(4):
            total = outer[i, 3] if k == 3 else 0.0
            for j in range(3):
                total += outer[i, j] * inner[j, k]
            found[i, k] = total
