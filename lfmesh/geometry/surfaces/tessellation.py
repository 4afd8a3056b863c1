"""Meshes of exact surfaces: caps, rings that close the space between two caps, solids.

All caps of a lens have the same number of triangle rings, so that a ring joins neighbouring rims without a gap.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh, facet_normals, joined
from lfmesh.geometry.surfaces.sag import gradients, heights, normals, reach, sag, slope
from lfmesh.geometry.surfaces.surface import in_place, is_revolved

OVERREACH = 0.02
"""Relative extent of a mesh beyond its clear aperture; the aperture itself is tested in float64."""

FLOAT32_MARGIN = 2.0**-20
"""A few float32 roundings, relative."""

MAX_RINGS = 120

AZIMUTHS = 96
"""Points on a circle of a surface at which the gap to a tilted neighbour is measured."""

ALL_ROUND = np.linspace(0.0, 2.0 * np.pi, 97)
"""Sampling azimuths for the mesh of a surface that is not of revolution; every eighth of a turn is one.

They set the mesh density only. Proofs use the bounds of `bends`.
"""

QUADRATIC = 4.0 / 3.0
"""Largest deviation of a triangle from a quadratic surface over that at its edge midpoints; an equilateral one on a
paraboloid reaches it."""

HIGHER_ORDERS = 1.25
"""Factor on that for terms beyond the quadratic within a facet."""


@cache
def disk_pattern(rings: int) -> tuple[Index, Array, Index]:
    """Return the topology of a disk: ring (v,) and azimuth (v,) rad of each vertex, and faces (f, 3) facing +z.

    Ring i has 6 i vertices, so that triangles are nearly equilateral: 6 rings² faces in all.
    """
    ring = np.repeat(np.arange(rings + 1), [1, *(6 * i for i in range(1, rings + 1))])
    azimuth = np.concatenate([[0.0], *(2 * np.pi * np.arange(6 * i) / (6 * i) for i in range(1, rings + 1))])
    first = np.concatenate([[0], 1 + 3 * np.arange(rings) * (np.arange(rings) + 1)])
    faces = []
    for i in range(1, rings + 1):
        inner, outer = max(6 * (i - 1), 1), 6 * i
        for sector in range(6):
            for step in range(i):
                a = first[i] + (sector * i + step) % outer
                b = first[i] + (sector * i + step + 1) % outer
                c = first[i - 1] + (sector * (i - 1) + step) % inner
                faces.append((a, b, c))
                if step < i - 1:
                    faces.append((b, first[i - 1] + (sector * (i - 1) + step + 1) % inner, c))
    return ring.astype(np.int64), azimuth, np.array(faces, dtype=np.int64)


def last_radius(surface: Any) -> float:
    """Return the largest radius with a finite sag."""
    return reach(surface) * (1.0 - 4.0 * np.finfo(np.float64).eps)


def rim_radius(surface: Any, rings: int, overreach: float = OVERREACH) -> float:
    """Return the radius of the mesh's rim; its edges, chords of that circle, stay outside the clear aperture.

    If the surface ends earlier, they stay outside its end instead, by more than the rounding of a float32 query.

    Parameters
    ----------
    surface : SURFACE record
    rings : int
        Rings of triangles.
    overreach : float
        Relative extent of the mesh beyond the aperture.
    """
    inner = min(surface["semi_diameter"] * (1.0 + overreach), last_radius(surface) * (1.0 + FLOAT32_MARGIN))
    return float(inner / np.cos(np.pi / (6 * rings)))


def mesh_sag(surface: Any, r: ArrayLike) -> Array:
    """Return the sag of a mesh at radii `r`: beyond the surface's end, that of its end."""
    return sag(surface, np.minimum(r, last_radius(surface)))


def mesh_heights(surface: Any, x: ArrayLike, y: ArrayLike, most: float = np.inf) -> Array:
    """Return z of a mesh above the vertex at points (x, y) of one shape: beyond the end, that of the end.

    Parameters
    ----------
    surface : SURFACE record
    x, y : float64, mm
    most : float, mm
        Radius beyond which z is constant.
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    r, most = np.hypot(x, y), min(most, last_radius(surface))
    if is_revolved(surface):
        return sag(surface, np.minimum(r, most))
    inside = np.minimum(1.0, np.divide(most, r, out=np.ones_like(r), where=r > 0.0))
    return heights(surface, inside * x, inside * y)


def steepness(surface: Any, r: ArrayLike) -> Array:
    """Return the largest slope of a surface at radii (n,), mm, over all azimuths."""
    r = np.asarray(r, dtype=np.float64)
    if is_revolved(surface):
        return np.abs(slope(surface, r))
    by_x, by_y = gradients(surface, np.multiply.outer(r, np.cos(ALL_ROUND)), np.multiply.outer(r, np.sin(ALL_ROUND)))
    return np.asarray(np.hypot(by_x, by_y).max(axis=-1))


def ring_radii(surface: Any, rings: int, rim: float) -> Array:
    """Return (rings + 1,) radii equally spaced along the meridian's arc, so that steep rims get their share.

    The one nearest to the border of an outer zone moves there.

    Parameters
    ----------
    surface : SURFACE record
    rings : int
    rim : float, mm
    """
    # Sampled equally in angle over a quarter turn: points crowd at the rim, where a hemisphere's slope diverges.
    fine = min(rim, last_radius(surface)) * np.sin(np.linspace(0.0, 0.5 * np.pi, 2049))
    if is_revolved(surface):
        rise = np.diff(sag(surface, fine))
    else:
        phi = ALL_ROUND[:, None]
        rise = np.abs(np.diff(heights(surface, np.cos(phi) * fine, np.sin(phi) * fine))).max(axis=0)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(fine), rise))])
    radii = np.interp(np.linspace(0.0, arc[-1], rings + 1), arc, fine)
    radii[-1] = rim
    if 0.0 < surface["border"] < rim and rings > 1:
        radii[1 + np.abs(radii[1:-1] - surface["border"]).argmin()] = surface["border"]
    return radii


def cap(surface: Any, rings: int, rim: float) -> Mesh:
    """Return the mesh of a surface out to `rim`, facing +z, in the frame of the lens, with exact corner normals.

    Parameters
    ----------
    surface : SURFACE record
    rings : int
    rim : float, mm
    """
    ring, azimuth, faces = disk_pattern(rings)
    return disk_mesh(surface, ring_radii(surface, rings, rim)[ring], azimuth, faces)


def disk_mesh(surface: Any, r: Array, azimuth: Array, faces: Index) -> Mesh:
    """Return the mesh of a surface with given vertices and faces; see `cap`.

    Parameters
    ----------
    surface : SURFACE record
    r : (v,) float64, mm
    azimuth : (v,) float64, rad
    faces : (f, 3) int64
        Facing +z.
    """
    x, y = r * np.cos(azimuth), r * np.sin(azimuth)
    z = mesh_sag(surface, r) if is_revolved(surface) else mesh_heights(surface, x, y)
    vertices = np.column_stack([x, y, z + surface["vertex_z"]])
    inside = np.minimum(1.0, np.divide(last_radius(surface), r, out=np.ones_like(r), where=r > 0.0))
    return Mesh(vertices, faces, normals(surface, inside * x, inside * y)[faces])


def revolved(profile: Array, azimuths: int) -> Mesh:
    """Return the mesh of a meridional polyline (n, 2) of (r, z) turned about the axis.

    It faces the axis where the polyline runs towards +z. Its azimuths match a cap's rim.
    """
    phi = 2 * np.pi * np.arange(azimuths) / azimuths
    r, z = profile[:, :1], profile[:, 1:]
    vertices = np.stack([r * np.cos(phi), r * np.sin(phi), np.broadcast_to(z, (len(z), azimuths))], axis=-1)
    return strip(vertices)


def strip(circles: Array) -> Mesh:
    """Return the mesh of the strips between neighbouring closed polylines, (lines, points, 3) mm.

    It faces inwards if successive lines advance towards +z and run from x to y.
    """
    lines, count, _ = circles.shape
    here = np.arange(count)
    there = (here + 1) % count
    faces = []
    for k in range(lines - 1):
        low, high = k * count, (k + 1) * count
        faces.append(np.column_stack([low + here, high + here, low + there]))
        faces.append(np.column_stack([low + there, high + here, high + there]))
    mesh = Mesh(circles.reshape(-1, 3), np.concatenate(faces).astype(np.int64))
    # Lines that touch leave facets without area.
    return Mesh(mesh.vertices, mesh.faces[facet_normals(mesh)[1] > 0.0])


def chord_error(surface: Any, rings: int, rim: float) -> float:
    """Return a bound of the distance along z between the surface and its mesh, mm: along meridian and parallel.

    Parameters
    ----------
    surface : SURFACE record
    rings : int
    rim : float, mm
    """
    if not is_revolved(surface):
        return _facet_error(surface, cap(surface, rings, rim))
    r = ring_radii(surface, rings, rim)
    middle = 0.5 * (r[1:] + r[:-1])
    z = mesh_sag(surface, r)
    radial = np.abs(sag(surface, middle) - 0.5 * (z[1:] + z[:-1])).max()
    # A chord of ring i lies inside the circle by r (1 − cos(π/6i)), which the slope turns into sag.
    i = np.arange(1, rings + 1)
    around = (
        np.abs(slope(surface, np.minimum(r[1:], 0.999 * reach(surface)))) * r[1:] * (1 - np.cos(np.pi / (6 * i)))
    ).max()
    return float(radial + around)


def _facet_error(surface: Any, mesh: Mesh) -> float:
    """Return a bound of the distance along z between a surface and its mesh, mm, by the middles of all edges.

    On a quadratic surface, the deviation of a triangle is largest on an edge if the surface is a saddle or the triangle
    obtuse in the metric of its curvature. Otherwise it is at most `QUADRATIC` times larger.
    """
    corners = mesh.vertices[mesh.faces]
    middles = 0.5 * (corners + np.roll(corners, -1, axis=1))
    off = middles[..., 2] - surface["vertex_z"] - mesh_heights(surface, middles[..., 0], middles[..., 1])
    return float(QUADRATIC * HIGHER_ORDERS * np.abs(off).max())


def rings_for(surfaces: NDArray[np.void], least: int, tolerance_mm: float = np.inf) -> int:
    """Return the number of rings that keep every mesh within a sag tolerance.

    Parameters
    ----------
    surfaces : (K,) SURFACE
    least : int
        Rings to begin with.
    tolerance_mm : float
    """
    rings = least
    while rings < MAX_RINGS:
        rims = [rim_radius(s, rings) for s in surfaces]
        errors = [chord_error(s, rings, rim) for s, rim in zip(surfaces, rims, strict=True)]
        if max(errors, default=0.0) <= tolerance_mm:
            break
        rings = max(rings + 1, int(rings * 1.2))
    return min(rings, MAX_RINGS)


def stand_together(front: Any, back: Any) -> bool:
    """Tell whether two surfaces have the same pose, so that their relative position is as prescribed."""
    return np.array_equal(front["pose"], back["pose"])


def on_circles(record: Any, r: Array, azimuths: int = AZIMUTHS) -> Array:
    """Return points (len(r), azimuths, 3) of a surface on circles about its axis, where it stands, mm.

    Parameters
    ----------
    record : SURFACE record
    r : (n,) float64, mm
    azimuths : int
    """
    x, y = _circles(r, azimuths)
    z = np.broadcast_to(record["vertex_z"] + heights_on_circles(record, r, azimuths), x.shape)
    points = np.stack([x, y, z], axis=-1)
    return frame.points(record["pose"], points) if record["posed"] else points


def heights_on_circles(record: Any, r: Array, azimuths: int = AZIMUTHS) -> Array:
    """Return the heights of a surface over its vertex on circles about its axis, (n, azimuths) mm.

    For a surface of revolution, the shape is (n, 1). Poses are ignored.

    Parameters
    ----------
    record : SURFACE record
    r : (n,) float64, mm
    azimuths : int
    """
    if is_revolved(record):
        return np.asarray(mesh_sag(record, r))[:, None]
    return mesh_heights(record, *_circles(r, azimuths))


def _circles(r: Array, azimuths: int) -> tuple[Array, Array]:
    phi = 2 * np.pi * np.arange(azimuths) / azimuths
    return np.multiply.outer(r, np.cos(phi)), np.multiply.outer(r, np.sin(phi))


def height_above(record: Any, points: Array) -> tuple[Array, Array]:
    """Return the heights of points (..., 3), camera frame, above a surface, and their distances from its axis, mm."""
    p = in_place(record, points)
    r = np.hypot(p[..., 0], p[..., 1])
    return p[..., 2] - record["vertex_z"] - mesh_heights(record, p[..., 0], p[..., 1]), r


def element(front: Mesh, ring: Mesh, back: Mesh) -> Mesh:
    """Return the closed solid between two caps (facing +z) and the ring (facing the axis), outward-oriented.

    Parameters
    ----------
    front, back : Mesh
        The caps.
    ring : Mesh
    """
    return joined([front.flipped(), ring.flipped(), back])
