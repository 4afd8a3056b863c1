"""Division of light at an interface: a block of rays continues refracted or reflected.

Covers bare, coated and absorbing interfaces, also with a phase, and thin lenses of all shapes. The bundle holds the
intersections and normals. Power absorbed by a coating is booked, and so is the power of a phase in orders that are not
followed; the rest that does not continue is left behind.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, fused, select
from lfmesh.optics.fresnel import amplitude_sums, fresnel, refraction, transmittance
from lfmesh.optics.share_table import (
    PASSED,
    TERMS,
    TOTAL,
    place_in_table,
    side_of_table,
    variable_under_total_reflection,
)
from lfmesh.transport.events.interface import shares, through_thin_lens
from lfmesh.transport.events.phase import (
    EVANESCENT,
    absorbed_at_phase,
    has_phase,
    light_at_phase,
    towards_order,
    unlisted_at_phase,
)
from lfmesh.transport.packets.book import THIN_LENSES
from lfmesh.transport.sequences.bundle import (
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    COEFFICIENTS,
    COS_T,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    ETENDUE,
    FATE,
    INDEX_BEFORE,
    INDEX_BEHIND,
    LEFT_BEHIND,
    MET,
    NX,
    NY,
    NZ,
    PHASE_X,
    PHASE_Y,
    PIECE,
    REFLECTED,
    TAKEN,
    TRANSMITTED,
    WEIGHT,
    WITHIN,
    X,
    Y,
    Z,
)
from lfmesh.transport.tables.phase_faces import EVANESCENT_ORDERS, FIRST_TRANSMITTED, UNLISTED_ORDERS
from lfmesh.transport.tables.tables import ABSORBING, BARE, THIN_LENS, Interfaces

Array = NDArray[np.float64]

# The `TERMS` coefficients of a piece of a coating's table.
_C0, _C1, _C2 = COEFFICIENTS, COEFFICIENTS + BLOCK, COEFFICIENTS + 2 * BLOCK
_C3, _C4, _C5 = COEFFICIENTS + 3 * BLOCK, COEFFICIENTS + 4 * BLOCK, COEFFICIENTS + 5 * BLOCK


@kernel
def divide(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, indices: tuple[float, float], outward: bool,
    mirrors: bool, book: Array,
) -> None:  # fmt: skip
    """Take the rays of a bundle through their face, or reflect them there.

    A phase turns transmitted rays into its main order, and leaves reflected ones in the zeroth. It needs the rows
    `PHASE_X` and `PHASE_Y`.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    interfaces : Interfaces
        Interfaces of the region.
    number, colour : int
        Row of the interface, and number of the wavelength.
    indices : (2,) float
        Refractive index before and after the interface.
    outward : bool
        Rays come from the side of a coating's last layer.
    mirrors : bool
        Reflect the rays; else refract them.
    book : (slots,) float64
        Receives light absorbed by a coating.
    """
    row = interfaces.rows[number]
    if not mirrors and has_phase(interfaces.phases, number):
        _through_phase(interfaces.phases, bundle, interfaces, number, colour, indices, outward, book)
    elif row.kind == THIN_LENS:
        _through_thin_lens(bundle, interfaces, number, colour)
    elif row.kind == BARE and not mirrors:
        _refract(bundle, indices)
    else:
        if row.kind == BARE:
            _find_bare_shares(bundle, indices)
        else:
            _find_coated_shares(bundle, interfaces, number, colour, indices, outward)
        _turn(bundle, indices, mirrors, row.kind == ABSORBING)
        if row.kind == ABSORBING:
            taken = 0.0
            for i in range(BLOCK):
                taken += bundle[TAKEN + i]
            book[row.slot] += taken


@pasted
def go_on(bundle: Array, i: int, moves: bool, ray: Ray, fate: float, share: float, taken: float) -> None:
    """Continue ray `i` from a point of a face, or end it there, unless it has ended before.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    moves : bool
        The ray reaches the point; a ray that misses the face ends in place.
    ray : Ray
        The point, and the direction of the continued ray.
    fate : float
        Fate that ends the ray, or 0, see `bundle.FATE`.
    share : float
        Fraction of its power that continues; with 0 it is dropped.
    taken : float
        Power absorbed by the interface.
    """
    weight, ended = bundle[WEIGHT + i], bundle[ENDED_ON + i]
    alive = ended == 0.0
    arrives = both(alive, fate == 0.0)
    goes = both(arrives, share > 0.0)
    moves = both(alive, moves)
    now = select(arrives, select(share > 0.0, 0.0, DROPPED), select(alive, fate, ended))
    on = select(goes, weight * share, select(both(alive, now == DROPPED), 0.0, weight))
    bundle[ENDED_ON + i] = now
    bundle[MET + i] += select(arrives, 1.0, 0.0)
    # Power neither passed on nor absorbed is reflected; under total reflection, all of it.
    bundle[LEFT_BEHIND + i] += weight - on - taken
    bundle[WEIGHT + i] = on
    bundle[X + i] = select(moves, ray.x, bundle[X + i])
    bundle[Y + i] = select(moves, ray.y, bundle[Y + i])
    bundle[Z + i] = select(moves, ray.z, bundle[Z + i])
    bundle[DX + i] = select(goes, ray.dx, bundle[DX + i])
    bundle[DY + i] = select(goes, ray.dy, bundle[DY + i])
    bundle[DZ + i] = select(goes, ray.dz, bundle[DZ + i])


@kernel
def _refract(bundle: Array, indices: tuple[float, float]) -> None:
    """Refract rays at a bare interface, without branches."""
    n_i, n_t = indices
    eta = n_i / n_t
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        nx, ny, nz = bundle[NX + i], bundle[NY + i], bundle[NZ + i]
        cos_i = nx * dx + ny * dy + nz * dz
        cos2_t = fused(eta * eta * cos_i, cos_i, 1.0 - eta * eta)
        cos_t = np.sqrt(cos2_t)
        s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
        share = select(cos2_t > 0.0, transmittance(n_i, n_t, cos_i, cos_t, s, p, 1.0 / (s * p)), 0.0)
        g = fused(-eta, cos_i, cos_t)
        ux, uy, uz = fused(eta, dx, g * nx), fused(eta, dy, g * ny), fused(eta, dz, g * nz)
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        go_on(bundle, i, True, Ray(x, y, z, ux, uy, uz), bundle[FATE + i], share, 0.0)


@pasted
def _incidence(bundle: Array, i: int) -> float:
    """Return the cosine of a ray's angle of incidence."""
    cosine = bundle[NX + i] * bundle[DX + i] + bundle[NY + i] * bundle[DY + i] + bundle[NZ + i] * bundle[DZ + i]
    return select(cosine < 1.0, cosine, 1.0)


@kernel
def _find_bare_shares(bundle: Array, indices: tuple[float, float]) -> None:
    n_i, n_t = indices
    for i in range(BLOCK):
        reflectance, passed, cos_t = fresnel(n_i, n_t, _incidence(bundle, i))
        bundle[REFLECTED + i], bundle[TRANSMITTED + i], bundle[COS_T + i] = reflectance, passed, cos_t


@kernel
def _find_coated_shares(
    bundle: Array, interfaces: Interfaces, number: int, colour: int, indices: tuple[float, float], outward: bool
) -> None:
    """Find the fractions as `coated_shares` does; only table look-ups are not vectorised."""
    row, parameters = interfaces.rows[number], interfaces.parameters
    first, size, absorbs = row.first, TERMS * row.pieces, row.kind == ABSORBING
    _find_places(bundle, indices, row.pieces)
    if not absorbs:
        _read(bundle, parameters, first, first, colour)
        _share_all(bundle)
        return
    if indices[0] > indices[1]:
        _find_places_under_total_reflection(bundle, indices, row.pieces)
    _read(bundle, parameters, first + PASSED * size, first + PASSED * size, colour)
    _keep_passed(bundle)
    first += side_of_table(indices[0], indices[1], outward) * size
    _read(bundle, parameters, first, row.first + TOTAL * size, colour)
    _share_rest(bundle)


@kernel
def _find_places(bundle: Array, indices: tuple[float, float], pieces: int) -> None:
    """Find the places of rays in a coating's table; transmittance 0 marks total reflection, 1 the rest."""
    n_i, n_t = indices
    for i in range(BLOCK):
        cos_i = _incidence(bundle, i)
        total, cos_t = refraction(n_i, n_t, cos_i)
        u = np.sqrt(select(cos_i < cos_t, cos_i, cos_t))
        bundle[PIECE + i], bundle[WITHIN + i] = place_in_table(u, pieces)
        bundle[TRANSMITTED + i], bundle[COS_T + i] = select(total, 0.0, 1.0), cos_t


@kernel
def _find_places_under_total_reflection(bundle: Array, indices: tuple[float, float], pieces: int) -> None:
    n_i, n_t = indices
    for i in range(BLOCK):
        piece, within = place_in_table(variable_under_total_reflection(n_i, n_t, _incidence(bundle, i)), pieces)
        total = bundle[TRANSMITTED + i] == 0.0
        bundle[PIECE + i] = select(total, piece, bundle[PIECE + i])
        bundle[WITHIN + i] = select(total, within, bundle[WITHIN + i])


@kernel
def _read(bundle: Array, parameters: Array, first: int, if_total: int, colour: int) -> None:
    """Read the coefficients of a quantity, from row `if_total` under total reflection, else `first`."""
    for i in range(BLOCK):
        at = (if_total if bundle[TRANSMITTED + i] == 0.0 else first) + TERMS * int(bundle[PIECE + i])
        bundle[_C0 + i], bundle[_C1 + i] = parameters[at, colour], parameters[at + 1, colour]
        bundle[_C2 + i], bundle[_C3 + i] = parameters[at + 2, colour], parameters[at + 3, colour]
        bundle[_C4 + i], bundle[_C5 + i] = parameters[at + 4, colour], parameters[at + 5, colour]


@pasted
def _looked_up(bundle: Array, i: int) -> float:
    """Return the fraction that the coefficients give."""
    x = bundle[WITHIN + i]
    share = bundle[_C4 + i] + x * bundle[_C5 + i]
    share = bundle[_C2 + i] + x * (bundle[_C3 + i] + x * share)
    share = bundle[_C0 + i] + x * (bundle[_C1 + i] + x * share)
    return select(share > 0.0, select(share < 1.0, share, 1.0), 0.0)


@kernel
def _share_all(bundle: Array) -> None:
    """Set the fractions at a coating that does not absorb."""
    for i in range(BLOCK):
        reflectance = select(bundle[TRANSMITTED + i] == 0.0, 1.0, _looked_up(bundle, i))
        bundle[REFLECTED + i], bundle[TRANSMITTED + i] = reflectance, 1.0 - reflectance


@kernel
def _keep_passed(bundle: Array) -> None:
    for i in range(BLOCK):
        bundle[TAKEN + i] = _looked_up(bundle, i)


@kernel
def _share_rest(bundle: Array) -> None:
    """Set the fractions at an absorbing coating with known transmittance."""
    for i in range(BLOCK):
        reflectance, passed = _looked_up(bundle, i), bundle[TAKEN + i]
        left, total = 1.0 - reflectance, bundle[TRANSMITTED + i] == 0.0
        bundle[REFLECTED + i] = reflectance
        bundle[TRANSMITTED + i] = select(total, 0.0, select(passed < left, passed, left))


@kernel
def _turn(bundle: Array, indices: tuple[float, float], mirrors: bool, absorbs: bool) -> None:
    """Refract or reflect rays by the fractions in the bundle."""
    eta = indices[0] / indices[1]
    on = 1.0 if mirrors else eta
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        nx, ny, nz = bundle[NX + i], bundle[NY + i], bundle[NZ + i]
        cos_i = _incidence(bundle, i)
        reflectance, passed = bundle[REFLECTED + i], bundle[TRANSMITTED + i]
        g = select(mirrors, -2.0 * cos_i, bundle[COS_T + i] - eta * cos_i)
        share = select(mirrors, reflectance, passed)
        fate = bundle[FATE + i]
        divided = both(absorbs, both(bundle[ENDED_ON + i] == 0.0, fate == 0.0))
        taken = select(divided, bundle[WEIGHT + i] * (1.0 - reflectance - passed), 0.0)
        bundle[TAKEN + i] = taken
        ux, uy, uz = on * dx + g * nx, on * dy + g * ny, on * dz + g * nz
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        go_on(bundle, i, True, Ray(x, y, z, ux, uy, uz), fate, share, taken)


@kernel
def _through_thin_lens(bundle: Array, interfaces: Interfaces, number: int, colour: int) -> None:
    for i in range(BLOCK):
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        ux, uy, uz, factor = through_thin_lens(interfaces, number, colour, x, y, (dx, dy, dz))
        ended = bundle[ENDED_ON + i]
        go_on(bundle, i, True, Ray(x, y, z, ux, uy, uz), bundle[FATE + i], 1.0, 0.0)
        passed = both(ended == 0.0, bundle[ENDED_ON + i] == 0.0)
        bundle[ETENDUE + i] *= select(passed, factor, 1.0)


@inlined
def _through_phase(
    phases: Any, bundle: Array, interfaces: Interfaces, number: int, colour: int, indices: tuple[float, float],
    outward: bool, book: Array,
) -> None:  # fmt: skip
    """Turn rays into the main order of a phase; `phases` : PhaseFaces or None."""
    if phases is None:
        return
    listed = phases.first[number, FIRST_TRANSMITTED]
    absorbed, evanescent, unlisted = 0.0, 0.0, 0.0
    for i in range(BLOCK):
        dx, dy, dz, weight = bundle[DX + i], bundle[DY + i], bundle[DZ + i], bundle[WEIGHT + i]
        share, taken = 1.0, 0.0
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            light = light_at_phase(
                interfaces, phases, number, colour, indices, (dx, dy, dz),
                (bundle[NX + i], bundle[NY + i], bundle[NZ + i]), (bundle[PHASE_X + i], bundle[PHASE_Y + i]), outward,
            )  # fmt: skip
            share, of_light, dx, dy, dz = towards_order(interfaces, phases, light, listed, False)
            in_coating, in_none, lost = absorbed_at_phase(interfaces, light), unlisted_at_phase(phases, light), 0.0
            if share == EVANESCENT:
                share, lost = 0.0, of_light
            else:
                in_none += of_light - share
            absorbed += weight * in_coating
            evanescent += weight * lost
            unlisted += weight * in_none
            taken = weight * (in_coating + lost + in_none)
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        go_on(bundle, i, True, Ray(x, y, z, dx, dy, dz), bundle[FATE + i], share, taken)
    book[phases.slot[number, EVANESCENT_ORDERS]] += evanescent
    book[phases.slot[number, UNLISTED_ORDERS]] += unlisted
    if absorbed != 0.0:
        book[interfaces.rows[number].slot] += absorbed


@inlined
def divide_by_place(
    gradients: Any, bundle: Array, interfaces: Interfaces, number: int, colour: int, outward: bool, mirrors: bool,
    book: Array,
) -> None:  # fmt: skip
    """Take the rays of a bundle through a face of gradient-index glass, or reflect them there, as `divide` does.

    The indices on both sides are those of the rows `INDEX_BEFORE` and `INDEX_BEHIND`.

    Parameters
    ----------
    gradients : Any
        Gradients of the region, or None: numba skips this code.
    bundle, interfaces, number, colour, outward, mirrors, book
        As for `divide`. The face is bare or coated.
    """
    if gradients is None:
        return
    absorbed = 0.0
    for i in range(BLOCK):
        dx, dy, dz, weight = bundle[DX + i], bundle[DY + i], bundle[DZ + i], bundle[WEIGHT + i]
        share, taken = 1.0, 0.0
        if bundle[ENDED_ON + i] == 0.0 and bundle[FATE + i] == 0.0:
            n_i, n_t, cos_i = bundle[INDEX_BEFORE + i], bundle[INDEX_BEHIND + i], _incidence(bundle, i)
            reflectance, passed, cos_t = shares(interfaces, number, colour, n_i, n_t, cos_i, outward)
            eta = 1.0 if mirrors else n_i / n_t
            g = -2.0 * cos_i if mirrors else cos_t - eta * cos_i
            share = reflectance if mirrors else passed
            dx, dy, dz = eta * dx + g * bundle[NX + i], eta * dy + g * bundle[NY + i], eta * dz + g * bundle[NZ + i]
            if interfaces.rows[number].kind == ABSORBING:
                taken = weight * (1.0 - reflectance - passed)
                absorbed += taken
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        go_on(bundle, i, True, Ray(x, y, z, dx, dy, dz), bundle[FATE + i], share, taken)
    if absorbed != 0.0:
        book[interfaces.rows[number].slot] += absorbed


@kernel
def begin_etendue(interfaces: Interfaces, bundle: Array) -> None:
    """Begin to track the effect of any thin lenses on importance."""
    if interfaces.thin:
        for i in range(BLOCK):
            bundle[ETENDUE + i] = 1.0


@kernel
def take_etendue(interfaces: Interfaces, bundle: Array, book: Array) -> None:
    """Scale the weights, which are importance, by the thin lenses since `begin_etendue`; book the change.

    Parameters
    ----------
    interfaces : Interfaces
        Interfaces of the lens.
    bundle : (ROWS · BLOCK,) float64
    book : (slots,) float64
    """
    if interfaces.thin:
        for i in range(BLOCK):
            factor, weight = bundle[ETENDUE + i], bundle[WEIGHT + i]
            book[THIN_LENSES] += weight * (1.0 - factor)
            bundle[WEIGHT + i] = weight * factor
