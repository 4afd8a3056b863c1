"""Directions towards the lens: a mixture of all aims, with its density.

Every aim draws a direction from a point (`toward_...`) and returns its density (`..._density`), both in the camera
frame. Most rays go to the lens's opening as seen from the point, a few to a disk that bounds everything that can reach
the lens. Some go through glass (`through_glass`) or to the origins of ghosts (`ghost_cells`). The density of the whole
mixture weights every ray (balance heuristic, Veach & Guibas 1995). Light outside the measured opening is thus included,
and no weight exceeds that of uniform sampling on the wide disk by more than the inverse of its share.

Points close before the lens see the wide disk at grazing angles nearly everywhere. From them, half of the rays to that
disk go uniformly over half of the sphere instead.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector, disk_density, toward_disk
from lfmesh.transport.aims.disks import no_disks
from lfmesh.transport.aims.ghost_cells import ghost_cell_density, share_of_ghost_cells, toward_ghost_cell
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.aims.through_glass import bundles_density, share_of_bundles, toward_bundle
from lfmesh.transport.tables.tables import AimTables, LensAim

WIDE_SHARE = 0.1
"""Share of rays to the wide disk if reflections are followed: ghosts come from all over it."""

WIDE_SHARE_OF_STRAYS = 0.3
"""The same if only paths with reflections are estimated."""

WIDE_SHARE_OF_IMAGE_PATH = 0.002
"""The same if no reflections are followed: it only adds light outside the measured opening."""

WIDE_SHARE_OF_FALLBACK = 0.5
"""The same behind an array with aimed rays that do not hold all light, for every estimator, see `aim_proof`."""

EVERYWHERE = 0.5
"""Share of the rays to the wide disk that go everywhere towards the lens instead, from points close before it."""

OVER_HALF_SPHERE = 1.0 / (2.0 * np.pi)
"""Density of directions that are uniform over half of the sphere, 1/sr."""

WIDE_SHARE_WITHIN = 0.5
"""Least share of rays to the wide disk from points so close before the opening that it fills a right angle."""


def with_wide_share(aim: AimTables, share: float, share_without_aim: float | None = None) -> AimTables:
    """Return the aim with another share of sensor rays that go anywhere, if aimed rays hold all light.

    Parameters
    ----------
    aim : AimTables
    share : float
    share_without_aim : float, optional
        The same from points that see no opening.
    """
    if aim.exit.wide_share >= WIDE_SHARE_OF_FALLBACK:
        return aim
    without = aim.exit.share_without_aim if share_without_aim is None else share_without_aim
    return aim._replace(exit=aim.exit._replace(wide_share=share, share_without_aim=without))


def anywhere(aim: LensAim) -> LensAim:
    """Return one side's aim for an unknown opening: every ray goes to the wide disk."""
    opening = aim.opening._replace(far=no_disks(), near=no_disks())
    return aim._replace(opening=opening, wide_share=1.0, share_without_aim=1.0)


@kernel
def aimed(aim: LensAim, p: Vector, numbers: Vector) -> tuple[float, float, float, float]:
    """Return a direction from a point towards the lens, and its density in the mixture, 1/sr.

    From a point that sees no opening, only a share of the rays is sent, to the wide disk; the others have density zero.

    Parameters
    ----------
    aim : LensAim
    p : (3,) float, mm
        Point, camera frame.
    numbers : (3,) float
        Random numbers, uniform in [0, 1): for the choice between aims, and for the place in the chosen one.
    """
    guided = _guided_share(aim, p)
    if guided <= 0.0:
        return aimed_straight(aim, p, numbers)
    choice, u, v = numbers
    if choice >= 1.0 - guided:
        dx, dy, dz = _toward_guide(aim.glass, aim.ghosts, p, (choice - (1.0 - guided), u, v), guided)
        return dx, dy, dz, aimed_density(aim, p, (dx, dy, dz))
    dx, dy, dz, straight = aimed_straight(aim, p, (choice / (1.0 - guided), u, v))
    if straight <= 0.0:
        return dx, dy, dz, 0.0
    return dx, dy, dz, (1.0 - guided) * straight + _guide_density(aim, p, (dx, dy, dz), guided)


@kernel
def aimed_straight(aim: LensAim, p: Vector, numbers: Vector) -> tuple[float, float, float, float]:
    """Return a direction from a point straight towards the lens, and its density among these, 1/sr.

    Parameters
    ----------
    aim, p, numbers
        As for `aimed`.
    """
    choice, u, v = numbers
    disk, share, everywhere = _shares(aim, p)
    if choice < everywhere:
        dz, turn = 1.0 - u, 2.0 * np.pi * v
        across = np.sqrt(1.0 - dz * dz)
        d = across * np.cos(turn), across * np.sin(turn), dz * aim.opening.sense
    elif choice < share:
        d = toward_disk(p, (0.0, 0.0, aim.opening.plane_z, aim.wide_radius), u, v)
    elif disk[3] > 0.0:
        d = toward_disk(p, disk, u, v)
    else:
        return 0.0, 0.0, 1.0, 0.0
    return d[0], d[1], d[2], _straight_density(aim, p, d, disk, share, everywhere)


@kernel
def aimed_density(aim: LensAim, p: Vector, d: Vector) -> float:
    """Return the density, 1/sr, of a direction drawn by `aimed`.

    Parameters
    ----------
    aim : LensAim
    p : (3,) float, mm
        Point, camera frame.
    d : (3,) float
        Unit direction.
    """
    guided = _guided_share(aim, p)
    density = 0.0
    if guided < 1.0:
        disk, share, everywhere = _shares(aim, p)
        density = (1.0 - guided) * _straight_density(aim, p, d, disk, share, everywhere)
    if guided > 0.0:
        density += _guide_density(aim, p, d, guided)
    return density


@inlined
def _guided_share(aim: LensAim, p: Vector) -> float:
    """Return the share of rays that go straight neither to the lens's opening nor to the wide disk."""
    return share_of_bundles(aim.glass, p) + share_of_ghost_cells(aim.ghosts, aim.opening, p)


@inlined
def _toward_guide(glass: Any, ghosts: Any, p: Vector, numbers: Vector, guided: float) -> Vector:
    """Return the direction of such a ray; the first random number is below the share."""
    if glass is not None:
        return toward_bundle(glass, p, numbers)
    return toward_ghost_cell(ghosts, p, (numbers[0] / guided, numbers[1], numbers[2]))


@inlined
def _guide_density(aim: LensAim, p: Vector, d: Vector, guided: float) -> float:
    """Return the density, 1/sr, of such rays times their share."""
    return bundles_density(aim.glass, p, d) + guided * ghost_cell_density(aim.ghosts, p, d)


@inlined
def _shares(aim: LensAim, p: Vector) -> tuple[tuple[float, float, float, float], float, float]:
    """Return the opening's disk, and the shares of straight rays not aimed at it.

    Returns
    -------
    disk : (4,) float, mm
        Centre and radius; radius −1: the point sees none.
    share : float
        Share of rays to the wide disk or everywhere.
    everywhere : float
        Share of rays everywhere.
    """
    opening = aim.opening
    cx, cy, radius = opening_from(opening, p)
    share, everywhere = aim.wide_share if radius > 0.0 else aim.share_without_aim, 0.0
    distance = (opening.plane_z - p[2]) * opening.sense
    if 0.0 < distance < opening.near_depth:
        if radius * radius > (p[0] - cx) ** 2 + (p[1] - cy) ** 2 + distance * distance:
            share = max(share, WIDE_SHARE_WITHIN)
        everywhere = EVERYWHERE * share
    return (cx, cy, opening.plane_z, radius), share, everywhere


@inlined
def _straight_density(
    aim: LensAim, p: Vector, d: Vector, disk: tuple[float, float, float, float], share: float, everywhere: float
) -> float:
    """Return the density, 1/sr, of straight rays for the disk and the shares of `_shares`."""
    wide = disk_density(p, d, (0.0, 0.0, aim.opening.plane_z, aim.wide_radius))
    density = (share - everywhere) * wide
    if everywhere > 0.0 and d[2] * aim.opening.sense > 0.0:
        density += everywhere * OVER_HALF_SPHERE
    if disk[3] > 0.0:
        density += (1.0 - share) * disk_density(p, d, disk)
    return density
