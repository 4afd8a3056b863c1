"""Intersection of rays with facets and their curved patches, in float64, and the start of the next Embree query."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.levels import FLAT
from lfmesh.geometry.meshes.patch import hit_patch
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.packets.packet import FALLBACKS, Flow

Array = NDArray[np.float64]


FLOAT32_GRAIN = 2.0**-22
"""Rounding error of a float32 query, relative to its coordinates; an origin must be this far past a facet."""


EDGE = 2.0**-36
"""Tolerance, in barycentric weights, within which a float64 crossing counts as inside the facet."""


@inlined
def clear_of(facet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    """Return the distance, mm, that takes a ray from near a facet safely past the facet's plane.

    Parameters
    ----------
    facet : FACET
    x, y, z : float, mm
    dx, dy, dz : float
        The ray.
    """
    normal = facet.normal
    return safely_behind(normal[0], normal[1], normal[2], facet.offset, facet.size, Ray(x, y, z, dx, dy, dz))


@inlined
def safely_behind(nx: float, ny: float, nz: float, offset: float, size: float, ray: Ray) -> float:
    """Return the result of `clear_of` for a facet given by its normal, plane offset and size.

    It exceeds the plane's distance by the rounding error of a float32 query, but not the facet's size. If a ray along
    the facet then meets its own facet, the hit is refused and the ray queried again.

    Parameters
    ----------
    nx, ny, nz : float
        Unit normal of the facet.
    offset, size : float, mm
        Offset of the plane along the normal; size of the facet.
    ray : Ray
    """
    x, y, z, dx, dy, dz = ray
    along = nx * dx + ny * dy + nz * dz
    above = nx * x + ny * y + nz * z - offset
    short = -above if along > 0.0 else above
    beyond = (short if short > 0.0 else 0.0) + FLOAT32_GRAIN * (abs(x) + abs(y) + abs(z) + size)
    far = beyond / abs(along)
    return far if far < size else size


@kernel
def next_query_from(facet: Any, packet: Any, t: float) -> float:
    """Return the start distance, mm, of the next query after a refused facet; the step doubles at each try.

    Parameters
    ----------
    facet : FACET
    packet : PACKET
    t : float, mm
        Distance of the facet.
    """
    normal = facet.normal
    along = abs(normal[0] * packet.dx + normal[1] * packet.dy + normal[2] * packet.dz)
    grain = FLOAT32_GRAIN * (abs(packet.x) + abs(packet.y) + abs(packet.z) + abs(t) + facet.size)
    step = min(grain / along, facet.size) if along > 0.0 else facet.size
    return max(packet.query_from, t) + step * 2.0 ** abs(packet.tries)


@kernel
def crosses(facet: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> tuple[float, float]:
    """Return the distance of a ray's crossing of a facet, in float64, and normal · direction; inf, 0 for a miss.

    An edge belongs to both of its facets, with tolerance `EDGE`, so no ray slips between them.

    Parameters
    ----------
    facet : FACET
    x, y, z : float, mm
    dx, dy, dz : float
        The ray.
    """
    normal = facet.normal
    along = normal[0] * dx + normal[1] * dy + normal[2] * dz
    if along == 0.0:
        return np.inf, 0.0
    t = (facet.offset - normal[0] * x - normal[1] * y - normal[2] * z) / along
    b, c = barycentric(facet, x + t * dx, y + t * dy, z + t * dz)
    if not (b >= -EDGE and c >= -EDGE and b + c <= 1.0 + EDGE):
        return np.inf, 0.0
    return t, along


@kernel
def facet_normal(level: int, facet: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal for refraction at a point of a facet: the facet's own (flat) or interpolated (smooth).

    Parameters
    ----------
    level : int
        Surface level.
    facet : FACET
    x, y, z : float, mm
    """
    normal = facet.normal
    if level == FLAT:
        return normal[0], normal[1], normal[2]
    at = facet.corner_normals
    v, w = barycentric(facet, x, y, z)
    u = 1.0 - v - w
    nx = u * at[0, 0] + v * at[1, 0] + w * at[2, 0]
    ny = u * at[0, 1] + v * at[1, 1] + w * at[2, 1]
    nz = u * at[0, 2] + v * at[1, 2] + w * at[2, 2]
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@kernel
def meets_patch(
    flow: Flow, patches: Array, across: NDArray[np.int64], facet: Any, prim: int, ray: Ray
) -> tuple[bool, float, float, float, float]:
    """Return whether a ray meets the curved patch of a facet, the distance, and the normal there.

    After a miss, or a hit in the wrong sense (on the other side of a thin slice cut off a ball), the result is the
    facet's own plane, counted as a fallback.

    Parameters
    ----------
    patches : (m, 6, 3) float64
    across : (m, 3) int64
        Neighbours of each patch.
    facet : FACET
    prim : int
        Number of the facet.
    ray : Ray
        Starts at the crossing with the facet; distances count from here.
    """
    x, y, z, dx, dy, dz = ray
    b, c = barycentric(facet, x, y, z)
    met, t, nx, ny, nz = hit_patch(patches, across, prim, b, c, ray)
    normal = facet.normal
    through_facet = normal[0] * dx + normal[1] * dy + normal[2] * dz
    if met and (nx * dx + ny * dy + nz * dz) * through_facet > 0.0:
        return True, t, nx, ny, nz
    flow.counts[FALLBACKS] += 1
    return False, 0.0, normal[0], normal[1], normal[2]


@kernel
def barycentric(facet: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the barycentric weights of the second and third corner at a point of a facet's plane.

    Parameters
    ----------
    facet : FACET
    x, y, z : float, mm
    """
    corners = facet.corners
    ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
    e1x, e1y, e1z = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    e2x, e2y, e2z = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    a = e1x * e1x + e1y * e1y + e1z * e1z
    b = e1x * e2x + e1y * e2y + e1z * e2z
    c = e2x * e2x + e2y * e2y + e2z * e2z
    p = px * e1x + py * e1y + pz * e1z
    q = px * e2x + py * e2y + pz * e2z
    determinant = a * c - b * b
    return (c * p - b * q) / determinant, (a * q - b * p) / determinant


@inlined
def nearest_on_facet(facet: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Project a point onto a facet near it, clamped to the facet.

    Parameters
    ----------
    facet : FACET
    x, y, z : float, mm
    """
    b, c = barycentric(facet, x, y, z)
    b, c = max(b, 0.0), max(c, 0.0)
    whole = max(b + c, 1.0)
    b, c = b / whole, c / whole
    at, a = facet.corners, 1.0 - b - c
    return (
        a * at[0, 0] + b * at[1, 0] + c * at[2, 0],
        a * at[0, 1] + b * at[1, 1] + c * at[2, 1],
        a * at[0, 2] + b * at[1, 2] + c * at[2, 2],
    )
