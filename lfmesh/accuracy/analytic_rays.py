"""Rays of the analytic truth: bundles, frames, transfer to a conic, Snell's and Fresnel's laws. See `analytic`."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]

NEWTON_STEPS = 30


@dataclass
class Rays:
    """A bundle of rays under way."""

    p: Array
    d: Array
    weight: Array
    alive: NDArray[np.bool_]


def turned(tilt_deg: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation about x, then y, then z."""
    a, b, c = np.deg2rad(np.asarray(tilt_deg, dtype=np.float64))
    about_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    about_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    about_z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def into_frame(rays: Rays, turn: NDArray[np.float64], origin: NDArray[np.float64]) -> tuple[Array, Array]:
    """Return positions and directions in a frame that stands at `origin`, turned by `turn`.

    Parameters
    ----------
    rays : Rays
    turn : (3, 3) float64
    origin : (3,) float64, mm
    """
    kind = rays.p.dtype
    # The columns of the turn are the frame's axes: a row vector times it has the frame's coordinates.
    axes = turn.astype(kind)
    return (rays.p - origin.astype(kind)) @ axes, rays.d @ axes


def out_of_frame(p: Array, d: Array, turn: NDArray[np.float64], origin: NDArray[np.float64]) -> tuple[Array, Array]:
    """Return positions and directions from a frame back in that in which it stands.

    Parameters
    ----------
    p, d : (n, 3) float
        Positions, mm, and directions in the frame.
    turn : (3, 3) float64
    origin : (3,) float64, mm
    """
    back = turn.astype(p.dtype).T
    return p @ back + origin.astype(p.dtype), d @ back


def conic_transfer(p: Array, d: Array, c: Any, k: Any) -> Array:
    """Return the distance from p to the conic's sheet through the origin (Welford's 4.10, generalised).

    Parameters
    ----------
    p, d : (n, 3) float
        Positions from the vertex, mm, and directions.
    c : float or (n,) float, 1/mm
        Curvature.
    k : float
        Conic constant.
    """
    # Transfer to the vertex's plane first: the rest is then small and keeps its digits.
    to_plane = -p[:, 2] / d[:, 2]
    x, y = p[:, 0] + to_plane * d[:, 0], p[:, 1] + to_plane * d[:, 1]
    f = c * (x * x + y * y)
    g = d[:, 2] - c * (d[:, 0] * x + d[:, 1] * y)
    return to_plane + f / (g + np.sqrt(g * g - c * f * (1 + k * d[:, 2] ** 2)))


def refract(
    rays: Rays, normal: Array, before: float | Array, after: float | Array, change: Array | None = None
) -> None:  # fmt: skip
    """Refract the rays by Snell's law, n' d' − n d parallel to the normal, and weight them by Fresnel's transmittance.

    A phase of the face adds its gradient to n d along the face (W. T. Welford, Optics Communications 14, 1975, 322).
    The transmittance stays that of the refracted ray.

    Parameters
    ----------
    rays : Rays
    normal : (n, 3) float
        Along the rays, of any length.
    before, after : float or (n,) float
        Refractive indices.
    change : (n, 3) float, optional
        Change of n d by a phase, before its projection on the face.
    """
    kind = rays.d.dtype.type
    n_i, n_t = (np.broadcast_to(np.asarray(n, kind), len(rays.d)) for n in (before, after))
    normal = normal / np.sqrt((normal * normal).sum(axis=1))[:, None]
    a_i = n_i * (rays.d * normal).sum(axis=1)
    square = n_t * n_t - n_i * n_i + a_i * a_i
    rays.alive &= (a_i > 0) & (square > 0)
    a_t = np.sqrt(square)
    bent = n_i[:, None] * rays.d + (a_t - a_i)[:, None] * normal
    if change is not None:
        across = n_i[:, None] * rays.d + change - (a_i + (change * normal).sum(axis=1))[:, None] * normal
        square = n_t * n_t - (across * across).sum(axis=1)
        rays.alive &= square > 0
        bent = across + np.sqrt(square)[:, None] * normal
    rays.d = bent / np.sqrt((bent * bent).sum(axis=1))[:, None]
    cos_i, cos_t = a_i / n_i, a_t / n_t
    t_s = 2 * n_i * cos_i / (n_i * cos_i + n_t * cos_t)
    t_p = 2 * n_i * cos_i / (n_t * cos_i + n_i * cos_t)
    rays.weight = rays.weight * (n_t * cos_t) / (n_i * cos_i) * (t_s * t_s + t_p * t_p) / 2
