"""Tables of the disks in a plane that pass light through the lens, by two coordinates of the viewpoint."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.transport.tables.tables import Disks

Array = NDArray[np.float64]

CONTINUED = 4.0
"""Factor on the interpolation error at nodes with disks extrapolated from their neighbours."""

BEYOND = 1.0 + 2.0**-40
"""Factor on the last column, beyond which the lens counts as closed: keeps rounding from putting the outermost points
there."""


def no_disks() -> Disks:
    """Return a table of a closed lens."""
    return Disks(1.0, 0.0, 1.0, np.zeros((2, 2)), np.full((2, 2), -1.0), np.zeros((2, 2)))


def wide_open(disks: Disks, radius: float) -> Disks:
    """Return a table that shows every point a disk about the axis, mm."""
    return Disks(np.inf, disks.first, 1.0, np.zeros((2, 2)), np.full((2, 2), radius), np.zeros((2, 2)))


def covering(
    column_step: float, along: Array, middle: Array, radius: Array, distance: Array, *, vanishes: bool = False
) -> Disks:
    """Return measured disks as a table that also covers the space between its nodes.

    Parameters
    ----------
    column_step : float
    along : (n,) float64
        Row coordinates.
    middle, radius : (n, m) float64, mm
        Centre along the meridian and radius of the disk at each node; radius −1: closed.
    distance : (n,) float64, mm
        Distances of the rows from the plane.
    vanishes : bool
        The disks of the first row, in the plane itself, are points.
    """
    middle, radius = middle.copy(), radius.copy()
    allowed = _cover(middle, radius, distance)
    if vanishes:
        # Between the first two rows the interpolation error vanishes towards the plane as the disk does. It is at most
        # four times the error in the middle.
        allowed[1] = 4.0 * np.maximum(allowed[0], allowed[1])
        allowed[0] = 0.0
    radius = np.where(radius >= 0.0, radius + allowed, -1.0)
    row_step = float(along[1] - along[0]) if len(along) > 1 else 1.0
    if len(along) == 1:
        middle, radius = np.repeat(middle, 2, axis=0), np.repeat(radius, 2, axis=0)
    middle, radius = np.ascontiguousarray(middle), np.ascontiguousarray(radius)
    return Disks(column_step, float(along[0]), row_step, middle, radius, np.zeros((2, 2)))


def _cover(middle: Array, radius: Array, distance: Array) -> Array:
    """Give disks to closed nodes next to open ones, for partly open intervals; return errors, (n, m) mm.

    Parameters
    ----------
    middle, radius : (n, m) float64, mm
        Disks by evenly spaced rows and columns; radius −1: closed. Changed at closed nodes next to open ones.
    distance : (n,) float64, mm
        Distances of the rows.

    Returns
    -------
    allowed : (n, m) float64, mm
        Error bound of linear interpolation.
    """
    is_open = radius >= 0.0
    bend = sum(_bend(values, is_open, axis) for values in (middle, radius) for axis in (0, 1))
    allowed = np.pad(np.asarray(bend), 1)
    rows, columns = radius.shape
    allowed = np.maximum.reduce([allowed[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])
    _extend(middle, radius, distance)
    return np.where(is_open, allowed, CONTINUED * allowed)


def _bend(values: Array, is_open: NDArray[np.bool_], axis: int) -> Array:
    """Return the linear interpolation error along an axis, (n, m): an eighth of the second difference."""
    found = np.zeros(values.shape)
    if values.shape[axis] > 2:
        values, there, known = np.moveaxis(values, axis, 0), np.moveaxis(found, axis, 0), np.moveaxis(is_open, axis, 0)
        all_open = known[:-2] & known[1:-1] & known[2:]
        there[1:-1] = np.where(all_open, 0.125 * np.abs(np.diff(values, 2, axis=0)), 0.0)
    return found


def _extend(middle: Array, radius: Array, distance: Array) -> None:
    """Give disks to the closed nodes next to open ones.

    Centres are extrapolated linearly along the columns or, without an open neighbour there, along the rows. Radii stay
    constant along columns and grow with the distance along rows.
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


@inlined
def disk_at(disks: Disks, x: float, y: float, across: float, along: float) -> tuple[float, float, float]:
    """Return centre (x, y) and radius of the disk that a point sees; radius −1: none.

    Parameters
    ----------
    disks : Disks
    x, y : float, mm
        Point, camera frame.
    across, along : float
        Its coordinates for columns and rows.
    """
    height = np.sqrt(x * x + y * y)
    middle, radius = disks.middle, disks.radius
    rows, columns = radius.shape[0] - 1, radius.shape[1] - 1
    a, b = across / disks.column_step, (along - disks.first) / disks.row_step
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
    # Along the meridian of the point; for a point on the axis the centre is on the axis too.
    m = m / height if height > 0.0 else 0.0
    shift, down = disks.decentre, row + b
    return m * x + (shift[0, 0] + down * shift[1, 0]), m * y + (shift[0, 1] + down * shift[1, 1]), r
