"""How a packet advances along its ray, through the medium that it is in.

The only place where that happens to a packet: what a medium takes from light, or turns aside, on its way is done here,
whatever region the packet is in. Air and glass as they are leave it as it is.
"""

from typing import Any

from lfmesh.kernel import inlined
from lfmesh.transport.packets.packet import Flow
from lfmesh.transport.tables.tables import Media


@inlined
def travel(flow: Flow, media: Media, packet: Any, t: float) -> tuple[float, float, float]:
    """Let a packet travel a distance along its ray, in mm; return where it comes to, in its frame."""
    return arrive(flow, media, packet, packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz)


@inlined
def arrive(flow: Flow, media: Media, packet: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Let a packet travel to a point of its ray that is known more closely than by its distance; return the point."""
    return x, y, z
