"""The pixel-to-ray map: the object-space ray that a pixel sees through a lenslet.

The ray runs from a point of the sensor through the lenslet's apex and back through the lens. It holds for any sensor
position: in the microlens focal plane, in front of it or behind it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.lightfield.rays.chief_rays import Plate, plate_of
from lfmesh.lightfield.rays.lens_alone import lens_alone
from lfmesh.lightfield.rays.pixel_slopes import ahead, pixel_slopes
from lfmesh.scene import Scene
from lfmesh.transport.packets.packet import CAMERA_FRAME, MLA_FRAME
from lfmesh.transport.trace import Status, trace

Array = NDArray[np.float64]


class ObjectRays(NamedTuple):
    """Rays in object space, world frame; NaN if the lens or its stop passes none.

    Attributes
    ----------
    origin : (n, 3) float64, mm
        Exit point from the front of the lens.
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
        Column and row on the sensor, with the centre of the first pixel at (0, 0).

    Returns
    -------
    ObjectRays

    Raises
    ------
    LfmeshError
        A conventional camera, or a lenslet outside the array.
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
    # Start just before the array, as close as a ray may start.
    step = 0.01 * (scene.camera.mla.distance_mm or 0.0) if scene.camera.mla is not None else 0.0
    known = np.flatnonzero(np.isfinite(towards_lens).all(axis=1))
    paths = trace(
        lens_alone(scene), (entry + step * towards_lens)[known], towards_lens[known], scene.primary_nm,
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
    """Return starts and directions, in the air before the array, of rays from pixels through apexes."""
    sensor = scene.camera.sensor
    on_sensor = (pixels - 0.5 * (np.asarray(sensor.pixels) - 1.0)) * sensor.pixel_mm
    glass = np.full(len(pixels), plate.lenslets.thickness if plate.curved_to_lens else 0.0)
    in_array = ahead(plate, pixel_slopes(plate, on_sensor, apexes, glass, glass).slope)
    in_array /= np.linalg.norm(in_array, axis=1, keepdims=True)
    in_array = plate.deflected(in_array)
    first = np.column_stack([apexes, np.zeros(len(apexes))])
    if not plate.curved_to_lens:
        inside = plate.inside(in_array)
        first = first + (plate.lenslets.thickness / inside[:, 2])[:, None] * inside
    to_camera = plate.moves[MLA_FRAME, CAMERA_FRAME]
    return frames.points(to_camera, first), frames.directions(to_camera, in_array)
