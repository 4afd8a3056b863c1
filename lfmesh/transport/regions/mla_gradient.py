"""Packets in a gradient-index plate of the microlens array.

Array frame; see `regions.mla` for the spaces.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import ray_of
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.crossing import end
from lfmesh.transport.events.gradient_cell import REACHED, cross_cells, normal_in_cell
from lfmesh.transport.events.travel import travel
from lfmesh.transport.packets.packet import NO_SURFACE, S_ABSORBED, Flow, Options
from lfmesh.transport.regions import lens_block as rows
from lfmesh.transport.regions.mla_plate import ends_on_mask, medium_of, set_local_sides, set_sides
from lfmesh.transport.tables.tables import MlaTables

Array = NDArray[np.float64]


@inlined
def meets_along_curve(
    gradient: Any, block: Array, i: int, packet: Any, mla: MlaTables, frames: Array, options: Options, flow: Flow
) -> int:
    """Follow a packet in a gradient-index plate to the face of its lenslet, and enter its hit in the block.

    It becomes the straight ray that arrives as the curve does. `NO_SURFACE`: it has ended, as at a wall of its cell.

    Parameters
    ----------
    gradient : CellGradients or None
        Gradient of `mla`; not None.
    block : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    packet : PACKET
    mla : MlaTables
        Tables of the face that it goes to.
    frames : (6, 6, 3, 4) float64
    options : Options
    flow : Flow
    """
    if gradient is None:
        return NO_SURFACE
    ray = cross_cells(gradient, mla, packet.colour, packet.column, packet.row, ray_of(packet))
    dx, dy, dz = ray.dx, ray.dy, ray.dz
    packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz = ray.x, ray.y, ray.z, dx, dy, dz
    packet.column, packet.row = ray.column, ray.row
    x, y, z = travel(flow, mla.media, packet, medium_of(mla, packet), ray.distance)
    if ray.slot != REACHED:
        end(options, flow, frames, packet, mla.frame, x, y, z, dx, dy, dz, packet.weight, ray.slot, S_ABSORBED)
        return NO_SURFACE
    nx, ny, nz = normal_in_cell(mla.lenslets, ray.column, ray.row, (x, y, z))
    block[rows.PX + i], block[rows.PY + i], block[rows.PZ + i] = x, y, z
    block[rows.DX + i], block[rows.DY + i], block[rows.DZ + i] = dx, dy, dz
    block[rows.NX + i], block[rows.NY + i], block[rows.NZ + i] = -nx, -ny, -nz
    if ends_on_mask(block, i, packet, mla, frames, options, flow):
        return NO_SURFACE
    set_sides(block, i, packet, mla, True, mla.row)
    set_local_sides(gradient, block, i, packet, mla, True)
    return mla.row
