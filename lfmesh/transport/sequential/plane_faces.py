"""Many rays along a sequence of the plane faces behind the lens: the sensor's cover, and the sensor as a mirror.

Faces are counted from the lens to the sensor: the front and the rear face of the cover, if there is one, then the
sensor. Between the cover's faces is its glass; everywhere else is air.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.geometry.frame import direction_through, point_through
from lfmesh.kernel import kernel
from lfmesh.transport.events.crossing import refracted
from lfmesh.transport.events.interface import shares_from
from lfmesh.transport.packets.packet import CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.sequential.reflections import Array, Arrived
from lfmesh.transport.tables.cover import FRONT_ROW, REAR_ROW, CoverTables
from lfmesh.transport.tables.tables import AIR, SensorTables, Tables


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
    _move(rays, tables.frames[CAMERA_FRAME, SENSOR_FRAME])
    for face, mirrors in zip(faces, reflected, strict=True):
        if tables.cover is not None and face in (FRONT_ROW, REAR_ROW):
            _at_cover(rays, tables.cover, face, mirrors, colour)
        else:
            _mirror_at_sensor(rays, tables.sensor)
    _move(rays, tables.frames[SENSOR_FRAME, CAMERA_FRAME])


class Detected(NamedTuple):
    """What pixels detect of rays that fly to the sensor from behind the last face.

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


def _move(rays: Arrived, move: Array) -> None:
    rays.position[:] = frames.points(move, rays.position)
    rays.direction[:] = frames.directions(move, rays.direction)


def _on_pixels(p: Array, d: Array, sensor: SensorTables) -> tuple[Array, Any]:
    """Return where rays (sensor frame) meet the sensor's plane, and whether that is on a pixel."""
    half = 0.5 * sensor.pixel * np.array([sensor.columns, sensor.rows])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = p[:, :2] - (p[:, 2] / d[:, 2])[:, None] * d[:, :2]
        return at, (d[:, 2] > 0.0) & (p[:, 2] <= 0.0) & (np.abs(at) <= half).all(axis=1)


def _mirror_at_sensor(rays: Arrived, sensor: SensorTables) -> None:
    """Reflect rays (sensor frame) at the pixels; beside them they end."""
    at, arrives = _on_pixels(rays.position, rays.direction, sensor)
    rays.weight[:] = np.where(arrives, rays.weight * sensor.reflectance, 0.0)
    rays.position[:, :2], rays.position[:, 2] = np.where(arrives[:, None], at, 0.0), 0.0
    rays.direction[:, 2] *= -1.0


@kernel
def _at_cover(rays: Arrived, cover: CoverTables, face: int, mirrors: bool, colour: int) -> None:
    """Reflect or refract rays (sensor frame) at a face of the cover, weighted with R or T and what is absorbed."""
    z = cover.front_z if face == FRONT_ROW else cover.rear_z
    glass = cover.media.indices[cover.medium, colour]
    for i in range(len(rays.weight)):
        p, d = rays.position[i], rays.direction[i]
        if not rays.weight[i] > 0.0 or d[2] == 0.0:
            rays.weight[i] = 0.0
            continue
        t, sense = (z - p[2]) / d[2], (1.0 if d[2] > 0.0 else -1.0)
        if t < 0.0:
            rays.weight[i] = 0.0
            continue
        entering = (face == FRONT_ROW) == (sense > 0.0)
        n_i, n_t = (1.0, glass) if entering else (glass, 1.0)
        share = np.exp(-_per_mm(cover.media.absorption, AIR if entering else cover.medium, colour) * t)
        cos_i = min(abs(d[2]), 1.0)
        reflectance, transmittance, cos_t = shares_from(cover.interfaces, face, colour, n_i, n_t, cos_i, not entering)
        p[0], p[1], p[2] = p[0] + t * d[0], p[1] + t * d[1], z
        if mirrors:
            rays.weight[i] *= share * reflectance
            d[2] = -d[2]
        else:
            rays.weight[i] *= share * transmittance
            if transmittance > 0.0:
                d[0], d[1], d[2] = refracted(d[0], d[1], d[2], 0.0, 0.0, sense, n_i / n_t, cos_i, cos_t)


@kernel
def _per_mm(absorption: Any, medium: int, colour: int) -> float:
    """Return a medium's absorption coefficient, 1/mm; 0 where none absorbs."""
    if absorption is None:
        return 0.0
    return float(absorption.per_mm[medium, colour])
