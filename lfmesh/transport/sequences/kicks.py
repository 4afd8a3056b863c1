"""Deflections by diffraction in bundles, drawn at the aperture or in advance."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.kick import is_first_kick, kick_by_key, kick_of_packet, turned
from lfmesh.transport.packets.book import EVANESCENT
from lfmesh.transport.packets.packet import PixelSamples
from lfmesh.transport.sequences import bundle as rows
from lfmesh.transport.sequences.bundle import EVENTS_BEFORE, KEY, KICK_AT, KICK_X, KICK_Y, MET
from lfmesh.transport.tables.tables import Apertures

Array = NDArray[np.float64]


@inlined
def give_keys(apertures: Any, wave: NDArray[np.void], count: int, bundle: Array, numbers: NDArray[np.int64]) -> None:
    """Set each ray's key and event count, for random numbers of diffraction.

    Parameters
    ----------
    apertures : Apertures or None
    wave, count, bundle, numbers
        As for `image_path.follow_block`.
    """
    if apertures is None:
        return
    keys = bundle.view(np.uint64)
    for i in range(count):
        keys[KEY + i], bundle[EVENTS_BEFORE + i] = wave[numbers[i]].key, wave[numbers[i]].events


@inlined
def draw_kick(apertures: Any, pixels: PixelSamples, packet: Any, bundle: Array, i: int) -> None:
    """Draw in advance the later deflection of a packet from a pixel, by its starting numbers.

    Parameters
    ----------
    apertures : Apertures or None
    pixels : PixelSamples
    packet : PACKET
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place of the packet's ray in the block.
    """
    if apertures is None:
        return
    at = -1.0
    if is_first_kick(apertures, pixels, apertures.events) and packet.events <= apertures.events:
        kick = kick_of_packet(apertures, pixels, packet, packet.key, apertures.events)
        bundle[KICK_X + i], bundle[KICK_Y + i] = kick
        at = float(apertures.events)
    bundle[KICK_AT + i] = at


@inlined
def kick_of_ray(apertures: Apertures, bundle: Array, i: int, colour: int) -> tuple[float, float]:
    """Return the deflection of a ray at an aperture.

    Parameters
    ----------
    apertures : Apertures
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    colour : int
        Wavelength number.
    """
    events = bundle[EVENTS_BEFORE + i] + bundle[MET + i]
    if bundle[KICK_AT + i] == events:
        return bundle[KICK_X + i], bundle[KICK_Y + i]
    return kick_by_key(apertures, colour, bundle.view(np.uint64)[KEY + i], int(events))


@inlined
def diffract(apertures: Any, row: int, bundle: Array, colour: int, sense: float) -> None:
    """Deflect rays outside the array at the lenslets just met, if these diffract.

    Parameters
    ----------
    apertures : Apertures or None
    row : int
        Row of the face among the array's interfaces.
    bundle : (ROWS · BLOCK,) float64
    colour : int
        Wavelength number.
    sense : float
        1: the rays run along the normals in the bundle; −1: against them.
    """
    if apertures is None:
        return
    if apertures.row != row:
        return
    for i in range(rows.BLOCK):
        if bundle[rows.ENDED_ON + i] != 0.0 or bundle[rows.FATE + i] != 0.0:
            continue
        goes_on, dx, dy, dz = turned(
            kick_of_ray(apertures, bundle, i, colour), bundle[rows.DX + i], bundle[rows.DY + i], bundle[rows.DZ + i],
            sense * bundle[rows.NX + i], sense * bundle[rows.NY + i], sense * bundle[rows.NZ + i],
        )  # fmt: skip
        bundle[rows.DX + i], bundle[rows.DY + i], bundle[rows.DZ + i] = dx, dy, dz
        if not goes_on:
            # The ray ends on the face, whether it is still to arrive or has arrived.
            for row_of, at in ((rows.X, rows.AT_X), (rows.Y, rows.AT_Y), (rows.Z, rows.AT_Z)):
                bundle[row_of + i] = bundle[at + i]
            bundle[rows.ENDED_ON + i] = EVANESCENT + 1.0
