"""Ground glass: an interface of GGX microfacets, each smooth, with Fresnel reflection and refraction.

Single events at facets follow Walter et al. (EGSR 2007). Light between facets is followed by the random walk of Heitz,
Hanika, d'Eon & Dachsbacher (SIGGRAPH 2016) with Smith's model, so no light is lost: each facet is independent of the
last one, and a height matters only through the share of the surface below it. A refracted ray walks on below the
surface, as above the same surface turned over.

All in the local frame of the surface: +z is the mean normal on the side of the arriving light.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.fresnel import fresnel
from lfmesh.optics.microfacets import facet_density, projected_area, smith_lambda, visible_normal
from lfmesh.transport.packets.random import uniform

Direction = tuple[float, float, float]

MOST_FACETS = 512
"""Facets after which a walk is broken off; about three are usual."""

LOWEST = 2.0**-53
"""Smallest share of the surface below a ray, so that a ray in the deepest valley can leave."""

NUMBERS = 4
"""Random numbers per facet: height, normal (two), and whether it reflects."""


@kernel
def ground_direction(
    alpha: float, n_i: float, n_t: float, arriving: Direction, u: float, v: float, key: np.uint64
) -> tuple[bool, float, float, float]:
    """Return whether light passes a ground interface, and its new unit direction.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    n_i, n_t : float
        Refractive indices on the side of the light and on the other.
    arriving : (3,) float
        Unit direction of the light, z < 0.
    u, v : float
        Uniform in [0, 1), for the normal of the first facet.
    key : uint64
        For the other random numbers.
    """
    x, y, z = arriving
    below, refracts = 1.0, False
    for facet in range(MOST_FACETS):
        height = uniform(key, NUMBERS * facet)
        leaves, below = _next_height(alpha, below, x, y, z, height)
        if leaves:
            break
        if facet > 0:
            u, v = uniform(key, NUMBERS * facet + 1), uniform(key, NUMBERS * facet + 2)
        normal = visible_normal(alpha, -x, -y, -z, u, v)
        x, y, z, passes = _at_facet(n_i, n_t, (x, y, z), normal, uniform(key, NUMBERS * facet + 3))
        if passes:
            # To the other side, which is the upper one from now on.
            refracts, n_i, n_t, z, below = not refracts, n_t, n_i, -z, max(1.0 - below, LOWEST)
    z = abs(z)
    return refracts, x, y, -z if refracts else z


@kernel
def ground_density(
    alpha: float, n_i: float, n_t: float, arriving: Direction, leaving: Direction, key: np.uint64
) -> float:
    """Return an unbiased random estimate of the density, 1/sr, of a direction in `ground_direction`.

    Sums, over the facets of a random walk, the light sent straight out in that direction.

    Parameters
    ----------
    alpha, n_i, n_t, arriving
        As for `ground_direction`.
    leaving : (3,) float
        Unit direction of leaving light, below the surface if z < 0.
    key : uint64
    """
    x, y, z = arriving
    below, refracts, found = 1.0, False, 0.0
    for facet in range(MOST_FACETS):
        leaves, below = _next_height(alpha, below, x, y, z, uniform(key, NUMBERS * facet))
        if leaves:
            break
        # The requested direction, in the frame of the ray's present side.
        asked = leaving[0], leaving[1], -leaving[2] if refracts else leaving[2]
        found += _straight(alpha, n_i, n_t, (-x, -y, -z), asked, below)
        u, v = uniform(key, NUMBERS * facet + 1), uniform(key, NUMBERS * facet + 2)
        normal = visible_normal(alpha, -x, -y, -z, u, v)
        x, y, z, passes = _at_facet(n_i, n_t, (x, y, z), normal, uniform(key, NUMBERS * facet + 3))
        if passes:
            refracts, n_i, n_t, z, below = not refracts, n_t, n_i, -z, max(1.0 - below, LOWEST)
    return found


@inlined
def _next_height(alpha: float, below: float, x: float, y: float, z: float, u: float) -> tuple[bool, float]:
    """Return whether a ray leaves the surface and, if not, the share of the surface below the next facet.

    Parameters
    ----------
    below : float
        Share of the surface below the ray's start.
    u : float
        Random number.
    """
    slant = smith_lambda(alpha, x, y, z)
    if z > 0.0 and (slant == 0.0 or u < below**slant):
        return True, below
    # Both upwards (Λ > 0) and downwards (Λ < 0); 1 − u is above 0.
    return False, min(below * (u if z > 0.0 else 1.0 - u) ** (-1.0 / slant), 1.0)


@inlined
def _at_facet(
    n_i: float, n_t: float, direction: Direction, normal: Direction, choice: float
) -> tuple[float, float, float, bool]:
    """Reflect or refract a direction at a facet, with Fresnel probabilities; tell whether it was refracted."""
    (x, y, z), (mx, my, mz) = direction, normal
    facing = min(-(x * mx + y * my + z * mz), 1.0)
    reflectance, _, cos_t = fresnel(n_i, n_t, max(facing, 0.0))
    if choice < reflectance:
        a, b = 1.0, 2.0 * facing
    else:
        a = n_i / n_t
        b = a * facing - cos_t
    x, y, z = a * x + b * mx, a * y + b * my, a * z + b * mz
    scale = 1.0 / np.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale, choice >= reflectance


@inlined
def _straight(alpha: float, n_i: float, n_t: float, source: Direction, leaving: Direction, below: float) -> float:
    """Return the density, 1/sr, of light from a facet in a direction, times its chance of getting out.

    `source` points back to the origin of the light. Walter et al. 2007, eq. 13-17, with visible normals.
    """
    (ix, iy, iz), (ox, oy, oz) = source, leaving
    if oz > 0.0:
        hx, hy, hz = ix + ox, iy + oy, iz + oz
    else:
        hx, hy, hz = n_i * ix + n_t * ox, n_i * iy + n_t * oy, n_i * iz + n_t * oz
    length2 = hx * hx + hy * hy + hz * hz
    if length2 == 0.0 or hz == 0.0:
        return 0.0
    scale = (1.0 if hz > 0.0 else -1.0) / np.sqrt(length2)
    hx, hy, hz = hx * scale, hy * scale, hz * scale
    facing, away = ix * hx + iy * hy + iz * hz, ox * hx + oy * hy + oz * hz
    if facing <= 0.0 or (away > 0.0) != (oz > 0.0):
        return 0.0
    reflectance, transmittance, _ = fresnel(n_i, n_t, min(facing, 1.0))
    per_normal = facet_density(alpha, hx, hy, hz) / projected_area(alpha, ix, iy, iz)
    if oz > 0.0:
        return reflectance * per_normal * 0.25 * below ** smith_lambda(alpha, ox, oy, oz)
    per_normal *= facing * n_t * n_t * -away / length2
    return transmittance * per_normal * max(1.0 - below, LOWEST) ** smith_lambda(alpha, ox, oy, -oz)
