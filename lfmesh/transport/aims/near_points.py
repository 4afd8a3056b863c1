"""Lens's opening as seen from close points, in a table by height and distance.

Up to the lens, a table by field angle and inverse distance, as in `pupil`, would extend to infinite tangents. There the
disks vary smoothly with height and distance instead. If the lens passes only a limited range of angles, the disk
shrinks to the point itself in proportion to its distance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.aims.disks import covering
from lfmesh.transport.tables.tables import Disks

Array = NDArray[np.float64]

HEIGHTS = 33
"""Number of evenly spaced heights at which the opening is measured."""

DISTANCES = 9
"""Number of evenly spaced distances at which it is measured if the points do not all lie in one plane."""

NEAREST = 1e-4
"""Distance that replaces 0 in measurements, relative to the depth up to which points are near."""

VANISHING = 0.1
"""Share of the radius measured there below which the disk is taken to vanish in the plane itself."""


class NearViewpoints(NamedTuple):
    """Viewpoints close before the lens.

    Attributes
    ----------
    depth : float, mm
        Points closer to the lens's outermost plane are near.
    height : (m,) float64, mm
        Heights over the axis, from 0, evenly spaced.
    distance : (n,) float64, mm
        Distances from the plane, near to far, evenly spaced; the first may be 0.
    """

    depth: float
    height: Array
    distance: Array

    @property
    def measured(self) -> Array:
        """Distances of the measurements, none of them 0, (n,) mm."""
        return np.maximum(self.distance, NEAREST * self.depth)

    @property
    def extends_beyond(self) -> bool:
        """True if shapes reach from near points to points farther away."""
        return bool(self.distance[-1] >= self.depth)


def near_viewpoints(
    plane_z: float, depth: float, shapes: Iterable[tuple[Array, NDArray[np.intp]]]
) -> NearViewpoints | None:
    """Return the grid of viewpoints for the near parts of shapes; None without any.

    Parameters
    ----------
    plane_z, depth : float, mm
        The lens's outermost plane, and the depth of the near range before it.
    shapes : of (points (n, 3) float64, mm, camera frame; edges (m, 2) int)
        Vertices of surfaces or convex bodies, and pairs of joined ones.
    """
    distance, height = [np.zeros(0)], [np.zeros(0)]
    for points, edges in shapes:
        before = plane_z - points[:, 2]
        inside = (before > 0.0) & (before < depth)
        distance.append(before[inside])
        height.append(np.hypot(points[inside, 0], points[inside, 1]))
        one, other = edges.T
        for border in (0.0, depth):
            # Intersections of edges with the borders of the near range.
            across = (before[one] > border) != (before[other] > border)
            a, b = one[across], other[across]
            t = (before[a] - border) / (before[a] - before[b])
            crossing = points[a] + t[:, None] * (points[b] - points[a])
            distance.append(np.full(len(t), border))
            height.append(np.hypot(crossing[:, 0], crossing[:, 1]))
    distances, heights = np.concatenate(distance), np.concatenate(height)
    if not (distances < depth).any():
        return None
    low, high = float(distances.min()), float(distances.max())
    many = DISTANCES if high - low > 1e-9 * depth else 1
    # If all points lie on the axis, the table still needs a width.
    return NearViewpoints(depth, np.linspace(0.0, float(heights.max()) or depth, HEIGHTS), np.linspace(low, high, many))


def near_disks(seen: NearViewpoints, middle: Array, radius: Array) -> Disks:
    """Return measured disks as a table.

    Parameters
    ----------
    seen : NearViewpoints
    middle, radius : (n, m) float64, mm
        Centre along the meridian and radius of the disk from each viewpoint at `NearViewpoints.measured`; radius −1:
        closed.
    """
    distance, measured = seen.distance, seen.measured
    middle, radius = middle.copy(), radius.copy()
    vanishes = False
    if distance[0] < measured[0] and len(distance) > 1:
        vanishes = _continue_to_plane(middle[0], radius[0], seen.height, measured[0])
    return covering(float(seen.height[1]), distance, middle, radius, measured, vanishes=vanishes)


def _continue_to_plane(middle: Array, radius: Array, height: Array, measured: float) -> bool:
    """Move disks (m,) measured near the plane into it; tell whether they vanish.

    A disk not larger than a few times the distance shrinks to the point itself. Larger disks are openings for light at
    any angle.
    """
    is_open = radius >= 0.0
    vanishes = bool((radius[is_open] * VANISHING < measured).all())
    if vanishes:
        middle[is_open], radius[is_open] = height[is_open], 0.0
    return vanishes
