"""Pixels of a camera without an array, as sources of ghosts: rays to where on the lens ghosts come from.

A ghost shows a pixel a pupil of its own, often small and far beside that of the image path. So the disk at the lens is
divided in cells, as seen from the axis and the pixel, and a ray goes to a cell with the chance that a coarse trace has
found ghosts to come from there, and to a uniform point of it.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernel import inlined, kernel
from lfmesh.transport.aiming.lenslet_aim import CELL_U, CELL_V, DISCRETE, PIXEL_U, PIXEL_V
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import CAMERA_FRAME, LENS, SAMPLE_SHIFT, SENSOR_FRAME, Flow, put
from lfmesh.transport.sequential.ghosts import ANGLES, GhostTables, interval_of_height
from lfmesh.transport.sources.pixel_starts import STARTS, StartRoom, begin_launch, draw_numbers
from lfmesh.transport.tables.lights import MM2
from lfmesh.transport.tables.tables import SensorTables

Array = NDArray[np.float64]


@kernel
def launch_to_cells(
    pixels: NDArray[np.int64], begin: NDArray[np.int64], taken: int, samples: int, stratified: bool,
    replicate_key: np.uint64, colour: int, sensor: SensorTables, ghosts: GhostTables, frames: Array,
    lens_surfaces: int, flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Start `taken` of the `samples` packets of each pixel.

    Parameters
    ----------
    pixels, begin, taken, samples, stratified, replicate_key, colour, lens_surfaces
        As for `pixels.launch_adjoint`.
    frames : (6, 6, 3, 4) float64
        With the sensor where it appears to be.
    """
    begin_launch(room, colour, lens_surfaces)
    area = sensor.pixel * sensor.pixel * MM2 / samples * (1.0 - sensor.reflectance)
    which, place = 0, 0
    for first in range(0, len(pixels) * taken, STARTS):
        count = min(STARTS, len(pixels) * taken - first)
        draw_numbers(room, stratified, replicate_key, pixels, begin, taken, which, place, count)
        for i in range(count):
            pixel, sample, numbers = pixels[which], begin[which] + place, room.numbers
            column, row = pixel % sensor.columns - 0.5 * sensor.columns, pixel // sensor.columns - 0.5 * sensor.rows
            x, y = (column + numbers[PIXEL_U, i]) * sensor.pixel, (row + numbers[PIXEL_V, i]) * sensor.pixel
            px, py, pz = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, x, y, 0.0)
            dx, dy, dz, density = to_cell(
                ghosts, px, py, pz, numbers[DISCRETE, i], numbers[CELL_U, i], numbers[CELL_V, i]
            )
            ux, uy, uz = move_direction(frames, CAMERA_FRAME, SENSOR_FRAME, dx, dy, dz)
            if uz < 0.0:
                weight = -uz / density * area
                flow.book[EMITTED] += weight
                packet = room.packets[i]
                packet.source = pixel | (which * samples + sample) << SAMPLE_SHIFT
                packet.key, packet.start, packet.events = room.keys[i], weight, 0
                put(flow, LENS, packet, SENSOR_FRAME, x, y, 0.0, ux, uy, uz, weight, room.keys[i], 0.0)
            place += 1
            if place == taken:
                which, place = which + 1, 0


@inlined
def to_cell(
    ghosts: GhostTables, x: float, y: float, z: float, choice: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a direction from a point of the sensor to the disk at the lens, and its density, 1/sr.

    Parameters
    ----------
    ghosts : GhostTables
    x, y, z : float, mm
        The point, camera frame, behind the disk.
    choice, u, v : float
        Random numbers, uniform in [0, 1): of the cell, and of the point in it.
    """
    until = ghosts.cells[interval_of_height(ghosts, x * x + y * y)]
    cell = min(int(np.searchsorted(until, choice, side="right")), len(until) - 1)
    before = until[cell - 1] if cell > 0 else 0.0
    chance = until[cell] - before
    # What is left of the number decides on which side of the meridian the point lies.
    side = 1.0 if choice - before < 0.5 * chance else -1.0
    radius, angle = cell // ANGLES, cell % ANGLES
    least2, most2 = ghosts.rings[radius], ghosts.rings[radius + 1]
    r = np.sqrt(least2 + u * (most2 - least2))
    least, most = np.arccos(1.0 - 2.0 * angle / ANGLES), np.arccos(max(1.0 - 2.0 * (angle + 1) / ANGLES, -1.0))
    phi = side * (least + v * (most - least)) + np.arctan2(y, x)
    size = (most2 - least2) * (most - least)
    dx, dy, dz = r * np.cos(phi) - x, r * np.sin(phi) - y, ghosts.plane_z - z
    distance2 = dx * dx + dy * dy + dz * dz
    scale = 1.0 / np.sqrt(distance2)
    # An area seen at an angle is smaller by its cosine.
    return dx * scale, dy * scale, dz * scale, chance / size * distance2 / abs(dz * scale)
