"""Rays from points of the sensor, through its cover, to points of the array."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry import frame as frames
from lfmesh.lightfield.rays.chief_rays import Plate
from lfmesh.optics.ray_aiming import aim_rays
from lfmesh.transport.packets.packet import MLA_FRAME, SENSOR_FRAME

Array = NDArray[np.float64]

MOST_STEPS = 20
"""Most iterations for the ray through a cover; each gains a few digits, more at smaller inclination."""


class PixelSlopes(NamedTuple):
    """Rays between sensor and array, in the array's frame.

    Attributes
    ----------
    seen : (n, 3) float64, mm
        Apparent origin of the ray before the cover; without one, the point of the sensor.
    slope : (n, 2) float64
        dx/|dz| and dy/|dz| between sensor and array; NaN if no ray leads to the point.
    derivative : (n, 2, 2) float64, mm
        Of the ray's end point by its slopes.
    """

    seen: Array
    slope: Array
    derivative: Array


def pixel_slopes(plate: Plate, on_sensor: Array, to: Array, before_mm: Array, glass_mm: Array) -> PixelSlopes:
    """Find the rays from points of the sensor to points of the array.

    Parameters
    ----------
    plate : Plate
    on_sensor : (n, 2) float64, mm
        Sensor frame.
    to : (n, 2) float64, mm
        Array frame.
    before_mm : (n,) float64
        Extent of the array towards the sensor, from the plane of its apexes.
    glass_mm : (n,) float64
        Glass that the ray crosses between a flat face and the point.
    """
    to_array = plate.moves[SENSOR_FRAME, MLA_FRAME]
    # Through a cover, a pixel appears nearer, or farther if its index is below that outside, and displaced by terms of
    # third order in the angle.
    nearer = plate.cover_mm * (1.0 - 1.0 / plate.cover_index)
    moved = np.column_stack([on_sensor, np.full(len(on_sensor), -nearer)])
    for _ in range(MOST_STEPS if nearer else 1):
        seen = frames.points(to_array, moved)
        slope, derivative = slopes_across(to - seen[:, :2], np.abs(seen[:, 2]) - before_mm, glass_mm, plate.glass)
        if nearer:
            place = on_sensor + _off_its_place(plate, slope)[0]
            still = np.array_equal(place, moved[:, :2], equal_nan=True)
            moved[:, :2] = place
            if still:
                break
    if nearer:
        by_slope = to_array[:, :2] @ _off_its_place(plate, slope)[1]
        derivative = derivative + by_slope[:, :2]
        derivative += np.sign(seen[:, 2])[:, None, None] * slope[:, :, None] * by_slope[:, 2:]
    return PixelSlopes(seen, slope, derivative)


def ahead(plate: Plate, slope: Array) -> Array:
    """Return the (n, 3) directions, not normalised, of slopes towards the lens in the array's frame."""
    # The array's z axis points into the glass, away from the lens if the curved face is on the lens side.
    return np.column_stack([slope, np.full(len(slope), -1.0 if plate.curved_to_lens else 1.0)])


def _off_its_place(plate: Plate, slope: Array) -> tuple[Array, Array]:
    """Return the apparent displacement of a pixel by the cover, (n, 2) mm (sensor frame), and derivatives.

    With slopes s in the sensor's frame, a plate of thickness t and index n displaces a ray by t s (1 / n' − 1), with n'
    = √(n² + (n² − 1) s²). The pixel's apparent approach accounts for t s (1 / n − 1).
    """
    n, more = plate.cover_index, plate.cover_index**2 - 1.0
    turn = plate.moves[MLA_FRAME, SENSOR_FRAME][:, :3]
    way = ahead(plate, slope) @ turn.T
    along = np.abs(way[:, 2])
    s = way[:, :2] / along[:, None]
    by_slope = (turn[:2, :2] - (np.sign(way[:, 2])[:, None] * s)[:, :, None] * turn[2, :2]) / along[:, None, None]
    inside = np.sqrt(n * n + more * np.square(s).sum(axis=1))
    share = 1.0 / inside - 1.0 / n
    off = plate.cover_mm * share[:, None] * s
    by_s = share[:, None, None] * np.eye(2) - (more / inside**3)[:, None, None] * s[:, :, None] * s[:, None, :]
    return off, plate.cover_mm * by_s @ by_slope


def slopes_across(offset: Array, air_mm: Array, glass_mm: Array, index: float) -> tuple[Array, Array]:
    """Return the slopes (n, 2) of rays with a given offset across a gap and a plate; NaN if there is none.

    Also return the derivatives of the offset by the slope, (n, 2, 2) mm.

    Parameters
    ----------
    offset : (n, 2) float64, mm
    air_mm, glass_mm : (n,) float64
        Thickness of the air and of the plate.
    index : float
        Refractive index of the plate.
    """
    more = index * index - 1.0

    def landing(slope: Array, which: NDArray[np.int64]) -> Array:
        in_glass = np.sqrt(index * index + more * np.square(slope).sum(axis=1))
        return slope * (air_mm[which] + glass_mm[which] / in_glass)[:, None]

    # First-order slopes are too small, and corrections shrink with the slope: iterations approach from below.
    guess = offset / (air_mm + glass_mm / index)[:, None]

    def derivative(slope: Array) -> Array:
        in_glass = np.sqrt(index * index + more * np.square(slope).sum(axis=1))
        along = (air_mm + glass_mm / in_glass)[:, None, None] * np.eye(2)
        return along - (glass_mm * more / in_glass**3)[:, None, None] * slope[:, :, None] * slope[:, None, :]

    aimed = aim_rays(landing, offset, guess, derivative(guess), air_mm + glass_mm)
    slopes = np.where(aimed.arrived[:, None], aimed.start, np.nan)
    return slopes, derivative(slopes)
