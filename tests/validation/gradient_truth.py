"""Rays through lenses with gradient-index glass, integrated in arc length by SciPy: a truth for tests.

It shares nothing with lfmesh. With the unit direction u and dr/ds = u, the ray equation d(n u)/ds = ∇n gives
du/ds = (∇n − (∇n · u) u) / n. Dormand and Prince's method of order 8 integrates it from face to face (E. Hairer,
S. P. Nørsett and G. Wanner, Solving Ordinary Differential Equations I, Springer 1993). The index comes from its formula
and the gradient from imaginary steps.
"""

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Array = NDArray[np.float64]
Keys = dict[str, Any]
Index = Callable[[complex, complex, complex], complex]

PRECISION = 1e-13
STEP_MM = 1e-30
"""Imaginary step."""

SAMPLES = 65
"""Points of a curve that are held against the edge of the glass."""


def powers(coefficients: list[float], x: complex) -> complex:
    """Return the sum of coefficients times x, x², ..."""
    return sum((c * x**i for i, c in enumerate(coefficients, 1)), 0j)


def index_of(surface: Keys) -> Index:
    """Return the index behind a surface, as a function of x, y and z from its vertex, mm."""
    keys = surface.get("gradient")
    if keys is None:
        constant = complex(surface.get("index", 1.0))
        return lambda x, y, z: constant
    n0, kind = keys["index"], keys["kind"]
    terms = keys["coefficients"]
    if kind == "radial_n2":
        return lambda x, y, z: n0 * cmath.sqrt(1.0 + powers(terms, x * x + y * y))
    if kind == "radial_n":
        return lambda x, y, z: n0 + powers(terms, x * x + y * y)
    if kind == "axial":
        return lambda x, y, z: n0 + powers(terms, z)
    assert kind == "spherical"
    radius = keys["radius_mm"]
    sign = math.copysign(1.0, radius)
    return lambda x, y, z: n0 + powers(terms, radius - sign * cmath.sqrt(x * x + y * y + (radius - z) ** 2))


def value_and_gradient(index: Index, p: Array) -> tuple[float, Array]:
    """Return the index at a point and its gradient, 1/mm."""
    x, y, z = (complex(c) for c in p)
    step = 1j * STEP_MM
    along_x, along_y, along_z = index(x + step, y, z), index(x, y + step, z), index(x, y, z + step)
    return along_x.real, np.array([along_x.imag, along_y.imag, along_z.imag]) / STEP_MM


@dataclass
class Face:
    """A surface: its vertex and its axes as rows, in the camera frame, its shape, and the index behind it.

    The index is a function of coordinates in the frame of the surface.
    """

    vertex: Array
    axes: Array
    radius: float
    conic: float
    asphere: tuple[float, ...]
    aperture: float
    behind: Index
    graded: bool

    def own(self, p: Array) -> Array:
        return np.asarray(self.axes @ (p - self.vertex))

    def sag(self, r2: float) -> float:
        """Return the height above the vertex; beyond the end of a sphere, that of its end."""
        c = 0.0 if math.isinf(self.radius) else 1.0 / self.radius
        z = c * r2 / (1.0 + math.sqrt(max(1.0 - (1.0 + self.conic) * c * c * r2, 0.0)))
        return z + sum(a * r2 ** (j + 2) for j, a in enumerate(self.asphere))

    def height(self, p: Array) -> float:
        """Return z minus the sag at a point of the camera frame, mm."""
        x, y, z = self.own(p)
        return float(z - self.sag(x * x + y * y))

    def normal(self, p: Array) -> Array:
        """Return the gradient of `height`, which has a positive component along the axis."""
        x, y, _ = self.own(p)
        c, r2 = 0.0 if math.isinf(self.radius) else 1.0 / self.radius, x * x + y * y
        rate = c / math.sqrt(max(1.0 - (1.0 + self.conic) * c * c * r2, 1e-6))
        rate += sum((2 * j + 4) * a * r2 ** (j + 1) for j, a in enumerate(self.asphere))
        return np.asarray(np.array([-rate * x, -rate * y, 1.0]) @ self.axes)


@dataclass
class Ray:
    """A ray that has passed the faces of a lens.

    Attributes
    ----------
    points : list of (3,) float, mm
        On each face, in the order of the light.
    direction : (3,) float
    weight : float
        Product of Fresnel's transmittances.
    passes : bool
    margin : float, mm
        Smallest distance from a rim or an edge.
    path : float, mm
        Optical path between the first face and the last one.
    """

    direction: Array
    points: list[Array] = field(default_factory=list)
    weight: float = 1.0
    passes: bool = True
    margin: float = math.inf
    path: float = 0.0

    def hold_against(self, distance: float) -> None:
        """Note a distance from a rim, which is negative outside."""
        self.margin = min(self.margin, abs(distance))
        self.passes &= distance >= 0.0


def turned(vector: Array, tilt_deg: list[float]) -> Array:
    """Return a vector turned about x, then y, then z."""
    v = list(vector)
    for (i, j), degrees in zip(((1, 2), (2, 0), (0, 1)), tilt_deg, strict=True):
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        v[i], v[j] = c * v[i] - s * v[j], s * v[i] + c * v[j]
    return np.array(v)


def faces_of(surfaces: list[Keys], elements: list[Keys] | None = None) -> list[Face]:
    """Return the faces of a prescription and its posed elements, given as tables of a scene."""
    places = np.concatenate([[0.0], np.cumsum([s.get("thickness_mm", 0.0) for s in surfaces])])
    faces = []
    for number, s in enumerate(surfaces):
        vertex, tilt = np.array([0.0, 0.0, places[number]]), [0.0, 0.0, 0.0]
        for element in elements or []:
            if number in element["surfaces"]:
                tilt = element["pose"].get("tilt_deg", tilt)
                pivot = np.array([0.0, 0.0, places[element["surfaces"][0]]])
                vertex = pivot + turned(vertex - pivot, tilt) + element["pose"].get("shift_mm", [0.0, 0.0, 0.0])
        axes = np.array([turned(axis, tilt) for axis in np.eye(3)])
        faces.append(
            Face(vertex, axes, s.get("radius_mm", math.inf), s.get("conic", 0.0), tuple(s.get("asphere_mm", ())),
                 s["semi_diameter_mm"], index_of(s), "gradient" in s)
        )  # fmt: skip
    return faces


def on_straight_line(p: Array, d: Array, face: Face) -> Array:
    """Return the point at which a straight ray meets a face."""
    axis = face.axes[2]
    t = (face.vertex - p) @ axis / (d @ axis)
    for _ in range(60):
        at = p + t * d
        change = face.height(at) / (face.normal(at) @ d)
        t -= change
        if abs(change) < 1e-15 * (1.0 + abs(t)):
            break
    return np.asarray(p + t * d)


def on_curve(ray: Ray, p: Array, medium: Face, face: Face, far: Face, sense: float) -> tuple[Array, Array]:
    """Return point and direction at which a ray through gradient-index glass meets a face.

    Parameters
    ----------
    ray : Ray
        Its margin and its path grow.
    p : (3,) float, mm
        Start, on the other face of the glass.
    medium, far : Face
        Face in front of the glass, whose frame the index has, and face behind it.
    face : Face
        The one of the two that is ahead.
    sense : float
        1 for light towards +z, −1 for light towards −z.
    """

    def rate(_: float, state: Array) -> Array:
        u = state[3:6]
        n, gradient = value_and_gradient(medium.behind, medium.own(state[:3]))
        gradient = gradient @ medium.axes
        return np.concatenate([u, (gradient - (gradient @ u) * u) / n, [n]])

    def crossing(_: float, state: Array) -> float:
        return sense * face.height(state[:3])

    crossing.terminal, crossing.direction = True, 1.0  # type: ignore[attr-defined]
    start = np.concatenate([p, ray.direction, [0.0]])
    settings: Keys = {"method": "DOP853", "rtol": PRECISION, "atol": PRECISION}
    reach = 10.0 * float(np.linalg.norm(far.vertex - medium.vertex)) + 10.0
    rough = solve_ivp(rate, (0.0, reach), start, events=crossing, dense_output=True, **settings)
    assert rough.t_events[0].size, "the ray does not reach the face"
    length = float(rough.t_events[0][0])
    state = solve_ivp(rate, (0.0, length), start, **settings).y[:, -1]
    for _ in range(3):
        rest = -face.height(state[:3]) / float(face.normal(state[:3]) @ state[3:6])
        if rest == 0.0:
            break
        state = solve_ivp(rate, (0.0, rest), state, **settings).y[:, -1]
    _hold_against_edge(ray, rough.sol(np.linspace(0.0, length, SAMPLES))[:3].T, medium, far)
    ray.path += float(state[6])
    return state[:3], state[3:6] / np.linalg.norm(state[3:6])


def _hold_against_edge(ray: Ray, points: Array, front: Face, back: Face) -> None:
    """Compare the points of a curve with the cone between the rims of both faces, which have one axis."""
    own = np.array([front.own(p) for p in points])
    rims = front.sag(front.aperture**2), back.sag(back.aperture**2) + front.own(back.vertex)[2]
    radius = np.interp(own[:, 2], rims, (front.aperture, back.aperture))
    inside = (own[:, 2] > rims[0]) & (own[:, 2] < rims[1])
    if inside.any():
        ray.hold_against(float((radius - np.hypot(own[:, 0], own[:, 1]))[inside].min()))


def _refract(ray: Ray, normal: Array, n_i: float, n_t: float) -> None:
    """Turn a ray by Snell's law and weaken it by Fresnel's."""
    normal = normal / np.linalg.norm(normal)
    cos_i = float(ray.direction @ normal)
    along = n_i / n_t * (ray.direction - cos_i * normal)
    square = 1.0 - float(along @ along)
    if square <= 0.0:
        ray.passes = False
        return
    cos_t = math.sqrt(square)
    t_s, t_p = 2.0 * n_i * cos_i / (n_i * cos_i + n_t * cos_t), 2.0 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
    ray.weight *= 0.5 * n_t * cos_t / (n_i * cos_i) * (t_s * t_s + t_p * t_p)
    ray.direction = along + cos_t * normal


def follow(faces: list[Face], origin: Array, direction: Array, sense: float = 1.0) -> Ray:
    """Return a ray behind all faces, or as far as it comes.

    Parameters
    ----------
    faces : list of Face
        From the object to the sensor, in air.
    origin : (3,) float, mm
    direction : (3,) float
    sense : float
        1 for light towards the sensor, −1 for light from it.
    """
    ray = Ray(np.asarray(direction / np.linalg.norm(direction)))
    p = np.asarray(origin, float)
    order = range(len(faces)) if sense > 0 else range(len(faces) - 1, -1, -1)
    air = index_of({})
    for step, number in enumerate(order):
        face = faces[number]
        space = number - 1 if sense > 0 else number
        if space >= 0 and step and faces[space].graded:
            p, ray.direction = on_curve(ray, p, faces[space], face, faces[space + 1], sense)
        else:
            start, p = p, on_straight_line(p, ray.direction, face)
            if step:
                ray.path += faces[space].behind(0j, 0j, 0j).real * float(np.linalg.norm(p - start))
        ray.points.append(p)
        ray.hold_against(face.aperture - float(np.hypot(*face.own(p)[:2])))
        before, behind = (
            (faces[k].behind(*faces[k].own(p)).real if k >= 0 else air(0j, 0j, 0j).real) for k in (number - 1, number)
        )
        n_i, n_t = (before, behind) if sense > 0 else (behind, before)
        _refract(ray, sense * face.normal(p), n_i, n_t)
        if not ray.passes:
            break
    return ray
