"""Axes of lamps and particles: rotations by three angles, and axes perpendicular to a direction."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene.quantities import Vector

Array = NDArray[np.float64]

ALONG_X = 1e-6
"""Sine of the angle from the x axis below which a direction counts as along it."""


def rotation(tilt_deg: Vector) -> Array:
    """Return the rotation by three angles about x, then y, then z, as in `geometry.frame`."""
    turn = np.eye(3)
    for axis, angle in enumerate(tilt_deg):
        turn = turned_about(np.eye(3)[axis], np.deg2rad(angle)) @ turn
    return turn


def turned_about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit axis by an angle in rad (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(0.5 * angle) ** 2 * cross @ cross)


def axes_along(heading: Array, turn_deg: float) -> Array:
    """Return the axes of a lamp with a given heading, a unit vector, (3, 3) float64.

    The third is the heading, the first +x projected perpendicular to it (+y for a heading along x). The first two are
    turned counter-clockwise as seen from behind the lamp.

    Parameters
    ----------
    heading : (3,) float64
    turn_deg : float
    """
    side = np.array([1.0, 0.0, 0.0]) - heading[0] * heading
    if np.linalg.norm(side) < ALONG_X:
        side = np.array([0.0, 1.0, 0.0]) - heading[1] * heading
    side /= np.linalg.norm(side)
    # Repeated for accuracy, as the remainder may be short.
    side -= (side @ heading) * heading
    side /= np.linalg.norm(side)
    other = np.cross(side, heading)
    turn = np.deg2rad(turn_deg)
    c, s = np.cos(turn), np.sin(turn)
    return np.array([c * side + s * other, c * other - s * side, heading])
