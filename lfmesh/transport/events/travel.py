"""Travel of a packet along its ray, through the medium that it is in.

Packets of all regions advance here and nowhere else, so that absorption and scattering in a medium have one place. Air
and glass are transparent as yet.
"""

from typing import Any

from lfmesh.kernel import inlined
from lfmesh.transport.packets.packet import Flow
from lfmesh.transport.tables.tables import Media


@inlined
def travel(flow: Flow, media: Media, packet: Any, t: float) -> tuple[float, float, float]:
    """Let a packet travel along its ray; return the point that it reaches, mm, in its frame.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    t : float, mm
        Distance.
    """
    return arrive(flow, media, packet, packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz)


@inlined
def arrive(flow: Flow, media: Media, packet: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Let a packet travel to a point of its ray that is known more accurately than its distance; return the point.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    x, y, z : float, mm
        The point, in the packet's frame.
    """
    return x, y, z
