"""Depth to which one optical surface reaches through another, and the radius at which they touch, by bounds on cells.

The aperture of the first surface is divided into squares. From the height over the other surface at the middle of a
square follows its largest one there, by its gradient and a bound of its second derivatives. Squares that cannot hold
a larger height than was found are done, the others are divided. Surfaces that touch along an area, or all but do, leave
more squares than are divided: that they cross by no more than the bounds of these is all that is proven then.
"""

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.bends import bends_between, with_bends
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
"""Squares across an aperture to begin with; the middle of one is the vertex."""

LEVELS = 20
"""Times that they are halved at most."""

MOST_SQUARES = 1 << 13
"""Squares at most; the others are left undecided, as of surfaces that touch all over."""

CLOSE_ENOUGH = 1.001
"""Largest height over the one that is found, at most."""

QUARTERS = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
"""Middles of the quarters of a square, in half its sides."""


def reaches_through(one: Any, other: Any, sense: float, least: float, enough: float = np.inf) -> tuple[float, float]:
    """Return how far a surface reaches through another one, along that one's axis, inside both clear apertures, mm.

    Parameters
    ----------
    one, other : SURFACE record
    sense : float
        1: by points of `one` beyond `other`, along its axis; −1: by points before it.
    least : float, mm
        Depth that does not count.
    enough : float, mm
        Depth that is not followed any further once it is found.

    Returns
    -------
    found : float
        0 where no point that reaches through by more than `least` was found.
    possible : float
        No point reaches through by more. 0 where none is proven to reach through by more than `least`.
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
            # Those of the largest bounds are divided: they decide how far the surfaces may reach.
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
    """Return how far a surface and the next reach through each other, and how far they may at most, mm.

    Parameters
    ----------
    front, back : SURFACE record
    least, enough : float, mm
        As for `reaches_through`.
    """
    found, possible = zip(
        *(reaches_through(*pair, least, enough) for pair in ((front, back, 1.0), (back, front, -1.0))), strict=True
    )
    # Along either axis it is a proof that they do not.
    return max(found), max(possible) if min(possible) > 0.0 or max(found) > 0.0 else 0.0


def end_where_they_touch(surfaces: NDArray[np.void], rings: int) -> None:
    """End surfaces that touch outside their clear apertures, or at their rims, where they do.

    Meshes of that many rings or more, which reach a little beyond the apertures, would cross there.

    Parameters
    ----------
    surfaces : (K,) SURFACE
    rings : int
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
    """Return the radius from `low` to `high` at which surfaces of revolution first touch; inf where they do not, mm.

    Between two radii the gap falls below the smaller one at both by m h² / 8 at most, with a bound m of its second
    derivative and the distance h of the radii.
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
    middle = 0.5 * (low + high)
    if middle in (low, high):
        return low
    found = _first_touch(front, back, low, middle)
    return found if found < np.inf else _first_touch(front, back, middle, high)


def _first_touch_off_axis(front: Any, back: Any, low: float, high: float) -> float:
    """Return the radius from `low` to `high` of the parts of two surfaces that first touch; inf where they do not, mm.

    Beyond `low` the larger parts hold all points of the smaller ones: where those touch, so do they. Parts that are not
    proven apart count as touching.
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
    """Return a bound of how far a surface reaches from its vertex along its axis, mm.

    Parameters
    ----------
    surface : SURFACE record
    radius : float, mm
        Of the part of the surface that counts.
    """
    bend = float(_bend(with_bends(surface, radius), np.array([radius]))[0])
    return 0.5 * bend * radius**2 if bend > 0.0 else 0.0


def _heights(
    one: Any, other: Any, sense: float, middles: Array, half: float, ends: tuple[float, float]
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return heights (k,) at the middles of squares, where they are inside both apertures, and bounds of the largest.

    A middle beyond an aperture is moved to its edge, from which all points of the square inside it are no farther.

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
    bend = _bend(one, np.minimum(np.hypot(*p.T) + extent, ends[0]))
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
    its_bend = _bend(other, np.minimum(np.hypot(*at.T) + wide, last_radius(other)))
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
    """Return points (k, 2) moved towards the axis into a circle."""
    r = np.hypot(*points.T)
    return np.asarray(points * np.minimum(1.0, np.divide(radius, r, out=np.ones_like(r), where=r > 0.0))[:, None])


def _bend(surface: Any, radius: Array) -> Array:
    """Return bounds (k,) of the second derivatives of z, in any direction, inside circles of given radii (k,)."""
    least, most = bends_between(surface, np.zeros(len(radius)), radius)
    return np.maximum(-least, most)
