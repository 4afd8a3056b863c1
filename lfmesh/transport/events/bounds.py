"""Bounds of media: entry and exit distances of rays, for a medium or a cell of its grid."""

from typing import Any

import numpy as np

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.geometry.meshes.shell_tree import next_crossing
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.tables.volumes import BOX, CYLINDER, IN_FRONT, SHELL


@inlined
def own_ray(row: Any, ray: Ray) -> Ray:
    """Transform a ray from the object frame, or that of the medium's mover, into a medium's own frame.

    Parameters
    ----------
    row : VOLUME
    ray : Ray
    """
    x, y, z = point_through(row.to_own, ray.x, ray.y, ray.z)
    dx, dy, dz = direction_through(row.to_own, ray.dx, ray.dy, ray.dz)
    return Ray(x, y, z, dx, dy, dz)


@inlined
def slab(low: float, high: float, o: float, d: float) -> tuple[float, float]:
    """Return a ray's entry and exit distances for the slab between two coordinate planes.

    Parameters
    ----------
    low, high : float
        Coordinates of the planes.
    o, d : float
        The ray's start and direction along the coordinate.
    """
    if d == 0.0:
        return (-np.inf, np.inf) if low <= o <= high else (np.inf, -np.inf)
    a, b = (low - o) / d, (high - o) / d
    return (a, b) if a <= b else (b, a)


@kernel
def span(shells: Any, row: Any, ray: Ray, t: float) -> tuple[float, float, float]:
    """Return the entry and exit distances of a ray, in a medium's own frame, as seen from distance t.

    Parameters
    ----------
    shells : ShellTree or None
        None if no mesh bounds a medium; numba then compiles nothing for it.
    row : VOLUME
    ray : Ray
    t : float, mm

    Returns
    -------
    first, last : float, mm
        The first is larger if the ray misses the medium.
    holds : float, mm
        Where the result ceases to hold, beyond t: at the next crossing of a mesh, else inf.
    """
    holds = np.inf
    if shells is not None:
        inside = True
        if row.bounds == SHELL:
            inside, holds = next_crossing(shells, row.nodes[0], row.nodes[1], t, ray)
        if not inside:
            return np.inf, -np.inf, holds
    first, last = _span(row, ray)
    return first, last, holds


@kernel
def _span(row: Any, ray: Ray) -> tuple[float, float]:
    """Return the entry and exit distances of a ray for a medium's grid and bounds, except meshes."""
    x, y, z, dx, dy, dz = ray
    first, last = -np.inf, np.inf
    if row.bounds == IN_FRONT:
        return slab(-np.inf, 0.0, z, dz) if dz != 0.0 or z < 0.0 else (np.inf, -np.inf)
    if row.bounds == BOX:
        for axis in range(3):
            o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
            a, b = slab(-row.size[axis], row.size[axis], o, d)
            first, last = max(first, a), min(last, b)
    elif row.bounds != SHELL:
        cut = 0.0 if row.bounds == CYLINDER else 1.0
        a = dx * dx + dy * dy + cut * dz * dz
        middle = -(x * dx + y * dy + cut * z * dz)
        radius2 = row.size[0] * row.size[0]
        if a > 0.0:
            # The discriminant by the distance of the ray from the axis: far starts lose no digits.
            s = middle / a
            px, py, pz = x + s * dx, y + s * dy, cut * (z + s * dz)
            rest = radius2 - (px * px + py * py + pz * pz)
            if rest <= 0.0:
                return np.inf, -np.inf
            half = np.sqrt(rest / a)
            first, last = s - half, s + half
        elif x * x + y * y > radius2:
            return np.inf, -np.inf
        if row.bounds == CYLINDER:
            c, d = slab(-row.size[2], row.size[2], z, dz)
            first, last = max(first, c), min(last, d)
    if row.cells[0] > 0:
        for axis in range(3):
            o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
            a, b = slab(row.low[axis], row.high[axis], o, d)
            first, last = max(first, a), min(last, b)
    return first, last


@kernel
def cell_end(row: Any, t: float, ray: Ray) -> float:
    """Return a ray's exit distance, beyond t, from the current cell of a medium's grid.

    The corners of a trilinear cell are the centres of eight voxels.

    Parameters
    ----------
    row : VOLUME
    t : float, mm
    ray : Ray
    """
    x, y, z, dx, dy, dz = ray
    shift = 0.5 if row.constant else 0.0
    nearest = np.inf
    for axis in range(3):
        o, d = (x, y, z)[axis], (dx, dy, dz)[axis]
        if d == 0.0:
            continue
        o, d = (o - row.origin[axis]) / row.spacing[axis] + shift, d / row.spacing[axis]
        plane = np.floor(o + t * d) + (1.0 if d > 0.0 else 0.0)
        ends = (plane - o) / d
        if ends <= t:
            # The ray is on this plane, to rounding, or has just passed it.
            plane += 1.0 if d > 0.0 else -1.0
            ends = (plane - o) / d
        if ends > t:
            nearest = min(nearest, ends)
    return nearest
