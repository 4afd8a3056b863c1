"""Positions of micro-images from the phase of the white image at the lattice's spatial frequencies.

The window fades to zero at the neighbours' centres. This removes the bias that background and border sampling give a
centroid.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.calibration.centres import find_centroids
from lfmesh.scene import Scene

Array = NDArray[np.float64]

ELSEWHERE = 0.25
"""Offset, over the pitch, beyond which the lattice found is that of the light between micro-images."""


def micro_image_places(light: Array, scene: Scene, near: Array | None = None) -> Array:
    """Return the positions of all micro-images, (rows, columns, 2) pixels; NaN: none, or its window leaves the sensor.

    Parameters
    ----------
    light : (H, W) float64
        White image, oriented like the raw image, C-contiguous.
    scene : Scene
        Solved.
    near : (rows, columns, 2) float64, optional
        Approximate positions. Overlapping micro-images are brightest between them, where a search from the pitch alone
        would lock on.

    Raises
    ------
    LfmeshError
        As for `find_centroids`.
    """
    found = find_centroids(light, scene)
    ideal = Lattice(found.hexagonal, 1.0, *found.known.shape[::-1]).centres()
    terms = np.column_stack([ideal.reshape(-1, 2), np.ones(ideal[..., 0].size)])
    affine, *_ = np.linalg.lstsq(terms, found.lattice.reshape(-1, 2), rcond=None)
    to_px = affine[:2].T
    lattice = found.lattice
    if near is not None:
        beside = np.nanmean(near - lattice, axis=(0, 1))
        lattice = lattice + (beside if np.linalg.norm(beside) > ELSEWHERE * found.pitch else 0.0)
    waves = _waves(found.hexagonal)
    fades = np.array([1.0, ROW_SPACING if found.hexagonal else 1.0])
    sums = np.empty((*found.known.shape, len(waves)), np.complex128)
    _fill_sums(light, lattice, np.linalg.inv(to_px), waves, fades, sums)
    shifts = _shifts(sums, waves) @ to_px.T
    return np.where(found.known[..., None], lattice + shifts, np.nan)


def _waves(hexagonal: bool) -> Array:
    """Return reciprocal vectors of the lattice of pitch 1, (n, 2), without their opposites.

    A square lattice has two; a hexagonal one gets the six shortest, as nearly touching disks leave little modulation
    along the first three.
    """
    if not hexagonal:
        return np.eye(2)
    first, second = np.array([1.0, np.sqrt(1.0 / 3.0)]), np.array([0.0, np.sqrt(4.0 / 3.0)])
    return np.array([first, first - second, second, first + second, 2.0 * first - second, first - 2.0 * second])


def _shifts(sums: Array, waves: Array) -> Array:
    """Return the shift of every micro-image, (rows, columns, 2), in pitches, by least squares on its phases.

    Parameters
    ----------
    sums : (rows, columns, waves) complex128
        Sums of windowed light times each wave.
    waves : (waves, 2) float64

    Notes
    -----
    Phases are weighted by the square of the wave's mean amplitude, which is negative if micro-images are dark at the
    middle of a wave: if they overlap, or are much smaller than the pitch.
    """
    mean = np.nanmean(sums.reshape(-1, len(waves)), axis=0)
    phases = np.angle(sums * np.where(mean.real < 0.0, -1.0, 1.0)) / (2.0 * np.pi)
    weighted = waves * np.abs(mean)[:, None] ** 2
    return np.asarray(phases @ weighted @ np.linalg.inv(waves.T @ weighted))


@kernel
def _fill_sums(
    light: Array, centres: Array, to_lattice: Array, waves: Array, fades: Array, sums: NDArray[np.complex128]
) -> None:
    """Fill (rows, columns, waves) sums of light times waves about each centre; NaN where the window leaves the sensor.

    Parameters
    ----------
    light : (H, W) float64
    centres : (rows, columns, 2) float64
        Pixels.
    to_lattice : (2, 2) float64
        Pixels to coordinates of a lattice of pitch 1.
    waves : (waves, 2) float64
        Reciprocal vectors of that lattice.
    fades : (2,) float64
        End of the window in those coordinates, so that constants and other waves cancel.
    sums : (rows, columns, waves) complex128
    """
    height, width = light.shape
    rows, columns, _ = centres.shape
    # Half the bounding box of the window.
    det = to_lattice[0, 0] * to_lattice[1, 1] - to_lattice[0, 1] * to_lattice[1, 0]
    reach_x = (abs(to_lattice[1, 1]) * fades[0] + abs(to_lattice[0, 1]) * fades[1]) / abs(det)
    reach_y = (abs(to_lattice[1, 0]) * fades[0] + abs(to_lattice[0, 0]) * fades[1]) / abs(det)
    for row in range(rows):
        for column in range(columns):
            x, y = centres[row, column, 0], centres[row, column, 1]
            sums[row, column] = np.nan
            left, right = int(np.ceil(x - reach_x)), int(np.floor(x + reach_x))
            bottom, top = int(np.ceil(y - reach_y)), int(np.floor(y + reach_y))
            if left < 0 or bottom < 0 or right >= width or top >= height:
                continue
            for wave in range(len(waves)):
                real, imaginary = 0.0, 0.0
                for r in range(bottom, top + 1):
                    for c in range(left, right + 1):
                        u = to_lattice[0, 0] * (c - x) + to_lattice[0, 1] * (r - y)
                        v = to_lattice[1, 0] * (c - x) + to_lattice[1, 1] * (r - y)
                        if abs(u) >= fades[0] or abs(v) >= fades[1]:
                            continue
                        along_u = 0.5 + 0.5 * np.cos(np.pi * u / fades[0])
                        weight = light[r, c] * along_u * (0.5 + 0.5 * np.cos(np.pi * v / fades[1]))
                        angle = 2.0 * np.pi * (waves[wave, 0] * u + waves[wave, 1] * v)
                        real += weight * np.cos(angle)
                        imaginary += weight * np.sin(angle)
                sums[row, column, wave] = complex(real, imaginary)
