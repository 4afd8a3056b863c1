"""Patch rendering of a focused plenoptic image: from each micro-image, the part that continues its neighbours'.

A pixel o pixels from the centre of its micro-image belongs to the point A + o·shift of the main image, seen from the
middle of the exit pupil, with the lenslet's place A and `TracedShift`'s shift for the distance. A lenslet thus
contributes a patch pitch/shift pixels wide (T. Georgiev, A. Lumsdaine, "Focused plenoptic camera and rendering", J.
Electronic Imaging 19 (2010) 021106). Neighbours' views of the same point are averaged; their spread tells whether the
patch size is right.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from lfmesh.errors import LfmeshError
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.calibration.calibration import Calibration
from lfmesh.lightfield.calibration.raw_image import between_pixels
from lfmesh.lightfield.calibration.white import refuse_other_white
from lfmesh.lightfield.photographs.depth import BORDER
from lfmesh.lightfield.photographs.photograph import AllInFocus, FocalStack, Photograph
from lfmesh.lightfield.rays.chief_rays import plate_of
from lfmesh.lightfield.rays.ray_model import RayModel, ShiftMap
from lfmesh.lightfield.rays.view_rays import ViewRays, traced_shift
from lfmesh.lightfield.views.decode import BRIGHT_PERCENTILE, DARK, view_count
from lfmesh.lightfield.views.focused import lenslet_blur_px
from lfmesh.lightfield.views.upright import Upright
from lfmesh.notebook import Say, announced
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

LAST_RESORT = 1e-9
"""Weight of lenslet types other than the sharpest, so that they count only if no other sees a point."""

FINEST = 4096
"""Most samples along an axis of a picture."""

WINDOW = 1.0
"""Standard deviation of the window for the comparison of planes, in lenslets."""


class _Focused(NamedTuple):
    """Camera and raw image for patch rendering."""

    scene: Scene
    calibration: Calibration
    model: RayModel
    geometry: ShiftMap
    apexes: Array  # (rows, columns, 2) mm
    light: Array  # (H, W, c), NaN where dark
    spread: Array
    radius_px: float
    unit: str


def render_patches(
    image: Image, distance_mm: float, *, white: Image | None = None, sample_mm: float | None = None
) -> Photograph:
    """Render the raw image of a focused plenoptic camera for one object distance.

    A multi-focus array contributes its sharpest lenslets; others fill in points that these miss.

    Parameters
    ----------
    image : Image
    distance_mm : float
        Before the first vertex.
    white : Image, optional
        Of the same camera; the raw image is divided by it.
    sample_mm : float, optional
        Step of the picture, on the array (default: a pixel of the patches).

    Returns
    -------
    Photograph

    Raises
    ------
    LfmeshError
        A conventional camera, or patches larger than the micro-images, as at the focus of a standard plenoptic camera.
    """
    camera = _focused(image, white)
    step = _sample_mm(camera, [distance_mm]) if sample_mm is None else sample_mm
    return _photograph(camera, distance_mm, step)


def patch_stack(image: Image, distances_mm: Sequence[float], *, white: Image | None = None) -> FocalStack:
    """Render the raw image of a focused plenoptic camera for several distances, with the samples of the finest.

    Parameters
    ----------
    image : Image
    distances_mm : sequence of float
    white : Image, optional

    Raises
    ------
    LfmeshError
        As from `render_patches`, or no distance is given.
    """
    camera, step = _for_distances(image, distances_mm, white)
    photographs = []
    with announced(None) as say:
        for number, distance in enumerate(distances_mm):
            say(f"patches: plane {number + 1} of {len(distances_mm)}")
            photographs.append(_photograph(camera, distance, step))
    return FocalStack(tuple(photographs))


def patches_in_focus(
    image: Image, distances_mm: Sequence[float], *, white: Image | None = None, progress: Say | bool | None = None
) -> AllInFocus:
    """Render each place with the patch size for which lenslets agree best.

    Parameters
    ----------
    image : Image
    distances_mm : sequence of float
    white : Image, optional
    progress : callable or bool, optional
        Called with the progress in words. True shows it, False nothing. Default: it is shown at a terminal or in a
        notebook after two seconds.

    Returns
    -------
    AllInFocus

    Raises
    ------
    LfmeshError
        As from `render_patches`, or no distance is given.
    """
    camera, step = _for_distances(image, distances_mm, white)
    with announced(progress) as say:
        return _in_focus(camera, distances_mm, step, say)


def _in_focus(camera: _Focused, distances_mm: Sequence[float], step: float, say: Say) -> AllInFocus:
    window = WINDOW * camera.calibration.lenslet_pitch_mm / step
    best: Array | None = None
    for number, distance in enumerate(distances_mm):
        say(f"patches: plane {number + 1} of {len(distances_mm)}")
        mean, stderr, variance = _rendered(camera, distance, step)
        known = np.isfinite(variance)
        weight = ndimage.gaussian_filter(known.astype(np.float64), window)
        cost = ndimage.gaussian_filter(np.where(known, variance, 0.0), window)
        cost = np.where(weight > 1e-6, cost / np.maximum(weight, 1e-6), np.inf)
        if best is None:
            best, picture, error, chosen = cost, mean, stderr, np.full(cost.shape, float(distance))
            continue
        better = cost < best
        best = np.where(better, cost, best)
        picture, error = np.where(better[..., None], mean, picture), np.where(better[..., None], stderr, error)
        chosen = np.where(better, distance, chosen)
    return AllInFocus(picture, error, chosen, camera.scene.wavelengths_nm, camera.unit)


def patch_px(scene: Scene, distance_mm: float) -> float:
    """Return the width of the patches for an object distance, in pixels, by first-order optics."""
    model = RayModel.of(scene)
    shift = abs(model.shift_mm(distance_mm))
    return model.lenslet_pitch_mm / shift if shift else math.inf


def _for_distances(image: Image, distances_mm: Sequence[float], white: Image | None) -> tuple[_Focused, float]:
    """Return the camera and the finest patch pixel, on the array, over several distances."""
    if not len(distances_mm):
        raise LfmeshError("distances_mm is empty: give at least one distance")
    camera = _focused(image, white)
    return camera, _sample_mm(camera, distances_mm)


def _photograph(camera: _Focused, distance_mm: float, step_mm: float) -> Photograph:
    mean, stderr, _ = _rendered(camera, distance_mm, step_mm)
    scale = abs(camera.model.object_scale(distance_mm)) if math.isfinite(distance_mm) else math.inf
    waves = camera.scene.wavelengths_nm
    f_number, unit = camera.model.f_number, camera.unit
    return Photograph(mean, stderr, float(distance_mm), f_number, step_mm * scale, waves, unit, "patches")


def _focused(image: Image, white: Image | None) -> _Focused:
    scene = solved_camera(image.scene).scene
    model = RayModel.of(scene)
    calibration, geometry, radius = _geometry(scene.camera_alone())
    light, spread, unit = image.mean, image.stderr, "W per pixel"
    if white is not None:
        light, spread = _divided(image, white, scene)
        unit = "W/(m² sr)"
    apexes = plate_of(scene).lenslets.apexes
    return _Focused(scene, calibration, model, geometry, apexes, light, spread, radius, unit)


@lru_cache(maxsize=4)
def _geometry(scene: Scene) -> tuple[Calibration, ShiftMap, float]:
    """Return a camera's calibration, its distance map, and the usable radius of micro-images in pixels.

    Cached, as tracing takes longer than rendering.
    """
    rays = ViewRays.of_camera(scene)
    model, calibration = RayModel.of(scene), rays.calibration
    # Pixels that the pupil fills, as for the fit of `TracedShift`.
    radius = min(0.5 * calibration.pitch_px, model.pupil_slope / model.slope_step) - BORDER
    count = view_count(calibration, None)
    places = np.arange(count) - 0.5 * (count - 1)
    usable = np.hypot(*np.meshgrid(places, places)) <= radius
    if usable.sum() < 4:
        raise LfmeshError(
            f"camera: the micro-images are {calibration.pitch_px:.3g} pixels wide, too small to render patches of"
        )
    return calibration, traced_shift(rays, usable), radius


def _divided(image: Image, white: Image, scene: Scene) -> tuple[Array, Array]:
    """Return the raw image over the white one, with standard error; NaN where white is dark."""
    refuse_other_white(white, image, scene.camera)
    level = DARK * np.percentile(white.mean, BRIGHT_PERCENTILE, axis=(0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(white.mean > level, image.mean / white.mean, np.nan)
        error = np.hypot(image.stderr, ratio * white.stderr) / white.mean
    return ratio, error


def _sample_mm(camera: _Focused, distances_mm: Sequence[float]) -> float:
    """Return the finest patch pixel, on the array, over several distances."""
    return min(abs(camera.geometry.shift_mm(distance)) for distance in distances_mm)


def _rendered(camera: _Focused, distance_mm: float, step_mm: float) -> tuple[Array, Array, Array]:
    """Return mean and standard error (t, s, c), and the variance over the lenslets (t, s); upright."""
    shift = camera.geometry.shift_mm(distance_mm)
    calibration = camera.calibration
    patch = calibration.lenslet_pitch_mm / abs(shift) if shift else math.inf
    if patch > 2.0 * camera.radius_px:
        raise LfmeshError(
            f"distance_mm = {distance_mm:g}: its patches would be {patch:.4g} pixels wide, but the micro-images are "
            f"{2.0 * camera.radius_px:.4g}, so no lenslet sees the gaps between them; use lf.refocus near the plane "
            "that is imaged onto the lenslets"
        )
    extent = np.ptp(camera.apexes.reshape(-1, 2), axis=0) + calibration.lenslet_pitch_mm
    width, height = (max(1, round(side / step_mm)) for side in extent)
    if not step_mm > 0.0 or max(width, height) > FINEST:
        raise LfmeshError(f"sample_mm = {step_mm:g}: must be at least {extent.max() / FINEST:.4g}, on the array")
    blur = lenslet_blur_px(camera.scene, camera.model.image_excess_mm(distance_mm))
    weights = np.where(np.array(blur) <= min(blur) * (1.0 + 1e-9), 1.0, LAST_RESORT)
    shape = (height, width, camera.light.shape[2])
    mean, stderr, variance = np.empty(shape), np.empty(shape), np.empty(shape[:2])
    _gather(
        camera.light, camera.spread, calibration.centres_px, camera.apexes, calibration.kinds, weights,
        *Upright.of(camera.scene).senses, shift, camera.radius_px, step_mm, calibration.lenslet_pitch_mm,
        calibration.row_pitch_mm,
        mean, stderr, variance,
    )  # fmt: skip
    return mean, stderr, variance


@kernel
def _gather(
    light: Array, spread: Array, centres: Array, apexes: Array, kinds: NDArray[np.int64], weights: Array,
    sense_x: float, sense_y: float, shift: float, radius: float, step: float, pitch: float, row_pitch: float,
    mean: Array, stderr: Array, variance: Array,
) -> None:  # fmt: skip
    """Average the pixels of all lenslets that see each sample's point."""
    height, width, channels = mean.shape
    rows, columns = kinds.shape
    reach = abs(shift) * radius
    for t in range(height):
        for s in range(width):
            x, y = sense_x * step * (s - 0.5 * (width - 1)), sense_y * step * (t - 0.5 * (height - 1))
            # Rows of hexagonal arrays are offset by half a pitch, and form errors shift apexes a little.
            left = max(int((x - reach) / pitch + 0.5 * (columns - 1)) - 1, 0)
            right = min(int((x + reach) / pitch + 0.5 * (columns - 1)) + 2, columns - 1)
            top = max(int((y - reach) / row_pitch + 0.5 * (rows - 1)) - 1, 0)
            bottom = min(int((y + reach) / row_pitch + 0.5 * (rows - 1)) + 2, rows - 1)
            variance[t, s] = 0.0
            for c in range(channels):
                total, value, square, error = 0.0, 0.0, 0.0, 0.0
                for r in range(top, bottom + 1):
                    for k in range(left, right + 1):
                        du, dv = (x - apexes[r, k, 0]) / shift, (y - apexes[r, k, 1]) / shift
                        # Fades towards the rim, so that patches join without seams.
                        share = 1.0 - (du * du + dv * dv) / (radius * radius)
                        if share <= 0.0:
                            continue
                        column, row = centres[r, k, 0] + du, centres[r, k, 1] + dv
                        sample, its_error = between_pixels(light, spread, column, row, c)
                        if np.isnan(sample):
                            continue
                        weight = share * weights[kinds[r, k]]
                        total += weight
                        value += weight * sample
                        square += weight * sample * sample
                        error += weight * weight * its_error
                mean[t, s, c] = value / total if total > 0.0 else np.nan
                stderr[t, s, c] = np.sqrt(error) / total if total > 0.0 else np.nan
                variance[t, s] += max(square / total - (value / total) ** 2, 0.0) if total > 0.0 else np.nan
