"""Diffraction at a lenslet's aperture, or the stop: a random change of a packet's direction.

The change takes place outside the plate, at the lenslet's face: before a packet meets it from there, or after it has
left it. Of two faces with lenslets, the limiting one diffracts (`tables.lens.with_diffraction`).

The change is drawn from the aperture's Fraunhofer pattern (`optics.diffraction`), added to the direction cosines along
the array, and independent of them. So a path and its reverse have the same density, and weights stay unchanged. Changes
beyond a right angle are drawn again. An oblique ray that is still turned along the array or into the face is no wave,
and ends.
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
from lfmesh.transport.packets.children import IN_KICK
from lfmesh.transport.packets.packet import PixelSamples, sample_of
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.packets.sobol import owen_sobol
from lfmesh.transport.tables.tables import Apertures

Array = NDArray[np.float64]

KICK_U, KICK_V = 6, 7
"""Dimensions of the starting numbers that give the first change of direction of a pixel's sample."""

_DIMENSIONS = 1 << 10
"""Distance between the random numbers of successive trials."""


@inlined
def key_of_kick(key: np.uint64, events: int) -> np.uint64:
    """Return the key of a packet's change of direction.

    Parameters
    ----------
    key : uint64
        Of the packet.
    events : int
        Number of interfaces met so far.
    """
    return derived(key, IN_KICK + events)


@kernel
def drawn_kick(apertures: Apertures, colour: int, numbers: tuple[float, float], key: np.uint64) -> tuple[float, float]:
    """Return the change of direction cosines along the aperture, in the medium of `Apertures.spread`.

    Parameters
    ----------
    apertures : Apertures
    colour : int
        Number of the wavelength.
    numbers : (2,) float
        Uniform in [0, 1), see `kick_by_key` and `kick_of_packet`.
    key : uint64
        For further numbers, see `key_of_kick`.
    """
    (u, v), trial = numbers, 0
    while True:
        a, b = _drawn_frequency(apertures, u, v, key, _DIMENSIONS * trial)
        kx, ky = apertures.spread[colour, 0] * a, apertures.spread[colour, 1] * b
        if kx * kx + ky * ky < 1.0:
            return kx, ky
        trial += 1
        u, v = _two_numbers(key, trial)


@inlined
def _two_numbers(key: np.uint64, trial: int) -> tuple[float, float]:
    """Return the random numbers of a trial."""
    return uniform(key, _DIMENSIONS * trial), uniform(key, _DIMENSIONS * trial + _DIMENSIONS // 2)


@inlined
def kick_by_key(apertures: Apertures, colour: int, key: np.uint64, events: int) -> tuple[float, float]:
    """Return a packet's change of direction from its key alone.

    Parameters
    ----------
    apertures, colour
        As for `drawn_kick`.
    key, events
        As for `key_of_kick`.
    """
    own = key_of_kick(key, events)
    return drawn_kick(apertures, colour, _two_numbers(own, 0), own)


@inlined
def is_first_kick(apertures: Apertures, pixels: PixelSamples, events: int) -> bool:
    """Tell whether a packet's change of direction uses two starting numbers of a pixel's sample.

    Parameters
    ----------
    apertures : Apertures
    pixels : PixelSamples
    events : int
        Number of interfaces met so far.
    """
    return pixels.each > 0 and events == apertures.events


@inlined
def kick_of_packet(
    apertures: Apertures, pixels: PixelSamples, packet: Any, key: np.uint64, events: int
) -> tuple[float, float]:
    """Return a packet's change of direction.

    Parameters
    ----------
    apertures : Apertures
    pixels : PixelSamples
    packet : PACKET
    key, events
        As for `key_of_kick`.
    """
    if not is_first_kick(apertures, pixels, events):
        return kick_by_key(apertures, packet.colour, key, events)
    stream, sample = sample_of(pixels, packet)
    point = sample ^ (sample >> 1)
    numbers = owen_sobol(stream, point, KICK_U), owen_sobol(stream, point, KICK_V)
    return drawn_kick(apertures, packet.colour, numbers, key_of_kick(key, events))


@inlined
def _drawn_frequency(apertures: Apertures, u: float, v: float, key: np.uint64, first: int) -> tuple[float, float]:
    """Draw a spatial frequency for an aperture, in cycles over its widths.

    Parameters
    ----------
    apertures : Apertures
    u, v : float
        Uniform in [0, 1).
    key : uint64
        For further random numbers.
    first : int
        First dimension.
    """
    if apertures.shape == ROUND:
        radius, angle = _drawn_distance(apertures, u, key, first + 1), 2.0 * np.pi * v
        return radius * np.cos(angle), radius * np.sin(angle)
    if apertures.shape == HEXAGON:
        inside, a, b = frequency_in_cells(apertures.cells, u, v, uniform(key, first + 1))
        return (a, b) if inside else _drawn_beyond_cells(apertures, derived(key, first))
    return (
        _drawn_on_line(apertures, u, key, first + 1, 0.0),
        _drawn_on_line(apertures, v, key, first + _DIMENSIONS // 2 + 1, 0.0),
    )


@inlined
def _drawn_on_line(apertures: Apertures, u: float, key: np.uint64, first: int, least: float) -> float:
    """Return a number with the density sinc², from a random number and further ones from `first` on.

    Parameters
    ----------
    least : float
        Excludes the smallest absolute values, up to this share.
    """
    side = 2.0 * u - 1.0
    distance = _drawn_distance(apertures, least + (1.0 - least) * abs(side), key, first)
    return distance if side > 0.0 else -distance


@kernel
def _drawn_beyond_cells(apertures: Apertures, key: np.uint64) -> tuple[float, float]:
    """Draw a frequency for a hexagon beyond the table of cells, by rejection from its rhombi."""
    _, near = distance_in_body(apertures.quantiles, NEAR_SHARE)
    trial = 0
    while True:
        own = derived(key, trial)
        trial += 1
        u, v = _two_numbers(own, 0)
        a = _drawn_on_line(apertures, u, own, 1, NEAR_SHARE)
        b = _drawn_on_line(apertures, v, own, _DIMENSIONS // 2 + 1, 0.0)
        # Two far numbers may be drawn in either order.
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
    """Return the distance that encloses a share of the light; beyond the table, by further random numbers."""
    inside, x = distance_in_body(apertures.quantiles, share)
    return x if inside else _drawn_in_tail(apertures.shape, x, key, first)


@kernel
def _drawn_in_tail(shape: int, end: float, key: np.uint64, first: int) -> float:
    """Draw a distance beyond the end of the table."""
    while True:
        accepted, x = proposed_in_tail(shape, end, uniform(key, first), uniform(key, first + 1))
        first += 2
        if accepted:
            return x


@inlined
def turned(
    kick: tuple[float, float], dx: float, dy: float, dz: float, nx: float, ny: float, nz: float
) -> tuple[bool, float, float, float]:
    """Return whether a direction outside the plate can be changed, and the result.

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
    """Return whether a direction's components along a face can be changed, and the result.

    Parameters
    ----------
    kick : (2,) float
        Along the projection of x on the face, and perpendicular to it.
    d, n : (3,) float
        Unit direction, and unit normal of either sign.
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
    apertures: Any, row: int, pixels: PixelSamples, packet: Any, key: np.uint64, d: tuple[float, float, float],
    n: tuple[float, float, float],
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Return whether a packet continues past a lenslet's face, and its direction.

    Parameters
    ----------
    apertures : Apertures or None
        None without diffraction.
    row : int
        Row of the face among the array's interfaces; only one of two faces diffracts.
    pixels, packet, key
        As for `kick_of_packet`.
    d, n : (3,) float
        As for `turned`.
    """
    if apertures is None:
        return True, d[0], d[1], d[2]
    if apertures.row != row:
        return True, d[0], d[1], d[2]
    kick = kick_of_packet(apertures, pixels, packet, key, packet.events)
    return turned(kick, d[0], d[1], d[2], n[0], n[1], n[2])
