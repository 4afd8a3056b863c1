"""A user's rays along the image path in blocks, directly between the caller's arrays and the results.

This module follows rays to their ends if they certainly meet only lens, array and sensor: rays that start before the
lens and enter it, or start behind it, in either direction. Other rays get the fate `UNSURE`, and the caller traces
them as packets.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, select
from lfmesh.transport.packets.book import BESIDE_SENSOR, EMITTED, ESCAPED, HOUSING, ON_SENSOR, UNFOLLOWED
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    COUNTERS,
    EVENTS,
    MLA_FRAME,
    S_ABSORBED,
    S_ESCAPED,
    S_SENSOR,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.sequences.bundle import (
    BESIDE,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    LEFT_BEHIND,
    MET,
    ROWS,
    WEIGHT,
    X,
    Y,
    Z,
    empty_bundle,
    move_bundle,
    normalise,
    pad,
)
from lfmesh.transport.sequences.follower import (
    ARRAY_AGAIN,
    IN_ARRAY,
    IN_LENS,
    LENS_AGAIN,
    Route,
    follow_legs,
    image_route_of,
)
from lfmesh.transport.tables.surroundings import Surroundings
from lfmesh.transport.tables.tables import Camera, Tables

Array = NDArray[np.float64]
Corner = tuple[float, float, float]

# Rows beyond those of a bundle: the starts of the rays, camera frame, and their ways.
_X, _Y, _Z = ROWS * BLOCK, (ROWS + 1) * BLOCK, (ROWS + 2) * BLOCK
_DX, _DY, _DZ = (ROWS + 3) * BLOCK, (ROWS + 4) * BLOCK, (ROWS + 5) * BLOCK
_WAY = (ROWS + 6) * BLOCK
RAY_ROWS = ROWS + 7
"""Number of rows of a bundle with the starts of its rays."""

# Ways of a ray. The first three are not followed here.
_REFUSED, _ABSENT, _UNSURE = -2, -1, 0
_FROM_OBJECTS = 1  # through lens and array to the sensor
_TO_SENSOR, _ON_SENSOR = 2, 3  # from between lens and sensor: through the array, or straight on
_TO_OBJECTS, _BACK = 4, 5  # through the lens into object space: straight away, or through the array before
_WAYS = 6

ENDED, GONE, UNSURE, REFUSED = 0, 1, 2, 3
"""Fates: the ray has ended; it left the image path and has no row; it is not followed here; its numbers make no
ray."""


PART = 32_768
"""Number of rays per kernel call, enough to outweigh the call."""


class Ends(NamedTuple):
    """Ends of rays, one per row; as the attributes of `Paths`."""

    position: Array  # (n, 3) mm, world frame
    direction: Array  # (n, 3)
    weight: Array
    status: NDArray[np.int64]
    events: NDArray[np.int64]
    slot: NDArray[np.int32]  # slot of the book
    fate: NDArray[np.uint8]


class Followed(NamedTuple):
    """Followed rays, and the energy of fates `ENDED` and `GONE`."""

    ends: Ends
    book: Array  # (slots,) float64
    counts: NDArray[np.int64]  # (COUNTERS,)


def followed(tables: Tables, around: Surroundings, slots: int, p: Array, d: Array, threads: int) -> Followed:
    """Follow rays to their ends if their ways are certain.

    Parameters
    ----------
    tables : Tables
        With the media at the rays' wavelength first.
    around : Surroundings
    slots : int
        Number of slots of the book.
    p, d : (n, 3) float64, contiguous
        Position, mm, and direction of any length, world frame.
    threads : int
        0: all processors. The result does not depend on it.
    """
    rays, camera, route = len(p), tables.camera, image_route_of(tables)
    ends = Ends(
        np.empty((rays, 3)), np.empty((rays, 3)), np.empty(rays),
        np.empty(rays, np.int64), np.empty(rays, np.int64), np.empty(rays, np.int32), np.empty(rays, np.uint8),
    )  # fmt: skip
    parts = [slice(first, first + PART) for first in range(0, rays, PART)]
    books, counts = np.zeros((len(parts), slots)), np.zeros((len(parts), COUNTERS), np.int64)

    def follow(number: int) -> None:
        part = parts[number]
        some = Ends(
            ends.position[part], ends.direction[part], ends.weight[part], ends.status[part],
            ends.events[part], ends.slot[part], ends.fate[part],
        )  # fmt: skip
        follow_given_rays(
            p[part], d[part], camera, route, around, empty_bundle(RAY_ROWS), some, books[number], counts[number]
        )

    workers = min(threads or os.cpu_count() or 1, len(parts))
    if workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(follow, range(len(parts))))
    else:
        for number in range(len(parts)):
            follow(number)
    return Followed(ends, books.sum(axis=0), counts.sum(axis=0))


@kernel
def follow_given_rays(
    origins: Array, directions: Array, camera: Camera, route: Route, around: Surroundings, bundle: Array, ends: Ends,
    book: Array, counts: NDArray[np.int64],
) -> None:  # fmt: skip
    """Follow rays to their ends, block by block.

    Parameters
    ----------
    origins : (n, 3) float64, mm, world frame
    directions : (n, 3) float64
        Of any length.
    camera : Camera
        With the media at the rays' wavelength first.
    route : Route
        See `follower.image_route`.
    around : Surroundings
    bundle : (RAY_ROWS · BLOCK,) float64
        Working memory.
    ends : Ends
        Filled; rows of rays with a fate other than `ENDED` are not overwritten.
    book : (slots,) float64
        Receives the energy of the followed rays.
    counts : (COUNTERS,) int64
    """
    for first in range(0, len(origins), BLOCK):
        last = min(first + BLOCK, len(origins))
        count = last - first
        _start(bundle, origins[first:last], directions[first:last], count, camera.frames[WORLD_FRAME, CAMERA_FRAME])
        ways = _find_ways(bundle, count, camera, around)
        some = Ends(
            ends.position[first:last], ends.direction[first:last], ends.weight[first:last], ends.status[first:last],
            ends.events[first:last], ends.slot[first:last], ends.fate[first:last],
        )  # fmt: skip
        if ways & 1 != 0:
            _pass_over(bundle, count, some)
        for way in range(_FROM_OBJECTS, _WAYS):
            if ways & (1 << way) != 0:
                _follow_way(bundle, way, camera, route, around, book)
                _keep(bundle, count, way, camera.sensor.reflectance, some, book, counts)


@kernel
def _start(bundle: Array, origins: Array, directions: Array, count: int, to_camera: Array) -> None:
    """Write the rays in the camera frame with unit directions; refuse invalid rays."""
    for i in range(count):
        bundle[X + i], bundle[Y + i], bundle[Z + i] = origins[i, 0], origins[i, 1], origins[i, 2]
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = directions[i, 0], directions[i, 1], directions[i, 2]
    pad(bundle, count)
    _judge(bundle)
    # Twice, as the first division leaves a rounding error.
    normalise(bundle)
    normalise(bundle)
    move_bundle(bundle, to_camera)
    for i in range(6 * BLOCK):
        bundle[_X + i] = bundle[X + i]
    for i in range(count, BLOCK):
        bundle[_WAY + i] = _ABSENT


@kernel
def _judge(bundle: Array) -> None:
    """Refuse invalid rays."""
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        # Zero times a number that is not finite is not zero.
        is_ray = both(0.0 * x + 0.0 * y + 0.0 * z + 0.0 * length == 0.0, length > 0.0)
        bundle[_WAY + i] = select(is_ray, 1.0 * _UNSURE, 1.0 * _REFUSED)


@kernel
def _find_ways(bundle: Array, count: int, camera: Camera, around: Surroundings) -> int:
    """Find the way of each ray; return the set of ways as bits, the first for unfollowed rays."""
    low, high = around.low, around.high
    _find_entries(bundle, around.before, around.farthest, (low[0], low[1], low[2]), (high[0], high[1], high[2]))
    for n in range(len(around.boxes)):
        low, high = around.boxes[n, 0], around.boxes[n, 1]
        _stop_at_box(bundle, (low[0], low[1], low[2]), (high[0], high[1], high[2]), around.low[2])
    ways = 0
    for i in range(count):
        way = int(bundle[_WAY + i])
        if way == _UNSURE and bundle[_Z + i] > around.behind:
            way = _way_from_behind(bundle, i, camera, around)
            bundle[_WAY + i] = way
        ways |= 1 << max(way, _UNSURE)
    return ways


@kernel
def _find_entries(bundle: Array, before: float, farthest: float, low: Corner, high: Corner) -> None:
    """Find the rays from object space through the front of the lens's box."""
    for i in range(BLOCK):
        x, y, z, dz = bundle[_X + i], bundle[_Y + i], bundle[_Z + i], bundle[_DZ + i]
        t = (low[2] - z) / dz
        at_x, at_y = x + t * bundle[_DX + i], y + t * bundle[_DY + i]
        enters = both(both(at_x > low[0], at_x < high[0]), both(at_y > low[1], at_y < high[1]))
        near = both(abs(x) < farthest, both(abs(y) < farthest, abs(z) < farthest))
        starts = both(both(z < before, dz > 0.0), bundle[_WAY + i] == _UNSURE)
        bundle[_WAY + i] = select(both(starts, both(enters, near)), 1.0 * _FROM_OBJECTS, bundle[_WAY + i])


@pasted
def _crosses_box(ray: Ray, limit: float, low: Corner, high: Corner) -> bool:
    """Return whether a ray may meet a box within a distance, or lies in one of its planes."""
    x, y, z, dx, dy, dz = ray
    ax, bx = (low[0] - x) / dx, (high[0] - x) / dx
    ay, by = (low[1] - y) / dy, (high[1] - y) / dy
    az, bz = (low[2] - z) / dz, (high[2] - z) / dz
    near = select(ax < bx, ax, bx)
    far = select(ax < bx, bx, ax)
    near_y, far_y = select(ay < by, ay, by), select(ay < by, by, ay)
    near_z, far_z = select(az < bz, az, bz), select(az < bz, bz, az)
    near = select(near_y > near, near_y, near)
    near = select(near_z > near, near_z, near)
    far = select(far_y < far, far_y, far)
    far = select(far_z < far, far_z, far)
    # Written so that a quotient 0/0 counts as a crossing.
    return both(not near > far, both(not far < 0.0, not near > limit))


@kernel
def _stop_at_box(bundle: Array, low: Corner, high: Corner, to_z: float) -> None:
    """Mark rays as unsure if they may meet a box before the lens, at z = `to_z`."""
    for i in range(BLOCK):
        x, y, z = bundle[_X + i], bundle[_Y + i], bundle[_Z + i]
        dx, dy, dz = bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i]
        limit = (to_z - z) / dz
        crosses = _crosses_box(Ray(x, y, z, dx, dy, dz), limit, low, high)
        stops = both(bundle[_WAY + i] == _FROM_OBJECTS, crosses)
        bundle[_WAY + i] = select(stops, 1.0 * _UNSURE, bundle[_WAY + i])


@kernel
def _way_from_behind(bundle: Array, i: int, camera: Camera, around: Surroundings) -> int:
    """Return the way of a ray that starts behind the lens."""
    x, y, z = bundle[_X + i], bundle[_Y + i], bundle[_Z + i]
    dx, dy, dz = bundle[_DX + i], bundle[_DY + i], bundle[_DZ + i]
    if not (z < around.end and x * x + y * y < around.outline * around.outline):
        return _UNSURE
    if not camera.mla.present:
        move = camera.frames[CAMERA_FRAME, SENSOR_FRAME]
        if move[2, 0] * dx + move[2, 1] * dy + move[2, 2] * dz > 0.0:
            return _ON_SENSOR
        return _TO_OBJECTS if dz < 0.0 else _UNSURE
    move, lenslets = camera.frames[CAMERA_FRAME, MLA_FRAME], camera.mla.lenslets
    at = move[2, 0] * x + move[2, 1] * y + move[2, 2] * z + move[2, 3]
    slope = move[2, 0] * dx + move[2, 1] * dy + move[2, 2] * dz
    if not (at < lenslets.top or at > lenslets.thickness - _bulge(camera.mla.back)):
        return _UNSURE
    if (at < lenslets.top) == (slope > 0.0):
        return _TO_SENSOR if dz > 0.0 else _BACK
    if (at < lenslets.top) != camera.mla.curved_to_lens:
        return _ON_SENSOR
    return _TO_OBJECTS if dz < 0.0 else _UNSURE


@inlined
def _bulge(back: Any) -> float:
    """Return the top of the other face's lenslet layer, mm; 0 if flat."""
    if back is None:
        return 0.0
    return back.lenslets.top


@kernel
def _pass_over(bundle: Array, count: int, ends: Ends) -> None:
    """Record the fate of rays that are not followed here."""
    for i in range(count):
        if bundle[_WAY + i] <= 1.0 * _UNSURE:
            ends.fate[i] = UNSURE if bundle[_WAY + i] == 1.0 * _UNSURE else REFUSED


@kernel
def _follow_way(bundle: Array, way: int, camera: Camera, route: Route, around: Surroundings, book: Array) -> None:
    """Take a block's rays of one way to its end."""
    frames = camera.frames
    _load_way(bundle, 1.0 * way)
    to_sensor = way <= _ON_SENSOR
    if way == _FROM_OBJECTS:
        follow_legs(bundle, camera, route, IN_LENS, ARRAY_AGAIN, 0, book)
    elif way == _TO_SENSOR:
        follow_legs(bundle, camera, route, IN_ARRAY, ARRAY_AGAIN, 0, book)
    elif not to_sensor:
        follow_legs(bundle, camera, route, ARRAY_AGAIN if way == _BACK else LENS_AGAIN, LENS_AGAIN + 1, 0, book)
    if way != _ON_SENSOR:
        normalise(bundle)
    if to_sensor:
        move_bundle(bundle, frames[CAMERA_FRAME, SENSOR_FRAME])
        _end_on_sensor(bundle, camera.sensor.pixel, 1.0 * camera.sensor.columns, 1.0 * camera.sensor.rows)
        move_bundle(bundle, frames[SENSOR_FRAME, WORLD_FRAME])
        return
    for n in range(len(around.boxes)):
        low, high = around.boxes[n, 0], around.boxes[n, 1]
        _doubt_at_box(bundle, (low[0], low[1], low[2]), (high[0], high[1], high[2]))
    _escape(bundle, around.plate, around.opening)
    move_bundle(bundle, frames[CAMERA_FRAME, WORLD_FRAME])


@kernel
def _load_way(bundle: Array, way: float) -> None:
    """Put the rays of one way at their starts; mark the others as ended."""
    for i in range(6 * BLOCK):
        bundle[X + i] = bundle[_X + i]
    for i in range(BLOCK):
        bundle[WEIGHT + i], bundle[LEFT_BEHIND + i], bundle[MET + i] = 1.0, 0.0, 0.0
        bundle[ENDED_ON + i] = select(bundle[_WAY + i] == way, 0.0, DROPPED)


@kernel
def _end_on_sensor(bundle: Array, pixel: float, columns: float, rows: float) -> None:
    """End the remaining rays (sensor frame) in the sensor's plane."""
    for i in range(BLOCK):
        ended = bundle[ENDED_ON + i]
        x, y, z, dz = bundle[X + i], bundle[Y + i], bundle[Z + i], bundle[DZ + i]
        arrives = both(dz > 0.0, z <= 0.0)
        t = select(arrives, -z / dz, 0.0)
        x, y = x + t * bundle[DX + i], y + t * bundle[DY + i]
        column, row = np.floor(x / pixel + 0.5 * columns), np.floor(y / pixel + 0.5 * rows)
        on = both(both(column >= 0.0, column < columns), both(row >= 0.0, row < rows))
        slot = select(arrives, select(on, ON_SENSOR + 1.0, BESIDE_SENSOR + 1.0), HOUSING + 1.0)
        live = ended == 0.0
        bundle[X + i], bundle[Y + i] = select(live, x, bundle[X + i]), select(live, y, bundle[Y + i])
        bundle[Z + i] = select(both(live, arrives), 0.0, z)
        bundle[ENDED_ON + i] = select(live, slot, ended)


@kernel
def _doubt_at_box(bundle: Array, low: Corner, high: Corner) -> None:
    """Mark rays as unsure, by `BESIDE`, if they may meet a box in object space."""
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        crosses = _crosses_box(Ray(x, y, z, dx, dy, dz), np.inf, low, high)
        doubtful = both(bundle[ENDED_ON + i] == 0.0, crosses)
        bundle[ENDED_ON + i] = select(doubtful, BESIDE, bundle[ENDED_ON + i])


@kernel
def _escape(bundle: Array, plate: float, opening: float) -> None:
    """End the rays that leave through the lens and the housing's opening."""
    for i in range(BLOCK):
        t = (plate - bundle[Z + i]) / bundle[DZ + i]
        t = select(t > 0.0, t, 0.0)
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        escapes = both(bundle[DZ + i] < 0.0, x * x + y * y < opening * opening)
        slot = select(escapes, ESCAPED + 1.0, BESIDE)
        bundle[ENDED_ON + i] = select(bundle[ENDED_ON + i] == 0.0, slot, bundle[ENDED_ON + i])


@kernel
def _keep(
    bundle: Array, count: int, way: int, reflectance: float, ends: Ends, book: Array, counts: NDArray[np.int64]
) -> None:
    """Write the ends of one way's rays, and book their energy."""
    emitted, events, sensor, left_behind = 0, 0, 0.0, 0.0
    for i in range(count):
        if bundle[_WAY + i] != 1.0 * way:
            continue
        ended = bundle[ENDED_ON + i]
        if ended == BESIDE:
            ends.fate[i] = UNSURE
            continue
        emitted += 1
        met = int(bundle[MET + i])
        events += met
        left_behind += bundle[LEFT_BEHIND + i]
        if ended == DROPPED:
            ends.fate[i] = GONE
            continue
        slot = int(ended) - 1
        weight = bundle[WEIGHT + i]
        if slot == ON_SENSOR and reflectance > 0.0:
            left_behind += weight * reflectance
            weight *= 1.0 - reflectance
            met += 1
            events += 1
        ends.fate[i] = ENDED
        ends.position[i, 0], ends.position[i, 1], ends.position[i, 2] = (
            bundle[X + i], bundle[Y + i], bundle[Z + i],
        )  # fmt: skip
        ends.direction[i, 0], ends.direction[i, 1], ends.direction[i, 2] = (
            bundle[DX + i], bundle[DY + i], bundle[DZ + i],
        )  # fmt: skip
        ends.weight[i], ends.slot[i], ends.events[i] = weight, slot, met
        if slot == ON_SENSOR:
            sensor += weight
            ends.status[i] = S_SENSOR
        else:
            book[slot] += weight
            ends.status[i] = S_ESCAPED if slot == ESCAPED else S_ABSORBED
    book[EMITTED] += emitted
    book[ON_SENSOR] += sensor
    book[UNFOLLOWED] += left_behind
    counts[EVENTS] += events
