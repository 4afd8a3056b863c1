"""Rigid frames: position and orientation of a body in other coordinates.

A frame is a (3, 4) float64 array [A | b] that takes a point p of the body to A p + b. A is orthogonal and may be a
reflection: a microlens array's z runs from the curved face into the glass, even if that is against the camera's z.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfmesh.kernels.decorators import inlined, kernel

Frame = NDArray[np.float64]

IDENTITY: Frame = np.hstack([np.eye(3), np.zeros((3, 1))])


def rotation(tilt_deg: ArrayLike) -> NDArray[np.float64]:
    """Return the (3, 3) rotation by three angles about fixed axes: x first, then y, then z."""
    x, y, z = np.deg2rad(np.asarray(tilt_deg, dtype=np.float64))
    about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    about_z = np.array([[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def tilt_of(turn: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the three angles, in degrees, of a (3, 3) rotation; the inverse of `rotation`."""
    x, z = np.arctan2(turn[2, 1], turn[2, 2]), np.arctan2(turn[1, 0], turn[0, 0])
    y = np.arctan2(-turn[2, 0], np.hypot(turn[2, 1], turn[2, 2]))
    return float(np.rad2deg(x)), float(np.rad2deg(y)), float(np.rad2deg(z))


def frame(tilt_deg: ArrayLike = (0, 0, 0), origin_mm: ArrayLike = (0, 0, 0)) -> Frame:
    """Return the frame of a body with its origin at `origin_mm`, turned by `tilt_deg` about that origin."""
    return np.column_stack([rotation(tilt_deg), np.asarray(origin_mm, dtype=np.float64)])


def compose(outer: Frame, inner: Frame) -> Frame:
    """Return the frame that applies `inner` first, then `outer`."""
    return np.column_stack([outer[:, :3] @ inner[:, :3], outer[:, :3] @ inner[:, 3] + outer[:, 3]])


def inverse(through: Frame) -> Frame:
    """Return the inverse of a frame."""
    return np.column_stack([through[:, :3].T, -through[:, :3].T @ through[:, 3]])


def points(through: Frame, p: ArrayLike) -> NDArray[np.float64]:
    """Transform points (n, 3) by a frame."""
    return np.asarray(p, dtype=np.float64) @ through[:, :3].T + through[:, 3]


def directions(through: Frame, d: ArrayLike) -> NDArray[np.float64]:
    """Transform directions (n, 3) by a frame."""
    return np.asarray(d, dtype=np.float64) @ through[:, :3].T


@inlined
def point_through(through: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Transform a point by a frame.

    Parameters
    ----------
    through : (3, 4) float64
        Axes of the frame and its origin, mm.
    x, y, z : float, mm
    """
    return (
        through[0, 0] * x + through[0, 1] * y + through[0, 2] * z + through[0, 3],
        through[1, 0] * x + through[1, 1] * y + through[1, 2] * z + through[1, 3],
        through[2, 0] * x + through[2, 1] * y + through[2, 2] * z + through[2, 3],
    )


@inlined
def direction_through(through: NDArray[np.float64], x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return a direction seen through a frame, (3, 4).

    Parameters
    ----------
    through : (3, 4) float64
        Axes of the frame and its origin, mm.
    x, y, z : float
    """
    return (
        through[0, 0] * x + through[0, 1] * y + through[0, 2] * z,
        through[1, 0] * x + through[1, 1] * y + through[1, 2] * z,
        through[2, 0] * x + through[2, 1] * y + through[2, 2] * z,
    )


@kernel
def move_point(
    table: NDArray[np.float64], here: int, there: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Transform a point, mm, from frame `here` to frame `there`.

    Parameters
    ----------
    table : (n, n, 3, 4) float64
        Transformation between each pair of n frames.
    here, there : int
    x, y, z : float, mm
    """
    return (
        table[here, there, 0, 0] * x
        + table[here, there, 0, 1] * y
        + table[here, there, 0, 2] * z
        + table[here, there, 0, 3],
        table[here, there, 1, 0] * x
        + table[here, there, 1, 1] * y
        + table[here, there, 1, 2] * z
        + table[here, there, 1, 3],
        table[here, there, 2, 0] * x
        + table[here, there, 2, 1] * y
        + table[here, there, 2, 2] * z
        + table[here, there, 2, 3],
    )


@kernel
def move_direction(
    table: NDArray[np.float64], here: int, there: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return a direction moved from frame `here` into frame `there` of a (n, n, 3, 4) table of frames.

    Parameters
    ----------
    table : (n, n, 3, 4) float64
        Frame by which each of n frames is seen from each other one.
    here, there : int
        Numbers of the two frames.
    x, y, z : float
    """
    return (
        table[here, there, 0, 0] * x + table[here, there, 0, 1] * y + table[here, there, 0, 2] * z,
        table[here, there, 1, 0] * x + table[here, there, 1, 1] * y + table[here, there, 1, 2] * z,
        table[here, there, 2, 0] * x + table[here, there, 2, 1] * y + table[here, there, 2, 2] * z,
    )
