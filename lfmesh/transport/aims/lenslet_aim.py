"""Directions from a point of the sensor through the lenslets that show it the lens's opening, and their density.

`lenslet_view` measures beforehand what each lenslet shows; here the directions are drawn.

The directions from a point form three disjoint sets, each estimated by rays of its own. Main rays estimate directions
that meet the face of a lenslet that shows the opening; where several do, each is chosen by the root mean square of the
light that lenslets show at that distance from the centre of their view. Margin rays estimate other directions that
meet, or nearly meet, a lenslet that may show it, together with the blind rays that fall there. Blind rays, which go
anywhere, estimate all the rest, through which ghosts and stray light come. A ray that falls in another kind's set does
not count. The number of a pixel's rays of each kind is fixed beforehand, so that the main rays of an evenly lit pixel
all bring the same. Whether a direction meets a face is computed exactly: the face is met where the ray in the glass
crosses the sphere, and a ray aimed at a point of the face reaches it through the plate.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.array.lattice import ROW_SPACING, Lattice, centre, columns_near, half_hexagon, rows_near
from lfmesh.geometry.array.lenslet_profile import is_steeper, next_fall, profile_shape
from lfmesh.geometry.array.lenslets import Lenslets, is_spherical, shape_of, type_of
from lfmesh.geometry.frame import move_direction
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.packets.packet import MLA_FRAME, SENSOR_FRAME
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import LensAim, LensletAim, MlaTables, SensorTables

Array = NDArray[np.float64]

CELL_U, CELL_V, PIXEL_U, PIXEL_V, WHICH_CELL, DISCRETE = 0, 1, 2, 3, 4, 5
"""Dimensions of a path's starting numbers. The point of the lenslet gets the first two, which are distributed the most
evenly: where the image is in focus, sharp detail in the scene is sharp over the lenslet."""

MAIN, MARGIN, BLIND = 0, 1, 2
"""Role of a ray: the set of directions that it estimates."""

MARGIN_SHARE = 0.02
"""Share of the margin rays among the rays that are aimed."""

FEW = 2.0
"""Expected number of a pixel's main rays below which the role of each ray is drawn at random."""

LISTED = 11
"""Number of values of a lenslet in the list of those that may show the opening, see `list_cells`."""

SOLID_ANGLE, CHANCE = 8, 9
"""Two of these values: the relative probabilities with which margin rays, by solid angle, and main rays choose the
lenslet."""

KIND = 10
"""The last of them: the type of a lenslet that is no sphere."""

ALIKE = 3.5
"""Distance from the chief ray, in pitches, up to which all lenslets are taken to have the same solid angle."""

NUMBERS_OF_ROLES = -1
"""Number of the child of a pixel's key from which the number of rays of each role is drawn; no sample has it."""

STEPS = 40
"""Largest number of Newton steps towards a slope."""

THIRD_ORDER = 0.1
"""Largest correction by third order, relative to the slope of first order."""

EXACT = 1e-4
"""Relative size of the last Newton step, which leaves an error of the square of that."""

_TINY = float(np.finfo(np.float64).tiny)

_CORNERS = (
    (0.5, 0.5 / np.sqrt(3.0)),
    (-0.5, 0.5 / np.sqrt(3.0)),
    (0.0, -1.0 / np.sqrt(3.0)),
    (0.5, 0.5 / np.sqrt(3.0)),
)
"""Every second corner of a hexagon of width 1, and the first again."""

HALF_DIAGONAL = 0.72
"""Half diagonal of a pixel, in its width, with a margin: largest distance from its centre at which a path starts."""

Numbers = tuple[float, float, float, float, float, float]
"""Starting numbers of a path, in [0, 1): point of the lenslet (or pupil), point of the pixel, lenslet, role."""


def most_listed(aim: LensletAim) -> int:
    """Return the largest number of lenslets that `list_cells` may list."""
    most = (2.0 * aim.search + 1.0) * (2.0 * aim.search / ROW_SPACING + 1.0)
    return int(min(most, len(aim.slope_radius2)))


@inlined
def pixel_extent(sensor: SensorTables, frames: Array) -> tuple[float, float]:
    """Return the largest distance of a pixel's points from its centre, and their largest difference in z, mm.

    The latter is in the array's frame, against which the sensor may be tilted.
    """
    nx, ny, _ = move_direction(frames, SENSOR_FRAME, MLA_FRAME, 0.0, 0.0, 1.0)
    half = HALF_DIAGONAL * sensor.pixel
    return half, half * np.sqrt(nx * nx + ny * ny)


class Allotment(NamedTuple):
    """Division of a pixel's rays among the roles.

    Attributes
    ----------
    blind_from, margin_from : int
        Samples from `blind_from` on are blind, those from `margin_from` up to there are margin rays; both 0 where the
        roles are drawn at random.
    main, aimed, unaimed : float
        Actual shares of the main rays, of main and margin rays together, and of the blind rays.
    margin, blind : float
        Expected shares of margin and blind rays.
    """

    blind_from: int
    margin_from: int
    main: float
    aimed: float
    unaimed: float
    margin: float
    blind: float


@pasted
def allotted(aim: LensAim, listed: int, samples: int, key: np.uint64) -> Allotment:
    """Divide a pixel's samples among the roles.

    The number of each role is its expected value rounded up or down at random, so that its mean is the expected value.

    Parameters
    ----------
    aim : LensAim
        Of the sensor's side.
    listed : int
        Number of lenslets that may show the opening to some point of the pixel.
    samples : int
    key : uint64
        Key of the pixel in its replicate.
    """
    blind = aim.wide_share if listed > 0 else aim.share_without_aim
    margin = MARGIN_SHARE * (1.0 - blind)
    if listed > 0 and samples * (1.0 - blind - margin) < FEW:
        return Allotment(0, 0, 1.0 - blind - margin, 1.0 - blind, blind, margin, blind)
    chance = derived(key, NUMBERS_OF_ROLES)
    blind_from = samples - int(samples * blind + uniform(chance, 0))
    margin_from = blind_from - int(samples * margin + uniform(chance, 1))
    aimed = blind_from / samples
    return Allotment(blind_from, margin_from, margin_from / samples, aimed, 1.0 - aimed, margin, blind)


@pasted
def role_of(sample: int, shares: Allotment, chance: float) -> int:
    """Return the role of a sample.

    Parameters
    ----------
    sample : int
        Number of the sample.
    shares : Allotment
    chance : float
        Random number in [0, 1), for pixels whose roles are drawn at random.
    """
    if shares.blind_from == 0 and shares.margin_from == 0:
        return BLIND if chance < shares.blind else (MARGIN if chance < shares.blind + shares.margin else MAIN)
    return BLIND if sample >= shares.blind_from else (MARGIN if sample >= shares.margin_from else MAIN)


@pasted
def list_cells(
    mla: MlaTables, aim: LensletAim, glass: float, x: float, y: float, z: float, extent: tuple[float, float],
    near: Array,
) -> int:  # fmt: skip
    """List the lenslets that may show the lens's opening to points of a pixel.

    A lenslet at c shows it to the point x at a distance d where |c − x − s d| ≤ ρ d, s being the middle of its view and
    ρ its radius. Over the pixel x and d change by `extent`, so both sides do by no more than that and (|s| + ρ) times
    the latter.

    Parameters
    ----------
    mla : MlaTables
    aim : LensletAim
    glass : float
        See `glass_before_faces`.
    x, y, z : float, mm
        Centre of the pixel, array frame.
    extent : (2,) float, mm
        See `pixel_extent`.
    near : (n, LISTED) float64
        Filled with a row for each lenslet: centre (0, 1), centre of the opening that it sees (2, 3) and the square of
        its radius (4), in slopes, curvature (5), decentre of the apex (6, 7), relative solid angle (8), a place for
        `cells_that_show` (9), and the type (10) where lenslets are no spheres.

    Returns
    -------
    int
        Number of lenslets listed.
    """
    lattice = mla.lenslets.lattice
    over = 1.0 / abs(z - aim.apex_z)
    kappa = aim.pupil_vergence
    lateral, deep = extent
    # Where the chief ray meets the array.
    chief_x = (kappa * aim.pupil_x + over * x) / (kappa + over)
    chief_y = (kappa * aim.pupil_y + over * y) / (kappa + over)
    distance = aim.search * lattice.pitch
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
def solid_angle(r: float, air: float, plate: float, glass: float) -> float:
    """Return the projected solid angle of an area in the plane of the apexes, relative to one straight ahead.

    Zero where no ray arrives: for a sensor that touches the glass, beyond the angle of total reflection.

    Parameters
    ----------
    r : float, mm
        Lateral distance of the area.
    air, plate : float, mm
        Thickness of air and glass in between.
    glass : float
        Refractive index.
    """
    s = slope_to(r, air, plate, glass)
    s2 = s * s
    q2 = glass * glass + (glass * glass - 1.0) * s2
    ahead = (air + plate / glass) ** 2
    seen = ahead / (spread_on_face(air, plate, glass, s2, q2, np.sqrt(q2), 1.0) * np.sqrt(1.0 + s2))
    # In that case the slope is infinite and the quotient 0/0.
    return seen if seen > 0.0 else 0.0


@inlined
def glass_before_faces(mla: MlaTables, colour: int) -> float:
    """Return the refractive index of the plate between the sensor and the lenslets' faces; 1 without a plate."""
    return mla.media.indices[mla.medium, colour] if mla.curved_to_lens else 1.0


@inlined
def path_to_apexes(mla: MlaTables, z: float) -> tuple[float, float, float]:
    """Return the thickness of air and of glass (mm) between the height z over the array and the lenslets' apexes.

    The third value is the change of the glass thickness by the sag of the face. Without glass in between, it applies to
    the air, which then counts as glass of index 1.
    """
    if mla.curved_to_lens:
        return abs(z - mla.lenslets.thickness), mla.lenslets.thickness, -1.0
    return abs(z), 0.0, 1.0


@inlined
def lenslet_ahead(mla: MlaTables, glass: float, z: float) -> float:
    """Return the solid angle of a lenslet straight ahead, sr, seen from the height z (array frame).

    Parameters
    ----------
    mla : MlaTables
    glass : float
        See `glass_before_faces`.
    z : float, mm
    """
    lattice = mla.lenslets.lattice
    air, plate, _ = path_to_apexes(mla, z)
    reduced = air + plate / glass
    filled = ROW_SPACING if lattice.hexagonal else 1.0
    return filled * lattice.pitch * lattice.pitch / (reduced * reduced)


@inlined
def slope_to(r: float, air: float, plate: float, glass: float) -> float:
    """Return the slope in air of the ray with a given lateral shift over a layer of air and a plate of glass.

    Newton's method from the slope by third-order optics; one step is mostly enough. For steep rays third order is
    inaccurate, so its correction is limited by `THIRD_ORDER`. The shift is a concave function of the slope, so from the
    second step on, the slope approaches the solution from below and always converges.

    Parameters
    ----------
    r : float, mm
        Lateral shift.
    air, plate : float, mm
        Thickness of air and glass.
    glass : float
        Refractive index.
    """
    more = glass * glass - 1.0
    s = r / (air + plate / glass)
    s += s * min(0.5 * s * s * plate * more / (glass * glass * (air * glass + plate)), THIRD_ORDER)
    for _ in range(STEPS):
        q2 = glass * glass + more * s * s
        q = np.sqrt(q2)
        step = (r - s * air - plate * s / q) / (air + plate * glass * glass / (q * q2))
        s += step
        if abs(step) <= EXACT * s:
            break
    return s


@inlined
def on_face(curvature: float, ax: float, ay: float, gx: float, gy: float) -> tuple[bool, float, float, float, float]:
    """Return whether the line (a + g z, z) passes a cap with its apex at the origin, the point, and 1 − g · ∇sag.

    Only the crossing from inside the sphere, on the half with the apex, is a ray through the face.

    Parameters
    ----------
    curvature : float, 1/mm
    ax, ay : float, mm
    gx, gy : float
    """
    g2, a2, b = gx * gx + gy * gy, ax * ax + ay * ay, 1.0 - curvature * (ax * gx + ay * gy)
    root2 = b * b - curvature * curvature * (1.0 + g2) * a2
    if b <= 0.0 or root2 <= 0.0:
        return False, 0.0, 0.0, 0.0, 0.0
    root = np.sqrt(root2)
    z = curvature * a2 / (b + root)
    level = 1.0 - curvature * z
    return level > 0.0, ax + gx * z, ay + gy * z, z, root / max(level, _TINY)


@inlined
def spread_on_face(air: float, plate: float, glass: float, s2: float, q2: float, q: float, turned: float) -> float:
    """Return the area of a face, projected along the axis, over the solid angle of rays in air that cross it, mm²/sr.

    Parameters
    ----------
    air, plate : float, mm
        Thickness of air and glass on the way.
    glass : float
        Refractive index.
    s2, q2, q : float
        Squared slope in air; the ratio of the slopes in air and in glass, squared, and the ratio itself.
    turned : float
        1 − (slope of the ray · slope of the face), by which the inclined face changes the projected area.
    """
    across = air + plate / q
    along = air + plate * glass * glass / (q * q2)
    return across * along * (1.0 + s2) * np.sqrt(1.0 + s2) / turned


@pasted
def through_a_lenslet(
    mla: MlaTables, aim: LensletAim, glass: float, normal: tuple[float, float, float], near: Array, listed: int,
    cells: NDArray[np.int64], numbers: Numbers, sample: int, shares: Allotment, x: float, y: float, z: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction (array frame) from a point of the sensor, and cos θ over its density among a pixel's samples.

    The latter is zero if the direction belongs to the set of another role than the sample's.

    Parameters
    ----------
    glass : float
        See `glass_before_faces`.
    normal : (3,) float
        The sensor's normal towards the array, array frame.
    near, listed
        Lenslets that may show the opening, and their number, from `list_cells`.
    cells : (2, n) int64
        Working memory, see `cells_that_show`.
    numbers : Numbers
    sample : int
        Number of the sample.
    shares : Allotment
    x, y, z : float, mm
        The point, array frame.
    """
    lattice = mla.lenslets.lattice
    nx, ny, nz = normal
    toward = -1.0 if mla.curved_to_lens else 1.0
    role = role_of(sample, shares, numbers[DISCRETE])
    maybe, lit, of_maybe, of_lit = cells_that_show(aim, near, listed, cells, x, y, z)
    size = lattice.pitch + 2.0 * aim.cell_margin
    filled = ROW_SPACING if lattice.hexagonal else 1.0
    air, depth, growth = path_to_apexes(mla, z)
    if role == BLIND:
        dx, dy, dz = lambertian(nx, ny, nz, numbers[CELL_U], numbers[CELL_V])
    elif maybe == 0:
        return 0.0, 0.0, 0.0, 0.0
    else:
        is_main = role == MAIN and lit > 0
        among, count, total, width = (1, lit, of_lit, lattice.pitch) if is_main else (0, maybe, of_maybe, size)
        number = 0
        if count > 1:
            number = _by_chance(
                near, CHANCE if is_main else SOLID_ANGLE, cells[among], count, numbers[WHICH_CELL] * total
            )
        chosen = cells[among, number]
        u, v = _point_of_cell(lattice.hexagonal, numbers[CELL_U], numbers[CELL_V])
        u, v = u * width, v * width
        curvature, ax, ay = near[chosen, 5], u - near[chosen, 6], v - near[chosen, 7]
        profile, kind = mla.lenslets.profile, near[chosen, KIND]
        exists, sag, tilt, tilt_x, tilt_y, level = _face_over(profile, kind, curvature, ax, ay)
        if not exists:
            # In the margin around the cell the face may have ended.
            return 0.0, 0.0, 0.0, 0.0
        plate = depth + growth * sag
        dx, dy = near[chosen, 0] + u - x, near[chosen, 1] + v - y
        r = np.sqrt(dx * dx + dy * dy)
        s = slope_to(r, air, plate, glass)
        part = s / r if r > 0.0 else 0.0
        sx, sy, s2 = dx * part, dy * part, s * s
        scale = 1.0 / np.sqrt(1.0 + s2)
        dx, dy, dz = sx * scale, sy * scale, toward * scale
        if is_main:
            q2 = glass * glass + (glass * glass - 1.0) * s2
            q = np.sqrt(q2)
            layer = mla.lenslets.valley - mla.lenslets.top
            stays = half_width_to(lattice, u, v) + layer * s / q < 0.5 * lattice.pitch
            if stays and _meets_once(profile, kind, sx, sy, q):
                # The ray stays in its cell throughout the layer of faces, so it meets no other lenslet.
                turned = 1.0 - growth * tilt * (sx * tilt_x + sy * tilt_y) / (q * level)
                if turned <= 0.0:
                    return 0.0, 0.0, 0.0, 0.0
                spread = spread_on_face(air, plate, glass, s2, q2, q, turned)
                spread *= near[chosen, CHANCE]
                density = shares.main * spread / (of_lit * filled * lattice.pitch * lattice.pitch)
                return dx, dy, dz, (nx * dx + ny * dy + nz * dz) / density
    cos_theta = nx * dx + ny * dy + nz * dz
    on_faces, drawn = 0.0, 0.0
    if maybe > 0 and dz * toward > 0.0:
        on_faces, drawn = spread_on_faces(mla, aim, glass, near, cells, maybe, x, y, z, dx, dy, dz)
    density = 0.0
    if on_faces > 0.0:
        if role == MAIN:
            density = shares.main * on_faces / (of_lit * filled * lattice.pitch * lattice.pitch)
    elif drawn > 0.0:
        by_cells = drawn / (of_maybe * filled * size * size)
        if lit == 0:
            # Without main rays, all rays are margin rays or blind.
            density = shares.aimed * by_cells + shares.unaimed * cos_theta / np.pi
        elif role != MAIN:
            density = shares.margin * by_cells + shares.blind * cos_theta / np.pi
    elif role == BLIND:
        density = shares.blind * cos_theta / np.pi
    return dx, dy, dz, cos_theta / density if density > 0.0 else 0.0


@pasted
def cells_that_show(
    aim: LensletAim, near: Array, listed: int, cells: NDArray[np.int64], x: float, y: float, z: float
) -> tuple[int, int, float, float]:
    """Find the listed lenslets that may show the opening to a point, and those among them that do, as far as is known.

    Parameters
    ----------
    near, listed
        From `list_cells`; `CHANCE` is filled in: solid angle times the root mean square of the light that a lenslet
        shows at this distance from the centre of its view.
    cells : (2, n) int64
        Filled with indices in the list: [0] lenslets that may show it, [1] lenslets that do.
    x, y, z : float, mm
        The point, array frame.

    Returns
    -------
    maybe, lit : int
        Numbers of such lenslets.
    of_maybe, of_lit : float
        Sums of their solid angles, and of their chances.
    """
    over = 1.0 / abs(z - aim.apex_z)
    rings = len(aim.shown) - 1
    maybe, lit, of_maybe, of_lit = 0, 0, 0.0, 0.0
    for cell in range(listed):
        a, b = (near[cell, 0] - x) * over - near[cell, 2], (near[cell, 1] - y) * over - near[cell, 3]
        part2 = (a * a + b * b) / max(near[cell, 4], _TINY)
        shows = part2 <= 1.0
        # The last entry of `shown`, for lenslets that do not show the opening, is zero.
        chance = near[cell, SOLID_ANGLE] * aim.shown[int(min(part2, 1.0) * rings)]
        cells[0, maybe], cells[1, lit], near[cell, CHANCE] = cell, cell, chance
        maybe += shows
        lit += chance > 0.0
        of_maybe += near[cell, SOLID_ANGLE] * shows
        of_lit += chance
    return maybe, lit, of_maybe, of_lit


@inlined
def _by_chance(near: Array, kind: int, cells: NDArray[np.int64], count: int, part: float) -> int:
    """Choose one of some listed lenslets; return its place among them.

    Parameters
    ----------
    near : (n, LISTED) float64
    kind : int
        `CHANCE` or `SOLID_ANGLE`: the column that holds the relative probabilities.
    cells : (n,) int64
        Indices in the list.
    count : int
        Number of cells.
    part : float
        Random number, from 0 to the sum of their probabilities.
    """
    for number in range(count - 1):
        part -= near[cells[number], kind]
        if part < 0.0:
            return number
    return count - 1


@pasted
def spread_on_faces(
    mla: MlaTables, aim: LensletAim, glass: float, near: Array, cells: NDArray[np.int64], maybe: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
) -> tuple[float, float]:  # fmt: skip
    """Return area over solid angle, mm²/sr, of a direction on the faces that it meets, for main and for margin rays.

    Summed over the faces by their chances, as each could have drawn the direction: faces of lenslets that show the
    opening, and cells with their margin of all that may. Zero if the direction is outside that part of the aim.

    Parameters
    ----------
    glass : float
        See `glass_before_faces`.
    near
        Lenslets from `list_cells`.
    cells, maybe
        Lenslets among them that may show the opening, and their number, from `cells_that_show`.
    x, y, z : float, mm
        Point of the sensor, array frame.
    dx, dy, dz : float
    """
    lattice = mla.lenslets.lattice
    air, depth, growth = path_to_apexes(mla, z)
    sx, sy = dx / abs(dz), dy / abs(dz)
    s2 = sx * sx + sy * sy
    q2 = glass * glass + (glass * glass - 1.0) * s2
    q = np.sqrt(q2)
    gx, gy = sx / q, sy / q
    px, py = x + sx * air + gx * depth, y + sy * air + gy * depth
    half = 0.5 * lattice.pitch
    on_faces, drawn = 0.0, 0.0
    for i in range(maybe):
        cell = cells[0, i]
        ex, ey = near[cell, 6], near[cell, 7]
        if not is_spherical(mla.lenslets.profile):
            on_face_, on_wider = _spread_on_profile(
                mla.lenslets.profile, mla.lenslets, near[cell, KIND], near[cell, 5], ex, ey,
                px - near[cell, 0] - ex, py - near[cell, 1] - ey, gx, gy, aim.cell_margin,
                (air, depth, growth, glass, s2, q2, q),
            )  # fmt: skip
            drawn += on_wider * near[cell, SOLID_ANGLE]
            on_faces += on_face_ * near[cell, CHANCE]
            continue
        met, ax, ay, sag, turned = on_face(
            near[cell, 5], px - near[cell, 0] - ex, py - near[cell, 1] - ey, growth * gx, growth * gy
        )  # fmt: skip
        if not met:
            continue
        out = half_width_to(lattice, ax + ex, ay + ey)
        spread = spread_on_face(air, depth + growth * sag, glass, s2, q2, q, turned)
        drawn += spread * near[cell, SOLID_ANGLE] * (out <= half + aim.cell_margin)
        on_faces += spread * near[cell, CHANCE] * (out <= half)
    return on_faces, drawn


@inlined
def _face_over(
    profile: Any, kind: float, curvature: float, ax: float, ay: float
) -> tuple[bool, float, float, float, float, float]:
    """Return whether a lenslet has a face over a point, its sag there, and its slope.

    The slope along x is the third value times the fourth over the last; along y it is the third times the fifth over
    the last, which of a sphere is the cosine of its inclination.
    """
    if profile is None:
        r2 = ax * ax + ay * ay
        level2 = 1.0 - curvature * curvature * r2
        if level2 <= 0.0:
            return False, 0.0, 0.0, 0.0, 0.0, 1.0
        level = np.sqrt(level2)
        return True, curvature * r2 / (1.0 + level), curvature, ax, ay, level
    rho2 = profile.weight_x * ax * ax + profile.weight_y * ay * ay
    if rho2 > profile.domain * profile.domain:
        return False, 0.0, 0.0, 0.0, 0.0, 1.0
    sag, gx, gy = profile_shape(profile, int(kind), curvature, ax, ay)
    return True, sag, 1.0, gx, gy, 1.0


@inlined
def _meets_once(profile: Any, kind: float, sx: float, sy: float, q: float) -> bool:
    """Tell whether a ray of these slopes, q times as much as at the face, crosses the face of its cell only once."""
    if profile is None:
        return True
    return is_steeper(profile, int(kind), sx, sy, q)


@inlined
def _spread_on_profile(
    profile: Any, lenslets: Lenslets, kind: float, curvature: float, ex: float, ey: float, ax: float, ay: float,
    gx: float, gy: float, margin: float, way: tuple[float, float, float, float, float, float, float],
) -> tuple[float, float]:  # fmt: skip
    """Return area over solid angle where a line crosses the face of a cell, and that of the cell with its margin.

    Of a face that is no sphere, which a line may cross more than once: each crossing could have drawn it.

    Parameters
    ----------
    ex, ey : float, mm
        The apex, from the cell's centre.
    ax, ay : float, mm
        The line at the height of the apexes, from the apex.
    gx, gy : float
        Its slopes, away from the sensor.
    margin : float, mm
    way : (7,) float
        Thickness of air and of glass, sense in which the sag changes that, index, and slopes as `spread_on_face` takes
        them.
    """
    if profile is None:
        return 0.0, 0.0
    air, depth, growth, glass, s2, q2, q = way
    half, side, begin = 0.5 * lenslets.lattice.pitch, 0.0, lenslets.top
    on_face_, on_wider = 0.0, 0.0
    while True:
        falls, z, turned = next_fall(
            profile, int(kind), curvature, ax, ay, growth * gx, growth * gy, side, begin, lenslets.valley
        )
        if not falls:
            return on_face_, on_wider
        out = half_width_to(lenslets.lattice, ax + growth * gx * z + ex, ay + growth * gy * z + ey)
        spread = spread_on_face(air, depth + growth * z, glass, s2, q2, q, turned)
        on_wider += spread * (out <= half + margin)
        on_face_ += spread * (out <= half)
        begin, side = z, -1.0


@inlined
def on_lenslet(
    lenslets: Lenslets, kind: int, curvature: float, ax: float, ay: float, gx: float, gy: float, from_glass: bool
) -> tuple[bool, float, float]:  # fmt: skip
    """Return whether a line (a + g z, z) passes a lenslet's face, and the point, from the apex; see `on_face`.

    Parameters
    ----------
    lenslets : Lenslets
    kind : int
        Type of the lenslet.
    curvature : float, 1/mm
    ax, ay : float, mm
    gx, gy : float
    from_glass : bool
        Of several crossings take the one that a ray in the glass meets first, else one in the air.
    """
    return _on_lenslet_by(lenslets.profile, lenslets, kind, curvature, ax, ay, gx, gy, from_glass)


@inlined
def _on_lenslet_by(
    profile: Any, lenslets: Lenslets, kind: int, curvature: float, ax: float, ay: float, gx: float, gy: float,
    from_glass: bool,
) -> tuple[bool, float, float]:  # fmt: skip
    if profile is None:
        met, px, py, _, _ = on_face(curvature, ax, ay, gx, gy)
        return met, px, py
    falls, z, _ = next_fall(profile, kind, curvature, ax, ay, gx, gy, 0.0, lenslets.top, lenslets.valley)
    met, at = falls, z
    while falls and from_glass:
        falls, z, _ = next_fall(profile, kind, curvature, ax, ay, gx, gy, -1.0, at, lenslets.valley)
        if falls:
            at = z
    return met, ax + gx * at, ay + gy * at


@inlined
def half_width_to(lattice: Lattice, x: float, y: float) -> float:
    """Return the half width of the cell about the origin whose border contains a point, mm.

    Parameters
    ----------
    lattice : Lattice
    x, y : float, mm
        From the cell's centre.
    """
    return half_hexagon(x, y) if lattice.hexagonal else max(abs(x), abs(y))


@kernel
def _point_of_cell(hexagonal: bool, u: float, v: float) -> tuple[float, float]:
    """Return a uniform point of the cell about the origin, in pitches."""
    if not hexagonal:
        return u - 0.5, v - 0.5
    # The hexagon is made of three rhombi, each spanned by two of the radii to the corners at 30°, 150° and 270°.
    third = int(3.0 * u)
    u = 3.0 * u - third
    ax, ay = _CORNERS[third]
    bx, by = _CORNERS[third + 1]
    return u * ax + v * bx, u * ay + v * by
