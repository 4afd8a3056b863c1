"""Diffraction at a lenslet's aperture, or the stop: a packet that passes it changes its direction by chance.

The change is taken in air, at the lenslet's face: before a packet from the air meets it, and after one has left it. Of
two faces with lenslets, light is diffracted at the one that limits it (`tables.lens.with_diffraction`).
Drawn from the aperture's Fraunhofer pattern (`optics.diffraction`), it is added to the direction cosines along the
array, and does not depend on them. So a path and its reverse have the same density, and weights stay as they are.
Changes beyond a right angle are drawn again. What would run along the array or into the face all the same, as
directions that are inclined already may, does not exist as a wave, and ends.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.diffraction import (
    HEXAGON,
    NEAR_SHARE,
    ROUND,
    distance_in_body,
    frequency_in_cells,
    hexagon_spectrum,
    is_beyond_cells,
    proposed_in_tail,
    rhombus_frequency,
)
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import Apertures

Array = NDArray[np.float64]

IN_KICK = 1 << 23
"""With the number of the event, number of the key of a change of direction; see `interface.IN_WALK`."""

_DIMENSIONS = 1 << 10
"""Random numbers from one trial to the next."""


@kernel
def drawn_kick(apertures: Apertures, colour: int, key: np.uint64, events: int) -> tuple[float, float]:
    """Return the change of a packet's direction cosines along the aperture, in air.

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
    trial = 0
    while True:
        a, b = _drawn_frequency(apertures, own, _DIMENSIONS * trial)
        trial += 1
        kx, ky = apertures.spread[colour, 0] * a, apertures.spread[colour, 1] * b
        if kx * kx + ky * ky < 1.0:
            return kx, ky


@inlined
def _drawn_frequency(apertures: Apertures, key: np.uint64, first: int) -> tuple[float, float]:
    """Return a frequency drawn for an aperture, in cycles over its widths.

    Parameters
    ----------
    apertures : Apertures
    key : uint64
    first : int
        First of the random numbers.
    """
    second = first + _DIMENSIONS // 2
    if apertures.shape == ROUND:
        radius = _drawn_distance(apertures, uniform(key, first), key, first + 1)
        angle = 2.0 * np.pi * uniform(key, second)
        return radius * np.cos(angle), radius * np.sin(angle)
    if apertures.shape == HEXAGON:
        inside, a, b = frequency_in_cells(
            apertures.cells, uniform(key, first), uniform(key, first + 1), uniform(key, first + 2)
        )
        return (a, b) if inside else _drawn_beyond_cells(apertures, derived(key, first))
    return _drawn_on_line(apertures, key, first, 0.0), _drawn_on_line(apertures, key, second, 0.0)


@inlined
def _drawn_on_line(apertures: Apertures, key: np.uint64, first: int, least: float) -> float:
    """Return a number with the density sinc², by random numbers from the given one on.

    Parameters
    ----------
    least : float
        It is none of this share of the least ones.
    """
    side = 2.0 * uniform(key, first) - 1.0
    distance = _drawn_distance(apertures, least + (1.0 - least) * abs(side), key, first + 1)
    return distance if side > 0.0 else -distance


@kernel
def _drawn_beyond_cells(apertures: Apertures, key: np.uint64) -> tuple[float, float]:
    """Return a frequency drawn for a hexagon beyond the table of cells, by rejection from its rhombi."""
    _, near = distance_in_body(apertures.quantiles, NEAR_SHARE)
    trial = 0
    while True:
        own = derived(key, trial)
        trial += 1
        a = _drawn_on_line(apertures, own, 0, NEAR_SHARE)
        b = _drawn_on_line(apertures, own, _DIMENSIONS // 2, 0.0)
        # Two far numbers may be drawn either way round.
        ways, choice = 2.0 if abs(b) > near else 1.0, 6.0 * uniform(own, _DIMENSIONS)
        a, b = (b, a) if choice < 3.0 else (a, b)
        x, y = rhombus_frequency(int(choice) % 3, a, b)
        if not is_beyond_cells(x, y):
            continue
        spectrum, of_rhombi = hexagon_spectrum(x, y)
        if ways * of_rhombi * uniform(own, _DIMENSIONS + 1) < spectrum:
            return x, y


@inlined
def _drawn_distance(apertures: Apertures, share: float, key: np.uint64, first: int) -> float:
    """Return the distance within which a share of the light lies, beyond the table by further random numbers."""
    inside, x = distance_in_body(apertures.quantiles, share)
    return x if inside else _drawn_in_tail(apertures.shape, x, key, first)


@kernel
def _drawn_in_tail(shape: int, end: float, key: np.uint64, first: int) -> float:
    """Return a distance beyond the end of the table."""
    while True:
        accepted, x = proposed_in_tail(shape, end, uniform(key, first), uniform(key, first + 1))
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
def turned_along(
    kick: tuple[float, float], d: tuple[float, float, float], n: tuple[float, float, float]
) -> tuple[bool, float, float, float]:
    """Return whether a direction's components along a face can be changed, and the new direction.

    Parameters
    ----------
    kick : (2,) float
        In the directions of x along the face, and square to that.
    d, n : (3,) float
        Unit direction, and unit normal of either side.
    """
    over, along = 1.0 / np.sqrt(1.0 - n[0] * n[0]), d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
    a, b = kick[0] * over, kick[1] * over
    # x less its part along the normal, and the vector product of the normal with that.
    tx = d[0] - along * n[0] + a * (1.0 - n[0] * n[0])
    ty = d[1] - along * n[1] - a * n[0] * n[1] + b * n[2]
    tz = d[2] - along * n[2] - a * n[0] * n[2] - b * n[1]
    left = 1.0 - tx * tx - ty * ty - tz * tz
    if not left > 0.0:
        return False, d[0], d[1], d[2]
    onto = np.sqrt(left) if along > 0.0 else -np.sqrt(left)
    return True, tx + onto * n[0], ty + onto * n[1], tz + onto * n[2]


@inlined
def kicked(
    apertures: Any, row: int, colour: int, key: np.uint64, events: int, d: tuple[float, float, float],
    n: tuple[float, float, float],
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Return whether a packet goes on past a lenslet's face, and its direction there.

    Parameters
    ----------
    apertures : Apertures or None
        None: there is no diffraction.
    row : int
        Of the face among the array's interfaces: only one of two diffracts.
    colour, key, events
        As for `drawn_kick`.
    d, n : (3,) float
        As for `turned`.
    """
    if apertures is None:
        return True, d[0], d[1], d[2]
    if apertures.row != row:
        return True, d[0], d[1], d[2]
    return turned(drawn_kick(apertures, colour, key, events), d[0], d[1], d[2], n[0], n[1], n[2])
