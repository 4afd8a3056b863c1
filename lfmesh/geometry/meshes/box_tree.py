"""Full binary trees of boxes: node n has the children 2 n and 2 n + 1; the root is node 1."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array
from lfmesh.kernels.decorators import inlined


class BoxTree(NamedTuple):
    """Boxes of a tree, and the contents of its leaves."""

    low: Array  # (2 · leaves, 3) mm
    high: Array
    order: NDArray[np.int64]  # (leaves · size,) numbers of the items, leaf by leaf; some twice, to fill the leaves
    leaves: int  # a power of two
    size: int  # items per leaf


def box_tree(low: Array, high: Array, middles: Array, largest_leaf: int, margin: float) -> BoxTree:
    """Return a tree of items with boxes; there must be at least one item.

    Parameters
    ----------
    low, high : (n, 3) float64, mm
        Corners of the boxes.
    middles : (n, 3) float64, mm
        Points that group neighbours into leaves.
    largest_leaf : int
        Most items per leaf.
    margin : float
        Enlargement of the tree's boxes, over the size of the largest leaf.
    """
    leaves = 1 << max(0, int(np.ceil(np.log2(len(low) / largest_leaf))))
    size = -(-len(low) // leaves)
    order = _in_leaves(middles, leaves, size)
    lows, highs = np.zeros((2 * leaves, 3)), np.zeros((2 * leaves, 3))
    lows[leaves:] = low[order].reshape(leaves, size, 3).min(axis=1)
    highs[leaves:] = high[order].reshape(leaves, size, 3).max(axis=1)
    wider = margin * float((highs[leaves:] - lows[leaves:]).max())
    lows[leaves:] -= wider
    highs[leaves:] += wider
    for first in (leaves >> level for level in range(1, leaves.bit_length())):
        lows[first : 2 * first] = lows[2 * first : 4 * first].reshape(first, 2, 3).min(axis=1)
        highs[first : 2 * first] = highs[2 * first : 4 * first].reshape(first, 2, 3).max(axis=1)
    return BoxTree(lows, highs, order, leaves, size)


@inlined
def next_node(node: int) -> int:
    """Return the next node of the depth-first order that is not below a node; 0 if there is none."""
    while node & 1:
        node >>= 1
    return node + 1 if node > 0 else 0


def _in_leaves(middles: Array, leaves: int, size: int) -> NDArray[np.int64]:
    """Return the order that groups neighbours into leaves: each node is split in half along its widest axis."""
    order = np.resize(np.arange(len(middles)), leaves * size)
    nodes = 1
    while nodes < leaves:
        part = order.reshape(nodes, -1)
        at = middles[part]
        widest = np.ptp(at, axis=1).argmax(axis=1)
        along = np.take_along_axis(at, widest[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(part, np.argsort(along, axis=1, kind="stable"), axis=1).ravel()
        nodes *= 2
    return order
