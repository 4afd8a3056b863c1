"""Diffraction at a lenslet's aperture: a packet that passes it changes its direction by chance.

The change is taken in air, at the lenslet's face: before a packet from the air meets it, and after one has left it.
Drawn from the aperture's Fraunhofer pattern (`optics.diffraction`), it is added to the direction cosines along the
array, and does not depend on them. So a path and its reverse have the same density, and weights stay as they are.
Changes beyond a right angle are drawn again. What would run along the array or into the face all the same, as
directions that are inclined already may, does not exist as a wave, and ends.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.diffraction import hexagon_share, proposed_in_tail, rhombus_frequency, sinc2_in_body
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import Apertures

Array = NDArray[np.float64]

IN_KICK = 1 << 23
"""With the number of the event, number of the key of a change of direction; see `interface.IN_WALK`."""

_DIMENSIONS = 1 << 10
"""Random numbers from one trial to the next."""


@kernel
def drawn_kick(apertures: Apertures, colour: int, key: np.uint64, events: int) -> tuple[float, float]:
    """Return the change of a packet's direction cosines along the array, in air.

    Parameters
    ----------
    apertures : Apertures
    colour : int
        Number of the wavelength.
    key : uint64
        Of the packet.
    events : int
        Number of interfaces that it has met.
    """
    own = derived(key, IN_KICK + events)
    width_x, width_y = apertures.spread[colour, 0], apertures.spread[colour, 1]
    trial = 0
    # Each of a hexagon's trials succeeds with a chance of 1/3.
    while True:
        first = _DIMENSIONS * trial
        a = _drawn_sinc2(apertures.quantiles, own, first)
        b = _drawn_sinc2(apertures.quantiles, own, first + _DIMENSIONS // 2)
        trial += 1
        if apertures.hexagonal:
            number = int(3.0 * uniform(own, first + _DIMENSIONS - 1))
            a, b = rhombus_frequency(number, a, b)
            if uniform(own, first + _DIMENSIONS - 2) >= hexagon_share(a, b):
                continue
        kx, ky = width_x * a, width_y * b
        if kx * kx + ky * ky < 1.0:
            return kx, ky


@inlined
def _drawn_sinc2(quantiles: Array, key: np.uint64, first: int) -> float:
    """Return a number with the density sinc², by random numbers from the given one on."""
    inside, x = sinc2_in_body(quantiles, uniform(key, first))
    return x if inside else _drawn_in_tail(x, key, first + 1)


@kernel
def _drawn_in_tail(end: float, key: np.uint64, first: int) -> float:
    """Return a number with the density sinc² beyond the end of the table."""
    while True:
        accepted, x = proposed_in_tail(end, uniform(key, first), uniform(key, first + 1))
        first += 2
        if accepted:
            return x


@inlined
def turned(
    kick: tuple[float, float], dx: float, dy: float, dz: float, nx: float, ny: float, nz: float
) -> tuple[bool, float, float, float]:
    """Return whether a direction in air can be changed, and the new one.

    Parameters
    ----------
    kick : (2,) float
        See `drawn_kick`.
    dx, dy, dz : float
        Unit direction, array frame.
    nx, ny, nz : float
        Normal of the face, on the direction's side.
    """
    ux, uy = dx + kick[0], dy + kick[1]
    uz2 = 1.0 - ux * ux - uy * uy
    if not uz2 > 0.0:
        return False, dx, dy, dz
    uz = np.sqrt(uz2) if dz > 0.0 else -np.sqrt(uz2)
    return ux * nx + uy * ny + uz * nz > 0.0, ux, uy, uz


@inlined
def kicked(
    apertures: Any, colour: int, key: np.uint64, events: int, d: tuple[float, float, float],
    n: tuple[float, float, float],
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Return whether a packet goes on past a lenslet's aperture, and its direction there.

    Parameters
    ----------
    apertures : Apertures or None
        None: there is no diffraction.
    colour, key, events
        As for `drawn_kick`.
    d, n : (3,) float
        As for `turned`.
    """
    if apertures is None:
        return True, d[0], d[1], d[2]
    return turned(drawn_kick(apertures, colour, key, events), d[0], d[1], d[2], n[0], n[1], n[2])
