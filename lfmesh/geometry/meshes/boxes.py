"""Boxes that a line is tested against, as the trees of facets and of patches do."""

import numpy as np

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel


@inlined
def part_inside(rate: float, room: float, first: float, last: float) -> tuple[float, float]:
    """Return the part of a line between two distances that lies inside a plane: where rate · t ≤ room.

    Parameters
    ----------
    rate : float
        At which the line comes nearer to the plane, over the distance along it.
    room : float, mm
        From the start of the line to the plane.
    first, last : float, mm
    """
    if rate > 0.0:
        last = min(last, room / rate)
    elif rate < 0.0:
        first = max(first, room / rate)
    elif room < 0.0:
        last = -np.inf
    return first, last


@inlined
def meets_box(low: Array, high: Array, ray: Ray, begin: float, end: float) -> bool:
    """Tell whether a line meets a box between two distances.

    Parameters
    ----------
    low, high : (3,) float64, mm
    ray : Ray
    begin, end : float, mm
    """
    x, y, z, dx, dy, dz = ray
    for axis in range(3):
        o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
        begin, end = part_inside(d, high[axis] - o, begin, end)
        begin, end = part_inside(-d, o - low[axis], begin, end)
    return begin <= end


@kernel
def box_entry(low: Array, high: Array, ray: Ray) -> float:
    """Return the distance at which a ray enters a box: 0 from inside, inf if it misses.

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
