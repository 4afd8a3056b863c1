"""The lens's opening as seen from points close before it, in a table by their height and distance.

By field angle and inverse distance, as `pupil` has other points, a table that reaches up to the lens is stretched over
tangents up to infinity. Close to the lens the disks change evenly with height and distance instead: where the lens lets
light through at limited angles alone, the disk shrinks to the point itself, in proportion to its distance.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import kernel
from lfmesh.transport.tables.tables import NearOpening

Array = NDArray[np.float64]

HEIGHTS = 33
"""Heights at which the opening is measured, evenly spaced."""

DISTANCES = 9
"""Distances at which it is measured if the points do not all lie in one plane, evenly spaced."""

NEAREST = 1e-4
"""Distance in place of 0 at which the opening is measured, relative to that up to which points are near."""

VANISHING = 0.1
"""Share of the radius measured there below which it is taken to vanish in the plane itself."""

CONTINUED = 4.0
"""Factor on the errors of interpolation at nodes whose disks are continued from their neighbours'."""

BEYOND = 1.0 + 2.0**-40
"""Factor on the greatest height of a table, which the outermost of its points must not exceed by rounding."""


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


def no_near_points(depth: float = 0.0) -> NearOpening:
    """Return the table of a scene without near points; with a depth, of near points that see no opening."""
    closed = np.full((2, 2), -1.0)
    return NearOpening(depth, 1.0, 0.0, 1.0, np.zeros((2, 2)), closed, np.zeros((2, 2)))


def wide_open(near: NearOpening, radius: float) -> NearOpening:
    """Return a table by which every near point sees a disk about the axis, mm."""
    return near._replace(
        height_step=np.inf,
        middle=np.zeros((2, 2)),
        radius=np.full((2, 2), radius),
        distance_step=near.distance_step * (len(near.radius) - 1),
        decentre=np.zeros((2, 2)),
    )


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


def near_opening(seen: NearViewpoints, middle: Array, radius: Array) -> NearOpening:
    """Return measured disks as a table whose disks cover what lies between its nodes.

    Parameters
    ----------
    seen : NearViewpoints
    middle, radius : (n, m) float64, mm
        Centre along the meridian and radius of the disk from each viewpoint at `NearViewpoints.measured`; radius −1:
        no light gets through.
    """
    height, distance, measured = seen.height, seen.distance, seen.measured
    middle, radius = middle.copy(), radius.copy()
    vanishes = False
    if distance[0] < measured[0] and len(distance) > 1:
        vanishes = _continue_to_plane(middle[0], radius[0], height, measured[0])
    allowed = cover(middle, radius, measured)
    if vanishes:
        # Between the first two rows an error of interpolation vanishes towards the plane as the disk does, and is at
        # most four times as large as in the middle.
        allowed[1] = 4.0 * np.maximum(allowed[0], allowed[1])
        allowed[0] = 0.0
    radius = np.where(radius >= 0.0, radius + allowed, -1.0)
    if len(distance) == 1:
        middle, radius = np.repeat(middle, 2, axis=0), np.repeat(radius, 2, axis=0)
    return NearOpening(
        depth=seen.depth,
        height_step=float(height[1]),
        distance=float(distance[0]),
        distance_step=float(distance[1] - distance[0]) if len(distance) > 1 else 1.0,
        middle=np.ascontiguousarray(middle),
        radius=np.ascontiguousarray(radius),
        decentre=np.zeros((2, 2)),
    )


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


def cover(middle: Array, radius: Array, distance: Array) -> Array:
    """Give disks to the closed nodes next to open ones, as intervals may be open in part; return errors, (n, m) mm.

    Parameters
    ----------
    middle, radius : (n, m) float64, mm
        Disks by rows and columns that are evenly spaced; radius −1: closed. Those next to open ones are changed.
    distance : (n,) float64, mm
        Of the rows.

    Returns
    -------
    allowed : (n, m) float64, mm
        By how much disks that are interpolated linearly may be off.
    """
    is_open = radius >= 0.0
    bend = sum(_bend(values, is_open, axis) for values in (middle, radius) for axis in (0, 1))
    allowed = np.pad(np.asarray(bend), 1)
    rows, columns = radius.shape
    allowed = np.maximum.reduce([allowed[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
    _extend(middle, radius, distance)
    return np.where(is_open, allowed, CONTINUED * allowed)


def _bend(values: Array, is_open: NDArray[np.bool_], axis: int) -> Array:
    """Return the error of linear interpolation along an axis, (n, m): an eighth of the second difference."""
    found = np.zeros(values.shape)
    if values.shape[axis] > 2:
        values, there, known = np.moveaxis(values, axis, 0), np.moveaxis(found, axis, 0), np.moveaxis(is_open, axis, 0)
        all_open = known[:-2] & known[1:-1] & known[2:]
        there[1:-1] = np.where(all_open, 0.125 * np.abs(np.diff(values, 2, axis=0)), 0.0)
    return found


def _extend(middle: Array, radius: Array, distance: Array) -> None:
    """Give disks to the closed nodes next to open ones.

    Centres go on evenly along the columns or, where no neighbour there is open, along the rows. Radii stay, or grow
    with the distance.
    """
    for axis in (1, 0):
        m, r = (np.moveaxis(a, axis, 0) for a in (middle, radius))
        was_open = r >= 0.0
        for here in range(len(r)):
            for step in (1, -1):
                near, far = here + step, here + 2 * step
                if not 0 <= near < len(r):
                    continue
                some = (r[here] < 0.0) & was_open[near]
                grown = max(1.0, distance[here] / distance[near]) if axis == 0 else 1.0
                m[here, some], r[here, some] = m[near, some], grown * r[near, some]
                if 0 <= far < len(r):
                    some &= was_open[far]
                    m[here, some] += m[near, some] - m[far, some]


@kernel
def near_disk(near: NearOpening, x: float, y: float, distance: float) -> tuple[float, float, float]:
    """Return centre (x, y) and radius, in the plane of the opening, of the disk seen from a near point; −1: none.

    Parameters
    ----------
    near : NearOpening
    x, y : float, mm
        The point, camera frame.
    distance : float, mm
        Of the point from the plane.
    """
    height = np.sqrt(x * x + y * y)
    middle, radius = near.middle, near.radius
    rows, columns = radius.shape[0] - 1, radius.shape[1] - 1
    a, b = height / near.height_step, (distance - near.distance) / near.distance_step
    if a > columns * BEYOND:
        return 0.0, 0.0, -1.0
    column, row = min(int(a), columns - 1), min(max(int(b), 0), rows - 1)
    a, b = min(a - column, 1.0), min(max(b - row, 0.0), 1.0)
    if min(radius[row, column], radius[row, column + 1], radius[row + 1, column], radius[row + 1, column + 1]) < 0.0:
        return 0.0, 0.0, -1.0
    m = (1.0 - b) * ((1.0 - a) * middle[row, column] + a * middle[row, column + 1])
    m += b * ((1.0 - a) * middle[row + 1, column] + a * middle[row + 1, column + 1])
    r = (1.0 - b) * ((1.0 - a) * radius[row, column] + a * radius[row, column + 1])
    r += b * ((1.0 - a) * radius[row + 1, column] + a * radius[row + 1, column + 1])
    m = m / height if height > 0.0 else 0.0
    shift, down = near.decentre, row + b
    return m * x + (shift[0, 0] + down * shift[1, 0]), m * y + (shift[0, 1] + down * shift[1, 1]), r
