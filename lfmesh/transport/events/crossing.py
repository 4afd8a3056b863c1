"""Operations shared by all stations: divide a packet's weight, record a vertex, end a packet, query Embree again.

Functions that change a weight enter the difference in the book.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.facets import FLOAT32_GRAIN
from lfmesh.transport.packets.book import (
    DEPTH,
    LOST_CONTRADICTION,
    LOST_MISS,
    ROULETTE_ADDED,
    ROULETTE_REMOVED,
    UNFOLLOWED,
)
from lfmesh.transport.packets.packet import (
    BOTH,
    CAMERA,
    DEPOSITS,
    ENDED,
    ENDS_AT,
    EVENT_OF_STATUS,
    NO_SURFACE,
    NODES,
    PIXEL_MASK,
    REQUERIES,
    ROULETTE,
    S_DEPTH,
    S_LOST,
    SAMPLE_SHIFT,
    WORLD_FRAME,
    Flow,
    Options,
    frame_in_table,
    keep_chord,
    keep_state,
    put,
    sample_of,
)
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, uniform
from lfmesh.transport.packets.sobol import of_event

MAX_TRIES = 12


# Dimensions of an event's random numbers.
CHOOSE, KEEP_REFLECTED, KEEP_REFRACTED, KEEP_BOUNCE = 0, 1, 2, 3
BOUNCE_U, BOUNCE_V, AIM_DISK, AIM_U, AIM_V, LIGHT_U, LIGHT_V, KEEP_REACHED = 4, 5, 6, 7, 8, 9, 10, 11
EMITTER_U, EMITTER_V, PASS = 12, 13, 14

Array = NDArray[np.float64]


@kernel
def draw(packet: Any, dimension: int) -> float:
    """Return a uniform random number in [0, 1) for the packet's current event."""
    return uniform(packet.key, packet.events * DIMENSIONS_PER_EVENT + dimension)


@inlined
def draw_two(options: Options, packet: Any, dimension: int) -> tuple[float, float]:
    """Return two random numbers in [0, 1) for the packet's current event, from a pixel's Sobol' set if possible.

    Parameters
    ----------
    dimension : int
        Dimension of the first number; the second has the next.
    """
    number = packet.events * DIMENSIONS_PER_EVENT + dimension
    if options.pixels.each == 0:
        return uniform(packet.key, number), uniform(packet.key, number + 1)
    stream, sample = sample_of(options.pixels, packet)
    return of_event(stream, number, sample)


@inlined
def refracted(
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, eta: float, cos_i: float, cos_t: float
) -> tuple[float, float, float]:
    """Return the refracted direction by Snell's law.

    Parameters
    ----------
    dx, dy, dz : float
        Unit direction.
    nx, ny, nz : float
        Unit normal along the ray.
    eta : float
        n_i / n_t.
    cos_i, cos_t : float
        Cosines of incidence and refraction.
    """
    g = cos_t - eta * cos_i
    return normalised(eta * dx + g * nx, eta * dy + g * ny, eta * dz + g * nz)


@inlined
def reflected(dx: float, dy: float, dz: float, nx: float, ny: float, nz: float) -> tuple[float, float, float]:
    """Return a direction mirrored at a plane with a unit normal of either sign.

    Parameters
    ----------
    dx, dy, dz : float
        Direction.
    nx, ny, nz : float
        Unit normal.
    """
    g = 2.0 * (dx * nx + dy * ny + dz * nz)
    return normalised(dx - g * nx, dy - g * ny, dz - g * nz)


@inlined
def normalised(dx: float, dy: float, dz: float) -> tuple[float, float, float]:
    """Remove rounding errors from the length of a unit direction by one Newton step.

    Parameters
    ----------
    dx, dy, dz : float
    """
    scale = 1.5 - 0.5 * (dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel
def windowed(book: Array, weight: float, floor: float, key: np.uint64, dimension: int) -> float:
    """Apply the weight window's unbiased Russian roulette: a weight below the floor becomes the floor or zero.

    Parameters
    ----------
    book : (slots,) float64
        Receives the change.
    weight, floor : float
    key : uint64
    dimension : int
        Key and dimension of the random number.
    """
    if weight >= floor:
        return weight
    if uniform(key, dimension) * floor < weight:
        book[ROULETTE_ADDED] += floor - weight
        return floor
    book[ROULETTE_REMOVED] += weight
    return 0.0


@inlined
def thinned(cutoff: float, book: Array, packet: Any, weight: float, key: np.uint64) -> float:
    """Return the weight, after roulette, of a packet that is outside the estimated paths so far; 0: it ends.

    Parameters
    ----------
    cutoff : float
        Threshold of roulette, over the packet's starting weight.
    book : (slots,) float64
    packet : PACKET
    weight : float
    key : uint64
    """
    dimension = packet.events * DIMENSIONS_PER_EVENT + KEEP_REACHED
    return windowed(book, weight, cutoff * packet.start, key, dimension)


@inlined
def split_shares(
    options: Options, book: Array, packet: Any, reflectance: float, transmittance: float
) -> tuple[float, float]:
    """Return the weights of the reflected and the refracted child after roulette; zero: no such child.

    Parameters
    ----------
    options : Options
        `split` and `cutoff` decide.
    book : (slots,) float64
    packet : PACKET
    reflectance, transmittance : float
        Shares of the power.
    """
    weight = packet.weight
    dimension = packet.events * DIMENSIONS_PER_EVENT
    if options.thinning.split == BOTH:
        floor = options.thinning.cutoff * packet.start
        to_reflected = weight * reflectance
        if to_reflected > 0.0:
            to_reflected = windowed(book, to_reflected, floor, packet.key, dimension + KEEP_REFLECTED)
        to_refracted = weight * transmittance
        if to_refracted > 0.0:
            to_refracted = windowed(book, to_refracted, floor, packet.key, dimension + KEEP_REFRACTED)
        return to_reflected, to_refracted
    if options.thinning.split == ROULETTE:
        if uniform(packet.key, dimension + CHOOSE) * (reflectance + transmittance) < reflectance:
            return weight, 0.0
        return 0.0, weight
    if transmittance == 0.0:
        # Under total reflection the reflected child is the path.
        return weight, 0.0
    book[UNFOLLOWED] += weight * reflectance
    return 0.0, weight * transmittance


@kernel
def record(
    flow: Flow, frames: Array, frame: int, x: float, y: float, z: float,
    weight: float, surface: int, part: int, event: int, parent: int,
) -> int:  # fmt: skip
    """Append a vertex of a packet's path and return its number.

    Parameters
    ----------
    frame : int
        Frame of the point.
    x, y, z : float, mm
    weight : float
        Weight after the event.
    surface, part, event, parent : int
        Fields of NODE.
    """
    return record_interface(flow, frames, frame, x, y, z, weight, surface, part, event, parent, NO_SURFACE)


@kernel
def record_interface(
    flow: Flow, frames: Array, frame: int, x: float, y: float, z: float,
    weight: float, surface: int, part: int, event: int, parent: int, beyond: int,
) -> int:  # fmt: skip
    """Append a vertex at an interface, as `record` does, with the medium beyond it.

    Parameters
    ----------
    flow, frames, frame, x, y, z, weight, surface, part, event, parent
        As for `record`.
    beyond : int
        Medium that the ray enters.
    """
    top = flow.tops[NODES]
    node = flow.nodes[top]
    wx, wy, wz = move_point(frames, frame_in_table(frame), WORLD_FRAME, x, y, z)
    node.parent = parent
    node.position[0], node.position[1], node.position[2] = wx, wy, wz
    node.weight = weight
    node.surface = surface
    node.part = part
    node.event = event
    node.beyond = beyond
    flow.tops[NODES] = top + 1
    return top


@inlined
def end(
    options: Options, flow: Flow, frames: Array, packet: Any, frame: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, slot: int, status: int,
) -> None:  # fmt: skip
    """End a packet at a point: enter its weight in the book and, if ends are kept, extend `flow.ended`.

    Parameters
    ----------
    frame : int
        Frame of point and direction.
    x, y, z : float, mm
    dx, dy, dz : float
    weight : float
    slot : int
        Slot of the book.
    status : int
        `Status`.
    """
    flow.book[slot] += weight
    if options.tracing or options.record:
        _keep_end(options, flow, frames, packet, frame, x, y, z, dx, dy, dz, weight, slot, status)


@inlined
def end_here(options: Options, flow: Flow, frames: Array, packet: Any, slot: int, status: int) -> None:
    """End a packet at the start of its ray, with its weight unchanged.

    Parameters
    ----------
    options : Options
    flow : Flow
    frames : (6, 6, 3, 4) float64
    packet : PACKET
    slot : int
    status : int
    """
    end(
        options, flow, frames, packet, packet.frame, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz,
        packet.weight, slot, status,
    )  # fmt: skip


@kernel
def lose(options: Options, flow: Flow, frames: Array, packet: Any, reason: int, slot: int) -> None:
    """End a packet as lost, at the start of its ray.

    Parameters
    ----------
    reason, slot : int
        Slots of the book for the reason and the body.
    """
    flow.book[reason] += packet.weight
    end_here(options, flow, frames, packet, slot, S_LOST)


@kernel
def _keep_end(
    options: Options, flow: Flow, frames: Array, packet: Any, frame: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, slot: int, status: int,
) -> None:  # fmt: skip
    node = packet.node
    if options.record:
        node = record(
            flow, frames, frame, x, y, z, weight, ENDS_AT + slot, NO_SURFACE, EVENT_OF_STATUS[status], packet.node
        )
    kept = flow.ended[flow.tops[ENDED]]
    wx, wy, wz = move_point(frames, frame_in_table(frame), WORLD_FRAME, x, y, z)
    kept.position[0], kept.position[1], kept.position[2] = wx, wy, wz
    wx, wy, wz = move_direction(frames, frame_in_table(frame), WORLD_FRAME, dx, dy, dz)
    kept.direction[0], kept.direction[1], kept.direction[2] = wx, wy, wz
    kept.weight = weight
    kept.source = packet.source & PIXEL_MASK
    kept.status = status
    kept.events = packet.events
    kept.node = node
    kept.body = slot
    kept.colour = packet.colour
    keep_state(flow.polarised, packet, kept)
    flow.tops[ENDED] += 1


@inlined
def deposit(options: Options, flow: Flow, place: int, colour: int, weight: float) -> None:
    """Add light to a pixel: in the chunk's film (adjoint), or in the list of deposits (forward).

    Parameters
    ----------
    place : int
        Adjoint: the packet's source (pixel and sample); forward: the pixel.
    colour : int
        Forward: number of the wavelength.
    weight : float, W
    """
    if options.adjoint:
        row, sample = (place & PIXEL_MASK) - options.pixels.first_source, place >> SAMPLE_SHIFT
        flow.film[row, options.pixels.channel] += weight
        # Without a branch: each sample is counted once, when it first brings light.
        flow.hits[row, options.pixels.channel] += np.uint32(1) - flow.counted[sample]
        flow.counted[sample] = 1
        return
    entry = flow.deposits[flow.tops[DEPOSITS]]
    entry.pixel = place
    entry.colour = colour
    entry.weight = weight
    flow.tops[DEPOSITS] += 1


@kernel
def requery(
    options: Options, flow: Flow, frames: Array, station: int, packet: Any, query_from: float, missed: bool, slot: int
) -> None:
    """Queue the packet's ray for another query or, after `MAX_TRIES`, end it as lost.

    After a refused hit the query starts behind that hit. A ray that met nothing inside a closed space slipped between
    facets: it is queried from its start, with the origin shifted by a rounding error that doubles at each try.

    Parameters
    ----------
    station : int
    query_from : float, mm
        Start of the next query.
    missed : bool
        The ray met nothing; else a hit was refused.
    slot : int
        Slot of the book for a lost packet.
    """
    flow.counts[REQUERIES] += 1
    tries = abs(packet.tries)
    if tries >= MAX_TRIES:
        lose(options, flow, frames, packet, LOST_MISS if missed else LOST_CONTRADICTION, slot)
        return
    limit = packet.limit
    again = put(
        flow, station, packet, packet.frame,
        packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz,
        packet.weight, packet.key, limit if missed and packet.kind == CAMERA else query_from,
    )  # fmt: skip
    again.tries = -tries - 1 if missed else tries + 1
    again.limit = limit
    keep_chord(flow.bending, packet, again)


@inlined
def too_deep(options: Options, flow: Flow, frames: Array, packet: Any) -> bool:
    """End a packet after `max_events` events; return True if it was ended.

    Parameters
    ----------
    options : Options
    flow : Flow
    frames : (6, 6, 3, 4) float64
    packet : PACKET
    """
    if packet.events < options.max_events:
        return False
    end_here(options, flow, frames, packet, DEPTH, S_DEPTH)
    return True


@inlined
def write_query(
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    i: int,
    packet: Any,
    fold_x: float,
    fold_y: float,
) -> None:
    """Write a packet's ray in float32 for Embree.

    Parameters
    ----------
    origins, directions : (n, 3) float32
    i : int
        Row to write.
    packet : PACKET
    fold_x, fold_y : float, mm
        Subtracted from the position, to move a ray at the array into Embree's cell.
    """
    t, dx, dy, dz = packet.query_from, packet.dx, packet.dy, packet.dz
    x, y, z = packet.x + t * dx - fold_x, packet.y + t * dy - fold_y, packet.z + t * dz
    if packet.tries < 0:
        x, y, z = _jittered(packet, x, y, z)
    origins[i, 0], origins[i, 1], origins[i, 2] = np.float32(x), np.float32(y), np.float32(z)
    directions[i, 0], directions[i, 1], directions[i, 2] = np.float32(dx), np.float32(dy), np.float32(dz)


@kernel
def _jittered(packet: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a query's origin, randomly shifted by a few rounding errors along each axis, doubled at each try."""
    key, tries = packet.key, -packet.tries
    scale = abs(packet.x) + abs(packet.y) + abs(packet.z)
    aside = float(np.float32(4.0 * FLOAT32_GRAIN * scale * 2.0 ** (tries - 1)))
    x += aside * (uniform(key, -3 * tries - 2) - 0.5)
    y += aside * (uniform(key, -3 * tries - 3) - 0.5)
    z += aside * (uniform(key, -3 * tries - 4) - 0.5)
    return x, y, z


@inlined
def at_box(packet: Any) -> tuple[float, float, float]:
    """Return the point, at distance `limit`, where a packet from object space entered the box of the lens.

    If it misses the lens, it continues there: from its start it might meet the target that it left, and would cross
    media twice.

    Parameters
    ----------
    packet : PACKET
        In the camera frame.
    """
    t = max(packet.limit, 0.0)
    return packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz


@kernel
def move_packet(frames: Array, packet: Any, there: int) -> None:
    """Transform a packet's ray into the frame `there`.

    Parameters
    ----------
    frames : (6, 6, 3, 4) float64
    packet : PACKET
    there : int
    """
    here = packet.frame
    if here == there:
        return
    packet.x, packet.y, packet.z = move_point(frames, here, there, packet.x, packet.y, packet.z)
    packet.dx, packet.dy, packet.dz = move_direction(frames, here, there, packet.dx, packet.dy, packet.dz)
    packet.frame = there
