"""Cameras with gradient-index glass, and closed forms of rays in it, for tests of events and sequences."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

import lfmesh as lf
from lfmesh.geometry.ray import Ray
from lfmesh.transport.events.gradient import GapEnd, cross_gap
from lfmesh.transport.tables.tables import LensTables

Array = NDArray[np.float64]

NM = 587.6
INDEX, ALPHA = 1.6, 0.1
"""n² = n₀² (1 − α² r²) of the rods."""

ROD = {"kind": "radial_n2", "index": INDEX, "coefficients": [-(ALPHA**2)]}


def camera(surfaces: list[dict[str, Any]], *, distance_mm: float = 5.0, **others: Any) -> lf.Scene:
    """Return a camera with these surfaces, the first of them the stop, and a sensor behind them."""
    first, *rest = surfaces
    own = {key: others.pop(key) for key in [key for key in others if key in ("object_medium", "absorption")]}
    lens = {"surfaces": [{"stop": True} | first, *rest]} | ({"elements": others.pop("elements", [])})
    sensor = {"pixels": [200, 200], "pixel_mm": 0.5, "distance_mm": distance_mm}
    transport = {"wavelengths_nm": [NM]} | others.pop("transport", {})
    return lf.Scene(camera={"lens": lens, "sensor": sensor} | own, transport=transport, **others)


def rod(
    length_mm: float = 10.0, radius_mm: float = 3.0, gradient: dict[str, Any] | None = None
) -> list[dict[str, Any]]:
    """Return the surfaces of a rod with plane faces."""
    return [
        {"thickness_mm": length_mm, "gradient": gradient or ROD, "semi_diameter_mm": radius_mm},
        {"semi_diameter_mm": radius_mm},
    ]


def built(surfaces: list[dict[str, Any]], **others: Any) -> lf.World:
    """Return the world of a camera, whose rays are not aimed."""
    return lf.build(camera(surfaces, **others), aimed=False)


def crossed(lens: LensTables, space: int, k: int, p: Array, d: Array) -> GapEnd:
    """Return the end of a ray through a gap."""
    return cross_gap(lens, space, 0, k, Ray(*map(float, p), *map(float, d)))


def point_of(end: GapEnd) -> tuple[Array, Array]:
    """Return the point where a ray ends, and its direction there."""
    d = np.array([end.dx, end.dy, end.dz])
    return np.array([end.x, end.y, end.z]) + end.distance * d, d


def unit(*v: float) -> Array:
    return np.array(v) / np.linalg.norm(v)


class RodRay(NamedTuple):
    """A ray at the end of a rod, by closed form: place across, optical ray vector, optical path."""

    place: Array
    vector: Array
    path: float


def rod_ray(place: Array, vector: Array, length: float) -> RodRay:
    """Return a ray of the rod n² = n₀² (1 − α² r²) after a length along z.

    Parameters
    ----------
    place : (2,) float64, mm
    vector : (3,) float64
        Optical ray vector at the start.
    length : float, mm
    """
    w = INDEX * ALPHA
    sigma = length / vector[2]
    c, s = np.cos(w * sigma), np.sin(w * sigma)
    a = vector[:2] / w
    squares = 0.5 * (
        (place**2 + a**2) * sigma
        + (place**2 - a**2) * np.sin(2.0 * w * sigma) / (2.0 * w)
        + place * a * (1.0 - np.cos(2.0 * w * sigma)) / w
    )
    path = INDEX**2 * (sigma - ALPHA**2 * float(squares.sum()))
    return RodRay(place * c + a * s, np.append(w * (a * c - place * s), vector[2]), path)


class LinearRay(NamedTuple):
    """A ray in a linear index at the end, by closed form: point, optical ray vector, length, optical path."""

    point: Array
    vector: Array
    length: float
    path: float


def back_in_linear_index(point: Array, vector: Array, slope: Array) -> LinearRay:
    """Return a ray of the index n = n₀ + **g** · **r** where it has turned and is back at the z of its start.

    With dσ = ds/n the index along a ray is n cosh(g σ) + (**g** · **T**) sinh(g σ) / g, and **T** changes along **g**
    alone: the ray is a catenary.

    Parameters
    ----------
    point : (3,) float64, mm
    vector : (3,) float64
        Optical ray vector, towards +z: its length is the index at the point.
    slope : (3,) float64, mm⁻¹
        **g**, with a component towards −z.
    """
    n, g = float(np.linalg.norm(vector)), float(np.linalg.norm(slope))
    along, rate = slope / g, float(vector @ slope) / g

    def moved(sigma: float) -> Array:
        whole = n * (np.cosh(g * sigma) - 1.0) + rate * np.sinh(g * sigma)
        return np.asarray((vector - rate * along) * sigma + along * whole / g)

    # dT/dσ is n g, so z rises and falls once.
    late = 1e-3
    while moved(late)[2] > 0.0:
        late *= 2.0
    end = brentq(lambda sigma: moved(sigma)[2], 0.5 * late, late, xtol=1e-15, rtol=1e-14)
    index, change = n * np.cosh(g * end) + rate * np.sinh(g * end), n * np.sinh(g * end) + rate * np.cosh(g * end)
    path = 0.5 * end * (n * n - rate * rate) + 0.5 * (index * change - n * rate) / g
    return LinearRay(point + moved(end), vector + along * (change - rate), (change - rate) / g, path)


def index_in_rod(place: Array) -> float:
    """Return the index of the rod at a distance from its axis."""
    return float(INDEX * np.sqrt(1.0 - ALPHA**2 * (place[:2] ** 2).sum()))


def passed(n_i: float, n_t: float, momentum: float) -> float:
    """Return Fresnel's transmittance of unpolarised light, by its momentum along the face; 0 under total reflection."""
    if not (momentum < n_i and momentum < n_t):
        return 0.0
    a, b = np.sqrt(n_i**2 - momentum**2), np.sqrt(n_t**2 - momentum**2)
    across, along = (a - b) / (a + b), (n_t**2 * a - n_i**2 * b) / (n_t**2 * a + n_i**2 * b)
    return float(1.0 - 0.5 * (across**2 + along**2))
