"""From a point of the sensor through the lenslets that show it the opening of the lens: which, where, how densely.

`lenslet_view` measures beforehand what each lenslet shows; here a path is started with it.

Directions from a point are of three sets. Those that meet the face of a lenslet that surely shows the opening are the
main rays'; others that meet a lenslet that may show it, or its close surroundings, are the margin rays', with what of
the blind ones falls there; all the rest, through which ghosts and stray light come, are the blind rays', which go
anywhere. No ray counts in another's set, and how many of a pixel's there are of each kind is settled beforehand: so
an even pixel's main rays all bring the same. Whether a direction meets a face is not a matter of approximation: the
face is met where the ray in the glass crosses the sphere, and a ray that is aimed at a point of it goes there through
the plate.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.lattice import ROW_SPACING, Lattice, cell_of, centre, half_hexagon
from lfmesh.geometry.lenslets import shape_of
from lfmesh.kernel import inlined, kernel, pasted
from lfmesh.optics.scattering import lambertian
from lfmesh.transport.packets.random import derived, uniform
from lfmesh.transport.tables.tables import AimTables, ArrayTables

Array = NDArray[np.float64]

CELL_U, CELL_V, PIXEL_U, PIXEL_V, WHICH_CELL, DISCRETE = 0, 1, 2, 3, 4, 5
"""The point of the lenslet gets the evenest: what is sharp in the scene is sharp there, where the image is in focus."""

MAIN, MARGIN, BLIND = 0, 1, 2
"""Whose directions a ray is to estimate."""

MARGIN_SHARE = 0.05
"""Share of the rays to lenslets that may show the opening, beside those that surely do."""

FEW = 2.0
"""Main rays of a pixel that it must at least have by its share: with less, chance says of each ray whose it is."""

LISTED = 9
"""What is known of a lenslet that may show the opening, see `list_cells`."""

SOLID_ANGLE = 8
"""The last of it: by how much a lenslet is more likely to be chosen than another."""

ALIKE = 3
"""Up to so many cells to each side of the chief ray's, all look alike from the sensor, and are as likely as another."""

NUMBERS_OF_ROLES = -1
"""Child of a pixel's key, beside its samples, from which their roles' numbers are drawn."""

STEPS = 40
"""Of Newton's method at most, towards a slope."""

THIRD_ORDER = 0.1
"""Share of the first order's slope that the third adds to it at most."""

EXACT = 1e-4
"""Its last step, relative, which leaves an error of the square of that."""

_TINY = float(np.finfo(np.float64).tiny)

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


def most_listed(aim: AimTables) -> int:
    """Return how many lenslets `list_cells` may list."""
    return (2 * aim.search + 1) ** 2


class Allotment(NamedTuple):
    """How a pixel's rays are shared out among the directions that they estimate.

    Attributes
    ----------
    blind_from, margin_from : int
        First of its samples that are blind, and of those before them that are the margin's; both 0 where chance says.
    main, aimed, unaimed : float
        Share of the main rays, of all but the blind ones, and of these: as it was settled.
    margin, blind : float
        Share of the rays of each kind that is expected.
    """

    blind_from: int
    margin_from: int
    main: float
    aimed: float
    unaimed: float
    margin: float
    blind: float


@pasted
def allotted(aim: AimTables, listed: int, samples: int, key: np.uint64) -> Allotment:
    """Share out a pixel's samples.

    Their numbers are the two whole ones next to the share of each kind, by chance, so that its mean is the share.

    Parameters
    ----------
    listed : int
        How many lenslets may show the opening to some point of the pixel.
    key : uint64
        Of the pixel in its replicate.
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
    """Return whose directions a sample is to estimate."""
    if shares.blind_from == 0 and shares.margin_from == 0:
        return BLIND if chance < shares.blind else (MARGIN if chance < shares.blind + shares.margin else MAIN)
    return BLIND if sample >= shares.blind_from else (MARGIN if sample >= shares.margin_from else MAIN)


@pasted
def list_cells(
    array: ArrayTables, aim: AimTables, glass: float, x: float, y: float, z: float, reach: float, near: Array
) -> int:  # fmt: skip
    """List the lenslets that show (part of) the lens's opening to a point of the sensor or one within reach of it.

    Returns
    -------
    int
        How many; `near` has a row for each: its centre, the middle and the square of the radius of the opening as it
        sees it (slopes), its curvature, its apex's decentre, and how large it looks from the point.
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
            near[count, 5], near[count, 6] = c, r
            count += a * a + b * b <= limit * limit and radius2 >= 0.0
    for i in range(count):
        near[i, 5], near[i, 6], near[i, 7] = shape_of(array.lenslets, int(near[i, 5]), int(near[i, 6]))
        near[i, SOLID_ANGLE] = 1.0
    if aim.search > ALIKE:
        air, plate, _ = path_to_apexes(array, z)
        for i in range(count):
            dx, dy = near[i, 0] - x, near[i, 1] - y
            near[i, SOLID_ANGLE] = solid_angle(np.sqrt(dx * dx + dy * dy), air, plate, glass)
    return count


@inlined
def solid_angle(r: float, air: float, plate: float, glass: float) -> float:
    """Return the projected solid angle of an area of the apexes, so far sideways, over that of one straight ahead.

    Zero where no ray gets there: on a sensor that touches the glass, beyond the angle of total reflection.
    """
    s = slope_to(r, air, plate, glass)
    s2 = s * s
    q2 = glass * glass + (glass * glass - 1.0) * s2
    ahead = (air + plate / glass) ** 2
    seen = ahead / (spread_on_face(air, plate, glass, s2, q2, np.sqrt(q2), 1.0) * np.sqrt(1.0 + s2))
    # There the slope has no end, and the quotient is 0/0.
    return seen if seen > 0.0 else 0.0


@inlined
def glass_before_faces(array: ArrayTables, colour: int) -> float:
    """Return the refractive index of what lies between the sensor and the lenslets' faces, beside air."""
    return array.indices[colour] if array.curved_to_lens else 1.0


@inlined
def path_to_apexes(array: ArrayTables, z: float) -> tuple[float, float, float]:
    """Return how much air and how much glass (mm) lie between a height over the array and the lenslets' apexes.

    And by how much the second grows with the sag of the face: the glass, or if there is none the air, which then is
    glass of index 1.
    """
    if array.curved_to_lens:
        return abs(z - array.lenslets.thickness), array.lenslets.thickness, -1.0
    return abs(z), 0.0, 1.0


@inlined
def slope_to(r: float, air: float, plate: float, glass: float) -> float:
    """Return the slope of the ray in air that goes so far sideways in some air and a plate of glass.

    Newton's steps from the slope that third order gives, of which one is mostly enough. Third order is no good for
    steep rays, and no more of it is taken than `THIRD_ORDER`. How far the ray goes sideways grows ever more slowly with
    the slope: so the steps come from below, from the second on at the latest, and always arrive.
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
    """Return whether the line (a + g z, z) leaves a cap at the origin, where, its z, and 1 − g · (gradient of the sag).

    A line crosses a sphere once from inside: only there, and on the half with the apex, is it a ray through the face.
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
    """Return the area of a face, seen along the axis, over the solid angle of the rays in air that cross it, mm².

    Parameters
    ----------
    s2, q2, q : float
        Square of the slope in air; the slope over that in the glass, squared and as it is.
    turned : float
        One less the product of the face's slope and the ray's along it: the face comes to meet the ray, or recedes.
    """
    across = air + plate / q
    along = air + plate * glass * glass / (q * q2)
    return across * along * (1.0 + s2) * np.sqrt(1.0 + s2) / turned


@pasted
def through_a_lenslet(
    array: ArrayTables, aim: AimTables, glass: float, normal: tuple[float, float, float], near: Array, listed: int,
    cells: NDArray[np.int64], numbers: Numbers, sample: int, shares: Allotment, x: float, y: float, z: float,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return a direction (array frame) from a point of the sensor, and cos θ over its density among a pixel's samples.

    Zero: the direction is another set's than the sample's.

    Parameters
    ----------
    glass
        See `glass_before_faces`.
    near, listed
        Lenslets that may show the opening, and how many, from `list_cells`.
    sample, shares
        Its number, and how the pixel's samples are shared out.
    """
    lattice = array.lenslets.lattice
    nx, ny, nz = normal
    toward = -1.0 if array.curved_to_lens else 1.0
    role = role_of(sample, shares, numbers[DISCRETE])
    maybe, surely, of_maybe, of_surely = cells_that_show(aim, near, listed, cells, x, y, z)
    size = lattice.pitch + 2.0 * aim.cell_margin
    filled = ROW_SPACING if lattice.hexagonal else 1.0
    air, depth, growth = path_to_apexes(array, z)
    if role == BLIND:
        dx, dy, dz = lambertian(nx, ny, nz, numbers[CELL_U], numbers[CELL_V])
    elif maybe == 0:
        return 0.0, 0.0, 0.0, 0.0
    else:
        is_sure = role == MAIN and surely > 0
        among, count, total, width = (2, surely, of_surely, lattice.pitch) if is_sure else (0, maybe, of_maybe, size)
        number = min(int(numbers[WHICH_CELL] * count), count - 1)
        if aim.search > ALIKE:
            number = by_solid_angle(near, cells[among], count, numbers[WHICH_CELL] * total)
        chosen = cells[among, number]
        u, v = _point_of_cell(lattice.hexagonal, numbers[CELL_U], numbers[CELL_V])
        u, v = u * width, v * width
        curvature, ax, ay = near[chosen, 5], u - near[chosen, 6], v - near[chosen, 7]
        level2 = 1.0 - curvature * curvature * (ax * ax + ay * ay)
        if level2 <= 0.0:
            # Beside the cell the sphere may have ended.
            return 0.0, 0.0, 0.0, 0.0
        level = np.sqrt(level2)
        plate = depth + growth * curvature * (ax * ax + ay * ay) / (1.0 + level)
        dx, dy = near[chosen, 0] + u - x, near[chosen, 1] + v - y
        r = np.sqrt(dx * dx + dy * dy)
        s = slope_to(r, air, plate, glass)
        part = s / r if r > 0.0 else 0.0
        sx, sy, s2 = dx * part, dy * part, s * s
        scale = 1.0 / np.sqrt(1.0 + s2)
        dx, dy, dz = sx * scale, sy * scale, toward * scale
        if is_sure:
            q2 = glass * glass + (glass * glass - 1.0) * s2
            q = np.sqrt(q2)
            layer = array.lenslets.valley - array.lenslets.top
            if half_width_to(lattice, u, v) + layer * s / q < 0.5 * lattice.pitch:
                # The ray stays in the cell as long as there are faces: it is no other lenslet's.
                turned = 1.0 - growth * curvature * (sx * ax + sy * ay) / (q * level)
                if turned <= 0.0:
                    return 0.0, 0.0, 0.0, 0.0
                spread = spread_on_face(air, plate, glass, s2, q2, q, turned)
                spread *= near[chosen, SOLID_ANGLE]
                density = shares.main * spread / (of_surely * filled * lattice.pitch * lattice.pitch)
                return dx, dy, dz, (nx * dx + ny * dy + nz * dz) / density
    cos_theta = nx * dx + ny * dy + nz * dz
    surely_drawn, drawn = 0.0, 0.0
    if maybe > 0 and dz * toward > 0.0:
        surely_drawn, drawn = spread_on_faces(array, aim, glass, near, cells, maybe, x, y, z, dx, dy, dz)
    density = 0.0
    if surely_drawn > 0.0:
        if role == MAIN:
            density = shares.main * surely_drawn / (of_surely * filled * lattice.pitch * lattice.pitch)
    elif drawn > 0.0:
        by_cells = drawn / (of_maybe * filled * size * size)
        if surely == 0:
            # All rays are the margin's or blind.
            density = shares.aimed * by_cells + shares.unaimed * cos_theta / np.pi
        elif role != MAIN:
            density = shares.margin * by_cells + shares.blind * cos_theta / np.pi
    elif role == BLIND:
        density = shares.blind * cos_theta / np.pi
    return dx, dy, dz, cos_theta / density if density > 0.0 else 0.0


@pasted
def cells_that_show(
    aim: AimTables, near: Array, listed: int, cells: NDArray[np.int64], x: float, y: float, z: float
) -> tuple[int, int, float, float]:
    """Find the listed lenslets that may show the opening to a point; return how many, and how many surely do.

    And how large those look together. `cells` has their numbers in the list: [0] those that may, [1] whether each
    surely does, [2] those that surely do.
    """
    over = 1.0 / abs(z - aim.lenslet_z)
    maybe, surely, of_maybe, of_surely = 0, 0, 0.0, 0.0
    for cell in range(listed):
        a, b = (near[cell, 0] - x) * over - near[cell, 2], (near[cell, 1] - y) * over - near[cell, 3]
        off2, radius2 = a * a + b * b, near[cell, 4]
        shows = off2 <= aim.sure2 * radius2
        cells[0, maybe], cells[1, maybe], cells[2, surely] = cell, shows, cell
        maybe += off2 <= radius2
        surely += shows
        of_maybe += near[cell, SOLID_ANGLE] * (off2 <= radius2)
        of_surely += near[cell, SOLID_ANGLE] * shows
    return maybe, surely, of_maybe, of_surely


@inlined
def by_solid_angle(near: Array, cells: NDArray[np.int64], count: int, part: float) -> int:
    """Return which of some listed lenslets holds a part of how large they look together, in their order."""
    for number in range(count - 1):
        part -= near[cells[number], SOLID_ANGLE]
        if part < 0.0:
            return number
    return count - 1


@pasted
def spread_on_faces(
    array: ArrayTables, aim: AimTables, glass: float, near: Array, cells: NDArray[np.int64], maybe: int,
    x: float, y: float, z: float, dx: float, dy: float, dz: float,
) -> tuple[float, float]:  # fmt: skip
    """Return area over solid angle (mm²) of a direction on the faces that it meets: sure ones, and all with a margin.

    Summed over the faces, each of which could have drawn it. Zero: what comes from there is outside that part of the
    aim.
    """
    lattice = array.lenslets.lattice
    air, depth, growth = path_to_apexes(array, z)
    sx, sy = dx / abs(dz), dy / abs(dz)
    s2 = sx * sx + sy * sy
    q2 = glass * glass + (glass * glass - 1.0) * s2
    q = np.sqrt(q2)
    gx, gy = sx / q, sy / q
    px, py = x + sx * air + gx * depth, y + sy * air + gy * depth
    half = 0.5 * lattice.pitch
    surely_drawn, drawn = 0.0, 0.0
    for i in range(maybe):
        cell = cells[0, i]
        ex, ey = near[cell, 6], near[cell, 7]
        met, ax, ay, sag, turned = on_face(
            near[cell, 5], px - near[cell, 0] - ex, py - near[cell, 1] - ey, growth * gx, growth * gy
        )  # fmt: skip
        if not met:
            continue
        out = half_width_to(lattice, ax + ex, ay + ey)
        spread = spread_on_face(air, depth + growth * sag, glass, s2, q2, q, turned)
        spread *= near[cell, SOLID_ANGLE]
        drawn += spread * (out <= half + aim.cell_margin)
        surely_drawn += spread * (cells[1, i] * (out <= half))
    return surely_drawn, drawn


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
