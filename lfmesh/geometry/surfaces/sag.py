"""Sag, slopes and normals of exact surfaces at arrays of points, by numpy; NaN where a surface does not reach."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lfmesh.geometry.surfaces.surface import BICONIC, TOROID, Array, form_at, is_revolved
from lfmesh.kernels.decorators import kernel


def sag(surface: Any, r: ArrayLike) -> Array:
    """Return the sag of a surface of revolution at radii `r` (any shape), mm; NaN where it does not reach."""
    _need_revolved(surface)
    return _curve(surface, np.asarray(r, dtype=np.float64))[0]


def slope(surface: Any, r: ArrayLike) -> Array:
    """Return dz/dr of a surface of revolution at radii `r`."""
    _need_revolved(surface)
    return _curve(surface, np.asarray(r, dtype=np.float64))[1]


def _need_revolved(surface: Any) -> None:
    if not is_revolved(surface):
        raise TypeError("a surface that is none of revolution has no sag by radius alone; ask for `heights`")


def _curve(surface: Any, r: Array) -> tuple[Array, Array]:
    """Return z and dz/dr from the curvature, conic constant and terms; NaN where the conic does not reach."""
    numbers = surface["curvature"], surface["conic"], surface["asphere"][: surface["terms"]]
    z, rate = _even_curve(*numbers, r)
    r2 = r * r
    power = np.abs(r)
    for term, a in enumerate(surface["odd"][: surface["odd_terms"]]):
        rate = rate + (2 * term + 3) * a * (r * power)
        power = power * r2
        z = z + a * power
    if surface["border"] > 0.0:
        outer = surface["outer_curvature"], surface["outer_conic"], surface["outer_asphere"][: surface["outer_terms"]]
        beyond, its_rate = _even_curve(*outer, r)
        outside = r2 > surface["border"] ** 2
        z = np.where(outside, beyond + surface["outer_offset"], z)
        rate = np.where(outside, its_rate, rate)
    return np.asarray(z), np.asarray(rate)


def _even_curve(c: float, conic: float, asphere: Array, r: Array) -> tuple[Array, Array]:
    """Return z and dz/dr of a conic and even terms."""
    r2 = r * r
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(1.0 - (1.0 + conic) * c * c * r2)
        z, rate = c * r2 / (1.0 + root), c * r / root
    power = r2
    for term, a in enumerate(asphere):
        rate = rate + (2 * term + 4) * a * (r * power)
        power = power * r2
        z = z + a * power
    return z, rate


def heights(surface: Any, x: ArrayLike, y: ArrayLike) -> Array:
    """Return z of any surface above its vertex, mm; NaN where it does not reach.

    Parameters
    ----------
    surface : SURFACE record
    x, y : float64 of one shape, mm
    """
    return _form(surface, np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))[0]


def gradients(surface: Any, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Return dz/dx and dz/dy of any surface.

    Parameters
    ----------
    surface : SURFACE record
    x, y : float64 of one shape, mm
    """
    return _form(surface, np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))[1:]


def _form(surface: Any, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """Return z, dz/dx and dz/dy of any surface."""
    cx, c = float(surface["curvature_x"]), float(surface["curvature"])
    with np.errstate(invalid="ignore", divide="ignore"):
        if surface["kind"] == BICONIC:
            a, b = (1.0 + surface["conic_x"]) * cx * cx, (1.0 + surface["conic"]) * c * c
            q, root = cx * x * x + c * y * y, np.sqrt(1.0 - a * x * x - b * y * y)
            z, more = q / (1.0 + root), q / (root * (1.0 + root) ** 2)
            return z, 2.0 * cx * x / (1.0 + root) + a * x * more, 2.0 * c * y / (1.0 + root) + b * y * more
        if surface["kind"] == TOROID:
            f, rate = _curve(surface, y)
            u = 1.0 - cx * f
            root = np.sqrt(u * u - cx * cx * x * x)
            z = np.where(u > 0.0, f + cx * x * x / (u + root), np.nan)
            return z, cx * x / root, rate * u / root
        if not is_revolved(surface):
            z, by_x, by_y = (np.empty(x.shape) for _ in range(3))
            _form_of_each(surface, x.ravel(), y.ravel(), z.reshape(-1), by_x.reshape(-1), by_y.reshape(-1))
            return np.where(np.hypot(x, y) <= reach(surface), z, np.nan), by_x, by_y
        r = np.hypot(x, y)
        z, rate = _curve(surface, r)
    radial = np.divide(rate, r, out=np.zeros_like(r), where=r > 0.0)
    return z, radial * x, radial * y


@kernel
def _form_of_each(s: Any, x: Array, y: Array, z: Array, by_x: Array, by_y: Array) -> None:
    """Write z, dz/dx and dz/dy at points (n,)."""
    for i in range(len(x)):
        z[i], by_x[i], by_y[i] = form_at(s, x[i], y[i])


def normals(surface: Any, x: ArrayLike, y: ArrayLike) -> Array:
    """Return (n, 3) unit normals, towards +z, at the points (x, y) of the surface.

    Parameters
    ----------
    surface : SURFACE record
    x, y : (n,) float64, mm
    """
    by_x, by_y = gradients(surface, x, y)
    n = np.stack([-by_x, -by_y, np.ones_like(by_x)], axis=-1)
    return np.asarray(n / np.linalg.norm(n, axis=-1, keepdims=True))


def reach(surface: Any) -> float:
    """Return the largest radius inside which the surface exists everywhere, mm; inf if it has no rim of its own."""
    own, c, conic = 0.0, surface["curvature"], surface["conic"]
    if surface["border"] > 0.0:
        c, conic = surface["outer_curvature"], surface["outer_conic"]
    if c != 0.0:
        own = max(own, float((1.0 + conic) * c**2))
    if surface["kind"] == BICONIC:
        own = max(own, float((1.0 + surface["conic_x"]) * surface["curvature_x"] ** 2))
    return min(float(1.0 / np.sqrt(own)) if own > 0.0 else np.inf, float(surface["end"]))
