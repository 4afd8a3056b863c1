"""Closed meshes that bound media: entry and exit points of lines, through a tree of boxes.

Crossings are counted with their sense, so shells may enclose hollows, overlap and consist of several parts. A point is
inside if more of the crossings beyond it leave than enter. Facets are tested as in S. Woop, C. Benthin and I. Wald,
"Watertight ray/triangle intersection", JCGT 2 (2013) 65-82: corners are sheared along the line, so that all facets
around a corner see it at the same place. A line that meets an edge to the last digit counts as moved aside by an
infinitesimal length (H. Edelsbrunner and E. Mücke, "Simulation of simplicity", ACM Transactions on Graphics 9 (1990)
66-104). No line therefore slips through an edge or a corner, or meets it twice.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.boxes import meets_box, slopes_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel

LEAF = 4
"""Most facets per leaf."""

MARGIN = 1e-9
"""Enlargement of each box over the size of the shell: more than the rounding of lines."""

NODE = np.dtype(
    [
        ("low", "f8", (3,)),  # mm
        ("high", "f8", (3,)),
        ("next", "i8"),  # node to continue with if a line misses the box; the nodes between are inside it
        ("first", "i8"),  # first facet of a leaf
        ("count", "i8"),  # number of facets of a leaf, else 0
    ]
)


@by_address
class ShellTree(NamedTuple):
    """Shells, each a run of nodes in depth-first order; the first node holds the whole shell."""

    nodes: NDArray[np.void]  # (n,) NODE
    corners: Array  # (facets, 3, 3) mm, in the order of the leaves; outward-facing


def tree_of(shells: Sequence[Array]) -> tuple[ShellTree, list[tuple[int, int]]]:
    """Return the trees of shells, and for each shell its first node and the one past its last.

    Parameters
    ----------
    shells : sequence of (m, 3, 3) float64
        Corners of the facets of each, mm.
    """
    rows: list[tuple[Array, Array, int, int, int]] = []
    facets: list[Array] = []
    ends = []
    for corners in shells:
        begin = len(rows)
        size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        filled = sum(map(len, facets))
        for low, high, below, order in _nodes(corners, np.arange(len(corners))):
            count = len(order) if below == 1 else 0
            rows.append((low - MARGIN * size, high + MARGIN * size, len(rows) + below, filled, count))
            if count:
                facets.append(corners[order])
                filled += count
        ends.append((begin, len(rows)))
    nodes = np.zeros(len(rows), NODE)
    for key, values in zip(("low", "high", "next", "first", "count"), zip(*rows, strict=True), strict=True):
        nodes[key] = values
    return ShellTree(nodes, np.concatenate(facets)), ends


def _nodes(corners: Array, order: NDArray[np.int64]) -> Iterator[tuple[Array, Array, int, NDArray[np.int64]]]:
    """Yield the box, the number of nodes in the subtree, and the facets of each node, parents first."""
    own = corners[order]
    low, high = own.min(axis=(0, 1)), own.max(axis=(0, 1))
    if len(order) <= LEAF:
        yield low, high, 1, order
        return
    middles = own.mean(axis=1)
    ranks = np.argsort(middles[:, int(np.ptp(middles, axis=0).argmax())], kind="stable")
    half = len(order) // 2
    below = [node for part in (ranks[:half], ranks[half:]) for node in _nodes(corners, order[part])]
    yield low, high, 1 + len(below), order
    yield from below


@inlined
def _passes_left(ax: float, ay: float, bx: float, by: float) -> tuple[float, bool]:
    """Return the cross product of two points in a plane, and whether the origin, moved aside, is left of their line."""
    cross = ax * by - ay * bx
    if cross != 0.0:
        return cross, cross > 0.0
    return cross, ay > by if ay != by else bx > ax


@kernel
def next_crossing(tree: ShellTree, begin: int, end: int, t: float, ray: Ray) -> tuple[bool, float]:
    """Return whether the point of a line at t is in a shell, and the distance to the line's next crossing of the shell.

    Parameters
    ----------
    tree : ShellTree
    begin, end : int
        First node of the shell, and the one past its last.
    t : float, mm
    ray : Ray

    Returns
    -------
    inside : bool
    ahead : float, mm
        Beyond t; inf if there is none.
    """
    x, y, z, dx, dy, dz = ray
    whole = tree.nodes[begin]
    # Start from a point near the shell, so that distant starts lose no digits.
    mx, my, mz = (
        0.5 * (whole.low[0] + whole.high[0]) - x,
        0.5 * (whole.low[1] + whole.high[1]) - y,
        0.5 * (whole.low[2] + whole.high[2]) - z,
    )
    shift = mx * dx + my * dy + mz * dz
    x, y, z = x + shift * dx, y + shift * dy, z + shift * dz
    from_near = Ray(x, y, z, dx, dy, dz)
    slopes = slopes_of(from_near)
    # The axis along which the line is steepest becomes the third.
    k = 2
    if abs(dx) >= abs(dy) and abs(dx) >= abs(dz):
        k = 0
    elif abs(dy) >= abs(dz):
        k = 1
    i, j = (k + 1) % 3, (k + 2) % 3
    o, d = (x, y, z), (dx, dy, dz)
    oi, oj, ok = o[i], o[j], o[k]
    si, sj, sk = d[i] / d[k], d[j] / d[k], 1.0 / d[k]
    sense = 1 if d[k] > 0.0 else -1
    beyond, ahead, node = 0, np.inf, begin
    while node < end:
        box = tree.nodes[node]
        if not meets_box(box.low, box.high, from_near, slopes, -np.inf, np.inf):
            node = box.next
            continue
        for facet in range(box.first, box.first + box.count):
            corner = tree.corners[facet]
            az, bz, cz = corner[0, k] - ok, corner[1, k] - ok, corner[2, k] - ok
            ax, ay = corner[0, i] - oi - si * az, corner[0, j] - oj - sj * az
            bx, by = corner[1, i] - oi - si * bz, corner[1, j] - oj - sj * bz
            cx, cy = corner[2, i] - oi - si * cz, corner[2, j] - oj - sj * cz
            u, left = _passes_left(bx, by, cx, cy)
            v, left_too = _passes_left(cx, cy, ax, ay)
            w, all_left = _passes_left(ax, ay, bx, by)
            if left != left_too or left != all_left:
                continue
            whole_area = u + v + w
            height = (u * az + v * bz + w * cz) / whole_area if whole_area != 0.0 else (az + bz + cz) / 3.0
            at = shift + height * sk
            if at > t:
                # If the line passes left of all edges, the outside of the facet faces along the third axis.
                beyond += sense if left else -sense
                ahead = min(ahead, at)
        node += 1
    return beyond > 0, ahead
