"""Index fields on voxel grids, interpolated by cubic B-splines: n² and ½ ∇n² at a point, as kernels evaluate them.

A grid holds a quantity q at its nodes, the centres of its voxels. The index is n = a + b q, with a and b for each
wavelength: by Gladstone and Dale's law, one grid of the density serves all wavelengths of a gas. Between the nodes

    q(x, y, z) = Σ c_ijk B(x/h_x − i) B(y/h_y − j) B(z/h_z − k)

with the cubic B-spline B and coefficients c such that q is exact at the nodes. A point depends on 4³ coefficients. The
gradient is the derivative of this formula, so value and gradient belong to one field: rays conserve n² − |T|², and a
ray that is sent back takes the same way.

At each end of the grid, the third derivative is continuous across the second node ("not-a-knot"; C. de Boor, A
Practical Guide to Splines, Springer 2001, chapter IV). Polynomials up to the third degree are then exact, and the error
falls with the fourth power of the spacing up to the last node. The mirrored data that image filters assume would set
the gradient to 0 there, which is wrong by all of a linear gradient. The polynomials of the outer cells continue through
the half voxels between the outer nodes and the grid's faces, and beyond them, where an integrator may evaluate them. Of
one, two or three nodes along an axis, the spline is the constant, linear or quadratic polynomial through them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.errors import SceneError
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import fused

Array = NDArray[np.float64]
Weights = tuple[float, float, float, float, float, float, float, float]

LEAPFROG, RUNGE_KUTTA = range(2)
"""Schemes of integration, see `index_field_path`."""

STEP_CELLS = 4.0
"""Default length of a leapfrog step, in voxels."""

REACH = 4
"""Coefficients along each axis that a point depends on."""

FEWEST_NODES = 4
"""Nodes along an axis that the equations of the spline need."""

INDEX_FIELD = np.dtype(
    [
        ("low", "f8", (3,)),  # mm, lowest corner of the field
        ("high", "f8", (3,)),  # mm, highest corner
        ("per_mm", "f8", (3,)),  # voxels per mm along each axis
        ("scheme", "i8"),
        ("slabs", "i8", (3,)),  # LEAPFROG: steps from face to face along each axis
        ("step", "f8"),  # RUNGE_KUTTA: voxels
        ("origin", "f8", (3,)),  # mm, node [0, 0, 0]
        ("counts", "i8", (3,)),  # coefficients along each axis
        ("first", "i8"),  # first of the field's coefficients
        ("offset", "f8"),  # a of n = a + b q
        ("scale", "f8"),  # b
    ]
)


@by_address
class IndexFields(NamedTuple):
    """Index fields in the form that kernels read."""

    rows: NDArray[np.void]  # (fields · wavelengths,) INDEX_FIELD: all wavelengths of a field in succession
    coefficients: Array  # of all fields, each [x, y, z]


@dataclass(frozen=True, eq=False)
class IndexField:
    """An index field on a voxel grid, in the grid's own frame.

    Attributes
    ----------
    coefficients : (cx, cy, cz) float64
        Of the B-splines, from the one before the first node to the one behind the last.
    spacing_mm, origin_mm : (3,) float64
        Distances between neighbouring nodes, and node [0, 0, 0].
    bounds_mm : (2, 3) float64
        Lowest and highest corner of the box in which the field bends light.
    offsets, scales : (wavelengths,) float64
        a and b of n = a + b q.
    scheme : int
        LEAPFROG or RUNGE_KUTTA.
    step_cells : float
        Length of a step, in voxels.
    """

    coefficients: Array
    spacing_mm: Array
    origin_mm: Array
    bounds_mm: Array
    offsets: Array
    scales: Array
    scheme: int = LEAPFROG
    step_cells: float = STEP_CELLS


def index_field(
    values: ArrayLike,
    spacing_mm: ArrayLike,
    origin_mm: ArrayLike | None = None,
    bounds_mm: ArrayLike | None = None,
    law: tuple[ArrayLike, ArrayLike] = (0.0, 1.0),
) -> IndexField:
    """Interpolate a quantity on a voxel grid, and return the index field that it gives.

    Parameters
    ----------
    values : (nx, ny, nz) array_like
        q at the nodes.
    spacing_mm : float or (3,) array_like
    origin_mm : (3,) array_like, optional
        Node [0, 0, 0]. Default: the grid is centred on the origin.
    bounds_mm : (2, 3) array_like, optional
        Lowest and highest corner of the field. Default: the faces of the outer voxels.
    law : pair of float or (wavelengths,) array_like
        a and b of n = a + b q. Default: q is the index.

    Raises
    ------
    SceneError
        The values are no grid of finite numbers, an index is 0 or less, or the bounds reach beyond the grid.
    """
    grid = np.asarray(values, np.float64)
    if grid.ndim != 3 or grid.size == 0:
        raise SceneError(f"index field: the values must be an array [x, y, z], but have the shape {grid.shape}")
    if not np.isfinite(grid).all():
        raise SceneError("index field: the values must be finite everywhere")
    spacing = np.broadcast_to(np.asarray(spacing_mm, np.float64), (3,)).copy()
    origin = -0.5 * spacing * (np.array(grid.shape) - 1) if origin_mm is None else np.array(origin_mm, np.float64)
    offsets, scales = (np.array(part, np.float64) for part in np.broadcast_arrays(*map(np.atleast_1d, law)))
    # A uniform grid then has the coefficients 0, and bends no light by rounding errors.
    least, largest = float(grid.min()), float(grid.max())
    middle = 0.5 * (least + largest)
    _refuse_indices(offsets, scales, least, largest)
    bounds = _bounds(grid.shape, spacing, origin, bounds_mm)
    return IndexField(spline_coefficients(grid - middle), spacing, origin, bounds, offsets + scales * middle, scales)


def _refuse_indices(offsets: Array, scales: Array, least: float, largest: float) -> None:
    lowest = np.minimum(offsets + scales * least, offsets + scales * largest)
    if not (np.isfinite(lowest) & (lowest > 0.0)).all():
        raise SceneError(f"index field: the index is {lowest.min():g} at a voxel; it must be above 0")


def _bounds(shape: tuple[int, ...], spacing: Array, origin: Array, bounds_mm: ArrayLike | None) -> Array:
    low = origin - 0.5 * spacing
    faces = np.array([low, low + spacing * shape])
    if bounds_mm is None:
        return faces
    bounds = np.array(bounds_mm, np.float64).reshape(2, 3)
    # Bounds and faces may come from two calculations.
    slack = 1e-9 * spacing
    for axis, name in enumerate("xyz"):
        if not (faces[0] - slack <= bounds[0])[axis] or not (bounds[1] <= faces[1] + slack)[axis]:
            raise SceneError(
                f"index field: its bounds reach from {bounds[0, axis]:g} to {bounds[1, axis]:g} mm along {name}, but "
                f"its grid from {faces[0, axis]:g} to {faces[1, axis]:g} mm; enlarge the grid"
            )
    return bounds


def field_table(fields: Sequence[IndexField]) -> IndexFields:
    """Return index fields in the form that kernels read.

    Parameters
    ----------
    fields : sequence of IndexField
        All with the same number of wavelengths.
    """
    rows = np.zeros((len(fields), len(fields[0].offsets) if fields else 1), INDEX_FIELD)
    end = 0
    for own, field in zip(rows, fields, strict=True):
        own["low"], own["high"] = field.bounds_mm
        own["per_mm"], own["origin"] = 1.0 / field.spacing_mm, field.origin_mm
        own["scheme"], own["step"] = field.scheme, field.step_cells
        voxels = (field.bounds_mm[1] - field.bounds_mm[0]) / field.spacing_mm
        own["slabs"] = np.maximum(np.ceil(voxels / field.step_cells * (1.0 - 1e-9)), 1.0)
        own["counts"], own["first"] = field.coefficients.shape, end
        own["offset"], own["scale"] = field.offsets, field.scales
        end += field.coefficients.size
    parts = [field.coefficients.ravel() for field in fields] or [np.zeros(0)]
    return IndexFields(rows.ravel(), parts[0] if len(parts) == 1 else np.concatenate(parts))


def spline_coefficients(values: ArrayLike) -> Array:
    """Return the coefficients of the cubic B-splines that interpolate a grid.

    With the second difference δ², the spline is c + δ²c/6 at the nodes. The condition δ⁴c = 0 at the second node gives
    its coefficient, q − δ²q/6. The coefficients between the second node and the last but one follow from a tridiagonal
    system with 4 on its diagonal and 1 beside it, the four outer ones from the equations of the two outer nodes.

    Parameters
    ----------
    values : (nx, ny, nz) array_like

    Returns
    -------
    (cx, cy, cz) float64
        Two more than nodes along each axis, but at least 4.
    """
    grid = np.asarray(values, np.float64)
    counts = [max(n, 2) + 2 for n in grid.shape]
    for axis in range(3):
        grid = _extended(grid, axis)
    whole = np.zeros([n + 2 for n in grid.shape])
    whole[1:-1, 1:-1, 1:-1] = grid
    for axis, n in enumerate(grid.shape):
        lines = whole.reshape(int(np.prod(whole.shape[:axis])), n + 2, -1)
        _solve(lines, _elimination(n))
    return np.ascontiguousarray(whole[tuple(slice(n) for n in counts)])


def _extended(grid: Array, axis: int) -> Array:
    """Return a grid with at least `FEWEST_NODES` nodes along an axis, on the polynomial through the given ones."""
    while (n := grid.shape[axis]) < FEWEST_NODES:
        last = [grid.take([n - 1 - i], axis) for i in range(n)]
        following = (last[0], 2.0 * last[0] - last[-1], 3.0 * (last[0] - last[min(1, n - 1)]) + last[-1])[n - 1]
        grid = np.concatenate([grid, following], axis)
    return grid


def _elimination(nodes: int) -> Array:
    """Return the factors of the elimination: 1/4, and 1/(4 − r) behind a factor r."""
    factors = np.empty(max(nodes - 4, 0))
    factor = 0.0
    for i in range(len(factors)):
        factor = 1.0 / (4.0 - factor)
        factors[i] = factor
    return factors


@kernel
def _solve(lines: Array, factors: Array) -> None:
    """Replace the data of lines along the middle axis by coefficients; the first and last element hold no data."""
    n = lines.shape[1] - 2
    for o in range(lines.shape[0]):
        line = lines[o]
        for k in range(lines.shape[2]):
            first, last = line[2, k], line[n - 1, k]
            second = first - (line[1, k] - 2.0 * first + line[3, k]) / 6.0
            last_but_one = last - (line[n - 2, k] - 2.0 * last + line[n, k]) / 6.0
            # The outer equations still need the data that these two replace.
            line[0, k], line[n + 1, k] = first, last
            line[2, k], line[n - 1, k] = second, last_but_one
        for i in range(len(factors)):
            for k in range(lines.shape[2]):
                line[i + 3, k] = (6.0 * line[i + 3, k] - line[i + 2, k]) * factors[i]
        for i in range(len(factors) - 1, -1, -1):
            for k in range(lines.shape[2]):
                line[i + 3, k] -= factors[i] * line[i + 4, k]
        for k in range(lines.shape[2]):
            inner = 6.0 * line[0, k] - 4.0 * line[2, k] - line[3, k]
            line[0, k] = 6.0 * line[1, k] - 4.0 * inner - line[2, k]
            line[1, k] = inner
            inner = 6.0 * line[n + 1, k] - 4.0 * line[n - 1, k] - line[n - 2, k]
            line[n + 1, k] = 6.0 * line[n, k] - 4.0 * inner - line[n - 1, k]
            line[n, k] = inner


@inlined
def _weights(t: float) -> Weights:
    """Return the four B-splines at a distance t from a node, in voxels, and their derivatives."""
    s = 1.0 - t
    s2, t2 = s * s, t * t
    third = 2.0 / 3.0
    return (
        s2 * s / 6.0,
        fused(t2, 0.5 * t - 1.0, third),
        fused(s2, 0.5 * s - 1.0, third),
        t2 * t / 6.0,
        -0.5 * s2,
        t * (1.5 * t - 2.0),
        s * (2.0 - 1.5 * s),
        0.5 * t2,
    )


@inlined
def _along_z(c: Array, at: int, w: Weights) -> tuple[float, float]:
    """Return the sum over four coefficients in succession, and its derivative."""
    c0, c1, c2, c3 = c[at], c[at + 1], c[at + 2], c[at + 3]
    value = fused(w[0], c0, fused(w[1], c1, fused(w[2], c2, w[3] * c3)))
    rate = fused(w[4], c0, fused(w[5], c1, fused(w[6], c2, w[7] * c3)))
    return value, rate


@inlined
def _in_plane(c: Array, at: int, stride: int, v: Weights, w: Weights) -> tuple[float, float, float]:
    """Return the sum over 4 × 4 coefficients, and its derivatives along y and z."""
    value0, z0 = _along_z(c, at, w)
    value1, z1 = _along_z(c, at + stride, w)
    value2, z2 = _along_z(c, at + 2 * stride, w)
    value3, z3 = _along_z(c, at + 3 * stride, w)
    value = fused(v[0], value0, fused(v[1], value1, fused(v[2], value2, v[3] * value3)))
    by_y = fused(v[4], value0, fused(v[5], value1, fused(v[6], value2, v[7] * value3)))
    by_z = fused(v[0], z0, fused(v[1], z1, fused(v[2], z2, v[3] * z3)))
    return value, by_y, by_z


@inlined
def _cell(row: Any, axis: int, at: float) -> tuple[int, float]:
    """Return the first coefficient along an axis that a point depends on, and its distance from the node behind it."""
    u = (at - row.origin[axis]) * row.per_mm[axis]
    i = min(max(int(np.floor(u)), 0), row.counts[axis] - REACH)
    return i, u - i


@inlined
def index_at(fields: IndexFields, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return n at a point, and ∇n, mm⁻¹.

    Parameters
    ----------
    fields : IndexFields
    number : int
        Row of the field and wavelength.
    x, y, z : float, mm
        In the grid's own frame. Beyond the grid, the polynomials of the outer cells continue.
    """
    row = fields.rows[number]
    i, t = _cell(row, 0, x)
    u = _weights(t)
    j, t = _cell(row, 1, y)
    v = _weights(t)
    k, t = _cell(row, 2, z)
    w = _weights(t)
    # All are 0 or more. LLVM sees it by the maximum, and leaves out the checks for negative numbers of elements.
    stride = max(row.counts[2], 0)
    layer = max(row.counts[1], 0) * stride
    at = max(row.first + i * layer + j * stride + k, 0)
    c = fields.coefficients
    value0, y0, z0 = _in_plane(c, at, stride, v, w)
    value1, y1, z1 = _in_plane(c, at + layer, stride, v, w)
    value2, y2, z2 = _in_plane(c, at + 2 * layer, stride, v, w)
    value3, y3, z3 = _in_plane(c, at + 3 * layer, stride, v, w)
    value = fused(u[0], value0, fused(u[1], value1, fused(u[2], value2, u[3] * value3)))
    by_x = fused(u[4], value0, fused(u[5], value1, fused(u[6], value2, u[7] * value3)))
    by_y = fused(u[0], y0, fused(u[1], y1, fused(u[2], y2, u[3] * y3)))
    by_z = fused(u[0], z0, fused(u[1], z1, fused(u[2], z2, u[3] * z3)))
    b = row.scale
    return (
        fused(b, value, row.offset),
        b * by_x * row.per_mm[0],
        b * by_y * row.per_mm[1],
        b * by_z * row.per_mm[2],
    )


@inlined
def index_field_at(fields: IndexFields, number: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return n² at a point, and ½ ∇n², mm⁻¹.

    Parameters
    ----------
    fields, number, x, y, z
        As in `index_at`.
    """
    n, by_x, by_y, by_z = index_at(fields, number, x, y, z)
    return n * n, n * by_x, n * by_y, n * by_z


def indices_at(fields: IndexFields, number: int, points: ArrayLike) -> Array:
    """Return n and ∇n at points, (n, 4): 1 and mm⁻¹.

    Parameters
    ----------
    fields, number
        As in `index_at`.
    points : (n, 3) array_like, mm
    """
    at = np.ascontiguousarray(points, np.float64).reshape(-1, 3)
    found = np.empty((len(at), 4))
    _fill(fields, number, at, found)
    return found


@kernel
def _fill(fields: IndexFields, number: int, points: Array, found: Array) -> None:
    for k in range(len(points)):
        n, by_x, by_y, by_z = index_at(fields, number, points[k, 0], points[k, 1], points[k, 2])
        found[k, 0], found[k, 1], found[k, 2], found[k, 3] = n, by_x, by_y, by_z
