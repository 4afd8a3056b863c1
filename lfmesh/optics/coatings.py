"""Thin-film coatings: reflectance and transmittance of a stack of plane layers between two media.

The fields at the front of the stack follow from those at its back by one characteristic matrix per layer (Born & Wolf,
Principles of Optics, 1.6.2; for absorption and total reflection Byrnes, arXiv 1603.02720). Fields vary as exp(−iωt), so
an absorbing layer has the index n + ik, k > 0. Every matrix is divided by the field's growth in its layer, so thick
absorbing and evanescent layers neither overflow nor lose digits. The media on both sides are transparent.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

S, P = 0, 1
"""Polarisation: electric field perpendicular to the plane of incidence, or in it."""

_SMALL_PHASE = 1e-3
"""Phase below which sin δ / δ is taken from its series, with an error below 1e-18."""


@dataclass(frozen=True)
class Stack:
    """Layers at one wavelength, in the order of the light.

    Attributes
    ----------
    indices : tuple of complex
        n + ik of each layer.
    thicknesses_nm : tuple of float
    """

    indices: tuple[complex, ...]
    thicknesses_nm: tuple[float, ...]

    @property
    def absorbs(self) -> bool:
        """True if any layer absorbs."""
        return any(index.imag != 0.0 for index in self.indices)

    @property
    def reversed(self) -> "Stack":
        """The same layers as seen from the other side."""
        return Stack(self.indices[::-1], self.thicknesses_nm[::-1])


def coated(n_i: float, n_t: float, stack: Stack, wavelength_nm: float, cos_i: Array) -> tuple[Array, Array]:
    """Return reflectance and transmittance of a stack for unpolarised light.

    Parameters
    ----------
    n_i, n_t : float
        Refractive indices before and behind the stack.
    stack : Stack
    wavelength_nm : float
        In air, the reference of all indices.
    cos_i : (n,) float64
        Cosine of incidence, above 0.

    Returns
    -------
    R, T : (n,) float64
        Fractions of the power, each from its amplitudes; T is 0 under total reflection.
    """
    cos_i = np.atleast_1d(np.asarray(cos_i, dtype=np.float64))
    k_i = n_i * cos_i
    return between(n_i, n_t, stack, wavelength_nm, k_i, beyond(n_i, n_t, k_i))


def beyond(n_i: float, n_t: float, k_i: Array) -> ComplexArray:
    """Return the normal component of a wave vector behind an interface, over 2π / λ.

    Parameters
    ----------
    n_i, n_t : float
        Indices before and behind the interface.
    k_i : (n,) float64
        Normal component before it.
    """
    k2 = (n_t - n_i) * (n_t + n_i) + k_i * k_i
    return np.where(k2 >= 0.0, np.sqrt(np.maximum(k2, 0.0)) + 0.0j, 1.0j * np.sqrt(np.maximum(-k2, 0.0)))


def between(
    n_i: float, n_t: float, stack: Stack, wavelength_nm: float, k_i: Array, k_t: ComplexArray
) -> tuple[Array, Array]:
    """Return reflectance and transmittance as in `coated`, from the normal components of the wave vectors.

    Near the critical angle these are more precise than the angle.

    Parameters
    ----------
    k_i : (n,) float64
        Normal component of the incident wave vector, over 2π / λ: n_i cos θ_i.
    k_t : (n,) complex128
        That of the transmitted one; imaginary under total reflection.
    """
    shares = [polarised(n_i, n_t, stack, wavelength_nm, k_i, k_t, polarisation) for polarisation in (S, P)]
    R, T = np.mean(shares, axis=0)
    return np.asarray(R), np.asarray(T)


def polarised(
    n_i: float, n_t: float, stack: Stack, wavelength_nm: float, k_i: Array, k_t: ComplexArray, polarisation: int
) -> tuple[Array, Array]:
    """Return reflectance and transmittance as in `between`, for one polarisation.

    Parameters
    ----------
    n_i, n_t, stack, wavelength_nm
        As in `between`.
    k_i, k_t : (n,)
        Normal components before and behind the stack, over 2π / λ.
    polarisation : int
        `S` or `P`.
    """

    def admittance(k: ComplexArray, index: complex) -> ComplexArray:
        # Magnetic over electric field for s, electric over magnetic for p.
        return k / (index * index) if polarisation == P else k

    tangential2 = n_i * n_i - k_i * k_i
    in_front, behind = admittance(k_i.astype(np.complex128), n_i), admittance(k_t, n_t)
    # Tangential fields at the back of the stack: 1, and the admittance of the medium behind.
    first, second = np.ones_like(in_front), behind
    growth = np.zeros(len(k_i))
    for index, thickness in zip(reversed(stack.indices), reversed(stack.thicknesses_nm), strict=True):
        k = np.sqrt(np.asarray(index * index - tangential2, dtype=np.complex128))
        k = np.where(k.imag < 0.0, -k, k)
        path = 2.0 * np.pi / wavelength_nm * thickness
        phase = np.asarray(path * k, dtype=np.complex128)
        cosine, sine, sine_over_phase = _scaled(phase)
        # sin δ / q and q sin δ, with q the admittance of the layer, which may vanish.
        over = sine_over_phase * path * (index * index if polarisation == P else 1.0)
        times = sine * admittance(k, index)
        first, second = cosine * first - 1.0j * over * second, cosine * second - 1.0j * times * first
        growth += phase.imag
    reflected, sum_ = in_front * first - second, in_front * first + second
    # Along an interface between equal indices both fields vanish; nearby light passes undivided.
    nothing = sum_ == 0.0
    size2 = np.where(nothing, 1.0, np.abs(sum_) ** 2)
    R = np.abs(reflected) ** 2 / size2
    T = 4.0 * in_front.real * behind.real * np.exp(-2.0 * growth) / size2
    return R, np.where(nothing, 1.0, T)


def _scaled(phase: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Return cos δ, sin δ and sin δ / δ of phases with Im δ ≥ 0, each over exp(Im δ)."""
    along, back = np.exp(1.0j * phase.real - 2.0 * phase.imag), np.exp(-1.0j * phase.real)
    cosine, sine = 0.5 * (along + back), -0.5j * (along - back)
    small = np.abs(phase) < _SMALL_PHASE
    square = np.where(small, phase * phase, 0.0)
    series = (1.0 - square / 6.0 * (1.0 - square / 20.0)) * np.exp(-phase.imag)
    return cosine, sine, np.where(small, series, sine / np.where(small, 1.0, phase))
