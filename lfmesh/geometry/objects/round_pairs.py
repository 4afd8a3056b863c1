"""Relative position of spheres and cylinders: apart, one inside the other, cut, or with a surface in common.

Two convex bodies are apart if a plane separates them. It is found by alternating projections, from the nearest point of
one body to that of the other and back (W. Cheney and A. A. Goldstein, "Proximity maps for convex sets", Proceedings of
the American Mathematical Society 10, 1959). If the bodies meet, both points converge to one.
"""

from enum import Enum

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.objects.round_body import RoundBody
from lfmesh.scene.objects.shapes import Cylinder, Sphere

ON_RIM = 4096
"""Points that represent a circle: the arcs between them rise 3e-7 of the radius above their chords."""

MOST_STEPS = 1000
"""Projections after which bodies without a separating plane count as cut."""


class Pair(Enum):
    """Position of one closed round body relative to another."""

    APART = 0
    FIRST_INSIDE = 1
    SECOND_INSIDE = 2
    CUT = 3


def pair_of(one: RoundBody, other: RoundBody, near_mm: float) -> Pair:
    """Return the relative position of two spheres or cylinders.

    Parameters
    ----------
    one, other : RoundBody
    near_mm : float
        Overlap, or protrusion, that still counts as touching.
    """
    if _is_inside(one, other, near_mm):
        return Pair.FIRST_INSIDE
    if _is_inside(other, one, near_mm):
        return Pair.SECOND_INSIDE
    return Pair.APART if _are_apart(one, other, 0.5 * near_mm) else Pair.CUT


def _is_inside(one: RoundBody, other: RoundBody, near_mm: float) -> bool:
    """Tell whether a body lies in a convex one, by its outermost points."""
    if isinstance(one.shape, Sphere):
        return bool(other.height_mm(one.place[:, 3]) <= near_mm - one.shape.radius_mm)
    assert isinstance(one.shape, Cylinder)
    turn = 2.0 * np.pi * np.arange(ON_RIM) / ON_RIM
    rim = one.shape.radius_mm * np.column_stack([np.cos(turn), np.sin(turn)])
    ends = [np.column_stack([rim, np.full(ON_RIM, sign * 0.5 * one.shape.height_mm)]) for sign in (-1.0, 1.0)]
    return bool((other.height_mm(frame.points(one.place, np.concatenate(ends))) <= near_mm).all())


def _are_apart(one: RoundBody, other: RoundBody, off_mm: float) -> bool:
    """Tell whether a plane separates two bodies with their surfaces set back by `off_mm`."""
    p = other.place[:, 3]
    for _ in range(MOST_STEPS):
        q = _nearest(one, p, off_mm)
        p = _nearest(other, q, off_mm)
        way = p - q
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return False
        way /= length
        if _farthest(one, way, off_mm) < -_farthest(other, -way, off_mm):
            return True
    return False


def _nearest(body: RoundBody, point: Array, off_mm: float) -> Array:
    """Return the nearest point to a point (3,) of a body with its surface set back."""
    x, y, z = frame.points(frame.inverse(body.place), point)
    radius = max(body.shape.radius_mm - off_mm, 0.0)
    if isinstance(body.shape, Sphere):
        share = min(radius / max(float(np.sqrt(x * x + y * y + z * z)), radius), 1.0) if radius > 0.0 else 0.0
        own = share * np.array([x, y, z])
    else:
        half = max(body.half_mm - off_mm, 0.0)
        share = min(radius / max(float(np.hypot(x, y)), radius), 1.0) if radius > 0.0 else 0.0
        own = np.array([share * x, share * y, np.clip(z, -half, half)])
    return frame.points(body.place, own)


def _farthest(body: RoundBody, way: Array, off_mm: float) -> float:
    """Return the largest coordinate along a unit vector of a body with its surface set back."""
    radius, half = max(body.shape.radius_mm - off_mm, 0.0), max(body.half_mm - off_mm, 0.0)
    reach = float(way @ body.place[:, 3])
    if isinstance(body.shape, Sphere):
        return reach + radius
    rise = float(way @ body.place[:, 2])
    return reach + half * abs(rise) + radius * float(np.sqrt(max(1.0 - rise * rise, 0.0)))


def common_place(one: RoundBody, other: RoundBody, near_mm: float) -> Array | None:
    """Return a point (3,) where curved surfaces of two bodies coincide over an area; None if they do not.

    Flat ends are excluded; their facets lie in their planes and are compared instead.

    Parameters
    ----------
    one, other : RoundBody
    near_mm : float
        Largest distance between surfaces that coincide.
    """
    between = other.place[:, 3] - one.place[:, 3]
    thicker = abs(one.shape.radius_mm - other.shape.radius_mm)
    if isinstance(one.shape, Sphere) and isinstance(other.shape, Sphere):
        if float(np.linalg.norm(between)) + thicker > near_mm:
            return None
        return np.asarray(one.place[:, 3] + one.shape.radius_mm * one.place[:, 2])
    if not (isinstance(one.shape, Cylinder) and isinstance(other.shape, Cylinder)):
        return None
    axis = one.place[:, 2]
    along = float(between @ axis)
    beside = float(np.linalg.norm(between - along * axis))
    tilt = float(np.linalg.norm(np.cross(axis, other.place[:, 2])))
    first, last = max(-one.half_mm, along - other.half_mm), min(one.half_mm, along + other.half_mm)
    if last - first <= near_mm or beside + thicker + tilt * (last - first) > near_mm:
        return None
    return np.asarray(one.place[:, 3] + 0.5 * (first + last) * axis + one.shape.radius_mm * one.place[:, 0])
