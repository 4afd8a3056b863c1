"""Distances on a line by the light that lamps send there: equiangular sampling (Kulla & Fajardo, EGSR 2012).

The irradiance of a point at distance h from a line falls along it as 1 / (h² + s²), so that distances of that density
are those of even steps of the angle at which the point sees them. Of several lamps the densities add, each by its
largest intensity. A lamp with a size is taken for a point as far off the line as its size adds to h. Near a lamp that
is longer than thick the irradiance grows as one over the distance from its spine, the segment along its middle: within
two sizes of it that is a density of its own. So the sum stays in a bounded proportion to what the lamp sends, and says
where samples go, not what they count. None are drawn where a lamp that shines to one side sends nothing. Directional
light is the same all along a line.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.lights.places import GRAIN

Array = NDArray[np.float64]

NARROWEST = 2.0**-26
"""Least distance of a lamp from a line, over that from the line's start: nearer ones are told apart by no rounding."""

AROUND = 2.0
"""Distance from the middle of a lamp that is longer than thick, in its sizes, up to which its spine counts."""


@kernel
def passes_lamp(
    lights: NDArray[np.void], spectra: Array, colour: int, line: Ray, first: float, last: float, within: float
) -> bool:  # fmt: skip
    """Tell whether a part of a line comes near a lamp.

    Parameters
    ----------
    lights : (lamps,) LIGHT
    spectra : (lamps, wavelengths) float64
    colour : int
        Number of the wavelength.
    line : Ray
        In the object frame.
    first, last : float, mm
        Its part; the last may be inf.
    within : float, mm
        Distance of the lamp that is near.
    """
    for number in range(len(lights)):
        light = lights[number]
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(light, line, first, last)
        if power <= 0.0 or begin >= end:
            continue
        if _is_long(light):
            # The distance from the spine along the line is convex.
            s, h, rise = _seen_from_spine(light, line)
            past = rise * (min(max(s, begin), end) - s)
        else:
            past = min(max(s, begin), end) - s
        if h * h + past * past < within * within:
            return True
    return False


@kernel
def lamps_on_line(lights: NDArray[np.void], spectra: Array, colour: int, line: Ray, first: float, last: float) -> float:
    """Return the integral of `density_by_angle` over a part of a line, W/(sr mm); 0: there is no lamp.

    Parameters
    ----------
    lights, spectra, colour, line, first, last
        As for `passes_lamp`.
    """
    whole = 0.0
    for number in range(len(lights)):
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(lights[number], line, first, last)
        if power > 0.0 and begin < end:
            whole += power * _angle(s, h, begin, end) / h
            if _is_long(lights[number]):
                whole += power * _by_spine(lights[number], line, begin, end)
    return whole


@kernel
def distance_by_angle(
    lights: NDArray[np.void], spectra: Array, colour: int, line: Ray, first: float, last: float, choice: float
) -> float:  # fmt: skip
    """Return a distance on a part of a line, drawn by `density_by_angle`.

    Parameters
    ----------
    lights, spectra, colour, line, first, last
        As for `passes_lamp`.
    choice : float
        Uniform below the integral.
    """
    t = first
    for number in range(len(lights)):
        light = lights[number]
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(light, line, first, last)
        if power <= 0.0 or begin >= end:
            continue
        own = power * _angle(s, h, begin, end) / h
        t = s + h * np.tan(np.arctan2(begin - s, h) + min(choice / own, 1.0) * _angle(s, h, begin, end))
        t = min(max(t, begin), end)
        if choice < own:
            break
        choice -= own
        if _is_long(light):
            own = power * _by_spine(light, line, begin, end)
            if choice < own:
                return _distance_by_spine(light, line, begin, end, choice / own)
            choice -= own
    return t


@kernel
def density_by_angle(lights: NDArray[np.void], spectra: Array, colour: int, line: Ray, t: float) -> float:
    """Return what all lamps send to a distance on a line, W/(sr mm²): the density of `distance_by_angle`, unnormalised.

    Parameters
    ----------
    lights, spectra, colour, line
        As for `passes_lamp`.
    t : float, mm
    """
    total = 0.0
    for number in range(len(lights)):
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(lights[number], line, -np.inf, np.inf)
        if power > 0.0 and begin <= t <= end:
            total += power / (h * h + (t - s) * (t - s))
            if _is_long(lights[number]):
                first, last = _around(lights[number], line, begin, end)
                if first <= t <= last:
                    s, h, rise = _seen_from_spine(lights[number], line)
                    total += power / (lights[number].size * np.hypot(h, rise * (t - s)))
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
    ax, ay, az = light.direction[0], light.direction[1], light.direction[2]
    px, py, pz = line.x - light.position[0], line.y - light.position[1], line.z - light.position[2]
    height, rise = px * ax + py * ay + pz * az, line.dx * ax + line.dy * ay + line.dz * az
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
def _seen_from_lamp(
    lights: NDArray[np.void], spectra: Array, number: int, colour: int, line: Ray
) -> tuple[float, float, float]:
    """Return a lamp's intensity, W/sr, the distance on a line that is nearest to it, and its distance there, mm."""
    light: Any = lights[number]
    if not light.placed:
        return 0.0, 0.0, 1.0
    px, py, pz = light.position[0] - line.x, light.position[1] - line.y, light.position[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    ex, ey, ez = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    h2, power = ex * ex + ey * ey + ez * ez + light.size * light.size, light.peak
    least = NARROWEST * (abs(px) + abs(py) + abs(pz))
    h = max(np.sqrt(h2), least)
    # A line that starts in a point lamp itself has no angles.
    return power * spectra[number, colour] if h > 0.0 else 0.0, s, h


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
