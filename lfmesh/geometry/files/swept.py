"""Points inside a box of the curves and nets of a STEP file's surfaces.

Curves follow ISO 10303-42, in the format of `step_surfaces`. Each sample point is on the curve, to rounding.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np

from lfmesh.geometry import frame
from lfmesh.geometry.meshes.mesh import Array

ENOUGH, MOST = 129, 512
"""Points for fitting a profile, and pieces of a curve examined at a time."""

PIECES = 8
"""Number of parts into which a piece of a curve is divided."""

DEEPEST = 14
"""Number of such divisions: the last pieces are 2e-13 of the whole."""

ARC_PER_CHORD = 2.0
"""Largest ratio of arc length to chord of a short piece of a curve."""

FARTHEST = 50.0
"""Largest parameter of an endless hyperbola or parabola: farther than any lens."""

Outside = Callable[[Array], Array]
"""Distance of points (n, 3) outside a box, mm; 0 inside."""


def curve_in_box(curve: dict[str, Any], place: frame.Frame, outside: Outside) -> Array:
    """Return points (n, 3) of a curve inside a box, `ENOUGH` or more; none if the curve misses the box.

    Parameters
    ----------
    curve : dict
        In the format of `step_surfaces`.
    place : (3, 4) float64
        Frame of its body.
    outside : function
        Distance outside the box.
    """
    at, t = _parametrised(curve)
    for _ in range(DEEPEST):
        points = frame.points(place, at(t))
        distance = outside(points)
        inside = distance == 0.0
        if inside.sum() >= ENOUGH:
            return np.asarray(points[inside])
        chord = np.linalg.norm(np.diff(points, axis=0), axis=1)
        near = np.flatnonzero(np.minimum(distance[:-1], distance[1:]) <= ARC_PER_CHORD * chord)
        near = near[t[near] < t[near + 1]][:MOST]
        if not len(near):
            break
        share = np.arange(PIECES + 1) / PIECES
        t = (t[near, None] + (t[near + 1] - t[near])[:, None] * share).ravel()
    return np.empty((0, 3))


def net_in_box(net: dict[str, Any], place: frame.Frame, outside: Outside) -> Array:
    """Return points (n, 3) of a B-spline surface that lie in a box, as `curve_in_box` does.

    Parameters
    ----------
    net : dict
        As `step_surfaces` writes it.
    place : (3, 4) float64
        Frame of its body.
    outside : function
        Of the box.
    """
    from scipy.interpolate import BSpline

    weights = np.asarray(net["weights"], dtype=np.float64)[..., None]
    control = np.concatenate([np.asarray(net["points"], dtype=np.float64) * weights, weights], axis=2)
    splines, ranges = [], []
    for axis, (degree, knots) in enumerate(zip(net["degrees"], net["knots"], strict=True)):
        splines.append((np.asarray(knots, dtype=np.float64), degree))
        ranges.append((knots[degree], knots[control.shape[axis]]))
    for _ in range(DEEPEST):
        u, v = (np.linspace(low, high, ENOUGH) for low, high in ranges)
        along = BSpline(splines[0][0], control, splines[0][1])(u)
        four = BSpline(splines[1][0], np.moveaxis(along, 1, 0), splines[1][1])(v)
        points = frame.points(place, (four[..., :3] / four[..., 3:]).reshape(-1, 3))
        inside = (outside(points) == 0.0).reshape(len(v), len(u))
        if not inside.any() or inside.sum() >= ENOUGH:
            return np.asarray(points[inside.ravel()])
        ranges = [_round(u, inside.any(axis=0)), _round(v, inside.any(axis=1))]
    return np.empty((0, 3))


def _round(t: Array, inside: Array) -> tuple[float, float]:
    """Return the interval of parameters that encloses the points inside."""
    found = np.flatnonzero(inside)
    return float(t[max(found[0] - 1, 0)]), float(t[min(found[-1] + 1, len(t) - 1)])


def _parametrised(curve: dict[str, Any]) -> tuple[Callable[[Array], Array], Array]:
    """Return a function from parameters (n,) to points (n, 3) of a curve, and parameters from end to end."""
    if curve["kind"] == "spline":
        from scipy.interpolate import BSpline

        weights = np.asarray(curve["weights"], dtype=np.float64)[:, None]
        control = np.concatenate([np.asarray(curve["points"], dtype=np.float64) * weights, weights], axis=1)
        spline = BSpline(np.asarray(curve["knots"], dtype=np.float64), control, curve["degree"])

        def on_spline(t: Array) -> Array:
            four = spline(t)
            return np.asarray(four[:, :3] / four[:, 3:])

        ends = np.unique(curve["knots"])
        ends = ends[(ends >= curve["knots"][curve["degree"]]) & (ends <= curve["knots"][len(control)])]
        return on_spline, ends if len(ends) > MOST else np.unique(
            np.concatenate([np.linspace(a, b, PIECES + 1) for a, b in pairwise(ends)])
        )
    at, x = np.asarray(curve["at"]), np.asarray(curve["x"])
    if curve["kind"] == "line":
        # The parameter is an angle; its tangent covers the line.
        size = 1.0 + float(np.abs(at).max())
        return lambda t: at + size * np.tan(t)[:, None] * x, np.linspace(-1.5, 1.5, MOST // PIECES + 1)
    y, a, b = np.asarray(curve["y"]), curve["a"], curve["b"]
    by_x: Callable[[Array], Array] = np.cos
    by_y: Callable[[Array], Array] = np.sin
    if curve["kind"] == "hyperbola":
        by_x, by_y = np.cosh, np.sinh
    elif curve["kind"] == "parabola":
        by_x, by_y = np.square, lambda t: np.asarray(2.0 * t)
    end = FARTHEST if curve["kind"] in ("hyperbola", "parabola") else np.pi
    return (
        lambda t: at + a * by_x(t)[:, None] * x + b * by_y(t)[:, None] * y,
        np.linspace(-end, end, MOST // PIECES + 1),
    )
