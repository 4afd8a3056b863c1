"""Aim at the lens through bodies of glass or liquid, from points inside them and behind them.

Object space before the camera is divided into cells. In each of them a few bundles of directions are known that lead to
the lens by way of glass: refracted through a plate, reflected at the wall of a tank, round both sides of a ball
(`render.glass_aim`). A bundle is an ellipse of directions whose centre moves linearly with the point. Beside them some
rays go straight to the lens's opening. As with `mixture`, aiming decides where samples go, and a ray is weighted by the
density of the whole mixture.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aiming.mixture import aimed, aimed_density
from lfmesh.transport.tables.tables import AimTables

CELL = np.dtype(
    [
        ("axis", "i8"),  # along which it is divided, camera frame; −1: not divided
        ("border", "f8"),  # mm
        ("below", "i8"),  # number of the cell on the lower side of the border
        ("above", "i8"),
        ("straight", "f8"),  # share of rays that are aimed as if there were no glass
        ("first", "i8"),  # of its bundles
        ("bundles", "i8"),  # number of them
    ]
)

BUNDLE = np.dtype(
    [
        ("share", "f8"),  # of the cell's rays
        ("point", "f8", (3,)),  # mm, camera frame
        ("axes", "f8", (3, 3)),  # unit vectors, camera frame; slopes are those along the first two over the third's
        ("slope", "f8", (2,)),  # of the ellipse's centre from the point
        ("per_mm", "f8", (2, 3)),  # change of that for each mm that a point is off, 1/mm
        ("stretch", "f8", (2, 2)),  # from the unit disk to slopes
        ("squeeze", "f8", (2, 2)),  # from slopes to the unit disk
        ("density", "f8"),  # in slopes, of directions even in the ellipse
    ]
)


@by_address
class GlassAim(NamedTuple):
    """Directions that lead to the lens through glass.

    Attributes
    ----------
    cells : (n,) CELL
        The first holds all others.
    bundles : (m,) BUNDLE
    wide_share : float
        Share of a bundle's rays that go to an ellipse that is wider.
    width : float
        By how much it is wider.
    """

    cells: NDArray[np.void]
    bundles: NDArray[np.void]
    wide_share: float
    width: float


@inlined
def cell_at(cells: NDArray[np.void], x: float, y: float, z: float) -> int:
    """Return the number of the undivided cell that a point is in.

    Parameters
    ----------
    cells : (n,) CELL
    x, y, z : float, mm
        Camera frame.
    """
    number = 0
    while cells[number].axis >= 0:
        cell = cells[number]
        place = x if cell.axis == 0 else (y if cell.axis == 1 else z)
        number = cell.below if place < cell.border else cell.above
    return number


@inlined
def _centre(bundle: Any, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the slopes of the centre of a bundle as seen from a point."""
    ax, ay, az = x - bundle.point[0], y - bundle.point[1], z - bundle.point[2]
    per_mm = bundle.per_mm
    return (
        bundle.slope[0] + per_mm[0, 0] * ax + per_mm[0, 1] * ay + per_mm[0, 2] * az,
        bundle.slope[1] + per_mm[1, 0] * ax + per_mm[1, 1] * ay + per_mm[1, 2] * az,
    )


@inlined
def place_in_bundle(bundle: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> tuple[float, float]:
    """Return the squared distance of a direction from a bundle's centre, over its ellipse, and the cosine to its axis.

    Parameters
    ----------
    bundle : BUNDLE
    x, y, z : float, mm
        The point, camera frame.
    dx, dy, dz : float
        Unit direction, camera frame.
    """
    axes = bundle.axes
    along = axes[2, 0] * dx + axes[2, 1] * dy + axes[2, 2] * dz
    if along <= 0.0:
        return np.inf, 0.0
    cx, cy = _centre(bundle, x, y, z)
    sx = (axes[0, 0] * dx + axes[0, 1] * dy + axes[0, 2] * dz) / along - cx
    sy = (axes[1, 0] * dx + axes[1, 1] * dy + axes[1, 2] * dz) / along - cy
    squeeze = bundle.squeeze
    a, b = squeeze[0, 0] * sx + squeeze[0, 1] * sy, squeeze[1, 0] * sx + squeeze[1, 1] * sy
    return a * a + b * b, along


@inlined
def _drawn(bundle: Any, x: float, y: float, z: float, radius: float, phi: float) -> tuple[float, float, float]:
    """Return the unit direction from a point to a place of a bundle's ellipse, given in its radii."""
    a, b = radius * np.cos(phi), radius * np.sin(phi)
    cx, cy = _centre(bundle, x, y, z)
    stretch, axes = bundle.stretch, bundle.axes
    sx, sy = cx + stretch[0, 0] * a + stretch[0, 1] * b, cy + stretch[1, 0] * a + stretch[1, 1] * b
    over = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
    return (
        (sx * axes[0, 0] + sy * axes[1, 0] + axes[2, 0]) * over,
        (sx * axes[0, 1] + sy * axes[1, 1] + axes[2, 1]) * over,
        (sx * axes[0, 2] + sy * axes[1, 2] + axes[2, 2]) * over,
    )


@kernel
def _density(through: Any, aim: AimTables, number: int, ray: tuple[float, ...]) -> float:
    """Return the density, 1/sr, with which a cell's rays go in a direction: `ray` holds point and direction."""
    x, y, z, dx, dy, dz = ray
    cell = through.cells[number]
    density = 0.0
    if cell.straight > 0.0:
        density = cell.straight * aimed_density(
            x, y, z, dx, dy, dz, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim
        )
    for i in range(cell.first, cell.first + cell.bundles):
        bundle = through.bundles[i]
        place, along = place_in_bundle(bundle, x, y, z, dx, dy, dz)
        even = 0.0
        if place <= 1.0:
            even = 1.0 - through.wide_share
        if place <= through.width * through.width:
            even += through.wide_share / (through.width * through.width)
        if even > 0.0:
            # An area in slopes is dω / cos³.
            density += bundle.share * even * bundle.density / (along * along * along)
    return density


@kernel
def aimed_from(
    through: Any, aim: AimTables, x: float, y: float, z: float, choice: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a direction from a point towards the lens, and its density, 1/sr, as `aimed` does.

    Parameters
    ----------
    through : GlassAim or None
        None: nothing is aimed through glass, and numba compiles nothing of it.
    aim : AimTables
    x, y, z : float, mm
        The point, camera frame.
    choice, u, v : float
        Random numbers, uniform in [0, 1).
    """
    if through is not None:
        number = cell_at(through.cells, x, y, z)
        cell = through.cells[number]
        if cell.bundles > 0:
            if choice < cell.straight:
                dx, dy, dz, straight = aimed(
                    x, y, z, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim,
                    choice / cell.straight, u, v,
                )  # fmt: skip
                if straight <= 0.0:
                    return 0.0, 0.0, 1.0, 0.0
            else:
                choice -= cell.straight
                which, last = cell.first, cell.first + cell.bundles - 1
                while which < last and choice >= through.bundles[which].share:
                    choice -= through.bundles[which].share
                    which += 1
                radius = np.sqrt(u)
                if choice < through.wide_share * through.bundles[which].share:
                    radius *= through.width
                dx, dy, dz = _drawn(through.bundles[which], x, y, z, radius, 2.0 * np.pi * v)
            return dx, dy, dz, _density(through, aim, number, (x, y, z, dx, dy, dz))
    return aimed(x, y, z, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim, choice, u, v)


@kernel
def aimed_density_from(
    through: Any, aim: AimTables, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> float:
    """Return the density, 1/sr, with which `aimed_from` draws a direction from a point; parameters as there.

    Parameters
    ----------
    through, aim, x, y, z
        As for `aimed_from`.
    dx, dy, dz : float
        Unit direction, camera frame.
    """
    if through is not None:
        number = cell_at(through.cells, x, y, z)
        if through.cells[number].bundles > 0:
            return _density(through, aim, number, (x, y, z, dx, dy, dz))
    return aimed_density(x, y, z, dx, dy, dz, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim)
