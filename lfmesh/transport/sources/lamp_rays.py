"""Rays that lamps emit: where packets of the forward method start."""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import kernel
from lfmesh.kernels.search import drawn_by
from lfmesh.optics.scattering import near, tangents
from lfmesh.transport.lights.lamps import intensity
from lfmesh.transport.packets.random import start
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, POINT, SPOT, Profiles
from lfmesh.transport.tables.tables import ObjectTables

MOST_STEPS = 64
"""Of Newton's method, or of halving, after which an angle is known to its last digits."""

# Dimensions of the numbers that a light's packet starts from; dimension 0 chooses the light.
PLACE_U, PLACE_V, WAY_U, WAY_V = 1, 2, 3, 4


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
