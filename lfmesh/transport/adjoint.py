"""The adjoint method's start: from a pixel through the lenslets that show it the exit pupil.

A pixel's power is the integral of radiance over its area and the directions it sees, W = ∫∫ L cos θ dω dA. The packet
carries the importance cos θ dA / density, in m² sr. Radiance over n² is what interfaces conserve up to T, so carried
importance would gain (n_i/n_t)² at every crossing; pixel and target both lie in air, the factors cancel, and are left
out throughout.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.lattice import ROW_SPACING, Lattice, cell_of, centre
from lfmesh.kernel import inlined, kernel
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.aiming import aimed
from lfmesh.transport.object_region import MM2
from lfmesh.transport.packet import (
    ARRAY_FRAME,
    CAMERA,
    CAMERA_FRAME,
    EMITTED,
    LENS,
    NO_SURFACE,
    PACKET,
    PLATE,
    SENSOR_FRAME,
    Flow,
    put,
)
from lfmesh.transport.random import derived, uniform
from lfmesh.transport.sobol import scramble, scramble_seed, step
from lfmesh.transport.tables import Aim, ArrayTables, SensorTables

Array = NDArray[np.float64]

START_DIMENSION = -64
"""A packet's starting numbers have dimensions of their own, before those of any event."""

PIXEL_U, PIXEL_V, CELL_U, CELL_V, DISCRETE, WHICH_CELL = 0, 1, 2, 3, 4, 5

STARTS = 128
"""Samples whose numbers are drawn together."""

Numbers = tuple[float, float, float, float, float, float]
"""What a path starts from, in [0, 1): place in the pixel, point of the lenslet (or pupil), which of them."""


@kernel
def start(key: np.uint64, dimension: int) -> float:
    """Return one of a packet's starting numbers."""
    return uniform(key, START_DIMENSION + dimension)


class StartRoom(NamedTuple):
    """Working memory of a launch, which draws the numbers of `STARTS` samples at a time."""

    point: NDArray[np.uint32]  # (6,) Sobol' point of the last sample, not yet scrambled
    seeds: NDArray[np.uint32]  # (6,) of its pixel's scrambling
    points: NDArray[np.uint32]  # (6, STARTS)
    scrambling: NDArray[np.uint32]  # (6, STARTS)
    numbers: Array  # (6, STARTS) what each sample starts from
    keys: NDArray[np.uint64]  # (STARTS,)
    cells: NDArray[np.int64]  # (most + 1, 2) column and row of the lenslets that show the pupil to a point
    packet: NDArray[np.void]  # (1,) PACKET


def start_room(aim: Aim) -> StartRoom:
    """Return the memory in which paths are started."""
    table = (WHICH_CELL + 1, STARTS)
    return StartRoom(
        np.zeros(table[0], np.uint32),
        np.zeros(table[0], np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table),
        np.zeros(STARTS, np.uint64),
        np.zeros(((2 * aim.search + 1) ** 2 + 1, 2), np.int64),
        np.zeros(1, PACKET),
    )


@kernel
def _draw(
    room: StartRoom, stratified: bool, replicate_key: np.uint64, pixels: NDArray[np.int64], which: int, sample: int,
    samples: int, count: int,
) -> None:  # fmt: skip
    """Draw the numbers of `count` samples from a pixel's sample on: of the pixels' own Sobol' sets, or by chance."""
    pixel_key = derived(replicate_key, pixels[which])
    for i in range(count):
        room.keys[i] = derived(pixel_key, sample)
        if stratified:
            if sample == 0:
                for dimension in range(len(room.seeds)):
                    room.point[dimension] = np.uint32(0)
                    room.seeds[dimension] = scramble_seed(pixel_key, dimension)
            else:
                step(room.point, sample)
            for dimension in range(len(room.seeds)):
                room.points[dimension, i], room.scrambling[dimension, i] = room.point[dimension], room.seeds[dimension]
        else:
            for dimension in range(len(room.seeds)):
                room.numbers[dimension, i] = start(room.keys[i], dimension)
        sample += 1
        if sample == samples:
            which, sample = which + 1, 0
            # After the last pixel of the run none is drawn for; the first stands in.
            pixel_key = derived(replicate_key, pixels[which % len(pixels)])
    if stratified:
        for dimension in range(len(room.seeds)):
            scramble(room.points[dimension], room.scrambling[dimension], room.numbers[dimension])


@kernel
def launch_adjoint(
    pixels: NDArray[np.int64], samples: int, stratified: bool, replicate_key: np.uint64, wave: int,
    sensor: SensorTables, array: ArrayTables, aim: Aim, frames: Array, lens_surfaces: int,
    flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Start `samples` packets from each of some pixels.

    Parameters
    ----------
    pixels : (n,) int64
        Their numbers, row by row.
    stratified : bool
        Start from scrambled Sobol' points in place of random ones.
    """
    packet = room.packet[0]
    packet.wave = wave
    packet.last = NO_SURFACE
    packet.column = NO_SURFACE
    packet.facet = NO_SURFACE
    packet.kind = CAMERA
    packet.events = 0
    packet.space = lens_surfaces
    area = sensor.pixel * sensor.pixel * MM2 / samples
    station = PLATE if array.present else LENS
    # The sensor's normal towards the array.
    normal = move_direction(frames, SENSOR_FRAME, ARRAY_FRAME, 0.0, 0.0, -1.0)
    which, sample = 0, 0
    for first in range(0, len(pixels) * samples, STARTS):
        count = min(STARTS, len(pixels) * samples - first)
        _draw(room, stratified, replicate_key, pixels, which, sample, samples, count)
        for i in range(count):
            pixel = pixels[which]
            row, column = pixel // sensor.columns, pixel % sensor.columns
            packet.source = pixel
            sample += 1
            if sample == samples:
                which, sample = which + 1, 0
            numbers = (
                room.numbers[PIXEL_U, i], room.numbers[PIXEL_V, i], room.numbers[CELL_U, i],
                room.numbers[CELL_V, i], room.numbers[DISCRETE, i], room.numbers[WHICH_CELL, i],
            )  # fmt: skip
            x = (column - 0.5 * sensor.columns + numbers[PIXEL_U]) * sensor.pixel
            y = (row - 0.5 * sensor.rows + numbers[PIXEL_V]) * sensor.pixel
            if array.present:
                px, py, pz = move_point(frames, SENSOR_FRAME, ARRAY_FRAME, x, y, 0.0)
                dx, dy, dz, importance = _through_a_lenslet(array, aim, normal, room.cells, numbers, px, py, pz)
                ux, uy, uz = move_direction(frames, ARRAY_FRAME, SENSOR_FRAME, dx, dy, dz)
            else:
                # The pupil disks are square to the axis of the lens, whichever way the sensor is tilted.
                px, py, pz = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, x, y, 0.0)
                dx, dy, dz, density = aimed(
                    px, py, pz, aim.exit, aim.back_radius, aim.wide_share, aim.blind_share,
                    numbers[DISCRETE], numbers[CELL_U], numbers[CELL_V],
                )  # fmt: skip
                ux, uy, uz = move_direction(frames, CAMERA_FRAME, SENSOR_FRAME, dx, dy, dz)
                importance = -uz / density if density > 0.0 else 0.0
            if importance <= 0.0:
                continue
            weight = area * importance
            packet.start = weight
            flow.book[EMITTED] += weight
            put(flow, station, packet, SENSOR_FRAME, x, y, 0.0, ux, uy, uz, weight, room.keys[i], 0.0)


@inlined
def _cells_that_show_pupil(
    array: ArrayTables, aim: Aim, x: float, y: float, distance: float, cells: NDArray[np.int64]
) -> int:
    """List the lenslets that show (part of) the lens's opening to a point of the sensor; return how many."""
    lattice = array.lenslets.lattice
    kappa, over = aim.pupil_vergence, 1.0 / distance
    total = kappa + over
    # Where the chief ray meets the array.
    column, row = cell_of(lattice, (kappa * aim.pupil_x + over * x) / total, (kappa * aim.pupil_y + over * y) / total)
    count = 0
    for r in range(max(row - aim.search, 0), min(row + aim.search + 1, lattice.rows)):
        for c in range(max(column - aim.search, 0), min(column + aim.search + 1, lattice.columns)):
            cx, cy = centre(lattice, c, r)
            cell = r * lattice.columns + c
            a, b = (cx - x) * over - aim.slope[cell, 0], (cy - y) * over - aim.slope[cell, 1]
            # Without a branch, which would be guessed wrong every other time.
            cells[count, 0], cells[count, 1] = c, r
            count += a * a + b * b <= aim.slope_radius2[cell]
    return count


@inlined
def _through_a_lenslet(
    array: ArrayTables, aim: Aim, normal: tuple[float, float, float], cells: NDArray[np.int64], numbers: Numbers,
    x: float, y: float, z: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction (array frame) from a point of the sensor, and cos θ over its density.

    Uniform over the cells that show the pupil to the point, mixed with a few directions from the whole hemisphere, for
    ghosts, stray light and what the measured opening leaves out; a point to which no cell shows the opening sends only
    those. The cells are aimed at where the sensor sees their apexes, through
    the plate; their faces lie deeper at the border, so the aimed cells are a margin larger.
    """
    lattice = array.lenslets.lattice
    nx, ny, nz = normal
    distance = abs(z - aim.lenslet_z)
    toward = -1.0 if array.curved_to_lens else 1.0
    count = _cells_that_show_pupil(array, aim, x, y, distance, cells)
    wide = aim.blind_share if count == 0 else aim.wide_share
    size = lattice.pitch + 2.0 * aim.cell_margin
    if numbers[DISCRETE] < wide:
        dx, dy, dz = lambertian(nx, ny, nz, numbers[CELL_U], numbers[CELL_V])
    elif count == 0:
        return 0.0, 0.0, 0.0, 0.0
    else:
        chosen = min(int(numbers[WHICH_CELL] * count), count - 1)
        cx, cy = centre(lattice, cells[chosen, 0], cells[chosen, 1])
        u, v = _point_of_cell(lattice.hexagonal, numbers[CELL_U], numbers[CELL_V])
        dx, dy, dz = cx + u * size - x, cy + v * size - y, toward * distance
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * scale, dy * scale, dz * scale
    cos_theta = nx * dx + ny * dy + nz * dz
    density = wide * cos_theta / np.pi
    if count > 0 and dz * toward > 0.0:
        # Every aimed cell, with its margin, that holds the direction could have drawn it.
        t = distance / (dz * toward)
        px, py = x + t * dx, y + t * dy
        drawn = 0
        for cell in range(count):
            cx, cy = centre(lattice, cells[cell, 0], cells[cell, 1])
            if _in_cell(lattice, px - cx, py - cy, aim.cell_margin):
                drawn += 1
        area = size * size * (ROW_SPACING if lattice.hexagonal else 1.0)
        cos_array = abs(dz)
        density += (1.0 - wide) * drawn * distance * distance / (count * area * cos_array * cos_array * cos_array)
    return dx, dy, dz, cos_theta / density


@kernel
def _in_cell(lattice: Lattice, x: float, y: float, margin: float) -> bool:
    """Tell whether a point lies in the cell at the origin, its sides moved out by a margin."""
    half = 0.5 * lattice.pitch + margin
    if not lattice.hexagonal:
        return abs(x) <= half and abs(y) <= half
    across = ROW_SPACING * abs(y)
    return abs(x) <= half and 0.5 * abs(x) + across <= half


@kernel
def _point_of_cell(hexagonal: bool, u: float, v: float) -> tuple[float, float]:
    """Return a uniform point of the cell at the origin, in pitches."""
    if not hexagonal:
        return u - 0.5, v - 0.5
    # Three rhombi make the hexagon, each spanned by two radii to corners.
    third = int(3.0 * u)
    u = 3.0 * u - third
    turn = 2.0943951023931953 * third + 0.5235987755982988
    ax, ay = np.cos(turn), np.sin(turn)
    bx, by = np.cos(turn + 2.0943951023931953), np.sin(turn + 2.0943951023931953)
    return (u * ax + v * bx) * 0.5773502691896258, (u * ay + v * by) * 0.5773502691896258
