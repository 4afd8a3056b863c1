"""Exact surfaces: plane, conic, asphere, biconic, toroid. Sag, normal and intersection with rays.

A surface is a record of `SURFACE`, with its origin at the vertex and z along the axis. Kernels read a table with one
record per refracting surface. The sag of a surface of revolution is

    z(r) = c r² / (1 + sqrt(1 − (1 + k) c² r²)) + a₄ r⁴ + a₆ r⁶ + ... + b₃ r³ + b₅ r⁵ + ...

with curvature c = 1 / radius and conic constant k (ISO 10110-12). A biconic has a curvature and a conic constant in x
and in y. In a toroid the curve z(y) turns about a line parallel to y, at the radius 1 / c_x behind the vertex. Outside
the border of an outer zone, z(r) has other numbers and an offset, so that it continues without a step.

Beyond the end of a surface other than a conic, `form_at` continues without a step: a root search needs heights
everywhere.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.first_crossing import crossing_finder, crossing_finder_over_zones
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.zones import Zone
from lfmesh.scene.camera.lens import Surface
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS

MAX_ASPHERE_TERMS = MOST_ASPHERE_TERMS

CONIC_AND_EVEN, WITH_ODD, BICONIC, TOROID = range(4)
"""Kinds of surfaces: the first two are surfaces of revolution. WITH_ODD has odd terms or an outer zone."""

Array = NDArray[np.float64]

SURFACE = np.dtype(
    [
        ("curvature", "f8"),
        ("conic", "f8"),
        ("asphere", "f8", (MAX_ASPHERE_TERMS,)),
        ("terms", "i8"),  # number of even powers; at least 1 unless the surface is a conic
        ("kind", "i8"),  # CONIC_AND_EVEN, WITH_ODD, BICONIC or TOROID
        ("odd", "f8", (MAX_ASPHERE_TERMS,)),
        ("odd_terms", "i8"),
        ("curvature_x", "f8"),  # of a biconic or toroid; `curvature` and `conic` are then for y
        ("conic_x", "f8"),
        ("vertex_z", "f8"),
        ("semi_diameter", "f8"),  # of the clear aperture
        ("end", "f8"),  # radius at which it ends: contact with a neighbour, or a toroid turning back
        # Bounds of the second derivatives of z in any direction, up to the radius `domain`: 0 until computed.
        ("least_bend", "f8"),
        ("most_bend", "f8"),
        ("domain", "f8"),
        ("stop", "i8"),  # 1: outside the aperture is the stop, 0: the mount
        ("level", "i8"),  # shape that a facet of its mesh stands for; see `meshes.levels`
        ("posed", "i8"),  # 1: displaced from its place in the prescription
        ("pose", "f8", (3, 4)),  # from the prescription, with the vertex at (0, 0, vertex_z), to the actual place
        ("unpose", "f8", (3, 4)),  # the inverse
        # Outer zone of a surface of the kind WITH_ODD; `curvature` and the like are then of the inner one.
        ("border", "f8"),  # radius at which it begins; 0: none
        ("outer_curvature", "f8"),
        ("outer_conic", "f8"),
        ("outer_asphere", "f8", (MAX_ASPHERE_TERMS,)),
        ("outer_terms", "i8"),
        ("outer_offset", "f8"),
    ]
)

NEWTON_STEPS = 80
"""At worst half of them bisect the bracket, which float64 allows about 60 times; Newton's method takes three."""

OVERSTEP = 1.125
"""First step of the bracket search over Newton's step: just long enough that it often brackets the root."""

STEEP = 0.5
"""Rate of approach below which the first step is not stretched further: it means little for a ray that turns away."""

DOUBLINGS = 44

SETTLED = 4e-16
"""Newton step, over the size of the coordinates, that is rounding in float64."""


def surface(
    radius_mm: float,
    conic: float = 0.0,
    asphere_mm: ArrayLike = (),
    *,
    odd_mm: ArrayLike = (),
    kind: int = CONIC_AND_EVEN,
    radius_x_mm: float = np.inf,
    conic_x: float = 0.0,
    vertex_z: float = 0.0,
    semi_diameter: float = np.inf,
    stop: bool = False,
) -> np.void:
    """Return one `SURFACE` record.

    Parameters
    ----------
    radius_mm : float
        inf: flat.
    conic : float
    asphere_mm : (terms,) float64
        Coefficients of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ...; for a toroid, of y⁴, y⁶, ...
    odd_mm : (odd_terms,) float64
        Coefficients of r³, r⁵, ..., in mm⁻², mm⁻⁴, ...
    kind : int
        BICONIC or TOROID, with `radius_mm` and `conic` for y; other kinds follow from the terms.
    radius_x_mm, conic_x : float
        Radius of a biconic or toroid in x, and conic constant of a biconic.
    vertex_z : float, mm
    semi_diameter : float, mm
        Of the clear aperture.
    stop : bool
        True if its aperture is the stop.
    """
    record = np.zeros(1, SURFACE)[0]
    record["curvature"] = 0.0 if np.isinf(radius_mm) else 1.0 / radius_mm
    record["conic"] = conic
    coefficients = np.trim_zeros(np.asarray(asphere_mm, dtype=np.float64), "b")
    record["asphere"][: len(coefficients)] = coefficients
    odd = np.trim_zeros(np.asarray(odd_mm, dtype=np.float64), "b")
    record["odd"][: len(odd)], record["odd_terms"] = odd, len(odd)
    record["kind"] = kind if kind != CONIC_AND_EVEN or not len(odd) else WITH_ODD
    record["terms"] = max(len(coefficients), 1 if record["kind"] != CONIC_AND_EVEN else 0)
    record["curvature_x"], record["conic_x"] = 0.0 if np.isinf(radius_x_mm) else 1.0 / radius_x_mm, conic_x
    record["vertex_z"] = vertex_z
    record["semi_diameter"] = semi_diameter
    record["end"] = np.inf
    record["stop"] = stop
    record["pose"] = record["unpose"] = frame.IDENTITY
    return record


def surface_of(of: Surface, **where: Any) -> np.void:
    """Return the `SURFACE` record of a surface of a prescription.

    Parameters
    ----------
    of : Surface
    **where
        `vertex_z`, `semi_diameter` and `stop`, see `surface`.
    """
    shape: dict[str, Any] = {}
    if of.biconic is not None:
        shape = {"kind": BICONIC, "radius_x_mm": of.biconic.radius_x_mm, "conic_x": of.biconic.conic_x}
    elif of.toroid is not None:
        shape = {"kind": TOROID, "radius_x_mm": of.toroid.radius_x_mm}
    record = surface(of.vertex_radius_mm, of.vertex_conic, of.terms_mm, odd_mm=of.odd_asphere_mm, **shape, **where)
    if of.toroid is not None:
        record["end"] = of.reach_mm
    if of.outer_zone is not None:
        _put_outer_zone(record, of.outer_zone.zones(of)[1])
    return record


def _put_outer_zone(record: Any, zone: Zone) -> None:
    """Enter the outer zone of a surface of revolution in its record."""
    record["kind"], record["terms"] = WITH_ODD, max(int(record["terms"]), 1)
    record["border"], record["outer_offset"], terms = zone.inner, zone.offset, [a for _, a in zone.powers]
    record["outer_curvature"], record["outer_conic"] = zone.curvature, zone.conic
    record["outer_asphere"][: len(terms)], record["outer_terms"] = terms, len(terms)


def is_revolved(surface: Any) -> bool:
    """Tell whether a `SURFACE` record is a surface of revolution."""
    return int(surface["kind"]) <= WITH_ODD


def put_in_pose(record: Any, pose: frame.Frame) -> None:
    """Displace a `SURFACE` record from the prescription by a rigid motion (3, 4)."""
    record["posed"] = not np.array_equal(pose, frame.IDENTITY)
    record["pose"], record["unpose"] = pose, frame.inverse(pose)


def in_place(record: Any, points: ArrayLike) -> Array:
    """Transform points (n, 3) mm from the camera frame to the nominal frame of a surface."""
    p = np.asarray(points, dtype=np.float64)
    return frame.points(record["unpose"], p) if record["posed"] else p


@kernel
def sag_at(s: Any, r2: float) -> float:
    """Return the sag of a conic with even terms at r² (scalar); NaN where the surface does not reach."""
    c = s.curvature
    z = c * r2 / (1.0 + np.sqrt(1.0 - (1.0 + s.conic) * c * c * r2))
    power = r2
    for i in range(s.terms):
        power *= r2
        z += s.asphere[i] * power
    return z


@kernel
def half_slope_at(s: Any, r2: float) -> float:
    """Return dz/d(r²) of a conic with even terms. Twice this times (x, y) is the gradient, on the axis too."""
    c = s.curvature
    slope = 0.5 * c / np.sqrt(1.0 - (1.0 + s.conic) * c * c * r2)
    power = r2
    for i in range(s.terms):
        slope += (i + 2) * s.asphere[i] * power
        power *= r2
    return slope


@kernel
def form_at(s: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return z, dz/dx and dz/dy of a surface of any kind; beyond its end, of how it goes on.

    Parameters
    ----------
    s : SURFACE record
    x, y : float, mm
    """
    if s.kind == BICONIC:
        return _biconic_at(s.curvature_x, s.conic_x, s.curvature, s.conic, x, y)
    if s.kind == TOROID:
        return _toroid_at(s, x, y)
    outer = 1 if s.border > 0.0 and x * x + y * y > s.border * s.border else 0
    return _zone_at(s, outer, x, y)


@inlined
def _zone_at(s: Any, outer: int, x: float, y: float) -> tuple[float, float, float]:
    """Return z, dz/dx and dz/dy by the formula of a surface's inner (0) or outer (1) zone, inside the zone or not."""
    r2 = x * x + y * y
    if outer > 0:
        z, g = _even_curve(s.outer_curvature, s.outer_conic, s.outer_asphere, s.outer_terms, r2)
        return z + s.outer_offset, g * x, g * y
    z, g = _even_curve(s.curvature, s.conic, s.asphere, s.terms, r2)
    r = np.sqrt(r2)
    for i in range(s.odd_terms):
        g += (2 * i + 3) * s.odd[i] * r
        r *= r2
        z += s.odd[i] * r
    return z, g * x, g * y


@kernel
def _even_curve(c: float, conic: float, asphere: Array, terms: int, r2: float) -> tuple[float, float]:
    """Return z and (dz/dr) / r of a conic and even terms at r²."""
    root2 = 1.0 - (1.0 + conic) * c * c * r2
    root = np.sqrt(root2) if root2 > 0.0 else 0.0
    z, g = c * r2 / (1.0 + root), (c / root if root2 > 0.0 else 2.0 * c)
    power = r2
    for i in range(terms):
        g += (2 * i + 4) * asphere[i] * power
        power *= r2
        z += asphere[i] * power
    return z, g


@kernel
def _biconic_at(cx: float, kx: float, cy: float, ky: float, x: float, y: float) -> tuple[float, float, float]:
    """Return z, dz/dx and dz/dy of a biconic: (cx x² + cy y²) / (1 + √(1 − (1 + kx) cx² x² − (1 + ky) cy² y²))."""
    a, b = (1.0 + kx) * cx * cx, (1.0 + ky) * cy * cy
    q, root2 = cx * x * x + cy * y * y, 1.0 - a * x * x - b * y * y
    if not root2 > 0.0:
        return q, 2.0 * cx * x, 2.0 * cy * y
    root = np.sqrt(root2)
    over = 1.0 / (1.0 + root)
    z = q * over
    more = z * over / root
    return z, x * (2.0 * cx * over + a * more), y * (2.0 * cy * over + b * more)


@kernel
def _toroid_at(s: Any, x: float, y: float) -> tuple[float, float, float]:
    """Return z, dz/dx and dz/dy of a toroid: with the curve f(y), c_x ((z − f)² + 2 f (z − f) + x²) = 2 (z − f)."""
    f, g = _even_curve(s.curvature, s.conic, s.asphere, s.terms, y * y)
    cx = s.curvature_x
    u = 1.0 - cx * f
    root2 = u * u - cx * cx * x * x
    if u > 0.0 and root2 > 0.0:
        root = np.sqrt(root2)
        return f + cx * x * x / (u + root), cx * x / root, g * y * u / root
    slope = np.copysign(1.0, cx * x)
    return f + slope * x, slope, g * y


@kernel
def _gradient_with_terms(s: Any, x: float, y: float) -> tuple[float, float]:
    """Return dz/dx and dz/dy of a surface that is not a conic."""
    if s.kind == CONIC_AND_EVEN:
        g = 2.0 * half_slope_at(s, x * x + y * y)
        return g * x, g * y
    _, gx, gy = form_at(s, x, y)
    return gx, gy


@inlined
def normal_at(s: Any, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the unit normal at a point of the surface, towards +z on the sheet of the vertex.

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
            # For a sphere this has unit length, to the rounding of the point.
            return nx, ny, nz
    else:
        gx, gy = _gradient_with_terms(s, x, y)
        nx, ny, nz = -gx, -gy, 1.0
    scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@inlined
def conic_distance(c: float, k: float, ray: Ray, sense: float) -> tuple[bool, float]:
    """Return whether a ray crosses a conic in a given sense, and the distance t.

    One root of the quadratic crosses along the normal (towards +z on the vertex's sheet), the other against it. The ray
    starts close to the surface, at the facet found by Embree. t is therefore a small correction of either sign, with a
    rounding error of the facet's size, not of the ray's length.

    Parameters
    ----------
    sense : float
        1 to cross along the normal, −1 against it.
    """
    x, y, z, dx, dy, dz = ray
    q = 1.0 + k
    a = c * (dx * dx + dy * dy + q * dz * dz)
    b = c * (x * dx + y * dy + q * z * dz) - dz
    g = c * (x * x + y * y + q * z * z) - 2.0 * z
    root = b * b - a * g
    if not root >= 0.0:
        return False, 0.0
    # Normal · direction is sense · sqrt(root) at t = (−b − sense √) / a = g / (−b + sense √): take the form without
    # cancellation.
    signed = np.copysign(np.sqrt(root), sense)
    above, below = g, signed - b
    if signed * b > 0.0:
        above, below = -b - signed, a
    if below == 0.0:
        return False, 0.0
    return True, above / below


@kernel
def _height(s: Any, ray: Ray, t: float) -> float:
    """Return the height of the ray's point at t above a conic with even terms, along z."""
    x, y, z, dx, dy, dz = ray
    px, py = x + t * dx, y + t * dy
    return z + t * dz - sag_at(s, px * px + py * py)


@kernel
def _rate(s: Any, ray: Ray, t: float) -> float:
    """Return the derivative of `_height` by t."""
    px, py = ray.x + t * ray.dx, ray.y + t * ray.dy
    return ray.dz - 2.0 * half_slope_at(s, px * px + py * py) * (px * ray.dx + py * ray.dy)


@kernel
def _height_by_form(s: Any, ray: Ray, t: float) -> float:
    """Return the height of the ray's point at t above a surface of any kind, along z."""
    x, y, z, dx, dy, dz = ray
    return z + t * dz - form_at(s, x + t * dx, y + t * dy)[0]


@kernel
def _rate_by_form(s: Any, ray: Ray, t: float) -> float:
    """Return the derivative of `_height_by_form` by t."""
    _, gx, gy = form_at(s, ray.x + t * ray.dx, ray.y + t * ray.dy)
    return ray.dz - gx * ray.dx - gy * ray.dy


def _searcher(height_at: Any, rate_at: Any) -> Any:
    """Return the search for a crossing, from the height above a kind of surface and its rate along the ray.

    Each kind has its own kernel: branching on the kind in one kernel would cost an even asphere a sixth of its time.
    """

    @kernel
    def newton(s: Any, ray: Ray, low: float, high: float, at_low: float) -> tuple[bool, float]:
        """Return the root of the height between low and high, by Newton's method with bisection as the fallback."""
        scale = abs(ray.x) + abs(ray.y) + abs(ray.z)
        t = high
        for _ in range(NEWTON_STEPS):
            height = height_at(s, ray, t)
            if height * at_low > 0.0:
                low = t
            else:
                high = t
            following = t - height / rate_at(s, ray, t)
            if not min(low, high) <= following <= max(low, high):
                following = 0.5 * (low + high)
            settled = abs(following - t) <= SETTLED * (scale + abs(t))
            t = following
            if settled:
                break
        return True, t

    @kernel
    def search(s: Any, ray: Ray, sense: float, of_conic: float) -> tuple[bool, float]:
        """Return the crossing nearest to the ray's start, in a given sense: bracketed, then by Newton's method.

        A ray may cross such a surface more than twice, and its conic part may lie far from it. The start's side of the
        surface gives the direction of the search: forwards if still in front of the surface, backwards if past it.
        """
        low = 0.0
        here = height_at(s, ray, low)
        if not abs(here) < np.inf:
            # The edge of a facet extends beyond the end of its surface.
            low = of_conic
            here = height_at(s, ray, low)
        if here == 0.0:
            return True, low
        ahead = -1.0 if sense * here > 0.0 else 1.0
        rate = sense * rate_at(s, ray, low)
        step = OVERSTEP * abs(here) / max(rate, STEEP)
        for _ in range(DOUBLINGS):
            high = low + ahead * step
            there = height_at(s, ray, high)
            if here * there <= 0.0:
                return newton(s, ray, low, high, here)
            if abs(there) < np.inf:
                low, step = high, 2.0 * step
            else:
                # Past the surface's end.
                step *= 0.5
        return False, 0.0

    return search


_first_crossing = crossing_finder(form_at)
_first_over_zones = crossing_finder_over_zones(_zone_at)


@kernel
def first_crossing(s: Any, ray: Ray, sense: float, begin: float, end: float, in_front: bool) -> tuple[bool, float]:
    """Return whether a ray crosses a surface inside its `domain`, and the first distance, even at grazing incidence.

    Parameters
    ----------
    s : SURFACE record
        With its bends, see `bends.set_bends`.
    ray : Ray
        From the vertex.
    sense : float
        1 to cross along the normal, −1 against it.
    begin, end : float, mm
        Range of the search.
    in_front : bool
        The ray begins in front of the surface or, to rounding, on it. From there it crosses the surface only if it
        enters.
    """
    x, y, z, dx, dy, dz = ray
    a, b, c = dx * dx + dy * dy, x * dx + y * dy, x * x + y * y - s.domain * s.domain
    if a > 0.0:
        root = b * b - a * c
        if not root >= 0.0:
            return False, 0.0
        begin, end = max(begin, (-b - np.sqrt(root)) / a), min(end, (np.sqrt(root) - b) / a)
    elif c > 0.0:
        return False, 0.0
    if not begin < end:
        return False, 0.0
    sag, _, _ = form_at(s, x + begin * dx, y + begin * dy)
    if not (in_front or sense * (sag - z - begin * dz) > 0.0):
        # It comes from beside the surface, on the wrong side for this crossing.
        return False, 0.0
    most = a * max(-s.least_bend if sense > 0.0 else s.most_bend, 0.0)
    if s.border > 0.0:
        return _first_over_zones(s, ray, sense, most, begin, end)
    return _first_crossing(s, ray, sense, most, begin, end)


_asphere_distance = _searcher(_height, _rate)
_distance_by_form = _searcher(_height_by_form, _rate_by_form)


@inlined
def distance_to(s: Any, ray: Ray, sense: float) -> tuple[bool, float]:
    """Return whether a ray that starts close to a surface crosses it, and the distance; see `conic_distance`.

    Parameters
    ----------
    s : SURFACE record
    ray : Ray
        From the vertex.
    sense : float
        1 to cross along the normal, −1 against it.
    """
    meets, t = conic_distance(s.curvature, s.conic, ray, sense)
    if s.terms > 0:
        if s.kind == CONIC_AND_EVEN:
            meets, t = _asphere_distance(s, ray, sense, t)
        else:
            meets, t = _distance_by_form(s, ray, sense, t)
    return meets, t
