"""Aim at the lens from points inside bodies of glass or liquid, whose faces bend light on its way out.

For nodes of a lattice in each such body the ray is known that leaves the body through the middle of the lens's opening,
and how far its slopes change where it is to meet another point of the opening (`render.glass_aim`). Between the nodes
both are interpolated. As with `mixture`, aiming decides where samples go, and a ray is weighted by its own density.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.by_address import by_address
from lfmesh.geometry.frame import point_through
from lfmesh.kernel import inlined, kernel
from lfmesh.transport.aiming.mixture import aimed, aimed_density
from lfmesh.transport.aiming.pupil import opening_from
from lfmesh.transport.tables.tables import AimTables

Array = NDArray[np.float64]

LATTICE = np.dtype(
    [
        ("rank", "i8"),  # of the body
        ("to_own", "f8", (3, 4)),  # from the camera frame into the lattice's own
        ("low", "f8", (3,)),  # mm, node 0
        ("step", "f8", (3,)),  # mm between nodes
        ("count", "i8", (3,)),  # nodes along each axis
        ("first", "i8"),  # first of the nodes
    ]
)

WIDENED = 2.0
"""Radius of the wide disk over that of the wide disk that points in air are aimed at."""

VALUES = 10
"""Of a node: whether it is known; slopes of its ray; slopes where that leaves; slopes for each mm of the opening; by
how much rays from near it miss the points that they are aimed at, mm."""


@by_address
class GlassAim(NamedTuple):
    """Rays from inside bodies to the lens's opening."""

    lattices: NDArray[np.void]  # (bodies,) LATTICE
    nodes: Array  # (nodes, VALUES)


class Way(NamedTuple):
    """How rays go from a point inside a body to the plane of the opening.

    Attributes
    ----------
    known : bool
    sx, sy : float
        Slopes dx/dz and dy/dz of the ray through the plane's centre.
    ex, ey : float
        Its slopes in air.
    xx, xy, yx, yy : float, 1/mm
        Change of sx and sy for each mm along x and along y in the plane.
    slack : float, mm
        Uncertainty of the point that is met.
    """

    known: bool
    sx: float
    sy: float
    ex: float
    ey: float
    xx: float
    xy: float
    yx: float
    yy: float
    slack: float


@kernel
def way_out(through: GlassAim, place: int, x: float, y: float, z: float) -> Way:
    """Return how rays go from a point to the opening, between the known nodes round it.

    Parameters
    ----------
    through : GlassAim
    place : int
        Rank of the body that the point is in.
    x, y, z : float, mm
        Camera frame.
    """
    for number in range(len(through.lattices)):
        lattice = through.lattices[number]
        if lattice.rank != place:
            continue
        px, py, pz = point_through(lattice.to_own, x, y, z)
        count, low, step = lattice.count, lattice.low, lattice.step
        a = min(max((px - low[0]) / step[0], 0.0), count[0] - 1.0)
        b = min(max((py - low[1]) / step[1], 0.0), count[1] - 1.0)
        c = min(max((pz - low[2]) / step[2], 0.0), count[2] - 1.0)
        i, j, k = min(int(a), count[0] - 2), min(int(b), count[1] - 2), min(int(c), count[2] - 2)
        a, b, c = a - i, b - j, c - k
        whole, sx, sy, ex, ey, xx, xy, yx, yy, slack = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for corner in range(8):
            di, dj, dk = corner & 1, corner >> 1 & 1, corner >> 2
            node = through.nodes[lattice.first + ((i + di) * count[1] + j + dj) * count[2] + k + dk]
            share = (a if di else 1.0 - a) * (b if dj else 1.0 - b) * (c if dk else 1.0 - c) * node[0]
            whole += share
            sx, sy, ex, ey = sx + share * node[1], sy + share * node[2], ex + share * node[3], ey + share * node[4]
            xx, xy, yx, yy = xx + share * node[5], xy + share * node[6], yx + share * node[7], yy + share * node[8]
            slack += share * node[9]
        if whole > 0.0:
            over = 1.0 / whole
            return Way(
                True, sx * over, sy * over, ex * over, ey * over, xx * over, xy * over, yx * over, yy * over,
                slack * over,
            )  # fmt: skip
    return Way(False, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@inlined
def _disks(aim: AimTables, way: Way, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return centre and radius of the opening, radius of the wide disk, and the share that goes to the latter."""
    far = aim.entrance.plane_z - z
    cx, cy, radius = opening_from(aim.entrance, -far * way.ex, -far * way.ey, z)
    narrow = aim.entrance.known and radius > 0.0
    share = 1.0
    if aim.entrance.known:
        share = aim.wide_share if narrow else aim.share_without_aim
    wide = WIDENED * aim.front_radius + way.slack
    return cx, cy, min(radius + way.slack, wide) if narrow else -1.0, wide, share


@inlined
def _density(aim: AimTables, way: Way, disks: Any, px: float, py: float, sx: float, sy: float) -> float:
    """Return the density, 1/sr, of the direction to a point of the opening's plane."""
    cx, cy, radius, wide, share = disks
    on_plane = 0.0
    if px * px + py * py <= wide * wide:
        on_plane += share / (np.pi * wide * wide)
    if radius > 0.0 and (px - cx) ** 2 + (py - cy) ** 2 <= radius * radius:
        on_plane += (1.0 - share) / (np.pi * radius * radius)
    # An area in slopes is dω / cos³.
    return on_plane / abs(way.xx * way.yy - way.xy * way.yx) * (1.0 + sx * sx + sy * sy) ** 1.5


@kernel
def aimed_from(
    through: Any, place: int, aim: AimTables, x: float, y: float, z: float, choice: float, u: float, v: float
) -> tuple[float, float, float, float]:
    """Return a direction from a point in air or inside a body towards the lens, and its density, 1/sr, as `aimed` does.

    Parameters
    ----------
    through : GlassAim or None
        None: nothing is aimed through glass, and numba compiles nothing of it.
    place : int
        Rank of the body that the point is in; 0: air.
    aim : AimTables
    x, y, z : float, mm
        The point, camera frame.
    choice, u, v : float
        Random numbers, uniform in [0, 1).
    """
    if through is not None and place != 0 and z < aim.entrance.plane_z:
        way = way_out(through, place, x, y, z)
        if way.known:
            disks = _disks(aim, way, x, y, z)
            cx, cy, radius, wide, share = disks
            if choice < share:
                cx, cy, radius = 0.0, 0.0, wide
            elif radius <= 0.0:
                return 0.0, 0.0, 1.0, 0.0
            r, phi = radius * np.sqrt(u), 2.0 * np.pi * v
            px, py = cx + r * np.cos(phi), cy + r * np.sin(phi)
            sx, sy = way.sx + way.xx * px + way.xy * py, way.sy + way.yx * px + way.yy * py
            density = _density(aim, way, disks, px, py, sx, sy)
            over = 1.0 / np.sqrt(1.0 + sx * sx + sy * sy)
            return sx * over, sy * over, over, density
    return aimed(x, y, z, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim, choice, u, v)


@kernel
def aimed_density_from(
    through: Any, place: int, aim: AimTables, x: float, y: float, z: float, dx: float, dy: float, dz: float
) -> float:
    """Return the density, 1/sr, with which `aimed_from` draws a direction from a point; parameters as there.

    Parameters
    ----------
    through, place, aim, x, y, z
        As for `aimed_from`.
    dx, dy, dz : float
        Unit direction, camera frame.
    """
    if through is not None and place != 0 and z < aim.entrance.plane_z:
        way = way_out(through, place, x, y, z)
        if way.known:
            if dz <= 0.0:
                return 0.0
            sx, sy = dx / dz, dy / dz
            a, b = sx - way.sx, sy - way.sy
            over = 1.0 / (way.xx * way.yy - way.xy * way.yx)
            px, py = (way.yy * a - way.xy * b) * over, (way.xx * b - way.yx * a) * over
            return _density(aim, way, _disks(aim, way, x, y, z), px, py, sx, sy)
    return aimed_density(x, y, z, dx, dy, dz, aim.entrance, aim.front_radius, aim.wide_share, aim.share_without_aim)
