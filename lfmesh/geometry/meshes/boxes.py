"""Intersection of lines with boxes, for the trees of facets, patches and round faces."""

import numpy as np

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel


@inlined
def part_inside(rate: float, room: float, first: float, last: float) -> tuple[float, float]:
    """Clip a line to a half-space, rate · t ≤ room.

    Parameters
    ----------
    rate : float
        Approach to the plane per distance along the line.
    room : float, mm
        Distance from the start of the line to the plane.
    first, last : float, mm
        Ends of the line before the clip.
    """
    if rate > 0.0:
        last = min(last, room / rate)
    elif rate < 0.0:
        first = max(first, room / rate)
    elif room < 0.0:
        last = -np.inf
    return first, last


@inlined
def slopes_of(ray: Ray) -> tuple[float, float, float]:
    """Return the distances along a ray for an advance of one along each axis, as used by `meets_box`."""
    return 1.0 / ray.dx, 1.0 / ray.dy, 1.0 / ray.dz


@inlined
def meets_box(
    low: Array, high: Array, ray: Ray, slopes: tuple[float, float, float], begin: float, end: float
) -> bool:  # fmt: skip
    """Tell whether a line meets a box between two distances.

    Parameters
    ----------
    low, high : (3,) float64, mm
    ray : Ray
    slopes : (3,) float
        From `slopes_of`, computed once for all boxes: multiplying takes four fifths of the time of dividing.
    begin, end : float, mm
    """
    begin, end = _within(low[0] - ray.x, high[0] - ray.x, slopes[0], begin, end)
    begin, end = _within(low[1] - ray.y, high[1] - ray.y, slopes[1], begin, end)
    begin, end = _within(low[2] - ray.z, high[2] - ray.z, slopes[2], begin, end)
    return begin <= end


@inlined
def _within(low: float, high: float, slope: float, begin: float, end: float) -> tuple[float, float]:
    """Clip a line to the slab between two planes of a box; a line in one of the planes counts as inside."""
    a, b = low * slope, high * slope
    if slope < 0.0:
        a, b = b, a
    return (a if a > begin else begin), (b if b < end else end)


@kernel
def box_entry(low: Array, high: Array, ray: Ray) -> float:
    """Return the distance to the entry of a ray into a box: 0 from inside, inf if it misses.

    Parameters
    ----------
    low, high : (3,) float64, mm
        Corners of the box.
    ray : Ray
    """
    near, far = 0.0, np.inf
    for axis in range(3):
        p, d = ray[axis], ray[3 + axis]
        if d == 0.0:
            if p < low[axis] or p > high[axis]:
                return np.inf
        else:
            a, b = (low[axis] - p) / d, (high[axis] - p) / d
            near, far = max(near, min(a, b)), min(far, max(a, b))
    return near if near <= far else np.inf
