"""Ghosts of the camera: blocks of packets from the sensor along sequences with two reflections.

A packet takes the image path from its pixel to the lens. There a sequence is drawn for it, with probabilities that a
coarse trace has found for rays of similar place and direction; the packet's weight is divided by that probability.
Packets of one sequence are followed together through the exact faces of lens, array, cover and sensor, weighted by the
reflectances and transmittances on the way. They start behind the lens, or at the pixel if the sequence turns back
before the lens. In object space they are packets like all others.

Light that the array reflects back to the sensor reaches the lens through other lenslets than the image path does.
Packets of such sequences leave their pixels in new directions: some to anywhere on the array, the others at angles
where a coarse trace has found light.

`paths.automaton` defines these paths; the sequences cover all of them.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.ray import Ray, ray_of
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import count_up_to, drawn_by
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
from lfmesh.transport.paths.automaton import REFLECTED_TWICE
from lfmesh.transport.sequences.bundle import empty_bundle
from lfmesh.transport.sequences.follower import END_ROWS, RAY_ENDED, RAY_MET, RAY_WEIGHT, Route, follow_rays
from lfmesh.transport.tables.pixel import area_of_sample
from lfmesh.transport.tables.tables import Camera, MlaTables

Array = NDArray[np.float64]

SEQUENCE, DIRECTION = 15, 17
"""Dimensions of an event's random numbers that draw a sequence and a new direction. The rest of the way to object space
draws nothing."""

RADII, HEIGHTS, ANGLES = 8, 8, 8
"""Numbers of intervals that define the kinds of rays at the lens, see `GhostTables`."""

SINES = 32
"""Number of equal intervals of the sine of the angle between the sensor's normal and a new direction."""


@by_address
class GhostTables(NamedTuple):
    """Sequences with two reflections, from the sensor to object space, and their sampling probabilities.

    Each sequence is cut into legs: lens, array, and cover with sensor. Three numbers define the kind of a ray: the
    squared radius in a plane at the lens, in even intervals inside its opening and outside; the squared radius in the
    plane of origin, in even intervals; and the cosine of the angle at the axis between the two points.
    """

    route: Route  # legs from the sensor to the lens and back, on the image path, then those of the sequences
    to_lens: int  # number of legs from the sensor to the lens
    first: NDArray[np.int64]  # (sequences + 1,) first leg of each sequence that packets follow
    from_pixel: NDArray[np.bool_]  # (sequences,) that leg starts at the pixel; else behind the lens
    lengths: NDArray[np.int64]  # (sequences,) number of faces
    anew: NDArray[np.bool_]  # (sequences,) packets leave the pixel in a new direction
    share_anew: float  # probability that one of these sequences is drawn
    until_anew: Array  # (sequences,) cumulative probability of each among these
    to_array: float  # fraction of new directions to anywhere on the array; the others follow `sines`
    array_half_x: float  # mm, half the sides of the array
    array_half_y: float
    sines: Array  # (sequences, SINES) cumulative probability of the intervals of the new direction's sine
    # (RADII · HEIGHTS · ANGLES + 1, sequences) cumulative probability of each other sequence for rays of each kind;
    # last row: for rays that do not reach the lens
    until: Array
    # (HEIGHTS, RADII · ANGLES) cumulative probability that a ray from each height goes to each cell at the lens
    cells: Array
    plane_z: float  # mm, camera frame: plane at the lens
    from_z: float  # mm, plane of origin: the array or, without one, the sensor
    rings: Array  # (RADII + 1,) mm², squared radii that bound the intervals at the lens
    height: float  # mm, radius that bounds the intervals in the plane of origin
    shown: Array  # (RADII,) root mean square of the light that reaches each ring at the lens, over all heights


class GhostRoom(NamedTuple):
    """Working memory for a wave of packets."""

    rays: Array  # (RAY_MET + 1, n) ray of each packet at the start of its sequence
    ends: Array  # (END_ROWS, n) see `follow_rays`
    chance: Array  # (n,) probability of the drawn sequence
    sequence: NDArray[np.int64]  # (n,) drawn sequence; −1: the packet has ended
    order: NDArray[np.int64]  # (n,) packets of the wave by sequence
    first: NDArray[np.int64]  # (sequences + 1,) start of each sequence in `order`
    bundle: Array  # (ROWS · BLOCK,)


def ghost_room(packets: int, sequences: int) -> GhostRoom:
    """Return working memory for waves of a number of packets."""
    return GhostRoom(
        np.zeros((RAY_MET + 1, packets)),
        np.zeros((END_ROWS, packets)),
        np.zeros(packets),
        np.zeros(packets, np.int64),
        np.zeros(packets, np.int64),
        np.zeros(sequences + 1, np.int64),
        empty_bundle(),
    )


def follow_ghosts(
    wave: NDArray[np.void], camera: Camera, ghosts: GhostTables, options: Options, flow: Flow, room: GhostRoom
) -> None:  # fmt: skip
    """Take a wave of packets from their pixels through the camera, each along its own sequence.

    Packets from object space end: two reflections do not bring them back there.

    Parameters
    ----------
    wave : (n,) PACKET
        Packets of one wavelength.
    camera : Camera
    """
    colour = int(wave["colour"][0]) if len(wave) > 0 else 0

    def follow(first: NDArray[np.int64], legs: NDArray[np.int64]) -> None:
        follow_rays(
            room.rays, room.ends, room.order, first, legs, camera, ghosts.route, colour, flow.book, room.bundle
        )  # fmt: skip

    count = _leave_pixels(wave, camera, ghosts, options, flow, room)
    follow(np.array([0, count]), np.array([0, ghosts.to_lens]))
    _draw_sequences(wave, count, ghosts, options, room)
    _sort(len(wave), room)
    follow(room.first, ghosts.first)
    _hand_on(wave, camera.frames, flow, room)


@kernel
def _leave_pixels(
    wave: NDArray[np.void], camera: Camera, ghosts: GhostTables, options: Options, flow: Flow, room: GhostRoom
) -> int:  # fmt: skip
    """Start a wave from the sensor, to the lens or in new directions; return the number to the lens.

    Those to the lens come first in `GhostRoom.order`.
    """
    surfaces, frames = len(camera.lens.surfaces), camera.frames
    count = 0
    for i in range(len(wave)):
        packet = wave[i]
        room.sequence[i] = NO_SURFACE
        if packet.frame == CAMERA_FRAME or packet.frame == OBJECT_FRAME or packet.space != surfaces:
            flow.book[UNFOLLOWED] += packet.weight
            continue
        if ghosts.share_anew > 0.0 and draw_two(options, packet, SEQUENCE)[0] < ghosts.share_anew:
            _start_anew(packet, i, camera, ghosts, options, room)
            continue
        if packet.weight == 0.0:
            # The packet was started for new directions only.
            continue
        move_packet(frames, packet, CAMERA_FRAME)
        if not packet.dz < 0.0:
            flow.book[UNFOLLOWED] += packet.weight
            continue
        _start_ray(room, i, ray_of(packet), packet.weight, 0.0)
        room.order[count] = i
        count += 1
    return count


@inlined
def _start_ray(room: GhostRoom, n: int, ray: Ray, weight: float, met: float) -> None:
    """Write a packet's ray and its number of interfaces met."""
    x, y, z, dx, dy, dz = ray
    rays = room.rays
    rays[0, n], rays[1, n], rays[2, n] = x, y, z
    rays[3, n], rays[4, n], rays[5, n] = dx, dy, dz
    rays[RAY_WEIGHT, n], rays[RAY_MET, n] = weight, met


@inlined
def _direction_at_end(room: GhostRoom, n: int) -> tuple[float, float, float]:
    """Return the unit direction at the end of a packet's ray."""
    dx, dy, dz = room.ends[3, n], room.ends[4, n], room.ends[5, n]
    # Every interface changes its length by a rounding error.
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel
def _draw_sequences(wave: NDArray[np.void], count: int, ghosts: GhostTables, options: Options, room: GhostRoom) -> None:
    """Draw a sequence for each packet at the lens, the first ones in `GhostRoom.order`."""
    rays, ends = room.rays, room.ends
    lost = len(ghosts.until) - 1
    for i in range(count):
        n = room.order[i]
        packet = wave[n]
        x, y, z = ends[0, n], ends[1, n], ends[2, n]
        dx, dy, dz = _direction_at_end(room, n)
        comes = ends[RAY_ENDED, n] == 0.0 and dz < 0.0
        kind = kind_of_ray(ghosts, x, y, z, dx, dy, dz) if comes else lost
        if not ghosts.until[kind, -1] > 0.0:
            continue
        u, _ = draw_two(options, packet, SEQUENCE)
        sequence, chance = _drawn(ghosts.until[kind], (u - ghosts.share_anew) / (1.0 - ghosts.share_anew))
        chance *= 1.0 - ghosts.share_anew
        room.sequence[n], room.chance[n] = sequence, chance
        if ghosts.from_pixel[sequence]:
            rays[RAY_WEIGHT, n] /= chance
        else:
            _start_ray(room, n, Ray(x, y, z, dx, dy, dz), ends[RAY_WEIGHT, n] / chance, ends[RAY_MET, n])


@kernel
def _start_anew(packet: Any, n: int, camera: Camera, ghosts: GhostTables, options: Options, room: GhostRoom) -> None:
    """Draw a sequence with a new direction at the pixel, and that direction."""
    mla, frames = camera.mla, camera.frames
    move_packet(frames, packet, SENSOR_FRAME)
    u, _ = draw_two(options, packet, SEQUENCE)
    sequence, chance = _drawn(ghosts.until_anew, u / ghosts.share_anew)
    chance *= ghosts.share_anew
    u, v = draw_two(options, packet, DIRECTION)
    until = ghosts.sines[sequence]
    if u < ghosts.to_array:
        dx, dy, dz = _to_array(mla, ghosts, frames, packet.x, packet.y, u / ghosts.to_array, v)
    else:
        dx, dy, dz = _at_sine(until, (u - ghosts.to_array) / (1.0 - ghosts.to_array), v)
    density = _density(mla, ghosts, frames, until, (packet.x, packet.y), (dx, dy, dz))
    if density > 0.0:
        room.sequence[n], room.chance[n] = sequence, chance
        move = frames[SENSOR_FRAME, CAMERA_FRAME]
        x, y, z = point_through(move, packet.x, packet.y, 0.0)
        dx, dy, dz = direction_through(move, dx, dy, dz)
        weight = area_of_sample(camera.sensor, options.pixels.samples, packet.colour) / (density * chance)
        _start_ray(room, n, Ray(x, y, z, dx, dy, dz), weight, 0.0)


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
    """Return the interval of a squared radius, mm², in the plane at the lens."""
    return min(count_up_to(ghosts.rings, squared), RADII) - 1


@inlined
def interval_of_angle(product: float, lengths: float) -> int:
    """Return the interval of the angle at the axis between two points, from their scalar product."""
    cosine = product / lengths if 0.0 < lengths < np.inf else 1.0
    return min(max(int(ANGLES * 0.5 * (1.0 - cosine)), 0), ANGLES - 1)


@inlined
def interval_of_height(ghosts: GhostTables, squared: float) -> int:
    """Return the interval of a squared radius, mm², in the plane of origin."""
    # For rays that graze the plane the distance may exceed any integer.
    return int(min(HEIGHTS * squared / (ghosts.height * ghosts.height), HEIGHTS - 1.0))


@kernel
def _to_array(
    mla: MlaTables, ghosts: GhostTables, frames: Array, x: float, y: float, u: float, v: float
) -> tuple[float, float, float]:
    """Return a direction (sensor frame) from the sensor to a uniform point of the array.

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
    """Return a direction from the sensor (its frame), uniform in projected solid angle over a sine interval.

    Parameters
    ----------
    until : (SINES,) float64
        Cumulative probability of the intervals.
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
    mla: MlaTables, ghosts: GhostTables, frames: Array, until: Array, place: tuple[float, float],
    direction: tuple[float, float, float],
) -> float:  # fmt: skip
    """Return the sampling density, 1/sr of projected solid angle, of a new direction; 0 along the sensor.

    Parameters
    ----------
    until : (SINES,) float64
        Cumulative probability of the intervals of its sine.
    place : (2,) float, mm
        Point on the sensor.
    direction : (3,) float
        Sensor frame.
    """
    (x, y), (dx, dy, dz) = place, direction
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
    """Return the item drawn by a random number, and its probability."""
    drawn = drawn_by(until, u)
    return drawn, until[drawn] - (until[drawn - 1] if drawn > 0 else 0.0)


@kernel
def _sort(count: int, room: GhostRoom) -> None:
    """Sort the packets of a wave by sequence, stably."""
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
    # Each start has moved to the start of the next sequence.
    for k in range(len(first) - 1, 0, -1):
        first[k] = first[k - 1]
    first[0] = 0


@kernel
def _hand_on(wave: NDArray[np.void], frames: Array, flow: Flow, room: GhostRoom) -> None:
    """Queue the packets that completed their sequences for object space."""
    ends, events = room.ends, 0
    move = frames[CAMERA_FRAME, OBJECT_FRAME]
    for i in range(room.first[-1]):
        n = room.order[i]
        met = int(ends[RAY_MET, n])
        events += met
        if ends[RAY_ENDED, n] != 0.0 or not ends[RAY_WEIGHT, n] > 0.0:
            continue
        packet = wave[n]
        packet.events += met + int(room.rays[RAY_MET, n])
        x, y, z = point_through(move, ends[0, n], ends[1, n], ends[2, n])
        dx, dy, dz = _direction_at_end(room, n)
        dx, dy, dz = direction_through(move, dx, dy, dz)
        child = put(flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, dx, dy, dz, ends[RAY_WEIGHT, n], packet.key, 0.0)
        child.space, child.path = 0, REFLECTED_TWICE
        child.last, child.facet, child.bodies = LEFT_LENS, NO_SURFACE, NO_SURFACE
    flow.counts[EVENTS] += events
