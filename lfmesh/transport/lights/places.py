"""Points that lamps shine from: random ones, and ones that are drawn as another point sees the lamp.

Only this module knows the shapes of lamps. A lamp's light at a point is its intensity over the squared distance, from a
point of the lamp that is drawn by its length or area. Close by that is unbounded, so points of lines and rectangles are
drawn by the angles at which they are seen, and those of other flat lamps in part by their solid angle.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.scattering import near
from lfmesh.transport.tables.lights import ROUND, STRAIGHT

NEAR_SIZES = 2.0
"""Distance from a flat lamp, in its sizes, below which its points are drawn by solid angle too."""

FAR_SIZES = 16.0
"""Distance from a line or rectangle, in its sizes, above which its points look alike, and are drawn evenly."""

GRAIN = 2.0**-50
"""Least distance from a lamp, over those of its middle and of the point that sees it: places have no more digits."""


@inlined
def point_of_light(light: Any, u: float, v: float) -> tuple[float, float, float]:
    """Return a random point of a light that is somewhere, mm, object frame: uniform by its length or area.

    Parameters
    ----------
    light : LIGHT
    u, v : float
        Random numbers, uniform in [0, 1), of a light that has a size.
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
    """Tell whether a flat light holds a point of its plane, given from its middle, mm."""
    return px * px + py * py + pz * pz <= light.half[0] * light.half[0]


@inlined
def point_as_seen(
    light: Any, x: float, y: float, z: float, u: float, v: float, nearby: bool
) -> tuple[float, float, float, float]:
    """Return a random point of a light that is somewhere, as another point sees it, and its share.

    Parameters
    ----------
    light : LIGHT
    x, y, z : float, mm
        The point that sees it, object frame.
    u, v : float
        Random numbers, uniform in [0, 1), of a light that has a size.
    nearby : bool
        The point may be as near to the lamp as may be: it is in a medium.

    Returns
    -------
    px, py, pz : float, mm
        Point of the light, object frame.
    share : float
        Density of points that are uniform by length or area over that with which this one was drawn; 0: none was.
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
    """Return a point of a near flat lamp as `point_as_seen` does, by area or with equal chance by solid angle.

    Points of even area alone would leave cos θ / r², over that density, unbounded beside the lamp. So with equal chance
    the direction towards the lamp's plane is drawn evenly, and the sum of both densities divides the light (balance
    heuristic): what one point brings is then below 4π times the lamp's radiance.

    Parameters
    ----------
    light : LIGHT
    sx, sy, sz : float, mm
        The point that sees it, from its middle.
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
    """Return a point of a line or a rectangle as `point_as_seen` does, by even steps of angles.

    Of a rectangle a line along its first axis is drawn first, by even steps of the angle at which the foot of the point
    on the plane across that axis sees the other one. On the line, steps are even in the sine of the angle from the
    perpendicular. What a point brings is then bounded: from a line whose intensity follows the sine, it is always the
    same; from a rectangle by Lambert's law, it is below 2π times the radiance.

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
    # sin(end) − sin(begin) without the digits that cancel where the lamp is far aside.
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
