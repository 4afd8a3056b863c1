"""Polarised light at smooth interfaces: Stokes vectors, and what bare and coated interfaces do with them.

Conventions. Light that travels along the unit direction d has a reference direction e square to d, and f = d × e. With
fields that vary as exp(−iωt), E_e and E_f being the complex amplitudes along e and f,

    I = |E_e|² + |E_f|²,  Q = |E_e|² − |E_f|²,  U = 2 Re(E_e* E_f),  V = 2 Im(E_e* E_f).

So linearly polarised light at the angle ψ from e towards f has Q = I cos 2ψ and U = I sin 2ψ; an observer whom the
light comes to sees that angle grow counter-clockwise. Where V > 0 the same observer sees the field turn
counter-clockwise: right-handed in the sense of IEEE and IAU, left-handed in that of Born & Wolf.

At an interface the reference is s = d × n, square to the plane of incidence (n: the normal), and p = d × s for each of
the three rays. In this basis the Mueller matrix is

    | (S+P)/2  (S−P)/2   0    0  |
    | (S−P)/2  (S+P)/2   0    0  |   with the shares S and P of the power of s- and p-polarised light,
    |    0        0     Re ρ −Im ρ |   and ρ = r_s* r_p of the amplitudes, which for transmission are scaled to power.
    |    0        0     Im ρ  Re ρ |

Transmission is the same in both directions, and so is reflection from one side, so light that is traced backwards, from
an analyser to its source, meets the same matrices. The amplitudes have the signs of Born & Wolf, Principles of Optics,
1.5.2 and 1.6.2: at normal incidence r_p = −r_s. The package `tmm` and most books on ellipsometry have them too.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfmesh.kernels.decorators import inlined
from lfmesh.optics.fresnel import amplitude_sums

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

SMALL_PHASE = 1e-3
"""Phase below which sin δ / δ is taken from its series, whose next term is then below 1e-18."""


class Polarising(NamedTuple):
    """Elements of the Mueller matrix of an interface, for reflected or for transmitted light."""

    s: float  # share of the power of s-polarised light
    p: float  # share of the power of p-polarised light
    real: float  # of ρ, the product of the conjugate s amplitude and the p amplitude
    imaginary: float


@inlined
def bare_interface(n_i: float, n_t: float, cos_i: float) -> tuple[Polarising, Polarising]:
    """Return reflection and transmission at an interface without a coating.

    Parameters
    ----------
    n_i, n_t : float
        Refractive index before and behind the interface.
    cos_i : float
        Cosine of the angle of incidence, 0 to 1.
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
    """Return reflection and transmission at a stack of layers, by their characteristic matrices.

    The same formulas as those of `optics.coatings.polarised`, with the phases.

    Parameters
    ----------
    n_i, n_t, cos_i : float
        As for `bare_interface`.
    indices : (layers, wavelengths) complex128
        n + ik of layers.
    thicknesses : (layers,) float64, nm
    colour : int
        Number of the wavelength.
    first, count : int
        First layer of the stack, and number of its layers.
    turned : bool
        Light meets the last layer first.
    wavelength_nm : float
        In air, which all indices are relative to.
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
    # Tangential fields at the back of the stack: one of them 1, the other the admittance of the medium behind.
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
    # The amplitudes of transmission, scaled to power, each without a factor that the two have in common.
    passed = 2.0 * np.sqrt(k_i * k_t.real) * np.exp(-growth)
    t_s, t_p = passed / s_sum, passed / (n_i * n_t) / p_sum
    rho = np.conj(t_s) * t_p
    return reflection, Polarising(
        t_s.real * t_s.real + t_s.imag * t_s.imag, t_p.real * t_p.real + t_p.imag * t_p.imag, rho.real, rho.imag
    )


@inlined
def after(way: Polarising, q: float, u: float, v: float) -> tuple[float, float, float, float]:
    """Return the share of the power that goes one way at an interface, and its state of polarisation.

    Parameters
    ----------
    way : Polarising
    q, u, v : float
        Q, U and V over I of the light that arrives, with the reference direction s.

    Returns
    -------
    share : float
    q, u, v : float
        Of the light that leaves, with the same reference direction; 0 where none leaves.
    """
    s, p = 0.5 * max(0.0, 1.0 + q) * way.s, 0.5 * max(0.0, 1.0 - q) * way.p
    share = s + p
    if share <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    over = 1.0 / share
    q, u, v = (s - p) * over, (way.real * u - way.imaginary * v) * over, (way.imaginary * u + way.real * v) * over
    # Close to complete polarisation rounding may exceed it, by much where nearly nothing is left.
    size2 = q * q + u * u + v * v
    if size2 > 1.0:
        scale = 1.0 / np.sqrt(size2)
        q, u, v = q * scale, u * scale, v * scale
    return share, q, u, v


@inlined
def turned(q: float, u: float, cosine: float, sine: float) -> tuple[float, float]:
    """Return Q and U over I with another reference direction.

    Parameters
    ----------
    q, u : float
        With the first reference direction, e.
    cosine, sine : float
        Components of the new direction along e and f, of any common length but 0.
    """
    size2 = cosine * cosine + sine * sine
    double_cosine, double_sine = (cosine - sine) * (cosine + sine) / size2, 2.0 * cosine * sine / size2
    return q * double_cosine + u * double_sine, u * double_cosine - q * double_sine
