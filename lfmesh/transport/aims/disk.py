"""Directions from a point to a disk perpendicular to the axis, uniform over its area."""

import numpy as np

from lfmesh.kernels.decorators import kernel

Vector = tuple[float, float, float]
"""Point or direction."""

Disk = tuple[float, float, float, float]
"""Centre (x, y, z) and radius of a disk, mm; no disk if the radius is not positive."""


@kernel
def toward_disk(p: Vector, disk: Disk, u: float, v: float) -> Vector:
    """Return the unit direction from a point to a uniform point of a disk.

    Parameters
    ----------
    p : (3,) float, mm
    disk : (4,) float, mm
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    r, phi = disk[3] * np.sqrt(u), 2.0 * np.pi * v
    dx, dy, dz = disk[0] + r * np.cos(phi) - p[0], disk[1] + r * np.sin(phi) - p[1], disk[2] - p[2]
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel
def disk_density(p: Vector, d: Vector, disk: Disk) -> float:
    """Return the density, 1/sr, of a direction drawn by `toward_disk`.

    Parameters
    ----------
    p : (3,) float, mm
    d : (3,) float
        Unit direction.
    disk : (4,) float, mm
    """
    radius = disk[3]
    if radius <= 0.0 or d[2] == 0.0:
        return 0.0
    t = (disk[2] - p[2]) / d[2]
    px, py = p[0] + t * d[0] - disk[0], p[1] + t * d[1] - disk[1]
    if t <= 0.0 or px * px + py * py > radius * radius:
        return 0.0
    return t * t / (np.pi * radius * radius * abs(d[2]))
