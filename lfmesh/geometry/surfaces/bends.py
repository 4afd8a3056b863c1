"""Bounds of the heights of exact surfaces, and of their second derivatives in all directions.

The second derivatives set the steps of rays that must not miss a crossing.
"""

from collections.abc import Callable
from functools import partial
from itertools import product
from typing import Any

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.surfaces.sag import sag
from lfmesh.geometry.surfaces.surface import BICONIC, TOROID, is_revolved
from lfmesh.geometry.surfaces.tessellation import AZIMUTHS, last_radius
from lfmesh.optics.bounds import (
    ACROSS,
    ALONG,
    SAG,
    SLOPE,
    Array,
    Range,
    extremes,
    plus,
    profile_extremes,
    profile_range,
    scaled,
    times,
)
from lfmesh.optics.section_bounds import BiconicParts, biconic_parts, toroid_height, toroid_seconds
from lfmesh.optics.zones import Zone, kinks, zone_range, zones_range

Line = tuple[tuple[float, float], tuple[float, float]]
"""Two opposite corners of a row of cells."""

WITHIN, WITHIN_BOTH = 0.005, 0.02
"""Largest relative excess of a bound over the extreme: on a meridian, and in x and y."""

HEIGHT_WITHIN = 1e-4
"""The same for the heights of a surface."""

BEFORE_END = 1e-5
"""Fraction of its radius by which a surface's domain stays inside its end, where second derivatives are unbounded."""


def set_bends(surface: Any, rim: float) -> None:
    """Enter bounds of the second derivatives in a SURFACE record, out to the rim of its mesh, mm."""
    domain = _domain(surface, rim)
    if not domain < np.inf:
        return
    surface["domain"] = domain
    surface["least_bend"], surface["most_bend"] = _bends(surface, domain)


def _domain(surface: Any, rim: float) -> float:
    """Return the radius inside which the second derivatives of a surface are bounded, mm."""
    return min(rim, last_radius(surface) * (1.0 - BEFORE_END))


def with_bends(surface: Any, radius: float) -> Any:
    """Return a SURFACE record with bounds of its second derivatives inside a radius, mm, unless it is of revolution."""
    if is_revolved(surface) or surface["domain"] == _domain(surface, radius):
        return surface
    bent = surface.copy()
    set_bends(bent, radius)
    return bent


def bends_between(surface: Any, low: Array, high: Array) -> Range:
    """Return bounds (n,) of the least and the largest second derivative of z, in any direction, between radii, 1/mm.

    On a surface of revolution they lie along the meridian or across it. Other surfaces have one bound for their whole
    domain, see `with_bends`.

    Parameters
    ----------
    surface : SURFACE record
    low, high : (n,) float64, mm
        Inside the surface's reach.
    """
    if not is_revolved(surface):
        return np.full(len(low), float(surface["least_bend"])), np.full(len(low), float(surface["most_bend"]))
    across, along = (range_on_circles(surface, low, high, order) for order in (ACROSS, ALONG))
    return np.minimum(across[0], along[0]), np.maximum(across[1], along[1])


def powers_of(surface: Any) -> list[tuple[int, float]]:
    """Return exponents and coefficients of a profile's terms."""
    even = enumerate(surface["asphere"][: surface["terms"]])
    odd = enumerate(surface["odd"][: surface["odd_terms"]])
    return [(4 + 2 * n, float(a)) for n, a in even] + [(3 + 2 * n, float(a)) for n, a in odd]


def zones_of(surface: Any) -> tuple[Zone, ...]:
    """Return the inner and the outer zone of a surface that has two; else nothing."""
    border = float(surface["border"])
    if not border > 0.0:
        return ()
    outer = enumerate(surface["outer_asphere"][: surface["outer_terms"]])
    return (
        Zone(0.0, border, 0.0, float(surface["curvature"]), float(surface["conic"]), powers_of(surface)),
        Zone(
            border, np.inf, float(surface["outer_offset"]), float(surface["outer_curvature"]),
            float(surface["outer_conic"]), [(4 + 2 * n, float(a)) for n, a in outer],
        ),
    )  # fmt: skip


def kink_of(surface: Any, radius: float) -> float:
    """Return the largest jump of a surface's slope inside a radius, mm, in magnitude; 0 without zones."""
    jumps = [max(-least, most) for border, (least, most) in kinks(zones_of(surface)) if border < radius]
    return max(jumps, default=0.0)


def range_on_circles(surface: Any, low: Array, high: Array, order: int) -> Range:
    """Return the range of a profile's sag, or of a derivative, between radii.

    Parameters
    ----------
    surface : SURFACE record
    low, high : (n,) float64, mm
    order : int
        See `profile_range`.
    """
    if zones := zones_of(surface):
        return zones_range(zones, (low, high), order)
    curvature = np.full_like(low, surface["curvature"])
    return profile_range((curvature,) * 2, float(surface["conic"]), powers_of(surface), (low, high), order)


def height_range(surface: Any, rim: float) -> tuple[float, float]:
    """Return bounds of the heights of a surface over its vertex, out to the rim of its mesh, mm."""
    radius = min(rim, last_radius(surface))
    if is_revolved(surface):
        return _of_revolution(surface, radius, (SAG,), HEIGHT_WITHIN)
    # Outward from the axis a biconic is monotonic along each meridian, and a toroid along each line y = const.
    return _extremes_on(*_height_cells(surface, radius))


def rim_range(surface: Any, rim: float) -> tuple[float, float]:
    """Return bounds of the heights of a surface's rim over its vertex, mm.

    Parameters
    ----------
    surface : SURFACE record
    rim : float, mm
        Radius of the circle about the axis; if beyond the end of the surface, the heights are the end's.
    """
    radius = min(rim, last_radius(surface))
    if is_revolved(surface):
        return (float(sag(surface, radius)),) * 2
    if surface["kind"] not in (BICONIC, TOROID):
        # Bounds of all heights inside hold for the rim, too.
        return height_range(surface, rim)
    ranges_in, (circle, _) = _height_cells(surface, radius)
    return _extremes_on(ranges_in, [circle])


def rim_hull(surface: Any, rim: float) -> Array:
    """Return points (n, 3) in the camera frame, mm, with a convex hull that contains the rim of a posed surface.

    They are a polygon around the circle, at the rim's least and largest height. Along any direction, and from any axis,
    the points reach at least as far as the rim.

    Parameters
    ----------
    surface : SURFACE record
    rim : float, mm
        See `rim_range`.
    """
    turn = 2.0 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS
    around = rim / np.cos(np.pi / AZIMUTHS) * np.column_stack([np.cos(turn), np.sin(turn)])
    levels = [float(surface["vertex_z"]) + height for height in rim_range(surface, rim)]
    points = np.concatenate([np.column_stack([around, np.full(AZIMUTHS, z)]) for z in levels])
    return frame.points(surface["pose"], points) if surface["posed"] else points


def box_of(surface: Any, rim: float) -> Array:
    """Return corners (n, 3) of a box around a surface out to the rim of its mesh, camera frame, mm.

    The outermost point of a posed surface need not be a vertex of its mesh.
    """
    if surface["posed"] and is_revolved(surface):
        turn, shift = surface["pose"][:, :3], surface["pose"][:, 3] + surface["vertex_z"] * surface["pose"][:, 2]
        reaches = [_reach_along(surface, rim, float(np.hypot(row[0], row[1])), float(row[2])) for row in turn]
        return np.asarray(shift + np.transpose(reaches))
    z = [surface["vertex_z"] + height for height in height_range(surface, rim)]
    return frame.points(surface["pose"], list(product((-rim, rim), (-rim, rim), z)))


def _reach_along(surface: Any, rim: float, aside: float, along: float) -> tuple[float, float]:
    """Return bounds of the extent of a surface of revolution from its vertex, against a direction and along it, mm.

    On a circle of radius r at height z they are along z ∓ aside r.

    Parameters
    ----------
    surface : SURFACE record
    rim : float, mm
    aside, along : float
        Components of the unit direction perpendicular to the axis and along it.
    """

    def ranges_in(low: Array, high: Array) -> Range:
        inner, outer = low[:, 0], high[:, 0]
        return plus(scaled(along, range_on_circles(surface, inner, outer, SAG)), (-aside * outer, aside * outer))

    return extremes(ranges_in, [0.0], [min(rim, last_radius(surface))], HEIGHT_WITHIN)


def _bends(surface: Any, domain: float) -> tuple[float, float]:
    """Return bounds of the least and the largest second derivative of a surface within a radius (mm), 1/mm."""
    if is_revolved(surface):
        return _of_revolution(surface, domain, (ACROSS, ALONG), WITHIN)
    if surface["kind"] == BICONIC:
        return extremes(lambda *cells: _biconic_bends(surface, *cells), [0.0, 0.0], [domain**2, 1.0], WITHIN_BOTH)
    if surface["kind"] == TOROID:
        return extremes(lambda *cells: _toroid_bends(surface, domain, *cells), [0.0, 0.0], [domain, 1.0], WITHIN_BOTH)
    raise _without_bounds(surface)


def _without_bounds(surface: Any) -> NotImplementedError:
    return NotImplementedError(f"geometry/surfaces/bends.py has no bounds of surfaces of kind {int(surface['kind'])}")


def _of_revolution(surface: Any, radius: float, orders: tuple[int, ...], within: float) -> tuple[float, float]:
    if zones := zones_of(surface):
        return _of_zones(zones, radius, orders, within)
    curvature, conic = float(surface["curvature"]), float(surface["conic"])
    return profile_extremes((curvature, curvature), conic, powers_of(surface), radius, orders, within)


def _of_zones(
    zones: tuple[Zone, ...], radius: float, orders: tuple[int, ...], within: float
) -> tuple[float, float]:  # fmt: skip
    """Return bounds of quantities of a profile in zones inside a radius, mm.

    A second derivative does not exist on a border. There the jump of the slope over the border's radius counts: it
    shows that the surface is not convex or not concave, and `first_crossing` takes each zone by itself.
    """
    found = []
    for zone in zones:
        if zone.inner < radius:

            def ranges_in(low: Array, high: Array, zone: Zone = zone) -> Range:
                parts = [zone_range(zone, (low[:, 0], high[:, 0]), order) for order in orders]
                return np.min([part[0] for part in parts], axis=0), np.max([part[1] for part in parts], axis=0)

            found.append(extremes(ranges_in, [zone.inner], [min(zone.outer, radius)], within))
    if ALONG in orders:
        found += [(least / at, most / at) for at, (least, most) in kinks(zones) if at < radius]
    return min(least for least, _ in found), max(most for _, most in found)


def _height_cells(surface: Any, radius: float) -> tuple[Callable[[Array, Array], Range], list[Line]]:
    """Return a function that bounds heights in cells, and the two lines of cells that contain the extreme heights.

    The first is the circle of the given radius, mm.
    """
    if surface["kind"] == BICONIC:
        return partial(_biconic_heights, surface), [((radius**2, 0.0), (radius**2, 1.0)), ((0.0, 0.0), (0.0, 0.0))]
    if surface["kind"] == TOROID:
        return partial(_toroid_heights, surface, radius), [((0.0, 1.0), (radius, 1.0)), ((0.0, 0.0), (radius, 0.0))]
    raise _without_bounds(surface)


def _extremes_on(ranges_in: Callable[[Array, Array], Range], lines: list[Line]) -> tuple[float, float]:
    least, most = zip(*(extremes(ranges_in, low, high, HEIGHT_WITHIN) for low, high in lines), strict=True)
    return min(least), max(most)


def _mixed(low: Array, high: Array, of_x: float, of_y: float) -> Range:
    """Return the range of a x² + b y² in cells of a biconic; it is linear in each coordinate of a cell."""
    ends = [of_x * at + of_y * (1.0 - at) for at in (low[:, 1], high[:, 1])]
    return times((low[:, 0], high[:, 0]), (np.minimum(*ends), np.maximum(*ends)))


def _biconic_parts(surface: Any, low: Array, high: Array) -> BiconicParts:
    """Return the parts of a biconic in cells; see `_biconic_bends`."""
    bulge = _mixed(low, high, float(surface["curvature_x"]), float(surface["curvature"]))
    return biconic_parts(bulge, _mixed(low, high, *_squares(surface)))


def _squares(surface: Any) -> tuple[float, float]:
    """Return (1 + k) c² of a biconic in x and in y."""
    in_x = (1.0 + float(surface["conic_x"])) * float(surface["curvature_x"]) ** 2
    return in_x, (1.0 + float(surface["conic"])) * float(surface["curvature"]) ** 2


def _biconic_heights(surface: Any, low: Array, high: Array) -> Range:
    """Return bounds of the height of a biconic in cells; see `_biconic_bends`."""
    return plus(_biconic_parts(surface, low, high).height)


def _biconic_bends(surface: Any, low: Array, high: Array) -> Range:
    """Return bounds of the second derivatives of a biconic in cells.

    With w² = 1 − a x² − b y², s = 1 / (1 + w) and q = c_x x² + c_y y² it is z = q s. As dw = −(a x, b y) / w:

        z_xx = 2 c_x s + a (4 c_x x² + q) s²/w + a² x² q h,   h = s² (2 s + 1/w) / w²
        z_xy = x y (2 (c_x b + c_y a) s²/w + a b q h)

    and z_yy by analogy. w², q and the like are linear in each coordinate of a cell. With g = (c_x x, c_y y) and
    v = (a x, b y) the matrix is D + 2 (g vᵀ + v gᵀ) s²/w + q h v vᵀ, D diagonal. For q > 0 the last two terms are
    at least −4 g gᵀ (s²/w)² / (q h), with g² < q max(c_x, c_y).

    Parameters
    ----------
    surface : SURFACE record
    low, high : (n, 2) float64
        x² + y², and the fraction of x² in it.
    """
    cx, cy = float(surface["curvature_x"]), float(surface["curvature"])
    a, b = _squares(surface)
    r2, share = (low[:, 0], high[:, 0]), (low[:, 1], high[:, 1])
    beside = 1.0 - share[1], 1.0 - share[0]
    parts = _biconic_parts(surface, low, high)
    q, w, s, first, _ = parts
    xx, yy = (
        parts.second(c, e, times(r2, part), bent)
        for c, e, bent, part in (
            (cx, a, _mixed(low, high, 5.0 * cx, cy), share),
            (cy, b, _mixed(low, high, cx, 5.0 * cy), beside),
        )
    )
    product = times((np.zeros_like(low[:, 0]), r2[1] * np.sqrt(share[1] * beside[1])),
                    parts.mixed((cx, cy), (a, b)))  # fmt: skip
    least, most = _in_all_directions(xx, yy, np.maximum(-product[0], product[1]))
    if cx * cy <= 0.0:
        return least, most
    # If the curvatures have one sign, the matrix less a square stays bounded towards the end.
    beyond = 4.0 * max(abs(cx), abs(cy)) * w[1] / ((1.0 + w[0]) * (1.0 + 3.0 * w[0]))
    in_x, in_y = (plus(scaled(2.0 * c, s), scaled(e, times(q, first))) for c, e in ((cx, a), (cy, b)))
    if cx > 0.0:
        return np.maximum(least, np.minimum(in_x[0], in_y[0]) - beyond), most
    return least, np.minimum(most, np.maximum(in_x[1], in_y[1]) + beyond)


def _toroid_roots(surface: Any, domain: float, low: Array, high: Array) -> tuple[Range, Range, Range]:
    """Return the ranges of x², u and v in cells of a toroid; see `_toroid_bends`.

    On the rim v² depends on y alone. It is bounded by its derivative, because its terms nearly cancel close to the end
    of a torus that is a sphere.

    Parameters
    ----------
    surface, domain, low, high
        See `_toroid_bends`.
    """
    cx, y, share = float(surface["curvature_x"]), (low[:, 0], high[:, 0]), (low[:, 1], high[:, 1])
    f, by_y = (range_on_circles(surface, *y, order) for order in (SAG, SLOPE))
    middle = 0.5 * (y[0] + y[1])
    rests = (scaled(-cx, sag) for sag in (f, range_on_circles(surface, middle, middle, SAG)))
    u, at_middle = ((np.maximum(1.0 + low, 0.0), np.maximum(1.0 + high, 0.0)) for low, high in rests)
    rate = plus(scaled(cx, y), scaled(-1.0, times(u, by_y)))
    off = abs(cx) * (y[1] - y[0]) * np.maximum(-rate[0], rate[1])
    beside = cx * cx * (domain - middle) * (domain + middle)
    # v² on the rim is at most u², its value in the plane x = 0.
    most_at_rim = np.clip(at_middle[1] ** 2 - beside + off, 0.0, u[1] ** 2)
    least_at_rim = np.clip(at_middle[0] ** 2 - beside - off, 0.0, most_at_rim)
    v = (
        np.sqrt((1.0 - share[1]) * np.maximum(u[0] ** 2, least_at_rim) + share[1] * least_at_rim),
        np.sqrt((1.0 - share[0]) * u[1] ** 2 + share[0] * most_at_rim),
    )
    x2 = share[0] * (domain - y[1]) * (domain + y[1]), share[1] * (domain - y[0]) * (domain + y[0])
    return x2, u, v


def _toroid_heights(surface: Any, domain: float, low: Array, high: Array) -> Range:
    """Return bounds of the height of a toroid in cells, f + c_x x² / (u + v); see `_toroid_bends`."""
    x2, u, v = _toroid_roots(surface, domain, low, high)
    f = range_on_circles(surface, low[:, 0], high[:, 0], SAG)
    return toroid_height(float(surface["curvature_x"]), f, x2, u, v)


def _toroid_bends(surface: Any, domain: float, low: Array, high: Array) -> Range:
    """Return bounds of the second derivatives of a toroid in cells.

    With its curve f(y), u = 1 − c_x f and v² = u² − c_x² x² it is z = (1 − v) / c_x, with the second derivatives

        (c_x / v) n nᵀ + (u/v) f″ e eᵀ,   n = (u/v, f′ c_x x/v),   e = (0, 1)

    Parameters
    ----------
    surface : SURFACE record
    domain : float, mm
    low, high : (n, 2) float64
        y, and x² over its largest value in the domain.
    """
    cx, y = float(surface["curvature_x"]), (low[:, 0], high[:, 0])
    by_y, bend = (range_on_circles(surface, *y, order) for order in (SLOPE, ALONG))
    x2, u, v = _toroid_roots(surface, domain, low, high)
    with np.errstate(divide="ignore"):
        over = 1.0 / v[1], 1.0 / v[0]
    along, across = times(u, over), times(scaled(cx * cx, x2), over, over)
    steep = np.maximum(-by_y[0], by_y[1]) ** 2 * across[1]
    steep2 = np.where(by_y[0] * by_y[1] > 0.0, np.minimum(by_y[0] ** 2, by_y[1] ** 2) * across[0], 0.0), steep
    xx, turned, bent = toroid_seconds(cx, along, over, steep2, bend)
    least, most = _in_all_directions(xx, plus(bent, turned), abs(cx) * over[1] * along[1] * np.sqrt(steep))
    # The sum of both parts' extremes gives the sign while cells are still wide.
    whole = plus(xx, turned)
    return (
        np.maximum(least, np.minimum(whole[0], 0.0) + np.minimum(bent[0], 0.0)),
        np.minimum(most, np.maximum(whole[1], 0.0) + np.maximum(bent[1], 0.0)),
    )


def _in_all_directions(xx: Range, yy: Range, xy: Array) -> Range:
    """Return bounds of the eigenvalues of symmetric matrices, which grow with the diagonal.

    Parameters
    ----------
    xx, yy : Range
    xy : (n,) float64
        Largest magnitude of the off-diagonal element.
    """
    with np.errstate(invalid="ignore"):
        low, high = (
            0.5 * (along + across) + sense * np.hypot(0.5 * (along - across), xy)
            for along, across, sense in zip(xx, yy, (-1.0, 1.0), strict=True)
        )
    return np.where(np.isnan(low), -np.inf, low), np.where(np.isnan(high), np.inf, high)
