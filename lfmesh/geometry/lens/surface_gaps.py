"""Penetration depth of two optical surfaces, and the radius of their contact, by bounds on cells.

The aperture of the first surface is divided into squares. The height over the other surface at the middle of a square,
its gradient and a bound of the second derivatives give the largest possible height in the square. Only squares that may
exceed the largest height found so far are divided further. If surfaces touch, or nearly touch, over an area, too many
squares remain, and only their bounds are proven.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.bends import bends_between, kink_of, with_bends, zones_of
from lfmesh.geometry.surfaces.edges import ROUNDING_OF_COORDINATES
from lfmesh.geometry.surfaces.sag import gradients, reach, sag
from lfmesh.geometry.surfaces.surface import is_revolved
from lfmesh.geometry.surfaces.tessellation import (
    FLOAT32_MARGIN,
    last_radius,
    mesh_heights,
    rim_radius,
    stand_together,
)

FIRST = 9
"""Initial number of squares across an aperture; odd, so that the middle of one is the vertex."""

LEVELS = 20
"""Largest number of halvings."""

MOST_SQUARES = 1 << 13
"""Largest number of squares. Others stay undecided, as when surfaces touch all over."""

CLOSE_ENOUGH = 1.001
"""Ratio of the largest possible height to the height found that ends the search."""

QUARTERS = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
"""Middles of the quarters of a square, in units of half its side."""


def reaches_through(one: Any, other: Any, sense: float, least: float, enough: float = np.inf) -> tuple[float, float]:
    """Return the depth of a surface beyond another, along the other's axis, inside both clear apertures, mm.

    Parameters
    ----------
    one, other : SURFACE record
    sense : float
        1: points of `one` beyond `other`, along its axis; −1: points in front of it.
    least : float, mm
        Depth that is ignored.
    enough : float, mm
        Depth that ends the search.

    Returns
    -------
    found : float
        Largest depth found; 0 if no point deeper than `least` was found.
    possible : float
        Upper bound of the depth; 0 if none can exceed `least`.
    """
    radius, edge = (min(float(s["semi_diameter"]), last_radius(s), reach(s)) for s in (one, other))
    one, other = (with_bends(s, end) for s, end in ((one, radius), (other, edge)))
    side = np.linspace(-1.0, 1.0, 2 * FIRST + 1)[1::2] * radius
    middles, half = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2), radius / FIRST
    deepest = aside = 0.0
    for _ in range(LEVELS):
        height, inside, most = _heights(one, other, sense, middles, half, (radius, edge))
        deepest = max(deepest, float(np.max(height, where=inside, initial=0.0)))
        open_ = most > max(least, CLOSE_ENOUGH * deepest)
        middles, most = middles[open_], most[open_]
        if 4 * len(middles) > MOST_SQUARES:
            # Divide the squares with the largest bounds, which decide the result.
            order = np.argsort(-most)
            aside = max(aside, float(most[order[MOST_SQUARES // 4]]))
            middles, most = middles[order[: MOST_SQUARES // 4]], most[order[: MOST_SQUARES // 4]]
        possible = max(CLOSE_ENOUGH * deepest, aside, float(np.max(most, initial=0.0)))
        if deepest > enough or not np.any(most > aside):
            break
        middles = (middles[:, None] + half * QUARTERS).reshape(-1, 2)
        half *= 0.5
    return deepest if deepest > least else 0.0, possible if possible > least else 0.0


def crossing(front: Any, back: Any, least: float, enough: float = np.inf) -> tuple[float, float]:
    """Return the penetration depth of two neighbouring surfaces and its upper bound, mm.

    Parameters
    ----------
    front, back : SURFACE record
    least, enough : float, mm
        See `reaches_through`.
    """
    found, possible = zip(
        *(reaches_through(*pair, least, enough) for pair in ((front, back, 1.0), (back, front, -1.0))), strict=True
    )
    # A proof along either axis shows that they do not cross.
    return max(found), max(possible) if min(possible) > 0.0 or max(found) > 0.0 else 0.0


def end_where_they_touch(surfaces: NDArray[np.void], rings: int) -> None:
    """Shorten surfaces that touch at or outside their clear apertures to the radius where they touch.

    Meshes, which extend slightly beyond the apertures, would cross there.

    Parameters
    ----------
    surfaces : (K,) SURFACE
    rings : int
        Least number of rings of the meshes.
    """
    for front, back in pairwise(surfaces):
        inner = float(min(front["semi_diameter"], back["semi_diameter"]))
        if not np.isfinite(inner):
            continue
        outer = min(rim_radius(front, rings), rim_radius(back, rings), last_radius(front), last_radius(back))
        on_axis = stand_together(front, back) and is_revolved(front) and is_revolved(back)
        touch = (_first_touch if on_axis else _first_touch_off_axis)(front, back, min(inner, outer), outer)
        for s in (front, back):
            if touch < np.inf and s["semi_diameter"] <= max(inner, touch):
                s["end"] = min(float(s["end"]), max(inner, touch))


def _first_touch(front: Any, back: Any, low: float, high: float) -> float:
    """Return the radius of the first contact of surfaces of revolution, from `low` to `high`, mm; inf if there is none.

    Between two radii at distance h the gap is at least the smaller of the gaps there less m h² / 8, with m a bound of
    its second derivative.
    """
    ends = np.array([low, high])
    at_low, at_high = back["vertex_z"] + sag(back, ends) - front["vertex_z"] - sag(front, ends)
    if not at_low > 0.0:
        return low
    least = ROUNDING_OF_COORDINATES * float(abs(back["vertex_z"]) + abs(front["vertex_z"]) + high)
    of_back, of_front = (bends_between(s, ends[:1], ends[1:]) for s in (back, front))
    bend = max(float(of_back[1][0] - of_front[0][0]), 0.0)
    if at_high > 0.0 and min(at_low, at_high) - 0.125 * bend * (high - low) ** 2 > -least:
        return np.inf
    borders = [float(s["border"]) for s in (front, back) if low < s["border"] < high]
    middle = borders[0] if borders else 0.5 * (low + high)
    if middle in (low, high):
        return low
    found = _first_touch(front, back, low, middle)
    return found if found < np.inf else _first_touch(front, back, middle, high)


def _first_touch_off_axis(front: Any, back: Any, low: float, high: float) -> float:
    """Return the radius from `low` to `high` of the smallest parts of two surfaces that touch, mm; inf if none do.

    Larger parts contain smaller ones, so they touch too and bisection applies. Parts not proven apart count as
    touching.
    """
    least = ROUNDING_OF_COORDINATES * float(abs(back["vertex_z"]) + high)

    def touch(radius: float) -> bool:
        one, other = front.copy(), back.copy()
        one["semi_diameter"] = other["semi_diameter"] = radius
        return crossing(one, other, least, least)[1] > 0.0

    if not touch(high):
        return np.inf
    while high - low > FLOAT32_MARGIN * low:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if touch(middle) else (middle, high)
    return low


def farthest_mm(surface: Any, radius: float) -> float:
    """Return a bound of the distance of a surface from its vertex plane, along its axis, mm.

    Parameters
    ----------
    surface : SURFACE record
    radius : float, mm
        Part of the surface that counts.
    """
    bend = float(_bend(with_bends(surface, radius), np.array([radius]), radius)[0])
    return 0.5 * bend * radius**2 if bend > 0.0 else 0.0


def _heights(
    one: Any, other: Any, sense: float, middles: Array, half: float, ends: tuple[float, float]
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return heights (k,) at the middles of squares, whether they are inside both apertures, and bounds of the heights.

    A middle beyond an aperture is moved to its edge; no point of the square inside is farther from there.

    Parameters
    ----------
    one, other : SURFACE record
    sense : float
    middles : (k, 2) float64, mm
    half : float, mm
        Half the side of the squares.
    ends : tuple of float, mm
        Radii of both apertures.
    """
    extent = half * np.sqrt(2.0)
    beside = np.hypot(*middles.T) - extent > ends[0]
    p = _clipped(middles, ends[0])
    slope = np.stack(gradients(one, *p.T), axis=1)
    bend = _bend(one, np.minimum(np.hypot(*p.T) + extent, ends[0]), extent)
    z = one["vertex_z"] + mesh_heights(one, *p.T)
    q = frame.points(other["unpose"], frame.points(one["pose"], np.column_stack([p, z])))
    turn = other["unpose"][:, :3] @ one["pose"][:, :3]
    # Tangents of the first surface along x and y, and their rates, in the frame of the other.
    along = turn[:, :2] + np.multiply.outer(slope, turn[:, 2]).transpose(0, 2, 1)
    wide = np.sqrt(1.0 + (np.hypot(*slope.T) + bend * extent) ** 2) * extent
    inside = np.hypot(q[:, 0], q[:, 1]) <= ends[1]
    beside |= np.hypot(q[:, 0], q[:, 1]) - wide > ends[1]
    at = _clipped(q[:, :2], ends[1])
    its_slope = np.stack(gradients(other, *at.T), axis=1)
    its_bend = _bend(other, np.minimum(np.hypot(*at.T) + wide, last_radius(other)), wide)
    its_steepest = np.hypot(*its_slope.T) + its_bend * wide
    height: Array = sense * (q[:, 2] - other["vertex_z"] - mesh_heights(other, *at.T))
    rate = along[:, 2] - np.einsum("ki,kij->kj", its_slope, along[:, :2])
    rise = np.hypot(*rate.T) * extent
    # Beyond the other's edge, its own height is taken there: both parts may change independently.
    apart = np.hypot(along[:, 2, 0], along[:, 2, 1]) * extent + np.hypot(*its_slope.T) * wide
    second = np.hypot(1.0, its_steepest) * bend * extent**2 + its_bend * wide**2
    most = height + np.where(inside, rise, apart) + 0.5 * second
    return height, inside, np.where(beside, -np.inf, most)


def _clipped(points: Array, radius: float) -> Array:
    """Move points (k, 2) towards the axis into a circle."""
    r = np.hypot(*points.T)
    return np.asarray(points * np.minimum(1.0, np.divide(radius, r, out=np.ones_like(r), where=r > 0.0))[:, None])


def _bend(surface: Any, radius: Array, extent: float | Array) -> Array:
    """Return bounds (k,) of the magnitude of the second derivatives of z inside circles of radii (k,).

    A straight line crosses the border of a zone at most twice, and its slope jumps by at most the kink J each time. On
    lines of the given extent e, that moves z by no more than a second derivative of 4 J / e does.
    """
    zones = zones_of(surface)
    parts = [(np.zeros(len(radius)), radius)]
    if zones:
        parts = [(np.minimum(radius, zone.inner), np.minimum(radius, zone.outer)) for zone in zones]
    bounds = [bends_between(surface, *part) for part in parts]
    most = np.max([np.maximum(-least, most) for least, most in bounds], axis=0)
    if not zones:
        return np.asarray(most)
    return np.asarray(most + np.where(radius > zones[0].outer, 4.0 * kink_of(surface, np.inf) / extent, 0.0))
