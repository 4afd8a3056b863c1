"""The sensor: a packet ends on a pixel, or beside the sensor."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernel import kernel
from lfmesh.transport.events.crossing import deposit, end, end_here, move_packet
from lfmesh.transport.packets.book import BESIDE_SENSOR, HOUSING, ON_SENSOR
from lfmesh.transport.packets.packet import S_ABSORBED, S_SENSOR, SENSOR_FRAME, Flow, Options
from lfmesh.transport.tables.tables import SensorTables


@kernel
def onto_sensor(
    wave: NDArray[np.void], sensor: SensorTables, frames: NDArray[np.float64], options: Options, flow: Flow
) -> None:
    """End each packet of a wave in the sensor's plane; in the forward method deposit it on its pixel.

    Parameters
    ----------
    wave : (n,) PACKET
    sensor : SensorTables
    frames : (5, 5, 3, 4) float64
    options : Options
    flow : Flow
    """
    for i in range(len(wave)):
        packet = wave[i]
        move_packet(frames, packet, SENSOR_FRAME)
        x, y, z = packet.x, packet.y, packet.z
        dx, dy, dz = packet.dx, packet.dy, packet.dz
        if dz <= 0.0 or z > 0.0:
            end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)
            continue
        t = -z / dz
        x, y = x + t * dx, y + t * dy
        column = np.floor(x / sensor.pixel + 0.5 * sensor.columns)
        row = np.floor(y / sensor.pixel + 0.5 * sensor.rows)
        slot, status = ON_SENSOR, S_SENSOR
        if not (0.0 <= column < sensor.columns and 0.0 <= row < sensor.rows):
            slot, status = BESIDE_SENSOR, S_ABSORBED
        elif not options.adjoint and not options.tracing:
            deposit(options, flow, int(row) * sensor.columns + int(column), packet.colour, packet.weight)
        end(options, flow, frames, packet, SENSOR_FRAME, x, y, 0.0, dx, dy, dz, packet.weight, slot, status)
