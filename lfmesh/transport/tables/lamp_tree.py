"""Tree of the lamps of a scene, used by points to choose the lamps that they ask (see `lights/many_lamps.py`).

A node bounds the places, directions and power of the lamps below it, as in pbrt's `BVHLightSampler` (Pharr, Jakob &
Humphreys, Physically Based Rendering, 4th edition, 12.6.3). It is split where the sum over both parts of power · solid
angle of the light · squared extent is least (Conty Estevez & Kulla, Importance sampling of many lights with adaptive
tree splitting, HPG 2018). Splits by place and by direction are tried, so lamps in one place are split by direction.
Parallel light has its own tree, after the tree of the lamps. Lamps of each mover have trees of their own, whose bounds
hold in the frame of the mover.

A few lamps are all asked from each point, and the tree is a plain list.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel

Array = NDArray[np.float64]

MOST_ASKED = 8
"""Largest number of lamps that a point asks; it asks all if there are no more."""

LAMP_NODE = np.dtype(
    [
        ("middle", "f8", (3,)),  # mm, centre of a sphere that holds the lamps
        ("radius", "f8"),  # mm
        ("axis", "f8", (3,)),  # unit, middle of the lamps' axes
        ("cos_spread", "f8"),  # cosine of the largest angle between the middle and an axis
        ("sin_spread", "f8"),
        ("cos_reach", "f8"),  # cosine of the largest angle between a lamp's axis and its light
        ("outer", "f8"),  # 1 − cos of the sum of both angles; 2: light goes all round
        ("per_sr", "f8"),  # 1/sr, mean intensity within that angle over the power; for fading lamps, along the axis
        ("fades", "?"),  # the intensity of all lamps falls as the cosine of the angle from their axes
        ("placed", "?"),  # lamps; else parallel light
        ("mover", "i8"),  # mover of all lamps; see `tables.motions`
        ("lamp", "i8"),  # number of the only lamp; −1: several, in two parts
        ("skip", "i8"),  # node after all nodes below; the first part is the next node, and its `skip` is the second
    ]
)

MARGIN = 2.0**-20
"""Margin of bounds beyond the lamps, over their extent, and in rad; exceeds rounding."""

GRAIN = 2.0**-40
"""The same margin over the distance from the origin."""

BINS = 16
"""Number of equal bins along each axis; nodes are split between bins."""

X, Y, Z, SIZE, AXIS_X, AXIS_Y, AXIS_Z, REACH, POWER, FADES, PLACED = range(11)
"""Columns of the facts of lamps; nodes may be split by the columns of places and axes."""

LOW, HIGH, AXES, WIDEST, WHOLE, COUNT = 0, 3, 6, 9, 10, 11
"""Columns of the facts of bins: corners of the box, sum of the axes, widest reach, power, number of lamps."""


def lamp_tree(rows: NDArray[np.void], powers: Array) -> tuple[NDArray[np.void], Array, NDArray[np.int64]]:
    """Return the tree of some lamps.

    Parameters
    ----------
    rows : (lamps,) LIGHT
    powers : (lamps, wavelengths) float64, W
        For parallel light W/m².

    Returns
    -------
    nodes : (nodes,) LAMP_NODE
        Each followed by all nodes below it.
    power : (nodes, wavelengths) float64
        Power of all lamps of each node.
    leaf : (lamps,) int64
        Node of each lamp.
    """
    facts = np.zeros((len(rows), PLACED + 1))
    facts[:, X : Z + 1], facts[:, SIZE] = rows["position"], rows["size"]
    facts[:, AXIS_X : AXIS_Z + 1] = rows["direction"]
    facts[:, REACH] = 2.0 * np.arcsin(np.sqrt(0.5 * rows["outer"]))
    facts[:, POWER] = powers.mean(axis=1)
    facts[:, FADES], facts[:, PLACED] = rows["fades"], rows["placed"]
    facts[~rows["placed"], REACH] = 0.0
    if len(rows) <= MOST_ASKED:
        roots = [np.array([number]) for number in range(len(rows))]
    else:
        movers, placed = rows["mover"], rows["placed"]
        of_movers = [(movers == mover) & kind for mover in np.unique(movers) for kind in (placed, ~placed)]
        roots = [some for some in map(np.flatnonzero, of_movers) if len(some)]
    nodes = np.zeros(sum(2 * len(some) - 1 for some in roots), LAMP_NODE)
    power, leaf, first = np.zeros((len(nodes), powers.shape[1])), np.zeros(len(rows), np.int64), 0
    for some in roots:
        _grow(facts, some, first, nodes, np.zeros((len(some) + 1, 3), np.int64), np.zeros((BINS, COUNT + 1)))
        nodes["mover"][first : first + 2 * len(some) - 1] = rows["mover"][some[0]]
        first += 2 * len(some) - 1
    _add_up(nodes, powers, power, leaf)
    return nodes, power, leaf


@kernel
def _grow(
    facts: Array, order: NDArray[np.int64], first: int, nodes: NDArray[np.void], waiting: NDArray[np.int64],
    bins: Array,
) -> None:  # fmt: skip
    """Fill in the nodes of a tree.

    Parameters
    ----------
    facts : (lamps, facts) float64
    order : (n,) int64
        Lamps of the tree; written in the order of its leaves.
    first : int
        Number of its root.
    nodes : (nodes,) LAMP_NODE
        Written.
    waiting : (n + 1, 3) int64
        Working memory: nodes, and begin and end of their lamps.
    bins : (BINS, facts of bins) float64
        Working memory.
    """
    waiting[0, 0], waiting[0, 1], waiting[0, 2] = first, 0, len(order)
    top = 1
    while top > 0:
        top -= 1
        number, begin, end = waiting[top, 0], waiting[top, 1], waiting[top, 2]
        node = nodes[number]
        _bound(facts, order[begin:end], node)
        node.skip, node.lamp = number + 2 * (end - begin) - 1, -1
        if end - begin == 1:
            node.lamp = order[begin]
            continue
        floor = MARGIN * node.radius**2 if node.radius > 0.0 else 1.0
        middle = begin + _parted(facts, order[begin:end], floor, bins)
        waiting[top, 0], waiting[top, 1], waiting[top, 2] = number + 2 * (middle - begin), middle, end
        waiting[top + 1, 0], waiting[top + 1, 1], waiting[top + 1, 2] = number + 1, begin, middle
        top += 2


@kernel
def _bound(facts: Array, some: NDArray[np.int64], node: Any) -> None:
    """Fill in the bounds of some lamps."""
    reach, axis_x, axis_y, axis_z, fades = 0.0, 0.0, 0.0, 0.0, True
    for lamp in some:
        axis_x += facts[lamp, AXIS_X]
        axis_y += facts[lamp, AXIS_Y]
        axis_z += facts[lamp, AXIS_Z]
        reach = max(reach, facts[lamp, REACH])
        fades = fades and facts[lamp, FADES] > 0.0
    node.fades, node.placed = fades, facts[some[0], PLACED] > 0.0
    for axis in range(3):
        low, high = np.inf, -np.inf
        for lamp in some:
            low = min(low, facts[lamp, X + axis] - facts[lamp, SIZE])
            high = max(high, facts[lamp, X + axis] + facts[lamp, SIZE])
        node.middle[axis] = 0.5 * (low + high) if len(some) > 1 else facts[some[0], X + axis]
    length = np.sqrt(axis_x * axis_x + axis_y * axis_y + axis_z * axis_z)
    spread = 0.0
    if length > MARGIN * len(some):
        axis_x, axis_y, axis_z = axis_x / length, axis_y / length, axis_z / length
    else:
        axis_x, axis_y, axis_z, spread = 0.0, 0.0, 1.0, np.pi
    node.axis[0], node.axis[1], node.axis[2] = axis_x, axis_y, axis_z
    radius = 0.0
    for lamp in some:
        px, py, pz = (
            facts[lamp, X] - node.middle[0],
            facts[lamp, Y] - node.middle[1],
            facts[lamp, Z] - node.middle[2],
        )
        radius = max(radius, np.sqrt(px * px + py * py + pz * pz) + facts[lamp, SIZE])
        ex, ey, ez = facts[lamp, AXIS_X] - axis_x, facts[lamp, AXIS_Y] - axis_y, facts[lamp, AXIS_Z] - axis_z
        spread = max(spread, 2.0 * np.arcsin(min(0.5 * np.sqrt(ex * ex + ey * ey + ez * ez), 1.0)))
    if len(some) > 1:
        radius = radius * (1.0 + MARGIN)
        radius += GRAIN * (abs(node.middle[0]) + abs(node.middle[1]) + abs(node.middle[2]))
    node.radius = radius
    spread, reach = min(spread + MARGIN, np.pi), min(reach + MARGIN, np.pi)
    node.cos_spread, node.sin_spread, node.cos_reach = np.cos(spread), np.sin(spread), np.cos(reach)
    node.outer = _height(min(spread + reach, np.pi))
    node.per_sr = (2.0 if fades else 1.0) / (2.0 * np.pi * node.outer) if node.placed else 1.0


@inlined
def _height(angle: float) -> float:
    """Return 1 − cos of an angle, rad, without cancellation."""
    return 2.0 * np.sin(0.5 * angle) ** 2


@kernel
def _parted(facts: Array, some: NDArray[np.int64], floor: float, bins: Array) -> int:
    """Sort two or more lamps into two parts; return the size of the first.

    Parameters
    ----------
    floor : float, mm²
        Least squared extent, so that lamps in one place are split by their directions.
    """
    best, where, edge = np.inf, -1, 0
    for column in range(X, AXIS_Z + 1):
        if column == SIZE:
            continue
        low, scale = _scale(facts, some, column)
        if scale == 0.0:
            continue
        _fill_bins(facts, some, column, low, scale, bins)
        for after in range(1, BINS):
            cost = _cost(bins[:after], floor) + _cost(bins[after:], floor)
            if cost < best:
                best, where, edge = cost, column, after
    if where < 0:
        return len(some) // 2
    low, scale = _scale(facts, some, where)
    first = 0
    for k in range(len(some)):
        lamp = some[k]
        if _bin_of(facts[lamp, where], low, scale) < edge:
            some[k], some[first] = some[first], lamp
            first += 1
    return first


@inlined
def _scale(facts: Array, some: NDArray[np.int64], column: int) -> tuple[float, float]:
    """Return the least value of a column, and the bins per unit; 0: all values are equal."""
    low, high = np.inf, -np.inf
    for lamp in some:
        low, high = min(low, facts[lamp, column]), max(high, facts[lamp, column])
    return low, BINS / (high - low) if high - low > GRAIN * max(abs(low), abs(high)) else 0.0


@inlined
def _bin_of(value: float, low: float, scale: float) -> int:
    """Return the bin of a value."""
    return min(int(scale * (value - low)), BINS - 1)


@kernel
def _fill_bins(facts: Array, some: NDArray[np.int64], column: int, low: float, scale: float, bins: Array) -> None:
    """Fill in the facts of the lamps in each bin."""
    bins[:] = 0.0
    bins[:, LOW : LOW + 3], bins[:, HIGH : HIGH + 3] = np.inf, -np.inf
    for lamp in some:
        row = bins[_bin_of(facts[lamp, column], low, scale)]
        for axis in range(3):
            row[LOW + axis] = min(row[LOW + axis], facts[lamp, X + axis] - facts[lamp, SIZE])
            row[HIGH + axis] = max(row[HIGH + axis], facts[lamp, X + axis] + facts[lamp, SIZE])
            row[AXES + axis] += facts[lamp, AXIS_X + axis]
        row[WIDEST] = max(row[WIDEST], facts[lamp, REACH])
        row[WHOLE] += facts[lamp, POWER]
        row[COUNT] += 1.0


@kernel
def _cost(bins: Array, floor: float) -> float:
    """Return the cost of a part: power · solid angle · squared extent of the lamps in some bins; inf if empty.

    Axes that fill a cone evenly up to an angle θ have a mean of length (1 + cos θ) / 2.
    """
    power, count, reach, extent2, axes2 = 0.0, 0.0, 0.0, 0.0, 0.0
    for axis in range(3):
        low, high, along = np.inf, -np.inf, 0.0
        for row in bins:
            low, high, along = min(low, row[LOW + axis]), max(high, row[HIGH + axis]), along + row[AXES + axis]
        extent2 += (high - low) ** 2
        axes2 += along * along
    for row in bins:
        power, count, reach = power + row[WHOLE], count + row[COUNT], max(reach, row[WIDEST])
    if count == 0.0:
        return np.inf
    spread = np.arccos(min(max(2.0 * np.sqrt(axes2) / count - 1.0, -1.0), 1.0))
    return power * (MARGIN + _height(min(spread + reach, np.pi))) * (floor + extent2)


@kernel
def _add_up(nodes: NDArray[np.void], powers: Array, power: Array, leaf: NDArray[np.int64]) -> None:
    """Fill in the power of each node, and the node of each lamp."""
    for number in range(len(nodes) - 1, -1, -1):
        lamp, right = nodes[number].lamp, 0
        if lamp >= 0:
            leaf[lamp] = number
        else:
            right = nodes[number + 1].skip
        for colour in range(power.shape[1]):
            if lamp >= 0:
                power[number, colour] = powers[lamp, colour]
            else:
                power[number, colour] = power[number + 1, colour] + power[right, colour]
