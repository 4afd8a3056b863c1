"""Finer meshes of lens surfaces in narrow gaps, so that the meshes of neighbours do not cross.

Rings of equal width would have to be as fine everywhere as in the narrowest part of the gap, such as the edge of an air
gap. Here, circles are close together and have many points only there.
"""

from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Array, Index, Mesh
from lfmesh.geometry.surfaces.sag import reach
from lfmesh.geometry.surfaces.surface import is_revolved
from lfmesh.geometry.surfaces.tessellation import (
    ALL_ROUND,
    FLOAT32_MARGIN,
    MAX_RINGS,
    disk_mesh,
    height_above,
    mesh_heights,
    mesh_sag,
    on_circles,
    rim_radius,
    ring_radii,
    stand_together,
    steepness,
)

SHARE = 0.125
"""Fraction of a gap by which each surface's mesh may deviate along the meridian, and as much again along circles; both
meshes together stay below half of the gap."""

MOST_PARTS = 8
"""Largest number of parts into which an interval is divided at once."""


class Circles(NamedTuple):
    """Circles through the vertices of a surface's mesh, from the centre to the rim: radii in mm, and points on each."""

    radii: Array
    counts: Index

    @property
    def even(self) -> bool:
        """True if they are the circles of rings of equal width."""
        return np.array_equal(self.counts, [1, *range(6, 6 * len(self.counts), 6)])


def circles_of(surfaces: NDArray[np.void], rings: int) -> list[Circles]:
    """Return the circles of all surfaces, such that neighbouring meshes do not cross.

    All rims have the same number of points. If no gap is narrow, `tessellation.cap` has the same circles.

    Parameters
    ----------
    surfaces : (K,) SURFACE
    rings : int
        Rings of triangles of a mesh without a near neighbour.
    """
    points = 6 * rings
    while True:
        rims = [rim_radius(s, points // 6) for s in surfaces]
        found = [_circles(surfaces[k], rings, rims[k], _allowed(surfaces, rims, k)) for k in range(len(surfaces))]
        needed = max((int(each.counts[-1]) for each in found), default=points)
        if needed <= points:
            break
        # With more points, the chords of a smaller rim stay outside the clear aperture.
        points = needed
    return [Circles(each.radii, np.append(each.counts[:-1], points)) for each in found]


def cap_on(surface: Any, circles: Circles) -> Mesh:
    """Return the mesh of a SURFACE record with vertices on given circles; `tessellation.cap` chooses its own."""
    counts = circles.counts.tolist()
    azimuth = np.concatenate([2 * np.pi * np.arange(n) / n for n in counts])
    return disk_mesh(surface, np.repeat(circles.radii, counts), azimuth, _between_circles(tuple(counts)))


@cache
def _between_circles(counts: tuple[int, ...]) -> Index:
    """Return the faces (f, 3), facing +z, between neighbouring circles with given counts; the first is the centre."""
    first = np.concatenate([[0], np.cumsum(counts)])
    return np.concatenate(
        [_strip(int(first[i]), counts[i], int(first[i + 1]), counts[i + 1]) for i in range(len(counts) - 1)]
    )


def _strip(inner: int, inner_count: int, outer: int, outer_count: int) -> Index:
    """Return the faces between two circles, given by their first vertex and number of vertices.

    The edges of both circles are ordered by the azimuth of their middles. The third corner of each edge's face is the
    vertex on the other circle that the preceding edges end at.
    """
    edges_in, edges_out = np.arange(inner_count if inner_count > 1 else 0), np.arange(outer_count)
    middles = np.concatenate([(edges_in + 0.5) * outer_count, (edges_out + 0.5) * max(inner_count, 1)])
    order = np.argsort(middles, kind="stable")
    of_inner = order < len(edges_in)
    passed_in: Index = np.cumsum(of_inner) - of_inner
    passed_out: Index = np.arange(len(order)) - passed_in
    a, b = inner + passed_in % inner_count, inner + (passed_in + 1) % inner_count
    c, d = outer + passed_out % outer_count, outer + (passed_out + 1) % outer_count
    faces = np.where(of_inner[:, None], np.stack([b, a, c], axis=1), np.stack([c, d, a], axis=1))
    return faces.astype(np.int64)


def _allowed(surfaces: NDArray[np.void], rims: list[float], k: int) -> Callable[[Array], Array]:
    """Return a function of radii (n,) that gives the deviation allowed to the mesh of surface k, either way, mm."""

    def allowed(r: Array) -> Array:
        gap = np.full(len(r), np.inf)
        for other in (k - 1, k + 1):
            if 0 <= other < len(surfaces):
                near = _gap(surfaces[k], surfaces[other], r, 1.0 if other > k else -1.0, rims[other])
                gap = np.minimum(gap, near)
        return np.asarray(SHARE * np.maximum(gap, 0.0))

    return allowed


def _gap(one: Any, other: Any, r: Array, sense: float, rim: float) -> Array:
    """Return the gap along z from one surface, at given radii, to another; inf beyond the other's rim, mm.

    It is sampled, and sets only how fine the meshes are; `surface_gaps` and `edges` prove that surfaces do not cross.

    Parameters
    ----------
    one, other : SURFACE record
    r : (n,) float64, mm
    sense : float
        1: the other is behind the first, −1: in front of it.
    rim : float, mm
        Radius of the other's rim.
    """
    if stand_together(one, other) and is_revolved(one) and is_revolved(other):
        away = other["vertex_z"] + mesh_sag(other, r) - one["vertex_z"] - mesh_sag(one, r)
        return np.where(r <= rim * (1.0 + FLOAT32_MARGIN), sense * away, np.inf)
    height, aside = height_above(other, on_circles(one, r))
    return np.asarray(np.where(aside <= rim, -sense * height, np.inf).min(axis=1))


def _circles(surface: Any, rings: int, rim: float, allowed: Callable[[Array], Array]) -> Circles:
    """Return the circles of one surface: `rings` equal rings, with more where less deviation is allowed."""
    own = ring_radii(surface, rings, rim)
    radii, counts = [0.0], [1]
    for i in range(rings):
        added = _divided(surface, float(own[i]), float(own[i + 1]), allowed, rim / MAX_RINGS)
        radii += added
        counts += [6 * (i + 1)] * len(added)
    r = np.array(radii)
    least = allowed(r)
    least = np.minimum(least, np.minimum(np.append(least[1:], np.inf), np.append(np.inf, least[:-1])))
    # A chord lies inside its circle by r (1 − cos(π/n)), which the slope turns into a deviation along z.
    depth = steepness(surface, np.minimum(r, 0.999 * reach(surface))) * r
    with np.errstate(divide="ignore", invalid="ignore"):
        needed = np.pi / np.arccos(np.clip(1.0 - least / depth, -1.0, 1.0))
        if not is_revolved(surface):
            # Along the circle the surface rises and falls too; the error of a chord grows with its length squared.
            needed = np.maximum(needed, np.pi * np.sqrt(0.5 * _waviness(surface, r) / least))
    needed = np.where(depth > 0.0, np.minimum(6 * np.ceil(needed / 6), 6 * MAX_RINGS), 0)
    return Circles(r, np.maximum(counts, needed.astype(np.int64)))


def _waviness(surface: Any, r: Array) -> Array:
    """Return the largest second derivative of z by azimuth, mm, on circles of radii (n,).

    It is sampled, like `_gap`.
    """
    z = mesh_heights(surface, np.multiply.outer(r, np.cos(ALL_ROUND)), np.multiply.outer(r, np.sin(ALL_ROUND)))
    return np.asarray(np.abs(np.diff(z, 2, axis=1)).max(axis=1) / ALL_ROUND[1] ** 2)


def _divided(surface: Any, low: float, high: float, allowed: Callable[[Array], Array], finest: float) -> list[float]:
    """Divide the meridian between two radii until its chords deviate no more than allowed; return the radii, mm.

    The first radius is left out.

    Parameters
    ----------
    surface : SURFACE record
    low, high : float, mm
    allowed : function of (n,) radii
    finest : float, mm
        Width that is not divided further.
    """
    at = np.array([low, 0.5 * (low + high), high])
    limit = allowed(at)
    phi = (np.zeros(1) if is_revolved(surface) else ALL_ROUND)[:, None]
    z = mesh_heights(surface, np.cos(phi) * at, np.sin(phi) * at)
    deviation = float(np.abs(z[:, 1] - 0.5 * (z[:, 0] + z[:, 2])).max())
    if high - low <= finest or deviation <= limit.min():
        return [high]
    wish = np.sqrt(deviation / limit[1]) if limit[1] > 0.0 else np.inf
    parts = int(np.ceil(min(max(wish, 2.0), MOST_PARTS, (high - low) / finest)))
    ends = np.linspace(low, high, max(parts, 2) + 1).tolist()
    return [r for a, b in pairwise(ends) for r in _divided(surface, a, b, allowed, finest)]
