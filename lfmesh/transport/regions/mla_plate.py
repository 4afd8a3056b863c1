"""The plate of the microlens array with its flat face, and operations shared by both faces.

Array frame; see `regions.mla` for the spaces.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import cell_of, centre, is_inside, stays_inside
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.crossing import end, end_here, move_packet, too_deep
from lfmesh.transport.events.gradient_cell import has_gradient, index_in_cell
from lfmesh.transport.events.interface import divided, is_rough, scattered, scatterer, splitter
from lfmesh.transport.events.polarisation import IN_ARRAY, shares_by_state
from lfmesh.transport.events.travel import transmitted, travel
from lfmesh.transport.packets.book import MLA_EDGE, MLA_MASK, MLA_MOUNT
from lfmesh.transport.packets.packet import (
    BACK_FRAME,
    FLAT_FACE,
    LEFT_FACE,
    LENS,
    MLA_FRAME,
    NO_SURFACE,
    S_ABSORBED,
    SENSOR,
    Flow,
    Options,
    put,
)
from lfmesh.transport.regions import lens_block as rows
from lfmesh.transport.regions.lens_block import BLOCK, incidence, split_block
from lfmesh.transport.tables.tables import AIR, FLAT_ROW, MlaTables

Array = NDArray[np.float64]


BEFORE, GLASS, BEHIND = 0, 1, 2


@inlined
def medium_of(mla: MlaTables, packet: Any) -> int:
    """Return the number of a packet's medium."""
    return mla.medium if packet.space == GLASS else AIR


@inlined
def _left_in_glass(absorption: Any, flow: Flow, medium: int, colour: int, weight: float, distance: float) -> float:
    """Return a weight after a distance in glass, mm; the book takes the loss."""
    if absorption is None:
        return weight
    left = weight * transmitted(absorption, medium, colour, distance)
    if left < weight:
        flow.book[absorption.slot[medium]] += weight - left
    return left


@inlined
def leave_mla(
    flow: Flow, packet: Any, frame: int, x: float, y: float, z: float, dx: float, dy: float, dz: float,
    weight: float, key: np.uint64, to_lens: bool, lens_surfaces: int,
) -> None:  # fmt: skip
    """Queue a packet that has left the array, for the lens or for the sensor.

    Parameters
    ----------
    flow : Flow
    packet : PACKET
    frame : int
        Frame of the face that it left.
    x, y, z : float, mm
        Point on the face.
    dx, dy, dz : float
    weight : float
    key : uint64
    to_lens : bool
        To the lens; else to the sensor.
    lens_surfaces : int
        Refracting surfaces of the lens.
    """
    child = put(flow, LENS if to_lens else SENSOR, packet, frame, x, y, z, dx, dy, dz, weight, key, 0.0)
    child.space = lens_surfaces


@inlined
def into_layer(
    options: Options, flow: Flow, frames: Array, mla: MlaTables, packet: Any,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64, space: int,
) -> None:  # fmt: skip
    """Queue a packet in the cell where it enters the layer of curved faces.

    It ends on the mount or the array's edge if it misses the array.

    Parameters
    ----------
    space : int
        Space it comes from: `BEFORE` or `GLASS`.
    """
    if space == GLASS and has_gradient(mla.gradient):
        # It stays in the cell where it entered the plate.
        child = put(flow, mla.cells, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, 0.0)
        child.space = GLASS
        return
    lenslets = mla.lenslets
    border = lenslets.top if space == BEFORE else lenslets.valley
    t = max(0.0, (border - z) / dz)
    column, row = cell_of(lenslets.lattice, x + t * dx, y + t * dy)
    held = is_inside(lenslets.lattice, column, row)
    if space == GLASS:
        held = stays_inside(lenslets.lattice, x, y, x + t * dx, y + t * dy)
    if not held:
        if space == GLASS:
            weight = _left_in_glass(mla.media.absorption, flow, mla.medium, packet.colour, weight, t)
        end(
            options, flow, frames, packet, mla.frame, x + t * dx, y + t * dy, z + t * dz, dx, dy, dz,
            weight, MLA_MOUNT if space == BEFORE else MLA_EDGE, S_ABSORBED,
        )  # fmt: skip
        return
    child = put(flow, mla.cells, packet, mla.frame, x, y, z, dx, dy, dz, weight, key, t)
    child.space, child.column, child.row = space, column, row


@inlined
def _send_from_flat_face(
    place: Any, options: Options, flow: Flow, frames: Array, packet: Any, refracts: bool,
    x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float, key: np.uint64,
) -> None:  # fmt: skip
    """Queue a child of a packet at the flat face that the parent met from the glass (`outward`) or from outside."""
    mla, lens_surfaces, outward = place
    if refracts == outward:
        leave_mla(flow, packet, MLA_FRAME, x, y, z, dx, dy, dz, weight, key, not mla.curved_to_lens, lens_surfaces)
    else:
        into_layer(options, flow, frames, mla, packet, x, y, z, dx, dy, dz, weight, key, GLASS)


_split_at_flat_face = splitter(_send_from_flat_face)


_scatter_at_flat_face = scatterer(_send_from_flat_face)


@kernel
def through_plate(
    wave: NDArray[np.void], block: Array, met: NDArray[np.int64],
    mla: MlaTables, frames: Array, lens_surfaces: int, options: Options, flow: Flow,
) -> None:  # fmt: skip
    """Move a wave of packets into the layer of curved faces, or split them at the flat face.

    Parameters
    ----------
    wave : (n,) PACKET
    block : (ROWS · BLOCK,) float64
    met : (BLOCK,) int64
        Working memory.
    lens_surfaces : int
    """
    for first in range(0, len(wave), BLOCK):
        count = min(BLOCK, len(wave) - first)
        for i in range(count):
            met[i] = _reaches_flat_face(block, i, wave[first + i], mla, frames, options, flow)
        split_block(block)
        for i in range(count):
            if met[i] != NO_SURFACE:
                packet = wave[first + i]
                outward = packet.space == GLASS
                if mla.interfaces.rough and is_rough(mla.interfaces, FLAT_ROW):
                    passes, dx, dy, dz = scattered_at_face(block, i, packet, mla, FLAT_ROW, options)
                    _scatter_at_flat_face(
                        (mla, lens_surfaces, outward), options, flow, frames, MLA_FRAME, packet, FLAT_FACE, NO_SURFACE,
                        AIR if outward else mla.medium, block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i],
                        passes, dx, dy, dz,
                    )  # fmt: skip
                    continue
                reflectance, transmittance = shares_at_face(block, i, packet, mla, frames, FLAT_ROW, outward, flow)
                r, t = rows.REFLECTED + i, rows.REFRACTED + i
                _split_at_flat_face(
                    (mla, lens_surfaces, outward), options, flow, frames, MLA_FRAME, packet, FLAT_FACE, NO_SURFACE,
                    AIR if outward else mla.medium, block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i],
                    reflectance, transmittance,
                    (block[r + rows.ALONG_X], block[r + rows.ALONG_Y], block[r + rows.ALONG_Z]),
                    (block[t + rows.ALONG_X], block[t + rows.ALONG_Y], block[t + rows.ALONG_Z]),
                )  # fmt: skip


@inlined
def _reaches_flat_face(
    block: Array, i: int, packet: Any, mla: MlaTables, frames: Array, options: Options, flow: Flow
) -> int:
    """Enter a packet's hit on the flat face in the block; `NO_SURFACE`: it has ended or is in the layer."""
    lenslets = mla.lenslets
    thickness = lenslets.thickness
    if _goes_to_lenslets(mla.back, mla, packet, frames, options, flow):
        return NO_SURFACE
    if packet.frame != MLA_FRAME:
        move_packet(frames, packet, MLA_FRAME)
        if packet.dz > 0.0 and packet.z <= lenslets.valley:
            into_layer(
                options, flow, frames, mla, packet, packet.x, packet.y, packet.z,
                packet.dx, packet.dy, packet.dz, packet.weight, packet.key, BEFORE,
            )  # fmt: skip
            return NO_SURFACE
        if not (packet.dz < 0.0 and packet.z >= thickness):
            end_here(options, flow, frames, packet, MLA_MOUNT, S_ABSORBED)
            return NO_SURFACE
        packet.space = BEHIND
    if too_deep(options, flow, frames, packet):
        return NO_SURFACE
    dx, dy, dz = packet.dx, packet.dy, packet.dz
    t = (thickness - packet.z) / dz
    x, y, _ = travel(flow, mla.media, packet, medium_of(mla, packet), t)
    outward = packet.space == GLASS
    if outward:
        held = stays_inside(lenslets.lattice, packet.x, packet.y, x, y)
    else:
        column, row = cell_of(lenslets.lattice, x, y)
        held = is_inside(lenslets.lattice, column, row)
    if not held:
        slot = MLA_EDGE if outward else MLA_MOUNT
        end(options, flow, frames, packet, MLA_FRAME, x, y, thickness, dx, dy, dz, packet.weight, slot, S_ABSORBED)
        return NO_SURFACE
    if packet.last == LEFT_FACE:
        packet.last = NO_SURFACE
    block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i] = dx, dy, dz
    block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i] = x, y, thickness
    block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i] = 0.0, 0.0, 1.0 if dz > 0.0 else -1.0
    set_sides(block, i, packet, mla, outward, FLAT_ROW)
    return FLAT_ROW


@inlined
def _goes_to_lenslets(back: Any, mla: MlaTables, packet: Any, frames: Array, options: Options, flow: Flow) -> bool:
    """In an array with lenslets on both faces, queue a packet in the layer ahead; else return False.

    Parameters
    ----------
    back : MlaTables, or None
        `mla.back`.
    """
    if back is None:
        return False
    in_glass = packet.frame == MLA_FRAME or packet.frame == BACK_FRAME
    if packet.last == LEFT_FACE:
        packet.last = NO_SURFACE
    if packet.frame == MLA_FRAME:
        move_packet(frames, packet, BACK_FRAME)
        _into_next_layer(options, flow, frames, back, packet, GLASS)
        return True
    move_packet(frames, packet, MLA_FRAME)
    if in_glass:
        _into_next_layer(options, flow, frames, mla, packet, GLASS)
    elif packet.dz > 0.0 and packet.z <= mla.lenslets.valley:
        _into_next_layer(options, flow, frames, mla, packet, BEFORE)
    else:
        move_packet(frames, packet, BACK_FRAME)
        if packet.dz > 0.0 and packet.z <= back.lenslets.valley:
            _into_next_layer(options, flow, frames, back, packet, BEFORE)
        else:
            end_here(options, flow, frames, packet, MLA_MOUNT, S_ABSORBED)
    return True


@kernel
def _into_next_layer(
    options: Options, flow: Flow, frames: Array, mla: MlaTables, packet: Any, space: int
) -> None:  # fmt: skip
    """Move a packet, given in the frame of the lenslets, into their layer."""
    into_layer(
        options, flow, frames, mla, packet, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz,
        packet.weight, packet.key, space,
    )  # fmt: skip


@inlined
def ends_on_mask(
    block: Array, i: int, packet: Any, mla: MlaTables, frames: Array, options: Options, flow: Flow
) -> bool:
    """End a packet that meets its lenslet outside the clear aperture; return True if it does.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
        With the hit.
    i : int
    packet : PACKET
    mla : MlaTables
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    clear_radius = mla.lenslets.clear_radius
    if clear_radius == np.inf:
        return False
    cx, cy = centre(mla.lenslets.lattice, packet.column, packet.row)
    px, py = block[rows.PX + i], block[rows.PY + i]
    x, y = px - cx, py - cy
    hidden = not x * x + y * y <= clear_radius * clear_radius
    if hidden:
        end(
            options, flow, frames, packet, mla.frame, px, py, block[rows.PZ + i],
            packet.dx, packet.dy, packet.dz, packet.weight, MLA_MASK, S_ABSORBED,
        )  # fmt: skip
    return hidden


@inlined
def shares_at_face(
    block: Array, i: int, packet: Any, mla: MlaTables, frames: Array, number: int, outward: bool, flow: Flow
) -> tuple[float, float]:
    """Return a packet's reflected and transmitted shares at a face, after absorption in its coating.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    packet : PACKET
    mla : MlaTables
    frames : (6, 6, 3, 4) float64
    number : int
        Row of the interface.
    outward : bool
        Light comes from the glass.
    flow : Flow
    """
    reflectance, transmittance = block[rows.REFLECTANCE + i], block[rows.TRANSMITTANCE + i]
    if mla.interfaces.coated:
        n_i, n_t = block[rows.N_I + i], block[rows.N_T + i]
        reflectance, transmittance, _ = divided(
            mla.interfaces, number, packet.colour, n_i, n_t, incidence(block, i), outward, packet, flow.book
        )
    return shares_by_state(
        flow.polarised, IN_ARRAY, number, outward, block[rows.N_I + i], block[rows.N_T + i], incidence(block, i),
        (block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i]), frames, mla.frame, packet, flow.book,
        reflectance, transmittance,
    )  # fmt: skip


@inlined
def scattered_at_face(
    block: Array, i: int, packet: Any, mla: MlaTables, number: int, options: Options
) -> tuple[bool, float, float, float]:
    """Return whether a rough face transmits a packet of a block, and its new direction.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    packet : PACKET
    mla : MlaTables
    number : int
        As for `shares_at_face`.
    options : Options
    """
    return scattered(
        mla.interfaces, number, options, packet, block[rows.N_I + i], block[rows.N_T + i],
        (block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i]),
    )  # fmt: skip


@inlined
def set_sides(block: Array, i: int, packet: Any, mla: MlaTables, outward: bool, number: int) -> None:
    """Enter a face as an interface, with the indices on both sides.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    packet : PACKET
    mla : MlaTables
    outward : bool
        Light comes from the glass.
    number : int
        Row of the interface.
    """
    glass, outside = mla.media.indices[mla.medium, packet.colour], mla.media.indices[AIR, packet.colour]
    block[rows.N_I + i], block[rows.N_T + i] = (glass, outside) if outward else (outside, glass)
    block[rows.NUMBER + i] = number


@inlined
def set_local_sides(gradient: Any, block: Array, i: int, packet: Any, mla: MlaTables, outward: bool) -> None:
    """Enter the indices on both sides of the face of a gradient-index plate at a packet's hit.

    Parameters
    ----------
    gradient : CellGradients or None
        Gradient of `mla`; None changes nothing.
    block : (ROWS · BLOCK,) float64
        With the hit.
    i : int
    packet : PACKET
    mla : MlaTables
    outward : bool
        Light comes from the glass.
    """
    if gradient is None:
        return
    point = block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i]
    glass = index_in_cell(gradient, mla, packet.colour, packet.column, packet.row, point)
    outside = mla.media.indices[AIR, packet.colour]
    block[rows.N_I + i], block[rows.N_T + i] = (glass, outside) if outward else (outside, glass)
