"""Lamps: their irradiance at a point.

A lamp is a region or a direction that no ray meets. No scattered ray finds its light, so points ask lamps.
`lights.intensity` alone knows the angular distributions of lamps, `lights.places` alone the places of their points.
"""

from typing import Any

import numpy as np

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined
from lfmesh.transport.events.crossing import LIGHT_U, draw_two
from lfmesh.transport.events.moving import direction_between, point_between
from lfmesh.transport.lights.intensity import intensity
from lfmesh.transport.lights.places import point_as_seen
from lfmesh.transport.lights.shadow import Way
from lfmesh.transport.packets.packet import TO_LAMP, Options, mover_of_frame
from lfmesh.transport.tables.lights import MM2, Profiles
from lfmesh.transport.tables.tables import ObjectTables

LIGHT_DIMENSIONS = 1 << 12
"""Distance between the dimensions of the random numbers of two successive lights."""


@inlined
def sample(
    options: Options, objects: ObjectTables, packet: Any, number: int, place: tuple[float, float, float], nearby: bool,
    moving: Any,
) -> Way:  # fmt: skip
    """Draw a ray from a point to a lamp, with the irradiance at the packet's wavelength.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    packet : PACKET
    number : int
        Number of the lamp.
    place : (3,) float, mm
        The point, in the packet's frame.
    nearby : bool
        The point is in a medium, so it may be arbitrarily close to the lamp.
    moving : Moving or None
    """
    light, (x, y, z) = objects.lamps.rows[number], place
    here = mover_of_frame(packet.frame)
    u, v = 0.0, 0.0
    if light.size > 0.0:
        u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * number)
    place = point_between(moving, here, light.mover, x, y, z)
    ux, uy, uz, reach, irradiance = illuminate(objects.lamps.profiles, light, place, u, v, nearby)
    ux, uy, uz = direction_between(moving, light.mover, here, ux, uy, uz)
    irradiance *= objects.lamps.spectra[number, packet.colour]
    return Way(TO_LAMP, number, Ray(x, y, z, ux, uy, uz), reach, irradiance, 1.0)


@inlined
def illuminate(
    profiles: Profiles, light: Any, place: tuple[float, float, float], u: float, v: float, nearby: bool
) -> tuple[float, float, float, float, float]:
    """Return direction, distance and irradiance of a light at a point, from a random point of the light.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    place : (3,) float, mm
        In the frame of the light's mover.
    u, v : float
        Uniform in [0, 1); used if the light has a size.
    nearby : bool
        As for `sample`.

    Returns
    -------
    ux, uy, uz : float
        Unit direction towards the light.
    reach : float
        Distance of the light, mm; inf for directional light.
    irradiance : float
        On a plane perpendicular to the direction, at the strongest wavelength, W/m².
    """
    x, y, z = place
    if not light.placed:
        return -light.direction[0], -light.direction[1], -light.direction[2], np.inf, light.power
    px, py, pz, share = point_as_seen(light, x, y, z, u, v, nearby)
    ux, uy, uz, reach, irradiance = illuminate_from(profiles, light, (px, py, pz), x, y, z)
    return ux, uy, uz, reach, share * irradiance


@inlined
def illuminate_from(
    profiles: Profiles, light: Any, place: tuple[float, float, float], x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return the results of `illuminate` for a given point of a light.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
        Not directional.
    place : (3,) float, mm
        Point of the light, in the frame of its mover.
    x, y, z : float, mm
        The lit point, likewise.
    """
    lx, ly, lz = place
    ux, uy, uz = lx - x, ly - y, lz - z
    distance2 = ux * ux + uy * uy + uz * uz
    reach = np.sqrt(distance2)
    ux, uy, uz = ux / reach, uy / reach, uz / reach
    return ux, uy, uz, reach, intensity(profiles, light, -ux, -uy, -uz) / (MM2 * distance2)
