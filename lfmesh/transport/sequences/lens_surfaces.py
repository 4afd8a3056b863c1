"""Intersections of blocks of rays with lens surfaces, one function per shape.

A new shape is a branch of `meet_surface`, which finds distance, point and normal for each ray of a bundle. Bare
spheres, the most common surfaces, are intersected and refracted in one step if they have no phase and touch no
gradient-index glass. Rays in that glass arrive along curves, see `gradient_gaps`.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.ray import Ray
from lfmesh.geometry.surfaces.surface import CONIC_AND_EVEN, NEWTON_STEPS, SETTLED, distance_to, first_crossing, form_at
from lfmesh.geometry.surfaces.tessellation import OVERREACH
from lfmesh.kernels.decorators import inlined, kernel, pasted
from lfmesh.kernels.vector import both, fused, select
from lfmesh.optics.fresnel import amplitude_sums, transmittance
from lfmesh.transport.events.gradient import in_gradient
from lfmesh.transport.events.phase import has_phase
from lfmesh.transport.sequences.bundle import (
    AGAIN,
    AT_X,
    AT_Y,
    AT_Z,
    BLOCK,
    DROPPED,
    DX,
    DY,
    DZ,
    ENDED_ON,
    FATE,
    NX,
    NY,
    NZ,
    PHASE_X,
    PHASE_Y,
    SCRATCH,
    T,
    X,
    Y,
    Z,
    absorb,
    move_bundle,
)
from lfmesh.transport.sequences.division import divide, divide_by_place, go_on
from lfmesh.transport.sequences.gradient_gaps import arrive_from_gap, follow_gap, set_local_indices
from lfmesh.transport.tables.tables import BARE, LensTables

Array = NDArray[np.float64]

# Working rows: radius², sag and half slope of an asphere's terms, and 1 once Newton's method has settled.
_R2, _SAG, _SLOPE, _SETTLED = SCRATCH, SCRATCH + BLOCK, SCRATCH + 2 * BLOCK, SCRATCH + 3 * BLOCK

NEAR = 1e-9
"""Distance, relative to the coordinates, up to which a ray still is on the surface that it leaves."""

TOUCHING = 1e-13
"""Distance, relative to the size of the lens, by which a ray may start beyond the surface that it meets: if surfaces
touch, rounding decides on which side of the next surface a ray leaves the last one."""

Fates = tuple[float, float, float]
"""Radius of the mount around the clear aperture, mm; fates of rays between aperture and mount, and beyond the mount."""


@kernel
def at_surface(
    bundle: Array, lens: LensTables, k: int, mirrors: bool, colour: int, sense: float, fates: Fates, checked: bool,
    book: Array,
) -> None:  # fmt: skip
    """Take a bundle through a refracting surface of the lens, or reflect it there.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    lens : LensTables
    k : int
        Surface number.
    mirrors : bool
        Reflect the rays; else refract them.
    colour : int
        Wavelength number.
    sense : float
        1 for rays that arrive along the surface's normal, which points to +z at the vertex; −1 against it.
    fates : Fates
    checked : bool
        Drop rays that first meet the last surface again (see `find_return`), or a sphere beyond its equator.
    book : (slots,) float64
        Receives light absorbed by glass and coating.
    """
    surface, into = lens.surfaces[k], 1 if sense > 0.0 else 0
    curved = in_gradient(lens.gradients, k + 1 - into)
    if curved:
        follow_gap(bundle, lens, k + 1 - into, k, colour)
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    nearest = -TOUCHING * max(abs(lens.box_low[2]), abs(lens.box_high[2]), lens.box_high[0])
    media, medium = lens.media, lens.medium
    before, behind = medium[k + 1 - into], medium[k + into]
    indices = (media.indices[before, colour], media.indices[behind, colour])
    is_sphere = surface.terms == 0 and surface.conic == 0.0
    is_bare = lens.interfaces.rows[k].kind == BARE and not has_phase(lens.interfaces.phases, k)
    local = curved or in_gradient(lens.gradients, k + into)
    if is_sphere and is_bare and not mirrors and _is_clear(media.absorption) and not local:
        _through_sphere(bundle, surface, sense, indices, fates, nearest, checked)
    else:
        if curved:
            arrive_from_gap(lens.gradients, bundle, surface, sense, fates[1])
        else:
            meet_surface(bundle, surface, sense)
            _set_fates(bundle, surface.semi_diameter * surface.semi_diameter, fates, nearest)
            if checked:
                _check(bundle, surface.curvature if is_sphere else 0.0, surface.vertex_z)
        absorb(bundle, media.absorption, before, colour, book)
        _place_on_axis(lens.interfaces.phases, bundle)
        if local:
            set_local_indices(lens.gradients, bundle, lens, k, colour, into)
            divide_by_place(lens.gradients, bundle, lens.interfaces, k, colour, sense < 0.0, mirrors, book)
        else:
            divide(bundle, lens.interfaces, k, colour, indices, sense < 0.0, mirrors, book)
    if surface.posed:
        move_bundle(bundle, surface.pose)


@pasted
def _is_clear(absorption: Any) -> bool:
    return absorption is None


@inlined
def _place_on_axis(phases: Any, bundle: Array) -> None:
    """Set the intersections in the frame of a surface's phase, if the lens has any (`phases` : PhaseFaces or None)."""
    if phases is None:
        return
    for i in range(BLOCK):
        bundle[PHASE_X + i], bundle[PHASE_Y + i] = bundle[AT_X + i], bundle[AT_Y + i]


@kernel
def meet_surface(bundle: Array, surface: Any, sense: float) -> None:
    """Intersect rays with an unposed surface: distance, point, and normal along the ray.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
    surface : SURFACE record
    sense : float
        1: along its normal, −1: against it.
    """
    if surface.kind != CONIC_AND_EVEN:
        _meet_by_form(bundle, surface, sense)
        return
    _meet_conic(bundle, surface.curvature, surface.conic, surface.vertex_z, sense)
    if surface.terms > 0:
        _meet_asphere(bundle, surface, sense)


@kernel
def _set_fates(bundle: Array, limit: float, fates: Fates, nearest: float) -> None:
    """Set the fates at or beyond the mount; rays that miss the surface stay in place."""
    rim, mount, beyond = fates
    for i in range(BLOCK):
        x, y, z = bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i]
        along = bundle[NX + i] * bundle[DX + i] + bundle[NY + i] * bundle[DY + i] + bundle[NZ + i] * bundle[DZ + i]
        meets, r2 = both(bundle[T + i] > nearest, along > 0.0), x * x + y * y
        bundle[FATE + i] = select(both(meets, r2 <= rim * rim), select(r2 <= limit, 0.0, mount), beyond)
        bundle[AT_X + i] = select(meets, x, bundle[X + i])
        bundle[AT_Y + i] = select(meets, y, bundle[Y + i])
        bundle[AT_Z + i] = select(meets, z, bundle[Z + i])


@kernel
def _check(bundle: Array, c: float, vertex_z: float) -> None:
    for i in range(BLOCK):
        holds = both(bundle[T + i] <= bundle[AGAIN + i], c * (bundle[AT_Z + i] - vertex_z) < 1.0)
        bundle[FATE + i] = select(both(bundle[FATE + i] == 0.0, not holds), DROPPED, bundle[FATE + i])


@kernel
def find_return(bundle: Array, lens: LensTables, k: int, sense: float) -> None:
    """Find the distance to a second hit, within the rim, on the surface just left.

    Parameters
    ----------
    bundle : (ROWS · BLOCK,) float64
        Camera frame.
    lens : LensTables
    k : int
        Number of the surface; −1: none.
    sense : float
        Sense of the crossing.
    """
    for i in range(BLOCK):
        bundle[AGAIN + i] = np.inf
    if k < 0:
        return
    surface = lens.surfaces[k]
    if surface.terms == 0 and not sense * surface.curvature < 0.0:
        return
    if surface.posed:
        move_bundle(bundle, surface.unpose)
    meet_surface(bundle, surface, sense)
    rim = surface.semi_diameter * (1.0 + OVERREACH)
    for i in range(BLOCK):
        t = bundle[T + i]
        ahead = t > NEAR * (abs(bundle[X + i]) + abs(bundle[Y + i]) + abs(bundle[Z + i]))
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        bundle[AGAIN + i] = select(both(ahead, x * x + y * y <= rim * rim), t, np.inf)
    if surface.posed:
        move_bundle(bundle, surface.pose)


@pasted
def conic_distance(c: float, q: float, ray: Ray, sense: float) -> tuple[bool, float]:
    """Return whether a ray meets a conic, and the distance, as `surface.conic_distance` without branches.

    The distance is meaningless if the ray misses.

    Parameters
    ----------
    c : float
        Curvature, 1/mm.
    q : float
        1 + conic constant.
    ray : Ray
        Start relative to the vertex, mm.
    sense : float
        1: cross the surface along its normal, −1: against it.
    """
    x, y, z, dx, dy, dz = ray
    a = c * (dx * dx + dy * dy + q * dz * dz)
    b = c * (x * dx + y * dy + q * z * dz) - dz
    g = c * (x * x + y * y + q * z * z) - 2.0 * z
    root = b * b - a * g
    # Root of a t² + 2 b t + g = 0, in the form without cancellation.
    signed = sense * np.sqrt(root)
    far = signed * b > 0.0
    return root >= 0.0, select(far, -b - signed, g) / select(far, a, signed - b)


@pasted
def conic_normal(c: float, q: float, x: float, y: float, z: float, sense: float) -> tuple[float, float, float]:
    """Return the unit normal of a conic, towards +z at the vertex if `sense` is 1, else against it.

    Parameters
    ----------
    c, q, sense : float
        As for `conic_distance`.
    x, y, z : float, mm
        Relative to the vertex.
    """
    nx, ny, nz = -c * x, -c * y, 1.0 - c * q * z
    scale = sense / np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx * scale, ny * scale, nz * scale


@pasted
def sphere_crossing(along: float, ray: Ray, sense: float) -> tuple[float, float, float, float]:
    """Return the squared cosine of incidence at a sphere, the cosine, and the distance's numerator and denominator.

    Parameters
    ----------
    along : float
        Curvature times sense, so that both senses share the formulas of a ray along +z.
    ray : Ray
        Relative to the vertex.
    sense : float
        As for `conic_distance`.
    """
    x, y, z, dx, dy, dz = ray
    b = fused(along, fused(x, dx, fused(y, dy, z * dz)), -sense * dz)
    g = fused(along, fused(x, x, fused(y, y, z * z)), -2.0 * sense * z)
    root = fused(b, b, -along * g)
    cos_i = np.sqrt(root)
    # Form of the root without cancellation.
    far = b > 0.0
    return root, cos_i, select(far, -(b + cos_i), g), select(far, along, cos_i - b)


@kernel
def _through_sphere(
    bundle: Array, surface: Any, sense: float, indices: tuple[float, float], fates: Fates, nearest: float, checked: bool
) -> None:
    """Take a bundle through a bare sphere, with one division for intersection and refraction."""
    n_i, n_t = indices
    rim, mount, beyond = fates
    c, vertex_z, limit = surface.curvature, surface.vertex_z, surface.semi_diameter * surface.semi_diameter
    eta = n_i / n_t
    along = c * sense
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - vertex_z
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        root, cos_i, above, below = sphere_crossing(along, Ray(x, y, z, dx, dy, dz), sense)
        # From the squared cosine, so that neither square root waits for the other.
        cos2_t = fused(eta * eta, root, 1.0 - eta * eta)
        # Zero under total reflection, as the distance shares its division with the transmittance.
        cos_t = np.sqrt(select(cos2_t > 0.0, cos2_t, 0.0))
        s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
        over_all = 1.0 / (below * (s * p))
        t, over = above * (over_all * (s * p)), over_all * below
        share = select(cos2_t > 0.0, transmittance(n_i, n_t, cos_i, cos_t, s, p, over), 0.0)
        x, y, z = fused(t, dx, x), fused(t, dy, y), fused(t, dz, z)
        g = fused(-eta, cos_i, cos_t)
        bend = -along * g
        ux, uy, uz = fused(eta, dx, bend * x), fused(eta, dy, bend * y), fused(eta, dz, fused(bend, z, g * sense))
        meets, r2 = both(root > 0.0, t > nearest), x * x + y * y
        holds = both(t <= bundle[AGAIN + i], c * z < 1.0)
        fate = select(r2 <= limit, select(both(checked, not holds), DROPPED, 0.0), mount)
        fate = select(both(meets, r2 <= rim * rim), fate, beyond)
        go_on(bundle, i, meets, Ray(x, y, z + vertex_z, ux, uy, uz), fate, share, 0.0)


@kernel
def _meet_conic(bundle: Array, c: float, k: float, vertex_z: float, sense: float) -> None:
    """Find the intersections with a conic; distance −1 if missed or on its other sheet."""
    q = 1.0 + k
    for i in range(BLOCK):
        x, y, z = bundle[X + i], bundle[Y + i], bundle[Z + i] - vertex_z
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        meets, t = conic_distance(c, q, Ray(x, y, z, dx, dy, dz), sense)
        x, y, z = x + t * dx, y + t * dy, z + t * dz
        bundle[T + i] = select(both(meets, c * q * z < 1.0), t, -1.0)
        bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i] = x, y, z + vertex_z
        bundle[NX + i], bundle[NY + i], bundle[NZ + i] = conic_normal(c, q, x, y, z, sense)


@kernel
def _meet_asphere(bundle: Array, surface: Any, sense: float) -> None:
    """Refine the distances to an asphere by Newton's method, for all rays while any moves.

    If that does not settle, or there was no conic to start from, a bracketed search decides for each ray.
    """
    moving = BLOCK
    for _ in range(NEWTON_STEPS):
        if moving == 0:
            break
        _add_terms(bundle, surface.terms, surface.asphere)
        moving = _newton_step(bundle, surface.curvature, surface.conic, surface.vertex_z)
    if moving > 0:
        for i in range(BLOCK):
            if bundle[ENDED_ON + i] == 0.0 and not bundle[_SETTLED + i] > 0.0:
                meets, t = _search(bundle, i, surface, 1.0 if bundle[DZ + i] > 0.0 else -1.0)
                bundle[T + i] = t if meets else -1.0
    _add_terms(bundle, surface.terms, surface.asphere)
    _set_points(bundle, surface.curvature, surface.conic, sense)


@kernel
def _meet_by_form(bundle: Array, surface: Any, sense: float) -> None:
    """Intersect rays one by one with a surface of odd terms or without rotational symmetry."""
    for i in range(BLOCK):
        bundle[T + i] = -1.0
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        if bundle[ENDED_ON + i] != 0.0 or dz == 0.0:
            continue
        meets, t = _search(bundle, i, surface, sense)
        if meets:
            x, y = bundle[X + i] + t * dx, bundle[Y + i] + t * dy
            _, gx, gy = form_at(surface, x, y)
            scale = sense / np.sqrt(gx * gx + gy * gy + 1.0)
            bundle[T + i] = t
            bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i] = x, y, bundle[Z + i] + t * dz
            bundle[NX + i], bundle[NY + i], bundle[NZ + i] = -gx * scale, -gy * scale, scale


@kernel
def _search(bundle: Array, i: int, surface: Any, sense: float) -> tuple[bool, float]:
    """Return whether a ray crosses a surface anywhere, and the distance.

    Within the reach of the mesh it steps without missing a crossing. Beyond, a bracketed search starts from the ray's
    intersection with the vertex plane.
    """
    dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
    at = -(bundle[Z + i] - surface.vertex_z) / dz
    # Measured from there, as a far start loses digits.
    x, y = bundle[X + i] + at * dx, bundle[Y + i] + at * dy
    meets, t = first_crossing(surface, Ray(x, y, 0.0, dx, dy, dz), sense, -at, np.inf, False)
    if not meets:
        meets, t = distance_to(surface, Ray(x, y, 0.0, dx, dy, dz), sense)
    return meets, at + t


@kernel
def _add_terms(bundle: Array, terms: int, asphere: Array) -> None:
    """Find r², and sag and half slope dz/d(r²) of an asphere's terms, by Horner's scheme."""
    for i in range(BLOCK):
        t = bundle[T + i]
        x, y = bundle[X + i] + t * bundle[DX + i], bundle[Y + i] + t * bundle[DY + i]
        bundle[_R2 + i] = x * x + y * y
        bundle[_SAG + i], bundle[_SLOPE + i] = 0.0, 0.0
    for m in range(terms - 1, -1, -1):
        _add_term(bundle, asphere[m], (m + 2.0) * asphere[m])


@kernel
def _add_term(bundle: Array, sag: float, slope: float) -> None:
    for i in range(BLOCK):
        r2 = bundle[_R2 + i]
        bundle[_SAG + i] = bundle[_SAG + i] * r2 + sag
        bundle[_SLOPE + i] = bundle[_SLOPE + i] * r2 + slope


@kernel
def _newton_step(bundle: Array, c: float, k: float, vertex_z: float) -> int:
    """Take one step towards the asphere; return the number of moving rays."""
    q = (1.0 + k) * c * c
    moving = 0
    for i in range(BLOCK):
        t, r2 = bundle[T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] - vertex_z + t * dz
        steep = np.sqrt(1.0 - q * r2)
        sag = c * r2 / (1.0 + steep) + r2 * r2 * bundle[_SAG + i]
        half_slope = 0.5 * c / steep + r2 * bundle[_SLOPE + i]
        step = (z - sag) / (dz - 2.0 * half_slope * (x * dx + y * dy))
        size = abs(x) + abs(y) + abs(z) + abs(t)
        settled = abs(step) <= SETTLED * size
        bundle[_SETTLED + i] = select(settled, 1.0, 0.0)
        bundle[T + i] = t - step
        moving += 0 if settled or bundle[ENDED_ON + i] != 0.0 else 1
    return moving


@kernel
def _set_points(bundle: Array, c: float, k: float, sense: float) -> None:
    """Set points and normals on an asphere at the distances."""
    q = (1.0 + k) * c * c
    for i in range(BLOCK):
        t, r2 = bundle[T + i], bundle[_R2 + i]
        dx, dy, dz = bundle[DX + i], bundle[DY + i], bundle[DZ + i]
        x, y, z = bundle[X + i] + t * dx, bundle[Y + i] + t * dy, bundle[Z + i] + t * dz
        slope = c / np.sqrt(1.0 - q * r2) + 2.0 * r2 * bundle[_SLOPE + i]
        scale = sense / np.sqrt(slope * slope * r2 + 1.0)
        bundle[AT_X + i], bundle[AT_Y + i], bundle[AT_Z + i] = x, y, z
        bundle[NX + i], bundle[NY + i], bundle[NZ + i] = -slope * x * scale, -slope * y * scale, scale
