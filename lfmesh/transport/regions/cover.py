"""The sensor's cover glass: a plate parallel to the sensor with two faces that divide every packet.

Sensor frame: the pixels lie at z = 0 and light arrives with dz > 0, so the plate's front face lies at
z = -(gap + thickness) and its rear face at z = -gap. Packets wait at the sensor's station in front of the plate, in it
and behind it; height and direction give the next of the three planes. In the adjoint method they also start here.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import end_here, move_packet, refracted, thinned, too_deep
from lfmesh.transport.events.interface import divided, splitter
from lfmesh.transport.events.travel import travel
from lfmesh.transport.packets.book import HOUSING, UNFOLLOWED
from lfmesh.transport.packets.packet import (
    BY_ORDER,
    COVER_FRONT,
    COVER_REAR,
    EVENTS,
    LENS,
    NO_SURFACE,
    PLATE,
    S_ABSORBED,
    SENSOR,
    SENSOR_FRAME,
    Flow,
    Options,
    count_event,
    put,
)
from lfmesh.transport.paths.automaton import cutoff_at_child
from lfmesh.transport.regions.sensor import onto_pixel
from lfmesh.transport.tables.cover import FRONT_ROW, REAR_ROW, CoverTables
from lfmesh.transport.tables.tables import AIR, SensorTables

Array = NDArray[np.float64]


@kernel
def through_cover(
    wave: NDArray[np.void], sensor: SensorTables, cover: CoverTables, has_mla: bool, lens_surfaces: int, frames: Array,
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Move packets to the next face of the cover and divide them there, to a pixel, or to the array.

    Parameters
    ----------
    wave : (n,) PACKET
    sensor : SensorTables
    cover : CoverTables
    has_mla : bool
    lens_surfaces : int
        Refracting surfaces of the lens.
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    outside = PLATE if has_mla else LENS
    for i in range(len(wave)):
        packet = wave[i]
        move_packet(frames, packet, SENSOR_FRAME)
        z, down = packet.z, packet.dz > 0.0
        if packet.dz == 0.0:
            end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
        elif down and z >= cover.rear_z:
            onto_pixel(packet, sensor, SENSOR, lens_surfaces, frames, options, flow)
        elif not down and z <= cover.front_z:
            # It comes from the lens or the array and, as the sensor is tilted, misses the cover's plane.
            end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
        elif not too_deep(options, flow, frames, packet):
            at_front = z < cover.front_z if down else z <= cover.rear_z
            _meet_face(packet, at_front, cover, outside, lens_surfaces, frames, options, flow)


@inlined
def _leave(
    flow: Flow, packet: Any, outside: int, lens_surfaces: int, z: float, x: float, y: float,
    dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a packet that leaves the front of the cover, like a packet from a pixel without a cover."""
    child = put(flow, outside, packet, SENSOR_FRAME, x, y, z, dx, dy, dz, weight, key, 0.0)
    child.space, child.last, child.facet, child.column = lens_surfaces, NO_SURFACE, NO_SURFACE, NO_SURFACE


@inlined
def _send_from_face(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at a face of the cover."""
    at_front, outside, lens_surfaces = place
    cutoff = cutoff_at_child(options, False, refracts, packet)
    if cutoff > 0.0:
        weight = thinned(cutoff, flow.book, packet, weight, key)
        if weight == 0.0:
            return
    if at_front and dz < 0.0:
        _leave(flow, packet, outside, lens_surfaces, z, x, y, dx, dy, dz, weight, key)
    else:
        put(flow, SENSOR, packet, SENSOR_FRAME, x, y, z, dx, dy, dz, weight, key, 0.0)


_split_at_face = splitter(_send_from_face)


@inlined
def _meet_face(
    packet: Any, at_front: bool, cover: CoverTables, outside: int, lens_surfaces: int, frames: Array,
    options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Divide a packet at the next face of the cover."""
    down = packet.dz > 0.0
    entering = at_front == down
    sense = 1.0 if down else -1.0
    z = cover.front_z if at_front else cover.rear_z
    x, y, _ = travel(flow, cover.media, packet, AIR if entering else cover.medium, (z - packet.z) / packet.dz)
    glass, around = cover.media.indices[cover.medium, packet.colour], cover.media.indices[AIR, packet.colour]
    n_i, n_t = (around, glass) if entering else (glass, around)
    cos_i = min(abs(packet.dz), 1.0)
    number = FRONT_ROW if at_front else REAR_ROW
    reflectance, transmittance, cos_t = divided(
        cover.interfaces, number, packet.colour, n_i, n_t, cos_i, not entering, packet, flow.book
    )
    bent = refracted(packet.dx, packet.dy, packet.dz, 0.0, 0.0, sense, n_i / n_t, cos_i, cos_t)
    place = (at_front, outside, lens_surfaces)
    if options.faces == BY_ORDER:
        # Only light that both faces transmit is on the image path.
        flow.counts[EVENTS] += 1
        count_event(packet)
        flow.book[UNFOLLOWED] += packet.weight * reflectance
        if transmittance > 0.0:
            weight = packet.weight * transmittance
            _send_from_face(
                place, options, flow, frames, packet, True, x, y, z, bent[0], bent[1], bent[2], weight, packet.key
            )
        return
    surface = COVER_FRONT if at_front else COVER_REAR
    _split_at_face(
        place, options, flow, frames, SENSOR_FRAME, packet, surface, NO_SURFACE, cover.medium if entering else AIR,
        x, y, z, reflectance, transmittance, (packet.dx, packet.dy, -packet.dz), bent,
    )  # fmt: skip
