"""The sensor: packets end on a pixel or beside the sensor, and reflected light goes on."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import (
    deposit,
    end,
    end_here,
    move_packet,
    record,
    split_shares,
    thinned,
    too_deep,
)
from lfmesh.transport.events.exposure import share_of_time
from lfmesh.transport.events.moving import begin
from lfmesh.transport.events.polarisation import through_polariser
from lfmesh.transport.packets.book import (
    BESIDE_SENSOR,
    HOUSING,
    ON_SENSOR,
    SAMPLING_ADDED,
    SAMPLING_REMOVED,
    UNFOLLOWED,
)
from lfmesh.transport.packets.packet import (
    BY_ORDER,
    E_REFLECTED,
    ENDS_AT,
    EVENTS,
    LAMP,
    LENS,
    NO_SURFACE,
    PLATE,
    S_ABSORBED,
    S_SENSOR,
    SENSOR_FRAME,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.packets.random import derived
from lfmesh.transport.paths.automaton import OFF_FACE, cutoff_at_child
from lfmesh.transport.tables.tables import SensorTables

NO_PIXEL, NOWHERE = -1, -2
"""Placeholders for a pixel's number: beside the sensor; the ray does not meet the sensor's plane."""


@kernel
def onto_sensor(
    wave: NDArray[np.void], sensor: SensorTables, frames: NDArray[np.float64], options: Options, flow: Flow
) -> None:
    """End each packet of a wave in the sensor's plane; in the forward method deposit it on its pixel.

    Parameters
    ----------
    wave : (n,) PACKET
    sensor : SensorTables
        Without reflection.
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    for i in range(len(wave)):
        packet = wave[i]
        move_packet(frames, packet, SENSOR_FRAME)
        pixel, x, y = _pixel_met(packet, sensor)
        if pixel != NOWHERE:
            packet.weight = through_polariser(flow.polarised, packet, packet.weight, SENSOR_FRAME, frames, flow.book)
        _end_on(pixel, x, y, packet.weight, packet, sensor, frames, options, flow)


@kernel
def onto_reflecting_sensor(
    wave: NDArray[np.void], sensor: SensorTables, has_mla: bool, lens_surfaces: int, frames: NDArray[np.float64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """End packets as `onto_sensor` does with the detected share, and send back the reflected share.

    Parameters
    ----------
    wave : (n,) PACKET
    sensor : SensorTables
    has_mla : bool
    lens_surfaces : int
        Refracting surfaces of the lens.
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    station = PLATE if has_mla else LENS
    for i in range(len(wave)):
        packet = wave[i]
        move_packet(frames, packet, SENSOR_FRAME)
        onto_pixel(packet, sensor, station, lens_surfaces, frames, options, flow)


@inlined
def onto_pixel(
    packet: Any, sensor: SensorTables, station: int, lens_surfaces: int, frames: NDArray[np.float64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """End a packet (sensor frame) on the sensor with its detected share, and send back the reflected share.

    Parameters
    ----------
    packet : PACKET
    sensor : SensorTables
    station : int
        Station of the reflected packet.
    lens_surfaces : int
    """
    pixel, x, y = _pixel_met(packet, sensor)
    if pixel < 0 or sensor.reflectance == 0.0:
        _end_on(pixel, x, y, packet.weight, packet, sensor, frames, options, flow)
        return
    if too_deep(options, flow, frames, packet):
        return
    flow.counts[EVENTS] += 1
    if options.faces == BY_ORDER:
        # The image path ends here.
        reflected, detected = 0.0, packet.weight * (1.0 - sensor.reflectance)
        flow.book[UNFOLLOWED] += packet.weight * sensor.reflectance
    else:
        reflected, detected = split_shares(options, flow.book, packet, sensor.reflectance, 1.0 - sensor.reflectance)
    count_event(packet)
    if detected > 0.0:
        _end_on(pixel, x, y, detected, packet, sensor, frames, options, flow)
    if reflected > 0.0:
        if options.record:
            packet.node = record(
                flow, frames, SENSOR_FRAME, x, y, 0.0, reflected, ENDS_AT + ON_SENSOR, NO_SURFACE, E_REFLECTED,
                packet.node,
            )  # fmt: skip
        # It goes on as packets start at a pixel, but off the image path.
        packet.path = OFF_FACE[packet.path]
        key = derived(packet.key, packet.events)
        cutoff = cutoff_at_child(options, False, False, packet)
        if cutoff > 0.0:
            reflected = thinned(cutoff, flow.book, packet, reflected, key)
            if reflected == 0.0:
                return
        child = put(
            flow, station, packet, SENSOR_FRAME, x, y, 0.0, packet.dx, packet.dy, -packet.dz, reflected, key, 0.0
        )  # fmt: skip
        child.space = lens_surfaces
        child.last, child.facet, child.column = NO_SURFACE, NO_SURFACE, NO_SURFACE


@inlined
def _pixel_met(packet: Any, sensor: SensorTables) -> tuple[int, float, float]:
    """Return the pixel that a packet (sensor frame) meets, row by row, or the reason for none, and its end, mm."""
    x, y, z = packet.x, packet.y, packet.z
    if packet.dz <= 0.0 or z > 0.0:
        return NOWHERE, x, y
    t = -z / packet.dz
    x, y = x + t * packet.dx, y + t * packet.dy
    column = np.floor(x / sensor.pixel + 0.5 * sensor.columns)
    row = np.floor(y / sensor.pixel + 0.5 * sensor.rows)
    if not (0.0 <= column < sensor.columns and 0.0 <= row < sensor.rows):
        return NO_PIXEL, x, y
    return int(row) * sensor.columns + int(column), x, y


@inlined
def _end_on(
    pixel: int, x: float, y: float, weight: float, packet: Any, sensor: SensorTables, frames: NDArray[np.float64],
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """End a packet on a pixel, beside the sensor or, if it misses the sensor's plane, at its present place."""
    if pixel == NOWHERE:
        end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
        return
    if packet.kind == LAMP:
        # The unscattered image of a lamp is in no class of paths.
        flow.book[SAMPLING_REMOVED] += weight
        return
    slot, status = (ON_SENSOR, S_SENSOR) if pixel >= 0 else (BESIDE_SENSOR, S_ABSORBED)
    if pixel >= 0 and not options.adjoint and not options.tracing:
        weight, is_seen = _seen_by_row(flow.moving, options, flow.book, packet, pixel // sensor.columns, weight)
        if not is_seen:
            return
        deposit(options, flow, pixel, packet.colour, weight)
    end(options, flow, frames, packet, SENSOR_FRAME, x, y, 0.0, packet.dx, packet.dy, packet.dz, weight, slot, status)


@inlined
def _seen_by_row(
    moving: Any, options: Options, book: NDArray[np.float64], packet: Any, row: int, weight: float
) -> tuple[float, bool]:  # fmt: skip
    """Return the weight of a packet in the mean over the window of a row of pixels, and whether the window sees it.

    `moving` is None in a scene without motion; numba then compiles only the first line.
    """
    if moving is None:
        return weight, True
    begin(moving, options, packet)
    seen = weight * share_of_time(moving.motions, row, moving.time_s[0])
    book[SAMPLING_ADDED] += max(seen - weight, 0.0)
    book[SAMPLING_REMOVED] += max(weight - seen, 0.0)
    return seen, seen > 0.0
