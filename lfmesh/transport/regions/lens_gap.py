"""Packets in a space of the lens that gradient-index glass fills: one by one to the wall at the end of their curve.

The next face is known by its order, with and without meshes. All in the camera frame.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.ray import ray_of
from lfmesh.geometry.surfaces.surface import normal_at
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.crossing import end
from lfmesh.transport.events.gradient import AT_EDGE, ON_OTHER_FACE, TRAPPED_INSIDE, cross_gap, index_at
from lfmesh.transport.events.travel import travel
from lfmesh.transport.packets.book import TRAPPED
from lfmesh.transport.packets.packet import CAMERA_FRAME, NO_SURFACE, S_ABSORBED, Flow, Options
from lfmesh.transport.regions.lens_block import N_I, N_T, NUMBER, NX, NY, NZ, PX, PY, PZ, SIZE, set_ray
from lfmesh.transport.regions.lens_exits import is_cut
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]


@inlined
def decide_in_gap(
    gradients: Any, block: Array, i: int, packet: Any, lens: LensTables, frames: Array, options: Options, flow: Flow
) -> int:  # fmt: skip
    """Enter the straight ray that ends as a packet's curve, and its hit, in the block; return the surface.

    A packet that turns back meets the surface that it comes from. `NO_SURFACE`: it has ended on the edge or a mount, or
    is trapped.

    Parameters
    ----------
    gradients : GradientSpaces or None
        None: numba skips this code.
    block : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    packet : PACKET
    lens : LensTables
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    if gradients is None:
        return NO_SURFACE
    space = packet.space
    _, _, along = direction_through(gradients.unpose[space], packet.dx, packet.dy, packet.dz)
    k = space if along > 0.0 else space - 1
    found = cross_gap(lens, space, packet.colour, k, ray_of(packet))
    packet.x, packet.y, packet.z = found.x, found.y, found.z
    packet.dx, packet.dy, packet.dz = found.dx, found.dy, found.dz
    if found.fate in (AT_EDGE, TRAPPED_INSIDE):
        slot = lens.ring_slot[space] if found.fate == AT_EDGE else TRAPPED
        x, y, z = travel(flow, lens.media, packet, lens.medium[space], found.distance)
        end(
            options, flow, frames, packet, CAMERA_FRAME, x, y, z, packet.dx, packet.dy, packet.dz, packet.weight, slot,
            S_ABSORBED,
        )  # fmt: skip
        return NO_SURFACE
    if found.fate == ON_OTHER_FACE:
        k = 2 * space - 1 - k
    t = found.distance
    x, y, z = packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    if is_cut(options, flow, frames, lens, packet, k, t, x, y, z):
        return NO_SURFACE
    set_ray(block, i, packet)
    block[PX + i], block[PY + i], block[PZ + i], block[NUMBER + i] = x, y, z, k
    block[N_I + i] = index_at(lens, space, packet.colour, x, y, z)
    block[N_T + i] = index_at(lens, k + 1 if k == space else k, packet.colour, x, y, z)
    surface, sense = lens.surfaces[k], 1.0 if k == space else -1.0
    if surface.posed:
        x, y, z = point_through(surface.unpose, x, y, z)
    nx, ny, nz = normal_at(surface, x, y, z - surface.vertex_z)
    if surface.posed:
        nx, ny, nz = direction_through(surface.pose, nx, ny, nz)
    block[NX + i], block[NY + i], block[NZ + i] = sense * nx, sense * ny, sense * nz
    # The children's queries have no facet to clear.
    block[SIZE + i] = 0.0
    return k


@inlined
def set_index_behind_face(gradients: Any, block: Array, i: int, packet: Any, k: int, lens: LensTables) -> None:
    """Enter the index behind surface `k` at the hit, if a packet enters gradient-index glass there.

    Parameters
    ----------
    gradients : GradientSpaces or None
        None: numba skips this code.
    block : (ROWS · BLOCK,) float64
    i : int
    packet : PACKET
    k : int
        `NO_SURFACE`: there is no hit.
    lens : LensTables
    """
    if gradients is None:
        return
    if k == NO_SURFACE:
        return
    beyond = k + 1 if k == packet.space else k
    if gradients.number[beyond] >= 0:
        block[N_T + i] = index_at(lens, beyond, packet.colour, block[PX + i], block[PY + i], block[PZ + i])
