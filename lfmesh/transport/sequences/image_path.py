"""Image path of packets, in blocks: from lens or array to the sensor or to object space.

Targets are still found by Embree. Light that leaves the image path, by reflection, total reflection or a neighbouring
lenslet, is not followed; its power is booked.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.boxes import box_entry
from lfmesh.geometry.ray import ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import at_box, end, move_packet
from lfmesh.transport.packets.book import UNFOLLOWED
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    EVENTS,
    LEFT_LENS,
    LENS,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    PLATE,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
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
    WEIGHT,
    X,
    Y,
    Z,
    load,
    move_bundle,
    normalise,
    pad,
)
from lfmesh.transport.sequences.division import take_etendue
from lfmesh.transport.sequences.follower import ARRAY_AGAIN, IN_ARRAY, IN_LENS, LENS_AGAIN, Route, follow_legs
from lfmesh.transport.sequences.kicks import draw_kick, give_keys
from lfmesh.transport.tables.tables import Camera, LensTables

Array = NDArray[np.float64]


@kernel
def follow_image_path(
    wave: NDArray[np.void], station: int, camera: Camera, route: Route, bundle: Array, numbers: NDArray[np.int64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Take a wave of packets that wait for lens or array to object space or the sensor.

    Parameters
    ----------
    wave : (n,) PACKET
    station : int
        `LENS` or `PLATE`.
    camera : Camera
    route : Route
        See `follower.image_route`.
    bundle : (ROWS · BLOCK,) float64
    numbers : (BLOCK,) int64
        Working memory.
    """
    for to_sensor in (True, False):
        count = 0
        for i in range(len(wave)):
            packet = wave[i]
            if packet.frame != CAMERA_FRAME:
                move_packet(camera.frames, packet, CAMERA_FRAME)
                if station == LENS:
                    packet.limit = _way_to_box(camera.lens, packet)
            if (packet.dz > 0.0) != to_sensor:
                continue
            if station == LENS and packet.space == 0 and not to_sensor:
                # The packet comes from object space and moves away from the lens, back into object space.
                _pass_beside(flow, packet, packet.weight)
                continue
            load(
                bundle, count, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, packet.weight
            )  # fmt: skip
            draw_kick(camera.mla.apertures, options.pixels, packet, bundle, count)
            draw_kick(camera.lens.aperture, options.pixels, packet, bundle, count)
            numbers[count] = i
            count += 1
            if count == BLOCK:
                follow_block(wave, station, to_sensor, count, camera, route, bundle, numbers, options, flow)
                count = 0
        if count > 0:
            pad(bundle, count)
            follow_block(wave, station, to_sensor, count, camera, route, bundle, numbers, options, flow)


@kernel
def follow_block(
    wave: NDArray[np.void], station: int, to_sensor: bool, count: int, camera: Camera, route: Route, bundle: Array,
    numbers: NDArray[np.int64], options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Take rays (camera frame) of one direction along the image path, and queue their packets.

    Parameters
    ----------
    wave : (n,) PACKET
        Packets before the passage.
    station : int
        As for `follow_image_path`, like `camera` and `route`.
    to_sensor : bool
    count : int
        Number of rays in the bundle.
    bundle : (ROWS · BLOCK,) float64
    numbers : (BLOCK,) int64
        Index in the wave of each ray's packet.
    """
    colour, through_lens = wave[numbers[0]].colour, station != PLATE or not to_sensor
    give_keys(camera.mla.apertures, wave, count, bundle, numbers)
    give_keys(camera.lens.aperture, wave, count, bundle, numbers)
    if not to_sensor and station == PLATE:
        follow_legs(bundle, camera, route, ARRAY_AGAIN, LENS_AGAIN, colour, flow.book)
    if through_lens:
        leg = IN_LENS if to_sensor else LENS_AGAIN
        follow_legs(bundle, camera, route, leg, leg + 1, colour, flow.book)
        if options.importance:
            take_etendue(camera.lens.interfaces, bundle, flow.book)
    if to_sensor:
        follow_legs(bundle, camera, route, IN_ARRAY, ARRAY_AGAIN, colour, flow.book)
    normalise(bundle)
    _hand_on(wave, to_sensor, count, camera.frames, bundle, numbers, options, flow)


@kernel
def _hand_on(
    wave: NDArray[np.void], to_sensor: bool, count: int, frames: Array, bundle: Array, numbers: NDArray[np.int64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Queue the packets that came through; end the others."""
    station, frame = SENSOR, CAMERA_FRAME
    if not to_sensor:
        # Moving all together is faster than one by one at the station.
        station, frame = OBJECTS, OBJECT_FRAME
        move_bundle(bundle, frames[CAMERA_FRAME, OBJECT_FRAME])
    left_behind, events = 0.0, 0
    for i in range(count):
        packet = wave[numbers[i]]
        left_behind += bundle[LEFT_BEHIND + i]
        met = int(bundle[MET + i])
        events += met
        packet.events += met
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        weight, ended = bundle[WEIGHT + i], bundle[ENDED_ON + i]
        if ended == 0.0:
            child = put(flow, station, packet, frame, x, y, z, dx, dy, dz, weight, packet.key, 0.0)
            child.last, child.facet, child.bodies = LEFT_LENS, NO_SURFACE, NO_SURFACE
        elif ended == BESIDE:
            _pass_beside(flow, packet, weight)
        elif ended != DROPPED:
            end(
                options, flow, frames, packet, frame, x, y, z, dx, dy, dz, weight, int(ended) - 1, S_ABSORBED
            )  # fmt: skip
    flow.counts[EVENTS] += events
    flow.book[UNFOLLOWED] += left_behind


@inlined
def _way_to_box(lens: LensTables, packet: Any) -> float:
    """Return the distance to the lens's box of a packet from object space with a free path."""
    t = box_entry(lens.box_low, lens.box_high, ray_of(packet))
    # Through rounding, a ray along the border may miss the box that it was found to enter.
    return t if t < np.inf else 0.0


@inlined
def _pass_beside(flow: Flow, packet: Any, weight: float) -> None:
    """Queue a packet (camera frame) that missed the lens for object space."""
    x, y, z = at_box(packet)
    child = put(
        flow, OBJECTS, packet, CAMERA_FRAME, x, y, z, packet.dx, packet.dy, packet.dz, weight, packet.key, 0.0
    )  # fmt: skip
    child.last, child.facet, child.bodies = LEFT_LENS, NO_SURFACE, NO_SURFACE
