"""Lights in both methods: their irradiance at a point (adjoint), and the rays that they emit (forward).

Only this module depends on the kind of a light: `illuminate` and `emitted` have a branch for each, and so have
`intensity` and `_drawn_by_intensity` for what shines from a point.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import drawn_by, piece_with
from lfmesh.optics.scattering import near, tangents
from lfmesh.transport.events.crossing import LIGHT_U, clear_of, draw_two
from lfmesh.transport.events.scattering import Point, evaluate
from lfmesh.transport.packets.packet import OBJECT_FRAME, OBJECTS, SHADOW, Flow, Options, put
from lfmesh.transport.packets.random import start
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, MM2, POINT, SPOT, Profiles
from lfmesh.transport.tables.tables import ObjectTables

LIGHT_DIMENSIONS = 1 << 12
"""Distance between the dimensions of one light's random numbers and the next one's."""

MOST_STEPS = 64
"""Of Newton's method, or of halving, after which an angle is known to its last digits."""

NEAR_RADII = 2.0
"""Distance from a disk, in its radii, below which its points are drawn as they are seen too."""

# Dimensions of the numbers that a light's packet starts from; dimension 0 chooses the light.
PLACE_U, PLACE_V, WAY_U, WAY_V = 1, 2, 3, 4


@inlined
def ask_lights(options: Options, objects: ObjectTables, flow: Flow, packet: Any, point: Point) -> bool:
    """Send a shadow packet to every light that can reach a point (next-event estimation); tell whether there is any.

    Parameters
    ----------
    options : Options
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
        ux, uy, uz, reach, irradiance = from_light(options, objects, packet, number, x, y, z)
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
def from_light(
    options: Options, objects: ObjectTables, packet: Any, number: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return what `illuminate` does, from the point of a light that a packet draws, at the packet's wavelength.

    Parameters
    ----------
    options : Options
    objects : ObjectTables
    packet : PACKET
    number : int
        Of the light.
    x, y, z : float
        The point, mm, object frame.
    """
    light = objects.lights[number]
    u, v = 0.0, 0.0
    if light.kind == DISK:
        u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * number)
    ux, uy, uz, reach, irradiance = illuminate(objects.profiles, light, x, y, z, u, v)
    return ux, uy, uz, reach, irradiance * objects.light_spectra[number, packet.colour]


@inlined
def _point_of_disk(light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random point of a disk, uniform by area, mm, object frame."""
    r, phi = light.radius * np.sqrt(u), 2.0 * np.pi * v
    px, py, pz, qx, qy, qz = tangents(light.direction[0], light.direction[1], light.direction[2])
    a, b = r * np.cos(phi), r * np.sin(phi)
    x, y, z = light.position[0], light.position[1], light.position[2]
    return x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz


@inlined
def from_light_nearby(
    options: Options, objects: ObjectTables, packet: Any, number: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return what `from_light` does, for a point that may be as near to the light as may be: in a medium.

    Parameters
    ----------
    options, objects, packet, number, x, y, z
        As for `from_light`.
    """
    light = objects.lights[number]
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    px, py, pz = x - light.position[0], y - light.position[1], z - light.position[2]
    radii = NEAR_RADII * light.radius
    if light.kind != DISK or px * px + py * py + pz * pz > radii * radii:
        return from_light(options, objects, packet, number, x, y, z)
    height = px * ax + py * ay + pz * az
    if height <= 0.0:
        return 0.0, 0.0, 1.0, 0.0, 0.0
    u, v = draw_two(options, packet, LIGHT_U + LIGHT_DIMENSIONS * number)
    ux, uy, uz, reach, irradiance = _near_disk(light, x, y, z, height, u, v)
    return ux, uy, uz, reach, irradiance * objects.light_spectra[number, packet.colour]


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
        Above the disk, more than 0.
    u, v : float
        Random numbers, uniform in [0, 1).

    Returns
    -------
    ux, uy, uz, reach, irradiance : float
        As of `illuminate`; the irradiance is 0 where the direction misses the disk.
    """
    radius2 = light.radius * light.radius
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    if u < 0.5:
        px, py, pz = _point_of_disk(light, 2.0 * u, v)
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
    lx, ly, lz = point_of_light(light, u, v)
    return illuminate_from(profiles, light, lx, ly, lz, x, y, z)


@inlined
def point_of_light(light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random point of a light that is somewhere, mm, object frame: of a disk uniform by area.

    Parameters
    ----------
    light : LIGHT
    u, v : float
        Random numbers, uniform in [0, 1), of a light that has a size.
    """
    if light.kind == DISK:
        return _point_of_disk(light, u, v)
    return light.position[0], light.position[1], light.position[2]


@inlined
def illuminate_from(
    profiles: Profiles, light: Any, lx: float, ly: float, lz: float, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return what `illuminate` does, from a given point of a light that is somewhere.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    lx, ly, lz : float, mm
        Point of the light, object frame.
    x, y, z : float
        The point that is lit, mm, object frame.
    """
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


@inlined
def intensity(profiles: Profiles, light: Any, dx: float, dy: float, dz: float) -> float:
    """Return the radiant intensity of a light that shines from a point, W/sr.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    dx, dy, dz : float
        Unit direction of the light.
    """
    if light.kind == POINT:
        return light.peak
    if light.kind == SPOT:
        ex, ey, ez = dx - light.direction[0], dy - light.direction[1], dz - light.direction[2]
        # 1 − cos of the angle from the axis.
        height = 0.5 * (ex * ex + ey * ey + ez * ez)
        if height <= light.inner:
            return light.peak
        return light.peak * (light.outer - height) / (light.outer - light.inner) if height < light.outer else 0.0
    return light.power * _profile_at(profiles, light, dx, dy, dz)


@kernel
def _profile_at(profiles: Profiles, light: Any, dx: float, dy: float, dz: float) -> float:
    """Return the intensity of a profiled light over its power, 1/sr."""
    axis, across = light.direction, light.across
    x = across[0, 0] * dx + across[0, 1] * dy + across[0, 2] * dz
    y = across[1, 0] * dx + across[1, 1] * dy + across[1, 2] * dz
    z = axis[0] * dx + axis[1] * dy + axis[2] * dz
    theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    row = profiles.rows[light.profile]
    vertical = profiles.angles[row[0] : row[0] + row[1]]
    horizontal = profiles.angles[row[2] : row[2] + row[3]]
    if theta < vertical[0] or theta > vertical[-1]:
        return 0.0
    phi = horizontal[0] + (phi - horizontal[0]) % (2.0 * np.pi)
    i = piece_with(vertical, theta)
    j = piece_with(horizontal, phi)
    s = (theta - vertical[i]) / (vertical[i + 1] - vertical[i])
    t = min((phi - horizontal[j]) / (horizontal[j + 1] - horizontal[j]), 1.0)
    first = row[4] + j * row[1] + i
    low = (1.0 - s) * profiles.intensity[first] + s * profiles.intensity[first + 1]
    first += row[1]
    return (1.0 - t) * low + t * ((1.0 - s) * profiles.intensity[first] + s * profiles.intensity[first + 1])


@kernel
def emitted(
    objects: ObjectTables, light: Any, key: np.uint64
) -> tuple[float, float, float, float, float, float, float]:
    """Return a random ray of a light towards the sphere that is aimed at, around the targets or around glass only.

    A light of a narrow cone or profile is not aimed: its rays follow its intensity, wherever that sends them.

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
        Share of the packet's power that goes this way: the density of the light's rays over that with which the ray
        was drawn.
    """
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    x, y, z = light.position[0], light.position[1], light.position[2]
    radius = objects.lit_radius
    mx, my, mz = objects.lit_middle[0], objects.lit_middle[1], objects.lit_middle[2]
    if light.kind != DISK and light.kind != DIRECTIONAL:
        if light.kind != POINT and light.power <= light.peak * 4.0 * np.pi * _cone_share(
            x - mx, y - my, z - mz, radius
        ):
            dx, dy, dz = _drawn_by_intensity(objects.profiles, light, start(key, WAY_U), start(key, WAY_V))
            return x, y, z, dx, dy, dz, 1.0
        dx, dy, dz, share = _into_cone(x - mx, y - my, z - mz, radius, key)
        if light.kind != POINT:
            share *= 4.0 * np.pi * intensity(objects.profiles, light, dx, dy, dz) / light.power
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
def _drawn_by_intensity(profiles: Profiles, light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random direction of a spot or a profiled light, with a density of its intensity over its power.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    axis, across = light.direction, light.across
    if light.kind == SPOT:
        # The number of 1 − cos of the angle if the soft edge were as bright as the inside: it fades to the right.
        height = 0.5 * u * (light.inner + light.outer)
        if height > light.inner:
            rest = 2.0 * (height - light.inner) / (light.outer - light.inner)
            height = light.outer - (light.outer - light.inner) * np.sqrt(max(0.0, 1.0 - rest))
        return near(axis[0], axis[1], axis[2], height, 2.0 * np.pi * v)
    row = profiles.rows[light.profile]
    vertical = profiles.angles[row[0] : row[0] + row[1]]
    horizontal = profiles.angles[row[2] : row[2] + row[3]]
    until = profiles.until[row[4] : row[4] + (row[1] - 1) * (row[3] - 1)]
    cell = drawn_by(until, u)
    below = until[cell - 1] if cell > 0 else 0.0
    # What is left of the first number is a random number of its own.
    u = min((u - below) / (until[cell] - below), 1.0)
    j, i = cell // (row[1] - 1), cell % (row[1] - 1)
    low, high = vertical[i], vertical[i + 1]
    first = row[4] + j * row[1] + i
    a, b = profiles.intensity[first], profiles.intensity[first + 1]
    c, d = profiles.intensity[first + row[1]], profiles.intensity[first + row[1] + 1]
    # Between the two planes the light of a cell changes linearly; the square root inverts its integral.
    one, other = _ring(low, high, a, b, high), _ring(low, high, c, d, high)
    t = v * (one + other) / (one + np.sqrt(one * one * (1.0 - v) + other * other * v)) if v > 0.0 else 0.0
    theta = _angle_in_ring(low, high, (1.0 - t) * a + t * c, (1.0 - t) * b + t * d, u)
    phi = horizontal[j] + t * (horizontal[j + 1] - horizontal[j])
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    return (
        x * across[0, 0] + y * across[1, 0] + z * axis[0],
        x * across[0, 1] + y * across[1, 1] + z * axis[1],
        x * across[0, 2] + y * across[1, 2] + z * axis[2],
    )


@kernel
def _ring(low: float, high: float, a: float, b: float, theta: float) -> float:
    """Return ∫ I sin θ dθ from `low` to `theta`, of an intensity I that is linear from a at `low` to b at `high`."""
    slope = (b - a) / (high - low)
    middle, half = 0.5 * (low + theta), 0.5 * (theta - low)
    # Cosines and sines of sums, so that differences of near numbers do not cancel.
    even = 2.0 * np.sin(middle) * np.sin(half)
    odd = 2.0 * np.cos(middle) * np.sin(half) - 2.0 * half * np.cos(theta)
    return a * even + slope * odd


@kernel
def _angle_in_ring(low: float, high: float, a: float, b: float, u: float) -> float:
    """Return the angle up to which a share u of a ring's light goes: Newton's method between bounds."""
    wanted = u * _ring(low, high, a, b, high)
    slope = (b - a) / (high - low)
    left, right = low, high
    theta = low + u * (high - low)
    for _ in range(MOST_STEPS):
        excess = _ring(low, high, a, b, theta) - wanted
        if excess > 0.0:
            right = theta
        else:
            left = theta
        density = (a + slope * (theta - low)) * np.sin(theta)
        following = theta - excess / density if density > 0.0 else 0.5 * (left + right)
        if not left < following < right:
            following = 0.5 * (left + right)
        if following == theta:
            break
        theta = following
    return theta


@kernel
def _cone_share(x: float, y: float, z: float, radius: float) -> float:
    """Return the share of all directions from a point that lie in the cone around a sphere.

    Parameters
    ----------
    x, y, z : float, mm
        The point, relative to the sphere's centre.
    radius : float, mm
    """
    distance2 = x * x + y * y + z * z
    if distance2 <= radius * radius:
        return 1.0
    # 1 − cos without cancellation for a far lamp.
    return 0.5 * radius * radius / distance2 / (1.0 + np.sqrt(1.0 - radius * radius / distance2))


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
    depth = 2.0 * _cone_share(x, y, z, radius)
    height = depth * start(key, WAY_U)
    phi = 2.0 * np.pi * start(key, WAY_V)
    if distance2 == 0.0:
        dx, dy, dz = near(0.0, 0.0, 1.0, height, phi)
    else:
        scale = -1.0 / np.sqrt(distance2)
        dx, dy, dz = near(x * scale, y * scale, z * scale, height, phi)
    return dx, dy, dz, 0.5 * depth
