"""Chords of rays through voxels, summed into rows of a sparse matrix.

The walk from voxel to voxel follows J. Amanatides & A. Woo, "A fast voxel traversal algorithm for ray tracing",
Eurographics 1987. Distances to faces are computed from voxel numbers, so rounding errors do not accumulate.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.transport.events.volume import Line, Ray, pass_through

Array = NDArray[np.float64]


class Room(NamedTuple):
    """Working memory of `sum_rows`; all but `first_touched` and `touched` is 0 between calls."""

    own: Array  # (voxels,) sums of the replicate
    total: Array  # (voxels,) sums of the row
    squares: Array  # (voxels,)
    first_touched: NDArray[np.int64]  # (voxels,) voxels met by the replicate
    touched: NDArray[np.int64]  # (voxels,) voxels met by the row
    met: NDArray[np.uint8]  # (voxels,) 1 for voxels in `touched`


def room_for(voxels: int) -> Room:
    """Return working memory for a grid."""
    numbers = np.zeros(voxels, np.int64)
    return Room(
        np.zeros(voxels), np.zeros(voxels), np.zeros(voxels), numbers, numbers.copy(), np.zeros(voxels, np.uint8)
    )


class Rows(NamedTuple):
    """Rows of a sparse matrix under construction."""

    column: NDArray[np.int32]  # (capacity,)
    value: Array  # (capacity,)
    error: NDArray[np.float32]  # (capacity,) standard error
    end: NDArray[np.int64]  # (rows,) number of entries up to and including each row
    row_error: Array  # (rows,) standard error of the row's sum
    dropped: Array  # (rows,) sum of the dropped entries


class Haze(NamedTuple):
    """Attenuation of rays by media, glass and liquids; `volumes` is None without media."""

    volumes: Any
    origin: Array  # (n, 3) ray origins, mm, object frame
    direction: Array  # (n, 3)
    colour: NDArray[np.int64]  # (n,) index of each ray's wavelength
    book: Array  # (0,) nothing is booked
    place: NDArray[np.int64]  # (n,) rank of each ray's body; 0: air
    per_mm: Array  # (n,) absorption coefficient of the glass or liquid around each ray, 1/mm


@kernel
def _passed(volumes: Any, haze: Haze, ray: int, begin: float, end: float) -> float:
    """Return the transmittance of media, which may be None, and glass along a piece of a ray."""
    clear = np.exp(-haze.per_mm[ray] * (end - begin))
    if volumes is None:
        return clear
    o, d = haze.origin[ray], haze.direction[ray]
    x, y, z = o[0] + begin * d[0], o[1] + begin * d[1], o[2] + begin * d[2]
    line = Line(Ray(x, y, z, d[0], d[1], d[2]), haze.place[ray], haze.colour[ray], None, 0)
    passage = pass_through(volumes, line, end - begin, haze.book, 0.0, np.uint64(0))
    return passage.transmittance * clear


@inlined
def walk(
    px: float, py: float, pz: float, dx: float, dy: float, dz: float, length: float, weight: float,
    nx: int, ny: int, nz: int, haze: Haze, ray: int, room: Room, touched: int,
) -> int:  # fmt: skip
    """Add weight times chord to every voxel that a ray crosses; return the replicate's number of voxels so far.

    Attenuation is included, as if uniform along the chord in the emitting voxel.

    Parameters
    ----------
    px, py, pz, dx, dy, dz : float
        Ray in units of voxels, see `VoxelBox.in_voxels`.
    length : float, mm
        End of the ray.
    weight : float
    nx, ny, nz : int
        Voxels of the grid.
    haze : Haze
    ray : int
        Number of the ray.
    room : Room
    touched : int
        Number of voxels that the replicate has met before.
    """
    enter, leave = 0.0, length
    for axis in range(3):
        p, d, n = px, dx, nx
        if axis == 1:
            p, d, n = py, dy, ny
        elif axis == 2:
            p, d, n = pz, dz, nz
        if d == 0.0:
            if p < 0.0 or p > n:
                return touched
            continue
        one, other = -p / d, (n - p) / d
        enter = max(enter, min(one, other))
        leave = min(leave, max(one, other))
    if not enter < leave:
        return touched
    i = min(max(int(np.floor(px + enter * dx)), 0), nx - 1)
    j = min(max(int(np.floor(py + enter * dy)), 0), ny - 1)
    k = min(max(int(np.floor(pz + enter * dz)), 0), nz - 1)
    here = enter
    left = weight * _passed(haze.volumes, haze, ray, 0.0, enter)
    while True:
        to_x = ((i + 1 if dx > 0.0 else i) - px) / dx if dx != 0.0 else np.inf
        to_y = ((j + 1 if dy > 0.0 else j) - py) / dy if dy != 0.0 else np.inf
        to_z = ((k + 1 if dz > 0.0 else k) - pz) / dz if dz != 0.0 else np.inf
        ahead = min(to_x, to_y, to_z)
        there = min(ahead, leave)
        if there > here:
            voxel = (i * ny + j) * nz + k
            if room.own[voxel] == 0.0:
                room.first_touched[touched] = voxel
                touched += 1
            if haze.volumes is None and haze.per_mm[ray] == 0.0:
                room.own[voxel] += weight * (there - here)
            else:
                passed = _passed(haze.volumes, haze, ray, here, there)
                # Mean of exp(-τ) over the chord.
                mean = (passed - 1.0) / np.log(passed) if 0.0 < passed < 1.0 else passed
                room.own[voxel] += left * mean * (there - here)
                left *= passed
            here = there
        if ahead >= leave:
            return touched
        if to_x == ahead:
            i += 1 if dx > 0.0 else -1
            if i < 0 or i >= nx:
                return touched
        elif to_y == ahead:
            j += 1 if dy > 0.0 else -1
            if j < 0 or j >= ny:
                return touched
        else:
            k += 1 if dz > 0.0 else -1
            if k < 0 or k >= nz:
                return touched


@kernel
def sum_rows(
    begin: int, p: Array, d: Array, length: Array, weight: Array, first: NDArray[np.int64], replicates: int,
    nx: int, ny: int, nz: int, threshold: float, haze: Haze, room: Room, rows: Rows,
) -> int:  # fmt: skip
    """Sum the rays of each row into sparse entries: means over replicates with standard errors.

    Parameters
    ----------
    begin : int
        First row to fill.
    p, d : (n, 3) float64
        In units of voxels, sorted by row and replicate.
    length, weight : (n,) float64
    first : (rows · replicates + 1,) int64
        First ray of each replicate of each row.
    replicates : int
    nx, ny, nz : int
    threshold : float
        Entries below this fraction of their row's largest are dropped.
    haze : Haze
    room : Room
    rows : Rows

    Returns
    -------
    int
        First row that does not fit into `rows`, or the number of rows if all do.
    """
    for row in range(begin, len(rows.end)):
        filled = rows.end[row - 1] if row > 0 else 0
        met, of_row, squares_of_row = 0, 0.0, 0.0
        for replicate in range(replicates):
            place = row * replicates + replicate
            touched = 0
            for ray in range(first[place], first[place + 1]):
                if weight[ray] > 0.0:
                    touched = walk(
                        p[ray, 0], p[ray, 1], p[ray, 2], d[ray, 0], d[ray, 1], d[ray, 2], length[ray], weight[ray],
                        nx, ny, nz, haze, ray, room, touched,
                    )  # fmt: skip
            of_replicate = 0.0
            for t in range(touched):
                voxel = room.first_touched[t]
                own = room.own[voxel]
                room.own[voxel] = 0.0
                room.total[voxel] += own
                room.squares[voxel] += own * own
                of_replicate += own
                if room.met[voxel] == 0:
                    room.met[voxel] = 1
                    room.touched[met] = voxel
                    met += 1
            of_row += of_replicate
            squares_of_row += of_replicate * of_replicate
        fits = filled + met <= len(rows.column)
        largest = 0.0
        for t in range(met):
            largest = max(largest, room.total[room.touched[t]])
        dropped = 0.0
        for t in range(met):
            voxel = room.touched[t]
            total, squares = room.total[voxel], room.squares[voxel]
            room.total[voxel], room.squares[voxel], room.met[voxel] = 0.0, 0.0, 0
            if not fits:
                continue
            if total < threshold * largest:
                dropped += total / replicates
                continue
            rows.column[filled] = voxel
            rows.value[filled] = total / replicates
            rows.error[filled] = _spread(total, squares, replicates)
            filled += 1
        if not fits:
            return row
        rows.end[row], rows.dropped[row] = filled, dropped
        rows.row_error[row] = _spread(of_row, squares_of_row, replicates)
    return len(rows.end)


@inlined
def _spread(total: float, squares: float, count: int) -> float:
    """Return the standard error of a mean from sums of numbers and squares; NaN for one number."""
    if count < 2:
        return np.nan
    mean = total / count
    return np.sqrt(max(squares / count - mean * mean, 0.0) / (count - 1))
