"""The first crossing of a ray with a surface z(x, y), of one or of two zones, by steps that miss none."""

from typing import Any

import numpy as np

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel

SETTLED = 2e-15
"""Height over the surface, relative to the size of the coordinates, that counts as rounding."""

MOST_STEPS = 1000
"""Most steps towards a crossing. A ray takes about five, unless it almost touches the surface."""


def crossing_finder(shape_at: Any) -> Any:
    """Make the kernel that finds first crossings with surfaces of a form.

    Parameters
    ----------
    shape_at : kernel
        Called as ``shape_at(surface, x, y)``; returns the sag at a point and its slopes along x and y.

    Returns
    -------
    first_crossing : kernel
    """

    @kernel
    def first_crossing(
        surface: Any, ray: Ray, side: float, most: float, begin: float, end: float
    ) -> tuple[bool, float]:
        """Return whether a ray crosses a surface, and the distance of the first crossing.

        Along the ray, the height u over the surface is at least u + u' t − m t² / 2, with m a bound of its second
        derivative. A step to the root of this bound passes no crossing; near one it converges like Newton's method. A
        ray that starts on the surface and leaves it does not cross it there.

        Parameters
        ----------
        surface : Any
            Passed to `shape_at`.
        ray : Ray
            From the vertex; the length of its direction is the unit of distances.
        side : float
            1 for a ray in front of the surface, −1 behind it.
        most : float
            Bound m.
        begin, end : float
            Range of the search.
        """
        x, y, z, dx, dy, dz = ray
        size = abs(x) + abs(y) + abs(z)
        t = begin
        for _ in range(MOST_STEPS):
            sag, gx, gy = shape_at(surface, x + t * dx, y + t * dy)
            height = side * (sag - z - t * dz)
            rate = side * (gx * dx + gy * dy - dz)
            if height <= SETTLED * (size + abs(t)):
                if rate < 0.0:
                    return True, t - height / min(rate, -np.sqrt(2.0 * most * abs(height)))
                height = max(height, 0.0)
            root = np.sqrt(rate * rate + 2.0 * most * height)
            if rate > 0.0:
                if most == 0.0:
                    return False, 0.0
                t += (rate + root) / most
            elif root > rate:
                t += 2.0 * height / (root - rate)
            else:
                return False, 0.0
            if not t <= end:
                return False, 0.0
        return False, 0.0

    return first_crossing


def crossing_finder_over_zones(zone_at: Any) -> Any:
    """Make the kernel that finds first crossings with surfaces of an inner and an outer zone.

    Parameters
    ----------
    zone_at : kernel
        Called as ``zone_at(surface, outer, x, y)``; returns the sag of a zone's formula, and its slopes, also beside
        the zone.

    Returns
    -------
    first_crossing : kernel
        As from `crossing_finder`. The surface has its `border`.
    """

    @kernel
    def shape_at(zone: tuple[Any, int], x: float, y: float) -> tuple[float, float, float]:
        surface, outer = zone
        return zone_at(surface, outer, x, y)

    in_zone = crossing_finder(shape_at)

    @kernel
    def of_zone(
        surface: Any, outer: int, ray: Ray, side: float, most: float, limits: tuple[float, float]
    ) -> tuple[bool, float]:
        return in_zone((surface, outer), ray, side, most, limits[0], limits[1])

    @kernel
    def first_crossing(
        surface: Any, ray: Ray, side: float, most: float, begin: float, end: float
    ) -> tuple[bool, float]:
        """Return whether a ray crosses a surface of two zones, and the distance of the first crossing.

        The cylinder through the border divides the ray into parts within one zone, where no kink breaks the bound.

        Parameters
        ----------
        surface, ray, side, most, begin, end
            As for the function made by `crossing_finder`; `most` bounds both zones.
        """
        x, y, _, dx, dy, _ = ray
        a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - surface.border * surface.border
        low, high = end, end
        if a > 0.0:
            root = b * b - a * c
            if root > 0.0:
                low, high = (-b - np.sqrt(root)) / a, (np.sqrt(root) - b) / a
        elif c <= 0.0:
            low = begin
        low, high = min(max(low, begin), end), min(max(high, begin), end)
        met, t = False, 0.0
        if begin < low:
            met, t = of_zone(surface, 1, ray, side, most, (begin, low))
        if not met and low < high:
            met, t = of_zone(surface, 0, ray, side, most, (low, high))
        if not met and high < end:
            met, t = of_zone(surface, 1, ray, side, most, (high, end))
        return met, t

    return first_crossing
