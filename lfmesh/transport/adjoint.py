"""The adjoint method's start: from a pixel through the lenslets that show it the exit pupil.

A pixel's power is the integral of radiance over its area and the directions it sees, W = ∫∫ L cos θ dω dA. The packet
carries the importance cos θ dA / density, in m² sr. Radiance over n² is what interfaces conserve up to T, so carried
importance would gain (n_i/n_t)² at every crossing; pixel and light both lie in air, the factors cancel, and are left
out throughout. A target that shines inside glass has its radiance divided by n² instead.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.geometry.lattice import ROW_SPACING, Lattice, cell_of, centre, half_hexagon
from lfmesh.kernel import inlined, kernel, pasted
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.aiming import aimed
from lfmesh.transport.bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    WEIGHT,
    X,
    Y,
    Z,
    load,
    move_bundle,
    pad,
)
from lfmesh.transport.image_path import follow_block
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
    Options,
    put,
)
from lfmesh.transport.random import derived, uniform
from lfmesh.transport.sobol import scramble, scramble_seed, step
from lfmesh.transport.tables import Aim, ArrayTables, LensTables, SensorTables

Array = NDArray[np.float64]

START_DIMENSION = -64
"""A packet's starting numbers have dimensions of their own, before those of any event."""

CELL_U, CELL_V, PIXEL_U, PIXEL_V, WHICH_CELL, DISCRETE = 0, 1, 2, 3, 4, 5
"""The point of the lenslet gets the evenest: what is sharp in the scene is sharp there, where the image is in focus."""

STARTS = BLOCK
"""Samples whose numbers are drawn together: a bundle of the sequential engine."""

HALF_DIAGONAL = 0.72
"""Of a pixel, with a margin, in its width: how far from its middle a path may start."""

SURE, MARGIN_SHARE = 0.95, 0.05
"""Within this part of a lenslet's view it surely shows the opening; share of the rays to what may show it."""

_CORNERS = (
    (0.5, 0.5 / np.sqrt(3.0)),
    (-0.5, 0.5 / np.sqrt(3.0)),
    (0.0, -1.0 / np.sqrt(3.0)),
    (0.5, 0.5 / np.sqrt(3.0)),
)
"""Every other corner of a hexagon one wide, and the first again."""

Numbers = tuple[float, float, float, float, float, float]
"""What a path starts from, in [0, 1): point of the lenslet (or pupil), place in the pixel, which lenslet, what else."""


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
    near: Array  # (most + 1, 5) lenslets that may show the lens's opening to some point of a pixel, see `_list_cells`
    cells: NDArray[np.int64]  # (3, most + 1) those that may show it to the point, whether they surely do, which do
    packets: NDArray[np.void]  # (STARTS,) PACKET


def start_room(aim: Aim) -> StartRoom:
    """Return the memory in which paths are started."""
    table = (DISCRETE + 1, STARTS)
    most = (2 * aim.search + 1) ** 2
    return StartRoom(
        np.zeros(table[0], np.uint32),
        np.zeros(table[0], np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table, np.uint32),
        np.zeros(table),
        np.zeros(STARTS, np.uint64),
        np.zeros((most + 1, 5)),
        np.zeros((3, most + 1), np.int64),
        np.zeros(STARTS, PACKET),
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
    bundle: Array, flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Start `samples` packets from each of some pixels.

    Parameters
    ----------
    pixels : (n,) int64
        Their numbers, row by row.
    stratified : bool
        Start from scrambled Sobol' points in place of random ones.
    """
    _begin(room, wave, lens_surfaces)
    station = PLATE if array.present else LENS
    which, sample = 0, 0
    for first in range(0, len(pixels) * samples, STARTS):
        count = min(STARTS, len(pixels) * samples - first)
        _draw(room, stratified, replicate_key, pixels, which, sample, samples, count)
        which, sample = _aim(room, bundle, pixels, which, sample, samples, count, sensor, array, aim, frames, flow.book)
        for i in range(count):
            if bundle[ENDED_ON + i] == 0.0:
                put(
                    flow, station, room.packets[i], SENSOR_FRAME, bundle[X + i], bundle[Y + i], bundle[Z + i],
                    bundle[DX + i], bundle[DY + i], bundle[DZ + i], bundle[WEIGHT + i], room.keys[i], 0.0,
                )  # fmt: skip


@kernel
def launch_along_image_path(
    pixels: NDArray[np.int64], samples: int, stratified: bool, replicate_key: np.uint64, wave: int,
    sensor: SensorTables, lens: LensTables, array: ArrayTables, aim: Aim, frames: Array,
    bundle: Array, numbers: NDArray[np.int64], options: Options, flow: Flow, room: StartRoom,
) -> None:  # fmt: skip
    """Do as `launch_adjoint` does, and take the packets through array and lens while they are at hand.

    Parameters
    ----------
    bundle, numbers
        Working memory of `image_path`.
    """
    _begin(room, wave, len(lens.surfaces))
    station = PLATE if array.present else LENS
    for i in range(STARTS):
        numbers[i] = i
    which, sample = 0, 0
    for first in range(0, len(pixels) * samples, STARTS):
        count = min(STARTS, len(pixels) * samples - first)
        _draw(room, stratified, replicate_key, pixels, which, sample, samples, count)
        which, sample = _aim(room, bundle, pixels, which, sample, samples, count, sensor, array, aim, frames, flow.book)
        pad(bundle, count)
        move_bundle(bundle, frames[SENSOR_FRAME, CAMERA_FRAME])
        follow_block(room.packets, station, False, count, lens, array, frames, bundle, numbers, options, flow)


@kernel
def _begin(room: StartRoom, wave: int, lens_surfaces: int) -> None:
    """Fill in what all packets of a launch have in common."""
    for i in range(STARTS):
        packet = room.packets[i]
        packet.wave = wave
        packet.last = NO_SURFACE
        packet.column = NO_SURFACE
        packet.facet = NO_SURFACE
        packet.node = NO_SURFACE
        packet.kind = CAMERA
        packet.space = lens_surfaces


@kernel
def _aim(
    room: StartRoom, bundle: Array, pixels: NDArray[np.int64], which: int, sample: int, samples: int, count: int,
    sensor: SensorTables, array: ArrayTables, aim: Aim, frames: Array, book: Array,
) -> tuple[int, int]:  # fmt: skip
    """Leave a block of rays (sensor frame) and their weights in the bundle, from the numbers that were drawn.

    Returns
    -------
    which, sample : int
        Pixel of the run, and its sample, with which the next block begins.
    """
    area = sensor.pixel * sensor.pixel * MM2 / samples
    # The sensor's normal towards the array.
    normal = move_direction(frames, SENSOR_FRAME, ARRAY_FRAME, 0.0, 0.0, -1.0)
    near, begun = 0, -1
    column, row = 0.0, 0.0
    for i in range(count):
        pixel = pixels[which]
        if which != begun:
            begun = which
            column, row = pixel % sensor.columns - 0.5 * sensor.columns, pixel // sensor.columns - 0.5 * sensor.rows
            if array.present:
                x, y = (column + 0.5) * sensor.pixel, (row + 0.5) * sensor.pixel
                px, py, pz = move_point(frames, SENSOR_FRAME, ARRAY_FRAME, x, y, 0.0)
                near = _list_cells(array, aim, px, py, pz, HALF_DIAGONAL * sensor.pixel, room.near)
        numbers = (
            room.numbers[CELL_U, i], room.numbers[CELL_V, i], room.numbers[PIXEL_U, i],
            room.numbers[PIXEL_V, i], room.numbers[WHICH_CELL, i], room.numbers[DISCRETE, i],
        )  # fmt: skip
        x, y = (column + numbers[PIXEL_U]) * sensor.pixel, (row + numbers[PIXEL_V]) * sensor.pixel
        if array.present:
            px, py, pz = move_point(frames, SENSOR_FRAME, ARRAY_FRAME, x, y, 0.0)
            dx, dy, dz, importance = _through_a_lenslet(
                array, aim, normal, room.near, near, room.cells, numbers, px, py, pz
            )  # fmt: skip
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
        weight = area * max(importance, 0.0)
        load(bundle, i, x, y, 0.0, ux, uy, uz, weight)
        if weight == 0.0:
            bundle[ENDED_ON + i] = DROPPED
        book[EMITTED] += weight
        packet = room.packets[i]
        packet.source, packet.key, packet.start, packet.events = pixel, room.keys[i], weight, 0
        sample += 1
        if sample == samples:
            which, sample = which + 1, 0
    return which, sample


@pasted
def _list_cells(array: ArrayTables, aim: Aim, x: float, y: float, z: float, reach: float, near: Array) -> int:
    """List the lenslets that show (part of) the lens's opening to a point of the sensor or one within reach of it.

    Returns
    -------
    int
        How many; `near` has a row for each: its centre, and the middle and the radius of the opening as it sees it.
    """
    lattice = array.lenslets.lattice
    over = 1.0 / abs(z - aim.lenslet_z)
    kappa = aim.pupil_vergence
    # Where the chief ray meets the array.
    column, row = cell_of(
        lattice, (kappa * aim.pupil_x + over * x) / (kappa + over), (kappa * aim.pupil_y + over * y) / (kappa + over)
    )
    count = 0
    for r in range(max(row - aim.search, 0), min(row + aim.search + 1, lattice.rows)):
        for c in range(max(column - aim.search, 0), min(column + aim.search + 1, lattice.columns)):
            cell = r * lattice.columns + c
            radius2 = aim.slope_radius2[cell]
            cx, cy = centre(lattice, c, r)
            a, b = (cx - x) * over - aim.slope[cell, 0], (cy - y) * over - aim.slope[cell, 1]
            limit = np.sqrt(max(radius2, 0.0)) + reach * over
            # Without a branch, which would be guessed wrong every other time.
            near[count, 0], near[count, 1] = cx, cy
            near[count, 2], near[count, 3], near[count, 4] = aim.slope[cell, 0], aim.slope[cell, 1], radius2
            count += a * a + b * b <= limit * limit and radius2 >= 0.0
    return count


@pasted
def _through_a_lenslet(
    array: ArrayTables, aim: Aim, normal: tuple[float, float, float], near: Array, listed: int,
    cells: NDArray[np.int64], numbers: Numbers, x: float, y: float, z: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction (array frame) from a point of the sensor, and cos θ over its density.

    Uniform over the cells that surely show the pupil to the point, mixed with some over all that may, which are a
    margin larger: the cells are aimed at where the sensor sees the borders of their faces, through the plate, and the
    borders are deeper at the corners. And with a few directions from the whole hemisphere, for ghosts and stray light;
    a point to which no cell shows the opening sends only those.

    Parameters
    ----------
    near, listed
        Lenslets that may show the opening, and how many, from `_list_cells`.
    """
    lattice = array.lenslets.lattice
    nx, ny, nz = normal
    distance, over = abs(z - aim.border_z), 1.0 / abs(z - aim.lenslet_z)
    toward = -1.0 if array.curved_to_lens else 1.0
    maybe, surely = 0, 0
    for cell in range(listed):
        a, b = (near[cell, 0] - x) * over - near[cell, 2], (near[cell, 1] - y) * over - near[cell, 3]
        off2, radius2 = a * a + b * b, near[cell, 4]
        shows = off2 <= SURE * SURE * radius2
        cells[0, maybe], cells[1, maybe], cells[2, surely] = cell, shows, cell
        maybe += off2 <= radius2
        surely += shows
    wide = aim.blind_share if maybe == 0 else aim.wide_share
    sure = (1.0 - MARGIN_SHARE) * (1.0 - wide) if surely > 0 else 0.0
    size = lattice.pitch + 2.0 * aim.cell_margin
    if numbers[DISCRETE] < wide:
        dx, dy, dz = lambertian(nx, ny, nz, numbers[CELL_U], numbers[CELL_V])
    elif maybe == 0:
        return 0.0, 0.0, 0.0, 0.0
    else:
        is_sure = numbers[DISCRETE] >= 1.0 - sure
        among, count, width = (2, surely, lattice.pitch) if is_sure else (0, maybe, size)
        chosen = cells[among, min(int(numbers[WHICH_CELL] * count), count - 1)]
        u, v = _point_of_cell(lattice.hexagonal, numbers[CELL_U], numbers[CELL_V])
        dx, dy, dz = near[chosen, 0] + u * width - x, near[chosen, 1] + v * width - y, toward * distance
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * scale, dy * scale, dz * scale
    cos_theta = nx * dx + ny * dy + nz * dz
    density = wide * cos_theta / np.pi
    if maybe > 0 and dz * toward > 0.0:
        # Every aimed cell that holds the direction could have drawn it.
        t = distance / (dz * toward)
        px, py = x + t * dx, y + t * dy
        drawn, drawn_surely = 0, 0
        half = 0.5 * lattice.pitch
        for i in range(maybe):
            out = _half_width_to(lattice, px - near[cells[0, i], 0], py - near[cells[0, i], 1])
            drawn += out <= half + aim.cell_margin
            drawn_surely += cells[1, i] * (out <= half)
        area = lattice.pitch * lattice.pitch * (ROW_SPACING if lattice.hexagonal else 1.0)
        per_area = (1.0 - wide - sure) * drawn / (maybe * size * size) * lattice.pitch * lattice.pitch
        if surely > 0:
            per_area += sure * drawn_surely / surely
        cos_array = abs(dz)
        density += per_area * distance * distance / (area * cos_array * cos_array * cos_array)
    return dx, dy, dz, cos_theta / density


@inlined
def _half_width_to(lattice: Lattice, x: float, y: float) -> float:
    """Return the half pitch of a cell at the origin whose border goes through a point."""
    return half_hexagon(x, y) if lattice.hexagonal else max(abs(x), abs(y))


@kernel
def _point_of_cell(hexagonal: bool, u: float, v: float) -> tuple[float, float]:
    """Return a uniform point of the cell at the origin, in pitches."""
    if not hexagonal:
        return u - 0.5, v - 0.5
    # Three rhombi make the hexagon, each spanned by two radii to corners: at 30°, 150° and 270°.
    third = int(3.0 * u)
    u = 3.0 * u - third
    ax, ay = _CORNERS[third]
    bx, by = _CORNERS[third + 1]
    return u * ax + v * bx, u * ay + v * by
