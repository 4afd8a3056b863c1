"""From a pixel and a lenslet to the ray in object space that they stand for: the camera's true pixel-to-ray map.

The ray runs from a point of the sensor through the lenslet's apex and back through the lens. It takes no account of
where the sensor stands, so it is as good for a sensor in the microlens focal plane as for one in front of or behind it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.refractors import measured
from lfmesh.lightfield.chief_rays import Plate, plate_of
from lfmesh.lightfield.lens_alone import lens_alone
from lfmesh.scene import Scene, solved
from lfmesh.transport.packets.packet import ARRAY_FRAME, CAMERA_FRAME, SENSOR_FRAME
from lfmesh.transport.trace import Status, trace

Array = NDArray[np.float64]

NEWTON_STEPS = 6
"""For the angle under which a ray crosses the plate; each doubles the digits, from a paraxial guess."""


class ObjectRays(NamedTuple):
    """Rays in object space, world frame; NaN where the lens or its stop lets none through.

    Attributes
    ----------
    origin : (n, 3) float64, mm
        Where it leaves the front of the lens.
    direction : (n, 3) float64
        Unit, away from the camera.
    """

    origin: Array
    direction: Array


def object_rays(scene: Scene, lenslets: NDArray[np.integer], pixels_px: Array) -> ObjectRays:
    """Trace rays from points of the sensor through lenslets into object space, at the primary wavelength.

    Parameters
    ----------
    scene : Scene
    lenslets : (n, 2) int
        Column and row of each ray's lenslet.
    pixels_px : (n, 2) float64
        Column and row on the sensor, the middle of the first pixel at (0, 0).

    Raises
    ------
    LfmeshError
        A conventional camera, or a lenslet that the array does not have.
    """
    scene = solved(measured(scene))
    plate = plate_of(scene)
    lattice = plate.lenslets.lattice
    lenslets, pixels = np.atleast_2d(lenslets), np.atleast_2d(np.asarray(pixels_px, dtype=np.float64))
    outside = ((lenslets < 0) | (lenslets >= (lattice.columns, lattice.rows))).any(axis=1)
    if outside.any():
        column, row = lenslets[np.flatnonzero(outside)[0]]
        raise LfmeshError(
            f"lenslet (column {column}, row {row}): the array has columns 0 to {lattice.columns - 1} and rows 0 to "
            f"{lattice.rows - 1}"
        )
    apexes = plate.apexes[lenslets[:, 1] * lattice.columns + lenslets[:, 0]]
    entry, towards_lens = _through_apexes(scene, plate, apexes, pixels)
    # From just before the array, which is as close to it as a ray may start.
    ahead = 0.01 * (scene.camera.mla.distance_mm or 0.0) if scene.camera.mla is not None else 0.0
    paths = trace(
        lens_alone(scene), entry + ahead * towards_lens, towards_lens, scene.transport.primary_nm, split="transmit"
    )  # fmt: skip
    origin, direction = np.full((2, len(pixels), 3), np.nan)
    through = paths.status == Status.ESCAPED
    to_world = frames.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm)
    origin[paths.source[through]] = frames.points(to_world, paths.position[through])
    direction[paths.source[through]] = frames.directions(to_world, paths.direction[through])
    return ObjectRays(origin, direction)


def _through_apexes(scene: Scene, plate: Plate, apexes: Array, pixels: Array) -> tuple[Array, Array]:
    """Return where rays from pixels through apexes meet the air before the array, and go: camera frame."""
    sensor = scene.camera.sensor
    on_sensor = (pixels - 0.5 * (np.asarray(sensor.pixels) - 1.0)) * sensor.pixel_mm
    points = frames.points(plate.moves[SENSOR_FRAME, ARRAY_FRAME], np.column_stack([on_sensor, np.zeros(len(pixels))]))
    offset = apexes - points[:, :2]
    across = np.hypot(*offset.T)
    glass = plate.lenslets.thickness if plate.curved_to_lens else 0.0
    sine = _sine_across(across, np.abs(points[:, 2]) - glass, glass, plate.glass)
    heading = offset / np.where(across > 0.0, across, 1.0)[:, None]
    # The array's z axis runs into the glass: towards the lens it is negative where the curved face looks there.
    along = np.sqrt(1.0 - sine**2) * (-1.0 if plate.curved_to_lens else 1.0)
    in_array = np.column_stack([sine[:, None] * heading, along])
    first = np.column_stack([apexes, np.zeros(len(apexes))])
    if not plate.curved_to_lens:
        inside = plate.inside(in_array)
        first = first + (plate.lenslets.thickness / inside[:, 2])[:, None] * inside
    to_camera = plate.moves[ARRAY_FRAME, CAMERA_FRAME]
    return frames.points(to_camera, first), frames.directions(to_camera, in_array)


def _sine_across(across: Array, air_mm: Array, glass_mm: float, index: float) -> Array:
    """Return the sine, in air, of the angle of a ray that gets `across` through air and a plate, by Newton's method."""
    sine = across / np.hypot(across, air_mm + glass_mm / index)
    for _ in range(NEWTON_STEPS):
        cos, cos_glass = np.sqrt(1.0 - sine**2), np.sqrt(1.0 - (sine / index) ** 2)
        reached = air_mm * sine / cos + glass_mm * sine / (index * cos_glass)
        slope = air_mm / cos**3 + glass_mm / (index * cos_glass**3)
        sine = np.clip(sine - (reached - across) / slope, 0.0, 1.0 - 1e-9)
    return sine
