"""Support of the aims: whether aimed rays can follow a given ray, and the widening needed."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import cell_of, centre
from lfmesh.geometry.array.lenslets import shape_of, type_of
from lfmesh.geometry.frame import move_direction, move_point
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.kick_aim import (
    list_cells_of_pixel,
    most_listed_after_kick,
    shown_after_kick,
    wide_share_after_kick,
    without_kick,
)
from lfmesh.transport.aims.lenslet_aim import (
    LISTED,
    ArraySeen,
    lenslets_density,
    most_listed,
    pixel_extent,
)
from lfmesh.transport.aims.lenslet_faces import glass_before_faces, half_width_to, on_lenslet, path_to_apexes
from lfmesh.transport.aims.near_points import NearViewpoints
from lfmesh.transport.aims.pupil import Viewpoints, opening_from
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequences.stop_rays import CameraTables, Rays
from lfmesh.transport.tables.tables import (
    AimTables,
    LensletAim,
    MlaTables,
    Opening,
    SensorTables,
)

Array = NDArray[np.float64]


def beyond_sensor_aim(aim: AimTables, through: CameraTables, rays: Rays) -> Array:
    """Return the factor on the opening's width needed to hold each ray; up to 1: it holds the ray.

    With an array the factor is 0 for rays in the aim and inf for all others.

    Parameters
    ----------
    aim : AimTables
    through : CameraTables
    rays : Rays
    """
    beyond = np.zeros(len(rays.throughput))
    if not through.mla.present:
        if aim.exit.wide_share < 1.0:
            _beyond_exit(rays.sensor, aim.exit.opening, through.frames, beyond)
        return beyond
    if through.mla.apertures is None:
        most = most_listed(aim.lenslets, aim.lenslets.search)
    else:
        most = most_listed_after_kick(aim.lenslets)
    near, cells = np.zeros((most + 1, LISTED)), np.zeros(most + 1, np.int64)
    _outside_cells(
        rays.sensor,
        rays.kick,
        rays.colour,
        aim.lenslets,
        through.mla,
        through.sensor,
        through.frames,
        near,
        cells,
        beyond,
    )
    return beyond


def seen_from_cells(aim: AimTables, through: CameraTables, rays: Rays) -> tuple[Array, Array, Array]:
    """Measure rays in the view of the lenslet that they pass.

    Parameters
    ----------
    aim : AimTables
    through : CameraTables
    rays : Rays

    Returns
    -------
    off, radius : (n,) float64
        Distance, in slope, from the centre of the view, and its radius; −1: the lenslet shows nothing.
    out : (n,) float64
        Distance from the centre of the cell, relative to half of the aimed cell.
    """
    off, radius, out = (np.zeros(len(rays.throughput)) for _ in range(3))
    _measure_in_cells(
        rays.sensor, rays.kick, rays.colour, aim.lenslets, through.mla, through.frames, off, radius, out
    )  # fmt: skip
    return off, radius, out


def beyond_object_aim(
    aim: AimTables, seen: Viewpoints | None, near: NearViewpoints | None, rays: Rays, random: np.random.Generator
) -> tuple[Array, Array]:
    """Return the factors of `beyond_sensor_aim` for far and near points; 0 for rays that miss these.

    Each ray is tested at a random distance within the points' range.

    Parameters
    ----------
    aim : AimTables
    seen : Viewpoints or None
        Viewpoints of the targets.
    near : NearViewpoints or None
        Close viewpoints.
    rays : Rays
    random : Generator
    """
    far_rays, near_rays = np.zeros(len(rays.throughput)), np.zeros(len(rays.throughput))
    if aim.entrance.wide_share >= 1.0:
        return far_rays, near_rays
    opening = aim.entrance.opening
    if seen is not None:
        share = random.random(len(far_rays))
        distance = 1.0 / (share / seen.distance[0] + (1.0 - share) / seen.distance[-1])
        _beyond_at(opening, rays, distance, seen.tangent[-1] * distance, far_rays)
    if near is not None:
        lowest, highest = near.measured[0], near.distance[-1]
        distance = lowest + (highest - lowest) * random.random(len(near_rays))
        _beyond_at(opening, rays, distance, np.full(len(distance), near.height[-1]), near_rays)
    return far_rays, near_rays


def _beyond_at(opening: Opening, rays: Rays, distance: Array, height: Array, beyond: Array) -> None:
    """Write the factors of rays at distances, (n,) mm, if not farther from the axis than heights."""
    t = (opening.plane_z - distance - rays.objects[:, 2]) / rays.objects[:, 5]
    p = rays.objects[:, :3] + t[:, None] * rays.objects[:, 3:]
    inside = np.hypot(p[:, 0], p[:, 1]) <= height
    found = np.zeros(int(inside.sum()))
    _beyond_opening(p[inside], -rays.objects[inside, 3:], opening, found)
    beyond[inside] = found


@kernel
def _beyond_opening(p: Array, d: Array, opening: Opening, beyond: Array) -> None:
    """Write the factor on the disk seen from each point that would make the ray cross it."""
    for i in range(len(beyond)):
        beyond[i] = _off_disk(opening, p[i, 0], p[i, 1], p[i, 2], d[i, 0], d[i, 1], d[i, 2])


@kernel
def _beyond_exit(rays: Array, opening: Opening, frames: Array, beyond: Array) -> None:
    for i in range(len(beyond)):
        x, y, z = move_point(frames, SENSOR_FRAME, CAMERA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        dx, dy, dz = move_direction(frames, SENSOR_FRAME, CAMERA_FRAME, rays[i, 2], rays[i, 3], rays[i, 4])
        beyond[i] = _off_disk(opening, x, y, z, dx, dy, dz)


@kernel
def _off_disk(opening: Opening, x: float, y: float, z: float, dx: float, dy: float, dz: float) -> float:
    cx, cy, radius = opening_from(opening, (x, y, z))
    if radius <= 0.0:
        return np.inf
    t = (opening.plane_z - z) / dz
    return np.hypot(x + t * dx - cx, y + t * dy - cy) / radius


@kernel
def _outside_cells(
    rays: Array, kick: Array, colour: NDArray[np.int64], aim: LensletAim, mla: MlaTables, sensor: SensorTables,
    frames: Array, near: Array, cells: NDArray[np.int64], outside: Array,
) -> None:  # fmt: skip
    """Write inf for each ray (n, 5) that no aimed path from its pixel can follow."""
    extent = pixel_extent(sensor, frames)
    for i in range(len(outside)):
        column = min(max(np.floor(rays[i, 0] / sensor.pixel + 0.5 * sensor.columns), 0), sensor.columns - 1)
        row = min(max(np.floor(rays[i, 1] / sensor.pixel + 0.5 * sensor.rows), 0), sensor.rows - 1)
        x, y = (column + 0.5 - 0.5 * sensor.columns) * sensor.pixel, (row + 0.5 - 0.5 * sensor.rows) * sensor.pixel
        px, py, pz = move_point(frames, SENSOR_FRAME, MLA_FRAME, x, y, 0.0)
        array = ArraySeen(mla, aim, glass_before_faces(mla, colour[i]))
        p = move_point(frames, SENSOR_FRAME, MLA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        listed = list_cells_of_pixel(mla.apertures, array, (px, py, pz), extent, near)
        shown, growth = shown_after_kick(mla.apertures, array, near, listed, cells, p, (kick[i, 0], kick[i, 1]))
        if wide_share_after_kick(growth) > 0.0:
            continue
        d = move_direction(frames, SENSOR_FRAME, MLA_FRAME, -rays[i, 2], -rays[i, 3], -rays[i, 4])
        on_cells, on_wider = lenslets_density(array, shown, p, d)
        if not on_cells + on_wider > 0.0:
            outside[i] = np.inf


@inlined
def _seen_after_kick(apertures: Any, array: ArraySeen, p: Vector, kick: Any) -> tuple[float, Vector]:
    """Return the growth of views by a deflection, and the point that sees them undeflected."""
    if apertures is None:
        return 1.0, p
    return without_kick(array, p, (kick[0], kick[1]))


@kernel
def _measure_in_cells(
    rays: Array, kick: Array, colour: NDArray[np.int64], aim: LensletAim, mla: MlaTables, frames: Array,
    off: Array, radius: Array, out: Array,
) -> None:  # fmt: skip
    """Write the results of `seen_from_cells`; near a border, in the likelier cell."""
    lattice = mla.lenslets.lattice
    half = 0.5 * lattice.pitch + aim.cell_margin
    for i in range(len(off)):
        x, y, z = move_point(frames, SENSOR_FRAME, MLA_FRAME, rays[i, 0], rays[i, 1], 0.0)
        dx, dy, dz = move_direction(frames, SENSOR_FRAME, MLA_FRAME, -rays[i, 2], -rays[i, 3], -rays[i, 4])
        over, glass = 1.0 / abs(z - aim.apex_z), glass_before_faces(mla, colour[i])
        air, depth, growth = path_to_apexes(mla, z)
        sx, sy = dx / abs(dz), dy / abs(dz)
        q = np.sqrt(glass * glass + (glass * glass - 1.0) * (sx * sx + sy * sy))
        gx, gy = growth * sx / q, growth * sy / q
        px, py = x + sx * air + sx / q * depth, y + sy * air + sy / q * depth
        wider, seen_from = _seen_after_kick(mla.apertures, ArraySeen(mla, aim, glass), (x, y, z), kick[i])
        middle = 0.5 * (mla.lenslets.top + mla.lenslets.valley)
        column, row = cell_of(lattice, px + gx * middle, py + gy * middle)
        off[i], radius[i], out[i] = np.inf, 1.0, np.inf
        for r in range(max(row - 2, 0), min(row + 3, lattice.rows)):
            for c in range(max(column - 2, 0), min(column + 3, lattice.columns)):
                cell = r * lattice.columns + c
                cx, cy = centre(lattice, c, r)
                curvature, ex, ey = shape_of(mla.lenslets, c, r)
                kind = type_of(mla.lenslets, c, r)
                met, ax, ay = on_lenslet(
                    mla.lenslets, kind, curvature, px - cx - ex, py - cy - ey, gx, gy, mla.curved_to_lens
                )
                a, b = (cx - seen_from[0]) * over - aim.slope[cell, 0], (cy - seen_from[1]) * over - aim.slope[cell, 1]
                slope, place = np.sqrt(a * a + b * b), half_width_to(lattice, ax + ex, ay + ey) / half
                if not met or max(place, 1.0) > max(out[i], 1.0):
                    continue
                if max(place, 1.0) < max(out[i], 1.0) or slope < off[i]:
                    off[i], out[i] = slope, place
                    radius[i] = wider * np.sqrt(aim.slope_radius2[cell]) if aim.slope_radius2[cell] > 0.0 else -1.0
