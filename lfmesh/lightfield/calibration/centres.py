"""Centres of the micro-images from a white image, as for a real camera."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LfmeshError
from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.calibration.calibration import Calibration, calibration_of, continued
from lfmesh.lightfield.rays.ray_model import RayModel
from lfmesh.scene import Scene
from lfmesh.transport.render.image import Image

Array = NDArray[np.float64]

ROUNDS = 6
"""Number of times that the lattice is fitted to the centroids, each from a better start."""

LIT = 0.25
"""A micro-image darker than this fraction of the median one has no centre of its own."""

CLIP = 0.85
"""Light is clipped at this fraction of a micro-image's brightness.

A micro-image has the shape of the pupil; neither noise nor the fall-off of light across it should move its centre.
"""

PROBE = 0.02
"""Shift of the cells, over the pitch, that probes the effect of their borders."""

LEAST_PULL = 0.1
"""Lower limit of 1 − drag, reached if micro-images touch all round and can hardly be seen."""

CONTRAST = 0.02
"""Depth of the dark between micro-images, over their mean, below which centres cannot be found."""


def estimate_centres(white: Image, scene: Scene | None = None) -> Calibration:
    """Find the centres of the micro-images from a white image, given layout, count and nominal pitch.

    The phase of the white image at the lattice's spatial frequencies places the lattice. Then each micro-image's
    centroid over its cell, with subpixel borders, moves its centre, and a lattice fitted to all centres moves the
    cells. `Calibration.error_px` gives the errors.

    Parameters
    ----------
    white : Image
        From `lf.white_image`.
    scene : Scene, optional
        Default: that of the image.

    Returns
    -------
    Calibration

    Raises
    ------
    LfmeshError
        A conventional camera, a black image, or no dark between the micro-images.
    """
    scene = solved_camera(white.scene if scene is None else scene).scene
    light = np.ascontiguousarray(white.mean.sum(axis=2))
    found = find_centroids(light, scene)
    own = _without_noise(found, light, np.nan_to_num((white.stderr**2).sum(axis=2)))
    return calibration_of(scene, continued(found.lattice + own, found.known), found.known, "white image")


class Centroids(NamedTuple):
    """Centroids of the micro-images of a white image, not smoothed.

    Attributes
    ----------
    lattice : (rows, columns, 2) float64, pixels
        Points of the best-fitting lattice.
    shifts : (rows, columns, 2) float64, pixels
        Offset of each centroid from its lattice point; 0 if unknown.
    known : (rows, columns) bool
    drag : float
        Motion of a centroid over the motion of its cell; `shifts` are corrected for it.
    pitch : float
        Width of the cells, pixels.
    hexagonal : bool
    """

    lattice: Array
    shifts: Array
    known: NDArray[np.bool_]
    drag: float
    pitch: float
    hexagonal: bool

    @property
    def centres_px(self) -> Array:
        """(rows, columns, 2): the centroids."""
        return np.asarray(self.lattice + self.shifts)


def find_centroids(light: Array, scene: Scene) -> Centroids:
    """Find the centroids of the micro-images.

    Parameters
    ----------
    light : (H, W) float64
        White image in any linear unit, C-contiguous, oriented like the raw image.
    scene : Scene
        Solved.

    Raises
    ------
    LfmeshError
        As from `estimate_centres`.
    """
    model = RayModel.of(scene)
    mla = scene.camera.mla
    assert mla is not None
    hexagonal, nominal = mla.layout == "hexagonal", model.micro_image_pitch_px
    ideal = Lattice(hexagonal, 1.0, *mla.count).centres()
    centres = nominal * ideal + 0.5 * (np.asarray(light.shape[::-1]) - 1.0)
    centres = centres + _phase_shift(light, centres, nominal, hexagonal)
    for _ in range(ROUNDS):
        moved, known = _centroids(light, centres, nominal, hexagonal)
        centres = _fitted(ideal, moved, known)
    shifts, known, drag = _own_shifts(light, centres, nominal, hexagonal)
    return Centroids(centres, shifts, known, drag, nominal, hexagonal)


def _fitted(ideal: Array, centres: Array, known: NDArray[np.bool_]) -> Array:
    """Return the lattice, shifted, rotated, scaled and sheared, that best fits the known centres."""
    terms = np.concatenate([ideal, np.ones((*known.shape, 1))], axis=-1)
    fit, *_ = np.linalg.lstsq(terms[known], centres[known], rcond=None)
    return np.asarray(terms @ fit)


def _own_shifts(light: Array, centres: Array, pitch: float, hexagonal: bool) -> tuple[Array, NDArray[np.bool_], float]:
    """Return the offsets of micro-images from the lattice, pixels, a mask of known ones, and the drag of cells.

    An offset cell loses light on one side and gains a neighbour's on the other, which drags the centroid along. Moving
    all cells measures the drag.
    """
    probe = PROBE * pitch
    moved, known = _centroids(light, centres, pitch, hexagonal)
    dragged = [_centroids(light, centres + step, pitch, hexagonal)[0] - centres for step in (probe, -probe)]
    drag = float((dragged[0] - dragged[1])[known].mean()) / (2.0 * probe)
    return np.where(known[..., None], (moved - centres) / max(1.0 - drag, LEAST_PULL), 0.0), known, drag


def _without_noise(found: Centroids, light: Array, variance: Array) -> Array:
    """Reduce the offsets of micro-images by the fraction of their variance due to pixel noise.

    This Wiener filter keeps a perfect array from looking imperfect.
    """
    seen = float((found.shifts[found.known] ** 2).mean())
    centroid = _centroid_variance(light, variance, found.lattice, found.pitch, found.hexagonal)
    noise = float(centroid[found.known].mean()) / (1.0 - found.drag) ** 2
    return found.shifts * max(0.0, 1.0 - noise / seen) if seen > 0.0 else found.shifts


def _phase_shift(light: Array, centres: Array, pitch: float, hexagonal: bool) -> Array:
    """Return the shift (x, y) in pixels, within half a pitch, that moves a lattice to the bright places."""
    row, column = (np.arange(size) for size in light.shape)
    start = centres.reshape(-1, 2).mean(axis=0)
    # Two reciprocal vectors of the lattice, and one of its points as the origin of phases.
    waves = np.array([[1.0, -np.sqrt(1.0 / 3.0)], [0.0, np.sqrt(4.0 / 3.0)]] if hexagonal else [[1.0, 0.0], [0.0, 1.0]])
    waves = waves / pitch
    point = centres.reshape(-1, 2)[int(np.argmin(((centres.reshape(-1, 2) - start) ** 2).sum(axis=1)))]
    phases = []
    for kx, ky in waves:
        along_y = np.exp(-2j * np.pi * ky * (row - point[1]))
        along_x = np.exp(-2j * np.pi * kx * (column - point[0]))
        amplitude = complex(along_y @ light @ along_x)
        if abs(amplitude) <= 0.5 * CONTRAST * light.sum():
            raise LfmeshError(
                "the white image shows no micro-images: "
                + ("it is black" if not light.any() else "they touch without dark gaps; stop the lens down")
            )
        phases.append(-np.angle(amplitude) / (2.0 * np.pi))
    return np.asarray(np.linalg.solve(waves, phases))


def _centroids(light: Array, centres: Array, pitch: float, hexagonal: bool) -> tuple[Array, NDArray[np.bool_]]:
    """Return the centroid of the light in each cell, and a mask of cells with enough light."""
    rows, columns, _ = centres.shape
    moved, power = np.empty_like(centres), np.empty((rows, columns))
    _cell_centroids(light, centres, pitch, hexagonal, moved, power)
    inside = power >= 0.0
    known = inside & (power > LIT * np.median(power[inside])) if inside.any() else inside
    if known.sum() < 4:
        raise LfmeshError("the white image shows fewer than four whole micro-images")
    return moved, known


@kernel
def _cell_centroids(light: Array, centres: Array, pitch: float, hexagonal: bool, moved: Array, power: Array) -> None:
    """Fill in centroids and power of all cells; the power is −1 for cells that leave the sensor."""
    height, width = light.shape
    rows, columns, _ = centres.shape
    half = 0.5 * pitch
    reach = int(half / np.cos(np.pi / 6.0) + 1.5)
    for row in range(rows):
        for column in range(columns):
            x, y = centres[row, column, 0], centres[row, column, 1]
            moved[row, column, 0], moved[row, column, 1], power[row, column] = x, y, -1.0
            first_c, first_r = int(np.floor(x)) - reach, int(np.floor(y)) - reach
            last_c, last_r = first_c + 2 * reach + 1, first_r + 2 * reach + 1
            if not (x - half >= -0.5 and x + half <= width - 0.5 and y - half >= -0.5 and y + half <= height - 0.5):
                continue
            limit = CLIP * _brightness(light, x, y, 0.5 * half)
            total, sum_x, sum_y = 0.0, 0.0, 0.0
            for r in range(max(first_r, 0), min(last_r, height - 1) + 1):
                for c in range(max(first_c, 0), min(last_c, width - 1) + 1):
                    share = _share_inside(c - x, r - y, half, hexagonal) * min(light[r, c], limit)
                    total += share
                    sum_x += share * (c - x)
                    sum_y += share * (r - y)
            power[row, column] = total
            if total > 0.0:
                moved[row, column, 0] += sum_x / total
                moved[row, column, 1] += sum_y / total


def _centroid_variance(light: Array, variance: Array, centres: Array, pitch: float, hexagonal: bool) -> Array:
    """Return the variance of each centroid, mean of x and y, from the pixels' variance; 0 outside the sensor."""
    result = np.zeros(centres.shape[:2])
    _fill_centroid_variance(light, variance, centres, pitch, hexagonal, result)
    return result


@kernel
def _fill_centroid_variance(
    light: Array, variance: Array, centres: Array, pitch: float, hexagonal: bool, result: Array
) -> None:
    height, width = light.shape
    rows, columns, _ = centres.shape
    half = 0.5 * pitch
    reach = int(half / np.cos(np.pi / 6.0) + 1.5)
    for row in range(rows):
        for column in range(columns):
            x, y = centres[row, column, 0], centres[row, column, 1]
            limit = CLIP * _brightness(light, x, y, 0.5 * half)
            total, square = 0.0, 0.0
            for r in range(max(int(y) - reach, 0), min(int(y) + reach + 2, height)):
                for c in range(max(int(x) - reach, 0), min(int(x) + reach + 2, width)):
                    share = _share_inside(c - x, r - y, half, hexagonal)
                    total += share * min(light[r, c], limit)
                    if light[r, c] >= limit:
                        continue
                    square += share * share * ((c - x) ** 2 + (r - y) ** 2) * variance[r, c]
            if total > 0.0:
                result[row, column] = 0.5 * square / (total * total)


@kernel
def _brightness(light: Array, x: float, y: float, radius: float) -> float:
    """Return the mean of the pixels within a radius, or of the nearest one."""
    height, width = light.shape
    total, count = light[min(max(int(y + 0.5), 0), height - 1), min(max(int(x + 0.5), 0), width - 1)], 1
    for r in range(max(int(y - radius), 0), min(int(y + radius) + 2, height)):
        for c in range(max(int(x - radius), 0), min(int(x + radius) + 2, width)):
            if (c - x) ** 2 + (r - y) ** 2 <= radius * radius:
                total += light[r, c]
                count += 1
    return total / count


@kernel
def _share_inside(dx: float, dy: float, half: float, hexagonal: bool) -> float:
    """Return the approximate fraction of a pixel inside a cell, from its distance to each border."""
    if not hexagonal:
        return min(max(half - abs(dx) + 0.5, 0.0), 1.0) * min(max(half - abs(dy) + 0.5, 0.0), 1.0)
    a, b = 0.5 * dx, ROW_SPACING * dy
    farthest = max(abs(dx), abs(a + b), abs(a - b))
    return min(max(half - farthest + 0.5, 0.0), 1.0)
