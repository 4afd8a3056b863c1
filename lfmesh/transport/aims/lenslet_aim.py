"""Directions from the sensor through the lenslets that show the lens's opening, and their density.

`lenslet_view` measures the views through lenslets beforehand; this module draws the directions. Most rays go to a cell
of a lenslet that shows the opening, chosen among several by the root mean square of the light that lenslets show at
that distance from the centre of their view. These rays alone estimate directions that meet such a cell, so they all
carry equal light in an evenly lit pixel. A mixture estimates all other directions, with ghosts and stray light: margin
rays, to cells with a margin of all lenslets that may show the opening, and rays that go anywhere. Intersections with
faces are exact: the ray in the glass must cross the sphere, and a ray aimed at a point of the face reaches it through
the plate.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, centre, columns_near, rows_near
from lfmesh.geometry.array.lenslet_profile import next_fall
from lfmesh.geometry.array.lenslets import Lenslets, is_spherical, shape_of, type_of
from lfmesh.geometry.frame import move_direction
from lfmesh.kernels.decorators import inlined, pasted
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.aims.disk import Vector
from lfmesh.transport.aims.lenslet_faces import (
    face_over,
    half_width_to,
    meets_once,
    on_face,
    path_to_apexes,
    point_of_cell,
    slope_to,
    solid_angle,
    spread_on_face,
)
from lfmesh.transport.packets.packet import MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import LensletAim, MlaTables, SensorTables

Array = NDArray[np.float64]

MARGIN_SHARE = 0.02
"""Share of rays through lenslets that go to any lenslet that may show the opening, by solid angle."""

FEW = 2.0
"""Expected number of a pixel's aimed rays below which each ray is aimed or not at random."""

NUMBER_OF_UNAIMED = -1
"""Number of the child of a pixel's key that draws the number of its other rays; no sample uses it."""

CELL_U, CELL_V, PIXEL_U, PIXEL_V, WHICH_CELL, DISCRETE = 0, 1, 2, 3, 4, 5
"""Dimensions of a path's starting numbers. The point of the lenslet gets the first two, the most evenly distributed:
where the image is in focus, sharp detail in the scene is sharp over the lenslet."""

LISTED = 11
"""Number of values per lenslet in the list of `list_cells`."""

SOLID_ANGLE, CHANCE = 8, 9
"""Two of these values: the relative probabilities of the lenslet for margin rays, by solid angle, and for all others,
also by the light that it shows."""

KIND = 10
"""Last of these values: the type of a non-spherical lenslet."""

ALIKE = 3.5
"""Distance from the chief ray, in pitches, up to which lenslets are taken to have equal solid angles."""

_TINY = float(np.finfo(np.float64).tiny)

HALF_DIAGONAL = 0.72
"""Half diagonal of a pixel, in pixel widths, with a margin: largest distance of a path's start from its centre."""


Numbers = tuple[float, float, float, float, float, float]
"""Starting numbers of a path, in [0, 1): point of the lenslet (or pupil), point of the pixel, lenslet, role."""


class ArraySeen(NamedTuple):
    """Microlens array and its aim.

    Attributes
    ----------
    mla : MlaTables
    aim : LensletAim
    glass : float
        Refractive index of the plate between the sensor and the lenslets' faces, relative to the medium outside; 1
        without a plate.
    """

    mla: MlaTables
    aim: LensletAim
    glass: float


class Shown(NamedTuple):
    """Lenslets that may show the opening to a point.

    Attributes
    ----------
    near : (n, LISTED) float64
        From `list_cells`; `CHANCE` is that of the point.
    cells : (n,) int64
        Indices in that list.
    number : int
        Number of indices.
    by_light, by_angle : float
        Sums of the chances and of the solid angles.
    on_cells, on_wider : float
        Density, 1/mm², on a lenslet's cell of rays that choose by light, over its chance; and on the cell with its
        margin of margin rays, over its solid angle.
    """

    near: Array
    cells: NDArray[np.int64]
    number: int
    by_light: float
    by_angle: float
    on_cells: float
    on_wider: float


def most_listed(aim: LensletAim, search: float) -> int:
    """Return the largest number of lenslets that `list_cells` may list for a `search`."""
    most = (2.0 * search + 1.0) * (2.0 * search / ROW_SPACING + 1.0)
    return int(min(most, len(aim.slope_radius2)))


@inlined
def pixel_extent(sensor: SensorTables, frames: Array) -> tuple[float, float]:
    """Return the largest distance of a pixel's points from its centre, and their difference in z, mm.

    The latter is in the frame of the array; the sensor may be tilted against it.
    """
    nx, ny, _ = move_direction(frames, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 1.0)
    half = HALF_DIAGONAL * sensor.pixel
    return half, half * np.sqrt(nx * nx + ny * ny)


@pasted
def list_cells(array: ArraySeen, p: Vector, extent: tuple[float, float], search: float, near: Array) -> int:
    """List the lenslets that may show a pixel the lens's opening.

    A lenslet at c shows it to the point x at a distance d if |c − x − s d| ≤ ρ d, where s is the middle of its view and
    ρ its radius. Over the pixel, x and d change by `extent`, so both sides change by at most that and (|s| + ρ) times
    the latter.

    Parameters
    ----------
    array : ArraySeen
    p : (3,) float, mm
        Centre of the pixel, array frame.
    extent : (2,) float, mm
        See `pixel_extent`.
    search : float
        Search distance around the pixel's chief ray, in pitches.
    near : (n, LISTED) float64
        Filled with a row for each lenslet: centre (0, 1), centre of its view of the opening (2, 3) and squared radius
        (4), in slopes, curvature (5), decentre of the apex (6, 7), relative solid angle (8), a place for
        `cells_that_show` (9), and the type (10) if lenslets are not spherical.

    Returns
    -------
    int
        Number of lenslets listed.
    """
    (mla, aim, glass), (x, y, z) = array, p
    lattice = mla.lenslets.lattice
    over = 1.0 / abs(z - aim.apex_z)
    kappa = aim.pupil_vergence
    lateral, deep = extent
    # Intersection of the chief ray with the array.
    chief_x = (kappa * aim.pupil_x + over * x) / (kappa + over)
    chief_y = (kappa * aim.pupil_y + over * y) / (kappa + over)
    distance = search * lattice.pitch
    count = 0
    first_row, end_row = rows_near(lattice, chief_y, distance)
    for r in range(first_row, end_row):
        first, end = columns_near(lattice, r, chief_x, distance)
        for c in range(first, end):
            cell = r * lattice.columns + c
            radius2, sx, sy = aim.slope_radius2[cell], aim.slope[cell, 0], aim.slope[cell, 1]
            cx, cy = centre(lattice, c, r)
            a, b = (cx - x) * over - sx, (cy - y) * over - sy
            limit = np.sqrt(max(radius2, 0.0)) * (1.0 + deep * over)
            limit += (lateral + deep * (abs(sx) + abs(sy))) * over
            # Without a branch, which the processor would mispredict half of the time.
            near[count, 0], near[count, 1] = cx, cy
            near[count, 2], near[count, 3], near[count, 4] = sx, sy, radius2
            near[count, 5], near[count, 6] = c, r
            count += a * a + b * b <= limit * limit and radius2 >= 0.0
    for i in range(count):
        if not is_spherical(mla.lenslets.profile):
            near[i, KIND] = type_of(mla.lenslets, int(near[i, 5]), int(near[i, 6]))
        near[i, 5], near[i, 6], near[i, 7] = shape_of(mla.lenslets, int(near[i, 5]), int(near[i, 6]))
        near[i, SOLID_ANGLE] = 1.0
    if aim.search > ALIKE:
        air, plate, _ = path_to_apexes(mla, z)
        for i in range(count):
            dx, dy = near[i, 0] - x, near[i, 1] - y
            near[i, SOLID_ANGLE] = solid_angle(np.sqrt(dx * dx + dy * dy), air, plate, glass)
    return count


@inlined
def unaimed_share(wide: float) -> float:
    """Return the share of a pixel's rays that go anywhere, or to lenslets by solid angle.

    Parameters
    ----------
    wide : float
        Share of rays that go anywhere.
    """
    return wide + (1.0 - wide) * MARGIN_SHARE


@pasted
def aimed_rays(share: float, samples: int, key: np.uint64) -> tuple[int, float]:
    """Return the number of a pixel's samples aimed by the lenslets' light, and the weight of each.

    The number is its expected value rounded up or down at random. The weight is the ratio of the two, so that all
    samples carry equal light in an evenly lit pixel. −1: each sample decides at random.

    Parameters
    ----------
    share : float
        Share of the other samples.
    samples : int
    key : uint64
        Key of the pixel in its replicate.
    """
    expected = samples * (1.0 - share)
    if expected < FEW:
        return -1, 1.0
    number = samples - int(samples * share + uniform(derived(key, NUMBER_OF_UNAIMED), 0))
    return number, expected / number


@pasted
def aimed_through_array(
    array: ArraySeen, shown: Shown, wide: float, normal: Vector, p: Vector, numbers: Numbers, far: bool
) -> tuple[float, float, float, float]:
    """Return a direction (array frame) from the sensor, and cos θ over its density among a pixel's samples.

    If no lenslet shows the opening to the point, only a share of the rays is sent, anywhere; for the others the last
    value is zero.

    Parameters
    ----------
    array : ArraySeen
    shown : Shown
    wide : float
        Share of rays that go anywhere.
    normal : (3,) float
        The sensor's normal towards the array, array frame.
    p : (3,) float, mm
        Point, array frame.
    numbers : Numbers
        The last one selects the target: below `wide` anywhere, then up to `unaimed_share` a lenslet by its solid angle,
        else a lenslet by the light that it shows.
    far : bool
        Views are so wide that all rays together estimate all directions.
    """
    point, choice = (numbers[CELL_U], numbers[CELL_V]), numbers[DISCRETE]
    by_light = choice >= unaimed_share(wide) and shown.by_light > 0.0
    if choice < wide:
        d = lambertian(normal[0], normal[1], normal[2], point[0], point[1])
        on_cells, on_wider = lenslets_density(array, shown, p, d)
    elif shown.number > 0:
        chosen = _by_chance(shown, CHANCE if by_light else SOLID_ANGLE, numbers[WHICH_CELL])
        width = array.mla.lenslets.lattice.pitch + (0.0 if by_light else 2.0 * array.aim.cell_margin)
        d, on_cells, on_wider = toward_lenslet(array, shown, p, chosen, width, point)
    else:
        return 0.0, 0.0, 0.0, 0.0
    cos_theta = normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2]
    density = 0.0
    if far:
        density = (1.0 - wide) * (on_cells + on_wider) + wide * max(cos_theta, 0.0) / np.pi
    elif on_cells > 0.0:
        density = (1.0 - wide) * on_cells if by_light else 0.0
    elif choice < wide or (on_wider > 0.0 and not by_light):
        # A margin ray to a face that no ray finds, such as a cylinder's beyond the layer of faces, is outside the
        # support, where only rays that go anywhere count.
        density = (1.0 - wide) * on_wider + wide * max(cos_theta, 0.0) / np.pi
    return d[0], d[1], d[2], cos_theta / density if density > 0.0 else 0.0


@pasted
def toward_lenslet(
    array: ArraySeen, shown: Shown, p: Vector, chosen: int, width: float, point: tuple[float, float]
) -> tuple[Vector, float, float]:
    """Return the direction from the sensor to a uniform point of a lenslet's cell, and its densities.

    The densities, over all lenslets, are zero if the face ends within the cell's margin, see `lenslets_density`.

    Parameters
    ----------
    array : ArraySeen
    shown : Shown
    p : (3,) float, mm
        Point, array frame.
    chosen : int
        Index of the lenslet in the list.
    width : float, mm
        Width of its cell, with or without the margin.
    point : (2,) float
        Random numbers, uniform in [0, 1).
    """
    mla, aim, glass = array
    lattice, near = mla.lenslets.lattice, shown.near
    air, depth, growth = path_to_apexes(mla, p[2])
    u, v = point_of_cell(lattice.hexagonal, point[0], point[1])
    u, v = u * width, v * width
    profile, kind = mla.lenslets.profile, near[chosen, KIND]
    ax, ay = u - near[chosen, 6], v - near[chosen, 7]
    exists, sag, tilt, tilt_x, tilt_y, level = face_over(profile, kind, near[chosen, 5], ax, ay)
    if not exists or (profile is not None and not mla.lenslets.top <= sag <= mla.lenslets.valley):
        return (0.0, 0.0, 1.0), 0.0, 0.0
    plate = depth + growth * sag
    dx, dy = near[chosen, 0] + u - p[0], near[chosen, 1] + v - p[1]
    r = np.sqrt(dx * dx + dy * dy)
    s = slope_to(r, air, plate, glass)
    part = s / r if r > 0.0 else 0.0
    sx, sy, s2 = dx * part, dy * part, s * s
    scale = 1.0 / np.sqrt(1.0 + s2)
    d = sx * scale, sy * scale, (-scale if mla.curved_to_lens else scale)
    q2 = glass * glass + (glass * glass - 1.0) * s2
    q = np.sqrt(q2)
    layer = mla.lenslets.valley - mla.lenslets.top
    # A ray that stays in its cell throughout the layer of faces meets no other lenslet. Twice, because the faces
    # continue beyond the layer in the margin.
    stays = half_width_to(lattice, u, v) + 2.0 * (layer * s / q + max(aim.cell_margin, 0.0)) < 0.5 * lattice.pitch
    if not (stays and meets_once(profile, kind, sx, sy, q)):
        on_cells, on_wider = lenslets_density(array, shown, p, d)
        return d, on_cells, on_wider
    turned = 1.0 - growth * tilt * (sx * tilt_x + sy * tilt_y) / (q * level)
    if turned <= 0.0:
        return d, 0.0, 0.0
    spread = spread_on_face(air, plate, glass, s2, q2, q, turned)
    return d, spread * near[chosen, CHANCE] * shown.on_cells, spread * near[chosen, SOLID_ANGLE] * shown.on_wider


@pasted
def cells_that_show(
    array: ArraySeen, near: Array, listed: int, cells: NDArray[np.int64], p: Vector, growth2: float
) -> Shown:
    """Find the listed lenslets that may show a point the opening.

    Parameters
    ----------
    array : ArraySeen
    near, listed
        From `list_cells`; `CHANCE` is filled in: solid angle times the root mean square of the light that a lenslet
        shows this far from the centre of its view.
    cells : (n,) int64
        Filled with indices in the list.
    p : (3,) float, mm
        Point, array frame.
    growth2 : float
        Factor on the squared radius of all views.
    """
    aim, lattice = array.aim, array.mla.lenslets.lattice
    over = 1.0 / abs(p[2] - aim.apex_z)
    rings = len(aim.shown) - 1
    count, by_light, by_angle = 0, 0.0, 0.0
    for cell in range(listed):
        a, b = (near[cell, 0] - p[0]) * over - near[cell, 2], (near[cell, 1] - p[1]) * over - near[cell, 3]
        part2 = (a * a + b * b) / max(near[cell, 4] * growth2, _TINY)
        shows = part2 <= 1.0
        # The last entry of `shown`, for lenslets that do not show the opening, is zero.
        chance = near[cell, SOLID_ANGLE] * aim.shown[int(min(part2, 1.0) * rings)]
        cells[count], near[cell, CHANCE] = cell, chance
        count += shows
        by_light += chance
        by_angle += near[cell, SOLID_ANGLE] * shows
    filled, width = ROW_SPACING if lattice.hexagonal else 1.0, lattice.pitch + 2.0 * aim.cell_margin
    margin = MARGIN_SHARE if by_light > 0.0 else 1.0
    on_cells = (1.0 - margin) / (filled * lattice.pitch * lattice.pitch * max(by_light, _TINY))
    return Shown(
        near, cells, count, by_light, by_angle, on_cells, margin / (filled * width * width * max(by_angle, _TINY))
    )


@inlined
def _by_chance(shown: Shown, kind: int, choice: float) -> int:
    """Choose a lenslet by a random number in [0, 1); return its index in the list.

    Parameters
    ----------
    kind : int
        `CHANCE` or `SOLID_ANGLE`: the column of the relative probabilities.
    choice : float
    """
    part = choice * (shown.by_light if kind == CHANCE else shown.by_angle)
    for number in range(shown.number - 1):
        part -= shown.near[shown.cells[number], kind]
        if part < 0.0:
            return shown.cells[number]
    return shown.cells[shown.number - 1]


@pasted
def lenslets_density(array: ArraySeen, shown: Shown, p: Vector, d: Vector) -> tuple[float, float]:
    """Return the densities, 1/sr, of a direction drawn by `toward_lenslet`; 0 outside its support.

    The first is for rays that choose lenslets by light, the second for margin rays. Both are sums over the faces that
    the direction meets, as each could have drawn it.

    Parameters
    ----------
    array : ArraySeen
    shown : Shown
    p : (3,) float, mm
        Point of the sensor, array frame.
    d : (3,) float
        Unit direction.
    """
    mla, aim, glass = array
    if shown.number == 0 or d[2] * (-1.0 if mla.curved_to_lens else 1.0) <= 0.0:
        return 0.0, 0.0
    lattice, near = mla.lenslets.lattice, shown.near
    air, depth, growth = path_to_apexes(mla, p[2])
    sx, sy = d[0] / abs(d[2]), d[1] / abs(d[2])
    s2 = sx * sx + sy * sy
    q2 = glass * glass + (glass * glass - 1.0) * s2
    q = np.sqrt(q2)
    gx, gy = sx / q, sy / q
    px, py = p[0] + sx * air + gx * depth, p[1] + sy * air + gy * depth
    half = 0.5 * lattice.pitch
    on_cells, on_wider = 0.0, 0.0
    for i in range(shown.number):
        cell = shown.cells[i]
        ex, ey = near[cell, 6], near[cell, 7]
        ax, ay = px - near[cell, 0] - ex, py - near[cell, 1] - ey
        by_light, by_angle = near[cell, CHANCE] * shown.on_cells, near[cell, SOLID_ANGLE] * shown.on_wider
        if not is_spherical(mla.lenslets.profile):
            on_cell, on_margin = _spread_on_profile(
                mla.lenslets.profile, mla.lenslets, near[cell], (ax, ay), (gx, gy), aim.cell_margin,
                (air, depth, growth, glass, s2, q2, q),
            )  # fmt: skip
            on_cells += by_light * on_cell
            on_wider += by_angle * on_margin
            continue
        met, ax, ay, sag, turned = on_face(near[cell, 5], ax, ay, growth * gx, growth * gy)
        if not met:
            continue
        out = half_width_to(lattice, ax + ex, ay + ey)
        spread = spread_on_face(air, depth + growth * sag, glass, s2, q2, q, turned)
        on_cells += spread * by_light * (out <= half)
        on_wider += spread * by_angle * (out <= half + aim.cell_margin)
    return on_cells, on_wider


@inlined
def _spread_on_profile(
    profile: Any, lenslets: Lenslets, lenslet: Array, a: tuple[float, float], g: tuple[float, float], margin: float,
    way: tuple[float, float, float, float, float, float, float],
) -> tuple[float, float]:  # fmt: skip
    """Return area over solid angle at a line's crossings of a cell's face, without and with its margin.

    For non-spherical faces. A line may cross them more than once, and each crossing could have drawn it.

    Parameters
    ----------
    lenslet : (LISTED,) float64
        Row of the lenslet in the list.
    a : (2,) float, mm
        The line at the height of the apexes, relative to the apex.
    g : (2,) float
        Its slopes, away from the sensor.
    margin : float, mm
    way : (7,) float
        Thickness of air and glass, sign of the sag's effect on the latter, index, and slopes as for `spread_on_face`.
    """
    on_cell, on_wider = 0.0, 0.0
    if profile is None:
        return on_cell, on_wider
    air, depth, growth, glass, s2, q2, q = way
    half, side, begin = 0.5 * lenslets.lattice.pitch, 0.0, lenslets.top
    gx, gy = growth * g[0], growth * g[1]
    while True:
        falls, z, turned = next_fall(
            profile, int(lenslet[KIND]), lenslet[5], a[0], a[1], gx, gy, side, begin, lenslets.valley
        )
        if not falls:
            return on_cell, on_wider
        out = half_width_to(lenslets.lattice, a[0] + gx * z + lenslet[6], a[1] + gy * z + lenslet[7])
        spread = spread_on_face(air, depth + growth * z, glass, s2, q2, q, turned)
        on_wider += spread * (out <= half + margin)
        on_cell += spread * (out <= half)
        begin, side = z, -1.0
