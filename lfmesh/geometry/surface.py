"""Exact surfaces of revolution: plane, conic, even asphere. Sag, normal and where a ray meets them.

A surface is one record of `SURFACE`; its coordinates have the origin at the vertex and z along the axis, so a table
of them (one a refracting surface) is what the kernels read. The sag is

    z(r) = c r² / (1 + sqrt(1 − (1 + k) c² r²)) + a₄ r⁴ + a₆ r⁶ + ...

with curvature c = 1 / radius and conic constant k (ISO 10110-12).
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.geometry import frame
from lfmesh.kernel import inlined, kernel
from lfmesh.scene.qcon import MOST_ASPHERE_TERMS

MAX_ASPHERE_TERMS = MOST_ASPHERE_TERMS

SURFACE = np.dtype(
    [
        ("curvature", "f8"),
        ("conic", "f8"),
        ("asphere", "f8", (MAX_ASPHERE_TERMS,)),
        ("terms", "i8"),
        ("vertex_z", "f8"),
        ("aperture", "f8"),  # semi-diameter of the clear aperture
        ("end", "f8"),  # radius at which it touches a neighbour, and ends
        ("stop", "i8"),  # 1: outside the aperture is the stop, 0: the mount
        ("level", "i8"),  # what a facet of its mesh stands for; the tracer says what the number means
        ("posed", "i8"),  # 1: it stands off its place in the prescription
        ("pose", "f8", (3, 4)),  # from the lens as prescribed, where the vertex is (0, 0, vertex_z), to where it stands
        ("unpose", "f8", (3, 4)),  # the inverse
    ]
)

NEWTON_STEPS = 80
"""At worst half of them halve the bracket, which float64 allows some 60 times; Newton's method takes three."""

OVERSTEP = 1.125
"""First step of the search for a bracket, over Newton's: so much further that it often holds the root already."""

STEEP = 0.5
"""Rate of approach below which the first step is stretched no further: where the ray turns away it tells nothing."""

DOUBLINGS = 44

SETTLED = 4e-16
"""Newton step, over the size of the coordinates, after which float64 has no more digits."""


def surface(
    radius_mm: float,
    conic: float = 0.0,
    asphere_mm: ArrayLike = (),
    *,
    vertex_z: float = 0.0,
    aperture: float = np.inf,
    stop: bool = False,
) -> np.void:
    """Return one `SURFACE` record.

    Parameters
    ----------
    radius_mm : float
        inf: flat.
    conic : float
    asphere_mm : (terms,) float64
        Coefficients of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ...
    vertex_z : float, mm
    aperture : float, mm
        Radius of the clear aperture.
    stop : bool
        Whether its aperture is the stop.
    """
    record = np.zeros(1, SURFACE)[0]
    record["curvature"] = 0.0 if np.isinf(radius_mm) else 1.0 / radius_mm
    record["conic"] = conic
    coefficients = np.trim_zeros(np.asarray(asphere_mm, dtype=np.float64), "b")
    record["terms"] = len(coefficients)
    record["asphere"][: len(coefficients)] = coefficients
    record["vertex_z"] = vertex_z
    record["aperture"] = aperture
    record["end"] = np.inf
    record["stop"] = stop
    record["pose"] = record["unpose"] = frame.IDENTITY
    return record


def put_in_pose(record: Any, pose: frame.Frame) -> None:
    """Let a `SURFACE` record stand off its place, by a rigid motion (3, 4) of the lens as prescribed."""
    record["posed"] = not np.array_equal(pose, frame.IDENTITY)
    record["pose"], record["unpose"] = pose, frame.inverse(pose)


def in_place(record: Any, points: ArrayLike) -> NDArray[np.float64]:
    """Return points (n, 3) of the camera frame as the surface sees them where the prescription has it.

    Parameters
    ----------
    record : SURFACE record
    points : (n, 3) float64, mm
    """
    p = np.asarray(points, dtype=np.float64)
    return frame.points(record["unpose"], p) if record["posed"] else p


def sag(surface: Any, r: ArrayLike) -> NDArray[np.float64]:
    """Return the sag in mm at the radii `r` (any shape, mm); NaN where the surface does not reach."""
    r2 = np.square(np.asarray(r, dtype=np.float64))
    c, k = surface["curvature"], surface["conic"]
    with np.errstate(invalid="ignore"):
        z = c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + k) * c * c * r2))
    power = r2
    for a in surface["asphere"][: surface["terms"]]:
        power = power * r2
        z = z + a * power
    return z


def slope(surface: Any, r: ArrayLike) -> NDArray[np.float64]:
    """Return dz/dr at the radii `r`."""
    r = np.asarray(r, dtype=np.float64)
    r2 = r * r
    c, k = surface["curvature"], surface["conic"]
    with np.errstate(invalid="ignore", divide="ignore"):
        result = c * r / np.sqrt(1.0 - (1.0 + k) * c * c * r2)
    power = r
    for term, a in enumerate(surface["asphere"][: surface["terms"]]):
        power = power * r2
        result = result + (2 * term + 4) * a * power
    return result


def normals(surface: Any, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Return (n, 3) unit normals, towards +z, at the points (x, y) of the surface.

    Parameters
    ----------
    surface : SURFACE record
    x, y : (n,) float64, mm
    """
    x, y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    r = np.hypot(x, y)
    tilt = slope(surface, r)
    radial = np.divide(tilt, r, out=np.zeros_like(r), where=r > 0)
    n = np.stack([-radial * x, -radial * y, np.ones_like(x)], axis=-1)
    return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


def reach(surface: Any) -> float:
    """Return the largest radius at which the surface exists, mm; inf when it has no rim of its own."""
    c, k = surface["curvature"], surface["conic"]
    own = float(1.0 / (abs(c) * np.sqrt(1.0 + k))) if c != 0.0 and k > -1.0 else np.inf
    return min(own, float(surface["end"]))


@kernel
def sag_at(s: Any, r2: float) -> float:
    """Return the sag at squared radius r² (scalar; NaN where the surface does not reach)."""
    c = s.curvature
    z = c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + s.conic) * c * c * r2))
    power = r2
    for i in range(s.terms):
        power *= r2
        z += s.asphere[i] * power
    return z


@kernel
def half_slope_at(s: Any, r2: float) -> float:
    """Return dz/d(r²), which the axis does not trouble: the gradient of the sag is twice this times (x, y)."""
    c = s.curvature
    slope = 0.5 * c / np.sqrt(1.0 - (1.0 + s.conic) * c * c * r2)
    power = r2
    for i in range(s.terms):
        slope += (i + 2) * s.asphere[i] * power
        power *= r2
    return slope


@inlined
def normal_at(s: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal, towards +z on the sheet of the vertex, at a point of the surface.

    Parameters
    ----------
    s : SURFACE record
    x, y, z : float, mm
        From the vertex.
    """
    if s.terms == 0:
        c = s.curvature
        nx, ny, nz = -c * x, -c * y, 1.0 - c * (1.0 + s.conic) * z
        if s.conic == 0.0:
            # A sphere's is of unit length as it stands, to the rounding of the point.
            return nx, ny, nz
    else:
        g = 2.0 * half_slope_at(s, x * x + y * y)
        nx, ny, nz = -g * x, -g * y, 1.0
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@inlined
def conic_distance(
    c: float, k: float, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[bool, float]:
    """Return whether, and at which distance t along the ray, it crosses a conic in a given sense.

    Of the quadratic's two roots, one crosses along the normal (towards +z on the vertex's sheet), the other against
    it, and a caller that knows the medium it is in knows which it wants. The caller starts from a point close to the
    surface (where the ray crosses the facet that Embree found), so t is a small correction, of either sign, and its
    rounding error is that of the facet's size, not of the ray's length.

    Parameters
    ----------
    sense : float
        1 to cross along the normal, −1 against it.
    """
    q = 1.0 + k
    a = c * (dx * dx + dy * dy + q * dz * dz)
    b = c * (x * dx + y * dy + q * z * dz) - dz
    g = c * (x * x + y * y + q * z * z) - 2.0 * z
    root = b * b - a * g
    if not root >= 0.0:
        return False, 0.0
    # Normal · direction is sense · sqrt(root) at t = (−b − sense √) / a = g / (−b + sense √): take the form in which
    # nothing cancels.
    signed = np.copysign(np.sqrt(root), sense)
    above, below = g, signed - b
    if signed * b > 0.0:
        above, below = -b - signed, a
    if below == 0.0:
        return False, 0.0
    return True, above / below


@inlined
def distance_to(
    s: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[bool, float]:
    """Return whether and where a ray that starts close to a surface crosses it; see `conic_distance`.

    Parameters
    ----------
    s : SURFACE record
    x, y, z : float, mm
        From the vertex.
    dx, dy, dz : float
        Unit.
    sense : float
        1 to cross along the normal, −1 against it.
    """
    meets, t = conic_distance(s.curvature, s.conic, x, y, z, dx, dy, dz, sense)
    if s.terms > 0:
        meets, t = _asphere_distance(s, x, y, z, dx, dy, dz, sense, t)
    return meets, t


@kernel
def _height(s: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float, t: float) -> float:
    """Return how far the ray's point at t stands above the surface, along z."""
    px, py = x + t * dx, y + t * dy
    return z + t * dz - sag_at(s, px * px + py * py)


@kernel
def _rate(s: Any, x: float, y: float, dx: float, dy: float, dz: float, t: float) -> float:
    """Return the derivative of `_height` by t."""
    px, py = x + t * dx, y + t * dy
    return dz - 2.0 * half_slope_at(s, px * px + py * py) * (px * dx + py * dy)


@kernel
def _asphere_distance(
    s: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float, of_conic: float
) -> tuple[bool, float]:
    """Return the crossing next to the ray's start, in a given sense: bracketed, then by Newton's method.

    A ray may cross an asphere more than twice, and its conic part may lie far from it. On which side of the surface
    the start lies tells which way the crossing does: one that is still in front of the surface goes on, one that has
    passed it goes back.
    """
    low = 0.0
    here = _height(s, x, y, z, dx, dy, dz, low)
    if not abs(here) < np.inf:
        # A facet's edge reaches beyond the end of its surface.
        low = of_conic
        here = _height(s, x, y, z, dx, dy, dz, low)
    if here == 0.0:
        return True, low
    ahead = -1.0 if sense * here > 0.0 else 1.0
    rate = sense * _rate(s, x, y, dx, dy, dz, low)
    step = OVERSTEP * abs(here) / max(rate, STEEP)
    for _ in range(DOUBLINGS):
        high = low + ahead * step
        there = _height(s, x, y, z, dx, dy, dz, high)
        if here * there <= 0.0:
            return _newton(s, x, y, z, dx, dy, dz, low, high, here)
        if abs(there) < np.inf:
            low, step = high, 2.0 * step
        else:
            # Past the surface's end.
            step *= 0.5
    return False, 0.0


@kernel
def _newton(
    s: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float, low: float, high: float, at_low: float
) -> tuple[bool, float]:
    """Return the root of the height between low and high: by Newton's method, by bisection where that leaves them."""
    scale = abs(x) + abs(y) + abs(z)
    t = high
    for _ in range(NEWTON_STEPS):
        height = _height(s, x, y, z, dx, dy, dz, t)
        if height * at_low > 0.0:
            low = t
        else:
            high = t
        following = t - height / _rate(s, x, y, dx, dy, dz, t)
        if not min(low, high) <= following <= max(low, high):
            following = 0.5 * (low + high)
        settled = abs(following - t) <= SETTLED * (scale + abs(t))
        t = following
        if settled:
            break
    return True, t
