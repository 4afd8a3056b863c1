"""Radiant intensity of lamps, and directions drawn by it.

Only this module knows the angular distributions of lamps, which are the same from each point of a lamp. `intensity` has
a branch for each law, and so has `drawn_by_intensity`, which must draw accordingly.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import drawn_by, piece_with
from lfmesh.optics.scattering import near
from lfmesh.transport.tables.lights import CONE, EVEN, LAMBERT, SINE, Profiles

MOST_STEPS = 64
"""Steps of Newton's method, or of bisection, that give an angle to its last digits."""


@inlined
def intensity(profiles: Profiles, light: Any, dx: float, dy: float, dz: float) -> float:
    """Return the radiant intensity of a lamp, W/sr, as if an extended lamp were concentrated in one of its points.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    dx, dy, dz : float
        Unit direction of the light.
    """
    if light.emission == EVEN:
        return light.peak
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    if light.emission == LAMBERT:
        return light.peak * max(0.0, dx * ax + dy * ay + dz * az)
    if light.emission == SINE:
        nx, ny, nz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
        return light.peak * np.sqrt(nx * nx + ny * ny + nz * nz)
    if light.emission == CONE:
        ex, ey, ez = dx - ax, dy - ay, dz - az
        # 1 − cos of the angle from the axis.
        height = 0.5 * (ex * ex + ey * ey + ez * ez)
        if height <= light.inner:
            return light.peak
        return light.peak * (light.outer - height) / (light.outer - light.inner) if height < light.outer else 0.0
    return light.power * _profile_at(profiles, light, dx, dy, dz)


@kernel
def _profile_at(profiles: Profiles, light: Any, dx: float, dy: float, dz: float) -> float:
    """Return the intensity of a lamp with a profile over its power, 1/sr."""
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
def drawn_by_intensity(profiles: Profiles, light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Draw a direction of a lamp's light with a density of intensity over power.

    Parameters
    ----------
    profiles : Profiles
    light : LIGHT
    u, v : float
        Uniform in [0, 1).
    """
    axis, across = light.direction, light.across
    if light.emission == EVEN:
        return near(axis[0], axis[1], axis[2], 2.0 * u, 2.0 * np.pi * v)
    if light.emission == LAMBERT:
        return near(axis[0], axis[1], axis[2], u / (1.0 + np.sqrt(1.0 - u)), 2.0 * np.pi * v)
    if light.emission == SINE:
        # The cosine is a coordinate of a random point in a circle; its place on the chord gives the azimuth.
        cosine, on_chord = np.sqrt(u) * np.cos(2.0 * np.pi * v), np.sqrt(u) * np.sin(2.0 * np.pi * v)
        half_chord = np.sqrt(1.0 - cosine * cosine)
        turn = on_chord / half_chord if half_chord > 0.0 else 0.0
        return near(axis[0], axis[1], axis[2], 1.0 - cosine, np.pi * (1.0 + turn))
    if light.emission == CONE:
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
    # The remainder of the first number is a new random number.
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
    """Return ∫ I sin θ dθ from `low` to `theta`, for an intensity I that is linear from a at `low` to b at `high`."""
    slope = (b - a) / (high - low)
    middle, half = 0.5 * (low + theta), 0.5 * (theta - low)
    # Cosines and sines of sums, so that differences of near numbers do not cancel.
    even = 2.0 * np.sin(middle) * np.sin(half)
    odd = 2.0 * np.cos(middle) * np.sin(half) - 2.0 * half * np.cos(theta)
    return a * even + slope * odd


@kernel
def _angle_in_ring(low: float, high: float, a: float, b: float, u: float) -> float:
    """Return the angle below which a share u of a ring's light lies, by bracketed Newton's method."""
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
