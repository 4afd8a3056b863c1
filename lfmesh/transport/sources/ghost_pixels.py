"""Pixels of a camera without an array, as sources of ghosts: rays to where on the lens ghosts come from.

A ghost shows a pixel a pupil of its own, often small and far beside that of the image path. So the disk at the lens is
divided in cells, as seen from the axis and the pixel, and a ray goes to a cell with the chance that a coarse trace has
found ghosts to come from there, and to a uniform point of it. Other rays go to the opening of the image path.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import drawn_by
from lfmesh.transport.aiming.lenslet_aim import CELL_U, CELL_V, DISCRETE, PIXEL_U, PIXEL_V
from lfmesh.transport.aiming.mixture import disk_density, toward_disk
from lfmesh.transport.aiming.pupil import opening_from
from lfmesh.transport.packets.book import EMITTED
from lfmesh.transport.packets.packet import CAMERA_FRAME, LENS, SAMPLE_SHIFT, SENSOR_FRAME, Flow, put
from lfmesh.transport.sequences.ghosts import (
    ANGLES,
    GhostTables,
    interval_of_angle,
    interval_of_height,
    interval_of_radius,
)
from lfmesh.transport.sources.pixel_starts import STARTS, StartRoom, begin_launch, draw_numbers
from lfmesh.transport.sources.wavelengths import Entries
from lfmesh.transport.tables.pixel import area_of_sample
from lfmesh.transport.tables.tables import Opening, SensorTables

Array = NDArray[np.float64]

SHARE_OF_OPENING = 0.5
"""Share of the rays to the opening, from a point that sees it."""


@kernel
def launch_to_cells(
    entries: Entries, samples: int, stratified: bool, replicate_key: np.uint64, colour: int, sensor: SensorTables,
    opening: Opening, ghosts: GhostTables, frames: Array, lens_surfaces: int, flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Start packets of pixels at one wavelength.

    Parameters
    ----------
    entries, samples, stratified, replicate_key, colour, lens_surfaces
        As for `pixels.launch_adjoint`.
    opening : Opening
        As seen from the sensor.
    frames : (6, 6, 3, 4) float64
        With the sensor where it appears to be.
    """
    begin_launch(room, colour, lens_surfaces)
    area = area_of_sample(sensor, samples)
    which, place = 0, 0
    total = entries.taken.sum()
    for first in range(0, total, STARTS):
        count = min(STARTS, total - first)
        draw_numbers(room, stratified, replicate_key, entries, which, place, count)
        for i in range(count):
            pixel, sample, numbers = entries.pixel[which], entries.begin[which] + place, room.numbers
            column, row = pixel % sensor.columns - 0.5 * sensor.columns, pixel // sensor.columns - 0.5 * sensor.rows
            x, y = (column + numbers[PIXEL_U, i]) * sensor.pixel, (row + numbers[PIXEL_V, i]) * sensor.pixel
            px, py, pz = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, x, y, 0.0)
            dx, dy, dz, density = toward_ghosts(
                opening, ghosts, px, py, pz, numbers[DISCRETE, i], numbers[CELL_U, i], numbers[CELL_V, i]
            )
            ux, uy, uz = move_direction(frames, CAMERA_FRAME, SENSOR_FRAME, dx, dy, dz)
            if uz < 0.0 and density > 0.0:
                weight = -uz / density * area
                flow.book[EMITTED] += weight
                packet = room.packets[i]
                packet.source = pixel | (entries.place[which] * samples + sample) << SAMPLE_SHIFT
                packet.key, packet.start, packet.events = room.keys[i], weight, 0
                put(flow, LENS, packet, SENSOR_FRAME, x, y, 0.0, ux, uy, uz, weight, room.keys[i], 0.0)
            place += 1
            if place == entries.taken[which]:
                which, place = which + 1, 0


@inlined
def toward_ghosts(
    opening: Opening, ghosts: GhostTables, x: float, y: float, z: float, choice: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a direction from a point of the sensor to the disk at the lens, and its density, 1/sr.

    A share of the rays goes to the lens's opening, through which many ghosts come. A small one the coarse trace may
    have met by chance alone.

    Parameters
    ----------
    opening : Opening
        As seen from the sensor.
    ghosts : GhostTables
    x, y, z : float, mm
        The point, camera frame, behind the disk.
    choice, u, v : float
        Random numbers, uniform in [0, 1): of where it goes, and of the point there.
    """
    cx, cy, radius = opening_from(opening, x, y, z)
    share = SHARE_OF_OPENING if opening.known and radius > 0.0 else 0.0
    if choice < share:
        dx, dy, dz = toward_disk(x, y, z, cx, cy, opening.plane_z, radius, u, v)
    else:
        dx, dy, dz = _to_cell(ghosts, x, y, z, (choice - share) / (1.0 - share), u, v)
    density = (1.0 - share) * _cell_density(ghosts, x, y, z, dx, dy, dz)
    if share > 0.0:
        density += share * disk_density(x, y, z, dx, dy, dz, cx, cy, opening.plane_z, radius)
    return dx, dy, dz, density


@inlined
def _to_cell(
    ghosts: GhostTables, x: float, y: float, z: float, choice: float, u: float, v: float
) -> tuple[float, float, float]:
    """Return a direction from a point to a uniform point of a cell at the lens, drawn by its chance."""
    until = ghosts.cells[interval_of_height(ghosts, x * x + y * y)]
    cell = drawn_by(until, choice)
    before = until[cell - 1] if cell > 0 else 0.0
    # What is left of the number decides on which side of the meridian the point lies.
    side = 1.0 if choice - before < 0.5 * (until[cell] - before) else -1.0
    ring, angle = cell // ANGLES, cell % ANGLES
    r = np.sqrt(ghosts.rings[ring] + u * (ghosts.rings[ring + 1] - ghosts.rings[ring]))
    phi = side * (_border(angle) + v * (_border(angle + 1) - _border(angle))) + np.arctan2(y, x)
    dx, dy, dz = r * np.cos(phi) - x, r * np.sin(phi) - y, ghosts.plane_z - z
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@inlined
def _cell_density(
    ghosts: GhostTables, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> float:  # fmt: skip
    """Return the density, 1/sr, with which `_to_cell` draws a direction from a point."""
    if not dz < 0.0:
        return 0.0
    t = (ghosts.plane_z - z) / dz
    px, py = x + t * dx, y + t * dy
    r2 = px * px + py * py
    if r2 > ghosts.rings[-1]:
        return 0.0
    ring = interval_of_radius(ghosts, r2)
    angle = interval_of_angle(x * px + y * py, np.sqrt(r2 * (x * x + y * y)))
    until = ghosts.cells[interval_of_height(ghosts, x * x + y * y)]
    cell = ring * ANGLES + angle
    chance = until[cell] - (until[cell - 1] if cell > 0 else 0.0)
    size = (ghosts.rings[ring + 1] - ghosts.rings[ring]) * (_border(angle + 1) - _border(angle))
    return chance / size * t * t / abs(dz)


@inlined
def _border(interval: int) -> float:
    """Return the angle, rad, at which an interval of angles begins."""
    return np.arccos(max(1.0 - 2.0 * interval / ANGLES, -1.0))
