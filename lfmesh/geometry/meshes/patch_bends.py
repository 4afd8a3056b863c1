"""Control points of curved patches and their parts, and bounds of the patches' second derivatives over their facets."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array

WIDER = (1.0, 1.25, 1.5, 2.0, 3.0, 5.0, 8.0)
"""Sizes tried for the triangle of parameters that covers the region between a patch's edges, in units of the largest
distance of the patch's sides from the edges."""

GENTLE = 0.05
"""Relative uncertainty of a patch's second derivatives up to which bounds from the whole patch are good enough."""

LARGER, LONGEST_MOVE = 0.25, (1.0 + 0.25 * 4.0 / 3.0) ** 2
"""Enlargement of the facet's triangle for these bounds, and the shift of patch points it implies, from their places in
the facet's plane, in units of the largest shift of a control point."""

UNBOUNDED = 1.5
"""Factor on a patch's second derivatives if no bounds exist beside it, between its edges, because it folds there."""

DIVISIONS = 4
"""Most subdivisions of a triangle of parameters to show that the patch does not fold."""

AT_ONCE = 1 << 12
"""Triangles of parameters bounded at a time."""

WHOLE = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])
"""Corners of a patch by their parameters (η, ζ)."""

CORNERS, ENDS = np.array([0, 1, 2, 0, 1, 2]), np.array([0, 1, 2, 1, 2, 0])
"""Pairs of corners of the control points of a quadratic patch."""

SIDES = np.array([[0, 1, 3], [1, 2, 4], [2, 0, 5]])
"""Control points of the sides ab, bc, ca of a patch."""

QUARTERS = np.array([
    [[2, 0, 0], [1, 1, 0], [1, 0, 1]],
    [[1, 1, 0], [0, 2, 0], [0, 1, 1]],
    [[1, 0, 1], [0, 1, 1], [0, 0, 2]],
    [[1, 1, 0], [0, 1, 1], [1, 0, 1]],
]) / 2.0  # fmt: skip
"""Corners of the four triangles into which the edge midpoints divide a triangle, as weights of its corners."""


def control_points(patches: Array) -> Array:
    """Return the Bézier control points (m, 6, 3) of patches: three corners, and one for each edge.

    Parameters
    ----------
    patches : (m, 6, 3) float64, mm
    """
    return cell_control_points(patches, np.broadcast_to(WHOLE, (len(patches), 3, 2)))


def cell_control_points(patches: Array, cells: Array) -> Array:
    """Return the Bézier control points (m, 6, 3) of parts of patches, by their polar form.

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
    """Return the derivatives of patches by η and ζ at the corners of cells, (m, 3, 3) each; they are linear between.

    Parameters
    ----------
    patches, cells
        See `cell_control_points`.
    """
    eta, zeta = cells[..., :1], cells[..., 1:]
    by_eta = patches[:, None, 1] + 2.0 * eta * patches[:, None, 4] + zeta * patches[:, None, 3]
    by_zeta = patches[:, None, 2] + 2.0 * zeta * patches[:, None, 5] + eta * patches[:, None, 3]
    return by_eta, by_zeta


def normal_control_vectors(by_eta: Array, by_zeta: Array) -> Array:
    """Return the control vectors (m, 6, 3) of the unnormalised normals of cells, which are quadratic.

    Parameters
    ----------
    by_eta, by_zeta : (m, 3, 3) float64, mm
        See `cell_tangents`.
    """
    one = np.cross(by_eta[:, CORNERS], by_zeta[:, ENDS])
    return np.asarray(0.5 * (one + np.cross(by_eta[:, ENDS], by_zeta[:, CORNERS])))


def tops(outward: Array, control: Array) -> Array:
    """Return the maximum of the sides of patches along directions in their facets' planes, (m, directions, sides) mm.

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


def bends_of(
    shape: Array, inverse: Array, edges: Array, hull: Array, usable: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives of patches' heights between their edges, and which patches do not fold.

    Parameters
    ----------
    shape : (m, 6, 3) float64, mm
        Coefficients of the patches in the frames of their facets; see `patch_tree.CURVED`.
    inverse : (m, 2, 2) float64
    edges : (m, 3, 3) float64
        See `patch_tree.CURVED`.
    hull : (m, 6, 3) float64, mm
        Control points in the frames of the facets.
    usable : (m,) bool
        Patches to examine.
    """
    least, most, gentle = _gentle_bends(shape, inverse, edges, hull)
    usable = usable.copy()
    left = np.flatnonzero(usable & ~gentle)
    least[left], most[left], bounded = _bends(
        shape[left], _parameters(shape[left], edges[left], hull[left]), edges[left]
    )
    left = left[~bounded]
    whole = np.broadcast_to(WHOLE, (len(left), 3, 2))
    least[left], most[left], usable[left] = _bends(shape[left], whole, edges[left])
    least[left], most[left] = UNBOUNDED * least[left], UNBOUNDED * most[left]
    return least, most, usable


def _gentle_bends(shape: Array, inverse: Array, edges: Array, hull: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives of patches that hardly turn, and which patches these are.

    Over a place p in its facet's plane a patch has a point x = p + B(p) and a height w(p), both quadratic. The region
    between the edges is the image of an enlarged facet; the enlargement allows for the reach of the edges and of |B|
    beyond the sides. If |∂B/∂p| ≤ ε < 1 there, x is one-to-one and ∂p/∂x differs from 1 by at most e = ε / (1 − ε). The
    second derivatives by x then differ from the constant ones by p by at most |w″| (2 e + e²) + (1 + e)³ |w′| |B″|.

    Parameters
    ----------
    shape, inverse, edges, hull
        See `bends_of`.
    """
    along_eta, along_zeta, mixed, eta2, zeta2 = np.ascontiguousarray(np.moveaxis(shape[:, 1:], 0, 2))
    (ax, ay), (bx, by) = np.ascontiguousarray(np.moveaxis(inverse, 0, 2))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        xx = 2.0 * (eta2 * (ax * ax) + mixed * (ax * bx) + zeta2 * (bx * bx))
        yy = 2.0 * (eta2 * (ay * ay) + mixed * (ay * by) + zeta2 * (by * by))
        xy = 2.0 * (eta2 * (ax * ay) + zeta2 * (bx * by)) + mixed * (ax * by + ay * bx)
        # Derivatives at the middle of the facet, η = 2/3 and ζ = 1/3.
        by_eta, by_zeta = along_eta + (4.0 * eta2 + mixed) / 3.0, along_zeta + (2.0 * mixed + 2.0 * zeta2) / 3.0
        by_x, by_y = by_eta * ax + by_zeta * bx, by_eta * ay + by_zeta * by
        corners = np.ascontiguousarray(np.moveaxis(hull[..., :2], 0, 2))
        begin, end, other = corners[:3], corners[[1, 2, 0]], corners[[2, 0, 1]]
        moved = np.sqrt(np.max(np.sum((corners[3:] - 0.5 * (begin + end)) ** 2, axis=1), axis=0))
        out_x, out_y, distance = np.moveaxis(edges, 0, 2).transpose(1, 0, 2)
        beyond = distance - out_x * begin[:, 0] - out_y * begin[:, 1] + LONGEST_MOVE * moved
        height = out_x * (begin[:, 0] - other[:, 0]) + out_y * (begin[:, 1] - other[:, 1])
        larger = 3.0 * np.max(beyond / height, axis=0)
        middle = np.mean(corners[:3], axis=0)
        wide = (1.0 + larger) * np.sqrt(np.max(np.sum((corners[:3] - middle) ** 2, axis=1), axis=0))
        turn = np.sqrt(np.sum(xx[:2] ** 2 + 2.0 * xy[:2] ** 2 + yy[:2] ** 2, axis=0))
        off = np.sqrt((by_x[0] - 1.0) ** 2 + by_x[1] ** 2 + by_y[0] ** 2 + (by_y[1] - 1.0) ** 2) + turn * wide
        mean, half = 0.5 * (xx[2] + yy[2]), np.hypot(0.5 * (xx[2] - yy[2]), xy[2])
        bend = np.abs(mean) + half
        steep = np.hypot(by_x[2], by_y[2]) + bend * wide
        back = off / (1.0 - off)
        apart = bend * back * (2.0 + back) + (1.0 + back) ** 3 * steep * turn
        gentle = (larger <= LARGER) & (off < 1.0) & (apart <= GENTLE * bend)
    return mean - half - apart, mean + half + apart, gentle


def _parameters(shape: Array, edges: Array, hull: Array) -> Array:
    """Return triangles (m, 3, 2) of parameters with images that cover the region inside a patch's `edges`; NaN if none.

    The image of each side, a parabola, lies beyond an edge. The triangle's image therefore covers each place between
    the edges once, if it does not fold there.

    Parameters
    ----------
    shape, edges
        See `bends_of`.
    hull : (m, 6, 3) float64, mm
        Control points in the frames of the facets.
    """
    opposite = np.array([2, 0, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        height = np.einsum("mei,mei->me", edges[..., :2], hull[:, :3, :2] - hull[:, opposite, :2])
        beyond = ((edges[..., 2] + tops(-edges[..., :2], hull)[:, [0, 1, 2], [0, 1, 2]]) / height).max(axis=1)
    found = np.full((len(shape), 3, 2), np.nan)
    for wider in WIDER:
        left = np.flatnonzero(np.isnan(found[:, 0, 0]) & np.isfinite(beyond))
        cells = WHOLE + 3.0 * wider * beyond[left, None, None] * (WHOLE - WHOLE.mean(axis=0))
        reached = tops(-edges[left, :, :2], cell_control_points(shape[left], cells))[:, [0, 1, 2], [0, 1, 2]]
        some = (edges[left, :, 2] + reached <= 0.0).all(axis=1)
        found[left[some]] = cells[some]
    return found


def _bends(shape: Array, cells: Array, edges: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives of patches' heights between their edges, and which do not fold there.

    Slopes and the derivatives of the parameters are quotients of quadratics with one denominator, bounded by their
    control values if those of the denominator are positive. All are means of control values with the same weights, so
    the second derivatives are means of triple products.

    Parameters
    ----------
    shape, edges
        See `bends_of`.
    cells : (m, 3, 2) float64
        Parameters of the corners of triangles that cover the region between the edges.
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
    """Tell which patches fold at a corner of a cell that lies between their edges; see `_bends`."""
    normal = np.cross(*cell_tangents(shape, cells))[..., 2]
    places = cell_control_points(shape, cells)[:, :3, :2]
    between = (np.einsum("mei,mci->mce", edges[..., :2], places) <= edges[:, None, :, 2]).all(axis=2)
    return np.asarray((between & (normal <= 0.0)).any(axis=1))


def _bends_of_cells(shape: Array, cells: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return bounds of the second derivatives over triangles, and which triangles have positive denominators.

    See `_bends`.
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
