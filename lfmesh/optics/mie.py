"""Scattering by homogeneous spheres (Mie), of one size or of log-normally distributed sizes.

The multipole coefficients are miepython's, which is verified against Wiscombe's tables (NCAR/TN-140+STR, 1979). The
phase function is tabulated, linear in the cosine, with as many nodes as the error requires.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from lfmesh.optics.phase import PhaseFunction, tabulated

Array = NDArray[np.float64]
Intensity = Callable[[Array], Array]

LARGEST_SIZE = 4000.0
"""Largest size parameter, π d / λ, of a sphere."""

TOLERANCE = 1e-4
"""Fraction of the scattered light by which a table may differ from the function; see `_misplaced`."""

MOST_NODES = 1 << 18

SIZES = 256
"""Intervals of the size distribution, by the trapezoidal rule: error 1e-5 for small spheres, and 1e-3 for resonances of
single sizes (2 µm, index 1.59, sigma 0.5)."""

REACH = 4.5
"""Extent of a distribution in standard deviations; above the median, in addition to the shift by the weight d⁶."""

_CHUNK = 4096
"""Number of angles summed together, to limit the working memory."""


@dataclass(frozen=True, eq=False)
class MieSphere:
    """Scattering and absorption of unpolarised monochromatic light by spheres.

    Attributes
    ----------
    phase : PhaseFunction
        Tabulated; for a size distribution, the mean weighted by scattering cross-section.
    scattering_um2, extinction_um2 : float, µm²
        Cross-sections; for a size distribution, the mean per sphere.
    mean_cosine : float
        Asymmetry parameter g, from the series rather than the table.
    """

    phase: PhaseFunction
    scattering_um2: float
    extinction_um2: float
    mean_cosine: float


@lru_cache(maxsize=512)
def mie_sphere(
    diameter_um: float, index: complex, wavelength_nm: float, surrounding_index: float = 1.0, sigma: float = 0.0
) -> MieSphere:
    """Return the scattering and absorption of spheres.

    Parameters
    ----------
    diameter_um : float, µm
        Diameter, or median of a log-normal number distribution.
    index : complex
        n + ik of the spheres.
    wavelength_nm : float, nm
        In vacuum.
    surrounding_index : float
    sigma : float
        Standard deviation of ln(diameter); 0 for a single size.

    Raises
    ------
    ValueError
        Spheres exceed `LARGEST_SIZE`.
    """
    relative = complex(index.real, -abs(index.imag)) / surrounding_index
    diameters, numbers = _sizes(diameter_um, sigma)
    sizes = np.pi * diameters * 1e3 * surrounding_index / wavelength_nm
    if sizes.max() > LARGEST_SIZE:
        raise ValueError(
            f"spheres of {diameters.max():.4g} µm have a size parameter of {sizes.max():.4g}; the limit is "
            f"{LARGEST_SIZE:g}"
        )
    spheres = [_multipoles(relative, float(x)) for x in sizes]
    area = 0.25 * np.pi * diameters**2
    q = np.array([_efficiencies(a, b, x) for (a, b), x in zip(spheres, sizes, strict=True)])
    scattering = numbers * area * q[:, 1]
    whole = float(scattering.sum())

    def intensity(cosines: Array) -> Array:
        """Return the mean of |S₁|² + |S₂|² over the spheres; its integral gives the cross-section (4.61, 4.77)."""
        return np.asarray(
            sum(share * _brightness(a, b, cosines) for share, (a, b) in zip(numbers, spheres, strict=True) if share > 0)
        )

    phase = _tabulated(intensity, float(sizes.max()))
    mean_cosine = float((scattering * q[:, 2]).sum() / whole)
    return MieSphere(phase, whole, float((numbers * area * q[:, 0]).sum()), mean_cosine)


def _sizes(median: float, sigma: float) -> tuple[Array, Array]:
    """Return the diameters of a distribution, µm, and the fraction of spheres that each represents."""
    if sigma == 0.0:
        return np.array([median]), np.ones(1)
    spread = np.linspace(-REACH, REACH + 6.0 * sigma, SIZES + 1)
    shares = np.exp(-0.5 * spread**2)
    return median * np.exp(sigma * spread), shares / shares.sum()


def _multipoles(relative: complex, x: float) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the coefficients a_n and b_n of a sphere of relative index n − ik and size parameter x."""
    # Imported on demand: it brings scipy.special.
    import miepython

    if relative == 1.0:
        return np.zeros(3, np.complex128), np.zeros(3, np.complex128)
    a, b = miepython.coefficients(relative, x)
    return np.asarray(a), np.asarray(b)


def _efficiencies(a: NDArray[np.complex128], b: NDArray[np.complex128], x: float) -> tuple[float, float, float]:
    """Return the efficiencies of extinction and scattering, and the mean cosine (Bohren & Huffman 4.61, 4.62, 4.8)."""
    n = np.arange(1, len(a) + 1)
    extinction = 2.0 / x**2 * float(((2 * n + 1) * (a + b).real).sum())
    scattering = 2.0 / x**2 * float(((2 * n + 1) * (abs(a) ** 2 + abs(b) ** 2)).sum())
    if scattering == 0.0:
        return extinction, 0.0, 0.0
    m = n[:-1]
    forward = m * (m + 2) / (m + 1) * (a[:-1] * a[1:].conj() + b[:-1] * b[1:].conj()).real
    both = (2 * n + 1) / (n * (n + 1)) * (a * b.conj()).real
    return extinction, scattering, 4.0 / x**2 * float(forward.sum() + both.sum()) / scattering


def _brightness(a: NDArray[np.complex128], b: NDArray[np.complex128], cosines: Array) -> Array:
    """Return |S₁|² + |S₂|² at cosines of the scattering angle (Bohren & Huffman 4.74)."""
    found = np.empty(len(cosines))
    for first in range(0, len(cosines), _CHUNK):
        mu = cosines[first : first + _CHUNK]
        before, pi = np.zeros_like(mu), np.ones_like(mu)
        s1, s2 = np.zeros(len(mu), np.complex128), np.zeros(len(mu), np.complex128)
        for n in range(1, len(a) + 1):
            tau = n * mu * pi - (n + 1) * before
            scale = (2 * n + 1) / (n * (n + 1))
            s1 += scale * (a[n - 1] * pi + b[n - 1] * tau)
            s2 += scale * (a[n - 1] * tau + b[n - 1] * pi)
            before, pi = pi, ((2 * n + 1) * mu * pi - (n + 1) * before) / n
        found[first : first + _CHUNK] = abs(s1) ** 2 + abs(s2) ** 2
    return found


def _tabulated(intensity: Intensity, size: float) -> PhaseFunction:
    """Tabulate a function with as many maxima as the size parameter, within `TOLERANCE`."""
    intervals = 128 * 2 ** max(0, int(np.ceil(np.log2(size / 16.0))))
    angles = np.linspace(np.pi, 0.0, intervals + 1)
    values = intensity(_cosines(angles))
    if not values.any():
        # Nothing is scattered.
        return PhaseFunction()
    while True:
        middles = 0.5 * (angles[:-1] + angles[1:])
        between = intensity(_cosines(middles))
        error = _misplaced(angles, values, middles, between)
        merged = np.empty(2 * len(angles) - 1)
        merged[::2], merged[1::2] = angles, middles
        angles, found = merged, np.empty_like(merged)
        found[::2], found[1::2] = values, between
        values = found
        # Halving quarters the error of linear interpolation.
        if 0.25 * error <= TOLERANCE or len(angles) > MOST_NODES:
            return tabulated(_cosines(angles), values)


def _misplaced(angles: Array, values: Array, middles: Array, between: Array) -> float:
    """Return the fraction of the light misplaced by linear interpolation at interval centres."""
    cosines, at = _cosines(angles), _cosines(middles)
    t = (at - cosines[:-1]) / np.diff(cosines)
    linear = (1.0 - t) * values[:-1] + t * values[1:]
    return float((abs(linear - between) * np.diff(cosines)).sum() / (between * np.diff(cosines)).sum())


def _cosines(angles: Array) -> Array:
    cosines = np.cos(angles)
    cosines[angles == np.pi] = -1.0
    return np.asarray(cosines)
