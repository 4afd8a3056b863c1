"""From a point of the sensor through the lenslets that show it the opening of the lens: which, where, how densely.

`lenslet_view` measures beforehand what each lenslet shows; here a path is started with it.
"""

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lattice import ROW_SPACING, Lattice, cell_of, centre, half_hexagon
from lfmesh.kernel import inlined, kernel, pasted
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.tables import Aim, ArrayTables

Array = NDArray[np.float64]

CELL_U, CELL_V, PIXEL_U, PIXEL_V, WHICH_CELL, DISCRETE = 0, 1, 2, 3, 4, 5
"""The point of the lenslet gets the evenest: what is sharp in the scene is sharp there, where the image is in focus."""

MARGIN_SHARE = 0.05
"""Share of the rays to lenslets that may show the opening, beside those that surely do."""

_CORNERS = (
    (0.5, 0.5 / np.sqrt(3.0)),
    (-0.5, 0.5 / np.sqrt(3.0)),
    (0.0, -1.0 / np.sqrt(3.0)),
    (0.5, 0.5 / np.sqrt(3.0)),
)
"""Every other corner of a hexagon one wide, and the first again."""

HALF_DIAGONAL = 0.72
"""Of a pixel, with a margin, in its width: how far from its middle a path may start."""

Numbers = tuple[float, float, float, float, float, float]
"""What a path starts from, in [0, 1): point of the lenslet (or pupil), place in the pixel, which lenslet, what else."""


def most_listed(aim: Aim) -> int:
    """Return how many lenslets `list_cells` may list."""
    return (2 * aim.search + 1) ** 2


@pasted
def list_cells(array: ArrayTables, aim: Aim, x: float, y: float, z: float, reach: float, near: Array) -> int:
    """List the lenslets that show (part of) the lens's opening to a point of the sensor or one within reach of it.

    Returns
    -------
    int
        How many; `near` has a row for each: its centre, and the middle and the radius of the opening as it sees it.
    """
    lattice = array.lenslets.lattice
    over = 1.0 / abs(z - aim.lenslet_z)
    kappa = aim.pupil_vergence
    # Where the chief ray meets the array.
    column, row = cell_of(
        lattice, (kappa * aim.pupil_x + over * x) / (kappa + over), (kappa * aim.pupil_y + over * y) / (kappa + over)
    )
    count = 0
    for r in range(max(row - aim.search, 0), min(row + aim.search + 1, lattice.rows)):
        for c in range(max(column - aim.search, 0), min(column + aim.search + 1, lattice.columns)):
            cell = r * lattice.columns + c
            radius2 = aim.slope_radius2[cell]
            cx, cy = centre(lattice, c, r)
            a, b = (cx - x) * over - aim.slope[cell, 0], (cy - y) * over - aim.slope[cell, 1]
            limit = np.sqrt(max(radius2, 0.0)) + reach * over
            # Without a branch, which would be guessed wrong every other time.
            near[count, 0], near[count, 1] = cx, cy
            near[count, 2], near[count, 3], near[count, 4] = aim.slope[cell, 0], aim.slope[cell, 1], radius2
            count += a * a + b * b <= limit * limit and radius2 >= 0.0
    return count


@pasted
def through_a_lenslet(
    array: ArrayTables, aim: Aim, normal: tuple[float, float, float], near: Array, listed: int,
    cells: NDArray[np.int64], numbers: Numbers, x: float, y: float, z: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction (array frame) from a point of the sensor, and cos θ over its density.

    Uniform over the cells that surely show the pupil to the point, mixed with some over all that may, which are a
    margin larger: the cells are aimed at where the sensor sees the borders of their faces, through the plate, and the
    borders are deeper at the corners. And with a few directions from the whole hemisphere, for ghosts and stray light;
    a point to which no cell shows the opening sends only those.

    Parameters
    ----------
    near, listed
        Lenslets that may show the opening, and how many, from `list_cells`.
    """
    lattice = array.lenslets.lattice
    nx, ny, nz = normal
    distance = abs(z - aim.border_z)
    toward = -1.0 if array.curved_to_lens else 1.0
    maybe, surely = cells_that_show(aim, near, listed, cells, x, y, z)
    wide = aim.blind_share if maybe == 0 else aim.wide_share
    sure = (1.0 - MARGIN_SHARE) * (1.0 - wide) if surely > 0 else 0.0
    size = lattice.pitch + 2.0 * aim.cell_margin
    if numbers[DISCRETE] < wide:
        dx, dy, dz = lambertian(nx, ny, nz, numbers[CELL_U], numbers[CELL_V])
    elif maybe == 0:
        return 0.0, 0.0, 0.0, 0.0
    else:
        is_sure = numbers[DISCRETE] >= 1.0 - sure
        among, count, width = (2, surely, lattice.pitch) if is_sure else (0, maybe, size)
        chosen = cells[among, min(int(numbers[WHICH_CELL] * count), count - 1)]
        u, v = _point_of_cell(lattice.hexagonal, numbers[CELL_U], numbers[CELL_V])
        dx, dy, dz = near[chosen, 0] + u * width - x, near[chosen, 1] + v * width - y, toward * distance
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        dx, dy, dz = dx * scale, dy * scale, dz * scale
    cos_theta = nx * dx + ny * dy + nz * dz
    density = wide * cos_theta / np.pi
    if maybe > 0 and dz * toward > 0.0:
        density += density_through_cells(array, aim, near, cells, maybe, surely, 1.0 - wide, x, y, z, dx, dy, dz)
    return dx, dy, dz, cos_theta / density


@pasted
def cells_that_show(
    aim: Aim, near: Array, listed: int, cells: NDArray[np.int64], x: float, y: float, z: float
) -> tuple[int, int]:
    """Find the listed lenslets that may show the opening to a point; return how many, and how many surely do.

    `cells` has their numbers in the list: [0] those that may, [1] whether each surely does, [2] those that surely do.
    """
    over = 1.0 / abs(z - aim.lenslet_z)
    maybe, surely = 0, 0
    for cell in range(listed):
        a, b = (near[cell, 0] - x) * over - near[cell, 2], (near[cell, 1] - y) * over - near[cell, 3]
        off2, radius2 = a * a + b * b, near[cell, 4]
        shows = off2 <= aim.sure2 * radius2
        cells[0, maybe], cells[1, maybe], cells[2, surely] = cell, shows, cell
        maybe += off2 <= radius2
        surely += shows
    return maybe, surely


@pasted
def density_through_cells(
    array: ArrayTables, aim: Aim, near: Array, cells: NDArray[np.int64], maybe: int, surely: int, share: float,
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
) -> float:  # fmt: skip
    """Return the density per solid angle with which a `share` of the rays, aimed at cells, is sent in a direction.

    Every aimed cell that holds the direction could have drawn it. Zero: what comes from there is outside the aim.
    """
    lattice = array.lenslets.lattice
    distance, cos_array = abs(z - aim.border_z), abs(dz)
    t = distance / cos_array
    px, py = x + t * dx, y + t * dy
    drawn, drawn_surely = 0, 0
    half, size = 0.5 * lattice.pitch, lattice.pitch + 2.0 * aim.cell_margin
    for i in range(maybe):
        out = half_width_to(lattice, px - near[cells[0, i], 0], py - near[cells[0, i], 1])
        drawn += out <= half + aim.cell_margin
        drawn_surely += cells[1, i] * (out <= half)
    sure = (1.0 - MARGIN_SHARE) * share if surely > 0 else 0.0
    area = lattice.pitch * lattice.pitch * (ROW_SPACING if lattice.hexagonal else 1.0)
    per_area = (share - sure) * drawn / (maybe * size * size) * lattice.pitch * lattice.pitch
    if surely > 0:
        per_area += sure * drawn_surely / surely
    return per_area * distance * distance / (area * cos_array * cos_array * cos_array)


@inlined
def half_width_to(lattice: Lattice, x: float, y: float) -> float:
    """Return the half pitch of a cell at the origin whose border goes through a point."""
    return half_hexagon(x, y) if lattice.hexagonal else max(abs(x), abs(y))


@kernel
def _point_of_cell(hexagonal: bool, u: float, v: float) -> tuple[float, float]:
    """Return a uniform point of the cell at the origin, in pitches."""
    if not hexagonal:
        return u - 0.5, v - 0.5
    # Three rhombi make the hexagon, each spanned by two radii to corners: at 30°, 150° and 270°.
    third = int(3.0 * u)
    u = 3.0 * u - third
    ax, ay = _CORNERS[third]
    bx, by = _CORNERS[third + 1]
    return u * ax + v * bx, u * ay + v * by
