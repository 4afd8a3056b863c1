"""A block of rays through the surfaces of the lens in their order, laid out for vector instructions.

A bundle is one float64 array of `ROWS` rows of `BLOCK` values, at constant offsets, so that the compiler sees that rows
do not overlap. Loops run over the whole block; the places beyond the last ray hold rays that have ended. There are no
branches: a ray that ends keeps its point and its slot while the others continue.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.surfaces.surface import CONIC_AND_EVEN, NEWTON_STEPS, SETTLED, distance_to, first_crossing, form_at
from lfmesh.kernels.decorators import kernel, pasted
from lfmesh.kernels.vector import both, fused, select
from lfmesh.optics.fresnel import amplitude_sums
from lfmesh.transport.events.interface import is_coated, is_thin_lens, shares, through_thin_lens, transmitted_share
from lfmesh.transport.packets.book import THIN_LENSES
from lfmesh.transport.tables.tables import Interfaces, LensTables

Array = NDArray[np.float64]

BLOCK = 128

# Rows: position and unit direction, mm; weight; power not followed; interfaces met; book slot + 1 of what ended it.
X, Y, Z, DX, DY, DZ = 0, BLOCK, 2 * BLOCK, 3 * BLOCK, 4 * BLOCK, 5 * BLOCK
WEIGHT, LEFT_BEHIND, MET, ENDED_ON = 6 * BLOCK, 7 * BLOCK, 8 * BLOCK, 9 * BLOCK
# Working rows: distance, radius², sag and half slope of an asphere's terms.
_T, _R2, _SAG, _SLOPE = 10 * BLOCK, 11 * BLOCK, 12 * BLOCK, 13 * BLOCK
# In place of the last two, of surfaces of other kinds: derivatives of the sag by x and y.
_GX, _GY = _SAG, _SLOPE
_SETTLED = 14 * BLOCK
# Working rows of absorbing media: position, weight, power not followed and end before a surface.
_FROM_X, _FROM_Y, _FROM_Z, _FROM_WEIGHT = 16 * BLOCK, 17 * BLOCK, 18 * BLOCK, 19 * BLOCK
_FROM_LEFT_BEHIND, _FROM_ENDED_ON = 20 * BLOCK, 21 * BLOCK
# Row of thin lenses: the factor by which importance has changed since `begin_etendue`.
ETENDUE = 22 * BLOCK
# First of the rows that other modules may use as working memory.
SCRATCH = 10 * BLOCK
ROWS = 26

DROPPED = -1.0
"""In place of slot + 1: the ray has left the image path, and all its power was left behind."""

BESIDE = -2.0
"""In place of slot + 1: the ray passes beside the lens."""


def empty_bundle(rows: int = ROWS) -> Array:
    """Return memory for a block of rays, aligned to cache lines.

    Parameters
    ----------
    rows : int
        More than `ROWS` where a module keeps rows of its own.
    """
    room = np.zeros(rows * BLOCK + 8)
    offset = (-room.ctypes.data // 8) % 8
    return room[offset : offset + rows * BLOCK]


@pasted
def load(bundle: Array, i: int, x: float, y: float, z: float, dx: float, dy: float, dz: float, weight: float) -> None:
    """Write ray `i` at its start, with its weight.

    Parameters
    ----------
    x, y, z : float, mm
    dx, dy, dz : float
        Unit direction.
    weight : float
    """
    bundle[X + i], bundle[Y + i], bundle[Z + i] = x, y, z
    bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx, dy, dz
    bundle[WEIGHT + i], bundle[LEFT_BEHIND + i], bundle[MET + i], bundle[ENDED_ON + i] = weight, 0.0, 0.0, 0.0


@kernel
def pad(bundle: Array, count: int) -> None:
    """Fill the places from `count` on with rays that have ended."""
    for i in range(count, BLOCK):
        bundle[X + i], bundle[Y + i], bundle[Z + i] = 0.0, 0.0, 0.0
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = 0.0, 0.0, 1.0
        bundle[WEIGHT + i], bundle[LEFT_BEHIND + i], bundle[MET + i] = 0.0, 0.0, 0.0
        bundle[ENDED_ON + i] = DROPPED


@kernel
def move_bundle(bundle: Array, move: Array) -> None:
    """Transform a bundle into another frame by a rigid move, (3, 4): rotation and shift."""
    xx, xy, xz, x0 = move[0, 0], move[0, 1], move[0, 2], move[0, 3]
    yx, yy, yz, y0 = move[1, 0], move[1, 1], move[1, 2], move[1, 3]
    zx, zy, zz, z0 = move[2, 0], move[2, 1], move[2, 2], move[2, 3]
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i]
        bundle[X + i] = xx * x + xy * y + xz * z + x0
        bundle[Y + i] = yx * x + yy * y + yz * z + y0
        bundle[Z + i] = zx * x + zy * y + zz * z + z0
        x, y, z = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        bundle[DX + i] = xx * x + xy * y + xz * z
        bundle[DY + i] = yx * x + yy * y + yz * z
        bundle[DZ + i] = zx * x + zy * y + zz * z


@kernel
def normalise(bundle: Array) -> None:
    """Normalise the directions, whose length every interface changes by a rounding error."""
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
        bundle[DX + i], bundle[DY + i], bundle[DZ + i] = dx * scale, dy * scale, dz * scale


@kernel
def through_stop(bundle: Array, stop_z: float, radius: float, slot: float) -> None:
    """End the rays that pass the plane of a stop outside its aperture.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    stop_z, radius : float, mm
    slot : float
        Of the book.
    """
    limit = radius * radius
    for i in range(BLOCK):
        t = (stop_z - bundle[Z + i]) / bundle[DZ + i]
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        ends = both(bundle[ENDED_ON + i] == 0.0, not x * x + y * y <= limit)
        bundle[X + i] = select(ends, x, bundle[X + i])
        bundle[Y + i] = select(ends, y, bundle[Y + i])
        bundle[Z + i] = select(ends, stop_z, bundle[Z + i])
        bundle[ENDED_ON + i] = select(ends, slot + 1.0, bundle[ENDED_ON + i])


@kernel
def note_start(absorption: Any, bundle: Array) -> None:
    """Note where rays are before they travel to the next surface; nothing where no medium absorbs.

    Parameters
    ----------
    absorption : Absorption or None
    bundle : (ROWS · BLOCK,) float64
    """
    if absorption is None:
        return
    for i in range(BLOCK):
        bundle[_FROM_X + i], bundle[_FROM_Y + i], bundle[_FROM_Z + i] = bundle[X + i], bundle[Y + i], bundle[Z + i]
        bundle[_FROM_WEIGHT + i], bundle[_FROM_LEFT_BEHIND + i] = bundle[WEIGHT + i], bundle[LEFT_BEHIND + i]
        bundle[_FROM_ENDED_ON + i] = bundle[ENDED_ON + i]


@kernel
def absorb_since_start(absorption: Any, bundle: Array, medium: int, colour: int, book: Array) -> None:
    """Take from rays what a medium absorbs between `note_start` and the surface at which they have been divided since.

    What the surface has left behind becomes less by the same share as what goes on.

    Parameters
    ----------
    absorption : Absorption or None
    bundle : (ROWS · BLOCK,) float64
    medium, colour : int
        Numbers of the medium and of the wavelength.
    book : (slots,) float64
    """
    if absorption is None:
        return
    coefficient = absorption.per_mm[medium, colour]
    if not coefficient > 0.0:
        return
    absorbed = 0.0
    for i in range(BLOCK):
        x, y = bundle[X + i] - bundle[_FROM_X + i], bundle[Y + i] - bundle[_FROM_Y + i]
        z = bundle[Z + i] - bundle[_FROM_Z + i]
        share = np.exp(-coefficient * np.sqrt(x * x + y * y + z * z))
        # The moves of posed surfaces shift rays that have ended by rounding errors.
        share = select(bundle[_FROM_ENDED_ON + i] == 0.0, share, 1.0)
        behind = bundle[_FROM_LEFT_BEHIND + i]
        absorbed += bundle[_FROM_WEIGHT + i] * (1.0 - share)
        bundle[LEFT_BEHIND + i] = behind + (bundle[LEFT_BEHIND + i] - behind) * share
        bundle[WEIGHT + i] *= share
    book[absorption.slot[medium]] += absorbed


@kernel
def through_surface(
    bundle: Array, lens: LensTables, k: int, colour: int, sense: float, rim: float, mount: float, beyond: float
) -> None:
    """Take a bundle through a refracting surface of the lens: refracted, and weighted with the transmittance.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    lens : LensTables
    k, colour : int
        Numbers of the surface and of the wavelength.
    sense : float
        1 for rays that go along +z, −1 against.
    rim : float
        Radius of the mount round the clear aperture, mm.
    mount, beyond : float
        Value of `ENDED_ON` for rays between aperture and rim, and for rays beyond the rim or that miss the surface.
    """
    surface = lens.surfaces[k]
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    _through_in_place(bundle, lens, k, colour, sense, rim, mount, beyond)
    if surface.posed:
        move_bundle(bundle, surface.pose)


@kernel
def _through_in_place(
    bundle: Array, lens: LensTables, k: int, colour: int, sense: float, rim: float, mount: float, beyond: float
) -> None:  # fmt: skip
    """Take a bundle through a surface of the lens in the frame in which it stands as prescribed."""
    surface = lens.surfaces[k]
    c, conic, z = surface.curvature, surface.conic, surface.vertex_z
    limit = surface.semi_diameter * surface.semi_diameter
    into = 1 if sense > 0.0 else 0
    indices, medium = lens.media.indices, lens.medium
    n_i, n_t = indices[medium[k + 1 - into], colour], indices[medium[k + into], colour]
    coated = is_coated(lens.interfaces, k)
    if surface.terms == 0 and conic == 0.0 and not coated:
        _through_sphere(bundle, lens.interfaces, k, colour, c, z, limit, sense, n_i, n_t, rim, mount, beyond)
        return
    _meet(bundle, surface, sense)
    if surface.kind != CONIC_AND_EVEN:
        _turn_along_gradient(bundle, lens.interfaces, k, colour, limit, sense, n_i, n_t, rim, mount, beyond, False)
        return
    if is_thin_lens(lens.interfaces, k):
        _bend_by_thin_lens(bundle, lens.interfaces, k, colour, z, limit, rim, mount, beyond)
        return
    if coated:
        _bend_at_coating(bundle, lens.interfaces, k, colour, c, conic, z, limit, sense, n_i, n_t, rim, mount, beyond)
        return
    _bend_along_slope(bundle, lens.interfaces, k, colour, c, conic, z, limit, sense, n_i, n_t, rim, mount, beyond)


@kernel
def mirror_at_surface(
    bundle: Array, lens: LensTables, k: int, colour: int, sense: float, rim: float, mount: float, beyond: float
) -> None:
    """Reflect a bundle at a refracting surface of the lens, weighted with the reflectance.

    Parameters
    ----------
    bundle, lens, k, colour, rim, mount, beyond
        As for `through_surface`.
    sense : float
        1 for rays that arrive along the surface's normal, which points to +z at the vertex; −1 against it.
    """
    surface = lens.surfaces[k]
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    into = 1 if sense > 0.0 else 0
    indices, medium = lens.media.indices, lens.medium
    n_i, n_t = indices[medium[k + 1 - into], colour], indices[medium[k + into], colour]
    limit = surface.semi_diameter * surface.semi_diameter
    _meet(bundle, surface, sense)
    if surface.kind != CONIC_AND_EVEN:
        _turn_along_gradient(bundle, lens.interfaces, k, colour, limit, sense, n_i, n_t, rim, mount, beyond, True)
    else:
        _mirror_along_slope(
            bundle, lens.interfaces, k, colour, surface.curvature, surface.conic, surface.vertex_z, limit, sense, n_i,
            n_t, rim, mount, beyond,
        )  # fmt: skip
    if surface.posed:
        move_bundle(bundle, surface.pose)


@kernel
def distances_to(bundle: Array, surface: Any, sense: float, row: int) -> None:
    """Write to a row of a bundle the distances at which rays cross a surface, as it stands in the prescription.

    Parameters
    ----------
    bundle : float64
    surface : SURFACE record
    sense : float
        1: along its normal, −1: against it.
    row : int
        −1 is written where a ray does not meet the surface.
    """
    _meet(bundle, surface, sense)
    for i in range(BLOCK):
        bundle[row + i] = bundle[_T + i]


@kernel
def _meet(bundle: Array, surface: Any, sense: float) -> None:
    """Leave the distance to a surface in `_T`, and what its asphere's terms add there in `_SAG` and `_SLOPE`.

    Of other surfaces than conics with even terms the latter hold the derivatives of the sag by x and y.
    """
    if surface.kind != CONIC_AND_EVEN:
        _meet_by_form(bundle, surface, sense)
        return
    _meet_conic(bundle, surface.curvature, surface.conic, surface.vertex_z, sense)
    if surface.terms > 0:
        _meet_asphere(bundle, surface)
    _asphere_terms(bundle, surface.terms, surface.asphere)


@pasted
def conic_distance(
    c: float, q: float, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[bool, float]:
    """Return whether a ray meets a conic, and the distance, as `surface.conic_distance`, without branches.

    The distance is meaningless where the ray misses.

    Parameters
    ----------
    c : float
        Curvature, 1/mm.
    q : float
        1 + conic constant.
    x, y, z : float
        Start relative to the vertex, mm.
    dx, dy, dz : float
    sense : float
        1: cross the surface along its normal, −1: against it.
    """
    a = c * (dx * dx + dy * dy + q * dz * dz)
    b = c * (x * dx + y * dy + q * z * dz) - dz
    g = c * (x * x + y * y + q * z * z) - 2.0 * z
    root = b * b - a * g
    return root >= 0.0, _root_of(a, b, g, sense, np.sqrt(root))


@pasted
def sphere_distance(
    c: float, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[bool, float, float]:
    """Return the results of `conic_distance` for a sphere (q = 1), and the cosine of incidence.

    Parameters
    ----------
    c : float, 1/mm
        Curvature.
    x, y, z : float, mm
        From the vertex.
    dx, dy, dz : float
        Unit direction.
    sense : float
        As for `conic_distance`.
    """
    root, cos_i, above, below = _sphere_crossing(c * sense, x, y, z, dx, dy, dz, sense)
    return root > 0.0, above / below, cos_i


@pasted
def _sphere_crossing(
    along: float, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[float, float, float, float]:
    """Return the squared cosine of incidence, the cosine, and two numbers whose ratio is the distance.

    Parameters
    ----------
    along : float
        Curvature times sense, so that both senses share the formulas of a ray along +z.
    """
    b = fused(along, fused(x, dx, fused(y, dy, z * dz)), -sense * dz)
    g = fused(along, fused(x, x, fused(y, y, z * z)), -2.0 * sense * z)
    root = fused(b, b, -along * g)
    cos_i = np.sqrt(root)
    # The form of the root without cancellation.
    far = b > 0.0
    return root, cos_i, select(far, -(b + cos_i), g), select(far, along, cos_i - b)


@pasted
def _root_of(a: float, b: float, g: float, sense: float, root: float) -> float:
    """Solve a t² + 2 b t + g = 0 for the crossing in a given sense, in the form without cancellation."""
    signed = sense * root
    far = signed * b > 0.0
    return select(far, -b - signed, g) / select(far, a, signed - b)


@pasted
def refraction(
    interfaces: Interfaces, number: int, colour: int,
    dx: float, dy: float, dz: float, nx: float, ny: float, nz: float, cos_i: float, n_i: float, n_t: float,
) -> tuple[float, float, float, bool, float]:  # fmt: skip
    """Return the refracted direction, whether reflection is total, and the transmittance.

    Snell's law as in `events.crossing`, without branches; where reflection is total, the other results are meaningless.
    The direction has unit length to rounding; `normalise` follows at the end of the path.

    Parameters
    ----------
    interfaces : Interfaces
    number, colour : int
        Row of the interface, and number of the wavelength.
    dx, dy, dz : float
    nx, ny, nz : float
        Unit normal along the ray.
    cos_i : float
    n_i, n_t : float
    """
    eta = n_i / n_t
    cos2_t = fused(eta * eta * cos_i, cos_i, 1.0 - eta * eta)
    cos_t = np.sqrt(cos2_t)
    s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
    share = transmitted_share(interfaces, number, colour, n_i, n_t, cos_i, cos_t, s, p, 1.0 / (s * p))
    g = fused(-eta, cos_i, cos_t)
    ux, uy, uz = fused(eta, dx, g * nx), fused(eta, dy, g * ny), fused(eta, dz, g * nz)
    return ux, uy, uz, not cos2_t > 0.0, share


@pasted
def _go_on(
    bundle: Array, i: int, meets: bool, x: float, y: float, z: float, ux: float, uy: float, uz: float,
    refracts: bool, transmittance: float, limit: float, rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    """Continue ray `i` from a point of a surface, or end it there; a ray that has ended is left as it is."""
    weight, ended = bundle[WEIGHT + i], bundle[ENDED_ON + i]
    alive = ended == 0.0
    r2 = fused(x, x, y * y)
    passes = r2 <= limit
    now = select(passes, select(refracts, 0.0, DROPPED), mount)
    now = select(alive, select(both(meets, r2 <= rim * rim), now, beyond), ended)
    moves = both(alive, meets)
    arrives, goes = both(moves, passes), now == 0.0
    bundle[ENDED_ON + i] = now
    bundle[MET + i] += select(arrives, 1.0, 0.0)
    on = select(arrives, select(goes, weight * transmittance, 0.0), weight)
    # Power that is not transmitted is reflected, under total reflection all of it.
    bundle[LEFT_BEHIND + i] += weight - on
    bundle[WEIGHT + i] = on
    bundle[X + i] = select(moves, x, bundle[X + i])
    bundle[Y + i] = select(moves, y, bundle[Y + i])
    bundle[Z + i] = select(moves, z, bundle[Z + i])
    bundle[DX + i] = select(goes, ux, bundle[DX + i])
    bundle[DY + i] = select(goes, uy, bundle[DY + i])
    bundle[DZ + i] = select(goes, uz, bundle[DZ + i])


@kernel
def _through_sphere(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    c: float, vertex_z: float, limit: float, sense: float, n_i: float, n_t: float,
    rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    """Take a bundle through a sphere: `sphere_distance` and `refraction` in one, with one division for both."""
    eta = n_i / n_t
    along = c * sense
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - vertex_z
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        root, cos_i, above, below = _sphere_crossing(along, x, y, z, dx, dy, dz, sense)
        # From the squared cosine, so that neither square root waits for the other.
        cos2_t = fused(eta * eta, root, 1.0 - eta * eta)
        # Zero under total reflection, as the distance shares its division with the transmittance.
        cos_t = np.sqrt(select(cos2_t > 0.0, cos2_t, 0.0))
        s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
        over_all = 1.0 / (below * (s * p))
        t, over = above * (over_all * (s * p)), over_all * below
        transmittance = transmitted_share(interfaces, number, colour, n_i, n_t, cos_i, cos_t, s, p, over)
        x, y, z = fused(t, dx, x), fused(t, dy, y), fused(t, dz, z)
        g = fused(-eta, cos_i, cos_t)
        bend = -along * g
        ux, uy, uz = fused(eta, dx, bend * x), fused(eta, dy, bend * y), fused(eta, dz, fused(bend, z, g * sense))
        _go_on(
            bundle, i, both(root > 0.0, t > 0.0), x, y, z + vertex_z, ux, uy, uz, cos2_t > 0.0, transmittance,
            limit, rim, mount, beyond,
        )  # fmt: skip


@kernel
def _meet_conic(bundle: Array, c: float, k: float, vertex_z: float, sense: float) -> None:
    """Leave the distance to a conic in `_T`: −1 where a ray misses it or meets its other sheet."""
    q = 1.0 + k
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - vertex_z
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        meets, t = conic_distance(c, q, x, y, z, dx, dy, dz, sense)
        bundle[_T + i] = select(both(meets, c * q * (z + t * dz) < 1.0), t, -1.0)


@kernel
def _meet_asphere(bundle: Array, surface: Any) -> None:
    """Improve the distances in `_T` to those of an asphere by Newton's method, all rays at once while any moves.

    Where that does not settle, or no conic was there to start from, the bracketed search for one ray decides.
    """
    moving = BLOCK
    for _ in range(NEWTON_STEPS):
        if moving == 0:
            break
        _asphere_terms(bundle, surface.terms, surface.asphere)
        moving = _newton_step(bundle, surface.curvature, surface.conic, surface.vertex_z)
    if moving > 0:
        for i in range(BLOCK):
            if bundle[ENDED_ON + i] == 0.0 and not bundle[_SETTLED + i] > 0.0:
                x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - surface.vertex_z
                dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
                sense = 1.0 if dz > 0.0 else -1.0
                meets, t = _search(surface, x, y, z, dx, dy, dz, sense)
                bundle[_T + i] = t if meets else -1.0


@kernel
def _meet_by_form(bundle: Array, surface: Any, sense: float) -> None:
    """Do what `_meet` does, ray by ray."""
    for i in range(BLOCK):
        bundle[_T + i], bundle[_GX + i], bundle[_GY + i] = -1.0, 0.0, 0.0
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        if bundle[ENDED_ON + i] != 0.0 or dz == 0.0:
            continue
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - surface.vertex_z
        meets, t = _search(surface, x, y, z, dx, dy, dz, sense)
        if meets:
            bundle[_T + i] = t
            _, bundle[_GX + i], bundle[_GY + i] = form_at(surface, x + t * dx, y + t * dy)


@kernel
def _search(
    surface: Any, x: float, y: float, z: float, dx: float, dy: float, dz: float, sense: float
) -> tuple[bool, float]:
    """Return whether and where a ray (from the vertex) crosses a surface, wherever that is.

    Inside the mesh's reach by steps that miss no crossing, beyond it by the search in a bracket from where the ray
    crosses the plane of the vertex.
    """
    at = -z / dz
    # Counted from there, as fewer digits are lost than from a start that is far away.
    x, y = x + at * dx, y + at * dy
    meets, t = first_crossing(surface, x, y, 0.0, dx, dy, dz, sense, -at, np.inf, False)
    if not meets:
        meets, t = distance_to(surface, x, y, 0.0, dx, dy, dz, sense)
    return meets, at + t


@kernel
def _asphere_terms(bundle: Array, terms: int, asphere: Array) -> None:
    """Leave r², and the sag and the half slope dz/d(r²) of an asphere's terms at the distances `_T`, by Horner."""
    _begin_terms(bundle)
    for m in range(terms - 1, -1, -1):
        _add_term(bundle, asphere[m], (m + 2.0) * asphere[m])


@kernel
def _begin_terms(bundle: Array) -> None:
    for i in range(BLOCK):
        t = bundle[_T + i]
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        bundle[_R2 + i] = x * x + y * y
        bundle[_SAG + i], bundle[_SLOPE + i] = 0.0, 0.0


@kernel
def _add_term(bundle: Array, sag: float, slope: float) -> None:
    for i in range(BLOCK):
        r2 = bundle[_R2 + i]
        bundle[_SAG + i] = bundle[_SAG + i] * r2 + sag
        bundle[_SLOPE + i] = bundle[_SLOPE + i] * r2 + slope


@kernel
def _newton_step(bundle: Array, c: float, k: float, vertex_z: float) -> int:
    """Take one step towards the asphere; return how many rays are still moving."""
    q = (1.0 + k) * c * c
    moving = 0
    for i in range(BLOCK):
        t, r2 = bundle[_T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] - vertex_z + t * dz
        steep = np.sqrt(1.0 - q * r2)
        sag = c * r2 / (1.0 + steep) + r2 * r2 * bundle[_SAG + i]
        half_slope = 0.5 * c / steep + r2 * bundle[_SLOPE + i]
        step = (z - sag) / (dz - 2.0 * half_slope * (x * dx + y * dy))
        size = abs(x) + abs(y) + abs(z) + abs(t)
        settled = abs(step) <= SETTLED * size
        bundle[_SETTLED + i] = select(settled, 1.0, 0.0)
        bundle[_T + i] = t - step
        moving += 0 if settled or bundle[ENDED_ON + i] != 0.0 else 1
    return moving


@kernel
def _bend_along_slope(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    c: float, k: float, vertex_z: float, limit: float, sense: float, n_i: float, n_t: float,
    rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    q = (1.0 + k) * c * c
    for i in range(BLOCK):
        t, r2 = bundle[_T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] + t * dz
        slope = c / np.sqrt(1.0 - q * r2) + 2.0 * r2 * bundle[_SLOPE + i]
        scale = sense / np.sqrt(slope * slope * r2 + 1.0)
        nx, ny = -slope * x * scale, -slope * y * scale
        cos_i = nx * dx + ny * dy + scale * dz
        ux, uy, uz, total, transmittance = refraction(
            interfaces, number, colour, dx, dy, dz, nx, ny, scale, cos_i, n_i, n_t
        )
        _go_on(
            bundle, i, both(t > 0.0, cos_i > 0.0), x, y, z, ux, uy, uz, not total, transmittance,
            limit, rim, mount, beyond,
        )  # fmt: skip


@kernel
def _bend_at_coating(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    c: float, k: float, vertex_z: float, limit: float, sense: float, n_i: float, n_t: float,
    rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    """Do what `_bend_along_slope` does at a coated surface, ray by ray, as tables have no vector instructions."""
    q, eta = (1.0 + k) * c * c, n_i / n_t
    for i in range(BLOCK):
        t, r2 = bundle[_T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] + t * dz
        slope = c / np.sqrt(1.0 - q * r2) + 2.0 * r2 * bundle[_SLOPE + i]
        scale = sense / np.sqrt(slope * slope * r2 + 1.0)
        nx, ny = -slope * x * scale, -slope * y * scale
        cos_i = nx * dx + ny * dy + scale * dz
        meets = t > 0.0 and cos_i > 0.0
        transmittance, g = 0.0, 0.0
        if meets and bundle[ENDED_ON + i] == 0.0:
            _, transmittance, cos_t = shares(interfaces, number, colour, n_i, n_t, min(cos_i, 1.0))
            g = cos_t - eta * cos_i
        _go_on(
            bundle, i, meets, x, y, z, eta * dx + g * nx, eta * dy + g * ny, eta * dz + g * scale,
            transmittance > 0.0, transmittance, limit, rim, mount, beyond,
        )  # fmt: skip


@kernel
def _turn_along_gradient(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, limit: float, sense: float, n_i: float, n_t: float,
    rim: float, mount: float, beyond: float, mirrors: bool,
) -> None:  # fmt: skip
    """Refract or mirror rays, bare or coated, at a surface of which `_meet` has left distance and gradient."""
    eta = n_i / n_t
    for i in range(BLOCK):
        t, gx, gy = bundle[_T + i], bundle[_GX + i], bundle[_GY + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        scale = sense / np.sqrt(gx * gx + gy * gy + 1.0)
        nx, ny = -gx * scale, -gy * scale
        cos_i = min(nx * dx + ny * dy + scale * dz, 1.0)
        meets = t > 0.0 and cos_i > 0.0
        share, g, on = 0.0, -2.0 * cos_i, 1.0
        if meets and bundle[ENDED_ON + i] == 0.0:
            reflectance, transmittance, cos_t = shares(interfaces, number, colour, n_i, n_t, cos_i)
            share = reflectance if mirrors else transmittance
            if not mirrors:
                on, g = eta, cos_t - eta * cos_i
        _go_on(
            bundle, i, meets, bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] + t * dz,
            on * dx + g * nx, on * dy + g * ny, on * dz + g * scale, share > 0.0, share, limit, rim, mount, beyond,
        )  # fmt: skip


@kernel
def _bend_by_thin_lens(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, vertex_z: float, limit: float,
    rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    """Take a bundle, whose distances `_meet` has found, through a thin lens."""
    for i in range(BLOCK):
        t, ended = bundle[_T + i], bundle[ENDED_ON + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y = bundle[X + i] + t * dx, bundle[Y + i] + t * dy
        ux, uy, uz, factor = through_thin_lens(interfaces, number, colour, x, y, dx, dy, dz)
        _go_on(bundle, i, t > 0.0, x, y, vertex_z, ux, uy, uz, True, 1.0, limit, rim, mount, beyond)
        passed = both(ended == 0.0, bundle[ENDED_ON + i] == 0.0)
        bundle[ETENDUE + i] *= select(passed, factor, 1.0)


@kernel
def begin_etendue(interfaces: Interfaces, bundle: Array) -> None:
    """Begin to count what thin lenses do to importance; nothing where the lens has none."""
    if interfaces.thin:
        for i in range(BLOCK):
            bundle[ETENDUE + i] = 1.0


@kernel
def take_etendue(interfaces: Interfaces, bundle: Array, book: Array) -> None:
    """Change the weights, of importance, by what thin lenses have done since `begin_etendue`, and enter it in the book.

    Parameters
    ----------
    interfaces : Interfaces
        Of the lens.
    bundle : (ROWS · BLOCK,) float64
    book : (slots,) float64
    """
    if interfaces.thin:
        for i in range(BLOCK):
            factor, weight = bundle[ETENDUE + i], bundle[WEIGHT + i]
            book[THIN_LENSES] += weight * (1.0 - factor)
            bundle[WEIGHT + i] = weight * factor


@kernel
def _mirror_along_slope(
    bundle: Array, interfaces: Interfaces, number: int, colour: int,
    c: float, k: float, vertex_z: float, limit: float, sense: float, n_i: float, n_t: float,
    rim: float, mount: float, beyond: float,
) -> None:  # fmt: skip
    """Mirror rays at a surface whose distance and slope `_meet` has left in the bundle; see `mirror_at_surface`."""
    q = (1.0 + k) * c * c
    for i in range(BLOCK):
        t, r2 = bundle[_T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] + t * dz
        slope = c / np.sqrt(1.0 - q * r2) + 2.0 * r2 * bundle[_SLOPE + i]
        scale = sense / np.sqrt(slope * slope * r2 + 1.0)
        nx, ny = -slope * x * scale, -slope * y * scale
        cos_i = nx * dx + ny * dy + scale * dz
        cosine = select(both(cos_i > 0.0, cos_i < 1.0), cos_i, 1.0)
        reflectance, _, _ = shares(interfaces, number, colour, n_i, n_t, cosine)
        ux, uy, uz = dx - 2.0 * cos_i * nx, dy - 2.0 * cos_i * ny, dz - 2.0 * cos_i * scale
        _go_on(
            bundle, i, both(t > 0.0, cos_i > 0.0), x, y, z, ux, uy, uz, reflectance > 0.0, reflectance,
            limit, rim, mount, beyond,
        )  # fmt: skip
