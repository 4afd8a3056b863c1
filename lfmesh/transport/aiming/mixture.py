"""Directions towards the lens: a mixture of the opening's disk and a wide disk that misses nothing, with its density.

Most rays go to the lens's opening as seen from the point, a few to a disk that bounds everything that can reach the
lens. A ray is weighted by the density of the whole mixture, whichever disk it was drawn from. So ghosts, and light
outside the measured opening, are included, and no weight exceeds that of uniform sampling on the wide disk by more than
the inverse of its share.

Points close before the lens see the wide disk at grazing angles nearly everywhere. From them half of the rays of its
share go evenly over half of the sphere instead.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aiming.pupil import opening_from
from lfmesh.transport.tables.tables import AimTables, Opening

WIDE_SHARE = 0.1
"""Share of rays to the wide disk where reflections are followed: ghosts come from all over it."""

WIDE_SHARE_OF_STRAYS = 0.3
"""The same where only paths with reflections are estimated."""

WIDE_SHARE_OF_GHOSTS = 0.1
"""The same where only ghosts of two reflections are."""

WIDE_SHARE_OF_IMAGE_PATH = 0.002
"""The same where no reflections are followed: it brings only light outside the measured opening."""

WIDE_SHARE_OF_FALLBACK = 0.5
"""The same, whatever is estimated, behind an array through which aimed rays do not hold all light, see `aim_proof`."""

EVERYWHERE = 0.5
"""Share of rays from points close before the lens, of those to the wide disk, that go everywhere towards the lens."""

OVER_HALF_SPHERE = 1.0 / (2.0 * np.pi)
"""Density of directions that are even over half of the sphere, 1/sr."""

WIDE_SHARE_WITHIN = 0.5
"""Least share of rays to the wide disk from points so near before the opening that it fills a right angle."""


def with_wide_share(aim: AimTables, share: float, share_without_aim: float | None = None) -> AimTables:
    """Return the aim with another share of rays that go anywhere, if aimed rays hold all light.

    Parameters
    ----------
    aim : AimTables
    share : float
    share_without_aim : float, optional
        The same from points that see no opening.
    """
    if aim.wide_share >= WIDE_SHARE_OF_FALLBACK:
        return aim
    return aim._replace(
        wide_share=share, share_without_aim=aim.share_without_aim if share_without_aim is None else share_without_aim
    )


@kernel
def toward_disk(
    x: float, y: float, z: float, cx: float, cy: float, disk_z: float, radius: float, u: float, v: float
) -> tuple[float, float, float]:
    """Return the unit direction from a point to a uniform point of a disk perpendicular to the z axis.

    Parameters
    ----------
    x, y, z : float, mm
        The point.
    cx, cy, disk_z, radius : float, mm
        Centre and radius of the disk.
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    r, phi = radius * np.sqrt(u), 2.0 * np.pi * v
    dx, dy, dz = cx + r * np.cos(phi) - x, cy + r * np.sin(phi) - y, disk_z - z
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@kernel
def disk_density(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, cx: float, cy: float, disk_z: float, radius: float
) -> float:
    """Return the density, 1/sr, with which `toward_disk` draws a direction.

    Parameters
    ----------
    x, y, z : float, mm
        The point.
    dx, dy, dz : float
        The direction.
    cx, cy, disk_z, radius : float, mm
        Centre and radius of the disk.
    """
    if radius <= 0.0 or dz == 0.0:
        return 0.0
    t = (disk_z - z) / dz
    px, py = x + t * dx - cx, y + t * dy - cy
    if t <= 0.0 or px * px + py * py > radius * radius:
        return 0.0
    return t * t / (np.pi * radius * radius * abs(dz))


@kernel
def aimed(
    x: float, y: float, z: float,
    opening: Opening, wide_radius: float, wide_share: float, share_without_aim: float,
    choice: float, u: float, v: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction from a point towards the opening or the wide disk, and its density in the mixture, 1/sr.

    From a point that sees no opening only a share of the rays is sent, to the wide disk; for the others the density
    is zero.

    Parameters
    ----------
    x, y, z : float, mm
        The point, camera frame.
    opening : Opening
    wide_radius : float, mm
    wide_share, share_without_aim : float
        See `AimTables`.
    choice, u, v : float
        Random numbers, uniform in [0, 1).
    """
    cx, cy, radius, share, everywhere = _shares(x, y, z, opening, wide_share, share_without_aim)
    if choice < everywhere:
        dz, turn = 1.0 - u, 2.0 * np.pi * v
        across = np.sqrt(1.0 - dz * dz)
        dx, dy, dz = across * np.cos(turn), across * np.sin(turn), dz * opening.sense
    elif choice < share:
        dx, dy, dz = toward_disk(x, y, z, 0.0, 0.0, opening.plane_z, wide_radius, u, v)
    elif radius > 0.0:
        dx, dy, dz = toward_disk(x, y, z, cx, cy, opening.plane_z, radius, u, v)
    else:
        return 0.0, 0.0, 1.0, 0.0
    return dx, dy, dz, _density(x, y, z, dx, dy, dz, opening, wide_radius, cx, cy, radius, share, everywhere)


@kernel
def aimed_density(
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
    opening: Opening, wide_radius: float, wide_share: float, share_without_aim: float,
) -> float:  # fmt: skip
    """Return the density, 1/sr, with which `aimed` draws a direction from a point; parameters as there.

    Parameters
    ----------
    x, y, z : float, mm
        Point, camera frame.
    dx, dy, dz : float
        Unit direction.
    opening, wide_radius, wide_share, share_without_aim
        As for `aimed`.
    """
    cx, cy, radius, share, everywhere = _shares(x, y, z, opening, wide_share, share_without_aim)
    return _density(x, y, z, dx, dy, dz, opening, wide_radius, cx, cy, radius, share, everywhere)


@inlined
def _shares(
    x: float, y: float, z: float, opening: Opening, wide_share: float, share_without_aim: float
) -> tuple[float, float, float, float, float]:
    """Return the disk of the opening, and the shares of rays that are not aimed at it from a point.

    Returns
    -------
    cx, cy, radius : float, mm
        The disk; radius −1: it is not known, or the point sees none.
    share : float
        Of rays to the wide disk or everywhere.
    everywhere : float
        Of rays everywhere.
    """
    cx, cy, radius = opening_from(opening, x, y, z)
    share, everywhere = 1.0, 0.0
    if not opening.known:
        radius = -1.0
    else:
        share = wide_share if radius > 0.0 else share_without_aim
    distance = (opening.plane_z - z) * opening.sense
    if 0.0 < distance < opening.near.depth:
        if radius * radius > (x - cx) ** 2 + (y - cy) ** 2 + distance * distance:
            share = max(share, WIDE_SHARE_WITHIN)
        everywhere = EVERYWHERE * share
    return cx, cy, radius, share, everywhere


@inlined
def _density(
    x: float, y: float, z: float, dx: float, dy: float, dz: float, opening: Opening, wide_radius: float,
    cx: float, cy: float, radius: float, share: float, everywhere: float,
) -> float:  # fmt: skip
    """Return the density, 1/sr, of a direction for the disk and the shares of `_shares`."""
    wide = disk_density(x, y, z, dx, dy, dz, 0.0, 0.0, opening.plane_z, wide_radius)
    density = (share - everywhere) * wide
    if everywhere > 0.0 and dz * opening.sense > 0.0:
        density += everywhere * OVER_HALF_SPHERE
    if radius > 0.0:
        density += (1.0 - share) * disk_density(x, y, z, dx, dy, dz, cx, cy, opening.plane_z, radius)
    return density
