"""Hemispherical reflectance of an interface for diffuse light, by Walsh's closed form of the Fresnel integral.

A diffuse `finish` reflects this fraction of the light and transmits the rest.
"""

from decimal import Decimal, localcontext

DIGITS = 120
"""Decimal digits. Near equal indices the formula's terms grow as 1 / (n − 1) while their sum vanishes as n − 1, so
float64 would keep few digits. Evaluated once per face and wavelength, it need not be fast."""


def diffuse_reflectance(n_i: float, n_t: float) -> float:
    """Return the fraction of diffuse light that an interface reflects; the paper's equation 4.

    Walsh (1926), as in Duntley, J. Opt. Soc. Am. 32, 61 (1942). From the dense side it is 1 − (1 − ρ) / n², because
    both sides exchange equal basic radiance.

    Parameters
    ----------
    n_i, n_t : float
        Indices on the incident side and on the other side.

    Returns
    -------
    float
        ∫ 2 cos θ R(θ) d(cos θ) from 0 to 1; 0 between equal indices.
    """
    if n_i == n_t:
        return 0.0
    with localcontext() as context:
        context.prec = DIGITS
        thin, dense = sorted((Decimal(n_i), Decimal(n_t)))
        n = dense / thin
        share = _thin_to_dense(n)
        return float(share if n_i < n_t else 1 - (1 - share) / n**2)


def _thin_to_dense(n: Decimal) -> Decimal:
    n2, n4 = n**2, n**4
    return (
        Decimal("0.5")
        + (3 * n + 1) * (n - 1) / (6 * (n + 1) ** 2)
        + n2 * (n2 - 1) ** 2 / (n2 + 1) ** 3 * ((n - 1) / (n + 1)).ln()
        - 2 * n**3 * (n2 + 2 * n - 1) / ((n2 + 1) * (n4 - 1))
        + 8 * n4 * (n4 + 1) / ((n2 + 1) * (n4 - 1) ** 2) * n.ln()
    )
