"""Places of things that move, and the space that they pass through during the exposure, relative to the camera."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame
from lfmesh.geometry.box_corners import corners_between
from lfmesh.geometry.rigid_motion import sweep
from lfmesh.transport.tables.motions import STILL, Motions

Array = NDArray[np.float64]

MOST_PIECES = 256
"""Largest number of places on one chord of a path; a longer piece makes the distance larger."""


def swept(motions: Motions | None, mover: int, points: Array) -> tuple[Array, float]:
    """Return places of points of a mover during the exposure, relative to the camera, and the margin of `sweep`.

    Parameters
    ----------
    motions : Motions or None
        None: nothing moves.
    mover : int
    points : (n, 3) float64, mm
        Object frame at t = 0.

    Returns
    -------
    places : (m, 3) float64, mm
        Object frame.
    margin_mm : float
    """
    if motions is None or mover == STILL or not len(points):
        return points, 0.0
    camera, own = motions.of(STILL), motions.of(mover)
    places, margin = sweep(own, points, 0.0, motions.end_s, camera if motions.camera_moves else None)
    return places.reshape(-1, 3), margin


def path_of_camera(motions: Motions | None, mover: int, point: Array, length_mm: float) -> tuple[Array, float]:
    """Return places of a point of the camera during the exposure, relative to a mover, and a distance.

    The point is never farther than the distance from all of the places.

    Parameters
    ----------
    motions : Motions or None
        None: nothing moves.
    mover : int
    point : (3,) float64, mm
        Object frame.
    length_mm : float
        Length of a piece of the path with one place.

    Returns
    -------
    places : (n, 3) float64, mm
        In the frame of the mover.
    distance_mm : float
    """
    if motions is None or mover == STILL:
        return point[None], 0.0
    places, margin = sweep(motions.of(STILL), point[None], 0.0, motions.end_s, motions.of(mover))
    corners = places[:, 0]
    longest = float(np.linalg.norm(np.diff(corners, axis=0), axis=1).max())
    pieces = min(max(int(np.ceil(longest / length_mm)), 1), MOST_PIECES)
    shares = (np.arange(pieces) + 0.5) / pieces
    middles = corners[:-1, None] + shares[:, None] * np.diff(corners, axis=0)[:, None]
    return middles.reshape(-1, 3), 0.5 * longest / pieces + margin


def reach_mm(motions: Motions | None, mover: int, points: Array) -> float:
    """Return the radius of a sphere about the origin of the object frame that holds points throughout, mm.

    Parameters
    ----------
    motions : Motions or None
    mover : int
    points : (n, 3) float64, mm
        Object frame at t = 0.
    """
    places, margin = swept(motions, mover, points)
    return float(np.linalg.norm(places, axis=1).max(initial=0.0)) + margin


def box_round(motions: Motions, mover: int, points: Array, to_frame: Array) -> Array:
    """Return the corners of a box that holds points of a mover during the exposure, (8, 3) mm.

    Parameters
    ----------
    motions : Motions
    mover : int
    points : (n, 3) float64, mm
        Object frame at t = 0.
    to_frame : (3, 4) float64
        From the object frame to the frame of the box.
    """
    places, margin = swept(motions, mover, points)
    places = frame.points(to_frame, places)
    return corners_between(places.min(axis=0) - margin, places.max(axis=0) + margin)
