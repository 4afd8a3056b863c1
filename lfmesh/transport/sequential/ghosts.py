"""Ghosts of the camera: packets from the sensor along sequences of its faces with two reflections, in blocks.

A packet takes the image path from its pixel to the lens. There one of the sequences is drawn for it, with probabilities
that a coarse trace has found for rays that come to the lens at about the same place and in about the same direction;
its weight is divided by that probability. The packets of one sequence are followed together through the exact faces of
lens, array, cover and sensor, each weighted by the reflectances and transmittances that it meets; where the sequence
turns back before the lens, from the pixel on. Before the lens they are packets like all others.

What the array reflects back towards the sensor comes to the lens from other lenslets than the image path. So the
packets of these sequences leave their pixels in new directions: some to anywhere on the array, the others at angles at
which a coarse trace has found light.

Which paths these are is defined in `packets.path_class`; the sequences are all of them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.by_address import by_address
from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.kernel import inlined, kernel
from lfmesh.transport.events.crossing import draw_two, move_packet
from lfmesh.transport.packets.book import UNFOLLOWED
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    EVENTS,
    LEFT_LENS,
    MLA_FRAME,
    NO_SURFACE,
    OBJECT_FRAME,
    OBJECTS,
    SENSOR_FRAME,
    Flow,
    Options,
    put,
)
from lfmesh.transport.packets.path_class import REFLECTED_TWICE
from lfmesh.transport.sequential.array_faces import along_array
from lfmesh.transport.sequential.lens_bundle import (
    BLOCK,
    DX,
    DY,
    DZ,
    ENDED_ON,
    MET,
    WEIGHT,
    X,
    Y,
    Z,
    empty_bundle,
    load,
    move_bundle,
    normalise,
    pad,
)
from lfmesh.transport.sequential.plane_faces import along_planes
from lfmesh.transport.sequential.reflections import BUNDLE_ROWS, along, drop_backward
from lfmesh.transport.sequential.sequences import ARRAY_LEG, LENS_LEG
from lfmesh.transport.tables.pixel import area_of_sample
from lfmesh.transport.tables.tables import LensTables, MlaTables, SensorTables

Array = NDArray[np.float64]

SEQUENCE, DIRECTION = 15, 17
"""Dimensions of the random numbers that draw a sequence, and a new direction, among those of an event. What follows on
the way out of the camera draws nothing."""

RADII, HEIGHTS, ANGLES = 8, 8, 8
"""Intervals by which rays are told apart that come to the lens, see `GhostTables`."""

SINES = 32
"""Equal intervals of the sine of the angle between the sensor's normal and a new direction."""

_MET = 7
"""Row of `GhostRoom.rays` for the interfaces that a ray has met; the others are position, direction and weight."""


@by_address
class GhostTables(NamedTuple):
    """Sequences of faces with two reflections, from the sensor to object space, and how they are drawn.

    Each sequence is cut into legs in lens, array, and cover and sensor. Rays that come to the lens are told apart by
    three numbers: the distances from the axis at which they cross a plane at the lens and the plane that they come
    from, squared and in even intervals, at the lens within its opening and outside; and the cosine of the angle between
    the two points as seen from the axis.
    """

    faces: NDArray[np.int64]  # (steps,) faces that each leg meets in turn, counted within its part
    reflected: NDArray[np.bool_]  # (steps,) whether a ray is reflected there
    # (legs, 4) part of the camera, first and last step (not included), whether it leads to the sensor; the legs from
    # the sensor to the lens and back, on the image path, then those of the sequences
    legs: NDArray[np.int64]
    to_lens: int  # number of legs from the sensor to the lens
    first: NDArray[np.int64]  # (sequences + 1,) first leg of each that packets follow
    from_pixel: NDArray[np.bool_]  # (sequences,) whether that is from the pixel on; else it is from behind the lens on
    lengths: NDArray[np.int64]  # (sequences,) faces that it meets
    anew: NDArray[np.bool_]  # (sequences,) whether its packets leave the pixel in a new direction
    share_anew: float  # chance that one of these is drawn
    until_anew: Array  # (sequences,) cumulative chance of each among these
    to_array: float  # share of the new directions to anywhere on the array; for the others `sines` holds
    array_half_x: float  # mm, half of the array's sides
    array_half_y: float
    sines: Array  # (sequences, SINES) cumulative chance of the intervals of the new direction's sine
    # (RADII · HEIGHTS · ANGLES + 1, sequences) cumulative chance of each other one for rays of each kind; the last row:
    # for those that do not come to the lens
    until: Array
    # (HEIGHTS, RADII · ANGLES) cumulative chance with which a ray from each height goes to each cell at the lens
    cells: Array
    plane_z: float  # mm, camera frame: the plane at the lens
    from_z: float  # mm, the plane that they come from: of the array or, without one, of the sensor
    rings: Array  # (RADII + 1,) mm², squared distances at which the intervals of the distance begin and end at the lens
    height: float  # mm, at which the intervals of the distance end where they come from


class GhostRoom(NamedTuple):
    """Working memory for a wave of packets."""

    rays: Array  # (8, n) of each packet of the wave, where it begins to follow its sequence
    chance: Array  # (n,) of the sequence drawn for it
    sequence: NDArray[np.int64]  # (n,) drawn for it; −1: it has ended
    order: NDArray[np.int64]  # (n,) packets of the wave by their sequences
    first: NDArray[np.int64]  # (sequences + 1,) where those of each sequence begin
    bundle: Array  # (BUNDLE_ROWS · BLOCK,)


def ghost_room(packets: int, sequences: int) -> GhostRoom:
    """Return working memory for waves of a number of packets."""
    return GhostRoom(
        np.zeros((_MET + 1, packets)),
        np.zeros(packets),
        np.zeros(packets, np.int64),
        np.zeros(packets, np.int64),
        np.zeros(sequences + 1, np.int64),
        empty_bundle(BUNDLE_ROWS),
    )


@kernel
def follow_ghosts(
    wave: NDArray[np.void], lens: LensTables, mla: MlaTables, sensor: SensorTables, cover: Any, ghosts: GhostTables,
    frames: Array, numbers: NDArray[np.int64], options: Options, flow: Flow, room: GhostRoom,
) -> None:  # fmt: skip
    """Take a wave of packets that have left their pixels through the camera, each along a sequence of its own.

    Packets that come from object space end: by two reflections none gets back there.

    Parameters
    ----------
    wave : (n,) PACKET
    cover : CoverTables, or None
    numbers : (BLOCK,) int64
        Working memory.
    """
    camera = lens, mla, sensor, cover
    _to_lens(wave, camera, ghosts, frames, numbers, options, flow, room)
    _sort(len(wave), room)
    for sequence in range(len(ghosts.lengths)):
        for first in range(room.first[sequence], room.first[sequence + 1], BLOCK):
            count = min(BLOCK, room.first[sequence + 1] - first)
            _along_sequence(wave, room.order[first : first + count], sequence, camera, ghosts, frames, flow, room)


@kernel
def _to_lens(
    wave: NDArray[np.void], camera: Any, ghosts: GhostTables, frames: Array, numbers: NDArray[np.int64],
    options: Options, flow: Flow, room: GhostRoom,
) -> None:  # fmt: skip
    """Take packets from the sensor to the lens, along the image path, and draw a sequence for each."""
    bundle, surfaces = room.bundle, len(camera[0].surfaces)
    count = 0
    for i in range(len(wave)):
        packet = wave[i]
        room.sequence[i] = NO_SURFACE
        if packet.frame == CAMERA_FRAME or packet.frame == OBJECT_FRAME or packet.space != surfaces:
            flow.book[UNFOLLOWED] += packet.weight
            continue
        if ghosts.share_anew > 0.0 and draw_two(options, packet, SEQUENCE)[0] < ghosts.share_anew:
            _start_anew(packet, i, camera, ghosts, frames, options, room)
            continue
        if packet.weight == 0.0:
            # It has left its pixel for new directions alone.
            continue
        move_packet(frames, packet, CAMERA_FRAME)
        if not packet.dz < 0.0:
            flow.book[UNFOLLOWED] += packet.weight
            continue
        load(bundle, count, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz, packet.weight)
        numbers[count] = i
        count += 1
        if count == BLOCK:
            _draw_sequences(wave, count, camera, ghosts, frames, numbers, options, flow, room)
            count = 0
    if count > 0:
        pad(bundle, count)
        _draw_sequences(wave, count, camera, ghosts, frames, numbers, options, flow, room)


@kernel
def _draw_sequences(
    wave: NDArray[np.void], count: int, camera: Any, ghosts: GhostTables, frames: Array, numbers: NDArray[np.int64],
    options: Options, flow: Flow, room: GhostRoom,
) -> None:  # fmt: skip
    """Take a block of packets to the lens, and draw a sequence for each."""
    bundle, rays = room.bundle, room.rays
    follow_legs(bundle, count, 0, ghosts.to_lens, camera, ghosts, frames, wave[numbers[0]].colour, flow.book)
    normalise(bundle)
    lost = len(ghosts.until) - 1
    for i in range(count):
        n = numbers[i]
        packet = wave[n]
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        comes = bundle[ENDED_ON + i] == 0.0 and bundle[DZ + i] < 0.0
        kind = kind_of_ray(ghosts, x, y, z, dx, dy, dz) if comes else lost
        if not ghosts.until[kind, -1] > 0.0:
            continue
        u, _ = draw_two(options, packet, SEQUENCE)
        sequence, chance = _drawn(ghosts.until[kind], (u - ghosts.share_anew) / (1.0 - ghosts.share_anew))
        chance *= 1.0 - ghosts.share_anew
        if ghosts.from_pixel[sequence]:
            x, y, z = packet.x, packet.y, packet.z
            dx, dy, dz = packet.dx, packet.dy, packet.dz
            rays[6, n], rays[_MET, n] = packet.weight / chance, 0.0
        else:
            rays[6, n], rays[_MET, n] = bundle[WEIGHT + i] / chance, bundle[MET + i]
        room.sequence[n], room.chance[n] = sequence, chance
        rays[0, n], rays[1, n], rays[2, n] = x, y, z
        rays[3, n], rays[4, n], rays[5, n] = dx, dy, dz


@kernel
def _start_anew(
    packet: Any, n: int, camera: Any, ghosts: GhostTables, frames: Array, options: Options, room: GhostRoom
) -> None:  # fmt: skip
    """Draw one of the sequences whose packets leave the pixel in a new direction, and the direction."""
    _, mla, sensor, _ = camera
    move_packet(frames, packet, SENSOR_FRAME)
    u, _ = draw_two(options, packet, SEQUENCE)
    sequence, chance = _drawn(ghosts.until_anew, u / ghosts.share_anew)
    chance *= ghosts.share_anew
    u, v = draw_two(options, packet, DIRECTION)
    until, rays = ghosts.sines[sequence], room.rays
    if u < ghosts.to_array:
        dx, dy, dz = _to_array(mla, ghosts, frames, packet.x, packet.y, u / ghosts.to_array, v)
    else:
        dx, dy, dz = _at_sine(until, (u - ghosts.to_array) / (1.0 - ghosts.to_array), v)
    density = _density(mla, ghosts, frames, until, packet.x, packet.y, dx, dy, dz)
    if density > 0.0:
        room.sequence[n], room.chance[n] = sequence, chance
        move = frames[SENSOR_FRAME, CAMERA_FRAME]
        rays[0, n], rays[1, n], rays[2, n] = point_through(move, packet.x, packet.y, 0.0)
        rays[3, n], rays[4, n], rays[5, n] = direction_through(move, dx, dy, dz)
        rays[6, n], rays[_MET, n] = area_of_sample(sensor, options.samples) / (density * chance), 0.0


@kernel
def follow_legs(
    bundle: Array, count: int, first: int, last: int, camera: Any, ghosts: GhostTables, frames: Array, colour: int,
    book: Array,
) -> None:  # fmt: skip
    """Take a bundle (camera frame) along some of the legs in turn.

    Parameters
    ----------
    bundle : (BUNDLE_ROWS · BLOCK,) float64
    count : int
        Rays in it.
    first, last : int
        Numbers of the legs; the last is not included.
    camera : (LensTables, MlaTables, SensorTables, CoverTables or None)
    ghosts : GhostTables
    frames : (6, 6, 3, 4) float64
    colour : int
        Number of the wavelength.
    book : (slots,) float64
        For light that media absorb.
    """
    lens, mla, sensor, cover = camera
    for leg in range(first, last):
        part, begin, end, to_sensor = ghosts.legs[leg]
        faces, reflected = ghosts.faces[begin:end], ghosts.reflected[begin:end]
        if part == LENS_LEG:
            along(bundle, lens, faces, reflected, to_sensor != 0, colour, book)
        elif part == ARRAY_LEG:
            drop_backward(bundle, to_sensor != 0)
            along_array(bundle, count, mla, faces, reflected, colour, frames, to_sensor != 0, book)
        else:
            along_planes(bundle, cover, sensor, faces, reflected, frames, colour)


@kernel
def weights_along(
    sequence: int, p: Array, d: Array, camera: Any, ghosts: GhostTables, frames: Array, colour: int, bundle: Array,
    book: Array, weights: Array,
) -> None:  # fmt: skip
    """Find with what weight rays pass along a sequence.

    Parameters
    ----------
    sequence : int
    p, d : (n, 3) float64
        Position, mm, and unit direction, camera frame: behind the lens and towards it, where they come on the image
        path; from the sensor, where the sequence's packets leave it in new directions.
    camera, ghosts, frames, colour
        As for `follow_legs`.
    bundle : (BUNDLE_ROWS · BLOCK,) float64
    book : (slots,) float64
        Working memory.
    weights : (n,) float64
        Filled; 0: the ray does not pass.
    """
    from_pixel = ghosts.from_pixel[sequence] and not ghosts.anew[sequence]
    for first in range(0, len(p), BLOCK):
        count = min(BLOCK, len(p) - first)
        for i in range(count):
            at, to = p[first + i], d[first + i]
            # Back to the pixel that it comes from, from the plane at the lens.
            t, sense = ((ghosts.plane_z - at[2]) / to[2], -1.0) if from_pixel else (0.0, 1.0)
            load(
                bundle, i, at[0] + t * to[0], at[1] + t * to[1], at[2] + t * to[2],
                sense * to[0], sense * to[1], sense * to[2], 1.0,
            )  # fmt: skip
        pad(bundle, count)
        if from_pixel:
            follow_legs(bundle, count, ghosts.to_lens, ghosts.first[0], camera, ghosts, frames, colour, book)
            _turn_back_at_sensor(bundle, frames)
        follow_legs(
            bundle, count, ghosts.first[sequence], ghosts.first[sequence + 1], camera, ghosts, frames, colour, book
        )
        for i in range(count):
            weights[first + i] = bundle[WEIGHT + i] if bundle[ENDED_ON + i] == 0.0 else 0.0


@kernel
def _turn_back_at_sensor(bundle: Array, frames: Array) -> None:
    """Take a bundle (camera frame) on to the plane of the sensor, and back the way that it came, with weight 1."""
    to_sensor = frames[CAMERA_FRAME, SENSOR_FRAME]
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        t = -point_through(to_sensor, x, y, z)[2] / direction_through(to_sensor, dx, dy, dz)[2]
        bundle[X + i], bundle[Y + i], bundle[Z + i] = x + t * dx, y + t * dy, z + t * dz
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = -dx, -dy, -dz
        bundle[WEIGHT + i] = 1.0


@inlined
def kind_of_ray(ghosts: GhostTables, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> int:
    """Return the row of `GhostTables.until` for a ray to the lens.

    Parameters
    ----------
    ghosts : GhostTables
    x, y, z : float, mm, camera frame
    dx, dy, dz : float
    """
    t = (ghosts.plane_z - z) / dz
    px, py = x + t * dx, y + t * dy
    t = (ghosts.from_z - z) / dz
    qx, qy = x + t * dx, y + t * dy
    p2, q2 = px * px + py * py, qx * qx + qy * qy
    radius = interval_of_radius(ghosts, p2)
    height = interval_of_height(ghosts, q2)
    angle = interval_of_angle(px * qx + py * qy, np.sqrt(p2 * q2))
    return (radius * HEIGHTS + height) * ANGLES + angle


@inlined
def interval_of_radius(ghosts: GhostTables, squared: float) -> int:
    """Return the interval of a squared distance from the axis, mm², in the plane at the lens."""
    return min(int(np.searchsorted(ghosts.rings, squared, side="right")), RADII) - 1


@inlined
def interval_of_angle(product: float, lengths: float) -> int:
    """Return the interval of the angle between two points as seen from the axis, by their scalar product."""
    cosine = product / lengths if 0.0 < lengths < np.inf else 1.0
    return min(max(int(ANGLES * 0.5 * (1.0 - cosine)), 0), ANGLES - 1)


@inlined
def interval_of_height(ghosts: GhostTables, squared: float) -> int:
    """Return the interval of a squared distance from the axis, mm², in the plane that rays come from."""
    # Of rays that graze the plane the distance may be larger than any integer.
    return int(min(HEIGHTS * squared / (ghosts.height * ghosts.height), HEIGHTS - 1.0))


@kernel
def _to_array(
    mla: MlaTables, ghosts: GhostTables, frames: Array, x: float, y: float, u: float, v: float
) -> tuple[float, float, float]:
    """Return the direction (sensor frame) from a point of the sensor to one on the array.

    Parameters
    ----------
    x, y : float, mm
    u, v : float
        Random numbers.
    """
    px, py, pz = point_through(frames[SENSOR_FRAME, MLA_FRAME], x, y, 0.0)
    half_x, half_y = ghosts.array_half_x, ghosts.array_half_y
    dx, dy, dz = (2.0 * u - 1.0) * half_x - px, (2.0 * v - 1.0) * half_y - py, 0.5 * mla.lenslets.thickness - pz
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return direction_through(frames[MLA_FRAME, SENSOR_FRAME], scale * dx, scale * dy, scale * dz)


@kernel
def _at_sine(until: Array, u: float, v: float) -> tuple[float, float, float]:
    """Return a direction from the sensor (its frame), evenly over the projected solid angle of an interval of the sine.

    Parameters
    ----------
    until : (SINES,) float64
        Cumulative chance of the intervals.
    u, v : float
        Random numbers.
    """
    interval, chance = _drawn(until, u)
    low, high = (interval / SINES) ** 2, ((interval + 1) / SINES) ** 2
    squared = low + (high - low) * min(max((u - until[interval] + chance) / chance, 0.0), 1.0)
    sine, turn = np.sqrt(squared), 2.0 * np.pi * v
    return sine * np.cos(turn), sine * np.sin(turn), -np.sqrt(1.0 - squared)


@kernel
def _density(
    mla: MlaTables, ghosts: GhostTables, frames: Array, until: Array, x: float, y: float,
    dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the density, in 1/sr of projected solid angle, with which a new direction is drawn; 0 along the sensor.

    Parameters
    ----------
    until : (SINES,) float64
        Cumulative chance of the intervals of its sine.
    x, y : float, mm
        The point of the sensor.
    dx, dy, dz : float
        The direction, sensor frame.
    """
    if not dz < 0.0:
        return 0.0
    interval = min(int(SINES * np.sqrt(dx * dx + dy * dy)), SINES - 1)
    chance = until[interval] - (until[interval - 1] if interval > 0 else 0.0)
    density = (1.0 - ghosts.to_array) * chance * SINES * SINES / (np.pi * (2 * interval + 1))
    px, py, pz = point_through(frames[SENSOR_FRAME, MLA_FRAME], x, y, 0.0)
    ux, uy, uz = direction_through(frames[SENSOR_FRAME, MLA_FRAME], dx, dy, dz)
    half_x, half_y = ghosts.array_half_x, ghosts.array_half_y
    t = (0.5 * mla.lenslets.thickness - pz) / uz if uz != 0.0 else -1.0
    if t > 0.0 and abs(px + t * ux) <= half_x and abs(py + t * uy) <= half_y:
        density += ghosts.to_array * t * t / (4.0 * half_x * half_y * abs(uz * dz))
    return density


@inlined
def _drawn(until: Array, u: float) -> tuple[int, float]:
    """Return which of several things a random number draws, and its chance."""
    drawn = min(int(np.searchsorted(until, u, side="right")), len(until) - 1)
    return drawn, until[drawn] - (until[drawn - 1] if drawn > 0 else 0.0)


@kernel
def _sort(count: int, room: GhostRoom) -> None:
    """Sort the packets of a wave by their sequences, in their order within each."""
    first = room.first
    for k in range(len(first)):
        first[k] = 0
    for i in range(count):
        if room.sequence[i] >= 0:
            first[room.sequence[i]] += 1
    total = 0
    for k in range(len(first)):
        total, first[k] = total + first[k], total
    for i in range(count):
        sequence = room.sequence[i]
        if sequence >= 0:
            room.order[first[sequence]] = i
            first[sequence] += 1
    # Each start has moved to the next sequence's.
    for k in range(len(first) - 1, 0, -1):
        first[k] = first[k - 1]
    first[0] = 0


@kernel
def _along_sequence(
    wave: NDArray[np.void], order: NDArray[np.int64], sequence: int, camera: Any, ghosts: GhostTables, frames: Array,
    flow: Flow, room: GhostRoom,
) -> None:  # fmt: skip
    """Take a block of packets along a sequence, and queue those that pass for object space."""
    bundle, rays, events = room.bundle, room.rays, 0
    for i in range(len(order)):
        n = order[i]
        load(bundle, i, rays[0, n], rays[1, n], rays[2, n], rays[3, n], rays[4, n], rays[5, n], rays[6, n])
    pad(bundle, len(order))
    first, last = ghosts.first[sequence], ghosts.first[sequence + 1]
    follow_legs(bundle, len(order), first, last, camera, ghosts, frames, wave[order[0]].colour, flow.book)
    normalise(bundle)
    move_bundle(bundle, frames[CAMERA_FRAME, OBJECT_FRAME])
    for i in range(len(order)):
        met = int(bundle[MET + i])
        events += met
        if bundle[ENDED_ON + i] != 0.0 or not bundle[WEIGHT + i] > 0.0:
            continue
        packet = wave[order[i]]
        packet.events += met + int(rays[_MET, order[i]])
        child = put(
            flow, OBJECTS, packet, OBJECT_FRAME, bundle[X + i], bundle[Y + i], bundle[Z + i],
            bundle[DX + i], bundle[DY + i], bundle[DZ + i], bundle[WEIGHT + i], packet.key, 0.0,
        )  # fmt: skip
        child.space, child.stray = 0, REFLECTED_TWICE
        child.last, child.facet, child.column = LEFT_LENS, NO_SURFACE, NO_SURFACE
    flow.counts[EVENTS] += events
