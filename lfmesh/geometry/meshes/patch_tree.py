"""First crossing of a ray with curved patches themselves, in float64, through a tree of boxes.

The facets of a curved surface lie on its hollow side. A ray that grazes the bulging side may pass between a facet and
its patch, and one that starts there may leave the patch without coming to the facet: queries of the facets miss both.
A quadratic patch lies in the hull of its six control points (G. Farin, Curves and Surfaces for CAGD, 2002, chapter 17);
inside that hull it is a height over its facet, which a ray crosses as `first_crossing` finds it.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.boxes import meets_box, part_inside
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.meshes.patch import INSIDE, NEWTON_STEPS, SETTLED, patch_point
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.first_crossing import crossing_finder
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel

LARGEST_LEAF = 4
"""Most patches of a leaf."""

MARGIN = 1e-9
"""By how much boxes and hulls are larger than their patches, over the patches' size: more than rays are rounded by."""

WIDER = (1.0, 1.25, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Sizes that are tried for the triangle of parameters that lies over all between a patch's edges, in the distance of
the patch's sides from those."""

UNBOUNDED = 1.5
"""Factor on the bends of a patch where bounds cannot be had beside it, between its edges, as it folds there."""

DIVISIONS = 4
"""Times that a triangle of parameters is divided at most, where bounds do not show that the patch does not fold."""

AT_ONCE = 1 << 12
"""Triangles of parameters that are bounded at a time."""

MOST_CROSSINGS = 6
"""Of a line and a quadratic surface: four by Bézout's theorem, and one at either end that rounding adds."""

WHOLE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
"""Corners of a patch by their parameters (η, ζ)."""

CORNERS, ENDS = np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 0])
"""Pairs of corners that the control points of a quadratic patch belong to."""

SIDES = np.array([[0, 1, 3], [1, 2, 4], [2, 0, 5]])
"""Control points of the sides ab, bc, ca of a patch."""

QUARTERS = np.array([
    [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
    [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
    [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
    [[1, 1, 0], [0, 1, 1], [1, 0, 1]],
]) / 2.0  # fmt: skip
"""Corners of the four triangles that the middles of its edges divide a triangle into, by weights of its corners."""

CURVED = np.dtype(
    [
        ("facet", "i8"),
        ("body", "i8"),
        ("origin", "f8", (3,)),  # mm, corner of the facet
        ("axes", "f8", (3, 3)),  # rows: unit vectors of the facet's own frame, the last its normal
        ("shape", "f8", (6, 3)),  # coefficients of the patch in that frame
        ("inverse", "f8", (2, 2)),  # of the facet's own map from (η, ζ) to (x, y)
        ("edges", "f8", (3, 3)),  # outward unit normals of lines beside the hull, and their distances, mm
        ("low", "f8"),  # mm, heights of the hull over the facet
        ("high", "f8"),
        ("least_bend", "f8"),  # 1/mm, bounds of the second derivatives of the height, in all directions
        ("most_bend", "f8"),
    ]
)


@by_address
class PatchTree(NamedTuple):
    """Curved patches in a full binary tree of boxes; node n has the nodes 2 n and 2 n + 1 below it, the root is 1."""

    low: Array  # (2 · leaves, 3) mm
    high: Array
    patches: NDArray[np.void]  # (leaves · size,) CURVED, leaf by leaf; some of them twice, to fill the leaves
    leaves: int  # a power of two; 0: no patches
    size: int  # patches of a leaf
    folded: int  # curved patches that are left out, as they fold over their facets


def patch_tree(patches: Array, corners: Array, bodies: NDArray[np.int64], chosen: NDArray[np.bool_]) -> PatchTree:
    """Return the tree of the patches that are curved.

    Left out, and counted, are those that fold over their facet, as normals make them that hardly differ along an edge
    to which they are not square.

    Parameters
    ----------
    patches : (m, 6, 3) float64, mm
        See `patch.patches`; none where no facet is chosen.
    corners : (m, 3, 3) float64, mm
        Of the facets.
    bodies : (m,) int64
        Number of the body of each facet.
    chosen : (m,) bool
        Facets that stand for patches.
    """
    facets = np.flatnonzero(chosen) if len(patches) else np.zeros(0, np.int64)
    facets = facets[(patches[facets, 3:] != 0.0).any(axis=(1, 2))]
    nothing = PatchTree(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0, CURVED), 0, 0, 0)
    if not len(facets):
        return nothing
    rows, hulls, usable = _rows(patches[facets], corners[facets])
    rows["facet"], rows["body"] = facets, bodies[facets]
    rows, hulls, folded = rows[usable], hulls[usable], int((~usable).sum())
    if not len(rows):
        return nothing._replace(folded=folded)
    leaves = 1 << max(0, int(np.ceil(np.log2(len(rows) / LARGEST_LEAF))))
    size = -(-len(rows) // leaves)
    order = _in_leaves(hulls.mean(axis=1), leaves, size)
    boxes = hulls[order].reshape(leaves, 6 * size, 3)
    margin = MARGIN * float(np.ptp(boxes, axis=1).max())
    low, high = np.zeros((2 * leaves, 3)), np.zeros((2 * leaves, 3))
    low[leaves:], high[leaves:] = boxes.min(axis=1) - margin, boxes.max(axis=1) + margin
    for first in (leaves >> level for level in range(1, leaves.bit_length())):
        low[first : 2 * first] = low[2 * first : 4 * first].reshape(first, 2, 3).min(axis=1)
        high[first : 2 * first] = high[2 * first : 4 * first].reshape(first, 2, 3).max(axis=1)
    return PatchTree(low, high, rows[order], leaves, size, folded)


def control_points(patches: Array) -> Array:
    """Return the (m, 6, 3) control points of patches as Bézier triangles: corners, and one for each edge.

    Parameters
    ----------
    patches : (m, 6, 3) float64, mm
    """
    return cell_control_points(patches, np.broadcast_to(WHOLE, (len(patches), 3, 2)))


def cell_control_points(patches: Array, cells: Array) -> Array:
    """Return the (m, 6, 3) control points of parts of patches, by their polar form: corners, and one for each edge.

    Parameters
    ----------
    patches : (m, 6, 3) float64, mm
    cells : (m, 3, 2) float64
        Parameters (η, ζ) of the corners of a triangle on each patch.
    """
    one, other = cells[:, CORNERS], cells[:, ENDS]
    eta, zeta = 0.5 * (one[..., 0] + other[..., 0]), 0.5 * (one[..., 1] + other[..., 1])
    mixed = 0.5 * (one[..., 0] * other[..., 1] + one[..., 1] * other[..., 0])
    basis = np.stack([np.ones_like(eta), eta, zeta, mixed, one[..., 0] * other[..., 0], one[..., 1] * other[..., 1]])
    return np.asarray(np.einsum("bkp,kbi->kpi", basis, patches))


def cell_tangents(patches: Array, cells: Array) -> tuple[Array, Array]:
    """Return the derivatives of patches by η and ζ at the corners of cells, (m, 3, 3) each; between them it is linear.

    Parameters
    ----------
    patches, cells
        As for `cell_control_points`.
    """
    eta, zeta = cells[..., :1], cells[..., 1:]
    by_eta = patches[:, None, 1] + 2.0 * eta * patches[:, None, 4] + zeta * patches[:, None, 3]
    by_zeta = patches[:, None, 2] + 2.0 * zeta * patches[:, None, 5] + eta * patches[:, None, 3]
    return by_eta, by_zeta


def normal_control_vectors(by_eta: Array, by_zeta: Array) -> Array:
    """Return the (m, 6, 3) control vectors of the normals of cells, which are quadratic before they have unit length.

    Parameters
    ----------
    by_eta, by_zeta : (m, 3, 3) float64, mm
        See `cell_tangents`.
    """
    one = np.cross(by_eta[:, CORNERS], by_zeta[:, ENDS])
    return np.asarray(0.5 * (one + np.cross(by_eta[:, ENDS], by_zeta[:, CORNERS])))


def _in_leaves(middles: Array, leaves: int, size: int) -> NDArray[np.int64]:
    """Return the order that puts neighbours into one leaf: each node's widest axis parts it in the middle."""
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


def _rows(patches: Array, corners: Array) -> tuple[NDArray[np.void], Array, NDArray[np.bool_]]:
    """Return the rows of patches, (m,) CURVED, their control points, (m, 6, 3) mm, and which can be used."""
    rows, hulls = np.zeros(len(patches), CURVED), control_points(patches)
    a, b, c = np.moveaxis(corners, 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        axes = np.stack([first, np.cross(normal, first), normal], axis=1)
        shape = np.einsum("mij,mkj->mki", axes, patches - patches[:, :1] * (np.arange(6) == 0)[:, None])
        hull = np.einsum("mij,mkj->mki", axes, hulls - a[:, None])
        # x = along · (η, ζ), whose columns are the facet's sides ab and bc.
        along = np.stack([hull[:, 1, :2], hull[:, 2, :2] - hull[:, 1, :2]], axis=2)
        usable = np.isfinite(axes).all(axis=(1, 2)) & (np.linalg.det(along) > 0.0)
    rows["origin"], rows["axes"], rows["shape"] = a, axes, shape
    rows["inverse"][usable] = np.linalg.inv(along[usable])
    side = np.roll(hull[:, :3, :2], -1, axis=1) - hull[:, :3, :2]
    outward = np.stack([side[..., 1], -side[..., 0]], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    # Patches that do not fold reach farthest on their sides.
    margin = MARGIN * np.ptp(hull, axis=1).max(axis=1, initial=0.0)
    rows["edges"][..., :2] = outward
    rows["edges"][..., 2] = _tops(outward, hull).max(axis=2) + margin[:, None]
    rows["low"], rows["high"] = hull[..., 2].min(axis=1) - margin, hull[..., 2].max(axis=1) + margin
    least, most, bounded = _bends(shape, _parameters(rows, hull), rows["edges"])
    left = np.flatnonzero(usable & ~bounded)
    whole = np.broadcast_to(WHOLE, (len(left), 3, 2))
    least[left], most[left], usable[left] = _bends(shape[left], whole, rows["edges"][left])
    least[left], most[left] = UNBOUNDED * least[left], UNBOUNDED * most[left]
    rows["least_bend"], rows["most_bend"] = np.minimum(least, 0.0), np.maximum(most, 0.0)
    return rows, hulls, usable


def _tops(outward: Array, control: Array) -> Array:
    """Return how far sides of patches reach along directions in their facets' planes, (m, directions, sides) mm.

    Parameters
    ----------
    outward : (m, directions, 2) float64
    control : (m, 6, 3) float64, mm
        Control points in the frames of the facets.
    """
    begin, end, middle = np.moveaxis(np.einsum("mei,mski->mesk", outward, control[:, SIDES, :2]), 3, 0)
    bend = begin - 2.0 * middle + end
    turns = (middle > begin) & (middle > end)
    return np.asarray(np.divide(begin * end - middle**2, bend, out=np.maximum(begin, end), where=turns))


def _parameters(rows: NDArray[np.void], hull: Array) -> Array:
    """Return triangles (m, 3, 2) of parameters whose images hold all that a patch's `edges` enclose; NaN: none found.

    The image of each side, a parabola, lies beyond an edge. So places between the edges are covered once by the
    triangle's image, if it does not fold there.

    Parameters
    ----------
    rows : (m,) CURVED
    hull : (m, 6, 3) float64, mm
        Control points in the frames of the facets.
    """
    edges, opposite = rows["edges"], np.array([2, 0, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.einsum("mei,mei->me", edges[..., :2], hull[:, :3, :2] - hull[:, opposite, :2])
        beyond = ((edges[..., 2] + _tops(-edges[..., :2], hull)[:, [0, 1, 2], [0, 1, 2]]) / height).max(axis=1)
    found = np.full((len(rows), 3, 2), np.nan)
    for wider in WIDER:
        left = np.flatnonzero(np.isnan(found[:, 0, 0]) & np.isfinite(beyond))
        cells = WHOLE + 3.0 * wider * beyond[left, None, None] * (WHOLE - WHOLE.mean(axis=0))
        tops = _tops(-edges[left, :, :2], cell_control_points(rows["shape"][left], cells))[:, [0, 1, 2], [0, 1, 2]]
        some = (edges[left, :, 2] + tops <= 0.0).all(axis=1)
        found[left[some]] = cells[some]
    return found


def _bends(shape: Array, cells: Array, edges: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives of patches' heights between their edges, and which do not fold there.

    Slopes and the derivatives of the parameters are quotients of quadratics, whose control values bound them where
    those of the denominator are positive. All have the same denominator, so that all are means of their control values
    with the same weights, and the second derivatives are means of the products of three.

    Parameters
    ----------
    shape : (m, 6, 3) float64, mm
        See `CURVED`.
    cells : (m, 3, 2) float64
        Parameters of the corners of triangles that hold all between the edges.
    edges : (m, 3, 3) float64
        See `CURVED`.
    """
    least, most = np.full(len(shape), np.inf), np.full(len(shape), -np.inf)
    usable = np.asarray(np.isfinite(cells).all(axis=(1, 2)) & np.isfinite(shape).all(axis=(1, 2)))
    owner = np.flatnonzero(usable)
    cells = cells[owner]
    for division in range(DIVISIONS + 1):
        again = np.zeros(len(owner), np.bool_)
        for first in range(0, len(owner), AT_ONCE):
            some = slice(first, first + AT_ONCE)
            low, high, bounded = _bends_of_cells(shape[owner[some]], cells[some])
            np.minimum.at(least, owner[some][bounded], low[bounded])
            np.maximum.at(most, owner[some][bounded], high[bounded])
            again[some] = ~bounded
        usable[owner[again & (division == DIVISIONS)]] = False
        usable[owner[again][_folds(shape[owner[again]], cells[again], edges[owner[again]])]] = False
        again &= usable[owner]
        cells = np.einsum("qcd,mdp->mqcp", QUARTERS, cells[again]).reshape(-1, 3, 2)
        owner = np.repeat(owner[again], len(QUARTERS))
        places = cell_control_points(shape[owner], cells)[..., :2]
        beyond = np.einsum("mei,mki->mek", edges[owner, :, :2], places) >= edges[owner, :, None, 2]
        cells, owner = (each[~beyond.all(axis=2).any(axis=1)] for each in (cells, owner))
    return least, most, usable & np.isfinite(least) & np.isfinite(most)


def _folds(shape: Array, cells: Array, edges: Array) -> NDArray[np.bool_]:
    """Tell which patches fold at a corner of a cell that lies between their edges.

    Parameters
    ----------
    shape, cells, edges
        As for `_bends`.
    """
    normal = np.cross(*cell_tangents(shape, cells))[..., 2]
    places = cell_control_points(shape, cells)[:, :3, :2]
    between = (np.einsum("mei,mki->mke", edges[..., :2], places) <= edges[:, None, :, 2]).all(axis=2)
    return np.asarray((between & (normal <= 0.0)).any(axis=1))


def _bends_of_cells(shape: Array, cells: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives of patches' heights over triangles, and which have positive denominators.

    Parameters
    ----------
    shape, cells
        As for `_bends`.
    """
    by_eta, by_zeta = cell_tangents(shape, cells)
    normal = normal_control_vectors(by_eta, by_zeta)
    bounded = np.asarray((normal[..., 2] > 0.0).all(axis=1))
    _, _, _, mixed, eta2, zeta2 = np.moveaxis(shape, 1, 0)
    second = np.stack([np.stack([2.0 * eta2, mixed], axis=2), np.stack([mixed, 2.0 * zeta2], axis=2)], axis=3)
    along_eta, along_zeta = (0.5 * (each[:, CORNERS] + each[:, ENDS]) for each in (by_eta, by_zeta))
    low, high = np.full(len(shape), np.inf), np.full(len(shape), -np.inf)
    with np.errstate(invalid="ignore", divide="ignore"):
        # (η, ζ) by (x, y), and the height's slopes.
        rows = (
            np.stack([along_zeta[..., 1], -along_zeta[..., 0]], axis=2),
            np.stack([-along_eta[..., 1], along_eta[..., 0]], axis=2),
        )
        back = np.stack(rows, axis=2) / normal[..., 2, None, None]
        slope = -normal[..., :2] / normal[..., 2:]
        for k in range(6):
            bend = second[:, 2] - slope[:, k, 0, None, None] * second[:, 0] - slope[:, k, 1, None, None] * second[:, 1]
            bends = np.einsum("miax,mab,mkby->mikxy", back, bend, back, optimize=True)
            mean = 0.5 * (bends[..., 0, 0] + bends[..., 1, 1])
            half = np.hypot(0.5 * (bends[..., 0, 0] - bends[..., 1, 1]), 0.5 * (bends[..., 0, 1] + bends[..., 1, 0]))
            low, high = (
                np.minimum(low, (mean - half).min(axis=(1, 2))),
                np.maximum(high, (mean + half).max(axis=(1, 2))),
            )
    return low, high, bounded


@kernel
def _place(patch: Any, x: float, y: float) -> tuple[float, float]:
    """Return the parameters (η, ζ) of the point of a patch over a point of its facet's plane, by Newton's method."""
    inverse = patch.inverse
    eta, zeta = inverse[0, 0] * x + inverse[0, 1] * y, inverse[1, 0] * x + inverse[1, 1] * y
    for _ in range(NEWTON_STEPS):
        u, v, _, ua, va, _, ub, vb, _ = patch_point(patch.shape, eta, zeta)
        determinant = ua * vb - ub * va
        by_eta = ((u - x) * vb - (v - y) * ub) / determinant
        by_zeta = ((v - y) * ua - (u - x) * va) / determinant
        eta -= by_eta
        zeta -= by_zeta
        if not abs(by_eta) + abs(by_zeta) >= SETTLED:
            break
    return eta, zeta


@kernel
def _height_at(patch: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return the height of a patch over its facet, mm, and its slopes along x and y of the facet's frame."""
    eta, zeta = _place(patch, x, y)
    _, _, height, ua, va, wa, ub, vb, wb = patch_point(patch.shape, eta, zeta)
    determinant = ua * vb - ub * va
    return height, (wa * vb - wb * va) / determinant, (wb * ua - wa * ub) / determinant


_first_crossing = crossing_finder(_height_at)


@kernel
def _crosses(patch: Any, sense: float, ray: Ray, begin: float, end: float) -> tuple[bool, float, float, float, float]:
    """Return whether a ray crosses a patch in a sense, the first distance, and the unit normal there.

    Parameters
    ----------
    patch : CURVED
    sense : float
        1 to cross along the facet's normal, −1 against it.
    ray : Ray
    begin, end : float, mm
        Distances between which it is looked for.
    """
    x, y, z, dx, dy, dz = ray
    o, a = patch.origin, patch.axes
    px, py, pz = x - o[0], y - o[1], z - o[2]
    u = a[0, 0] * px + a[0, 1] * py + a[0, 2] * pz
    v = a[1, 0] * px + a[1, 1] * py + a[1, 2] * pz
    w = a[2, 0] * px + a[2, 1] * py + a[2, 2] * pz
    du = a[0, 0] * dx + a[0, 1] * dy + a[0, 2] * dz
    dv = a[1, 0] * dx + a[1, 1] * dy + a[1, 2] * dz
    dw = a[2, 0] * dx + a[2, 1] * dy + a[2, 2] * dz
    first, last = part_inside(dw, patch.high - w, begin, end)
    first, last = part_inside(-dw, w - patch.low, first, last)
    for k in range(3):
        e = patch.edges[k]
        first, last = part_inside(e[0] * du + e[1] * dv, e[2] - e[0] * u - e[1] * v, first, last)
    if not first <= last:
        return False, 0.0, 0.0, 0.0, 1.0
    u, v, w = u + first * du, v + first * dv, w + first * dw
    across2 = du * du + dv * dv
    t, until = 0.0, last - first
    height, _, _ = _height_at(patch, u, v)
    # Beside the patch, or by rounding, it may be on the other side of the endless one: it first comes out of that.
    side = sense if sense * (height - w) >= 0.0 else -sense
    for _ in range(MOST_CROSSINGS):
        most = across2 * (-patch.least_bend if side > 0.0 else patch.most_bend)
        met, t = _first_crossing(patch, Ray(u, v, w, du, dv, dw), side, most, t, until)
        if not met:
            break
        if side == sense:
            eta, zeta = _place(patch, u + t * du, v + t * dv)
            if zeta >= -INSIDE and eta - 1.0 <= INSIDE and zeta - eta <= INSIDE:
                _, by_u, by_v = _height_at(patch, u + t * du, v + t * dv)
                scale = 1.0 / np.sqrt(1.0 + by_u * by_u + by_v * by_v)
                return (
                    True,
                    first + t,
                    scale * (a[2, 0] - by_u * a[0, 0] - by_v * a[1, 0]),
                    scale * (a[2, 1] - by_u * a[0, 1] - by_v * a[1, 1]),
                    scale * (a[2, 2] - by_u * a[0, 2] - by_v * a[1, 2]),
                )
        side = -side
    return False, 0.0, 0.0, 0.0, 1.0


def patch_finder(sense_of: Any) -> Any:
    """Make the kernel that finds the first of a tree's patches that a ray crosses.

    Parameters
    ----------
    sense_of : kernel
        Called as ``sense_of(state, body)``; returns 1 if patches of a body are met along their normals, −1 if against
        them, and 0 if not at all.

    Returns
    -------
    first_patch : kernel
    """

    @kernel
    def first_patch(
        tree: PatchTree, state: Any, ray: Ray, begin: float, end: float
    ) -> tuple[int, float, float, float, float]:
        """Return the facet of the first patch that a ray crosses, the distance, and the patch's unit normal; −1: none.

        Parameters
        ----------
        tree : PatchTree
        state : Any
            As `sense_of` takes it.
        ray : Ray
        begin, end : float, mm
            Distances between which it is looked for.
        """
        found, nearest, nx, ny, nz = -1, end, 0.0, 0.0, 1.0
        node = 1 if tree.leaves > 0 else 0
        while node > 0:
            if meets_box(tree.low[node], tree.high[node], ray, begin, nearest):
                if node < tree.leaves:
                    node *= 2
                    continue
                first = (node - tree.leaves) * tree.size
                for k in range(first, first + tree.size):
                    patch = tree.patches[k]
                    sense = sense_of(state, patch.body)
                    if sense == 0.0:
                        continue
                    met, t, mx, my, mz = _crosses(patch, sense, ray, begin, nearest)
                    if met and t < nearest:
                        found, nearest, nx, ny, nz = patch.facet, t, mx, my, mz
            # On to the next node that is not below this one.
            while node & 1:
                node >>= 1
            node += 1 if node > 0 else 0
        return found, nearest, nx, ny, nz

    return first_patch
