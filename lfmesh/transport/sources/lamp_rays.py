"""Random rays of lamps, the starts of packets in the forward method."""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.scattering import near, tangents
from lfmesh.transport.events.moving import point_between
from lfmesh.transport.lights.intensity import drawn_by_intensity, intensity
from lfmesh.transport.lights.places import point_of_light
from lfmesh.transport.packets.random import start
from lfmesh.transport.tables.motions import STILL
from lfmesh.transport.tables.tables import ObjectTables

# Dimensions of a light packet's starting numbers; dimension 0 selects the light.
PLACE_U, PLACE_V, WAY_U, WAY_V = 1, 2, 3, 4


@kernel
def emitted(
    objects: ObjectTables, light: Any, key: np.uint64, moving: Any
) -> tuple[float, float, float, float, float, float, float]:
    """Return a random ray of a light, aimed at the sphere around targets or around glass only.

    The rays of a light that sends most of its light into a smaller solid angle than the sphere's follow its intensity.

    Parameters
    ----------
    objects : ObjectTables
    light : LIGHT
    key : uint64
        Packet key.
    moving : Moving or None

    Returns
    -------
    x, y, z, dx, dy, dz : float
        Start, mm, and unit direction, in the frame of the light's mover.
    share : float
        Fraction of the packet's power on the ray: the light's ray density over the sampling density.
    """
    radius = objects.lit_radius
    middle, mover = objects.lit_middle, light.mover
    mx, my, mz = point_between(moving, STILL, mover, middle[0], middle[1], middle[2])
    if not light.placed:
        ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
        r, phi = radius * np.sqrt(start(key, PLACE_U)), 2.0 * np.pi * start(key, PLACE_V)
        px, py, pz, qx, qy, qz = tangents(ax, ay, az)
        a, b = r * np.cos(phi), r * np.sin(phi)
        # Start in front of everything that may cast a shadow.
        x, y, z = mx + a * px + b * qx, my + a * py + b * qy, mz + a * pz + b * qz
        ox, oy, oz = point_between(moving, STILL, mover, 0.0, 0.0, 0.0)
        back = objects.outer_radius + ((x - ox) * ax + (y - oy) * ay + (z - oz) * az)
        return x - back * ax, y - back * ay, z - back * az, ax, ay, az, 1.0
    x, y, z = point_of_light(light, start(key, PLACE_U), start(key, PLACE_V))
    if light.gain * _cone_share(x - mx, y - my, z - mz, radius) > 1.0:
        dx, dy, dz = drawn_by_intensity(objects.lamps.profiles, light, start(key, WAY_U), start(key, WAY_V))
        return x, y, z, dx, dy, dz, 1.0
    dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
    # Ray density of the light over the uniform density.
    share *= light.gain * (intensity(objects.lamps.profiles, light, dx, dy, dz) / light.peak)
    return x, y, z, dx, dy, dz, share


@kernel
def _cone_share(x: float, y: float, z: float, radius: float) -> float:
    """Return the fraction of directions from a point in the cone around a sphere.

    Parameters
    ----------
    x, y, z : float, mm
        Point, relative to the sphere's centre.
    radius : float, mm
    """
    distance2 = x * x + y * y + z * z
    if distance2 <= radius * radius:
        return 1.0
    # 1 − cos without cancellation for a far lamp.
    return 0.5 * radius * radius / distance2 / (1.0 + np.sqrt(1.0 - radius * radius / distance2))


@kernel
def _into_cone(x: float, y: float, z: float, radius: float, key: np.uint64) -> tuple[float, float, float, float]:
    """Return a uniform direction into the cone around a sphere, and the cone's fraction of 4π.

    Parameters
    ----------
    x, y, z : float, mm
        Point, relative to the sphere's centre.
    radius : float, mm
    key : uint64
        Packet key.
    """
    distance2 = x * x + y * y + z * z
    depth = 2.0 * _cone_share(x, y, z, radius)
    height = depth * start(key, WAY_U)
    phi = 2.0 * np.pi * start(key, WAY_V)
    if distance2 == 0.0:
        dx, dy, dz = near(0.0, 0.0, 1.0, height, phi)
    else:
        scale = -1.0 / np.sqrt(distance2)
        dx, dy, dz = near(x * scale, y * scale, z * scale, height, phi)
    return dx, dy, dz, 0.5 * depth
