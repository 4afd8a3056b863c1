"""The first crossing of a ray with a surface z(x, y), by steps that miss none."""

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
