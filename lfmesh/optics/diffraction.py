"""Fraunhofer diffraction at the aperture of a lenslet, as a random change of direction.

Behind an aperture of area A, light of wavelength λ in air changes its direction cosines by k with the density
|∫ exp(−2πi k·r/λ) d²r|² / (λ² A), the power spectrum of the aperture (Goodman, Introduction to Fourier Optics, 4.2, in
direction cosines as in Harvey, Appl. Opt. 18, 1979). It depends on the difference of two directions alone, so that it
is the same both ways. In q = k/λ, cycles a mm:

- A rectangle: the product over its sides of w sinc²(w q), with sinc x = sin πx / πx.
- A hexagon is made of three rhombi. Its spectrum is at most three times the sum of theirs (Cauchy-Schwarz inequality),
  each a product of sinc² along the rhombus's sides: rejection from that is exact.
"""

import numpy as np

from lfmesh.kernels.decorators import inlined, kernel

_EDGE = 1.0 / np.pi

_SIDE_X, _SIDE_Y = (0.0, -0.5, 0.5), (1.0 / np.sqrt(3.0), -0.5 / np.sqrt(3.0), -0.5 / np.sqrt(3.0))
"""Every second corner of a hexagon whose sides stand 1 apart, two of them across x: the sides of its three rhombi."""

_RHOMBUS = 1.0 / (2.0 * np.sqrt(3.0))
"""Area of each."""


@kernel
def proposed_sinc2(u: float, v: float) -> tuple[bool, float]:
    """Return whether a number proposed for the density sinc² is accepted, and the number.

    Proposals have the density min(1, (πx)⁻²) π/4, of which sinc² is the share that is accepted: π/4 of them in all.

    Parameters
    ----------
    u, v : float
        Random numbers, uniform in [0, 1).
    """
    side = 4.0 * u - 2.0
    if abs(side) < 1.0:
        x = _EDGE * side
        share = np.sinc(x)
        return bool(v < share * share), x
    # From 1 to 2 on either side: the tail, by its cumulative share.
    x = _EDGE / (2.0 - abs(side)) if abs(side) < 2.0 else np.inf
    if not x < np.inf:
        return False, 0.0
    share = np.sin(np.pi * x)
    return bool(v < share * share), x if side > 0.0 else -x


@inlined
def rhombus_frequency(number: int, a: float, b: float) -> tuple[float, float]:
    """Return the frequency q that has products a and b with the two sides of a rhombus of the unit hexagon.

    Parameters
    ----------
    number : int
        0, 1 or 2.
    a, b : float
        q·side and q·next side, whose densities are sinc².
    """
    after = (number + 1) % 3
    ax, ay, bx, by = _SIDE_X[number], _SIDE_Y[number], _SIDE_X[after], _SIDE_Y[after]
    over = 1.0 / (ax * by - ay * bx)
    return (a * by - b * ay) * over, (b * ax - a * bx) * over


@kernel
def hexagon_share(qx: float, qy: float) -> float:
    """Return the spectrum of the unit hexagon over three times the sum of those of its rhombi: at most 1.

    Parameters
    ----------
    qx, qy : float
        Frequency, in cycles over the distance of opposite sides, two of which are across x.
    """
    real, imaginary, total = 0.0, 0.0, 0.0
    for number in range(3):
        after = (number + 1) % 3
        a = qx * _SIDE_X[number] + qy * _SIDE_Y[number]
        b = qx * _SIDE_X[after] + qy * _SIDE_Y[after]
        amplitude = np.sinc(a) * np.sinc(b)
        # The centre of the rhombus is half the sum of its sides.
        phase = np.pi * (a + b)
        real += amplitude * np.cos(phase)
        imaginary -= amplitude * np.sin(phase)
        total += amplitude * amplitude
    return (real * real + imaginary * imaginary) / (3.0 * total) if total > 0.0 else 0.0
