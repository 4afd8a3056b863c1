"""Paraxial optics of gradient-index glass: the index on the axis, and the matrix of a gap between two vertices.

With dσ = ds/n, a paraxial ray follows dh/dσ = p and dp/dσ = ½ ∂²n²/∂h² h, where h is the height and p the reduced
angle, the index times the slope. On the axis dz/dσ = n. In a medium that is constant along z both have the solutions
cos and sin (cosh and sinh where the index grows off the axis). Elsewhere a Magnus integrator of order 6 follows the
matrix along z (S. Blanes, F. Casas, J. A. Oteo and J. Ros, Phys. Rep. 470, 151, 2009, section 5.5). Its steps are
exponentials of matrices without trace, so the determinant is 1.
"""

from math import cos, cosh, isfinite, sin, sinh, sqrt

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import GlassError
from lfmesh.optics.gradient_shapes import REVOLVED, GradientProfile, kink_per_mm, paraxial_at

Array = NDArray[np.float64]
GapMatrix = tuple[float, float, float, float]

_UNIT: GapMatrix = (1.0, 0.0, 0.0, 1.0)

NODES = np.array([0.5 - sqrt(0.15), 0.5, 0.5 + sqrt(0.15)])
"""Gauss nodes of a step, as fractions of its length."""

PRECISION = 1e-12
"""Relative change of the matrix on doubling the steps, at which the finer one is accepted; its error is a 64th."""

FASTEST = 350.0
"""Largest phase or exponent of a ray within a step; products of exponentials of twice this do not overflow."""

FEWEST_STEPS, MOST_STEPS = 8, 1 << 16


def index_on_axis(profile: GradientProfile, z_mm: float) -> float:
    """Return the index on the axis.

    Parameters
    ----------
    profile : GradientProfile
    z_mm : float
        Distance from the vertex in front of the medium.

    Raises
    ------
    GlassError
        The formula gives no real index there.
    """
    with np.errstate(all="ignore"):
        squared = float(paraxial_at(profile, z_mm)[0][0])
    if not (squared > 0.0 and isfinite(squared)):
        raise GlassError(f"gradient index: n² = {squared:.6g} on the axis at z = {z_mm:g} mm; it must be above 0")
    return sqrt(squared)


def gap_matrix(profile: GradientProfile, length_mm: float, *, section_x: bool = False) -> GapMatrix:
    """Return the matrix (a, b, c, d) of a gap on heights and reduced angles: h' = a h + b p, p' = c h + d p.

    Its determinant is 1, so light in the reverse direction has the matrix (d, b, c, a).

    Parameters
    ----------
    profile : GradientProfile
    length_mm : float
        Distance from the vertex in front of the medium to the next vertex, 0 or more.
    section_x : bool
        Return the matrix of the section x–z in place of y–z.

    Raises
    ------
    GlassError
        The formula gives no real index on the axis within the gap, or changes too fast along it.
    """
    return gap_and_sizes(profile, length_mm, section_x=section_x)[0]


def gap_and_sizes(
    profile: GradientProfile, length_mm: float, *, section_x: bool = False
) -> tuple[GapMatrix, GapMatrix]:  # fmt: skip
    """Return the matrix of a gap, and the sizes to which the rounding errors of its elements are relative.

    Parameters
    ----------
    profile, length_mm, section_x
        As in `gap_matrix`.
    """
    if length_mm == 0.0:
        return _UNIT, _UNIT
    if (kink := kink_per_mm(profile)) != 0.0 and 0.0 <= profile.numbers[0] <= length_mm:
        raise GlassError(
            f"gradient index: it has a kink of {kink:.3g} per mm on the axis at z = {profile.numbers[0]:g} mm"
        )
    index, rate = _along_axis(profile, np.linspace(0.0, length_mm, FEWEST_STEPS + 1), section_x)
    # A zero of b or c, as of a rod of half a period, is a difference of terms of these sizes.
    sizes = 1.0, float(length_mm / index.min()), float(length_mm * np.abs(rate / index).max()), 1.0
    matrix = _matrix(profile, length_mm, section_x, sizes)
    a, b, c, d = (max(size, abs(element)) for size, element in zip(sizes, matrix, strict=True))
    return matrix, (a, b, c, d)


def _matrix(profile: GradientProfile, length_mm: float, section_x: bool, sizes: GapMatrix) -> GapMatrix:
    if profile.kind == REVOLVED and not profile.numbers.reshape(profile.counts[:2])[:, 1:].any():
        index, rate = (float(each[0]) for each in _along_axis(profile, np.zeros(1), section_x))
        return _exponential(0.0, length_mm / index, length_mm * rate / index)
    steps = FEWEST_STEPS
    coarse, fine = (_followed(profile, length_mm, section_x, each) for each in (steps, 2 * steps))
    while not all(
        abs(x - y) <= PRECISION * max(size, abs(y)) for x, y, size in zip(coarse, fine, sizes, strict=True)
    ):  # fmt: skip
        steps *= 2
        if steps > MOST_STEPS:
            raise GlassError(f"gradient index: on the axis it changes too fast within {length_mm:g} mm")
        coarse, fine = fine, _followed(profile, length_mm, section_x, 2 * steps)
    a, b, c, d = fine
    return a, b, c, d


def _along_axis(profile: GradientProfile, z: Array, section_x: bool) -> tuple[Array, Array]:
    """Return the index on the axis and ½ ∂²n²/∂h² in a section, (n,) each."""
    with np.errstate(all="ignore"):
        squared, _, xx, yy = paraxial_at(profile, z)
    rate = xx if section_x else yy
    wrong = ~((squared > 0.0) & np.isfinite(squared) & np.isfinite(rate))
    if wrong.any():
        index_on_axis(profile, float(z[wrong][0]))
        raise GlassError(f"gradient index: it has no finite curvature at z = {z[wrong][0]:g} mm on the axis")
    return np.sqrt(squared), rate


def _followed(profile: GradientProfile, length_mm: float, section_x: bool, steps: int) -> GapMatrix:
    """Return the matrix of a gap in equal Magnus steps of order 6.

    With dM/dz = [[0, β], [γ, 0]] M, β = 1/n and γ = ½ ∂²n²/∂h² / n, the values at the Gauss nodes give the moments
    α₁ = h A₂, α₂ = h √15/3 (A₃ − A₁) and α₃ = h 10/3 (A₃ − 2 A₂ + A₁). The exponent is
    α₁ + α₃/12 + [−20 α₁ − α₃ + C₁, α₂ + C₂]/240, with C₁ = [α₁, α₂] and C₂ = −[α₁, 2 α₃ + C₁]/60.
    """
    h = length_mm / steps
    z = (h * (np.arange(steps)[:, None] + NODES)).ravel()
    index, rate = _along_axis(profile, z, section_x)
    beta, gamma = ((each / index).reshape(steps, 3) for each in (np.ones_like(rate), rate))
    # A matrix without trace is kept as its elements (a, b, c) of [[a, b], [c, −a]].
    at = np.stack([np.zeros_like(beta), beta, gamma])
    first = h * at[:, :, 1]
    second = h * sqrt(15.0) / 3.0 * (at[:, :, 2] - at[:, :, 0])
    third = h * 10.0 / 3.0 * (at[:, :, 2] - 2.0 * at[:, :, 1] + at[:, :, 0])
    c1 = _commutator(first, second)
    c2 = _commutator(first, 2.0 * third + c1) / -60.0
    exponents = first + third / 12.0 + _commutator(-20.0 * first - third + c1, second + c2) / 240.0
    total = _UNIT
    for a, b, c in exponents.T.tolist():
        total = _product(_exponential(a, b, c), total)
    return total


def _commutator(left: Array, right: Array) -> Array:
    """Return the commutators of matrices without trace, (3, n)."""
    (a, b, c), (p, q, r) = left, right
    return np.stack([b * r - q * c, 2.0 * (a * q - p * b), 2.0 * (c * p - r * a)])


def _exponential(a: float, b: float, c: float) -> GapMatrix:
    """Return the exponential of [[a, b], [c, −a]], whose square is (a² + b c) times the unit matrix."""
    square = a * a + b * c
    if not abs(square) <= FASTEST * FASTEST:
        raise GlassError("gradient index: it changes too fast across the axis")
    if square < 0.0:
        angle = sqrt(-square)
        even, odd = cos(angle), sin(angle) / angle
    elif square > 0.0:
        angle = sqrt(square)
        even, odd = cosh(angle), sinh(angle) / angle
    else:
        even, odd = 1.0, 1.0
    return even + odd * a, odd * b, odd * c, even - odd * a


def _product(after: GapMatrix, before: GapMatrix) -> GapMatrix:
    return (
        after[0] * before[0] + after[1] * before[2],
        after[0] * before[1] + after[1] * before[3],
        after[2] * before[0] + after[3] * before[2],
        after[2] * before[1] + after[3] * before[3],
    )
