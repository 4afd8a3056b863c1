"""Tree of the pieces of emitting facets, used by points to choose the piece that they ask (`lights/many_emitters.py`).

A node bounds the places and normals of the pieces below it, and holds their power. Like the tree of lamps, it is split
where the sum over both parts of power times squared extent is least; the extent combines places and normals (Walter et
al., Lightcuts, SIGGRAPH 2005). The pieces of a leaf are drawn by power alone: for two million facets a leaf holds some
thousands of pieces, so the tree stays in the cache.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel

FEW = 8
"""Largest number of facets with pieces drawn by power alone, as for a sheet with a picture, or a ball."""

LEAVES = 1 << 10
"""A node with more than this fraction (1 / `LEAVES`) of all pieces, in number or in power, is split."""

EMITTER_NODE = np.dtype(
    [
        ("middle", "f8", (3,)),  # mm, centre of a sphere that holds the pieces
        ("radius", "f8"),  # mm
        ("axis", "f8", (3,)),  # unit, middle of the normals
        ("cos_spread", "f8"),  # cosine of the largest angle between the axis and a normal
        ("sin_spread", "f8"),
        ("power", "f8"),  # share of the power of all pieces
        ("begin", "i8"),  # first piece, and the piece after the last
        ("end", "i8"),
        ("right", "i8"),  # second part; the first is the next node; 0: a leaf
        ("both", "?"),  # some pieces shine on both sides: the axis and normals are lines
    ]
)

MARGIN = 2.0**-20
"""Margin of bounds beyond the pieces, over their size, and in rad; exceeds rounding."""

NORMAL_WEIGHT = 0.125
"""Distance, over the extent of a node, that separates two pieces as much as one radian between their normals."""

BINS = 16
"""Number of equal bins along each axis; nodes are split between bins."""

DEEPEST = 48
"""Depth of the tree below which nodes are split into two halves."""


@by_address
class Bounds(NamedTuple):
    """Bounds of the pieces of emitting facets."""

    low: Array  # (n, 3) mm
    high: Array
    normal: Array  # (n, 3) unit, middle of the normals; 0 if they point all round
    spread: Array  # (n,) rad, largest angle between the middle and a normal
    both: NDArray[np.bool_]  # (n,) shines on both sides
    power: Array  # (n,)

    def some(self, which: NDArray[np.int64]) -> "Bounds":
        """Return the bounds of some pieces."""
        return Bounds(
            self.low[which], self.high[which], self.normal[which], self.spread[which], self.both[which],
            self.power[which],
        )  # fmt: skip


class Work(NamedTuple):
    """Working memory while a tree grows."""

    bins: Array  # (BINS, 14) lowest and highest coordinates of the pieces of each bin, their power and number
    waiting: NDArray[np.int64]  # (n, 4) nodes to come: first and last piece, parent of a second part, depth


def emitter_tree(bounds: Bounds) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Return the order of pieces in the leaves of their tree, (n,), and the nodes, (nodes,) EMITTER_NODE.

    The root comes first; each node is followed by all nodes below it.

    Parameters
    ----------
    bounds : Bounds
        Of one piece or more.
    """
    count, found = len(bounds.power), 0
    middles = np.hstack([0.5 * (bounds.low + bounds.high), bounds.normal])
    most = min(2 * count, 4 * LEAVES)
    while found == 0:
        order, nodes = np.arange(count), np.zeros(most, EMITTER_NODE)
        work = Work(np.zeros((BINS, 14)), np.zeros((DEEPEST + 64, 4), np.int64))
        found = _grow(bounds, middles, order, nodes, max(1, count // LEAVES), work)
        most *= 2
    nodes = nodes[:found].copy()
    leaves = nodes[nodes["right"] == 0]
    # Neighbours in number are neighbours in place as far as in the mesh.
    return order[np.lexsort([order, np.repeat(np.arange(len(leaves)), leaves["end"] - leaves["begin"])])], nodes


@kernel
def _grow(
    bounds: Bounds, middles: Array, order: NDArray[np.int64], nodes: NDArray[np.void], largest: int, work: Work
) -> int:  # fmt: skip
    """Fill in the nodes of a tree; return their number, 0 if too few.

    Parameters
    ----------
    bounds : Bounds
    middles : (n, 6) float64
        Places and normals of the pieces.
    order : (n,) int64
        Written.
    nodes : (nodes,) EMITTER_NODE
        Written.
    largest : int
        Largest number of pieces of a leaf.
    work : Work
    """
    waiting, top, count, brightest = work.waiting, 1, 0, 0.0
    waiting[0, 1], waiting[0, 2], waiting[0, 3] = len(order), -1, 0
    while top > 0:
        top -= 1
        begin, end, parent, depth = waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3]
        if count == len(nodes):
            return 0
        node, some = nodes[count], order[begin:end]
        if parent >= 0:
            nodes[parent].right = count
        node.begin, node.end, node.right = begin, end, 0
        _bound(bounds, some, node)
        if count == 0:
            brightest = node.power / LEAVES
        if end - begin > largest or (end - begin > 1 and node.power > brightest):
            parted = (
                _parted(bounds.power, middles, some, NORMAL_WEIGHT * node.radius, work.bins) if depth < DEEPEST else 0
            )
            middle = begin + (parted if parted > 0 else (end - begin) // 2)
            waiting[top, 0], waiting[top, 1], waiting[top, 2], waiting[top, 3] = middle, end, count, depth + 1
            waiting[top + 1, 0], waiting[top + 1, 1], waiting[top + 1, 2] = begin, middle, -1
            waiting[top + 1, 3] = depth + 1
            top += 2
        count += 1
    return count


@kernel
def _bound(bounds: Bounds, some: NDArray[np.int64], node: Any) -> None:
    """Fill in the bounds and the power of some pieces."""
    node.both, node.power, half2, known = False, 0.0, 0.0, True
    for piece in some:
        node.both = node.both or bounds.both[piece]
        node.power += bounds.power[piece]
    for axis in range(3):
        low, high = np.inf, -np.inf
        for piece in some:
            low, high = min(low, bounds.low[piece, axis]), max(high, bounds.high[piece, axis])
        node.middle[axis], half2 = 0.5 * (low + high), half2 + 0.25 * (high - low) ** 2
    node.radius = np.sqrt(half2) * (1.0 + MARGIN)
    first, x, y, z = bounds.normal[some[0]], 0.0, 0.0, 0.0
    for piece in some:
        n = bounds.normal[piece]
        sign = -1.0 if node.both and n[0] * first[0] + n[1] * first[1] + n[2] * first[2] < 0.0 else 1.0
        x, y, z = x + sign * n[0], y + sign * n[1], z + sign * n[2]
        known = known and (n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0)
    length, widest = np.sqrt(x * x + y * y + z * z), np.pi
    if known and length > MARGIN * len(some):
        x, y, z, widest = x / length, y / length, z / length, 0.0
        for piece in some:
            n = bounds.normal[piece]
            sign = -1.0 if node.both and n[0] * x + n[1] * y + n[2] * z < 0.0 else 1.0
            # From the chord between unit vectors, which has the digits of small angles.
            chord = np.sqrt((sign * n[0] - x) ** 2 + (sign * n[1] - y) ** 2 + (sign * n[2] - z) ** 2)
            widest = max(widest, 2.0 * np.arcsin(min(0.5 * chord, 1.0)) + bounds.spread[piece])
    else:
        x, y, z = 0.0, 0.0, 1.0
    node.axis[0], node.axis[1], node.axis[2] = x, y, z
    widest = min(widest + MARGIN, 0.5 * np.pi if node.both else np.pi)
    node.cos_spread, node.sin_spread = np.cos(widest), np.sin(widest)


@kernel
def _parted(power: Array, middles: Array, some: NDArray[np.int64], weight: float, bins: Array) -> int:
    """Sort two or more pieces into two parts; return the size of the first, 0 if nothing separates them.

    Parameters
    ----------
    weight : float, mm
        Extent that counts as much as an extent of 1 in normals.
    bins : (BINS, 14) float64
        Working memory, see `Work`.
    """
    best, where, edge, start, scale = np.inf, -1, 0, 0.0, 0.0
    for column in range(middles.shape[1]):
        low, high = np.inf, -np.inf
        for piece in some:
            low, high = min(low, middles[piece, column]), max(high, middles[piece, column])
        if not high - low > MARGIN * max(abs(low), abs(high)):
            continue
        per_unit = BINS / (high - low)
        bins[:, :6], bins[:, 6:12], bins[:, 12:] = np.inf, -np.inf, 0.0
        for piece in some:
            row, at = bins[_bin_of(middles[piece, column], low, per_unit)], middles[piece]
            for axis in range(6):
                row[axis], row[6 + axis] = min(row[axis], at[axis]), max(row[6 + axis], at[axis])
            row[12], row[13] = row[12] + power[piece], row[13] + 1.0
        for after in range(1, BINS):
            cost = _cost(bins[:after], weight) + _cost(bins[after:], weight)
            if cost < best:
                best, where, edge, start, scale = cost, column, after, low, per_unit
    first = 0
    if where >= 0:
        for k in range(len(some)):
            piece = some[k]
            if _bin_of(middles[piece, where], start, scale) < edge:
                some[k], some[first] = some[first], piece
                first += 1
    return first if first < len(some) else 0


@inlined
def _bin_of(value: float, low: float, scale: float) -> int:
    """Return the bin of a value."""
    return min(int(scale * (value - low)), BINS - 1)


@kernel
def _cost(bins: Array, weight: float) -> float:
    """Return the cost of a part: power times squared extent of the pieces in some bins; inf if empty."""
    power, count, extent2 = 0.0, 0.0, 0.0
    for row in bins:
        power, count = power + row[12], count + row[13]
    if count == 0.0:
        return np.inf
    for axis in range(6):
        low, high = np.inf, -np.inf
        for row in bins:
            low, high = min(low, row[axis]), max(high, row[6 + axis])
        extent2 += (high - low) ** 2 * (1.0 if axis < 3 else weight * weight)
    return power * extent2
