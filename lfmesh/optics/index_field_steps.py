"""The scheme and the steps of rays through an index field, and the check of its grid, both by probe rays.

The deflection by a field has two errors. Half as many voxels along each axis change it by several times the error of
the grid: the gradient of a cubic spline has the third order along rays that run between the nodes in line with an axis,
and in other directions a higher one. So a seventh of the change is the error of the grid, or more than that. Steps are
the cheapest ones that add no larger error.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.kernels.decorators import kernel
from lfmesh.optics.index_field_path import INSIDE, deflections, entries, traced, unit_directions
from lfmesh.optics.index_fields import (
    LEAPFROG,
    RUNGE_KUTTA,
    IndexField,
    field_table,
    indices_at,
    spline_coefficients,
)

Array = NDArray[np.float64]

CANDIDATES = ((LEAPFROG, 4.0), (LEAPFROG, 2.0), (LEAPFROG, 1.0), (RUNGE_KUTTA, 2.0), (RUNGE_KUTTA, 1.0))
"""Schemes and steps in voxels, in the order of their evaluations per voxel: 1/4, 1/2, 1, 3/2 and 3."""

REFERENCE = (RUNGE_KUTTA, 0.5)
"""Scheme and step that the others are compared with."""

HALVED = 7.0
"""Change of the deflection over the error of the grid if the grid is halved: 2³ − 1."""

COARSEST = 1e-3
"""Largest change of the deflection, over itself, of a grid that counts as fine enough."""

FINEST = 1e-6
"""Relative error of the deflection that suffices for any grid."""

PROBES = 192
SHIFTS = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Steps of a sequence in the unit cube that fills it evenly: powers of the inverse of the root of x⁴ = x + 1."""

BLOCKS = 24
"""Most blocks along each axis; the steepest point of each block may be a probe's."""


@dataclass(frozen=True)
class FieldProbe:
    """Results of probe rays through an index field.

    Attributes
    ----------
    scheme : int
        LEAPFROG or RUNGE_KUTTA.
    step_cells : float
        Length of a step, in voxels.
    deflection : float
        Largest angle between entry and exit, rad.
    integration_error : float
        Error by the steps: the largest, over the largest deflection.
    halving_change : float
        Change of the deflection by a grid with half as many voxels along each axis: the largest, over the largest
        deflection.
    trapped : int
        Probe rays that do not leave the field.
    """

    scheme: int
    step_cells: float
    deflection: float
    integration_error: float
    halving_change: float
    trapped: int

    @property
    def grid_error(self) -> float:
        """Estimated error of the deflection by the grid, over the largest deflection."""
        return self.halving_change / HALVED

    def fault(self) -> str | None:
        """Return a sentence on a grid that is too coarse, or None."""
        if self.halving_change <= COARSEST:
            return None
        return (
            f"a grid with half as many voxels along each axis bends light by up to {100.0 * self.halving_change:.3g} % "
            f"more or less, so the deflection may be wrong by {100.0 * self.grid_error:.3g} %; give smaller voxels"
        )


def probed(field: IndexField, rays: ArrayLike | None = None) -> FieldProbe:
    """Choose the scheme and the steps of a field, and check its grid.

    Parameters
    ----------
    field : IndexField
    rays : (n, 2, 3) array_like, optional
        A point, mm, and a direction of each probe ray. Default: rays in all directions through steep points.
    """
    strongest = int(np.argmax(np.abs(field.scales)))
    field = replace(field, offsets=field.offsets[[strongest]], scales=field.scales[[strongest]])
    given = np.asarray(probe_rays(field) if rays is None else rays, np.float64)
    truth = _passages(field, given, *REFERENCE)
    coarser = _passages(halved(field), given, REFERENCE[0], 0.5 * REFERENCE[1])
    change = _difference(coarser, truth)
    allowed = max(change / HALVED, FINEST)
    for scheme, step in CANDIDATES:
        error = _difference(_passages(field, given, scheme, step), truth)
        if error <= allowed:
            break
    starts, ends, inside = truth
    bent = deflections(starts, ends)[~inside]
    return FieldProbe(scheme, step, float(bent.max(initial=0.0)), error, change, int(inside.sum()))


def with_steps(field: IndexField, probe: FieldProbe) -> IndexField:
    """Return a field with the scheme and the steps that probe rays gave."""
    return replace(field, scheme=probe.scheme, step_cells=probe.step_cells)


def halved(field: IndexField) -> IndexField:
    """Return a field on a grid with half as many voxels along each axis, between the same outer nodes.

    Its values are those of the spline at the new nodes: of an odd number of nodes, every second one.
    """
    nodes = np.array(field.coefficients.shape) - 2
    fewer = nodes // 2 + 1
    spacing = field.spacing_mm * (nodes - 1) / (fewer - 1)
    quantity = replace(field, offsets=np.zeros(1), scales=np.ones(1))
    table = field_table([quantity])
    x, y, z = (o + s * np.arange(n) for o, s, n in zip(field.origin_mm, spacing, fewer, strict=True))
    layers = [indices_at(table, 0, _layer(at, y, z))[:, 0].reshape(len(y), len(z)) for at in x]
    return replace(field, coefficients=spline_coefficients(np.array(layers)), spacing_mm=spacing)


def _layer(x: float, y: Array, z: Array) -> Array:
    """Return the nodes of one layer across x, (ny nz, 3)."""
    return np.stack(np.meshgrid([x], y, z, indexing="ij"), axis=-1).reshape(-1, 3)


def probe_rays(field: IndexField) -> Array:
    """Return points and directions of probe rays in front of a field, (n, 2, 3).

    Half of them run along the axes, where the error of the grid is largest, the others in all directions. They pass
    within a voxel of the points with the steepest index of blocks of voxels. A steeper block has more rays. A field
    that is uniform has no probe rays.

    Parameters
    ----------
    field : IndexField
    """
    points, steepness = _steep_points(field)
    total = float(steepness.sum())
    if not total > 0.0:
        return np.zeros((0, 2, 3))
    numbers = np.arange(PROBES)
    chosen = np.searchsorted(np.cumsum(steepness) / total, (numbers + 0.5) / PROBES).clip(0, len(points) - 1)
    # Rays in line with the nodes have a smaller error than those between them.
    through = points[chosen] + (numbers[:, None] * SHIFTS % 1.0 - 0.5) * field.spacing_mm
    directions = np.eye(3)[numbers // 2 % 3]
    directions[::2] = _all_directions((PROBES + 1) // 2)
    size = float(np.linalg.norm(field.bounds_mm[1] - field.bounds_mm[0]))
    return np.stack([through - 2.0 * size * directions, directions], axis=1)


def _all_directions(count: int) -> Array:
    """Return evenly spread unit vectors, successive ones far apart: Fibonacci's lattice on the sphere, shuffled."""
    order = np.arange(count) * 47 % count
    up, turn = 1.0 - 2.0 * (order + 0.5) / count, np.pi * (3.0 - np.sqrt(5.0)) * order
    across = np.sqrt(1.0 - up * up)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), up])


def _steep_points(field: IndexField) -> tuple[Array, Array]:
    """Return the steepest node of each block of voxels, (n, 3), and |∇q| there, (n,), approximately."""
    nodes = np.array(field.coefficients.shape) - 2
    first = np.ceil((field.bounds_mm[0] - field.origin_mm) / field.spacing_mm).astype(np.int64).clip(0, nodes - 1)
    last = np.floor((field.bounds_mm[1] - field.origin_mm) / field.spacing_mm).astype(np.int64).clip(0, nodes - 1)
    last = np.maximum(first, last)
    blocks = np.minimum(last - first + 1, BLOCKS)
    steepest = np.full(blocks, -1.0)
    where = np.zeros((*blocks, 3), np.int64)
    _find_steepest(field.coefficients, 0.5 / field.spacing_mm, first, last, steepest, where)
    found = where.reshape(-1, 3)
    return field.origin_mm + field.spacing_mm * found, np.sqrt(steepest.ravel().clip(0.0))


@kernel
def _find_steepest(
    c: Array,
    per_mm: Array,
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    steepest: Array,
    where: NDArray[np.int64],
) -> None:
    """Write the largest squared difference of the coefficients in each block of nodes, and its node."""
    for i in range(first[0], last[0] + 1):
        a = (i - first[0]) * steepest.shape[0] // (last[0] - first[0] + 1)
        for j in range(first[1], last[1] + 1):
            b = (j - first[1]) * steepest.shape[1] // (last[1] - first[1] + 1)
            for k in range(first[2], last[2] + 1):
                d = (k - first[2]) * steepest.shape[2] // (last[2] - first[2] + 1)
                x = per_mm[0] * (c[i + 2, j + 1, k + 1] - c[i, j + 1, k + 1])
                y = per_mm[1] * (c[i + 1, j + 2, k + 1] - c[i + 1, j, k + 1])
                z = per_mm[2] * (c[i + 1, j + 1, k + 2] - c[i + 1, j + 1, k])
                square = x * x + y * y + z * z
                if square > steepest[a, b, d]:
                    steepest[a, b, d] = square
                    where[a, b, d, 0], where[a, b, d, 1], where[a, b, d, 2] = i, j, k


_Passages = tuple[Array, Array, NDArray[np.bool_]]


def _passages(field: IndexField, rays: Array, scheme: int, step: float) -> _Passages:
    """Return rays that meet a field at their entries and exits, (n, 8), and if they are trapped inside."""
    table = field_table([replace(field, scheme=scheme, step_cells=step)])
    starts = entries(table, 0, rays[:, 0], rays[:, 1])
    starts = starts[~np.isnan(starts[:, 0])]
    faces, ends = traced(table, 0, starts)
    return starts, ends, faces == INSIDE


def _difference(passages: _Passages, truth: _Passages) -> float:
    """Return the largest difference between rays at their exits, over the largest deflection.

    The distance between two rays counts as an angle, seen from the longest path.
    """
    (starts, ends, inside), (_, right, inside_too) = passages, truth
    out = ~(inside | inside_too)
    if not out.any():
        return 0.0
    starts, ends, right = starts[out], ends[out], right[out]
    largest = float(deflections(starts, right).max())
    return max(_errors(ends, right)) / largest if largest > 0.0 else 0.0


def _errors(ends: Array, truth: Array) -> Iterator[float]:
    """Yield the largest angle between rays at their exits, and their largest distance over the longest path."""
    yield float(deflections(ends, truth).max())
    along = unit_directions(truth)
    apart = ends[:, :3] - truth[:, :3]
    apart -= (apart * along).sum(axis=1, keepdims=True) * along
    yield float(np.linalg.norm(apart, axis=1).max() / truth[:, 7].max())
