"""Rings between the rims of two surfaces, and the proof that straight edges and facets stay on one side of a surface.

From the height over the surface and its gradient at the corners, a bound of the second derivatives bounds the height
all over a facet. Facets left undecided are halved.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import SceneError
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.bends import bends_between, with_bends
from lfmesh.geometry.surfaces.sag import gradients
from lfmesh.geometry.surfaces.tessellation import last_radius, mesh_heights, mesh_sag

ANNULUS_LEAN = 0.05
"""Rise of a ring's annulus over the length of its cylinder."""

ROUNDING_OF_COORDINATES = 1e-9
"""Depth of a crossing that counts as rounding, over the coordinates of the points."""

MOST_PARTS = 1 << 14
"""Number of parts beyond which facets are no longer halved, and count as not clear."""

ROUNDINGS = 8.0
"""Roundings of a coordinate by which a point of a rim may lie inside it."""


def ring_profile(front: Any, front_rim: float, back: Any, back_rim: float, azimuths: float = np.inf) -> Array:
    """Return the meridional polyline, front rim to back rim, that closes the space between two surfaces.

    It is a cylinder at the larger radius with a flat annulus to the smaller rim, as lenses are made, or a cone if that
    would cut a surface.

    Parameters
    ----------
    front, back : SURFACE record
    front_rim, back_rim : float, mm
        Radii of the two meshes.
    azimuths : float
        Corners of the polygons that stand for circles; inf: circles.

    Returns
    -------
    (n, 2) float64, mm
        r and z.
    """
    a = np.array([front_rim, front["vertex_z"] + mesh_sag(front, front_rim)])
    b = np.array([back_rim, back["vertex_z"] + mesh_sag(back, back_rim)])
    narrow, wide = (a, b) if a[0] < b[0] else (b, a)
    # The annulus leans into its own space: if it were coplanar with the neighbour's, a ray would meet either first.
    corner = np.array([wide[0], narrow[1] + ANNULUS_LEAN * (wide[1] - narrow[1])])
    turned = np.stack([a, corner, b]) if a[0] != b[0] else np.stack([a, b])
    half = np.pi / azimuths
    for profile in (turned, np.stack([a, b])):
        r, z = profile.T
        sides = [np.column_stack([r * np.cos(half), sense * r * np.sin(half), z]) for sense in (-1.0, 1.0)]
        lines = np.stack(sides, axis=1)
        if b[1] >= a[1] - abs(b[0] - a[0]) and all(
            stays_beside(lines, *of, azimuths) for of in ((front, front_rim, 1.0), (back, back_rim, -1.0))
        ):
            return profile
    raise SceneError(
        f"the rims of two neighbouring surfaces cross: one reaches z = {a[1]:.6g} mm at radius {a[0]:.6g} mm, the next "
        f"z = {b[1]:.6g} mm at {b[0]:.6g} mm, {b[1] - a[1]:.3g} mm behind it; give more thickness "
        "or smaller semi-diameters"
    )


def stays_beside(lines: Array, surface: Any, rim: float, side: float, azimuths: float) -> bool:
    """Tell whether the strips between closed polylines stay on one side of a surface.

    Edges from line to line are checked inside the rim of its mesh, facets inside its clear aperture: an edge of the rim
    itself is a chord of a circle of the surface.

    Parameters
    ----------
    lines : (lines, points, 3) float64, mm
        In the surface's nominal frame.
    surface : SURFACE record
    rim : float, mm
    side : float
        1: behind the surface, −1: in front of it.
    azimuths : float
        Corners of its rim.
    """
    aperture = min(float(surface["semi_diameter"]), last_radius(surface), rim * float(np.cos(np.pi / azimuths)))
    after = np.roll(lines, -1, axis=1)
    quads = np.stack([lines[:-1], lines[1:], after[:-1], after[1:]], axis=2).reshape(-1, 4, 3)
    surface = with_bends(surface, rim)
    if not _stay_beside(quads[:, :2], surface, rim, side):
        return False
    quads = quads[~_beyond(quads, aperture)]
    return not len(quads) or _stay_beside(np.concatenate([quads[:, :3], quads[:, 1:]]), surface, aperture, side)


def _stay_beside(parts: Array, surface: Any, radius: float, side: float) -> bool:
    """Tell whether edges (n, 2, 3) or facets (n, 3, 3) stay on one side of a surface, inside a radius, mm."""
    end, scale = last_radius(surface), float(np.abs(parts).max() + abs(surface["vertex_z"]))
    least, grain = ROUNDING_OF_COORDINATES * scale, np.finfo(np.float64).eps * scale
    radius -= ROUNDINGS * grain
    parts = parts[~_beyond(parts, radius)]
    while len(parts):
        nearest = _from_axis(parts)
        parts, nearest = parts[nearest < radius], nearest[nearest < radius]
        r = np.hypot(parts[..., 0], parts[..., 1])
        height = side * (parts[..., 2] - surface["vertex_z"] - mesh_heights(surface, parts[..., 0], parts[..., 1]))
        if ((r < radius) & (height < -least)).any() or len(parts) > MOST_PARTS:
            return False
        farthest = r.max(axis=1, initial=0.0)
        low, high = bends_between(surface, nearest, np.minimum(farthest, end))
        # Beyond its end a surface continues flat, with an edge there.
        low, high = np.where(farthest > end, -np.inf, low), np.where(farthest > end, np.inf, high)
        bends = (-low, high) if side > 0.0 else (high, -low)
        sides = np.square(np.roll(parts, -1, axis=1) - parts)[..., :2].sum(axis=-1)
        found = _least_heights(parts, height, bends, surface, side)
        left = (found < -2.0 * least) & (sides.max(axis=1, initial=0.0) > grain**2)
        parts = _halved(parts[left], sides[left])
    return True


def _beyond(parts: Array, radius: float) -> NDArray[np.bool_]:
    """Tell which parts (n, corners, 3) lie beyond a plane across their middle at a radius from the axis."""
    middle = parts[..., :2].mean(axis=1)
    along = (parts[..., :2] * middle[:, None]).sum(axis=-1).min(axis=1)
    return np.asarray(along > radius * np.hypot(middle[:, 0], middle[:, 1]))


def _least_heights(parts: Array, height: Array, bends: tuple[Array, Array], surface: Any, side: float) -> Array:
    """Return lower bounds (n,) of the height of edges or facets over a surface, mm: the largest of several.

    If the second derivative of the height is at most m, the height is at least its least corner value less m ρ² / 2.
    Here ρ is the radius of a ball around the part: by Jung's theorem ρ² is d / (2 d + 2) times the square of the
    longest side, in d dimensions. If it is at least −m, the height at a distance s from a corner is at least its linear
    extrapolation from there less m s² / 2. That function is concave, so it is least at a corner.

    Parameters
    ----------
    parts : (n, corners, 3) float64, mm
    height : (n, corners) float64, mm
    bends : (n,) and (n,) float64, 1/mm
        Largest second derivative upwards and downwards.
    surface : SURFACE record
    side : float
    """
    up, down = (np.maximum(bend, 0.0) for bend in bends)
    corners, longest = parts.shape[1], 0.0
    by_x, by_y = gradients(surface, parts[..., 0], parts[..., 1])
    found = np.full(len(parts), -np.inf)
    for k in range(corners):
        x, y, z = np.moveaxis(np.delete(parts, k, axis=1) - parts[:, k, None], -1, 0)
        squares = x * x + y * y
        longest = np.maximum(longest, squares.max(axis=1))
        with np.errstate(invalid="ignore"):
            rise = side * (z - by_x[:, k, None] * x - by_y[:, k, None] * y) - 0.5 * down[:, None] * squares
            found = np.fmax(found, height[:, k] + np.minimum(rise.min(axis=1), 0.0))
    with np.errstate(invalid="ignore"):
        return np.fmax(found, height.min(axis=1) - 0.25 * (corners - 1) / corners * up * longest)


def _from_axis(parts: Array) -> Array:
    """Return the least distance (n,) of edges or facets (n, corners, 3) from the axis, mm."""
    p = parts[..., :2]
    d = np.roll(p, -1, axis=1) - p
    squares = np.square(d).sum(axis=-1)
    share = np.divide(-(p * d).sum(axis=-1), squares, out=np.zeros_like(squares), where=squares > 0.0)
    q = p + np.clip(share, 0.0, 1.0)[..., None] * d
    nearest = np.hypot(q[..., 0], q[..., 1]).min(axis=1)
    if parts.shape[1] == 3:
        turns = p[..., 0] * d[..., 1] - p[..., 1] * d[..., 0]
        nearest = np.where((turns > 0.0).all(axis=1) | (turns < 0.0).all(axis=1), 0.0, nearest)
    return np.asarray(nearest)


def _halved(parts: Array, sides: Array) -> Array:
    """Return the halves (2 n, corners, 3) of edges or facets, cut at the middle of the longest side.

    Parameters
    ----------
    parts : (n, corners, 3) float64, mm
    sides : (n, corners) float64, mm²
        Squared lengths of the sides from each corner to the next, projected along the axis.
    """
    corners = parts.shape[1]
    turned = (sides.argmax(axis=1)[:, None] + np.arange(corners)) % corners
    parts = np.take_along_axis(parts, turned[..., None], axis=1)
    middle = 0.5 * (parts[:, 0] + parts[:, 1])
    first, second = parts.copy(), parts.copy()
    first[:, 1] = second[:, 0] = middle
    return np.concatenate([first, second])
