"""A block of packets at refracting surfaces, laid out for vector instructions: hits, and the two children.

A block is one float64 array of `ROWS` rows of `BLOCK` values, like a bundle of the sequential engine, but each packet
has its own surface, media and facet. Loops have no branches and run over the whole block; the results of places beyond
the last packet are never read. So every packet goes through the same instructions, whatever its neighbours are.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import MAX_ASPHERE_TERMS
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, select
from lfmesh.optics.fresnel import fresnel
from lfmesh.transport.events.crossing import reflected, refracted
from lfmesh.transport.events.facets import safely_behind
from lfmesh.transport.sequences.lens_surfaces import conic_distance, conic_normal

Array = NDArray[np.float64]

BLOCK = 32
"""Packets per block: few enough that block and packets fit in the first-level cache."""

# The ray: its start, mm, camera frame, its unit direction, and the distance at which the query started.
X, Y, Z, DX, DY, DZ, FROM = 0, BLOCK, 2 * BLOCK, 3 * BLOCK, 4 * BLOCK, 5 * BLOCK, 6 * BLOCK
# The conic: curvature, 1 + conic constant, z of the vertex, square of the aperture's radius, and the sense in which it
# is to be crossed: 1 along its normal, −1 against it, 0 if the packet is not for `meet_conics`.
CURVATURE, SQUASH, VERTEX_Z, APERTURE2, SENSE = 7 * BLOCK, 8 * BLOCK, 9 * BLOCK, 10 * BLOCK, 11 * BLOCK
# The facet: normal, offset of its plane, size.
FACET_X, FACET_Y, FACET_Z, OFFSET, SIZE = 12 * BLOCK, 13 * BLOCK, 14 * BLOCK, 15 * BLOCK, 16 * BLOCK
# The indices before and after the surface, and its number.
N_I, N_T, NUMBER = 17 * BLOCK, 18 * BLOCK, 19 * BLOCK
# The point of the hit, the unit normal there, along the ray, and whether the hit is valid (1 or 0).
PX, PY, PZ, NX, NY, NZ, HELD = 21 * BLOCK, 22 * BLOCK, 23 * BLOCK, 24 * BLOCK, 25 * BLOCK, 26 * BLOCK, 27 * BLOCK
# Results: shares of the power, and for each child its direction and the distance at which its query starts.
REFLECTANCE, TRANSMITTANCE = 28 * BLOCK, 29 * BLOCK
REFLECTED, REFRACTED = 30 * BLOCK, 34 * BLOCK
ALONG_X, ALONG_Y, ALONG_Z, CLEAR = 0, BLOCK, 2 * BLOCK, 3 * BLOCK
# For `meet_in_order`, the rows of the conic above hold the surface towards the object, and these the one towards the
# sensor, with the index beyond it and its number; then the squared radius that the ring of the space leaves free, and
# which of the two surfaces the ray starts on: −1, 1, or 0 for neither.
NEXT_CURVATURE, NEXT_SQUASH, NEXT_VERTEX_Z, NEXT_APERTURE2 = 38 * BLOCK, 39 * BLOCK, 40 * BLOCK, 41 * BLOCK
NEXT_N, NEXT_NUMBER, FREE2, STARTS_ON = 42 * BLOCK, 43 * BLOCK, 44 * BLOCK, 45 * BLOCK
# The distance at which `meet_in_order` finds the hit.
AT = 46 * BLOCK
# For aspheres: number of terms, 0 for a conic; squared radius, sum of the terms and of their slopes; coefficients.
TERMS, _RADIUS2, _SAG, _SLOPE, COEFFICIENTS = 47 * BLOCK, 48 * BLOCK, 49 * BLOCK, 50 * BLOCK, 51 * BLOCK
ROWS = 51 + MAX_ASPHERE_TERMS

NEWTON_STEPS = 12
"""Newton's method takes three to five; packets that take more are treated individually."""

SETTLED = 1e-14
"""Last Newton step, over the size of the coordinates, below which the point is exact and the normal equally good."""


def empty_block() -> Array:
    """Return memory for a block of packets, aligned to cache lines."""
    room = np.zeros(ROWS * BLOCK + 8)
    offset = (-room.ctypes.data // 8) % 8
    return room[offset : offset + ROWS * BLOCK]


@inlined
def set_ray(block: Array, i: int, packet: Any) -> None:
    """Enter the ray of a packet.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
        Place in the block.
    packet : PACKET
    """
    block[X + i], block[Y + i], block[Z + i] = packet.x, packet.y, packet.z
    block[DX + i], block[DY + i], block[DZ + i] = packet.dx, packet.dy, packet.dz
    block[FROM + i] = packet.query_from


@inlined
def set_facet(block: Array, i: int, facet: Any) -> None:
    """Enter the facet that a packet met.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    facet : FACET
    """
    normal = facet.normal
    block[FACET_X + i], block[FACET_Y + i], block[FACET_Z + i] = normal[0], normal[1], normal[2]
    block[OFFSET + i], block[SIZE + i] = facet.offset, facet.size


@inlined
def set_conic(block: Array, i: int, surface: Any, sense: float) -> None:
    """Enter the conic that a packet is to cross.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    surface : SURFACE
    sense : float
        1 or −1: selects the root on the surface.
    """
    block[CURVATURE + i], block[SQUASH + i], block[VERTEX_Z + i] = (
        surface.curvature, 1.0 + surface.conic, surface.vertex_z,
    )  # fmt: skip
    block[APERTURE2 + i] = surface.semi_diameter * surface.semi_diameter
    block[SENSE + i] = sense


@kernel
def meet_conics(block: Array) -> None:
    """Find the crossings of rays and conics in the given sense, within apertures, for facets of that sense.

    The analytic root gives the point, without the distance of the facet.
    """
    for i in range(BLOCK):
        dx, dy, dz = block[DX + i], block[DY + i], block[DZ + i]
        begin, sense, vertex_z = block[FROM + i], block[SENSE + i], block[VERTEX_Z + i]
        c, q = block[CURVATURE + i], block[SQUASH + i]
        x, y, z = block[X + i] + begin * dx, block[Y + i] + begin * dy, block[Z + i] - vertex_z + begin * dz
        meets, t = conic_distance(c, q, Ray(x, y, z, dx, dy, dz), sense)
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        nx, ny, nz = conic_normal(c, q, x, y, z, sense)
        along = block[FACET_X + i] * dx + block[FACET_Y + i] * dy + block[FACET_Z + i] * dz
        ahead = both(meets, begin + t > 0.0)
        crossed = both(sense * along > 0.0, nx * dx + ny * dy + nz * dz > 0.0)
        held = both(both(ahead, crossed), x * x + y * y <= block[APERTURE2 + i])
        block[PX + i], block[PY + i], block[PZ + i] = x, y, z + vertex_z
        block[NX + i], block[NY + i], block[NZ + i] = nx, ny, nz
        block[HELD + i] = select(held, 1.0, 0.0)


@inlined
def set_order(block: Array, i: int, space: Array, starts_on: float) -> None:
    """Enter the two conics that bound a space, and the radius inside its ring (a row of `LensTables.order`).

    Parameters
    ----------
    space : (12,) float64
    starts_on : float
        Surface of the start: towards the object (−1), towards the sensor (1), or neither (0).
    """
    block[CURVATURE + i], block[SQUASH + i], block[VERTEX_Z + i], block[APERTURE2 + i] = (
        space[0], space[1], space[2], space[3],
    )  # fmt: skip
    block[NEXT_CURVATURE + i], block[NEXT_SQUASH + i], block[NEXT_VERTEX_Z + i], block[NEXT_APERTURE2 + i] = (
        space[4], space[5], space[6], space[7],
    )  # fmt: skip
    block[FREE2 + i], block[STARTS_ON + i], block[SENSE + i] = space[8], starts_on, 1.0


@inlined
def set_only_conic(
    block: Array, i: int, curvature: float, squash: float, vertex_z: float, aperture2: float, sense: float
) -> None:
    """Enter a single conic for `meet_in_order`, to be crossed in the given sense, 1 or −1.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    curvature : float, 1/mm
    squash : float
        1 + conic constant.
    vertex_z : float, mm
    aperture2 : float, mm²
        Squared semi-diameter.
    sense : float
    """
    forward, none = sense > 0.0, np.nan
    block[CURVATURE + i], block[NEXT_CURVATURE + i] = (none, curvature) if forward else (curvature, none)
    block[SQUASH + i], block[NEXT_SQUASH + i] = squash, squash
    block[VERTEX_Z + i], block[NEXT_VERTEX_Z + i] = vertex_z, vertex_z
    block[APERTURE2 + i], block[NEXT_APERTURE2 + i] = aperture2, aperture2
    block[FREE2 + i], block[STARTS_ON + i], block[SENSE + i] = np.inf, 0.0, 1.0


@pasted
def _crossing(c: float, q: float, ray: Ray, begin: float, sense: float, starts_on: float) -> float:
    """Return the distance of a ray's crossing of a conic in the given sense, measured from `begin`; inf: none.

    A ray that leaves a conic meets it again only on the concave side; on the other, a root near the start is rounding.
    Any other ray starts in front of the conic: if the root lies behind its start, it crosses at once, as in
    `first_conic`.
    """
    meets, t = conic_distance(c, q, ray, sense)
    along = sense * (ray.dz - c * (ray.x * ray.dx + ray.y * ray.dy + q * ray.z * ray.dz))
    ahead = select(both(starts_on != sense, along > 0.0), np.inf, begin + t) > 0.0
    meets = both(both(meets, ahead), c * q * (ray.z + t * ray.dz) < 1.0)
    hollow = sense * c < 0.0
    meets = both(meets, starts_on != sense or hollow)
    return select(meets, t, np.inf)


@kernel
def meet_in_order(block: Array) -> None:
    """Find the first hit of each ray on the two conics of its space, without meshes.

    Hits within the aperture are valid if start and hit lie within the ring's inner radius, so that nothing else can
    come first.
    """
    for i in range(BLOCK):
        dx, dy, dz = block[DX + i], block[DY + i], block[DZ + i]
        sx, sy, begin, on = block[X + i], block[Y + i], block[FROM + i], block[STARTS_ON + i]
        x, y, z = sx + begin * dx, sy + begin * dy, block[Z + i] + begin * dz
        c, q, vertex_z = block[CURVATURE + i], block[SQUASH + i], block[VERTEX_Z + i]
        d, p, next_z = block[NEXT_CURVATURE + i], block[NEXT_SQUASH + i], block[NEXT_VERTEX_Z + i]
        back = _crossing(c, q, Ray(x, y, z - vertex_z, dx, dy, dz), begin, -1.0, on)
        ahead = _crossing(d, p, Ray(x, y, z - next_z, dx, dy, dz), begin, 1.0, on)
        forward = ahead < back
        t, sense = select(forward, ahead, back), select(forward, 1.0, -1.0)
        c, q, vertex_z = select(forward, d, c), select(forward, p, q), select(forward, next_z, vertex_z)
        aperture2 = select(forward, block[NEXT_APERTURE2 + i], block[APERTURE2 + i])
        x, y, z = x + t * dx, y + t * dy, z - vertex_z + t * dz
        free2, r2 = block[FREE2 + i], x * x + y * y
        clear = both(r2 <= free2, sx * sx + sy * sy <= free2)
        held = both(both(block[SENSE + i] > 0.0, t < np.inf), both(clear, r2 <= aperture2))
        block[PX + i], block[PY + i], block[PZ + i] = x, y, z + vertex_z
        block[NX + i], block[NY + i], block[NZ + i] = conic_normal(c, q, x, y, z, sense)
        block[N_T + i] = select(forward, block[NEXT_N + i], block[N_T + i])
        block[NUMBER + i] = select(forward, block[NEXT_NUMBER + i], block[NUMBER + i])
        block[HELD + i], block[AT + i] = select(held, 1.0, 0.0), begin + t


@inlined
def set_asphere(block: Array, i: int, surface: Any, terms: int) -> None:
    """Enter the aspheric terms of the surface, after its conic; a conic has none.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    i : int
    surface : SURFACE
    terms : int
        Largest number of terms of any packet of the block.
    """
    block[TERMS + i] = surface.terms
    if surface.terms > 0:
        # Terms are added in pairs.
        for m in range((terms + 1) // 2 * 2):
            block[COEFFICIENTS + m * BLOCK + i] = surface.asphere[m]


@kernel
def meet_aspheres(block: Array, terms: int) -> None:
    """Replace hits of `meet_in_order` on conic parts by hits on the aspheres.

    Uses Newton's method on all rays at once. Hits are valid if it converges; the caller must know that the ray crosses
    the asphere only once.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    terms : int
        Largest number of terms of a surface.
    """
    for i in range(BLOCK):
        t, curved = block[AT + i] - block[FROM + i], block[TERMS + i] > 0.0
        flat = (block[VERTEX_Z + i] - block[Z + i]) / block[DZ + i] - block[FROM + i]
        block[AT + i] = select(curved, select(abs(t) < np.inf, t, flat), block[AT + i])
    _settle(block, terms)


@kernel
def meet_aspheres_at_facets(block: Array, terms: int) -> None:
    """Replace hits of `meet_conics` on conic parts by hits on the aspheres.

    Like `meet_aspheres`, but from the crossing with the facet found, and only in its sense.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    terms : int
        As for `meet_aspheres`.
    """
    for i in range(BLOCK):
        nx, ny, nz = block[FACET_X + i], block[FACET_Y + i], block[FACET_Z + i]
        along = nx * block[DX + i] + ny * block[DY + i] + nz * block[DZ + i]
        above = nx * block[X + i] + ny * block[Y + i] + nz * block[Z + i] - block[OFFSET + i]
        curved, begin = block[TERMS + i] > 0.0, block[FROM + i]
        start = select(along * block[SENSE + i] > 0.0, -above / along - begin, np.nan)
        block[AT + i] = select(curved, start, block[AT + i])
        block[NEXT_CURVATURE + i] = select(curved, block[CURVATURE + i], block[NEXT_CURVATURE + i])
    _settle(block, terms)


@kernel
def _settle(block: Array, terms: int) -> None:
    """Move the rays to their aspheres by Newton's method, from the distances `AT`, measured from `FROM`."""
    moving = BLOCK
    for _ in range(NEWTON_STEPS):
        if moving == 0:
            break
        _add_terms(block, terms)
        moving = _newton_step(block)
    _set_hits(block)


@kernel
def _add_terms(block: Array, terms: int) -> None:
    """Compute the sums of the aspheres' terms, over r⁴, and half their slopes, over r³, at the distances `AT`."""
    pairs = (terms + 1) // 2
    _add_last_terms(block, COEFFICIENTS + 2 * (pairs - 1) * BLOCK, 2.0 * pairs)
    for pair in range(pairs - 2, -1, -1):
        _add_two_terms(block, COEFFICIENTS + 2 * pair * BLOCK, 2.0 * pair + 2.0)


@kernel
def _add_last_terms(block: Array, row: int, half_power: float) -> None:
    for i in range(BLOCK):
        t = block[AT + i] + block[FROM + i]
        x, y = block[X + i] + t * block[DX + i], block[Y + i] + t * block[DY + i]
        r2, a, b = x * x + y * y, block[row + i], block[row + BLOCK + i]
        block[_RADIUS2 + i] = r2
        block[_SAG + i] = b * r2 + a
        block[_SLOPE + i] = (half_power + 1.0) * b * r2 + half_power * a


@kernel
def _add_two_terms(block: Array, row: int, half_power: float) -> None:
    for i in range(BLOCK):
        r2, a, b = block[_RADIUS2 + i], block[row + i], block[row + BLOCK + i]
        block[_SAG + i] = (block[_SAG + i] * r2 + b) * r2 + a
        block[_SLOPE + i] = (block[_SLOPE + i] * r2 + (half_power + 1.0) * b) * r2 + half_power * a


@kernel
def _newton_step(block: Array) -> int:
    """Move the rays by one step; return how many have not converged. Leaves the slope over r in `_SLOPE`."""
    moving = 0
    for i in range(BLOCK):
        dx, dy, dz = block[DX + i], block[DY + i], block[DZ + i]
        start_z, t, vertex_z = block[Z + i], block[AT + i] + block[FROM + i], block[VERTEX_Z + i]
        c, q = select(dz > 0.0, block[NEXT_CURVATURE + i], block[CURVATURE + i]), block[SQUASH + i]
        x, y, z = block[X + i] + t * dx, block[Y + i] + t * dy, start_z - vertex_z + t * dz
        r2 = block[_RADIUS2 + i]
        steep = np.sqrt(1.0 - q * c * c * r2)
        height = z - c * r2 / (1.0 + steep) - r2 * r2 * block[_SAG + i]
        slope = c / steep + 2.0 * r2 * block[_SLOPE + i]
        step = height / (dz - slope * (x * dx + y * dy))
        limit = SETTLED * (abs(x) + abs(y) + abs(start_z) + abs(vertex_z) + abs(t))
        settled = abs(step) <= limit
        block[_SLOPE + i] = slope
        block[_RADIUS2 + i] = select(settled, r2, np.inf)
        block[AT + i] -= select(block[TERMS + i] > 0.0, step, 0.0)
        # Beyond the end of a surface the step is NaN: the ray has neither settled nor moves.
        moving += 1 if both(block[TERMS + i] > 0.0, abs(step) > limit) else 0
    return moving


@kernel
def _set_hits(block: Array) -> None:
    """Enter the points on the aspheres and the normals there, if the last step has converged."""
    for i in range(BLOCK):
        dx, dy, dz = block[DX + i], block[DY + i], block[DZ + i]
        t, r2, slope = block[AT + i] + block[FROM + i], block[_RADIUS2 + i], block[_SLOPE + i]
        x, y, z = block[X + i] + t * dx, block[Y + i] + t * dy, block[Z + i] + t * dz
        nx, ny = -slope * x, -slope * y
        scale = select(dz > 0.0, 1.0, -1.0) / np.sqrt(nx * nx + ny * ny + 1.0)
        curved = block[TERMS + i] > 0.0
        held = both(block[SENSE + i] != 0.0, both(t > 0.0, r2 <= block[APERTURE2 + i]))
        block[PX + i] = select(curved, x, block[PX + i])
        block[PY + i] = select(curved, y, block[PY + i])
        block[PZ + i] = select(curved, z, block[PZ + i])
        block[NX + i] = select(curved, nx * scale, block[NX + i])
        block[NY + i] = select(curved, ny * scale, block[NY + i])
        block[NZ + i] = select(curved, scale, block[NZ + i])
        block[HELD + i] = select(curved, select(held, 1.0, 0.0), block[HELD + i])
        block[AT + i] = select(curved, t, block[AT + i])


@kernel
def split_block(block: Array) -> None:
    """Compute the shares of power, directions and query starts of each packet's children.

    The shares are for bare surfaces; at coated ones packets are divided singly.
    """
    for i in range(BLOCK):
        dx, dy, dz = block[DX + i], block[DY + i], block[DZ + i]
        nx, ny, nz = block[NX + i], block[NY + i], block[NZ + i]
        n_i, n_t = block[N_I + i], block[N_T + i]
        cos_i = nx * dx + ny * dy + nz * dz
        cos_i = 1.0 if cos_i > 1.0 else cos_i
        reflectance, transmittance, cos_t = fresnel(n_i, n_t, cos_i)
        block[REFLECTANCE + i], block[TRANSMITTANCE + i] = reflectance, transmittance
        ux, uy, uz = reflected(dx, dy, dz, nx, ny, nz)
        set_child(block, REFLECTED + i, i, ux, uy, uz)
        ux, uy, uz = refracted(dx, dy, dz, nx, ny, nz, n_i / n_t, cos_i, cos_t)
        set_child(block, REFRACTED + i, i, ux, uy, uz)


@inlined
def incidence(block: Array, i: int) -> float:
    """Return the cosine of the angle of incidence of a packet."""
    cos_i = block[NX + i] * block[DX + i] + block[NY + i] * block[DY + i] + block[NZ + i] * block[DZ + i]
    return min(cos_i, 1.0)


@inlined
def set_child(block: Array, child: int, i: int, ux: float, uy: float, uz: float) -> None:
    """Enter the direction of a child, and the start of its query.

    Parameters
    ----------
    block : (ROWS · BLOCK,) float64
    child : int
        `REFLECTED` or `REFRACTED`, plus the place.
    i : int
    ux, uy, uz : float
        Unit direction.
    """
    block[child + ALONG_X], block[child + ALONG_Y], block[child + ALONG_Z] = ux, uy, uz
    block[child + CLEAR] = safely_behind(
        block[FACET_X + i], block[FACET_Y + i], block[FACET_Z + i], block[OFFSET + i], block[SIZE + i],
        Ray(block[PX + i], block[PY + i], block[PZ + i], ux, uy, uz),
    )  # fmt: skip
