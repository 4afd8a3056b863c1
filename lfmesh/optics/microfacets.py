"""GGX microfacets: normals, Smith masking and shadowing, and sampling of the visible normals.

Vectors are in the local frame of the surface with the mean normal +z and point away from the surface. `alpha` is
Walter's α_g (Walter, Marschner, Li & Torrance, EGSR 2007), above 0. Directions may point below the mean surface
(z < 0), as between two facets; facet normals have z > 0.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined


@inlined
def facet_density(alpha: float, mx: float, my: float, mz: float) -> float:
    """Return D(m), 1/sr: area of the facets with normal m, per area of the mean surface (Walter et al. 2007, eq. 33).

    D m_z integrates to one over the hemisphere.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    mx, my, mz : float
        Unit normal of a facet.
    """
    if mz <= 0.0:
        return 0.0
    a2 = alpha * alpha
    # cos⁴ θ (α² + tan² θ)², without the cancellation of 1 − cos² on almost smooth surfaces.
    spread = mx * mx + my * my + a2 * mz * mz
    return a2 / (np.pi * spread * spread)


@inlined
def stretched_length(alpha: float, x: float, y: float, z: float) -> float:
    """Return the length of a direction in the stretched space that turns the facets into a hemisphere.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    x, y, z : float
        Unit direction.
    """
    return np.sqrt(alpha * alpha * (x * x + y * y) + z * z)


@inlined
def projected_area(alpha: float, x: float, y: float, z: float) -> float:
    """Return σ(ω): projected area of the facets that face a direction, per area of the mean surface.

    Masking by other facets is ignored (Heitz et al., SIGGRAPH 2016).

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    x, y, z : float
        Unit direction.
    """
    length = stretched_length(alpha, x, y, z)
    if z >= 0.0:
        return 0.5 * (length + z)
    # Below the surface the two terms nearly cancel: use the difference of their squares.
    return 0.5 * alpha * alpha * (x * x + y * y) / (length - z)


@inlined
def smith_lambda(alpha: float, x: float, y: float, z: float) -> float:
    """Return Smith's Λ of a direction: infinite along the surface, 0 along +z, −1 along −z.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    x, y, z : float
        Unit direction.
    """
    length = stretched_length(alpha, x, y, z)
    if z >= 0.0:
        return 0.5 * alpha * alpha * (x * x + y * y) / (z * (length + z))
    return 0.5 * (length / z - 1.0)


@inlined
def smith_g2(alpha: float, ix: float, iy: float, iz: float, ox: float, oy: float, oz: float) -> float:
    """Return Smith's G₂ of two directions above the surface: fraction of the facets visible from both.

    Facets visible from one direction lie high, hence are more likely visible from the other (Heitz 2014).

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    ix, iy, iz, ox, oy, oz : float
        Unit directions; the result is 0 if one is below the surface.
    """
    if iz <= 0.0 or oz <= 0.0:
        return 0.0
    length_i, length_o = stretched_length(alpha, ix, iy, iz), stretched_length(alpha, ox, oy, oz)
    return 2.0 * iz * oz / (oz * length_i + iz * length_o)


@inlined
def visible_normal(
    alpha: float, x: float, y: float, z: float, u: float, v: float
) -> tuple[float, float, float]:  # fmt: skip
    """Sample a facet normal in proportion to its projected area from a direction (Heitz, JCGT 7(4), 2018).

    Uses the spherical cap that mirrors the stretched direction (Dupuy & Benyoub 2023), even below the surface.

    Parameters
    ----------
    alpha : float
        Roughness α_g.
    x, y, z : float
        Unit viewing direction, other than −z.
    u, v : float
        Uniform in [0, 1).
    """
    over = 1.0 / stretched_length(alpha, x, y, z)
    sx, sy, sz = alpha * x * over, alpha * y * over, z * over
    # Height in the cap above its rim at −sz; its largest value 1 + sz is imprecise near sz = −1.
    mz = (1.0 - v) * 2.0 * projected_area(alpha, x, y, z) * over
    height = mz - sz
    radius, phi = np.sqrt(max(0.0, (1.0 - height) * (1.0 + height))), 2.0 * np.pi * u
    mx, my = alpha * (radius * np.cos(phi) + sx), alpha * (radius * np.sin(phi) + sy)
    over = 1.0 / np.sqrt(mx * mx + my * my + mz * mz)
    return mx * over, my * over, mz * over
