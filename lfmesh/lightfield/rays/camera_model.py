"""The camera model: the object-space ray of every pixel, and every view as a pinhole camera.

For programs that rectify or trace such pictures themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from lfmesh.errors import LfmeshError
from lfmesh.geometry import frame as frames
from lfmesh.geometry.index_media import refuse_bending
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.motions import refuse_motion
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.rays.chief_rays import plate_of
from lfmesh.lightfield.rays.object_rays import object_rays
from lfmesh.lightfield.rays.pixel_bundles import bundles
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.rays.view_cameras import ViewCameras, view_cameras
from lfmesh.lightfield.rays.view_rays import ViewRays
from lfmesh.lightfield.views.decode import view_count
from lfmesh.notebook import Say, announced
from lfmesh.scene import Scene
from lfmesh.scene.literals import plain
from lfmesh.transport.packets.packet import CAMERA_FRAME, WORLD_FRAME
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

FARTHEST = 20.0
"""Largest distance for fits of views that are sharp to infinity, over the nearest distance of refocusing."""

PLANES = 5
"""Number of distances at which views are fitted, in equal steps of 1/distance."""

BESIDE = 0.75
"""Distance, in pitches, from all micro-image centres beyond which a pixel belongs to no lenslet."""


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Rays of pixels, and views as pinholes. Maps are oriented like the raw image: rows grow with y.

    Attributes
    ----------
    origin, direction : (H, W, 3) float64, mm, world frame
        Exit point of the pixel's ray from the lens, and unit direction away from the camera. NaN without light.
    footprint : (H, W, 4, 4) float64
        Covariance of the rays of the pixel's bundle: x and y in the plane of the first vertex (mm), dx/dz and dy/dz;
        camera frame.
    weight : (H, W) float64, m² sr
        W on the pixel through its lenslet for a radiance of 1 W/(m² sr), from the traced bundle.
    lenslet : (H, W, 2) int64
        Column and row of the pixel's lenslet; −1 for none.
    central : (H, W) bool
        True if the ray runs from the pixel's centre through the lenslet's apex. If the lens stops it, the bundle's mean
        ray replaces it.
    views : ViewCameras
    wavelength_nm : float
    scene : Scene
        Solved.
    """

    origin: Array
    direction: Array
    footprint: Array
    weight: Array
    lenslet: NDArray[np.int64]
    central: NDArray[np.bool_]
    views: ViewCameras
    wavelength_nm: float
    scene: Scene

    def __repr__(self) -> str:
        height, width = self.weight.shape
        rows, columns = self.views.rms_error.shape
        return f"<CameraModel: {width} × {height} pixels, {columns} × {rows} views>"

    @property
    def in_words(self) -> str:
        """Number of pixels and views with rays, and the error of the pinholes, in words."""
        has_rays = np.isfinite(self.views.rms_error)
        words = (
            f"{np.mean(self.weight > 0.0):.1%} of {self.weight.size} pixels see through their lenslet, "
            f"{has_rays.sum()} of {has_rays.size} views through the lens"
        )
        if not has_rays.any():
            return words
        near, far = self.views.distances_mm.min(), self.views.distances_mm.max()
        rms, largest = np.nanmax(self.views.rms_error), np.nanmax(self.views.largest_error)
        return (
            f"{words}; from {near:.4g} to {far:.4g} mm their pinholes err by {plain(rms, 2)} "
            f"samples rms and {plain(largest, 2)} at most, in the worst view"
        )


def camera_model(
    image_or_scene: Image | Scene, *, views: int | None = None, distances_mm: tuple[float, ...] | None = None,
    progress: Say | bool | None = None,
) -> CameraModel:  # fmt: skip
    """Trace the object-space ray of every pixel and fit a pinhole to every view, at the primary wavelength.

    Rays are in the air before the first surface; targets and tanks are ignored. Each pixel belongs to the lenslet with
    the nearest micro-image centre; light through others is ignored.

    Parameters
    ----------
    image_or_scene : Image or Scene
    views : int, optional
        Along each axis (default: as for `lf.decode`).
    distances_mm : tuple of float, optional
        Distances for the fit of pinholes, before the first vertex (default: the range that refocuses sharply).
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    CameraModel

    Raises
    ------
    LfmeshError
        A conventional camera, a camera that passes no light, media that bend light, motion, or an invalid number of
        views or distance.
    """
    scene = image_or_scene.scene if isinstance(image_or_scene, Image) else image_or_scene
    with announced(progress) as say:
        return _traced(scene, views, distances_mm, say)


def _traced(scene: Scene, views: int | None, distances_mm: tuple[float, ...] | None, say: Say) -> CameraModel:
    refuse_bending(scene, "a camera model is that of the camera alone; omit it")
    refuse_motion(scene, "a camera model is that of a camera at rest in front of objects at rest; omit it")
    say("camera model: rays of the pixels")
    bare = scene.changed({"targets": (), "lights": (), "tanks": (), "media": (), "particles": ()})
    plate = plate_of(solved_camera(bare).scene)
    rays = ViewRays.of_camera(solved_camera(bare).scene)
    distances = _distances(RayModel.of(rays.world.scene)) if distances_mm is None else np.array(distances_mm, float)
    if not (len(distances) and np.isfinite(distances).all() and (distances > 0.0).all()):
        raise LfmeshError(f"distances_mm = {list(distances_mm or ())}: must be one or more positive numbers of mm")
    width, height = scene.camera.sensor.pixels
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    pixels = np.column_stack([column.ravel(), row.ravel()]).astype(np.float64)
    owner = _owners(rays.calibration, pixels)
    own = np.flatnonzero(owner >= 0)
    columns = plate.lenslets.lattice.columns
    lenslet = np.full((len(pixels), 2), -1)
    lenslet[own] = np.column_stack([owner[own] % columns, owner[own] // columns])

    bundle = bundles(rays.world, plate, owner[own], pixels[own])
    weight, footprint = np.zeros(len(pixels)), np.full((len(pixels), 4, 4), np.nan)
    weight[own], footprint[own] = bundle.weight, bundle.covariance
    origin, direction = np.full((2, len(pixels), 3), np.nan)
    traced = object_rays(bare, lenslet[own], pixels[own])
    origin[own], direction[own] = traced
    central = np.isfinite(origin[:, 0])
    spare = np.flatnonzero(~central[own] & (bundle.weight > 0.0))
    mean = bundle.mean[spare]
    to_world = rays.world.tables.frames[CAMERA_FRAME, WORLD_FRAME]
    # Away from the camera, along −z.
    away = -np.column_stack([mean[:, 2:], np.ones(len(mean))])
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    origin[own[spare]] = frames.points(to_world, np.column_stack([mean[:, :2], np.zeros(len(mean))]))
    direction[own[spare]] = frames.directions(to_world, away)

    return CameraModel(
        origin.reshape(height, width, 3),
        direction.reshape(height, width, 3),
        footprint.reshape(height, width, 4, 4),
        weight.reshape(height, width),
        lenslet.reshape(height, width, 2),
        central.reshape(height, width),
        view_cameras(rays, view_count(rays.calibration, views), distances, say),
        scene.primary_nm,
        solved_camera(scene).scene,
    )


def _owners(calibration: Calibration, pixels: Array) -> NDArray[np.int64]:
    """Return the lenslet, counted row by row, with its micro-image centre nearest to each pixel; −1 for none."""
    known = np.flatnonzero(calibration.known)
    distance, nearest = cKDTree(calibration.centres_px.reshape(-1, 2)[known]).query(pixels)
    return np.where(distance <= BESIDE * calibration.pitch_px, known[nearest], -1)


def _distances(model: RayModel) -> Array:
    """Return the distances for the fit of views, over the range that refocuses sharply."""
    near, far = model.refocus_range_mm
    return 1.0 / np.linspace(1.0 / near, 1.0 / min(far, FARTHEST * near), PLANES)
