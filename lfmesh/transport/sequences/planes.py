"""Plane faces behind the lens for ray blocks: the sensor's cover, and the sensor as a mirror.

Faces are counted from the lens to the sensor: the front and rear face of the cover, if there is one, then the sensor.
The medium is the cover's glass between its faces, and the one behind the lens elsewhere.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.vector import both, select
from lfmesh.transport.sequences.bundle import AT_Z, BLOCK, DROPPED, DX, DY, DZ, X, Y, Z, absorb, set_fate, set_normal
from lfmesh.transport.sequences.division import divide, go_on
from lfmesh.transport.sequences.lens_surfaces import NEAR
from lfmesh.transport.tables.cover import FRONT_ROW, CoverTables
from lfmesh.transport.tables.tables import AIR, SensorTables

Array = NDArray[np.float64]

SENSOR_BEHIND_COVER = 2
"""Number of the sensor among the faces if there is a cover; without one it is the only face."""


@inlined
def at_plane(
    bundle: Array, cover: Any, sensor: SensorTables, face: int, to_sensor: bool, mirrors: bool, colour: int, book: Array
) -> None:  # fmt: skip
    """Take a bundle (sensor frame) to a face, and reflect or refract it there.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    cover : CoverTables or None
    sensor : SensorTables
    face : int
    to_sensor : bool
        Direction of travel; other rays are dropped.
    mirrors : bool
        Reflect the rays; else refract them.
    colour : int
        Wavelength number.
    book : (slots,) float64
        Receives light absorbed by glass and coating.
    """
    if cover is not None and face != SENSOR_BEHIND_COVER:
        _at_cover(bundle, cover, face, to_sensor, mirrors, colour, book)
    else:
        _mirror_at_sensor(bundle, sensor)


@kernel
def _at_cover(
    bundle: Array, cover: CoverTables, face: int, to_sensor: bool, mirrors: bool, colour: int, book: Array
) -> None:
    entering = (face == FRONT_ROW) == to_sensor
    glass, outside = cover.media.indices[cover.medium, colour], cover.media.indices[AIR, colour]
    indices = (outside, glass) if entering else (glass, outside)
    _meet_plane(bundle, cover.front_z if face == FRONT_ROW else cover.rear_z, 1.0 if to_sensor else -1.0)
    absorb(bundle, cover.media.absorption, AIR if entering else cover.medium, colour, book)
    divide(bundle, cover.interfaces, face, colour, indices, not entering, mirrors, book)


@kernel
def _meet_plane(bundle: Array, z: float, sense: float) -> None:
    for i in range(BLOCK):
        t = (z - bundle[Z + i]) / bundle[DZ + i]
        ahead = t >= -NEAR * (abs(bundle[X + i]) + abs(bundle[Y + i]) + abs(bundle[Z + i]))
        holds = both(ahead, sense * bundle[DZ + i] > 0.0)
        set_fate(bundle, i, select(holds, t, 0.0), select(holds, 0.0, DROPPED))
        bundle[AT_Z + i] = select(holds, z, bundle[AT_Z + i])
        set_normal(bundle, i, 0.0, 0.0, sense)


@kernel
def _mirror_at_sensor(bundle: Array, sensor: SensorTables) -> None:
    """Reflect rays (sensor frame) at the pixels; end them beside the sensor."""
    half_x, half_y = 0.5 * sensor.pixel * sensor.columns, 0.5 * sensor.pixel * sensor.rows
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        t = -bundle[Z + i] / dz
        x, y = bundle[X + i] + t * dx, bundle[Y + i] + t * dy
        held = both(both(dz > 0.0, t >= 0.0), both(abs(x) <= half_x, abs(y) <= half_y))
        go_on(bundle, i, True, Ray(x, y, 0.0, dx, dy, -dz), select(held, 0.0, DROPPED), sensor.reflectance, 0.0)
