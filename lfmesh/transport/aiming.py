"""Where to send rays: a mixture of the disk that matters and one that misses nothing, with its density.

Most rays go to the pupil, a few to a disk that bounds everything that can reach the lens; a ray is weighted by the
density of the whole mixture, whichever part drew it. So ghosts and vignetted rays are in, and no weight exceeds that
of uniform sampling by more than the inverse of the small share.
"""

import numpy as np

from lfmesh.kernel import kernel

WIDE_SHARE = 0.1
"""Share of rays that go to the wide disk."""


@kernel
def toward_disk(
    x: float, y: float, z: float, disk_z: float, radius: float, u: float, v: float
) -> tuple[float, float, float]:
    """Return the unit direction from a point to a uniform point of a disk square to the z axis."""
    r, phi = radius * np.sqrt(u), 2.0 * np.pi * v
    dx, dy, dz = r * np.cos(phi) - x, r * np.sin(phi) - y, disk_z - z
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel
def disk_density(x: float, y: float, z: float, dx: float, dy: float, dz: float, disk_z: float, radius: float) -> float:
    """Return the density per solid angle with which `toward_disk` draws a direction."""
    if radius <= 0.0 or dz == 0.0:
        return 0.0
    t = (disk_z - z) / dz
    px, py = x + t * dx, y + t * dy
    if t <= 0.0 or px * px + py * py > radius * radius:
        return 0.0
    return t * t / (np.pi * radius * radius * abs(dz))


@kernel
def aimed(
    x: float, y: float, z: float,
    pupil_z: float, pupil_radius: float, wide_z: float, wide_radius: float,
    choice: float, u: float, v: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction from a point towards pupil or wide disk, and its density in the mixture."""
    share = 1.0 if pupil_radius <= 0.0 else WIDE_SHARE
    if choice < share:
        dx, dy, dz = toward_disk(x, y, z, wide_z, wide_radius, u, v)
    else:
        dx, dy, dz = toward_disk(x, y, z, pupil_z, pupil_radius, u, v)
    density = share * disk_density(x, y, z, dx, dy, dz, wide_z, wide_radius)
    if share < 1.0:
        density += (1.0 - share) * disk_density(x, y, z, dx, dy, dz, pupil_z, pupil_radius)
    return dx, dy, dz, density
