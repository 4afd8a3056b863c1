"""Travel of a packet along its ray, through its current medium.

Packets of all regions advance only here, so absorption has one place: light decays as exp(−α d) (Bouguer, Lambert and
Beer), and the loss is entered in the book. Media without a glass body, like flames and fog, are in `events.volume`.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.packets.packet import Flow
from lfmesh.transport.tables.tables import Media


@inlined
def travel(flow: Flow, media: Media, packet: Any, medium: int, t: float) -> tuple[float, float, float]:
    """Move a packet along its ray; return the point that it reaches, mm, in its frame.

    Absorption reduces its weight.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    medium : int
    t : float, mm
    """
    return arrive(
        flow, media, packet, medium, packet.x + t * packet.dx, packet.y + t * packet.dy, packet.z + t * packet.dz
    )


@inlined
def arrive(
    flow: Flow, media: Media, packet: Any, medium: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Move a packet to a point of its ray, known more accurately than its distance; return the point.

    Parameters
    ----------
    flow : Flow
    media : Media
    packet : PACKET
    medium : int
    x, y, z : float, mm
        The point, in the packet's frame.
    """
    _absorb(media.absorption, flow, packet, medium, x, y, z)
    return x, y, z


@inlined
def _absorb(absorption: Any, flow: Flow, packet: Any, medium: int, x: float, y: float, z: float) -> None:
    """Reduce a packet's weight by absorption in its medium up to a point."""
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
    """Return the share of light that a medium transmits over a distance; 1 without absorption.

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
