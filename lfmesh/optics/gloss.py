"""Gloss: GGX facets of a dielectric or a metal over a Lambertian base.

The BRDF is the sum of three parts, each symmetric in its two directions:

- light reflected once: F D G₂ / (4 cos cos) (Walter et al. 2007);
- light reflected by several facets: F_ms (1 − E₁)(1 − E₁') / (π (1 − Ē₁)), with E₁ the directional albedo of perfectly
  reflecting facets, and F_ms = F̄² Ē₁ / (1 − F̄ (1 − Ē₁)) (Kulla & Conty, SIGGRAPH 2017 courses);
- light returned by the base: ρ (1 − E)(1 − E') / (π (1 − Ē)), with E the directional albedo of the other two parts
  (Kelemen & Szirmay-Kalos, Eurographics 2001). ρ is the reflectance of the base as seen through the layer, including
  light that the layer throws back on the way out. Metal has no base.

A layer without absorption over a base of ρ = 1 thus scatters all light, as does perfectly reflecting metal. 1 − E and
1 − E₁ are tabulated and lowered by `MARGIN`, more than the tables' error, so that no light is gained.

Kernels use the surface's local frame with the normal +z; unit vectors point away from it.
"""

from collections.abc import Callable
from functools import cache, lru_cache, partial
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.optics.microfacets import facet_density, projected_area, smith_g2, visible_normal
from lfmesh.optics.quadrature import gauss_legendre

Array = NDArray[np.float64]
Direction = tuple[float, float, float]

NODES = 256
"""Number of intervals of the tables, in the square root of the cosine."""

MARGIN = 2e-4
"""Reduction of the tables of 1 − E; their own error is below 1e-4 at a roughness of 0.01, and less above."""

ORDERS = 32
"""Number of Chebyshev polynomials of the cosine at a facet in the expansion of Fresnel's reflectance."""

ACROSS, ROUND = 48, 32
"""Quadrature points over the visible facets, in each part."""

# Rows of a model's parameters.
BASE, ALPHA, INDEX, EXTINCTION, SEVERAL, BASE_NORM, SEVERAL_NORM, TABLES = 0, 1, 2, 3, 4, 5, 6, 7
ROWS = TABLES + 2 * (NODES + 1)

KEPT_ROUGHNESSES, KEPT_LAYERS = 256, 4096
"""Number of roughnesses and layers with cached tables: 17 MB and 8 MB at most."""

LEAST_CHANCE = 0.05
"""Minimum probability of each of the two ways of sampling a direction."""


def gloss_parameters(reflectance: Array, index: NDArray[np.complex128], roughness: float) -> Array:
    """Return the parameters of a glossy target for the kernels, (ROWS, wavelengths).

    Parameters
    ----------
    reflectance : (wavelengths,) float64
        Reflectance of the base; ignored for metals.
    index : (wavelengths,) complex128
        n + ik of the facets; a metal if k > 0.
    roughness : float
        α_g.
    """
    rows = np.zeros((ROWS, len(index)))
    not_one, loss = _lost_by_facets(roughness)
    for column, n in enumerate(index):
        several, through, mean_through = _layer(complex(n), roughness)
        rows[BASE, column] = reflectance[column] if n.imag == 0.0 else 0.0
        rows[ALPHA, column], rows[INDEX, column], rows[EXTINCTION, column] = roughness, n.real, n.imag
        rows[SEVERAL, column] = several
        rows[SEVERAL_NORM, column] = several / (np.pi * loss) if loss > 0.0 else 0.0
        rows[BASE_NORM, column] = rows[BASE, column] / (np.pi * mean_through) if through.any() else 0.0
        rows[TABLES : TABLES + NODES + 1, column] = not_one
        rows[TABLES + NODES + 1 :, column] = through
    return rows


@lru_cache(maxsize=KEPT_ROUGHNESSES)
def _lost_by_facets(alpha: float) -> tuple[Array, float]:
    """Return the loss 1 − E₁ of single reflections at perfect facets, (NODES + 1,), and its mean."""
    not_one = np.maximum(1.0 - facet_moments(alpha)[0] - MARGIN, 0.0)
    not_one.setflags(write=False)
    return not_one, _table_mean(not_one)


@lru_cache(maxsize=KEPT_LAYERS)
def _layer(n: complex, alpha: float) -> tuple[float, Array, float]:
    """Return the quantities that depend on the facets alone, not on the base.

    Parameters
    ----------
    n : complex
        Index of the facets.
    alpha : float
        Roughness α_g.

    Returns
    -------
    several : float
        Factor F_ms of the light reflected by several facets.
    through : (NODES + 1,) float64
        1 − E.
    mean_through : float
        Mean of `through`.
    """
    not_one, loss = _lost_by_facets(alpha)
    mean = _mean(partial(interface_reflectance, n.real, n.imag))
    several = mean * mean * (1.0 - loss) / (1.0 - mean * loss)
    through = np.maximum(1.0 - _expanded(n) @ facet_moments(alpha) - several * not_one - MARGIN, 0.0)
    through.setflags(write=False)
    return several, through, _table_mean(through)


def _expanded(n: complex) -> Array:
    """Return Fresnel's reflectance as Chebyshev polynomials of 2c − 1, (ORDERS,)."""
    x, to_polynomials = _interpolation()
    return np.asarray(to_polynomials @ interface_reflectance(n.real, n.imag, 0.5 * (x + 1.0)), dtype=np.float64)


@cache
def _interpolation() -> tuple[Array, Array]:
    """Return the Chebyshev nodes, (ORDERS,), and the matrix from values there to Chebyshev polynomials.

    By discrete orthogonality (J. C. Mason and D. C. Handscomb, Chebyshev Polynomials, 2003, section 4.6).
    """
    x = np.cos(np.pi * (np.arange(ORDERS) + 0.5) / ORDERS)
    matrix = np.asarray(chebyshev.chebvander(x, ORDERS - 1).T * (2.0 / ORDERS), dtype=np.float64)
    matrix[0] *= 0.5
    return x, matrix


def _mean(of_cosine: Callable[[Array], Array]) -> float:
    """Return the cosine-weighted mean over the hemisphere of a function of the cosine."""
    x, w = gauss_legendre(64)
    c = 0.5 * (x + 1.0)
    return float((w * c * of_cosine(c)).sum())


def _table_mean(table: Array) -> float:
    """Return the same mean of a table, linear in the root of the cosine, by exact quadrature per interval."""
    x, w = gauss_legendre(4)
    t = (np.arange(NODES)[:, None] + 0.5 * (x + 1.0)) / NODES
    share = 0.5 * (x + 1.0)
    values = table[:-1, None] * (1.0 - share) + table[1:, None] * share
    return float((values * 4.0 * t**3 * w).sum() * 0.5 / NODES)


def interface_reflectance(n: Array | float, k: Array | float, cosine: Array) -> Array:
    """Return Fresnel's reflectance from air for unpolarised light, at a medium of index n + ik.

    Parameters
    ----------
    n, k : float
        Index and extinction coefficient.
    cosine : float64, any shape
        Cosine of incidence.
    """
    return np.asarray(_reflectance(n, k, np.asarray(cosine, dtype=np.float64)))


def _reflectance(n: Any, k: Any, c: Any) -> Any:
    """Return Fresnel's reflectance (Born & Wolf, 14.2), of numbers in kernels and arrays outside."""
    s2 = 1.0 - c * c
    t = n * n - k * k - s2
    both = np.sqrt(t * t + 4.0 * n * n * k * k)
    root = np.sqrt(0.5 * np.maximum(both + t, 0.0))
    square = both + c * c
    s = (square - 2.0 * root * c) / (square + 2.0 * root * c)
    square = both * c * c + s2 * s2
    return 0.5 * s * (1.0 + (square - 2.0 * root * c * s2) / (square + 2.0 * root * c * s2))


facet_reflectance = inlined(_reflectance)
"""Return Fresnel's reflectance from air at a facet: index n, extinction k, cosine of incidence."""


@lru_cache(maxsize=KEPT_ROUGHNESSES)
def facet_moments(alpha: float) -> Array:
    """Return the directional albedos of facets that reflect as Chebyshev polynomials, (ORDERS, NODES + 1).

    The k-th reflects T_k(2c − 1) at the facet cosine c; the first is E₁. They are the means of T_k G₂ / G₁ over the
    visible facets, sampled as in `microfacets.visible_normal`. Facets that reflect below the surface are cut off along
    their edge, which leaves smooth integrands.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    """
    mu = np.maximum(np.linspace(0.0, 1.0, NODES + 1) ** 2, 1e-12)
    moments = np.zeros((ORDERS, NODES + 1))
    none = _edge(alpha, mu, 1.0)
    all_round = np.minimum(_edge(alpha, mu, -1.0), none)
    for first in range(0, NODES + 1, 32):
        some = slice(first, first + 32)
        moments[:, some] = _part(alpha, mu[some], np.zeros_like(none[some]), all_round[some], False)
        moments[:, some] += _part(alpha, mu[some], all_round[some], none[some], True)
    moments.setflags(write=False)
    return moments


def _reflected(
    alpha: float, mu: Array, cos_phi: Array | float, sin_phi: Array | float, v: Array
) -> tuple[Array, Array]:
    """Return the cosines at a visible facet and of the direction that it reflects into, from its sampling numbers.

    Parameters
    ----------
    mu : float64
        Cosine of the viewing direction.
    cos_phi, sin_phi, v : float64
        As in `visible_normal`.
    """
    sine = np.sqrt(1.0 - mu * mu)
    length = np.hypot(alpha * sine, mu)
    sx, top = alpha * sine / length, 1.0 + mu / length
    radius = np.sqrt(np.maximum(0.0, v * top * (2.0 - v * top)))
    x, y, z = alpha * (radius * cos_phi + sx), alpha * radius * sin_phi, (1.0 - v) * top
    over = 1.0 / np.maximum(np.sqrt(x * x + y * y + z * z), 1e-150)
    cosine = (sine * x + mu * z) * over
    return cosine, 2.0 * cosine * z * over - mu


def _edge(alpha: float, mu: Array, cos_phi: float) -> Array:
    """Return the largest v of a facet, at one azimuth, that reflects above the surface, by bisection."""
    low, high = np.zeros_like(mu), np.ones_like(mu)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = _reflected(alpha, mu, cos_phi, 0.0, middle)[1] > 0.0
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return low


def _edge_azimuth(alpha: float, mu: Array, v: Array) -> Array:
    """Return the largest azimuth of a facet that reflects above the surface; the condition is linear in its cosine."""
    sine = np.sqrt(1.0 - mu * mu)
    length = np.hypot(alpha * sine, mu)
    sx, top = alpha * sine / length, 1.0 + mu / length
    radius2, z = np.maximum(0.0, v * top * (2.0 - v * top)), (1.0 - v) * top
    slope = 2.0 * alpha * np.sqrt(radius2) * (sine * z - mu * alpha * sx)
    rest = mu * (alpha * alpha * (radius2 + sx * sx) + z * z) - 2.0 * (sine * alpha * sx + mu * z) * z
    return np.arccos(np.clip(rest / np.where(slope == 0.0, 1e-300, slope), -1.0, 1.0))


def _part(alpha: float, mu: Array, low: Array, high: Array, cut: bool) -> Array:
    """Return the integrals over v from `low` to `high` and over azimuth, up to the edge if `cut`."""
    x, w = gauss_legendre(ACROSS)
    p = 0.5 * (x + 1.0)
    # Points cluster at both ends, at the square roots and the shadow near the horizon.
    place, weight = p**3 * (10.0 - 15.0 * p + 6.0 * p * p), 15.0 * (p * (1.0 - p)) ** 2 * w
    mu, low, high = mu[:, None], low[:, None], high[:, None]
    v, v_weight = low + (high - low) * place, (high - low) * weight
    limit = _edge_azimuth(alpha, mu, v) if cut else np.full_like(v, np.pi)
    x, w = gauss_legendre(ROUND)
    p = 0.5 * (x + 1.0)
    phi = limit[..., None] * (1.0 - (1.0 - p) ** 3)
    phi_weight = limit[..., None] * (1.5 * (1.0 - p) ** 2 * w / np.pi)
    mu = mu[..., None]
    cosine, out = _reflected(alpha, mu, np.cos(phi), np.sin(phi), v[..., None])
    out = np.maximum(out, 0.0)
    seen_from = np.sqrt(alpha * alpha * (1.0 - mu * mu) + mu * mu)
    seen_out = np.sqrt(alpha * alpha * (1.0 - out * out) + out * out)
    share = out * (seen_from + mu) / (out * seen_from + mu * seen_out) * phi_weight * v_weight[..., None]
    x2 = 2.0 * (2.0 * np.clip(cosine, 0.0, 1.0) - 1.0)
    before, now = np.ones_like(x2), 0.5 * x2
    moments = np.empty((ORDERS, len(mu)))
    for order in range(ORDERS):
        moments[order] = np.einsum("ijk,ijk->i", before, share)
        before, now = now, x2 * now - before
    return moments


@inlined
def table_at(parameters: Array, first: int, colour: int, cosine: float) -> float:
    """Return the value of a table that is linear in the root of the cosine.

    Parameters
    ----------
    parameters : (rows, wavelengths) float64
    first : int
        Row of the table's first value.
    colour : int
        Wavelength index.
    cosine : float
    """
    t = np.sqrt(min(max(cosine, 0.0), 1.0)) * NODES
    i = min(int(t), NODES - 1)
    return (i + 1.0 - t) * parameters[first + i, colour] + (t - i) * parameters[first + i + 1, colour]


def mean_albedos(parameters: Array) -> tuple[Array, Array]:
    """Return the hemispherical means of the albedos in `gloss_albedos`, each (wavelengths,).

    Parameters
    ----------
    parameters : (ROWS, wavelengths) float64

    Returns
    -------
    facets, base : (wavelengths,) float64
        Albedo of the facets, and that added by the base if its texel is 1.
    """
    columns = parameters.T
    facets, base = np.zeros(len(columns)), np.zeros(len(columns))
    for column, own in enumerate(columns):
        several, through = own[SEVERAL] * own[TABLES : TABLES + NODES + 1], own[TABLES + NODES + 1 :]
        facets[column] = _table_mean(np.maximum(0.0, 1.0 - MARGIN - through - several) + several)
        base[column] = own[BASE] * _table_mean(through)
    return facets, base


@inlined
def gloss_albedos(
    parameters: Array, first: int, colour: int, texel: float, cosine: float
) -> tuple[float, float]:  # fmt: skip
    """Return the albedos of single facets and of the other two parts together.

    Parameters
    ----------
    parameters : (rows, wavelengths) float64
    first : int
        Row of the model's first parameter.
    colour : int
        Wavelength index.
    texel : float
        Factor on the base's reflectance.
    cosine : float
    """
    several = parameters[first + SEVERAL, colour] * table_at(parameters, first + TABLES, colour, cosine)
    through = table_at(parameters, first + TABLES + NODES + 1, colour, cosine)
    once = max(0.0, 1.0 - MARGIN - through - several)
    return once, several + parameters[first + BASE, colour] * texel * through


@kernel
def gloss_brdf(
    parameters: Array, first: int, colour: int, texel: float, incoming: Direction, outgoing: Direction
) -> float:
    """Return the BRDF, 1/sr; 0 for a direction below the surface.

    Parameters
    ----------
    parameters, first, colour, texel
        As in `gloss_albedos`.
    incoming, outgoing : (3,) float
        Unit directions.
    """
    (ix, iy, iz), (ox, oy, oz) = incoming, outgoing
    if iz <= 0.0 or oz <= 0.0:
        return 0.0
    tables = first + TABLES
    value = (
        parameters[first + SEVERAL_NORM, colour]
        * (table_at(parameters, tables, colour, iz) * table_at(parameters, tables, colour, oz))
    )  # fmt: skip
    tables += NODES + 1
    value += (
        parameters[first + BASE_NORM, colour] * texel
        * (table_at(parameters, tables, colour, iz) * table_at(parameters, tables, colour, oz))
    )  # fmt: skip
    hx, hy, hz, cosine = _half_way(ix, iy, iz, ox, oy, oz)
    alpha = parameters[first + ALPHA, colour]
    reflectance = facet_reflectance(parameters[first + INDEX, colour], parameters[first + EXTINCTION, colour], cosine)
    facets = facet_density(alpha, hx, hy, hz) * smith_g2(alpha, ix, iy, iz, ox, oy, oz)
    return value + reflectance * facets / (4.0 * iz * oz)


@inlined
def _half_way(
    ix: float, iy: float, iz: float, ox: float, oy: float, oz: float
) -> tuple[float, float, float, float]:  # fmt: skip
    """Return the unit normal of the facet that reflects one direction into another, and its cosine with them."""
    hx, hy, hz = ix + ox, iy + oy, iz + oz
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    if length == 0.0:
        return 0.0, 0.0, 1.0, 0.0
    # |i + o| is twice the cosine of half their angle.
    return hx / length, hy / length, hz / length, min(0.5 * length, 1.0)


@inlined
def _chance_of_facet(once: float, rest: float) -> float:
    """Return the probability of sampling a direction by a facet rather than by the cosine."""
    if rest <= 0.0:
        return 1.0
    return min(max(once / (once + rest), LEAST_CHANCE), 1.0 - LEAST_CHANCE)


@kernel
def gloss_direction(
    parameters: Array, first: int, colour: int, texel: float, incoming: Direction, u: float, v: float
) -> tuple[float, float, float]:
    """Sample a direction: reflected by a visible facet, or by Lambert's law.

    Facet reflections below the surface are mirrored, so that no sample is lost.

    Parameters
    ----------
    parameters, first, colour, texel
        As in `gloss_albedos`.
    incoming : (3,) float
        Unit direction of the incident light.
    u, v : float
        Uniform in [0, 1).
    """
    ix, iy, iz = incoming
    once, rest = gloss_albedos(parameters, first, colour, texel, iz)
    chance = _chance_of_facet(once, rest)
    if u < chance:
        hx, hy, hz = visible_normal(parameters[first + ALPHA, colour], ix, iy, iz, u / chance, v)
        twice = 2.0 * (ix * hx + iy * hy + iz * hz)
        ox, oy, oz = twice * hx - ix, twice * hy - iy, abs(twice * hz - iz)
        over = 1.0 / np.sqrt(ox * ox + oy * oy + oz * oz)
        return ox * over, oy * over, oz * over
    u = min((u - chance) / (1.0 - chance), 1.0)
    radius, phi = np.sqrt(u), 2.0 * np.pi * v
    return radius * np.cos(phi), radius * np.sin(phi), np.sqrt(max(0.0, 1.0 - u))


@kernel
def gloss_density(
    parameters: Array, first: int, colour: int, texel: float, incoming: Direction, outgoing: Direction
) -> float:
    """Return the probability density, 1/sr, of a direction in `gloss_direction`; 0 below the surface.

    Parameters
    ----------
    parameters, first, colour, texel
        As in `gloss_albedos`.
    incoming, outgoing : (3,) float
        Unit directions.
    """
    (ix, iy, iz), (ox, oy, oz) = incoming, outgoing
    if oz <= 0.0:
        return 0.0
    once, rest = gloss_albedos(parameters, first, colour, texel, iz)
    chance = _chance_of_facet(once, rest)
    alpha = parameters[first + ALPHA, colour]
    hx, hy, hz, _ = _half_way(ix, iy, iz, ox, oy, oz)
    facets = facet_density(alpha, hx, hy, hz)
    if oz < iz:
        hx, hy, hz, _ = _half_way(ix, iy, iz, ox, oy, -oz)
        facets += facet_density(alpha, hx, hy, hz)
    return chance * facets / (4.0 * projected_area(alpha, ix, iy, iz)) + (1.0 - chance) * oz / np.pi
