"""Decoding: sort the pixels of a raw image into views, one for each position in the micro-images."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import ROW_SPACING
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.calibration.calibration import Calibration, calibrate
from lfmesh.lightfield.calibration.raw_image import between_pixels
from lfmesh.lightfield.calibration.white import refuse_other_white
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.lightfield.views.field import LightField, Samples
from lfmesh.lightfield.views.upright import Upright
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

DARK = 0.1
"""White level, over that of the brightest samples, below which a divided sample is unknown."""

BRIGHT_PERCENTILE = 99.0


class Sampling(NamedTuple):
    """Samples of upright views from lenslets, each a weighted mean of two neighbours in a row.

    Attributes
    ----------
    t_mm : (t,) float64
    s_mm : (s,) float64
    rows : (t,) int64
        Rows of the array.
    columns : (2, s) int64
        First of the two lenslets, for even and odd rows of the array.
    share : (2, s) float64
        Weight of the second, in the next column.
    words : str
    """

    t_mm: Array
    s_mm: Array
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    share: Array
    words: str


def decode(
    image: Image,
    scene: Scene | None = None,
    *,
    white: Image | None = None,
    calibration: Calibration | None = None,
    views: int | None = None,
) -> LightField:
    """Sort the pixels of a raw image into the views of a light field.

    A sample is interpolated bilinearly at a whole or half-integer number of pixels from the centre of its micro-image.
    It is unknown (NaN) if another micro-image's centre is nearer, as in the corner views of a hexagonal array. A
    hexagonal array is resampled along its rows to a square grid with the spacing of the rows.

    Parameters
    ----------
    image : Image
        From `lf.render` or `lf.open_run`.
    scene : Scene, optional
        Scene of the image (default: its own).
    white : Image, optional
        From `lf.white_image`, of the same camera; the raw image is divided by it.
    calibration : Calibration, optional
        Centres of the micro-images (default: traced by `lf.calibrate`).
    views : int, optional
        Along each axis (default: whole pixels in the width of a micro-image). The outermost views need samples of their
        own.

    Returns
    -------
    LightField

    Raises
    ------
    LfmeshError
        A conventional camera; an image, white image or calibration of another camera; or an invalid number of views.
    """
    scene = solved_camera(image.scene if scene is None else scene).scene
    model = RayModel.of(scene)
    calibration = calibrate(scene) if calibration is None else calibration
    _refuse_strangers(image, white, scene, calibration)
    count = view_count(calibration, views)
    upright = Upright.of(scene)
    sampling = sampling_of(calibration, upright)
    data, stderr = _sorted_pixels(image, calibration, count, sampling, upright)
    unit = "W per pixel"
    if white is not None:
        _divide(data, stderr, *_sorted_pixels(white, calibration, count, sampling, upright))
        unit = "W/(m² sr)"
    directions = _centred(count, model.slope_step)
    return LightField(
        data=data,
        stderr=stderr,
        v_rad=directions,
        u_rad=directions.copy(),
        t_mm=sampling.t_mm,
        s_mm=sampling.s_mm,
        wavelengths_nm=image.wavelengths_nm,
        unit=unit,
        scene=scene,
        sampling=sampling.words,
        sharing=_sharing(calibration, count, sampling),
    )


def _refuse_strangers(image: Image, white: Image | None, scene: Scene, calibration: Calibration) -> None:
    height, width = image.mean.shape[:2]
    sensor = scene.camera.sensor.pixels
    if (width, height) != sensor:
        raise LfmeshError(f"the image has {width} × {height} pixels, the scene's sensor {sensor[0]} × {sensor[1]}")
    columns, rows = scene.camera.mla.count if scene.camera.mla is not None else (0, 0)
    if calibration.known.shape != (rows, columns) or calibration.sensor_px != sensor:
        raise LfmeshError(
            f"the calibration is of {calibration.known.shape[1]} × {calibration.known.shape[0]} lenslets and "
            f"{calibration.sensor_px[0]} × {calibration.sensor_px[1]} pixels, but the camera has {columns} × {rows} "
            f"and {sensor[0]} × {sensor[1]}"
        )
    if white is not None:
        refuse_other_white(white, image, scene.camera)


def view_count(calibration: Calibration, views: int | None) -> int:
    """Return the number of views along each axis, by default the whole pixels in the width of a micro-image.

    Raises
    ------
    LfmeshError
        The number is out of range.
    """
    # Allow for rounding errors of a pitch of whole pixels.
    whole = max(1, math.floor(calibration.pitch_px * (1.0 + 1e-6)))
    if views is None:
        return whole
    # The outermost row or column of views must have its own samples.
    most = max(count for count in range(whole, 2 * whole + 2) if count == whole or _reaches(calibration, count))
    if not 1 <= views <= most:
        raise LfmeshError(
            f"views = {views}: must be from 1 to {most}; the micro-images are {calibration.pitch_px:.4g} pixels wide"
        )
    return views


def _reaches(calibration: Calibration, count: int) -> bool:
    own = _are_own(calibration, count, (1.0, 1.0))
    return bool(own[0].any() or own[:, 0].any())


def sampling_of(calibration: Calibration, upright: Upright) -> Sampling:
    """Return the sampling of the views by the lenslets of a camera."""
    rows, columns = calibration.known.shape
    pitch = calibration.lenslet_pitch_mm
    t_mm, of_array = _centred(rows, calibration.row_pitch_mm), upright.rows(rows)
    if calibration.layout == "square":
        s_mm = _centred(columns, pitch)
        own = upright.columns(columns)
        words = f"one sample per lenslet, {pitch:.6g} mm apart"
        return Sampling(t_mm, s_mm, of_array, np.stack([own, own]), np.zeros((2, columns)), words)
    step = calibration.row_pitch_mm
    count = max(1, int((columns - 0.5) / ROW_SPACING) + 1) if rows > 1 else max(1, int(columns / ROW_SPACING))
    s_mm = _centred(count, step)
    left, share = np.zeros((2, count), np.int64), np.zeros((2, count))
    for odd in (0, 1):
        shift = 0.5 * odd - (0.25 if rows > 1 else 0.0)
        at = np.clip(upright.senses[0] * s_mm / pitch + 0.5 * (columns - 1) - shift, 0.0, columns - 1.0)
        left[odd] = np.minimum(at.astype(np.int64), max(columns - 2, 0))
        share[odd] = at - left[odd]
    words = (
        f"hexagonal lenslets {pitch:.6g} mm apart, resampled along their rows, linearly between neighbours, to a "
        f"square grid of {step:.6g} mm, the spacing of the rows"
    )
    return Sampling(t_mm, s_mm, of_array, left, share, words)


def _centred(count: int, step: float) -> Array:
    """Return an axis of equal steps centred on zero."""
    return step * (np.arange(count, dtype=np.float64) - 0.5 * (count - 1))


def _sorted_pixels(
    image: Image, calibration: Calibration, count: int, sampling: Sampling, upright: Upright
) -> tuple[Samples, Samples]:
    return _as_views(image.mean, image.stderr, calibration, count, sampling, upright)


def _as_views(
    mean: Array, spread: Array, calibration: Calibration, count: int, sampling: Sampling, upright: Upright
) -> tuple[Samples, Samples]:
    shape = (count, count, len(sampling.t_mm), len(sampling.s_mm), mean.shape[2])
    data, stderr = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    _sort_pixels(
        mean, spread, calibration.centres_px, sampling.rows, sampling.columns, sampling.share, *upright.senses,
        _are_own(calibration, count, upright.senses), data, stderr,
    )  # fmt: skip
    return data, stderr


def _are_own(calibration: Calibration, count: int, senses: tuple[float, float]) -> NDArray[np.bool_]:
    """Return a mask (v, u) of views with samples nearer to their own micro-image's centre than to any other."""
    sense_u, sense_v = senses
    u, v = np.meshgrid(sense_u * _centred(count, 1.0), sense_v * _centred(count, 1.0))
    neighbours = 6 if calibration.layout == "hexagonal" else 4
    turns = calibration.rotation_rad + 2.0 * np.pi / neighbours * np.arange(neighbours)
    # At most half of the distance to each neighbour, with a tolerance for rounding.
    ahead = u[..., None] * np.cos(turns) + v[..., None] * np.sin(turns)
    return np.asarray((ahead <= 0.5 * calibration.pitch_px * (1.0 + 1e-6)).all(axis=-1))


def sorted_views(light: Array, calibration: Calibration, count: int, sampling: Sampling, upright: Upright) -> Array:
    """Return a single-channel raw image as views, (v, u, t, s); NaN outside the sensor.

    Parameters
    ----------
    light : (H, W) float64
        As on the sensor.
    calibration : Calibration
    count : int
        Views along each axis.
    sampling : Sampling
    upright : Upright
    """
    values = np.ascontiguousarray(light[..., None])
    data, _ = _as_views(values, np.zeros_like(values), calibration, count, sampling, upright)
    return data[..., 0].astype(np.float64)


def _sharing(calibration: Calibration, count: int, sampling: Sampling) -> Samples:
    """Return 1 over the sum of squared pixel weights in a sample, the same for all views of a lenslet."""
    fraction = (calibration.centres_px + 0.5 * (count - 1)) % 1.0
    squares = np.prod((1.0 - fraction) ** 2 + fraction**2, axis=-1)[sampling.rows]
    odd = sampling.rows & 1
    left, share = sampling.columns[odd], sampling.share[odd]
    first = np.take_along_axis(squares, left, axis=1)
    second = np.take_along_axis(squares, np.minimum(left + 1, squares.shape[1] - 1), axis=1)
    here, there = (1.0 - share) ** 2, share**2
    return ((here + there) / (here * first + there * second)).astype(np.float32)


@kernel
def _sort_pixels(
    mean: Array, spread: Array, centres: Array, rows: NDArray[np.int64], columns: NDArray[np.int64], share: Array,
    sense_u: float, sense_v: float, own: NDArray[np.bool_], data: Samples, stderr: Samples,
) -> None:  # fmt: skip
    """Fill in (v, u, t, s, c) samples and standard errors of the `own` views from the raw image."""
    count, _, height, width, channels = data.shape
    for t in range(height):
        row = rows[t]
        for s in range(width):
            column, other = columns[row & 1, s], share[row & 1, s]
            for v in range(count):
                for u in range(count):
                    if not own[v, u]:
                        continue
                    du, dv = sense_u * (u - 0.5 * (count - 1)), sense_v * (v - 0.5 * (count - 1))
                    for c in range(channels):
                        value, square = between_pixels(
                            mean, spread, centres[row, column, 0] + du, centres[row, column, 1] + dv, c
                        )
                        if other > 0.0:
                            more, more_square = between_pixels(
                                mean, spread, centres[row, column + 1, 0] + du, centres[row, column + 1, 1] + dv, c
                            )
                            value = (1.0 - other) * value + other * more
                            square = (1.0 - other) ** 2 * square + other**2 * more_square
                        data[v, u, t, s, c] = value
                        stderr[v, u, t, s, c] = np.sqrt(square)


def _divide(data: Samples, stderr: Samples, white: Samples, white_stderr: Samples) -> None:
    """Divide a light field by the white one in place, channel by channel; dark samples become NaN."""
    for c in range(data.shape[-1]):
        lit = white[..., c][np.isfinite(white[..., c])]
        limit = DARK * float(np.percentile(lit, BRIGHT_PERCENTILE)) if lit.size else 0.0
        _divide_channel(data[..., c], stderr[..., c], white[..., c], white_stderr[..., c], limit)


@kernel
def _divide_channel(data: Samples, stderr: Samples, white: Samples, white_stderr: Samples, limit: float) -> None:
    views_v, views_u, height, width = data.shape
    for v in range(views_v):
        for u in range(views_u):
            for t in range(height):
                for s in range(width):
                    light = float(white[v, u, t, s])
                    if not light > limit:
                        data[v, u, t, s], stderr[v, u, t, s] = np.nan, np.nan
                        continue
                    ratio = data[v, u, t, s] / light
                    error = np.hypot(stderr[v, u, t, s], ratio * white_stderr[v, u, t, s]) / light
                    data[v, u, t, s], stderr[v, u, t, s] = ratio, error
