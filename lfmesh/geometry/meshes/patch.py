"""Curved facets: the quadratic patch through a triangle's corners and normals, and its intersection with a ray.

T. Nagata, "Simple local interpolation of surfaces using normal vectors", Computer Aided Geometric Design 22 (2005)
327-347. Each edge becomes the parabola of least curvature perpendicular to both end normals; the patch is the quadratic
through the three of them,

    x(η, ζ) = c₀₀ + c₁₀ η + c₀₁ ζ + c₁₁ η ζ + c₂₀ η² + c₀₂ ζ²,   0 ≤ ζ ≤ η ≤ 1,

with corners x(0, 0), x(1, 0), x(1, 1). Neighbours share the parabola of their edge, so patches join without a gap.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.meshes.mesh import Index
from lfmesh.geometry.meshes.vertex_normals import edge_partners
from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import kernel
from lfmesh.optics.scattering import tangents

Array = NDArray[np.float64]

NEWTON_STEPS = 12

SETTLED = 1e-8
"""Newton step, in units of the patch, below which the root is as exact as float64 allows."""


def edge_curvature(start: Array, end: Array, start_normal: Array, end_normal: Array) -> Array:
    """Return the second-order coefficient c (n, 3) of the curves x(t) = start + (d − c) t + c t² along edges d.

    If the normals agree, the edge stays straight, whatever its angle to them (Nagata, section 3).

    Parameters
    ----------
    start, end : (n, 3) float64, mm
    start_normal, end_normal : (n, 3) float64
        Unit.
    """
    d = end - start
    mean, half = 0.5 * (start_normal + end_normal), 0.5 * (start_normal - end_normal)
    spread = np.einsum("ij,ij->i", half, half)
    along_mean = np.einsum("ij,ij->i", d, mean)
    along_half = np.einsum("ij,ij->i", d, half)
    turned = spread > np.finfo(np.float64).eps ** 2
    first = np.divide(along_half, 1.0 - spread, out=np.zeros_like(spread), where=turned & (spread < 1.0))
    second = np.divide(along_mean, spread, out=np.zeros_like(spread), where=turned)
    return np.asarray(first[:, None] * mean + second[:, None] * half)


def patches(corners: Array, corner_normals: Array) -> Array:
    """Return the coefficients c₀₀, c₁₀, c₀₁, c₁₁, c₂₀, c₀₂ of every facet, (m, 6, 3) mm.

    Parameters
    ----------
    corners, corner_normals : (m, 3, 3) float64
        Unit normals; facets that differ in the normal at a vertex make a crease.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    na, nb, nc = corner_normals[:, 0], corner_normals[:, 1], corner_normals[:, 2]
    ab, bc, ac = edge_curvature(a, b, na, nb), edge_curvature(b, c, nb, nc), edge_curvature(a, c, na, nc)
    return np.stack([a, b - a - ab, c - b + ab - ac, ac - ab - bc, ab, bc], axis=1)


def patch_points(coefficients: Array, eta: Array, zeta: Array) -> tuple[Array, Array]:
    """Return the points and unit normals (m, q, 3) of all patches at q parameters (η, ζ).

    Parameters
    ----------
    coefficients : (m, 6, 3) float64, mm
    eta, zeta : (q,) or (m, q) float64
        From 0 to 1; common to all patches, or for each patch.
    """
    one = np.ones_like(eta)
    basis = np.stack([one, eta, zeta, eta * zeta, eta * eta, zeta * zeta])
    by_eta = np.stack([0 * one, one, 0 * one, zeta, 2 * eta, 0 * one])
    by_zeta = np.stack([0 * one, 0 * one, one, eta, 0 * one, 2 * zeta])
    places = "kq" if eta.ndim == 1 else "kmq"
    points, along_eta, along_zeta = (
        np.einsum(f"{places},mki->mqi", each, coefficients) for each in (basis, by_eta, by_zeta)
    )
    normal = np.cross(along_eta, along_zeta)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return points, normal / np.where(length > 0.0, length, 1.0)


def neighbours(faces: Index, corner_normals: Array) -> NDArray[np.int64]:
    """Return the facet across the edges ab, bc and ca of each facet, (m, 3); −1 at a rim or a crease.

    Parameters
    ----------
    faces : (m, 3)
        Corners by vertex number; facets that share an edge share both vertices.
    corner_normals : (m, 3, 3)
        If they differ across an edge, it is a crease, with another surface beyond.
    """
    first, second = edge_partners(faces)
    across = np.full(3 * len(faces), -1, np.int64)
    f, e = np.divmod(first, 3)
    g, h = np.divmod(second, 3)
    # The partner runs the other way: its end is this edge's start.
    same = (corner_normals[f, e] == corner_normals[g, (h + 1) % 3]).all(axis=1)
    same &= (corner_normals[f, (e + 1) % 3] == corner_normals[g, h]).all(axis=1)
    across[first[same]], across[second[same]] = g[same], f[same]
    return across.reshape(-1, 3)


@kernel
def patch_point(
    patch: Array, eta: float, zeta: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return a patch's point and its derivatives with respect to η and ζ.

    Parameters
    ----------
    patch : (6, 3) float64, mm
        Coefficients.
    eta, zeta : float
    """
    x = (
        patch[0, 0]
        + eta * (patch[1, 0] + eta * patch[4, 0] + zeta * patch[3, 0])
        + zeta * (patch[2, 0] + zeta * patch[5, 0])
    )
    y = (
        patch[0, 1]
        + eta * (patch[1, 1] + eta * patch[4, 1] + zeta * patch[3, 1])
        + zeta * (patch[2, 1] + zeta * patch[5, 1])
    )
    z = (
        patch[0, 2]
        + eta * (patch[1, 2] + eta * patch[4, 2] + zeta * patch[3, 2])
        + zeta * (patch[2, 2] + zeta * patch[5, 2])
    )
    ax = patch[1, 0] + 2.0 * eta * patch[4, 0] + zeta * patch[3, 0]
    ay = patch[1, 1] + 2.0 * eta * patch[4, 1] + zeta * patch[3, 1]
    az = patch[1, 2] + 2.0 * eta * patch[4, 2] + zeta * patch[3, 2]
    bx = patch[2, 0] + 2.0 * zeta * patch[5, 0] + eta * patch[3, 0]
    by = patch[2, 1] + 2.0 * zeta * patch[5, 1] + eta * patch[3, 1]
    bz = patch[2, 2] + 2.0 * zeta * patch[5, 2] + eta * patch[3, 2]
    return x, y, z, ax, ay, az, bx, by, bz


@kernel
def on_patch(patch: Array, ray: Ray, eta: float, zeta: float) -> tuple[bool, float, float, float]:
    """Intersect a ray with the unbounded patch by Newton's method: return whether it meets it, and t, η, ζ.

    The two equations in η and ζ put the patch's point on two planes through the ray.

    Parameters
    ----------
    patch : (6, 3) float64, mm
        Coefficients.
    ray : Ray
    eta, zeta : float
        Start of the iteration, near the facet.
    """
    x, y, z, dx, dy, dz = ray
    ux, uy, uz, vx, vy, vz = tangents(dx, dy, dz)
    for _ in range(NEWTON_STEPS):
        px, py, pz, ax, ay, az, bx, by, bz = patch_point(patch, eta, zeta)
        px, py, pz = px - x, py - y, pz - z
        f, g = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
        fa, fb = ax * ux + ay * uy + az * uz, bx * ux + by * uy + bz * uz
        ga, gb = ax * vx + ay * vy + az * vz, bx * vx + by * vy + bz * vz
        determinant = fa * gb - fb * ga
        if determinant == 0.0:
            return False, 0.0, eta, zeta
        step_eta, step_zeta = (f * gb - g * fb) / determinant, (g * fa - f * ga) / determinant
        eta -= step_eta
        zeta -= step_zeta
        if not abs(eta) + abs(zeta) < 16.0:
            return False, 0.0, eta, zeta
        # Newton squares its error: after a step this small the next one would be rounding.
        if abs(step_eta) + abs(step_zeta) < SETTLED:
            break
    else:
        return False, 0.0, eta, zeta
    px, py, pz, _, _, _, _, _, _ = patch_point(patch, eta, zeta)
    return True, (px - x) * dx + (py - y) * dy + (pz - z) * dz, eta, zeta


MAX_WALK = 8
"""Most patches that a search passes through before the facet itself is used."""

INSIDE = 1e-9
"""Largest distance of a root outside its patch, in units of the patch, that is rounding and needs no neighbour."""


@kernel
def hit_patch(
    patches: NDArray[np.float64], across: NDArray[np.int64], prim: int, b: float, c: float, ray: Ray
) -> tuple[bool, float, float, float, float]:
    """Intersect a ray with the curved surface near a facet: return whether it meets it, t, and the unit normal.

    A root outside its patch is searched on the neighbour across that edge. At a rim, the patch is continued by up to
    half its size, since a curved rim extends beyond its chord.

    Parameters
    ----------
    patches : (m, 6, 3), across : (m, 3)
        From `patches` and `neighbours`.
    prim : int
        Facet that the ray crosses.
    b, c : float
        Weights of the facet's second and third corner there.
    """
    eta, zeta = b + c, c
    for _ in range(MAX_WALK):
        found, t, eta, zeta = on_patch(patches[prim], ray, eta, zeta)
        if not found:
            return False, 0.0, 0.0, 0.0, 1.0
        edge, outside = 0, -zeta
        if eta - 1.0 > outside:
            edge, outside = 1, eta - 1.0
        if zeta - eta > outside:
            edge, outside = 2, zeta - eta
        following = across[prim, edge]
        if outside <= INSIDE or (following < 0 and outside <= 0.5):
            _, _, _, ax, ay, az, bx, by, bz = patch_point(patches[prim], eta, zeta)
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            return length > 0.0, t, nx / length, ny / length, nz / length
        if following < 0:
            return False, 0.0, 0.0, 0.0, 1.0
        prim, eta, zeta = following, 2.0 / 3.0, 1.0 / 3.0
    return False, 0.0, 0.0, 0.0, 1.0
