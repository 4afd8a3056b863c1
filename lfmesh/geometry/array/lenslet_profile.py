"""Aspheric lenslet profiles: conics with even terms, of revolution or along a line (cylinders).

The sag is that of ISO 10110-12, with ρ the distance from the lenslet's apex, or from the line of apexes of a cylinder:

    z(ρ) = c ρ² / (1 + sqrt(1 − (1 + k) c² ρ²)) + a₄ ρ⁴ + a₆ ρ⁶ + ...,   ρ² = wₓ x² + w_y y²

Both weights are 1 for a surface of revolution; one of them is 0 for cylinders.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.first_crossing import crossing_finder
from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.bounds import ACROSS, ALONG, SLOPE, profile_extremes

Array = NDArray[np.float64]

WITHIN = 0.002
"""Largest relative excess of the bounds over the largest slope and second derivative."""

BEYOND_CELL = 1.05
"""Extent of a profile over the distance to the cell's corner; cells that rays are aimed at are slightly larger."""

TINY = float(np.finfo(np.float64).tiny)


@by_address
class Profile(NamedTuple):
    """Profiles of an array's lenslet types.

    Attributes
    ----------
    conic : (types,) float64
    terms : (types, n) float64
        Coefficients of ρ⁴, ρ⁶, ... in mm⁻³, mm⁻⁵, ...
    weight_x, weight_y : float
        Weights of x² and y² in ρ²: 1, or 0 along the axis of cylinders.
    domain : float, mm
        Largest ρ used.
    steepest : (types,) float64
        Bound of the slope in the domain.
    bend : (types,) float64, 1/mm
        Bound of the second derivative of the sag, in any direction, in the domain.
    """

    conic: Array
    terms: Array
    weight_x: float
    weight_y: float
    domain: float
    steepest: Array
    bend: Array


def _largest(
    curvature: float, conic: float, terms: Array, radius: float, stretch: tuple[float, float], orders: tuple[int, ...]
) -> float:
    """Return a bound of the magnitude of a type's slope or second derivative.

    Parameters
    ----------
    curvature : float, 1/mm
    conic : float
    terms : (n,) float64
    radius : float, mm
    stretch : (2,) float
        Least and largest factor on the curvature.
    orders : tuple of int
        See `profile_extremes`.
    """
    between = [curvature * each for each in stretch]
    least, most = profile_extremes(between, conic, powers_of(terms), radius, orders, WITHIN)
    return max(-least, most)


def powers_of(terms: Array) -> list[tuple[int, float]]:
    """Return pairs of exponent of ρ and coefficient."""
    return [(4 + 2 * i, float(a)) for i, a in enumerate(terms)]


def profile_of(
    curvature: Array, conic: Array, terms: Array, cylinder_axis: str | None, reach: float, stretch: tuple[float, float]
) -> Profile:
    """Return the profiles of an array's types, with bounds of their slopes and second derivatives.

    Parameters
    ----------
    curvature, conic : (types,) float64
    terms : (types, n) float64
    cylinder_axis : str, optional
        Axis of cylindrical lenslets, "x" or "y".
    reach : float, mm
        Largest distance of a point of a cell from the apex or the line of apexes. The profile must not end inside it.
    stretch : (2,) float
        Least and largest factor on the curvature.
    """
    domain = BEYOND_CELL * reach
    bounds = []
    for c, k in zip(curvature, conic, strict=True):
        steepest = max(abs(c * s) for s in stretch)
        if (1.0 + k) * (steepest * domain) ** 2 >= 1.0:
            # Halfway, in ρ², between the cell's corner and the end of the profile.
            domain = min(domain, float(np.sqrt(0.5 * (reach**2 + 1.0 / ((1.0 + k) * steepest**2)))))
    for c, k, a in zip(curvature, conic, terms, strict=True):
        bounds.append([_largest(c, k, a, domain, stretch, orders) for orders in ((SLOPE,), (ACROSS, ALONG))])
    steepest_, bend_ = np.array(bounds).T
    along_x, along_y = cylinder_axis == "x", cylinder_axis == "y"
    return Profile(
        conic=np.asarray(conic, np.float64), terms=np.asarray(terms, np.float64),
        weight_x=0.0 if along_x else 1.0, weight_y=0.0 if along_y else 1.0, domain=domain,
        steepest=np.ascontiguousarray(steepest_), bend=np.ascontiguousarray(bend_),
    )  # fmt: skip


@kernel
def profile_shape(
    profile: Profile, kind: int, curvature: float, x: float, y: float
) -> tuple[float, float, float]:  # fmt: skip
    """Return the sag of a lenslet at a point from its apex, and its slopes along x and y.

    Parameters
    ----------
    profile : Profile
    kind : int
        Lenslet type.
    curvature : float, 1/mm
    x, y : float, mm
    """
    wx, wy = profile.weight_x * x, profile.weight_y * y
    r2 = wx * x + wy * y
    root = np.sqrt(1.0 - (1.0 + profile.conic[kind]) * curvature * curvature * r2)
    sag, steep, power = curvature * r2 / (1.0 + root), curvature / root, r2
    for i in range(profile.terms.shape[1]):
        a = profile.terms[kind, i]
        steep += (2.0 * i + 4.0) * a * power
        power *= r2
        sag += a * power
    return sag, steep * wx, steep * wy


@inlined
def is_steeper(profile: Profile, kind: int, dx: float, dy: float, dz: float) -> bool:
    """Tell whether a direction is steeper than a type's whole face, so that it crosses a face only once.

    Parameters
    ----------
    profile : Profile
    kind : int
        Lenslet type.
    dx, dy, dz : float
        Of any length.
    """
    across2 = profile.weight_x * dx * dx + profile.weight_y * dy * dy
    return dz * dz > profile.steepest[kind] * profile.steepest[kind] * across2


@kernel
def _shape(of: Any, x: float, y: float) -> tuple[float, float, float]:
    """Call `profile_shape` with a tuple of profile, type and curvature."""
    return profile_shape(of[0], of[1], of[2], x, y)


_first_crossing = crossing_finder(_shape)


@kernel
def first_crossing(
    profile: Profile, kind: int, curvature: float, ray: Ray, side: float, begin: float, end: float
) -> tuple[bool, float]:
    """Return whether a ray crosses a lenslet's face, and the first distance; see `crossing_finder`.

    Parameters
    ----------
    profile, kind, curvature
        See `profile_shape`.
    ray : Ray
        From the apex; the length of its direction is the unit of distances.
    side : float
        1 for a ray in the air in front of the face, −1 in the glass behind it.
    begin, end : float
        Distances between which the ray is in the cell.
    """
    across2 = profile.weight_x * ray.dx * ray.dx + profile.weight_y * ray.dy * ray.dy
    return _first_crossing((profile, kind, curvature), ray, side, profile.bend[kind] * across2, begin, end)


@kernel
def next_fall(
    profile: Profile, kind: int, curvature: float, ax: float, ay: float, gx: float, gy: float,
    side: float, begin: float, end: float,
) -> tuple[bool, float, float]:  # fmt: skip
    """Find the next crossing of the line (a + g z, z) with a lenslet's face into the glass, with increasing z.

    Parameters
    ----------
    profile, kind, curvature
        See `profile_shape`.
    ax, ay : float, mm
        From the apex.
    gx, gy : float
    side : float
        1 if the line begins in front of the face, −1 behind it, 0 if unknown.
    begin, end : float, mm
        Range of z.

    Returns
    -------
    crosses : bool
    z : float, mm
    turned : float
        1 − g · ∇sag there, which is positive.
    """
    begin, end = within_domain(profile, ax, ay, gx, gy, begin, end)
    if not begin <= end:
        return False, 0.0, 0.0
    if side == 0.0:
        sag, _, _ = profile_shape(profile, kind, curvature, ax + begin * gx, ay + begin * gy)
        side = 1.0 if sag >= begin else -1.0
    if side < 0.0:
        rises, begin = first_crossing(profile, kind, curvature, Ray(ax, ay, 0.0, gx, gy, 1.0), -1.0, begin, end)
        if not rises:
            return False, 0.0, 0.0
    falls, z = first_crossing(profile, kind, curvature, Ray(ax, ay, 0.0, gx, gy, 1.0), 1.0, begin, end)
    if not falls:
        return False, 0.0, 0.0
    _, sx, sy = profile_shape(profile, kind, curvature, ax + z * gx, ay + z * gy)
    return True, z, max(1.0 - gx * sx - gy * sy, TINY)


@inlined
def within_domain(
    profile: Profile, ax: float, ay: float, gx: float, gy: float, begin: float, end: float
) -> tuple[float, float]:
    """Clip a piece of the line (a + g z, z) to the profile's domain; an empty result has begin > end.

    Parameters
    ----------
    profile : Profile
    ax, ay : float, mm
        From the apex.
    gx, gy : float
    begin, end : float, mm
        Range of z.
    """
    g2 = profile.weight_x * gx * gx + profile.weight_y * gy * gy
    ag = profile.weight_x * ax * gx + profile.weight_y * ay * gy
    beyond2 = profile.weight_x * ax * ax + profile.weight_y * ay * ay - profile.domain * profile.domain
    if g2 == 0.0:
        return (begin, end) if beyond2 <= 0.0 else (0.0, -1.0)
    root2 = ag * ag - g2 * beyond2
    if root2 < 0.0:
        return 0.0, -1.0
    root = np.sqrt(root2)
    return max(begin, (-ag - root) / g2), min(end, (root - ag) / g2)


@kernel
def fill_shapes(profile: Profile, kind: int, curvature: float, points: Array, z: Array, normals: Array) -> None:
    """Write the sag of a lenslet and its unit normals towards +z at points from its apex.

    Parameters
    ----------
    profile, kind, curvature
        See `profile_shape`.
    points : (n, 2) float64, mm
    z : (n,) float64, mm
    normals : (n, 3) float64
    """
    for i in range(len(points)):
        sag, gx, gy = profile_shape(profile, kind, curvature, points[i, 0], points[i, 1])
        scale = 1.0 / np.sqrt(1.0 + gx * gx + gy * gy)
        z[i] = sag
        normals[i, 0], normals[i, 1], normals[i, 2] = -gx * scale, -gy * scale, scale
