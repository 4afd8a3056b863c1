"""Many rays along a sequence of the plane faces behind the lens: the sensor's cover, and the sensor as a mirror.

Faces are counted from the lens to the sensor: the front and the rear face of the cover, if there is one, then the
sensor. Between the cover's faces is its glass; everywhere else is air.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import both, select
from lfmesh.transport.events.crossing import refracted
from lfmesh.transport.events.interface import shares_from
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequential.lens_bundle import (
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    MET,
    WEIGHT,
    X,
    Y,
    Z,
    empty_bundle,
    move_bundle,
)
from lfmesh.transport.sequential.reflections import NEAR, Array, Arrived, load_rays, store
from lfmesh.transport.tables.cover import FRONT_ROW, CoverTables
from lfmesh.transport.tables.tables import AIR, SensorTables, Tables

SENSOR_BEHIND_COVER = 2
"""Number of the sensor among the faces where there is a cover; without one it is the only face."""


def count_faces(tables: Tables) -> int:
    """Return how many faces of the cover, and of a sensor that reflects, are behind lens and array."""
    return (2 if tables.cover is not None else 0) + (1 if tables.sensor.reflectance > 0.0 else 0)


def follow_plane_faces(
    rays: Arrived, tables: Tables, faces: tuple[int, ...], reflected: tuple[bool, ...], colour: int = 0
) -> None:
    """Take rays (camera frame) along a sequence of plane faces.

    Parameters
    ----------
    rays : Arrived
        Changed in place.
    tables : Tables
    faces : tuple of int
    reflected : tuple of bool
        Whether they are reflected at each of them; else they are refracted.
    colour : int
        Number of the wavelength.
    """
    _follow(
        rays, tables.cover, tables.sensor, np.array(faces, np.int64), np.array(reflected, np.bool_), tables.frames,
        colour, empty_bundle(),
    )  # fmt: skip


@kernel
def _follow(
    rays: Arrived, cover: Any, sensor: SensorTables, faces: NDArray[np.int64], reflected: NDArray[np.bool_],
    frames: Array, colour: int, bundle: Array,
) -> None:  # fmt: skip
    for first in range(0, len(rays.weight), BLOCK):
        count = load_rays(bundle, rays, first)
        along_planes(bundle, cover, sensor, faces, reflected, frames, colour)
        store(bundle, rays, first, count)


@kernel
def along_planes(
    bundle: Array, cover: Any, sensor: SensorTables, faces: NDArray[np.int64], reflected: NDArray[np.bool_],
    frames: Array, colour: int,
) -> None:  # fmt: skip
    """Take a bundle (camera frame) along a sequence of plane faces.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    cover : CoverTables, or None
    sensor : SensorTables
    faces : (n,) int64
        The faces, in the order in which they are met.
    reflected : (n,) bool
        Whether the rays are reflected at each of them.
    frames : (6, 6, 3, 4) float64
    colour : int
        Number of the wavelength.
    """
    move_bundle(bundle, frames[CAMERA_FRAME, SENSOR_FRAME])
    for step in range(len(faces)):
        _at_face(bundle, cover, sensor, faces[step], reflected[step], colour)
    move_bundle(bundle, frames[SENSOR_FRAME, CAMERA_FRAME])


@inlined
def _at_face(bundle: Array, cover: Any, sensor: SensorTables, face: int, mirrors: bool, colour: int) -> None:
    """Take rays (sensor frame) to a face, and reflect or refract them there."""
    if cover is not None and face != SENSOR_BEHIND_COVER:
        _at_cover(bundle, cover, face, mirrors, colour)
    else:
        _mirror_at_sensor(bundle, sensor)


class Detected(NamedTuple):
    """Power that pixels detect of rays that fly to the sensor from behind the last face.

    Attributes
    ----------
    weight : (n,) float64
        What is detected of each ray's.
    side : (n,) int64
        On which of the pixels' eight sides it passes the sensor's plane; 0: on a pixel, 9: it flies away from there.
    """

    weight: Array
    side: NDArray[np.int64]


def detected(rays: Arrived, tables: Tables) -> Detected:
    """Return what pixels detect of rays (camera frame) that fly to the sensor from behind the last face.

    Parameters
    ----------
    rays : Arrived
    tables : Tables
    """
    found = Detected(np.empty(len(rays.weight)), np.empty(len(rays.weight), np.int64))
    _detect(rays, tables.frames[CAMERA_FRAME, SENSOR_FRAME], tables.sensor, found)
    return found


@kernel
def _detect(rays: Arrived, move: Array, sensor: SensorTables, found: Detected) -> None:
    half_x, half_y = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    for i in range(len(rays.weight)):
        p, d = rays.position[i], rays.direction[i]
        x, y, z = point_through(move, p[0], p[1], p[2])
        dx, dy, dz = direction_through(move, d[0], d[1], d[2])
        side = 9
        if dz > 0.0 and z <= 0.0:
            x, y = x - z / dz * dx, y - z / dz * dy
            side = 0 if abs(x) <= half_x else (1 if x > 0.0 else 2)
            side += 0 if abs(y) <= half_y else (3 if y > 0.0 else 6)
        found.side[i] = side
        found.weight[i] = rays.weight[i] * (1.0 - sensor.reflectance) if side == 0 else 0.0


@kernel
def _mirror_at_sensor(bundle: Array, sensor: SensorTables) -> None:
    """Reflect rays (sensor frame) at the pixels; beside them they end."""
    half_x, half_y = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    for i in range(BLOCK):
        t = -bundle[Z + i] / bundle[DZ + i]
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        held = both(abs(x) <= half_x, abs(y) <= half_y)
        ends = both(bundle[ENDED_ON + i] == 0.0, not both(both(bundle[DZ + i] > 0.0, t >= 0.0), held))
        bundle[X + i], bundle[Y + i], bundle[Z + i] = x, y, 0.0
        bundle[DZ + i] = -bundle[DZ + i]
        bundle[WEIGHT + i] *= sensor.reflectance
        bundle[MET + i] += 1.0
        bundle[ENDED_ON + i] = select(ends, DROPPED, bundle[ENDED_ON + i])


@kernel
def _at_cover(bundle: Array, cover: CoverTables, face: int, mirrors: bool, colour: int) -> None:
    """Reflect or refract rays (sensor frame) at a face of the cover, weighted with R or T and what is absorbed."""
    z = cover.front_z if face == FRONT_ROW else cover.rear_z
    glass = cover.media.indices[cover.medium, colour]
    for i in range(BLOCK):
        if bundle[ENDED_ON + i] != 0.0:
            continue
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        t, sense = (z - bundle[Z + i]) / dz if dz != 0.0 else -1.0, (1.0 if dz > 0.0 else -1.0)
        if t < -NEAR * (abs(bundle[X + i]) + abs(bundle[Y + i]) + abs(bundle[Z + i])):
            bundle[ENDED_ON + i] = DROPPED
            continue
        entering = (face == FRONT_ROW) == (sense > 0.0)
        n_i, n_t = (1.0, glass) if entering else (glass, 1.0)
        share = np.exp(-_per_mm(cover.media.absorption, AIR if entering else cover.medium, colour) * t)
        cos_i = min(abs(dz), 1.0)
        reflectance, transmittance, cos_t = shares_from(cover.interfaces, face, colour, n_i, n_t, cos_i, not entering)
        bundle[X + i] += t * dx
        bundle[Y + i] += t * dy
        bundle[Z + i] = z
        bundle[MET + i] += 1.0
        if mirrors:
            bundle[WEIGHT + i] *= share * reflectance
            bundle[DZ + i] = -dz
        else:
            bundle[WEIGHT + i] *= share * transmittance
            if transmittance > 0.0:
                bundle[DX + i], bundle[DY + i], bundle[DZ + i] = refracted(
                    dx, dy, dz, 0.0, 0.0, sense, n_i / n_t, cos_i, cos_t
                )  # fmt: skip
            else:
                bundle[ENDED_ON + i] = DROPPED


@kernel
def _per_mm(absorption: Any, medium: int, colour: int) -> float:
    """Return a medium's absorption coefficient, 1/mm; 0 where none absorbs."""
    if absorption is None:
        return 0.0
    return float(absorption.per_mm[medium, colour])
