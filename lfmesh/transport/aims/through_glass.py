"""Aim at the lens through glass or liquid, from points inside and behind it.

Object space before the camera is divided into cells. Each has a few known bundles of directions that lead to the lens
through glass: refracted by a plate, reflected at the wall of a tank, around both sides of a ball (`render.glass_aim`).
A bundle is an ellipse of directions with a centre that moves linearly with the point. Other rays go straight to the
lens's opening, see `mixture`.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector

CELL = np.dtype(
    [
        ("axis", "i8"),  # axis of its division, camera frame; −1: not divided
        ("border", "f8"),  # mm
        ("below", "i8"),  # number of the cell on the lower side of the border
        ("above", "i8"),
        ("straight", "f8"),  # share of rays that are aimed as if there were no glass
        ("first", "i8"),  # number of its first bundle
        ("bundles", "i8"),  # number of its bundles
    ]
)

BUNDLE = np.dtype(
    [
        ("share", "f8"),  # fraction of the cell's rays
        ("point", "f8", (3,)),  # mm, camera frame
        ("axes", "f8", (3, 3)),  # unit vectors, camera frame; slopes: components along the first two over the third
        ("slope", "f8", (2,)),  # of the ellipse's centre, seen from the point
        ("per_mm", "f8", (2, 3)),  # change of that slope with the position, 1/mm
        ("stretch", "f8", (2, 2)),  # from the unit disk to slopes
        ("squeeze", "f8", (2, 2)),  # from slopes to the unit disk
        ("density", "f8"),  # in slopes, of directions uniform in the ellipse
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
        Share of a bundle's rays that go to a wider ellipse.
    width : float
        Ratio of the wider ellipse to the bundle's.
    """

    cells: NDArray[np.void]
    bundles: NDArray[np.void]
    wide_share: float
    width: float


@inlined
def cell_at(cells: NDArray[np.void], p: Vector) -> int:
    """Return the number of the undivided cell that contains a point.

    Parameters
    ----------
    cells : (n,) CELL
    p : (3,) float, mm
        Camera frame.
    """
    number = 0
    while cells[number].axis >= 0:
        cell = cells[number]
        place = p[0] if cell.axis == 0 else (p[1] if cell.axis == 1 else p[2])
        number = cell.below if place < cell.border else cell.above
    return number


@inlined
def share_of_bundles(glass: Any, p: Vector) -> float:
    """Return the share of rays from a point through bundles; 0 where no glass is known.

    Parameters
    ----------
    glass : GlassAim or None
        None: nothing is aimed through glass, and numba skips this code.
    p : (3,) float, mm
    """
    if glass is None:
        return 0.0
    cell = glass.cells[cell_at(glass.cells, p)]
    return 1.0 - cell.straight if cell.bundles > 0 else 0.0


@inlined
def toward_bundle(glass: Any, p: Vector, numbers: Vector) -> Vector:
    """Return a direction from a point into the ellipse of one of its bundles.

    Parameters
    ----------
    glass : GlassAim or None
    p : (3,) float, mm
    numbers : (3,) float
        Random numbers, uniform in [0, 1), the first below the share of the bundles.
    """
    if glass is None:
        return 0.0, 0.0, 1.0
    choice, u, v = numbers
    cell = glass.cells[cell_at(glass.cells, p)]
    which, last = cell.first, cell.first + cell.bundles - 1
    while which < last and choice >= glass.bundles[which].share:
        choice -= glass.bundles[which].share
        which += 1
    bundle = glass.bundles[which]
    radius, phi = np.sqrt(u), 2.0 * np.pi * v
    if choice < glass.wide_share * bundle.share:
        radius *= glass.width
    a, b = radius * np.cos(phi), radius * np.sin(phi)
    cx, cy = _centre(bundle, p)
    stretch, axes = bundle.stretch, bundle.axes
    sx, sy = cx + stretch[0, 0] * a + stretch[0, 1] * b, cy + stretch[1, 0] * a + stretch[1, 1] * b
    over = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
    return (
        (sx * axes[0, 0] + sy * axes[1, 0] + axes[2, 0]) * over,
        (sx * axes[0, 1] + sy * axes[1, 1] + axes[2, 1]) * over,
        (sx * axes[0, 2] + sy * axes[1, 2] + axes[2, 2]) * over,
    )


@kernel
def bundles_density(glass: Any, p: Vector, d: Vector) -> float:
    """Return the density, 1/sr, of a point's rays through bundles, times their share.

    Parameters
    ----------
    glass : GlassAim or None
    p : (3,) float, mm
    d : (3,) float
        Unit direction.
    """
    density = 0.0
    if glass is None:
        return density
    cell = glass.cells[cell_at(glass.cells, p)]
    for i in range(cell.first, cell.first + cell.bundles):
        bundle = glass.bundles[i]
        place, along = place_in_bundle(bundle, p, d)
        even = 0.0
        if place <= 1.0:
            even = 1.0 - glass.wide_share
        if place <= glass.width * glass.width:
            even += glass.wide_share / (glass.width * glass.width)
        if even > 0.0:
            # The area element in slopes is dω / cos³.
            density += bundle.share * even * bundle.density / (along * along * along)
    return density


@inlined
def place_in_bundle(bundle: Any, p: Vector, d: Vector) -> tuple[float, float]:
    """Return a direction's squared distance from a bundle's centre, in its ellipse, and the cosine to its axis.

    Parameters
    ----------
    bundle : BUNDLE
    p : (3,) float, mm
        Point, camera frame.
    d : (3,) float
        Unit direction, camera frame.
    """
    axes = bundle.axes
    along = axes[2, 0] * d[0] + axes[2, 1] * d[1] + axes[2, 2] * d[2]
    if along <= 0.0:
        return np.inf, 0.0
    cx, cy = _centre(bundle, p)
    sx = (axes[0, 0] * d[0] + axes[0, 1] * d[1] + axes[0, 2] * d[2]) / along - cx
    sy = (axes[1, 0] * d[0] + axes[1, 1] * d[1] + axes[1, 2] * d[2]) / along - cy
    squeeze = bundle.squeeze
    a, b = squeeze[0, 0] * sx + squeeze[0, 1] * sy, squeeze[1, 0] * sx + squeeze[1, 1] * sy
    return a * a + b * b, along


@inlined
def _centre(bundle: Any, p: Vector) -> tuple[float, float]:
    """Return the slopes of a bundle's centre seen from a point."""
    ax, ay, az = p[0] - bundle.point[0], p[1] - bundle.point[1], p[2] - bundle.point[2]
    per_mm = bundle.per_mm
    return (
        bundle.slope[0] + per_mm[0, 0] * ax + per_mm[0, 1] * ay + per_mm[0, 2] * az,
        bundle.slope[1] + per_mm[1, 0] * ax + per_mm[1, 1] * ay + per_mm[1, 2] * az,
    )
