"""Places of micro-images by the phase of the white image at the lattice's own spatial frequencies, one by one.

A window that fades to nothing at the neighbours' middles makes the sums blind to where pixels cut the border of a
micro-image, and to a constant background; both drag a centroid along.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice
from lfmesh.kernels.decorators import kernel
from lfmesh.lightfield.calibration.centres import find_centroids
from lfmesh.scene import Scene

Array = NDArray[np.float64]

ELSEWHERE = 0.25
"""Of the pitch: a lattice that lies so far beside the micro-images is that of the light between them."""


def micro_image_places(light: Array, scene: Scene, near: Array | None = None) -> Array:
    """Return where every micro-image lies, (rows, columns, 2) pixels; NaN where there is none or the window leaves.

    Parameters
    ----------
    light : (H, W) float64
        White image as the raw image lies, C-contiguous.
    scene : Scene
        Solved.
    near : (rows, columns, 2) float64, optional
        About where they lie. Where micro-images overlap, the light is brightest between them, and the search, which
        knows the pitch alone, takes that for micro-images.

    Raises
    ------
    LfmeshError
        As `find_centroids`.
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
    """Return reciprocal vectors of the lattice of pitch 1, (n, 2), one of each with its opposite.

    Two of a square one. Of a hexagonal one the three shortest and the three next: disks that nearly touch fill it so
    well that the light hardly changes along the shortest.
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
        Of windowed light times each wave.
    waves : (waves, 2) float64

    Notes
    -----
    A phase counts by the square of the wave's mean amplitude. Where micro-images overlap, or are small against the
    pitch, they are dark at the middle of a wave: its amplitude is negative, half a turn away.
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
        Where the window ends, in those coordinates: there no other wave of the lattice, nor a constant, adds to a sum.
    sums : (rows, columns, waves) complex128
    """
    height, width = light.shape
    rows, columns, _ = centres.shape
    # Half the box that holds the window.
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
