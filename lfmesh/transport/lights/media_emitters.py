"""Emitting media: directions towards random points of them, and the density of those directions.

A ray to emitting media gathers all emission along it, as a scattered ray does. Its direction has the density ∫ t² p dt,
with the density p of points along it. As the whole line counts, small or near flames do not increase the variance. Only
media in the point's body, or in its air, are drawn; light through glass is found by scattered rays alone.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray, ray_of
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.search import drawn_by
from lfmesh.transport.events.bodies import RANK, bodies_round
from lfmesh.transport.events.bounds import slab
from lfmesh.transport.events.crossing import EMITTER_U, draw_two
from lfmesh.transport.events.moving import mover_of_medium, point_between
from lfmesh.transport.events.volume import Line, ray_in_medium
from lfmesh.transport.lights.shadow import Way
from lfmesh.transport.packets.packet import NO_SURFACE, TO_MEDIA, Options, mover_of_frame
from lfmesh.transport.packets.random import uniform
from lfmesh.transport.tables.volumes import Volumes

Array = NDArray[np.float64]


@kernel
def sample(volumes: Volumes, options: Options, packet: Any, key: np.uint64, moving: Any) -> Way:
    """Draw a ray from a packet's point towards a random point of the emitting media in its body, or in air.

    Parameters
    ----------
    volumes : Volumes
    options : Options
    packet : PACKET
    key : uint64
        For the random numbers.
    moving : Moving or None
    """
    inside, ray, drawn = bodies_round(packet) & RANK, ray_of(packet), 0.0
    here = mover_of_frame(packet.frame)
    choice, u = draw_two(options, packet, EMITTER_U)
    line = Line(ray, inside, packet.colour, moving, here)
    found, x, y, z = point_of_media(volumes, line, (choice, u, uniform(key, 0), uniform(key, 1)))
    ux, uy, uz = x - packet.x, y - packet.y, z - packet.z
    distance = np.sqrt(ux * ux + uy * uy + uz * uz)
    if found and distance > 0.0:
        ray = Ray(packet.x, packet.y, packet.z, ux / distance, uy / distance, uz / distance)
        drawn = density(volumes, Line(ray, inside, packet.colour, moving, here))
    return Way(TO_MEDIA, NO_SURFACE, ray, np.inf, 1.0, drawn)


@inlined
def _light_drawn(volumes: Volumes, number: int, line: Line) -> float:
    """Return the weight of a medium when drawn from the start of a line; 0: elsewhere, dark, or unbounded.

    Approximates the medium's light: power over the mean squared distance of its parts.
    """
    row, power = volumes.rows[number], volumes.powers[number]
    if row.inside != line.place or not 0.0 < power < np.inf:
        return 0.0
    own, d2 = ray_in_medium(volumes, number, line), 0.0
    for axis in range(3):
        low, high, at = row.low[axis], row.high[axis], (own.x, own.y, own.z)[axis]
        d2 += (at - 0.5 * (low + high)) ** 2 + (high - low) ** 2 / 12.0
    return power / d2


@kernel
def point_of_media(
    volumes: Volumes, line: Line, numbers: tuple[float, float, float, float]
) -> tuple[bool, float, float, float]:  # fmt: skip
    """Return a random point of the emitting media in a line's body, or in air, in the line's frame; False: none.

    Parameters
    ----------
    volumes : Volumes
    line : Line
        Starts at the lit point; its direction is not used.
    numbers : (4,) float
        Uniform in [0, 1).
    """
    choice, u, v, w = numbers
    whole = 0.0
    for number in range(len(volumes.rows)):
        whole += _light_drawn(volumes, number, line)
    if whole <= 0.0:
        return False, 0.0, 0.0, 0.0
    rest, drawn, share = choice * whole, 0, 0.0
    for number in range(len(volumes.rows)):
        light = _light_drawn(volumes, number, line)
        if light > 0.0 and rest >= 0.0:
            # The remainder of the number is a new random number.
            drawn, share = number, min(rest / light, 1.0)
        rest -= light
    x, y, z, _ = drawn_point(volumes, drawn, share, u, v, w)
    x, y, z = point_between(line.moving, mover_of_medium(line.moving, drawn), line.mover, x, y, z)
    return True, x, y, z


@kernel
def density(volumes: Volumes, line: Line) -> float:
    """Return the density, 1/sr, of a line's direction among directions to `point_of_media`.

    Parameters
    ----------
    volumes : Volumes
    line : Line
    """
    whole, total = 0.0, 0.0
    for number in range(len(volumes.rows)):
        light = _light_drawn(volumes, number, line)
        if light > 0.0:
            whole += light
            total += light * _density_in(volumes, number, ray_in_medium(volumes, number, line))
    return total / whole if whole > 0.0 else 0.0


@inlined
def _cone(first: float, last: float) -> float:
    """Return ∫ t² dt between two distances."""
    return (last - first) * (last * last + last * first + first * first) / 3.0


@kernel
def _density_in(volumes: Volumes, number: int, ray: Ray) -> float:
    """Return the density, 1/sr, of a ray's direction, in a medium's own frame, among directions to `drawn_point`."""
    row = volumes.rows[number]
    first, last = 0.0, np.inf
    for axis in range(3):
        a, b = slab(row.low[axis], row.high[axis], (ray.x, ray.y, ray.z)[axis], (ray.dx, ray.dy, ray.dz)[axis])
        first, last = max(first, a), min(last, b)
    if first >= last:
        return 0.0
    if row.drawn == 0:
        size = (row.high[0] - row.low[0]) * (row.high[1] - row.low[1]) * (row.high[2] - row.low[2])
        return _cone(first, last) / size
    i, x_end, x_step, x_way = _at_voxel(row, 0, ray.x, ray.dx, first)
    j, y_end, y_step, y_way = _at_voxel(row, 1, ray.y, ray.dy, first)
    k, z_end, z_step, z_way = _at_voxel(row, 2, ray.z, ray.dz, first)
    total, t = 0.0, first
    for _ in range(row.cells[0] + row.cells[1] + row.cells[2]):
        if not t < last:
            break
        end = min(min(x_end, y_end), min(z_end, last))
        cell = row.first + (i * row.cells[1] + j) * row.cells[2] + k
        below = volumes.until[cell - 1] if cell > row.first else 0.0
        if end > t:
            total += (volumes.until[cell] - below) * _cone(t, end)
        t = max(t, end)
        if x_end <= end:
            i, x_end = i + x_step, x_end + x_way
        elif y_end <= end:
            j, y_end = j + y_step, y_end + y_way
        elif z_end <= end:
            k, z_end = k + z_step, z_end + z_way
        if i < 0 or j < 0 or k < 0 or i >= row.cells[0] or j >= row.cells[1] or k >= row.cells[2]:
            break
    return total / (row.spacing[0] * row.spacing[1] * row.spacing[2])


@inlined
def _at_voxel(row: Any, axis: int, o: float, d: float, t: float) -> tuple[int, float, int, float]:
    """Return the voxel along an axis at a distance on a ray, the distance at its end, the step, and its length, mm."""
    spacing = row.spacing[axis]
    voxel = min(max(int(np.floor((o + t * d - row.low[axis]) / spacing)), 0), row.cells[axis] - 1)
    if d == 0.0:
        return voxel, np.inf, 0, np.inf
    step = 1 if d > 0.0 else -1
    end = (row.low[axis] + (voxel + (1 if d > 0.0 else 0)) * spacing - o) / d
    return voxel, end, step, spacing / abs(d)


@inlined
def drawn_point(
    volumes: Volumes, number: int, choice: float, u: float, v: float, w: float
) -> tuple[float, float, float, float]:
    """Return a random point of a medium's box, in the frame of its mover, and its density, 1/mm³.

    Parameters
    ----------
    volumes : Volumes
    number : int
        Number of the medium.
    choice, u, v, w : float
        Uniform in [0, 1).
    """
    row = volumes.rows[number]
    own = row.to_own
    lx, ly, lz = row.high[0] - row.low[0], row.high[1] - row.low[1], row.high[2] - row.low[2]
    px, py, pz = row.low[0], row.low[1], row.low[2]
    density = 1.0 / (lx * ly * lz)
    if row.drawn > 0:
        until = volumes.until[row.first : row.first + row.drawn]
        cell = drawn_by(until, choice)
        density *= (until[cell] - (until[cell - 1] if cell > 0 else 0.0)) * row.drawn
        ny, nz = row.cells[1], row.cells[2]
        lx, ly, lz = row.spacing[0], row.spacing[1], row.spacing[2]
        px, py, pz = px + (cell // (ny * nz)) * lx, py + (cell // nz % ny) * ly, pz + (cell % nz) * lz
    px, py, pz = px + u * lx - own[0, 3], py + v * ly - own[1, 3], pz + w * lz - own[2, 3]
    # The frame's axes are orthogonal: the transposed matrix is the inverse one.
    x = own[0, 0] * px + own[1, 0] * py + own[2, 0] * pz
    y = own[0, 1] * px + own[1, 1] * py + own[2, 1] * pz
    z = own[0, 2] * px + own[1, 2] * py + own[2, 2] * pz
    return x, y, z, density
