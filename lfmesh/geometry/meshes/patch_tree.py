"""First crossing of a ray with the curved patches themselves, in float64, through a tree of boxes.

Facets lie on the concave side of their surface. A ray that grazes the convex side may pass between a facet and its
patch, or leave it without reaching the facet; ray queries of the facets miss both. A quadratic patch lies in the convex
hull of its six control points (G. Farin, Curves and Surfaces for CAGD, 2002, chapter 17). Inside this hull it is a
height over its facet, which `first_crossing` intersects with a ray.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.box_tree import box_tree, next_node
from lfmesh.geometry.meshes.boxes import meets_box, part_inside, slopes_of
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.meshes.patch import INSIDE, NEWTON_STEPS, SETTLED, patch_point
from lfmesh.geometry.meshes.patch_bends import bends_of, control_points, tops
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.first_crossing import crossing_finder
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import kernel

LARGEST_LEAF = 4
"""Most patches per leaf."""

MARGIN = 1e-9
"""Enlargement of boxes and hulls over the size of their patches: more than the rounding of rays."""

MOST_CROSSINGS = 6
"""Most crossings of a line and a quadratic surface: four by Bézout's theorem, and one at either end due to rounding."""

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
    """Curved patches in a full binary tree of boxes; see `box_tree`."""

    low: Array  # (2 · leaves, 3) mm
    high: Array
    patches: NDArray[np.void]  # (leaves · size,) CURVED, leaf by leaf; some twice, to fill the leaves
    leaves: int  # a power of two; 0: no patches
    size: int  # patches per leaf
    folded: int  # curved patches left out because they fold over their facets


def patch_tree(patches: Array, corners: Array, bodies: NDArray[np.int64], chosen: NDArray[np.bool_]) -> PatchTree:
    """Return the tree of all curved patches.

    Patches that fold over their facet are left out and counted. Normals cause this if they hardly differ along an edge
    that is not perpendicular to them.

    Parameters
    ----------
    patches : (m, 6, 3) float64, mm
        See `patch.patches`; empty if no facet is chosen.
    corners : (m, 3, 3) float64, mm
        Corners of the facets.
    bodies : (m,) int64
        Body of each facet.
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
    tree = box_tree(hulls.min(axis=1), hulls.max(axis=1), hulls.mean(axis=1), LARGEST_LEAF, MARGIN)
    return PatchTree(tree.low, tree.high, rows[tree.order], tree.leaves, tree.size, folded)


def _rows(patches: Array, corners: Array) -> tuple[NDArray[np.void], Array, NDArray[np.bool_]]:
    """Return the rows of patches (m,) CURVED, their control points (m, 6, 3) mm, and which patches are usable."""
    rows, hulls = np.zeros(len(patches), CURVED), control_points(patches)
    a, b, c = np.moveaxis(corners, 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True)
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        axes = np.stack([first, np.cross(normal, first), normal], axis=1)
        shape = np.einsum("mij,mkj->mki", axes, patches - patches[:, :1] * (np.arange(6) == 0)[:, None])
        hull = np.einsum("mij,mkj->mki", axes, hulls - a[:, None])
        # x = along · (η, ζ); the columns are the facet's sides ab and bc.
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
    rows["edges"][..., 2] = tops(outward, hull).max(axis=2) + margin[:, None]
    rows["low"], rows["high"] = hull[..., 2].min(axis=1) - margin, hull[..., 2].max(axis=1) + margin
    least, most, usable = bends_of(shape, rows["inverse"], rows["edges"], hull, usable)
    rows["least_bend"], rows["most_bend"] = np.minimum(least, 0.0), np.maximum(most, 0.0)
    return rows, hulls, usable


@kernel
def _place(patch: Any, x: float, y: float) -> tuple[float, float]:
    """Return the parameters (η, ζ) of a patch over a point in its facet's plane, by Newton's method."""
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
    """Return the height of a patch over its facet, mm, and its slopes along x and y in the facet's frame."""
    eta, zeta = _place(patch, x, y)
    _, _, height, ua, va, wa, ub, vb, wb = patch_point(patch.shape, eta, zeta)
    determinant = ua * vb - ub * va
    return height, (wa * vb - wb * va) / determinant, (wb * ua - wa * ub) / determinant


_first_crossing = crossing_finder(_height_at)


@kernel
def _crosses(patch: Any, sense: float, ray: Ray, begin: float, end: float) -> tuple[bool, float, float, float, float]:
    """Find the first crossing of a ray with a patch in a sense: return whether it exists, its distance and unit normal.

    Parameters
    ----------
    patch : CURVED
    sense : float
        1 to cross along the facet's normal, −1 against it.
    ray : Ray
    begin, end : float, mm
        Range of the search.
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
    # Beside the patch, or by rounding, the ray may start on the far side of the unbounded patch and leave it first.
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
    """Make the kernel that finds the first patch of a tree that a ray crosses.

    Parameters
    ----------
    sense_of : kernel
        Called as ``sense_of(state, body)``. Returns 1 if rays cross the body's patches along their normals, −1 if
        against them, 0 if not at all.

    Returns
    -------
    first_patch : kernel
    """

    @kernel
    def first_patch(
        tree: PatchTree, state: Any, ray: Ray, begin: float, end: float
    ) -> tuple[int, float, float, float, float]:
        """Return the facet of the first patch that a ray crosses, its distance and unit normal; −1 if there is none.

        Parameters
        ----------
        tree : PatchTree
        state : Any
            Passed to `sense_of`.
        ray : Ray
        begin, end : float, mm
            Range of the search.
        """
        found, nearest, nx, ny, nz = -1, end, 0.0, 0.0, 1.0
        slopes, node = slopes_of(ray), 1 if tree.leaves > 0 else 0
        while node > 0:
            if meets_box(tree.low[node], tree.high[node], ray, slopes, begin, nearest):
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
            node = next_node(node)
        return found, nearest, nx, ny, nz

    return first_patch
