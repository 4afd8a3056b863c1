"""Distances on a line by the light that lamps send there: equiangular sampling (Kulla & Fajardo, EGSR 2012).

The irradiance of a point at distance h from a line falls along it as 1 / (h² + s²); such distances correspond to even
steps of the angle seen from the point. The densities of several lamps add, each weighted by its largest intensity. A
lamp with a size is a point with its size added to h in quadrature. Near a lamp that is longer than thick, the
irradiance grows as one over the distance from its spine, the segment along its middle; within two sizes of it that adds
its own density. So the sum stays in a bounded ratio to the light of the lamp. It decides where samples go, not their
weights. No distances are drawn behind a one-sided lamp. Directional light is constant along a line. In the tree of many
lamps, a node far from the line counts as one lamp of its size. The line is moved into the frame of each lamp's mover.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.moving import ray_between
from lfmesh.transport.events.volume import Line
from lfmesh.transport.lights.places import GRAIN
from lfmesh.transport.tables.lights import Lamps

Array = NDArray[np.float64]

NARROWEST = 2.0**-26
"""Least distance of a lamp from a line, over its distance from the line's start; rounding hides smaller ones."""

AROUND = 2.0
"""Distance from the middle of a lamp that is longer than thick, in its sizes, within which its spine counts."""

ONE_SIDE = 2.0**-18
"""Tolerance above 1 for 1 − cos of the bound of directions of one-sided lamps."""

FAR = 2.0
"""Distance of a node of lamps from a line, in its radii, above which it counts as one lamp."""


@kernel
def passes_lamp(lamps: Lamps, line: Line, first: float, last: float, within: float) -> bool:
    """Tell whether a part of a line comes near a lamp.

    Parameters
    ----------
    lamps : Lamps
    line : Line
    first, last : float, mm
        Part of the line; the last may be inf.
    within : float, mm
        Distance below which a lamp is near.
    """
    number = 0
    while number < len(lamps.nodes):
        node = lamps.nodes[number]
        ray = _ray_to(node, line)
        power, s, h = _seen(lamps, number, line.colour, ray)
        begin, end = _lit(lamps, number, ray, first, last)
        past, within2 = min(max(s, begin), end) - s, within * within
        if node.lamp < 0:
            # No lamp is nearer than the middle by more than the radius, whose square `h` adds to the distance.
            within2 = (within + node.radius) ** 2 + node.radius * node.radius
        elif _is_long(lamps.rows[node.lamp]):
            # The distance from the spine along the line is convex.
            s, h, rise = _seen_from_spine(lamps.rows[node.lamp], ray)
            past = rise * (min(max(s, begin), end) - s)
        is_near = power > 0.0 and begin < end and h * h + past * past < within2
        if is_near and node.lamp >= 0:
            return True
        number = number + 1 if is_near else node.skip
    return False


@kernel
def lamps_on_line(lamps: Lamps, line: Line, first: float, last: float) -> float:
    """Return the integral of `density_by_angle` over a part of a line, W/(sr mm); 0 without lamps.

    Parameters
    ----------
    lamps, line, first, last
        As for `passes_lamp`.
    """
    whole, number = 0.0, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp, ray = lamps.nodes[number].lamp, _ray_to(lamps.nodes[number], line)
        power, s, h = _seen(lamps, number, line.colour, ray)
        begin, end = _lit(lamps, number, ray, first, last)
        if power > 0.0 and begin < end:
            whole += power * _angle(s, h, begin, end) / h
            if lamp >= 0 and _is_long(lamps.rows[lamp]):
                whole += power * _by_spine(lamps.rows[lamp], ray, begin, end)
        number = _counted(lamps, lamps.nodes[number].skip, line)
    return whole


@kernel
def distance_by_angle(lamps: Lamps, line: Line, first: float, last: float, choice: float) -> float:
    """Draw a distance on a part of a line by `density_by_angle`.

    Parameters
    ----------
    lamps, line, first, last
        As for `passes_lamp`.
    choice : float
        Uniform between 0 and the integral.
    """
    t, number = first, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp, ray = lamps.nodes[number].lamp, _ray_to(lamps.nodes[number], line)
        power, s, h = _seen(lamps, number, line.colour, ray)
        begin, end = _lit(lamps, number, ray, first, last)
        number = _counted(lamps, lamps.nodes[number].skip, line)
        if power <= 0.0 or begin >= end:
            continue
        own = power * _angle(s, h, begin, end) / h
        t = s + h * np.tan(np.arctan2(begin - s, h) + min(choice / own, 1.0) * _angle(s, h, begin, end))
        t = min(max(t, begin), end)
        if choice < own:
            break
        choice -= own
        if lamp >= 0 and _is_long(lamps.rows[lamp]):
            own = power * _by_spine(lamps.rows[lamp], ray, begin, end)
            if choice < own:
                return _distance_by_spine(lamps.rows[lamp], ray, begin, end, choice / own)
            choice -= own
    return t


@kernel
def density_by_angle(lamps: Lamps, line: Line, t: float) -> float:
    """Return the unnormalised density of `distance_by_angle` at a distance on a line, W/(sr mm²).

    Parameters
    ----------
    lamps, line
        As for `passes_lamp`.
    t : float, mm
    """
    total, number = 0.0, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp, ray = lamps.nodes[number].lamp, _ray_to(lamps.nodes[number], line)
        power, s, h = _seen(lamps, number, line.colour, ray)
        begin, end = _lit(lamps, number, ray, -np.inf, np.inf)
        if power > 0.0 and begin <= t <= end:
            total += power / (h * h + (t - s) * (t - s))
            if lamp >= 0 and _is_long(lamps.rows[lamp]):
                light = lamps.rows[lamp]
                first, last = _around(light, ray, begin, end)
                if first <= t <= last:
                    s, h, rise = _seen_from_spine(light, ray)
                    total += power / (light.size * np.hypot(h, rise * (t - s)))
        number = _counted(lamps, lamps.nodes[number].skip, line)
    return total


@inlined
def lit_part(light: Any, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Restrict a part of a line to the places that a lamp may light: for a one-sided lamp, in front of it.

    Parameters
    ----------
    light : LIGHT
    line : Ray
        In the frame of the light's mover.
    first, last : float, mm
        As for `passes_lamp`. If nothing is lit, first > last is returned.
    """
    # A cone of more than half a turn sends light backwards too.
    if light.outer > 1.0:
        return first, last
    return _part_in_front(light.direction, light.position, line, 0.0, first, last)


@inlined
def _part_in_front(
    axis: Array, place: Array, line: Ray, back: float, first: float, last: float
) -> tuple[float, float]:  # fmt: skip
    """Restrict a part of a line to the front of a plane across an axis, at distance `back` behind a place."""
    ax, ay, az = axis[0], axis[1], axis[2]
    px, py, pz = line.x - place[0], line.y - place[1], line.z - place[2]
    height, rise = px * ax + py * ay + pz * az + back, line.dx * ax + line.dy * ay + line.dz * az
    if rise > 0.0:
        return max(first, -height / rise), last
    if rise < 0.0:
        return first, min(last, -height / rise)
    return (first, last) if height > 0.0 else (np.inf, -np.inf)


@inlined
def _angle(s: float, h: float, first: float, last: float) -> float:
    """Return the angle, rad, of a part of a line seen from a point at distance s along the line and h from it."""
    return np.arctan2(last - s, h) - np.arctan2(first - s, h)


@inlined
def _ray_to(node: Any, line: Line) -> Ray:
    """Return the ray of a line in the frame of a node's mover."""
    return ray_between(line.moving, line.mover, node.mover, line.ray)


@inlined
def _counted(lamps: Lamps, number: int, line: Line) -> int:
    """Return the next node, from a number on, that counts as one lamp: a lamp, or lamps far from the line."""
    while number < len(lamps.nodes):
        node = lamps.nodes[number]
        if node.lamp >= 0 or not node.placed:
            break
        _, h2 = _past(node.middle, _ray_to(node, line))
        if h2 > (FAR * node.radius) ** 2:
            break
        number += 1
    return number


@inlined
def _past(place: Array, line: Ray) -> tuple[float, float]:
    """Return the distance along a line of closest approach to a place, mm, and the squared distance there."""
    px, py, pz = place[0] - line.x, place[1] - line.y, place[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    ex, ey, ez = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    return s, ex * ex + ey * ey + ez * ez


@inlined
def _seen(lamps: Lamps, number: int, colour: int, line: Ray) -> tuple[float, float, float]:
    """Return a node's intensity, W/sr, the distance along a line of closest approach, and its distance there, mm."""
    node = lamps.nodes[number]
    if not node.placed:
        return 0.0, 0.0, 1.0
    power, size = lamps.power[number, colour] * node.per_sr, node.radius
    if node.lamp >= 0:
        light = lamps.rows[node.lamp]
        power, size = light.peak * lamps.spectra[node.lamp, colour], light.size
    s, h2 = _past(node.middle, line)
    h2 = h2 + size * size
    px, py, pz = node.middle[0] - line.x, node.middle[1] - line.y, node.middle[2] - line.z
    least = NARROWEST * (abs(px) + abs(py) + abs(pz))
    h = max(np.sqrt(h2), least)
    # A line that starts at a point lamp has no angles.
    return power if h > 0.0 else 0.0, s, h


@inlined
def _lit(lamps: Lamps, number: int, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Restrict a part of a line to the places that a node's lamps may light."""
    node = lamps.nodes[number]
    if node.lamp >= 0:
        return lit_part(lamps.rows[node.lamp], line, first, last)
    # For one-sided lamps, bounds of directions are a little wider than half a turn.
    if node.outer > 1.0 + ONE_SIDE:
        return first, last
    return _part_in_front(node.axis, node.middle, line, node.radius, first, last)


@inlined
def _is_long(light: Any) -> bool:
    """Tell whether a lamp is longer than thick."""
    return light.spine[0] != 0.0 or light.spine[1] != 0.0 or light.spine[2] != 0.0


@kernel
def _seen_from_spine(light: Any, line: Ray) -> tuple[float, float, float]:
    """Return the distance along a line of closest approach to a lamp's spine, mm, a distance there, mm, and its growth.

    With these three, s, h and k, the point at t on the line is at least √(h² + k² (t − s)²) away from the spine, with h
    taken without the lamp's thickness.
    """
    px, py, pz = light.position[0] - line.x, light.position[1] - line.y, light.position[2] - line.z
    mx, my, mz = light.spine[0], light.spine[1], light.spine[2]
    length = np.sqrt(mx * mx + my * my + mz * mz)
    s, along = px * line.dx + py * line.dy + pz * line.dz, mx * line.dx + my * line.dy + mz * line.dz
    px, py, pz = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    mx, my, mz = mx - along * line.dx, my - along * line.dy, mz - along * line.dz
    across2 = mx * mx + my * my + mz * mz
    share = min(max(-(px * mx + py * my + pz * mz) / across2, -1.0), 1.0) if across2 > 0.0 else 0.0
    px, py, pz = px + share * mx, py + share * my, pz + share * mz
    h = np.sqrt(px * px + py * py + pz * pz + light.thickness * light.thickness)
    return s + share * along, max(h, GRAIN * (light.size + abs(s))), max(np.sqrt(across2) / length, NARROWEST)


@inlined
def _around(light: Any, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Restrict a part of a line to the range where a lamp's spine counts; if there is none, first > last."""
    px, py, pz = light.position[0] - line.x, light.position[1] - line.y, light.position[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    px, py, pz = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    half2 = (AROUND * light.size) ** 2 - (px * px + py * py + pz * pz)
    if half2 <= 0.0:
        return np.inf, -np.inf
    return max(first, s - np.sqrt(half2)), min(last, s + np.sqrt(half2))


@kernel
def _by_spine(light: Any, line: Ray, first: float, last: float) -> float:
    """Return the integral along a line of 1 / (size of the lamp · distance from its spine), 1/mm."""
    begin, end = _around(light, line, first, last)
    if begin >= end:
        return 0.0
    s, h, rise = _seen_from_spine(light, line)
    return (np.arcsinh(rise * (end - s) / h) - np.arcsinh(rise * (begin - s) / h)) / (rise * light.size)


@kernel
def _distance_by_spine(light: Any, line: Ray, first: float, last: float, choice: float) -> float:
    """Return a distance on a part of a line, drawn by one over the distance from a lamp's spine."""
    begin, end = _around(light, line, first, last)
    s, h, rise = _seen_from_spine(light, line)
    low, high = np.arcsinh(rise * (begin - s) / h), np.arcsinh(rise * (end - s) / h)
    return min(max(s + h * np.sinh(low + choice * (high - low)) / rise, begin), end)
