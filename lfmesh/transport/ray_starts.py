"""Starts of given rays: the station and the space where each begins."""

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame
from lfmesh.geometry.surfaces.surface import in_place
from lfmesh.geometry.surfaces.tessellation import mesh_heights
from lfmesh.transport.collisions import far_end_mm
from lfmesh.transport.packets.packet import (
    CAMERA_FRAME,
    LENS,
    MLA_FRAME,
    OBJECTS,
    PLATE,
    SENSOR,
    SENSOR_FRAME,
    WORLD_FRAME,
)
from lfmesh.transport.world import World


def located(
    world: World, p: NDArray[np.float64], d: NDArray[np.float64], numbers: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the station and the space where each ray starts, and the rays in the camera frame.

    Parameters
    ----------
    world : World
    p, d : (n, 3) float64
        Position, mm, and direction, world frame.
    numbers : (n,) int64, optional
        Ray numbers in error messages, if not 0 to n − 1.

    Raises
    ------
    LfmeshError
        A ray starts inside the array.
    """
    tables, shape = world.tables, world.lens_shape
    to_camera = tables.frames[WORLD_FRAME, CAMERA_FRAME]
    p, d = frame.points(to_camera, p), frame.directions(to_camera, d)
    r = np.hypot(p[:, 0], p[:, 1])
    # Number of surfaces in front of each point; beyond its rim a surface continues as the plane of the rim.
    behind = np.zeros(len(p), np.int64)
    for s, rim in zip(shape.surfaces, shape.rims, strict=True):
        q = in_place(s, p)
        behind += q[:, 2] > s["vertex_z"] + mesh_heights(s, q[:, 0], q[:, 1], rim)
    count = len(shape.surfaces)
    inside = (behind > 0) & (behind < count) & (r <= max(shape.rims))
    station = np.full(len(p), OBJECTS)
    space = behind.copy()
    station[inside] = LENS
    outline = np.hypot(world.housing.vertices[:, 0], world.housing.vertices[:, 1]).max()
    after = (behind == count) & (p[:, 2] < world.housing.vertices[:, 2].max()) & (r < outline)
    if tables.mla.present:
        q = frame.points(tables.frames[CAMERA_FRAME, MLA_FRAME], p)
        e = frame.directions(tables.frames[CAMERA_FRAME, MLA_FRAME], d)
        lenslets = tables.mla.lenslets
        within = after & (q[:, 2] > lenslets.top) & (q[:, 2] < far_end_mm(tables.mla))
        if within.any():
            number = np.flatnonzero(within)[0] if numbers is None else numbers[within][0]
            raise LfmeshError(f"ray {int(number)} starts inside the microlens array; start it before or behind")
        towards = (q[:, 2] <= lenslets.top) == (e[:, 2] > 0.0)
        lens_side = (q[:, 2] <= lenslets.top) == tables.mla.curved_to_lens
        station[after] = np.where(towards, PLATE, np.where(lens_side, LENS, SENSOR))[after]
    else:
        forward = frame.directions(tables.frames[CAMERA_FRAME, SENSOR_FRAME], d)[:, 2] > 0.0
        station[after] = np.where(forward, SENSOR, LENS)[after]
    if tables.cover is not None:
        # In the cover and behind it too.
        behind_front = frame.points(tables.frames[CAMERA_FRAME, SENSOR_FRAME], p)[:, 2] > tables.cover.front_z
        station[after & behind_front] = SENSOR
    space[after] = count
    # Beside the lens there is air, whichever surfaces lie in front of the point.
    space[station == OBJECTS] = 0
    return station, space, p, d


def refuse_starts_in_the_lens(
    station: NDArray[np.int64], space: NDArray[np.int64], surfaces: int, numbers: NDArray[np.int64]
) -> None:
    """Refuse rays that start in the lens, which the sequential engine does not follow.

    Parameters
    ----------
    station, space : (n,) int64
        From `located`.
    surfaces : int
        Of the lens.
    numbers : (n,) int64
        Numbers of the rays in the message.
    """
    inside = (station == LENS) & (space > 0) & (space < surfaces)
    if inside.any():
        raise LfmeshError(
            f'ray {int(numbers[inside][0])} starts inside the lens: engine = "sequential" follows rays through '
            'all of it; use "mesh"'
        )
