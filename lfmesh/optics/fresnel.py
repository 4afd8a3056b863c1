"""Fresnel's equations for unpolarised light at a smooth dielectric interface, in flux.

R and T are fractions of the incident power (T includes the n cos ratio, no n² factor), each from its amplitudes: T as
1 − R would lose digits at grazing incidence, and the usual sin/tan quotients are 0/0 at normal incidence. See Born &
Wolf, Principles of Optics, 1.5.2.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined, pasted
from lfmesh.kernels.vector import fused


@pasted
def amplitude_sums(n_i: float, n_t: float, cos_i: float, cos_t: float) -> tuple[float, float]:
    """Return the denominators of the amplitude coefficients of s- and p-polarised light.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    cos_i, cos_t : float
        Cosines of incidence and refraction.
    """
    return fused(n_t, cos_t, n_i * cos_i), fused(n_i, cos_t, n_t * cos_i)


@pasted
def transmittance(n_i: float, n_t: float, cos_i: float, cos_t: float, s: float, p: float, over: float) -> float:
    """Return the transmitted fraction of the power; meaningless under total reflection.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    cos_i, cos_t : float
        Cosines of incidence and refraction.
    s, p : float
        Denominators from `amplitude_sums`.
    over : float
        1 / (s p), which the caller may combine with another division.
    """
    return 2.0 * n_i * n_t * (cos_i * cos_t) * fused(s, s, p * p) * (over * over)


@pasted
def refraction(n_i: float, n_t: float, cos_i: float) -> tuple[bool, float]:
    """Return whether reflection is total, and the cosine of refraction, 0 if it is.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    cos_i : float
        Cosine of incidence, 0 to 1.
    """
    # Matched indices are tested first: at grazing incidence sin² rounds to 1, which would mean total reflection.
    matched = n_i == n_t
    eta = n_i / n_t
    sin2_t = eta * eta * (1.0 - cos_i) * (1.0 + cos_i)
    cos_t = np.sqrt(0.0 if sin2_t >= 1.0 else 1.0 - sin2_t)
    return sin2_t >= 1.0 and not matched, cos_i if matched else cos_t


@inlined
def fresnel(n_i: float, n_t: float, cos_i: float) -> tuple[float, float, float]:
    """Return reflectance, transmittance and the cosine of refraction.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    cos_i : float
        Cosine of incidence, 0 to 1.

    Returns
    -------
    R, T, cos_t : float
        1, 0, 0 under total reflection. Matched indices reflect nothing, even at grazing incidence.
    """
    # Without branches, so that loops over packets are vectorised.
    matched = n_i == n_t
    total, cos_t = refraction(n_i, n_t, cos_i)
    s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
    over = 1.0 / (s * p)
    r_s, r_p = (n_i * cos_i - n_t * cos_t) * (p * over), (n_t * cos_i - n_i * cos_t) * (s * over)
    R = 0.5 * (r_s * r_s + r_p * r_p)
    T = transmittance(n_i, n_t, cos_i, cos_t, s, p, over)
    R = 0.0 if matched else (1.0 if total else R)
    T = 1.0 if matched else (0.0 if total else T)
    return R, T, cos_t
