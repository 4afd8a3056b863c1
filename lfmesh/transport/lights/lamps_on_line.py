"""Distances on a line by the light that lamps send there: equiangular sampling (Kulla & Fajardo, EGSR 2012).

The irradiance of a point at distance h from a line falls along it as 1 / (h² + s²), so that distances of that density
are those of even steps of the angle at which the point sees them. Of several lamps the densities add, each by its
largest intensity. A lamp with a size is taken for a point as far off the line as its size adds to h. Near a lamp that
is longer than thick the irradiance grows as one over the distance from its spine, the segment along its middle: within
two sizes of it that is a density of its own. So the sum stays in a bounded proportion to what the lamp sends, and says
where samples go, not what they count. None are drawn where a lamp that shines to one side sends nothing. Directional
light is the same all along a line. Where lamps are many, those of a node of their tree that is far from the line count
as one lamp of the node's size.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.lights.places import GRAIN
from lfmesh.transport.tables.lights import Lamps

Array = NDArray[np.float64]

NARROWEST = 2.0**-26
"""Least distance of a lamp from a line, over that from the line's start: nearer ones are told apart by no rounding."""

AROUND = 2.0
"""Distance from the middle of a lamp that is longer than thick, in its sizes, up to which its spine counts."""

ONE_SIDE = 2.0**-18
"""By how much 1 − cos of a bound of the directions of lamps that shine to one side may be above 1."""

FAR = 2.0
"""Distance of a node of lamps from a line, in its radii, above which they count as one."""


@kernel
def passes_lamp(lamps: Lamps, colour: int, line: Ray, first: float, last: float, within: float) -> bool:
    """Tell whether a part of a line comes near a lamp.

    Parameters
    ----------
    lamps : Lamps
    colour : int
        Number of the wavelength.
    line : Ray
        In the object frame.
    first, last : float, mm
        Its part; the last may be inf.
    within : float, mm
        Distance of the lamp that is near.
    """
    number = 0
    while number < len(lamps.nodes):
        node = lamps.nodes[number]
        power, s, h = _seen(lamps, number, colour, line)
        begin, end = _lit(lamps, number, line, first, last)
        past, within2 = min(max(s, begin), end) - s, within * within
        if node.lamp < 0:
            # No lamp is nearer than the middle by more than the radius, whose square `h` adds to the distance.
            within2 = (within + node.radius) ** 2 + node.radius * node.radius
        elif _is_long(lamps.rows[node.lamp]):
            # The distance from the spine along the line is convex.
            s, h, rise = _seen_from_spine(lamps.rows[node.lamp], line)
            past = rise * (min(max(s, begin), end) - s)
        is_near = power > 0.0 and begin < end and h * h + past * past < within2
        if is_near and node.lamp >= 0:
            return True
        number = number + 1 if is_near else node.skip
    return False


@kernel
def lamps_on_line(lamps: Lamps, colour: int, line: Ray, first: float, last: float) -> float:
    """Return the integral of `density_by_angle` over a part of a line, W/(sr mm); 0: there is no lamp.

    Parameters
    ----------
    lamps, colour, line, first, last
        As for `passes_lamp`.
    """
    whole, number = 0.0, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp = lamps.nodes[number].lamp
        power, s, h = _seen(lamps, number, colour, line)
        begin, end = _lit(lamps, number, line, first, last)
        if power > 0.0 and begin < end:
            whole += power * _angle(s, h, begin, end) / h
            if lamp >= 0 and _is_long(lamps.rows[lamp]):
                whole += power * _by_spine(lamps.rows[lamp], line, begin, end)
        number = _counted(lamps, lamps.nodes[number].skip, line)
    return whole


@kernel
def distance_by_angle(lamps: Lamps, colour: int, line: Ray, first: float, last: float, choice: float) -> float:
    """Return a distance on a part of a line, drawn by `density_by_angle`.

    Parameters
    ----------
    lamps, colour, line, first, last
        As for `passes_lamp`.
    choice : float
        Uniform below the integral.
    """
    t, number = first, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp = lamps.nodes[number].lamp
        power, s, h = _seen(lamps, number, colour, line)
        begin, end = _lit(lamps, number, line, first, last)
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
            own = power * _by_spine(lamps.rows[lamp], line, begin, end)
            if choice < own:
                return _distance_by_spine(lamps.rows[lamp], line, begin, end, choice / own)
            choice -= own
    return t


@kernel
def density_by_angle(lamps: Lamps, colour: int, line: Ray, t: float) -> float:
    """Return what all lamps send to a distance on a line, W/(sr mm²): the density of `distance_by_angle`, unnormalised.

    Parameters
    ----------
    lamps, colour, line
        As for `passes_lamp`.
    t : float, mm
    """
    total, number = 0.0, _counted(lamps, 0, line)
    while number < len(lamps.nodes):
        lamp = lamps.nodes[number].lamp
        power, s, h = _seen(lamps, number, colour, line)
        begin, end = _lit(lamps, number, line, -np.inf, np.inf)
        if power > 0.0 and begin <= t <= end:
            total += power / (h * h + (t - s) * (t - s))
            if lamp >= 0 and _is_long(lamps.rows[lamp]):
                light = lamps.rows[lamp]
                first, last = _around(light, line, begin, end)
                if first <= t <= last:
                    s, h, rise = _seen_from_spine(light, line)
                    total += power / (light.size * np.hypot(h, rise * (t - s)))
        number = _counted(lamps, lamps.nodes[number].skip, line)
    return total


@inlined
def lit_part(light: Any, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Return the part of a part of a line to which a lamp may shine: that in front of a lamp that shines to one side.

    Parameters
    ----------
    light : LIGHT
    line, first, last
        As for `passes_lamp`; the first is the larger one where nothing is lit.
    """
    # A cone of more than half a turn sends light backwards too.
    if light.outer > 1.0:
        return first, last
    return _part_in_front(light.direction, light.position, line, 0.0, first, last)


@inlined
def _part_in_front(
    axis: Array, place: Array, line: Ray, back: float, first: float, last: float
) -> tuple[float, float]:  # fmt: skip
    """Return the part of a part of a line in front of a plane across an axis, some distance behind a place."""
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
    """Return the angle at which a point at distance s along a line and h from it sees a part of the line, rad."""
    return np.arctan2(last - s, h) - np.arctan2(first - s, h)


@inlined
def _counted(lamps: Lamps, number: int, line: Ray) -> int:
    """Return the next node from some number on that counts as one lamp: a lamp, or lamps that are far from a line."""
    while number < len(lamps.nodes):
        node = lamps.nodes[number]
        if node.lamp >= 0 or not node.placed:
            break
        _, h2 = _past(node.middle, line)
        if h2 > (FAR * node.radius) ** 2:
            break
        number += 1
    return number


@inlined
def _past(place: Array, line: Ray) -> tuple[float, float]:
    """Return the distance on a line that is nearest to a place, mm, and its squared distance there."""
    px, py, pz = place[0] - line.x, place[1] - line.y, place[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    ex, ey, ez = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    return s, ex * ex + ey * ey + ez * ez


@inlined
def _seen(lamps: Lamps, number: int, colour: int, line: Ray) -> tuple[float, float, float]:
    """Return a node's intensity, W/sr, the distance on a line that is nearest to it, and its distance there, mm."""
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
    # A line that starts in a point lamp itself has no angles.
    return power if h > 0.0 else 0.0, s, h


@inlined
def _lit(lamps: Lamps, number: int, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Return the part of a part of a line to which the lamps of a node may shine."""
    node = lamps.nodes[number]
    if node.lamp >= 0:
        return lit_part(lamps.rows[node.lamp], line, first, last)
    # Bounds of directions are a little wider than half a turn where lamps shine to one side.
    if node.outer > 1.0 + ONE_SIDE:
        return first, last
    return _part_in_front(node.axis, node.middle, line, node.radius, first, last)


@inlined
def _is_long(light: Any) -> bool:
    """Tell whether a lamp is longer than thick."""
    return light.spine[0] != 0.0 or light.spine[1] != 0.0 or light.spine[2] != 0.0


@kernel
def _seen_from_spine(light: Any, line: Ray) -> tuple[float, float, float]:
    """Return the distance on a line that is nearest to a lamp's spine, mm, a distance there, mm, and its growth.

    With these three, s, h and k, the point at t on the line is at least √(h² + k² (t − s)²), less the lamp's thickness
    in h, away from the spine.
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
    """Return the part of a part of a line on which a lamp's spine counts; the first is the larger one if none is."""
    px, py, pz = light.position[0] - line.x, light.position[1] - line.y, light.position[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    px, py, pz = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    half2 = (AROUND * light.size) ** 2 - (px * px + py * py + pz * pz)
    if half2 <= 0.0:
        return np.inf, -np.inf
    return max(first, s - np.sqrt(half2)), min(last, s + np.sqrt(half2))


@kernel
def _by_spine(light: Any, line: Ray, first: float, last: float) -> float:
    """Return the integral over a part of a line of one over the lamp's size and the distance from its spine, 1/mm."""
    begin, end = _around(light, line, first, last)
    if begin >= end:
        return 0.0
    s, h, rise = _seen_from_spine(light, line)
    return (np.arcsinh(rise * (end - s) / h) - np.arcsinh(rise * (begin - s) / h)) / (rise * light.size)


@kernel
def _distance_by_spine(light: Any, line: Ray, first: float, last: float, choice: float) -> float:
    """Return a distance on a part of a line, drawn by one over the distance from a lamp's spine, by a random number."""
    begin, end = _around(light, line, first, last)
    s, h, rise = _seen_from_spine(light, line)
    low, high = np.arcsinh(rise * (begin - s) / h), np.arcsinh(rise * (end - s) / h)
    return min(max(s + h * np.sinh(low + choice * (high - low)) / rise, begin), end)
