"""Axes of lamps and particles: rotations by three angles, and the axes across a direction."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.scene.quantities import Vector

Array = NDArray[np.float64]

ALONG_X = 1e-6
"""Sine of the angle from the x axis below which a direction is taken to point along it."""


def rotation(tilt_deg: Vector) -> Array:
    """Return the rotation by three angles, about x first, then y, then z, as `geometry.frame` has it for targets."""
    turn = np.eye(3)
    for axis, angle in enumerate(tilt_deg):
        turn = turned_about(np.eye(3)[axis], np.deg2rad(angle)) @ turn
    return turn


def turned_about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit axis by an angle, rad (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(0.5 * angle) ** 2 * cross @ cross)


def axes_along(heading: Array, turn_deg: float) -> Array:
    """Return the axes of a lamp that is headed along a unit direction, (3, 3) float64.

    The first is the part of +x (+y for a lamp along x) that is square to the direction, the second square to both; they
    are turned counter-clockwise as seen by an eye behind the lamp that looks along the direction, which is the third.

    Parameters
    ----------
    heading : (3,) float64
    turn_deg : float
    """
    side = np.array([1.0, 0.0, 0.0]) - heading[0] * heading
    if np.linalg.norm(side) < ALONG_X:
        side = np.array([0.0, 1.0, 0.0]) - heading[1] * heading
    side /= np.linalg.norm(side)
    # Again, as what was left may be short.
    side -= (side @ heading) * heading
    side /= np.linalg.norm(side)
    other = np.cross(side, heading)
    turn = np.deg2rad(turn_deg)
    c, s = np.cos(turn), np.sin(turn)
    return np.array([c * side + s * other, c * other - s * side, heading])
