"""Travel of a packet along its ray, through the medium that it is in.

Packets of all regions advance here and nowhere else, so that absorption in a medium has one place: light decays as
exp(−α d) (Bouguer, Lambert and Beer), and what is taken is entered in the book. Media without a shape of glass, like
flames and fog, are in `events.volume`.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.packets.packet import Flow
from lfmesh.transport.tables.tables import Media


@inlined
def travel(flow: Flow, media: Media, packet: Any, medium: int, t: float) -> tuple[float, float, float]:
    """Let a packet travel along its ray; return the point that it reaches, mm, in its frame.

    Its weight becomes what is left there.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    medium : int
        Number of the medium that it travels in.
    t : float, mm
        Distance.
    """
    return arrive(
        flow, media, packet, medium, packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    )


@inlined
def arrive(
    flow: Flow, media: Media, packet: Any, medium: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Let a packet travel to a point of its ray that is known more accurately than its distance; return the point.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    medium : int
        Number of the medium that it travels in.
    x, y, z : float, mm
        The point, in the packet's frame.
    """
    _absorb(media.absorption, flow, packet, medium, x, y, z)
    return x, y, z


@inlined
def _absorb(absorption: Any, flow: Flow, packet: Any, medium: int, x: float, y: float, z: float) -> None:
    """Take from a packet what its medium absorbs up to a point."""
    if absorption is None:
        return
    if absorption.per_mm[medium, packet.colour] > 0.0:
        ex, ey, ez = x - packet.x, y - packet.y, z - packet.z
        distance = np.sqrt(ex * ex + ey * ey + ez * ez)
        left = packet.weight * transmitted(absorption, medium, packet.colour, distance)
        flow.book[absorption.slot[medium]] += packet.weight - left
        packet.weight = left


@inlined
def transmitted(absorption: Any, medium: int, colour: int, distance: float) -> float:
    """Return the share of the light that a medium transmits over a distance; all of it where nothing absorbs.

    Parameters
    ----------
    absorption : Absorption or None
    medium, colour : int
        Numbers of the medium and of the wavelength.
    distance : float, mm
        May be infinite.
    """
    if absorption is None:
        return 1.0
    coefficient = absorption.per_mm[medium, colour]
    return np.exp(-coefficient * distance) if coefficient > 0.0 else 1.0
