"""Division of packets at surfaces of the lens, and their exits: to object space, array, sensor, stop or ring.

All in the camera frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import at_box, end, end_here, thinned
from lfmesh.transport.events.gradient import in_gradient
from lfmesh.transport.events.interface import (
    divided,
    is_rough,
    is_thin_lens,
    scattered,
    scatterer,
    splitter,
    through_thin_lens,
)
from lfmesh.transport.events.phase import light_at_phase, order_splitter
from lfmesh.transport.events.polarisation import IN_LENS, shares_by_state
from lfmesh.transport.events.travel import arrive, travel
from lfmesh.transport.packets.book import HOUSING, STOP, THIN_LENSES
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    LEFT_LENS,
    LENS,
    LENS_MESH,
    NO_SURFACE,
    OBJECTS,
    PLATE,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.paths.automaton import FACE_AGAIN, FACE_AGAIN_ALONG_CURVE, OUT_OF_LENS, cutoff_at_child
from lfmesh.transport.regions.lens_block import (
    ALONG_X,
    ALONG_Y,
    ALONG_Z,
    CLEAR,
    N_I,
    N_T,
    NX,
    NY,
    NZ,
    PX,
    PY,
    PZ,
    REFLECTANCE,
    REFLECTED,
    REFRACTED,
    TRANSMITTANCE,
    incidence,
    set_child,
)
from lfmesh.transport.regions.lens_hits import radius2_at
from lfmesh.transport.tables.tables import AIR, LensTables

Array = NDArray[np.float64]


@kernel
def stop_cuts(
    lens: LensTables, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[bool, float]:  # fmt: skip
    """Return whether the line of a ray crosses the plane of the stop outside its aperture, and the distance, mm.

    A ray parallel to the plane is cut, at distance 0.

    Parameters
    ----------
    lens : LensTables
    x, y, z : float, mm, camera frame
    dx, dy, dz : float
    """
    if lens.stop_posed:
        x, y, z = point_through(lens.stop_unpose, x, y, z)
        dx, dy, dz = direction_through(lens.stop_unpose, dx, dy, dz)
    if dz == 0.0:
        return True, 0.0
    t = (lens.stop_z - z) / dz
    px, py = x + t * dx, y + t * dy
    return not px * px + py * py <= lens.stop_radius * lens.stop_radius, t


@kernel
def leave_lens(
    options: Options, flow: Flow, frames: Array, lens: LensTables, has_mla: bool, packet: Any,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64, space: int,
    query_from: float,
) -> None:  # fmt: skip
    """Queue a packet that has left the lens for object space, the array or, without an array, the sensor.

    It ends on a stop on its side of the lens if it misses the aperture.

    Parameters
    ----------
    space : int
        In front of the lens (0) or behind it.
    query_from : float, mm
        Start of the next query along the ray.
    """
    if lens.stop_space == space:
        cuts, t = stop_cuts(lens, x, y, z, dx, dy, dz)
        if cuts:
            end(
                options, flow, frames, packet, CAMERA_FRAME, x + t * dx, y + t * dy, z + t * dz, dx, dy, dz,
                weight, STOP, S_ABSORBED,
            )  # fmt: skip
            return
    station = OBJECTS if space == 0 else (PLATE if has_mla else SENSOR)
    child = put(flow, station, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, weight, key, query_from)
    child.last = LEFT_LENS
    child.facet = NO_SURFACE
    if space == 0:
        child.bodies, child.medium = NO_SURFACE, AIR
        child.path = OUT_OF_LENS[packet.path]


@inlined
def _leaves_for_good(lens: LensTables, into: int, dz: float) -> bool:
    """Tell whether a ray from an outermost surface leaves the lens and cannot meet it again.

    True if the surface bulges outwards, or the ray is steeper than it everywhere. Refraction does not matter, so this
    holds for rays that a finish or a phase turns as well.
    """
    last = len(lens.surfaces)
    return (into == 0 and (lens.convex_front or -dz > lens.order[0, 11])) or (
        into == last and (lens.convex_back or dz > lens.order[last, 10])
    )


@inlined
def _send_child(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at surface `k`; if it cannot meet the lens again, send it out of the lens."""
    block, i, k, space, lens, has_mla = place
    into = (k + 1 if k == space else k) if refracts else space
    leaves = _leaves_for_good(lens, into, dz)
    cutoff = cutoff_at_child(options, leaves and into == 0, refracts, packet)
    if cutoff > 0.0:
        weight = thinned(cutoff, flow.book, packet, weight, key)
        if weight == 0.0:
            return
    if leaves:
        packet.space = into
        leave_lens(options, flow, frames, lens, has_mla, packet, x, y, z, dx, dy, dz, weight, key, into, 0.0)
    else:
        clear = block[(REFRACTED if refracts else REFLECTED) + i + CLEAR]
        station = LENS if lens.ordered[into] else LENS_MESH
        sent = put(flow, station, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, weight, key, clear)
        sent.last, sent.space = k, into


_split = splitter(_send_child)


_send_scattered = scatterer(_send_child)


@inlined
def _send_order(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue the child of a packet in an order of the phase of surface `k`; its direction is in the surface's frame."""
    block, i, k, _, lens, _ = place
    if lens.surfaces[k].posed:
        dx, dy, dz = direction_through(lens.surfaces[k].pose, dx, dy, dz)
    set_child(block, (REFRACTED if refracts else REFLECTED) + i, i, dx, dy, dz)
    _send_child(place, options, flow, frames, packet, refracts, x, y, z, dx, dy, dz, weight, key)


_split_orders = order_splitter(_send_order)


@inlined
def divide_at_surface(
    block: Array, i: int, packet: Any, k: int,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Divide a packet of a block at surface `k`.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    packet : PACKET
    k : int
        Number of the surface.
    lens : LensTables
    has_mla : bool
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    r, t = REFLECTED + i, REFRACTED + i
    if packet.last == k:
        curved = in_gradient(lens.gradients, packet.space)
        packet.path = FACE_AGAIN_ALONG_CURVE[packet.path] if curved else FACE_AGAIN[packet.path]
    x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], block[PX + i], block[PY + i], block[PZ + i])
    if _divided_by_phase(lens.interfaces.phases, block, i, packet, k, lens, has_mla, frames, options, flow, (x, y, z)):
        return
    reflectance, transmittance = block[REFLECTANCE + i], block[TRANSMITTANCE + i]
    if lens.interfaces.coated:
        n_i, n_t = block[N_I + i], block[N_T + i]
        if is_rough(lens.interfaces, k):
            passes, dx, dy, dz = scattered(
                lens.interfaces, k, options, packet, n_i, n_t, (block[NX + i], block[NY + i], block[NZ + i])
            )
            set_child(block, REFRACTED + i if passes else REFLECTED + i, i, dx, dy, dz)
            _send_scattered(
                (block, i, k, packet.space, lens, has_mla), options, flow, frames, CAMERA_FRAME, packet, k, NO_SURFACE,
                lens.medium[k + 1 if k == packet.space else k], x, y, z, passes, dx, dy, dz,
            )  # fmt: skip
            return
        if is_thin_lens(lens.interfaces, k):
            _bend_by_thin_lens(block, i, packet, k, lens, options, flow, x, y, z)
        else:
            reflectance, transmittance, _ = divided(
                lens.interfaces, k, packet.colour, n_i, n_t, incidence(block, i), k != packet.space, packet, flow.book
            )
    reflectance, transmittance = shares_by_state(
        flow.polarised, IN_LENS, k, k != packet.space, block[N_I + i], block[N_T + i], incidence(block, i),
        (block[NX + i], block[NY + i], block[NZ + i]), frames, CAMERA_FRAME, packet, flow.book,
        reflectance, transmittance,
    )  # fmt: skip
    _split(
        (block, i, k, packet.space, lens, has_mla), options, flow, frames, CAMERA_FRAME, packet, k, NO_SURFACE,
        lens.medium[k + 1 if k == packet.space else k], x, y, z, reflectance, transmittance,
        (block[r + ALONG_X], block[r + ALONG_Y], block[r + ALONG_Z]),
        (block[t + ALONG_X], block[t + ALONG_Y], block[t + ALONG_Z]),
    )  # fmt: skip


@inlined
def _divided_by_phase(
    phases: Any, block: Array, i: int, packet: Any, k: int,
    lens: LensTables, has_mla: bool, frames: Array, options: Options, flow: Flow, place: tuple[float, float, float],
) -> bool:  # fmt: skip
    """Divide a packet of a block into the orders of surface `k`; return False if it has no phase.

    Parameters
    ----------
    phases : PhaseFaces or None
        None: no surface of the lens has one.
    place : (3,) float, mm, camera frame
        Point on the surface.
    """
    if phases is None:
        return False
    if phases.number[k] < 0:
        return False
    (x, y, z), surface = place, lens.surfaces[k]
    px, py, dx, dy, dz = x, y, packet.dx, packet.dy, packet.dz
    nx, ny, nz = block[NX + i], block[NY + i], block[NZ + i]
    if surface.posed:
        px, py, _ = point_through(surface.unpose, x, y, z)
        dx, dy, dz = direction_through(surface.unpose, dx, dy, dz)
        nx, ny, nz = direction_through(surface.unpose, nx, ny, nz)
    light = light_at_phase(
        lens.interfaces, phases, k, packet.colour, (block[N_I + i], block[N_T + i]), (dx, dy, dz), (nx, ny, nz),
        (px, py), k != packet.space,
    )  # fmt: skip
    _split_orders(
        (block, i, k, packet.space, lens, has_mla), options, flow, frames, CAMERA_FRAME, packet, k, NO_SURFACE,
        lens.medium[k + 1 if k == packet.space else k], x, y, z, lens.interfaces, phases, light,
    )  # fmt: skip
    return True


@kernel
def _bend_by_thin_lens(
    block: Array, i: int, packet: Any, k: int, lens: LensTables, options: Options, flow: Flow,
    x: float, y: float, z: float,
) -> None:  # fmt: skip
    """Enter the direction of the refracted child behind a thin lens; scale importance by the étendue."""
    surface, dx, dy, dz = lens.surfaces[k], packet.dx, packet.dy, packet.dz
    if surface.posed:
        x, y, z = point_through(surface.unpose, x, y, z)
        dx, dy, dz = direction_through(surface.unpose, dx, dy, dz)
    dx, dy, dz, factor = through_thin_lens(lens.interfaces, k, packet.colour, x, y, (dx, dy, dz))
    if surface.posed:
        dx, dy, dz = direction_through(surface.pose, dx, dy, dz)
    set_child(block, REFRACTED + i, i, dx, dy, dz)
    if options.importance:
        flow.book[THIN_LENSES] += packet.weight * (1.0 - factor)
        packet.weight *= factor


@kernel
def pass_by(options: Options, flow: Flow, frames: Array, lens: LensTables, has_mla: bool, packet: Any) -> None:
    """Send a packet that met nothing out of the lens, or end it on the housing.

    Parameters
    ----------
    options : Options
    flow : Flow
    frames : (6, 6, 3, 4) float64
    lens : LensTables
    has_mla : bool
    packet : PACKET
    """
    if packet.space == 0 or packet.dz > 0.0:
        from_outside = packet.space == 0 and packet.last == NO_SURFACE
        x, y, z = at_box(packet) if from_outside else (packet.x, packet.y, packet.z)
        leave_lens(
            options, flow, frames, lens, has_mla, packet, x, y, z, packet.dx, packet.dy, packet.dz, packet.weight,
            packet.key, packet.space, 0.0 if from_outside else packet.limit,
        )  # fmt: skip
    else:
        end_here(options, flow, frames, packet, HOUSING, S_ABSORBED)


@kernel
def absorb_at_ring(options: Options, flow: Flow, frames: Array, lens: LensTables, packet: Any, t: float) -> None:
    """Absorb a packet at the ring of its space (lens edge or mount), or at the stop if that comes first.

    Parameters
    ----------
    options : Options
    flow : Flow
    frames : (6, 6, 3, 4) float64
    lens : LensTables
    packet : PACKET
    t : float, mm
        Distance of the ring.
    """
    slot = lens.ring_slot[packet.space]
    x, y, z = packet.x, packet.y, packet.z
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    if lens.stop_space == packet.space:
        cuts, at = stop_cuts(lens, x, y, z, dx, dy, dz)
        if cuts and 0.0 < at < t:
            slot, t = STOP, at
    x, y, z = travel(flow, lens.media, packet, lens.medium[packet.space], t)
    end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, slot, S_ABSORBED)


@kernel
def is_cut(
    options: Options, flow: Flow, frames: Array, lens: LensTables, packet: Any,
    k: int, t: float, x: float, y: float, z: float,
) -> bool:  # fmt: skip
    """Absorb a packet at the stop of its space, or at the mount around surface `k`; return True if absorbed.

    Parameters
    ----------
    options, flow, frames, lens, packet
        As for `divide_at_surface`.
    k : int
        Number of the surface.
    t : float, mm
        Distance of the surface.
    x, y, z : float, mm
        Hit.
    """
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    space = packet.space
    if lens.stop_space == space and packet.last != k:
        cuts, at = stop_cuts(lens, x, y, z, dx, dy, dz)
        # A ray that a user starts behind the stop does not cross it.
        if cuts and (packet.last != NO_SURFACE or space == 0 or space == len(lens.surfaces) or -t < at < 0.0):
            x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], x + at * dx, y + at * dy, z + at * dz)
            end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, STOP, S_ABSORBED)
            return True
    rim = lens.surfaces[k].semi_diameter
    if radius2_at(lens.surfaces[k], x, y, z) > rim * rim:
        slot = lens.mount_slot[k]
        x, y, z = arrive(flow, lens.media, packet, lens.medium[packet.space], x, y, z)
        end(options, flow, frames, packet, CAMERA_FRAME, x, y, z, dx, dy, dz, packet.weight, slot, S_ABSORBED)
        return True
    return False
