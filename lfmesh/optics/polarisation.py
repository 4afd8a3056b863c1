"""Polarised light at smooth interfaces: Stokes vectors, and the effect of bare and coated interfaces on them.

Light along the unit direction d has a perpendicular reference direction e, and f = d × e. Fields vary as exp(−iωt).
With the complex amplitudes E_e and E_f along e and f,

    I = |E_e|² + |E_f|²,  Q = |E_e|² − |E_f|²,  U = 2 Re(E_e* E_f),  V = 2 Im(E_e* E_f).

Linear polarisation at the angle ψ from e towards f has Q = I cos 2ψ and U = I sin 2ψ; the receiver sees ψ grow
counter-clockwise. If V > 0 the receiver sees the field rotate counter-clockwise: right-handed for IEEE and IAU,
left-handed for Born & Wolf.

At an interface with the normal n the reference is s = d × n, perpendicular to the plane of incidence, and p = d × s for
each of the three rays. In this basis the Mueller matrix is

    | (S+P)/2  (S−P)/2   0    0  |
    | (S−P)/2  (S+P)/2   0    0  |   with the power fractions S and P of s- and p-polarised light,
    |    0        0     Re ρ −Im ρ |   and ρ = r_s* r_p of the amplitudes, which for transmission are scaled to power.
    |    0        0     Im ρ  Re ρ |

Transmission is the same in both directions, and so is reflection from one side, so light traced backwards meets the
same matrices. The amplitudes have the signs of Born & Wolf, Principles of Optics, 1.5.2 and 1.6.2, of the package `tmm`
and of most books on ellipsometry: at normal incidence r_p = −r_s.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.optics.fresnel import amplitude_sums

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SMALL_PHASE = 1e-3
"""Phase below which sin δ / δ is taken from its series, with an error below 1e-18."""


class Polarising(NamedTuple):
    """Elements of the Mueller matrix of an interface, for reflected or for transmitted light."""

    s: float  # share of the power of s-polarised light
    p: float  # share of the power of p-polarised light
    real: float  # of ρ, the product of the conjugate s amplitude and the p amplitude
    imaginary: float


@inlined
def bare_interface(n_i: float, n_t: float, cos_i: float) -> tuple[Polarising, Polarising]:
    """Return reflection and transmission at a bare interface.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    cos_i : float
        Cosine of incidence, 0 to 1.
    """
    if n_i == n_t:
        return Polarising(0.0, 0.0, 0.0, 0.0), Polarising(1.0, 1.0, 1.0, 0.0)
    eta = n_i / n_t
    sin2_i = (1.0 - cos_i) * (1.0 + cos_i)
    sin2_t = eta * eta * sin2_i
    if sin2_t >= 1.0:
        # Half the phase of ρ has the tangent −cos θ √(sin² θ − (n_t/n_i)²) / sin² θ, see Born & Wolf, 1.5.4.
        x, y = sin2_t, -eta * cos_i * np.sqrt(sin2_t - 1.0)
        over = 1.0 / (x * x + y * y)
        return Polarising(1.0, 1.0, (x - y) * (x + y) * over, 2.0 * x * y * over), Polarising(0.0, 0.0, 0.0, 0.0)
    cos_t = np.sqrt(1.0 - sin2_t)
    s, p = amplitude_sums(n_i, n_t, cos_i, cos_t)
    r_s, r_p = (n_i * cos_i - n_t * cos_t) / s, (n_t * cos_i - n_i * cos_t) / p
    both = 4.0 * n_i * n_t * cos_i * cos_t
    return (
        Polarising(r_s * r_s, r_p * r_p, r_s * r_p, 0.0),
        Polarising(both / (s * s), both / (p * p), both / (s * p), 0.0),
    )


@inlined
def coated_interface(
    n_i: float, n_t: float, cos_i: float, indices: ComplexArray, thicknesses: Array, colour: int, first: int,
    count: int, turned: bool, wavelength_nm: float,
) -> tuple[Polarising, Polarising]:  # fmt: skip
    """Return reflection and transmission at a stack of layers, as in `optics.coatings.polarised` but with phases.

    Parameters
    ----------
    n_i, n_t, cos_i : float
        As in `bare_interface`.
    indices : (layers, wavelengths) complex128
        n + ik of layers.
    thicknesses : (layers,) float64, nm
    colour : int
        Wavelength index.
    first, count : int
        First layer of the stack, and number of layers.
    turned : bool
        Light meets the last layer first.
    wavelength_nm : float
        In air, the reference of all indices.
    """
    k_i = n_i * cos_i
    tangential2 = n_i * n_i * (1.0 - cos_i) * (1.0 + cos_i)
    sin2_t = tangential2 / (n_t * n_t)
    total = sin2_t >= 1.0 and n_i != n_t
    k_t = complex(k_i, 0.0)
    if total:
        k_t = complex(0.0, n_t * np.sqrt(sin2_t - 1.0))
    elif n_i != n_t:
        k_t = complex(n_t * np.sqrt(1.0 - sin2_t), 0.0)
    # Tangential fields at the back of the stack: 1, and the admittance of the medium behind.
    s_first, s_second = complex(1.0, 0.0), k_t
    p_first, p_second = complex(1.0, 0.0), k_t / (n_t * n_t)
    growth = 0.0
    for step in range(count):
        layer = first + (step if turned else count - 1 - step)
        index2 = indices[layer, colour] * indices[layer, colour]
        k = np.sqrt(index2 - tangential2)
        if k.imag < 0.0:
            k = -k
        path = 2.0 * np.pi / wavelength_nm * thicknesses[layer]
        phase = path * k
        along = np.exp(complex(-2.0 * phase.imag, phase.real))
        back = np.exp(complex(0.0, -phase.real))
        cosine, sine = 0.5 * (along + back), complex(0.0, -0.5) * (along - back)
        if abs(phase) < SMALL_PHASE:
            square = phase * phase
            over_phase = (1.0 - square / 6.0 * (1.0 - square / 20.0)) * np.exp(-phase.imag)
        else:
            over_phase = sine / phase
        minus_i = complex(0.0, -1.0)
        over, times = over_phase * path, sine * k
        s_first, s_second = cosine * s_first + minus_i * over * s_second, cosine * s_second + minus_i * times * s_first
        over, times = over * index2, times / index2
        p_first, p_second = cosine * p_first + minus_i * over * p_second, cosine * p_second + minus_i * times * p_first
        growth += phase.imag
    before_s, before_p = k_i, k_i / (n_i * n_i)
    s_sum, p_sum = before_s * s_first + s_second, before_p * p_first + p_second
    r_s, r_p = (before_s * s_first - s_second) / s_sum, (before_p * p_first - p_second) / p_sum
    rho = np.conj(r_s) * r_p
    reflection = Polarising(
        r_s.real * r_s.real + r_s.imag * r_s.imag, r_p.real * r_p.real + r_p.imag * r_p.imag, rho.real, rho.imag
    )
    if total:
        return reflection, Polarising(0.0, 0.0, 0.0, 0.0)
    # Transmission amplitudes, scaled to power, without their common factor.
    passed = 2.0 * np.sqrt(k_i * k_t.real) * np.exp(-growth)
    t_s, t_p = passed / s_sum, passed / (n_i * n_t) / p_sum
    rho = np.conj(t_s) * t_p
    return reflection, Polarising(
        t_s.real * t_s.real + t_s.imag * t_s.imag, t_p.real * t_p.real + t_p.imag * t_p.imag, rho.real, rho.imag
    )


@inlined
def after(way: Polarising, q: float, u: float, v: float) -> tuple[float, float, float, float]:
    """Return the fraction of the power that leaves an interface one way, and its polarisation.

    Parameters
    ----------
    way : Polarising
    q, u, v : float
        Q, U and V over I of the incident light, with the reference direction s.

    Returns
    -------
    share : float
    q, u, v : float
        Q, U and V over I of the outgoing light, with the same reference; 0 without light.
    """
    s, p = 0.5 * max(0.0, 1.0 + q) * way.s, 0.5 * max(0.0, 1.0 - q) * way.p
    share = s + p
    if share <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    over = 1.0 / share
    q, u, v = (s - p) * over, (way.real * u - way.imaginary * v) * over, (way.imaginary * u + way.real * v) * over
    # Near complete polarisation, rounding may exceed it, considerably if almost no light is left.
    size2 = q * q + u * u + v * v
    if size2 > 1.0:
        scale = 1.0 / np.sqrt(size2)
        q, u, v = q * scale, u * scale, v * scale
    return share, q, u, v


@inlined
def turned(q: float, u: float, cosine: float, sine: float) -> tuple[float, float]:
    """Return Q and U over I for another reference direction.

    Parameters
    ----------
    q, u : float
        For the first reference direction, e.
    cosine, sine : float
        Components of the new direction along e and f, with any nonzero norm.
    """
    size2 = cosine * cosine + sine * sine
    double_cosine, double_sine = (cosine - sine) * (cosine + sine) / size2, 2.0 * cosine * sine / size2
    return q * double_cosine + u * double_sine, u * double_cosine - q * double_sine
