"""The pixel-to-ray map: the ray in object space that a pixel sees through a lenslet.

The ray runs from a point of the sensor through the lenslet's apex and back through the lens. It takes no account of
where the sensor stands, so it is as good for a sensor in the microlens focal plane as for one in front of or behind it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.solved_camera import solved_camera
from lfmesh.lightfield.chief_rays import Plate, plate_of
from lfmesh.lightfield.lens_alone import lens_alone
from lfmesh.scene import Scene
from lfmesh.transport.aiming.ray_aiming import aim_rays
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.trace import Status, trace

Array = NDArray[np.float64]

MOST_STEPS = 20
"""Steps by which the ray through a cover is found; each takes off a few digits, the more the less it is inclined."""


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
    scene = solved_camera(scene).scene
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
    known = np.flatnonzero(np.isfinite(towards_lens).all(axis=1))
    paths = trace(
        lens_alone(scene), (entry + ahead * towards_lens)[known], towards_lens[known], scene.primary_nm,
        split="transmit",
    )  # fmt: skip
    origin, direction = np.full((2, len(pixels), 3), np.nan)
    through = paths.status == Status.ESCAPED
    rays = known[paths.source[through]]
    to_world = frames.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm)
    origin[rays] = frames.points(to_world, paths.position[through])
    direction[rays] = frames.directions(to_world, paths.direction[through])
    return ObjectRays(origin, direction)


def _through_apexes(scene: Scene, plate: Plate, apexes: Array, pixels: Array) -> tuple[Array, Array]:
    """Return where rays from pixels through apexes enter the air before the array, and their directions."""
    sensor = scene.camera.sensor
    on_sensor = (pixels - 0.5 * (np.asarray(sensor.pixels) - 1.0)) * sensor.pixel_mm
    glass = plate.lenslets.thickness if plate.curved_to_lens else 0.0
    # Seen through a cover, a pixel appears nearer, and off its place by what is of third order in the angle.
    nearer = plate.cover_mm * (1.0 - 1.0 / plate.cover_index)
    seen = np.column_stack([on_sensor, np.full(len(pixels), -nearer)])
    for _ in range(MOST_STEPS if nearer > 0.0 else 1):
        points = frames.points(plate.moves[SENSOR_FRAME, MLA_FRAME], seen)
        slope, _ = slopes_across(
            apexes - points[:, :2], np.abs(points[:, 2]) - glass, np.full(len(points), glass), plate.glass
        )
        # The array's z axis runs into the glass: towards the lens it is negative where the curved face looks there.
        in_array = np.column_stack([slope, np.full(len(slope), -1.0 if plate.curved_to_lens else 1.0)])
        in_array /= np.linalg.norm(in_array, axis=1, keepdims=True)
        if nearer > 0.0:
            to_lens = frames.directions(plate.moves[MLA_FRAME, SENSOR_FRAME], in_array)
            off = plate.moved_by_cover(to_lens) + nearer * to_lens[:, :2] / np.abs(to_lens[:, 2:])
            moved = on_sensor + off
            still = np.array_equal(moved, seen[:, :2], equal_nan=True)
            seen[:, :2] = moved
            if still:
                break
    first = np.column_stack([apexes, np.zeros(len(apexes))])
    if not plate.curved_to_lens:
        inside = plate.inside(in_array)
        first = first + (plate.lenslets.thickness / inside[:, 2])[:, None] * inside
    to_camera = plate.moves[MLA_FRAME, CAMERA_FRAME]
    return frames.points(to_camera, first), frames.directions(to_camera, in_array)


def slopes_across(offset: Array, air_mm: Array, glass_mm: Array, index: float) -> tuple[Array, Array]:
    """Return the slopes in air, (n, 2), of rays with a given offset across air and a plate; NaN where none has it.

    With them the derivatives of the offset by the slope, (n, 2, 2) mm.

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

    # First order gives slopes that are too small, and less is added the larger they are: steps come from below.
    guess = offset / (air_mm + glass_mm / index)[:, None]

    def derivative(slope: Array) -> Array:
        in_glass = np.sqrt(index * index + more * np.square(slope).sum(axis=1))
        along = (air_mm + glass_mm / in_glass)[:, None, None] * np.eye(2)
        return along - (glass_mm * more / in_glass**3)[:, None, None] * slope[:, :, None] * slope[:, None, :]

    aimed = aim_rays(landing, offset, guess, derivative(guess), air_mm + glass_mm)
    slopes = np.where(aimed.arrived[:, None], aimed.start, np.nan)
    return slopes, derivative(slopes)
