"""Distances on a line by the light that lamps send there: equiangular sampling (Kulla & Fajardo, EGSR 2012).

The irradiance of a point at distance h from a line falls along it as 1 / (h² + s²), so that distances of that density
are those of even steps of the angle at which the point sees them. Of several lamps the densities add, each by its
intensity. A disk is taken for a point as far off the line as its radius adds to h, so that the density stays in a
constant proportion to what the disk sends, which is bounded; a spot or a profile as one of its largest intensity. Both
change where samples go, not what they count. None are drawn behind a disk or a spot, where it sends nothing.
Directional light is the same all along a line.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.tables.lights import DIRECTIONAL, DISK, SPOT

Array = NDArray[np.float64]

NARROWEST = 2.0**-26
"""Least distance of a lamp from a line, over that from the line's start: nearer ones are told apart by no rounding."""


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
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(lights[number], line, first, last)
        past = min(max(s, begin), end) - s
        if begin < end and power > 0.0 and h * h + past * past < within * within:
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
        power, s, h = _seen_from_lamp(lights, spectra, number, colour, line)
        begin, end = lit_part(lights[number], line, first, last)
        if power <= 0.0 or begin >= end:
            continue
        own = power * _angle(s, h, begin, end) / h
        t = s + h * np.tan(np.arctan2(begin - s, h) + min(choice / own, 1.0) * _angle(s, h, begin, end))
        t = min(max(t, begin), end)
        if choice < own:
            break
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
    return total


@inlined
def lit_part(light: Any, line: Ray, first: float, last: float) -> tuple[float, float]:
    """Return the part of a part of a line that is in front of a lamp: before a disk, or on a spot's side.

    Parameters
    ----------
    light : LIGHT
    line, first, last
        As for `passes_lamp`; the first is the larger one where nothing is lit.
    """
    # A cone of more than half a turn sends light backwards too.
    if light.kind != DISK and not (light.kind == SPOT and light.outer <= 1.0):
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
    if light.kind == DIRECTIONAL:
        return 0.0, 0.0, 1.0
    px, py, pz = light.position[0] - line.x, light.position[1] - line.y, light.position[2] - line.z
    s = px * line.dx + py * line.dy + pz * line.dz
    ex, ey, ez = px - s * line.dx, py - s * line.dy, pz - s * line.dz
    h2, power = ex * ex + ey * ey + ez * ez, light.peak
    if light.kind == DISK:
        h2, power = h2 + light.radius * light.radius, light.power / np.pi
    least = NARROWEST * (abs(px) + abs(py) + abs(pz))
    h = max(np.sqrt(h2), least)
    # A line that starts in a point lamp itself has no angles.
    return power * spectra[number, colour] if h > 0.0 else 0.0, s, h
