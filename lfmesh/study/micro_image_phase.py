"""Places of micro-images by the phase of the white image at the lattice's own spatial frequencies, one by one.

A window that fades to nothing at the neighbours' middles makes the sums blind to where pixels cut the border of a
micro-image, and to a constant background; both drag a centroid along.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lattice import Lattice
from lfmesh.kernel import kernel
from lfmesh.lightfield.centres import find_centroids
from lfmesh.scene import Scene

Array = NDArray[np.float64]


def micro_image_places(light: Array, scene: Scene) -> Array:
    """Return where every micro-image lies, (rows, columns, 2) pixels; NaN where there is none or the window leaves.

    Parameters
    ----------
    light : (H, W) float64
        White image as the raw image lies, C-contiguous.
    scene : Scene
        Solved.

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
    # Reciprocal vectors of the lattice of pitch 1: two of a square one, three of equal length of a hexagonal one.
    third = np.sqrt(1.0 / 3.0)
    waves = np.array([[1.0, third], [1.0, -third], [0.0, 2.0 * third]] if found.hexagonal else [[1.0, 0.0], [0.0, 1.0]])
    phases = np.empty((*found.known.shape, len(waves)))
    _fill_phases(light, found.lattice, np.linalg.inv(to_px), waves, phases)
    shifts = phases @ np.linalg.pinv(waves).T @ to_px.T
    return np.where(found.known[..., None], found.lattice + shifts, np.nan)


@kernel
def _fill_phases(light: Array, centres: Array, to_lattice: Array, waves: Array, phases: Array) -> None:
    """Fill (rows, columns, waves) phases, in turns, about each centre; NaN where the window leaves the sensor."""
    height, width = light.shape
    rows, columns, _ = centres.shape
    # Half the box that holds the square |u|, |v| < 1 of lattice coordinates.
    det = to_lattice[0, 0] * to_lattice[1, 1] - to_lattice[0, 1] * to_lattice[1, 0]
    reach_x = (abs(to_lattice[1, 1]) + abs(to_lattice[0, 1])) / abs(det)
    reach_y = (abs(to_lattice[1, 0]) + abs(to_lattice[0, 0])) / abs(det)
    for row in range(rows):
        for column in range(columns):
            x, y = centres[row, column, 0], centres[row, column, 1]
            phases[row, column] = np.nan
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
                        if abs(u) >= 1.0 or abs(v) >= 1.0:
                            continue
                        weight = light[r, c] * (0.5 + 0.5 * np.cos(np.pi * u)) * (0.5 + 0.5 * np.cos(np.pi * v))
                        angle = 2.0 * np.pi * (waves[wave, 0] * u + waves[wave, 1] * v)
                        real += weight * np.cos(angle)
                        imaginary += weight * np.sin(angle)
                phases[row, column, wave] = np.arctan2(imaginary, real) / (2.0 * np.pi)
