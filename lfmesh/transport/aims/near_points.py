"""The lens's opening as seen from points close before it, in a table by their height and distance.

By field angle and inverse distance, as `pupil` has other points, a table that reaches up to the lens is stretched over
tangents up to infinity. Close to the lens the disks change evenly with height and distance instead: where the lens lets
light through at limited angles alone, the disk shrinks to the point itself, in proportion to its distance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.transport.aims.disks import covering
from lfmesh.transport.tables.tables import Disks

Array = NDArray[np.float64]

HEIGHTS = 33
"""Heights at which the opening is measured, evenly spaced."""

DISTANCES = 9
"""Distances at which it is measured if the points do not all lie in one plane, evenly spaced."""

NEAREST = 1e-4
"""Distance in place of 0 at which the opening is measured, relative to that up to which points are near."""

VANISHING = 0.1
"""Share of the radius measured there below which it is taken to vanish in the plane itself."""


class NearViewpoints(NamedTuple):
    """Points close before the lens from which it is seen.

    Attributes
    ----------
    depth : float, mm
        Points nearer to the lens's outermost plane are near.
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
        """Distances at which the opening is measured, none of them 0, (n,) mm."""
        return np.maximum(self.distance, NEAREST * self.depth)

    @property
    def extends_beyond(self) -> bool:
        """True if surfaces or bodies reach from near points to points farther away."""
        return bool(self.distance[-1] >= self.depth)


def near_viewpoints(
    plane_z: float, depth: float, shapes: Iterable[tuple[Array, NDArray[np.intp]]]
) -> NearViewpoints | None:
    """Return the grid of viewpoints that covers what of some shapes is close before the lens; None: nothing is.

    Parameters
    ----------
    plane_z, depth : float, mm
        The lens's outermost plane, and the distance before it up to which points are near.
    shapes : of (points (n, 3) float64, mm, camera frame; edges (m, 2) int)
        Vertices of surfaces or convex bodies, and which of them are joined.
    """
    distance, height = [np.zeros(0)], [np.zeros(0)]
    for points, edges in shapes:
        before = plane_z - points[:, 2]
        inside = (before > 0.0) & (before < depth)
        distance.append(before[inside])
        height.append(np.hypot(points[inside, 0], points[inside, 1]))
        one, other = edges.T
        for border in (0.0, depth):
            # Where edges cross the borders of what is near.
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
        no light gets through.
    """
    distance, measured = seen.distance, seen.measured
    middle, radius = middle.copy(), radius.copy()
    vanishes = False
    if distance[0] < measured[0] and len(distance) > 1:
        vanishes = _continue_to_plane(middle[0], radius[0], seen.height, measured[0])
    return covering(float(seen.height[1]), distance, middle, radius, measured, vanishes=vanishes)


def _continue_to_plane(middle: Array, radius: Array, height: Array, measured: float) -> bool:
    """Change disks (m,) measured close before the plane into those in the plane; tell whether they vanish.

    A disk that is no larger than the distance, or few times so, shrinks to the point itself. Larger ones are openings
    that let through light at any angle.
    """
    is_open = radius >= 0.0
    vanishes = bool((radius[is_open] * VANISHING < measured).all())
    if vanishes:
        middle[is_open], radius[is_open] = height[is_open], 0.0
    return vanishes
