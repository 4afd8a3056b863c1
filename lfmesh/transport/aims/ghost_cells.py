"""Directions to the origins of ghosts on the lens, for a camera without an array.

Each ghost has its own pupil for a pixel, often small and far from that of the image path. The disk at the lens is
therefore divided into cells, as seen from the axis and the pixel. Cells are drawn by the light of ghosts in a coarse
trace; the ray goes to a uniform point of the cell. Other rays go to the opening of the image path.
"""

from typing import Any

import numpy as np

from lfmesh.kernels.decorators import inlined
from lfmesh.kernels.search import drawn_by
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.pupil import opening_from
from lfmesh.transport.sequences.ghosts import ANGLES, interval_of_angle, interval_of_height, interval_of_radius
from lfmesh.transport.tables.tables import Opening

SHARE_OF_OPENING = 0.5
"""Share of rays to the opening, from a point that sees it."""


@inlined
def share_of_ghost_cells(ghosts: Any, opening: Opening, p: Vector) -> float:
    """Return the share of rays from a point that go to cells; 0 without ghosts.

    Many ghosts come through the opening of the image path. If it is small, the coarse trace may hit it only by chance.

    Parameters
    ----------
    ghosts : GhostTables or None
        None: numba skips this code.
    opening : Opening
        As seen from the sensor.
    p : (3,) float, mm
        Point, camera frame.
    """
    if ghosts is None:
        return 0.0
    return 1.0 - SHARE_OF_OPENING if opening_from(opening, p)[2] > 0.0 else 1.0


@inlined
def toward_ghost_cell(ghosts: Any, p: Vector, numbers: Vector) -> Vector:
    """Return a direction from a point to a uniform point of a randomly drawn cell at the lens.

    Parameters
    ----------
    ghosts : GhostTables or None
    p : (3,) float, mm
        Point, camera frame, behind the disk at the lens.
    numbers : (3,) float
        Random numbers, uniform in [0, 1): for the cell, and for the point.
    """
    if ghosts is None:
        return 0.0, 0.0, 1.0
    (x, y, z), (choice, u, v) = p, numbers
    until = ghosts.cells[interval_of_height(ghosts, x * x + y * y)]
    cell = drawn_by(until, choice)
    before = until[cell - 1] if cell > 0 else 0.0
    # The rest of the number decides the side of the meridian.
    side = 1.0 if choice - before < 0.5 * (until[cell] - before) else -1.0
    ring, angle = cell // ANGLES, cell % ANGLES
    r = np.sqrt(ghosts.rings[ring] + u * (ghosts.rings[ring + 1] - ghosts.rings[ring]))
    phi = side * (_border(angle) + v * (_border(angle + 1) - _border(angle))) + np.arctan2(y, x)
    dx, dy, dz = r * np.cos(phi) - x, r * np.sin(phi) - y, ghosts.plane_z - z
    scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
    return dx * scale, dy * scale, dz * scale


@inlined
def ghost_cell_density(ghosts: Any, p: Vector, d: Vector) -> float:
    """Return the density, 1/sr, of a direction drawn by `toward_ghost_cell`.

    Parameters
    ----------
    ghosts : GhostTables or None
    p : (3,) float, mm
    d : (3,) float
        Unit direction.
    """
    if ghosts is None:
        return 0.0
    if not d[2] < 0.0:
        return 0.0
    (x, y, z), (dx, dy, dz) = p, d
    t = (ghosts.plane_z - z) / dz
    px, py = x + t * dx, y + t * dy
    r2 = px * px + py * py
    if r2 > ghosts.rings[-1]:
        return 0.0
    ring = interval_of_radius(ghosts, r2)
    angle = interval_of_angle(x * px + y * py, np.sqrt(r2 * (x * x + y * y)))
    until = ghosts.cells[interval_of_height(ghosts, x * x + y * y)]
    cell = ring * ANGLES + angle
    chance = until[cell] - (until[cell - 1] if cell > 0 else 0.0)
    size = (ghosts.rings[ring + 1] - ghosts.rings[ring]) * (_border(angle + 1) - _border(angle))
    return chance / size * t * t / abs(dz)


@inlined
def _border(interval: int) -> float:
    """Return the angle, rad, where an interval of angles begins."""
    return np.arccos(max(1.0 - 2.0 * interval / ANGLES, -1.0))
