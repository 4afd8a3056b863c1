"""Pose of a board: intersection with rays, first guess, and world pose."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.scene import Scene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BoardPose:
    """Pose of a board, as `position_mm` and `rotation_deg` of a target.

    Attributes
    ----------
    position_mm : tuple of float
        Centre of the corners, world frame.
    rotation_deg : tuple of float
        About x, then y, then z. Unrotated, the board faces an unrotated camera.
    standard_error : tuple of float
        Of the three coordinates (mm) and the three angles (degrees).
    """

    position_mm: tuple[float, ...]
    rotation_deg: tuple[float, ...]
    standard_error: tuple[float, ...]


class Plane(NamedTuple):
    """Plane of a board in the camera frame: axes as columns, and the board's centre."""

    axes: Array
    middle: Array

    def meet(self, rays: Array) -> Array:
        """Return the intersections of rays with the plane, (n, 2) mm on the board.

        Parameters
        ----------
        rays : (n, 4) float64
            x and y at z = 0, dx/dz and dy/dz.
        """
        normal = self.axes[:, 2]
        along = rays[:, 2:] @ normal[:2] + normal[2]
        z = (normal @ self.middle - rays[:, :2] @ normal[:2]) / along
        points = np.column_stack([rays[:, :2] + z[:, None] * rays[:, 2:], z])
        return np.asarray((points - self.middle) @ self.axes[:, :2])


def pose_of(pose: Array) -> Plane:
    """Return the plane of a (6,) pose: centre (mm) and rotation vector (radians), camera frame."""
    return Plane(Rotation.from_rotvec(pose[3:]).as_matrix(), pose[:3])


def first_pose(rays: Array, board_mm: Array, near_mm: float) -> Array:
    """Return a (6,) pose facing the camera, where the rays are as far apart as the corners.

    Parameters
    ----------
    rays : (n, 4) float64
        x and y at z = 0, dx/dz and dy/dz.
    board_mm : (n, 2) float64
    near_mm : float
        Nearest distance.

    Raises
    ------
    LfmeshError
        There is no such distance.
    """
    at_zero, slope, own = rays[:, :2], rays[:, 2:], board_mm - board_mm.mean(axis=0)
    at_zero_beside, slope_beside = at_zero - at_zero.mean(axis=0), slope - slope.mean(axis=0)
    # Solve |a + z b|² = |c|²; the camera looks towards negative z.
    square, mixed, rest = (slope_beside**2).sum(), (at_zero_beside * slope_beside).sum(), (at_zero_beside**2).sum()
    inside = mixed**2 - square * (rest - (own**2).sum())
    z = (-mixed - np.sqrt(inside)) / square if inside > 0.0 else 0.0
    if not z < 0.0:
        raise LfmeshError(
            f"board: its corners match the rays of the views at no distance before the camera (its nearest focus lies "
            f"at {near_mm:.4g} mm); check the squares' size and --orientation"
        )
    there = at_zero + z * slope
    beside = (there - there.mean(axis=0)) @ np.array([1.0, 1.0j])
    turn = float(np.angle(np.vdot(own @ np.array([1.0, 1.0j]), beside)))
    cosine, sine = np.cos(turn), np.sin(turn)
    middle = there.mean(axis=0) - np.array([[cosine, -sine], [sine, cosine]]) @ board_mm.mean(axis=0)
    return np.array([*middle, z, 0.0, 0.0, turn])


TURN = 1e-6
"""Finite-difference step of the angles, radians."""


def world_pose(pose: Array, scene: Scene) -> tuple[Array, Array]:
    """Return the world position (mm) and rotation (degrees) of a camera-frame pose, and their derivative.

    Parameters
    ----------
    pose : (6,) float64
    scene : Scene

    Returns
    -------
    values : (6,) float64
    derivative : (6, 6) float64
    """
    own = scene.camera.pose
    camera = frames.frame(own.tilt_deg, own.shift_mm)

    def values(pose: Array) -> Array:
        axes = Rotation.from_matrix(camera[:, :3] @ pose_of(pose).axes)
        return np.concatenate([camera[:, :3] @ pose[:3] + camera[:, 3], axes.as_euler("xyz", degrees=True)])

    ends = [[values(pose + sign * unit) for sign in (1.0, -1.0)] for unit in TURN * np.eye(6)]
    return values(pose), np.stack([(up - down) / (2.0 * TURN) for up, down in ends], axis=1)
