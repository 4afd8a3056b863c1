"""Lamps: their irradiance at a point.

A lamp is a point, a direction, or a disk that no ray meets: no scattered ray finds its light, and each lamp is asked
from each point. How a lamp that shines from a point spreads its light is told by `lights.intensity` alone; disks and
directions have branches here and in `sources.lamp_rays`.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.scattering import near, tangents
from lfmesh.transport.events.crossing import LIGHT_U, draw_two
from lfmesh.transport.lights.intensity import intensity
from lfmesh.transport.lights.shadow import Way
from lfmesh.transport.packets.packet import TO_LAMP, Options
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, MM2, Profiles
from lfmesh.transport.tables.tables import ObjectTables

LIGHT_DIMENSIONS = 1 << 12
"""Distance between the dimensions of one light's random numbers and the next one's."""

NEAR_RADII = 2.0
"""Distance from a disk, in its radii, below which its points are drawn as they are seen too."""


@inlined
def sample(
    options: Options, objects: ObjectTables, packet: Any, number: int, place: tuple[float, float, float], nearby: bool
) -> Way:  # fmt: skip
    """Draw a way from a point to a lamp, with the irradiance at the packet's wavelength.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    packet : PACKET
    number : int
        Of the lamp.
    place : (3,) float, mm
        The point, object frame.
    nearby : bool
        The point may be as near to the lamp as may be: it is in a medium.
    """
    light, (x, y, z) = objects.lights[number], place
    px, py, pz = x - light.position[0], y - light.position[1], z - light.position[2]
    u, v, radii = 0.0, 0.0, NEAR_RADII * light.radius
    if light.kind == DISK:
        u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * number)
    if nearby and light.kind == DISK and px * px + py * py + pz * pz <= radii * radii:
        height = px * light.direction[0] + py * light.direction[1] + pz * light.direction[2]
        ux, uy, uz, reach, irradiance = _near_disk(light, x, y, z, height, u, v)
    else:
        ux, uy, uz, reach, irradiance = illuminate(objects.profiles, light, x, y, z, u, v)
    irradiance *= objects.light_spectra[number, packet.colour]
    return Way(TO_LAMP, number, Ray(x, y, z, ux, uy, uz), reach, irradiance, 1.0)


@kernel
def _near_disk(
    light: Any, x: float, y: float, z: float, height: float, u: float, v: float
) -> tuple[float, float, float, float, float]:
    """Return direction, distance and irradiance of a near disk, from a random point by area or as it is seen.

    Points of even area alone would leave cos θ / r², over that density, unbounded beside the disk. So with equal chance
    the direction towards the disk's plane is drawn evenly, and the sum of both densities divides the light (balance
    heuristic): what one point brings is then below four times the disk's power over π and its radius squared.

    Parameters
    ----------
    light : LIGHT
    x, y, z : float, mm
        The point, object frame.
    height : float, mm
        Above the disk.
    u, v : float
        Random numbers, uniform in [0, 1).

    Returns
    -------
    ux, uy, uz, reach, irradiance : float
        As of `illuminate`; the irradiance is 0 behind the disk, and where the direction misses it.
    """
    if height <= 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    radius2 = light.radius * light.radius
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    if u < 0.5:
        px, py, pz = point_of_light(light, 2.0 * u, v)
        ux, uy, uz = px - x, py - y, pz - z
        reach = np.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / reach, uy / reach, uz / reach
        cosine = height / reach
    else:
        # 1 − cos θ uniform below 1.
        ux, uy, uz = near(-ax, -ay, -az, 2.0 * u - 1.0, 2.0 * np.pi * v)
        cosine = 2.0 - 2.0 * u
        reach = height / cosine
        px, py, pz = x + reach * ux, y + reach * uy, z + reach * uz
        px, py, pz = px - light.position[0], py - light.position[1], pz - light.position[2]
        if px * px + py * py + pz * pz > radius2:
            return ux, uy, uz, reach, 0.0
    return ux, uy, uz, reach, light.power / (np.pi * MM2) * cosine / (0.5 * reach * reach + 0.25 * cosine * radius2)


@inlined
def illuminate(
    profiles: Profiles, light: Any, x: float, y: float, z: float, u: float, v: float
) -> tuple[float, float, float, float, float]:
    """Return direction, distance and irradiance of a light at a point, from a random point of the light.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    x, y, z : float
        The point, mm, object frame.
    u, v : float
        Random numbers, uniform in [0, 1), of a light that has a size.

    Returns
    -------
    ux, uy, uz : float
        Unit direction towards the light.
    reach : float
        Distance of the light, mm; inf for directional light.
    irradiance : float
        On a plane perpendicular to the direction, at the wavelength that has the most, W/m².
    """
    if light.kind == DIRECTIONAL:
        return -light.direction[0], -light.direction[1], -light.direction[2], np.inf, light.power
    return illuminate_from(profiles, light, point_of_light(light, u, v), x, y, z)


@inlined
def point_of_light(light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random point of a light that is somewhere, mm, object frame: of a disk uniform by area.

    Parameters
    ----------
    light : LIGHT
    u, v : float
        Random numbers, uniform in [0, 1), of a light that has a size.
    """
    x, y, z = light.position[0], light.position[1], light.position[2]
    if light.kind != DISK:
        return x, y, z
    r, phi = light.radius * np.sqrt(u), 2.0 * np.pi * v
    px, py, pz, qx, qy, qz = tangents(light.direction[0], light.direction[1], light.direction[2])
    a, b = r * np.cos(phi), r * np.sin(phi)
    return x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz


@inlined
def illuminate_from(
    profiles: Profiles, light: Any, place: tuple[float, float, float], x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return direction, distance and irradiance as `illuminate` does, from a given point of a light.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
        It is somewhere: not directional.
    place : (3,) float, mm
        Point of the light, object frame.
    x, y, z : float, mm
        The point that is lit, object frame.
    """
    lx, ly, lz = place
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    ux, uy, uz = lx - x, ly - y, lz - z
    distance2 = ux * ux + uy * uy + uz * uz
    reach = np.sqrt(distance2)
    ux, uy, uz = ux / reach, uy / reach, uz / reach
    if light.kind == DISK:
        cos_light = -(ux * ax + uy * ay + uz * az)
        irradiance = max(0.0, cos_light) * light.power / (np.pi * MM2 * distance2)
    else:
        irradiance = intensity(profiles, light, -ux, -uy, -uz) / (MM2 * distance2)
    return ux, uy, uz, reach, irradiance
