"""Poses: the installation error of a body or of a lens element, or the place of the camera in the world."""

from lfmesh.scene.model import Model
from lfmesh.scene.quantities import Vector


class Pose(Model):
    """A rigid motion: rotation about the body's centre (a lens element's first vertex), then a shift."""

    shift_mm: Vector = (0.0, 0.0, 0.0)
    """Shift along x, y, z, in mm."""
    tilt_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations about x, then y, then z, in degrees."""
