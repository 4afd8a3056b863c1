"""Poses of movers."""

from lfmesh.geometry.frame import Frame
from lfmesh.geometry.rigid_motion import seen_from
from lfmesh.transport.tables.motions import STILL, Motions


def pose_of_mover(motions: Motions, mover: int, time_s: float) -> Frame:
    """Return the frame of a mover at a time relative to the camera, (3, 4), object frame."""
    return seen_from(motions.of(STILL), motions.of(mover), time_s)
