"""Light scattered once near lamps as a light source: directions past a lamp, their density, and points on the line.

A point of a target or a medium, seen from the sensor, finds the light that a medium scatters near a lamp by the packet
that it scatters, which asks lamps from points of its line, and by one that it sends past a lamp, into its halo, whose
brightness grows like one over the angle from the lamp. Either direction counts its share of the densities of both
(balance heuristic, Veach & Guibas, SIGGRAPH 1995). The packet past a lamp brings nothing but what a medium scatters of
that lamp's light on its line; more often scattered light, and that of other lamps, is found by scattered packets alone.

On that line a point is drawn by the phase function and by the angle at which the lamp sees the line, so that together
with the direction any point of the medium is drawn in proportion to the light that it scatters to where the packet
began, but for what is lost on the way (as in Georgiev et al., Joint importance sampling of low-order volumetric
scattering, SIGGRAPH Asia 2013).
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.lamps_on_line import NARROWEST
from lfmesh.transport.packets.packet import NO_SURFACE, SCATTERED, Options
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.halos import DENSE, Halos, light_beyond
from lfmesh.transport.tables.lights import DIRECTIONAL

Array = NDArray[np.float64]

LAMP_U, LAMP_V, BY_ANGLE, ALONG, LAMP, SENT = 0, 1, 2, 3, 4, 5
"""Dimensions of the random numbers of a packet past a lamp: the lamp's point, and the point on the line."""


@inlined
def asks_halos(volumes: Any, options: Options, events: int) -> bool:
    """Tell whether points, after so many events, send packets past lamps.

    Parameters
    ----------
    volumes : Volumes or None
        None: there are no media, and numba compiles nothing but the first line.
    options : Options
    events : int
        That the packet has had.
    """
    if volumes is None:
        return False
    return _has_halos(volumes.halos) and options.bounce and volumes.scatters and events + 1 < options.max_events


@inlined
def _has_halos(halos: Any) -> bool:
    return halos is not None


@inlined
def _brightness(light: Any, spectra: Array, number: int, colour: int, far: float) -> float:
    """Return what a lamp is drawn in proportion to, for a point at a distance: the brightness of its halo."""
    return light.power * spectra[number, colour] / far if light.kind != DIRECTIONAL and far > 0.0 else 0.0


@inlined
def _distance(light: Any, x: float, y: float, z: float) -> float:
    """Return the distance of a lamp from a point, mm; that of a disk from all its points is about as large."""
    px, py, pz = light.position[0] - x, light.position[1] - y, light.position[2] - z
    return np.sqrt(px * px + py * py + pz * pz + light.radius * light.radius)


@inlined
def _chance_sent(halos: Halos, colour: int, far: float) -> float:
    """Return the chance with which a packet is sent past a lamp: where media are thin, its halo is of little weight."""
    depth = 0.0
    for number in range(len(halos.extent)):
        depth += halos.scattering[number, colour] * min(far, halos.extent[number])
    return min((depth / DENSE) ** 2, 1.0)


@kernel
def all_halos(lights: NDArray[np.void], spectra: Array, colour: int, x: float, y: float, z: float) -> float:
    """Return the sum of what lamps are drawn in proportion to at a point; 0: none has a halo there.

    Parameters
    ----------
    lights : (lamps,) LIGHT
    spectra : (lamps, wavelengths) float64
    colour : int
        Number of the wavelength.
    x, y, z : float, mm
        The point, object frame.
    """
    whole = 0.0
    for number in range(len(lights)):
        whole += _brightness(lights[number], spectra, number, colour, _distance(lights[number], x, y, z))
    return whole


@kernel
def halo_chance(
    halos: Halos, lights: NDArray[np.void], spectra: Array, number: int, colour: int, whole: float,
    x: float, y: float, z: float,
) -> float:  # fmt: skip
    """Return the chance with which a point sends a packet past a lamp.

    Parameters
    ----------
    halos : Halos
    lights, spectra, colour, x, y, z
        As for `all_halos`.
    number : int
        Of the lamp.
    whole : float
        What `all_halos` returned.
    """
    far = _distance(lights[number], x, y, z)
    if whole <= 0.0:
        return 0.0
    return _brightness(lights[number], spectra, number, colour, far) / whole * _chance_sent(halos, colour, far)


@kernel
def lamp_past(
    halos: Halos, lights: NDArray[np.void], spectra: Array, colour: int, x: float, y: float, z: float, key: np.uint64
) -> int:  # fmt: skip
    """Return the lamp past which a point sends a packet, drawn by `halo_chance`; −1: none.

    Parameters
    ----------
    halos : Halos
    lights, spectra, colour, x, y, z
        As for `all_halos`.
    key : uint64
        Of the random numbers.
    """
    whole = all_halos(lights, spectra, colour, x, y, z)
    choice, drawn = whole * uniform(key, LAMP), -1
    for number in range(len(lights)):
        own = _brightness(lights[number], spectra, number, colour, _distance(lights[number], x, y, z))
        if own > 0.0 and choice >= 0.0:
            drawn = number
        choice -= own
    if drawn < 0 or uniform(key, SENT) >= _chance_sent(halos, colour, _distance(lights[drawn], x, y, z)):
        return -1
    return drawn


@inlined
def past_point(
    px: float, py: float, pz: float, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> tuple[float, float, float]:
    """Return where a line is nearest to a point, and the distances of the point there and from the line's start, mm.

    Parameters
    ----------
    px, py, pz : float, mm
        The point.
    x, y, z, dx, dy, dz : float
        The line.
    """
    px, py, pz = px - x, py - y, pz - z
    s = px * dx + py * dy + pz * dz
    ex, ey, ez = px - s * dx, py - s * dy, pz - s * dz
    far = np.sqrt(px * px + py * py + pz * pz)
    return s, max(np.sqrt(ex * ex + ey * ey + ez * ez), NARROWEST * far), far


@inlined
def halo_density(halos: Halos, colour: int, angle: float, sine: float) -> float:
    """Return the density, 1/sr, with which directions past a lamp are drawn at an angle from it.

    Parameters
    ----------
    halos : Halos
    colour : int
        Number of the wavelength.
    angle : float
        rad.
    sine : float
        Of the angle, more than 0.
    """
    whole = halos.below[colour, len(halos.angles) - 1]
    return light_beyond(halos, colour, angle) / (2.0 * np.pi * whole * sine)


@inlined
def draws_halo(packet: Any) -> bool:
    """Tell whether the point that a packet comes from sent one past a lamp too, as the packet's line may have been."""
    return packet.kind == SCATTERED and packet.facet != NO_SURFACE


@kernel
def share_past_lamp(
    halos: Halos, colour: int, chance: float, packet: Any, px: float, py: float, pz: float
) -> float:  # fmt: skip
    """Return the share of a lamp's light, scattered on its line, that a scattered packet counts.

    Parameters
    ----------
    halos : Halos
    colour : int
        Number of the wavelength.
    chance : float
        Of the lamp, see `halo_chance`, at the start of the line.
    packet : PACKET
        At the start of the line.
    px, py, pz : float, mm
        Point of the lamp that the light comes from.
    """
    if chance <= 0.0:
        return 1.0
    s, h, far = past_point(px, py, pz, packet.x, packet.y, packet.z, packet.dx, packet.dy, packet.dz)
    if far <= 0.0:
        return 1.0
    past = chance * halo_density(halos, colour, np.arctan2(h, s), h / far)
    return packet.density / (packet.density + past)
