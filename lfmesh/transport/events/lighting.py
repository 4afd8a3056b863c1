"""Lights in both methods: their irradiance at a point (adjoint), and the rays that they emit (forward).

Only this module depends on the kind of a light: `illuminate` and `emitted` have a branch for each.
"""

from typing import Any

import numpy as np

from lfmesh.kernel import inlined, kernel
from lfmesh.optics.scattering import about, tangents
from lfmesh.transport.events.crossing import LIGHT_U, LIGHT_V, clear_of
from lfmesh.transport.events.scattering import Point, evaluate
from lfmesh.transport.packets.packet import OBJECT_FRAME, OBJECTS, SHADOW, Flow, put
from lfmesh.transport.packets.random import DIMENSIONS_PER_EVENT, start, uniform
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, MM2
from lfmesh.transport.tables.tables import ObjectTables

LIGHT_DIMENSIONS = 1 << 12
"""Distance between the dimensions of one light's random numbers and the next one's."""

# Dimensions of the numbers that a light's packet starts from; dimension 0 chooses the light.
PLACE_U, PLACE_V, WAY_U, WAY_V = 1, 2, 3, 4


@inlined
def ask_lights(objects: ObjectTables, flow: Flow, packet: Any, point: Point) -> bool:
    """Send a shadow packet to every light that can reach a point (next-event estimation); tell whether there is any.

    Parameters
    ----------
    objects : ObjectTables
    flow : Flow
    packet : PACKET
        It has met a target.
    point : Point
        Of the target.
    """
    facet = objects.facets[point.prim]
    x, y, z = point.x, point.y, point.z
    colour, ix, iy, iz = packet.colour, packet.dx, packet.dy, packet.dz
    any_light = False
    for number in range(len(objects.lights)):
        dimension = packet.events * DIMENSIONS_PER_EVENT + LIGHT_U + LIGHT_DIMENSIONS * number
        ux, uy, uz, reach, irradiance = illuminate(objects.lights[number], x, y, z, packet.key, dimension)
        irradiance *= objects.light_spectra[number, colour]
        cos_surface = point.nx * ux + point.ny * uy + point.nz * uz
        if cos_surface <= 0.0 or irradiance <= 0.0:
            continue
        any_light = True
        brdf = evaluate(objects.scattering, point, colour, ix, iy, iz, ux, uy, uz)
        shadow = put(
            flow, OBJECTS, packet, OBJECT_FRAME, x, y, z, ux, uy, uz,
            packet.weight * brdf * irradiance * cos_surface, packet.key, clear_of(facet, x, y, z, ux, uy, uz),
        )  # fmt: skip
        shadow.kind = SHADOW
        shadow.facet = point.prim
        shadow.limit = reach
    return any_light


@inlined
def illuminate(
    light: Any, x: float, y: float, z: float, key: np.uint64, dimension: int
) -> tuple[float, float, float, float, float]:
    """Return direction, distance and irradiance of a light at a point, from a random point of the light.

    Parameters
    ----------
    light : LIGHT
    x, y, z : float
        The point, mm, object frame.
    key : uint64
    dimension : int
        Key and first dimension of the random numbers.

    Returns
    -------
    ux, uy, uz : float
        Unit direction towards the light.
    reach : float
        Distance of the light, mm; inf for directional light.
    irradiance : float
        On a plane perpendicular to the direction, at the wavelength that has the most, W/m².
    """
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    if light.kind == DIRECTIONAL:
        return -ax, -ay, -az, np.inf, light.power
    lx, ly, lz = light.position[0], light.position[1], light.position[2]
    if light.kind == DISK:
        r = light.radius * np.sqrt(uniform(key, dimension))
        phi = 2.0 * np.pi * uniform(key, dimension + LIGHT_V - LIGHT_U)
        px, py, pz, qx, qy, qz = tangents(ax, ay, az)
        a, b = r * np.cos(phi), r * np.sin(phi)
        lx, ly, lz = lx + a * px + b * qx, ly + a * py + b * qy, lz + a * pz + b * qz
    ux, uy, uz = lx - x, ly - y, lz - z
    distance2 = ux * ux + uy * uy + uz * uz
    reach = np.sqrt(distance2)
    ux, uy, uz = ux / reach, uy / reach, uz / reach
    if light.kind == DISK:
        cos_light = -(ux * ax + uy * ay + uz * az)
        irradiance = max(0.0, cos_light) * light.power / (np.pi * MM2 * distance2)
    else:
        irradiance = light.power / (4.0 * np.pi * MM2 * distance2)
    return ux, uy, uz, reach, irradiance


@kernel
def emitted(
    objects: ObjectTables, light: Any, key: np.uint64
) -> tuple[float, float, float, float, float, float, float]:
    """Return a random ray of a light towards the sphere that is aimed at, around the targets or around glass only.

    Parameters
    ----------
    objects : ObjectTables
    light : LIGHT
    key : uint64
        Of the packet.

    Returns
    -------
    x, y, z, dx, dy, dz : float
        Start, mm, object frame, and unit direction.
    share : float
        Share of the packet's power that goes towards the sphere: the cone's share of all directions, weighted by
        Lambert's law for a disk.
    """
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    x, y, z = light.position[0], light.position[1], light.position[2]
    radius = objects.lit_radius
    mx, my, mz = objects.lit_middle[0], objects.lit_middle[1], objects.lit_middle[2]
    if light.kind != DISK and light.kind != DIRECTIONAL:
        dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
        return x, y, z, dx, dy, dz, share
    r = (radius if light.kind == DIRECTIONAL else light.radius) * np.sqrt(start(key, PLACE_U))
    phi = 2.0 * np.pi * start(key, PLACE_V)
    px, py, pz, qx, qy, qz = tangents(ax, ay, az)
    a, b = r * np.cos(phi), r * np.sin(phi)
    if light.kind == DIRECTIONAL:
        # Start in front of everything that may cast a shadow.
        x, y, z = mx + a * px + b * qx, my + a * py + b * qy, mz + a * pz + b * qz
        back = objects.outer_radius + (x * ax + y * ay + z * az)
        return x - back * ax, y - back * ay, z - back * az, ax, ay, az, 1.0
    x, y, z = x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz
    dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
    # Lambert's density over that of uniform directions in the cone: cos θ / π over 1 / (4π share).
    return x, y, z, dx, dy, dz, 4.0 * share * max(0.0, dx * ax + dy * ay + dz * az)


@kernel
def _into_cone(x: float, y: float, z: float, radius: float, key: np.uint64) -> tuple[float, float, float, float]:
    """Return a uniform direction from a point into the cone around a sphere, and the cone's share of 4π.

    Parameters
    ----------
    x, y, z : float, mm
        The point, relative to the sphere's centre.
    radius : float, mm
    key : uint64
        Of the packet.
    """
    distance2 = x * x + y * y + z * z
    cos_edge = -1.0
    if distance2 > radius * radius:
        cos_edge = np.sqrt(1.0 - radius * radius / distance2)
    # 1 − cos without cancellation for a far lamp.
    depth = 2.0 if cos_edge < 0.0 else radius * radius / distance2 / (1.0 + cos_edge)
    cos_theta = 1.0 - depth * start(key, WAY_U)
    phi = 2.0 * np.pi * start(key, WAY_V)
    if distance2 == 0.0:
        dx, dy, dz = about(0.0, 0.0, 1.0, cos_theta, phi)
    else:
        scale = -1.0 / np.sqrt(distance2)
        dx, dy, dz = about(x * scale, y * scale, z * scale, cos_theta, phi)
    return dx, dy, dz, 0.5 * depth
