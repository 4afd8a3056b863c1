"""Random points of lamps, with or without regard to the point that sees the lamp.

Only this module knows the shapes of lamps. A lamp's light at a point is its intensity over the squared distance, from a
point of the lamp drawn by length or area. That is unbounded near the lamp, so points of lines and rectangles are drawn
by apparent angles, and points of other flat lamps in part by solid angle.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.scattering import near
from lfmesh.transport.tables.lights import ROUND, STRAIGHT

NEAR_SIZES = 2.0
"""Distance from a flat lamp, in its sizes, below which its points are drawn by solid angle too."""

FAR_SIZES = 16.0
"""Distance from a line or rectangle, in its sizes, above which its points are drawn evenly."""

GRAIN = 2.0**-50
"""Least distance from a lamp, over its size plus the distance of its middle; rounding hides smaller ones."""


@inlined
def point_of_light(light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random point of a light with a position, mm, object frame, uniform over its length or area.

    Parameters
    ----------
    light : LIGHT
    u, v : float
        Uniform in [0, 1); used if the light has a size.
    """
    x, y, z = light.position[0], light.position[1], light.position[2]
    if light.size <= 0.0:
        return x, y, z
    if light.shape == ROUND:
        r, phi = light.half[0] * np.sqrt(u), 2.0 * np.pi * v
        a, b = r * np.cos(phi), r * np.sin(phi)
    else:
        a, b = light.half[0] * (2.0 * u - 1.0), light.half[1] * (2.0 * v - 1.0)
    e = light.across
    return x + a * e[0, 0] + b * e[1, 0], y + a * e[0, 1] + b * e[1, 1], z + a * e[0, 2] + b * e[1, 2]


@inlined
def _holds(light: Any, px: float, py: float, pz: float) -> bool:
    """Tell whether a point of a flat light's plane, relative to its middle, mm, lies on the light."""
    return px * px + py * py + pz * pz <= light.half[0] * light.half[0]


@inlined
def point_as_seen(
    light: Any, x: float, y: float, z: float, u: float, v: float, nearby: bool
) -> tuple[float, float, float, float]:
    """Draw a point of a light with a position, as another point sees it; return it with its share.

    Parameters
    ----------
    light : LIGHT
    x, y, z : float, mm
        The point that sees it, object frame.
    u, v : float
        Uniform in [0, 1); used if the light has a size.
    nearby : bool
        The point is in a medium, so it may be arbitrarily close to the lamp.

    Returns
    -------
    px, py, pz : float, mm
        Point of the light, object frame.
    share : float
        Uniform density by length or area, over the density of this draw; 0: nothing drawn.
    """
    if light.size <= 0.0:
        return light.position[0], light.position[1], light.position[2], 1.0
    sx, sy, sz = x - light.position[0], y - light.position[1], z - light.position[2]
    far2 = sx * sx + sy * sy + sz * sz
    if light.shape == STRAIGHT:
        if far2 < (FAR_SIZES * light.size) ** 2:
            return _point_by_angles(light, sx, sy, sz, u, v)
    elif nearby and far2 <= (NEAR_SIZES * light.size) ** 2:
        return _point_by_solid_angle(light, sx, sy, sz, u, v)
    px, py, pz = point_of_light(light, u, v)
    return px, py, pz, 1.0


@kernel
def _point_by_solid_angle(
    light: Any, sx: float, sy: float, sz: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a point of a near flat lamp as `point_as_seen` does, by area or solid angle with equal chance.

    Points uniform by area alone would leave cos θ / r² unbounded close to the lamp. So half of the draws choose a
    uniform direction towards the lamp's plane, and the sum of both densities divides the light (balance heuristic). One
    point then brings less than 4π times the lamp's radiance.

    Parameters
    ----------
    light : LIGHT
    sx, sy, sz : float, mm
        The point that sees it, relative to its middle.
    u, v : float
    """
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    height = sx * ax + sy * ay + sz * az
    sense = 1.0 if height > 0.0 else -1.0
    height *= sense
    mx, my, mz = light.position[0], light.position[1], light.position[2]
    if height <= 0.0:
        return mx, my, mz, 0.0
    if u < 0.5:
        px, py, pz = point_of_light(light, 2.0 * u, v)
        ux, uy, uz = px - mx - sx, py - my - sy, pz - mz - sz
        reach2 = ux * ux + uy * uy + uz * uz
        cosine = height / np.sqrt(reach2)
    else:
        # 1 − cos θ uniform below 1.
        ux, uy, uz = near(-sense * ax, -sense * ay, -sense * az, 2.0 * u - 1.0, 2.0 * np.pi * v)
        cosine = 2.0 - 2.0 * u
        reach = height / cosine
        px, py, pz, reach2 = sx + reach * ux, sy + reach * uy, sz + reach * uz, reach * reach
        if not _holds(light, px, py, pz):
            return mx, my, mz, 0.0
        px, py, pz = px + mx, py + my, pz + mz
    return px, py, pz, reach2 / (0.5 * reach2 + 0.25 / np.pi * cosine * light.area)


@kernel
def _point_by_angles(
    light: Any, sx: float, sy: float, sz: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a point of a line or a rectangle as `point_as_seen` does, uniform in angles.

    In a rectangle, a line along its first axis is drawn, uniform in the angle along the second axis as seen from the
    foot of the point on the plane across the first. On the line, the draw is uniform in the sine of the angle from the
    perpendicular. The light of one point is then constant for a line with an intensity that follows the sine, and below
    2π times the radiance for a Lambertian rectangle.

    Parameters
    ----------
    light, sx, sy, sz, u, v
        As for `_point_by_solid_angle`.
    """
    e, scale = light.across, light.size + abs(sx) + abs(sy) + abs(sz)
    a = sx * e[0, 0] + sy * e[0, 1] + sz * e[0, 2]
    b, share = 0.0, 1.0
    if light.half[1] > 0.0:
        half = light.half[1]
        foot = sx * e[1, 0] + sy * e[1, 1] + sz * e[1, 2]
        hx, hy, hz = (
            sx - a * e[0, 0] - foot * e[1, 0],
            sy - a * e[0, 1] - foot * e[1, 1],
            sz - a * e[0, 2] - foot * e[1, 2],
        )
        h = max(np.sqrt(hx * hx + hy * hy + hz * hz), GRAIN * scale)
        begin = np.arctan2(-half - foot, h)
        angle = np.arctan2(2.0 * half * h, h * h + (foot + half) * (foot - half))
        b = min(max(foot + h * np.tan(begin + v * angle), -half), half)
        share = angle * (h * h + (b - foot) * (b - foot)) / (2.0 * half * h)
    half = light.half[0]
    qx, qy, qz = sx - a * e[0, 0] - b * e[1, 0], sy - a * e[0, 1] - b * e[1, 1], sz - a * e[0, 2] - b * e[1, 2]
    h = max(np.sqrt(qx * qx + qy * qy + qz * qz), GRAIN * scale)
    begin, end = np.arctan2(-half - a, h), np.arctan2(half - a, h)
    angle = np.arctan2(2.0 * half * h, h * h + (a + half) * (a - half))
    # sin(end) − sin(begin) without cancellation for a lamp far to the side.
    sines = 2.0 * np.cos(0.5 * (begin + end)) * np.sin(0.5 * angle)
    sine = min(max(np.sin(begin) + u * sines, -1.0), 1.0)
    cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
    along = min(max(a + h * sine / cosine, -half), half) if cosine > 0.0 else (half if sine > 0.0 else -half)
    reach2 = h * h + (along - a) * (along - a)
    share *= sines * reach2 * np.sqrt(reach2) / (2.0 * half * h * h)
    return (
        light.position[0] + along * e[0, 0] + b * e[1, 0],
        light.position[1] + along * e[0, 1] + b * e[1, 1],
        light.position[2] + along * e[0, 2] + b * e[1, 2],
        share,
    )
