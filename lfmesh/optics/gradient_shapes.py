"""Index profiles of gradient-index glass: their kinds, their numbers, their dispersion and their paraxial optics.

A profile gives n² at every point of the medium's own frame, with its origin at the vertex of the surface in front of
the medium and z along the axis. A polynomial gives a value v, in r² = x² + y² and in mm:

- `REVOLVED`: v = Σ c_ij r^(2i) z^j.
- `SEPARABLE`: v = Σ a_i x^i + Σ b_i y^i + Σ d_i z^i. `FOLDED`: the same with |y| in place of y.
- `SPHERICAL`: v = Σ c_i t^i with t = R − sgn(R) √(r² + (R − z)²), constant on the spheres about (0, 0, R). On the axis
  t = z up to the centre.

The value is the index n, its square n², or the index at the reference wavelength of a material with dispersion. These
are the formulas of OpticStudio (Ansys Zemax OpticStudio 2024 R2, User Guide, pages "Gradient 1" to "Gradient 12" and
"GRADIUM"), with wavelengths in µm:

| surface | formula | profile |
|---|---|---|
| Gradient 1 without nr1 r | n = n₀ + nr2 r² | `REVOLVED` |
| Gradient 2 | n² = n₀ + nr2 r² + nr4 r⁴ + ... + nr12 r¹² | `REVOLVED`, n² |
| Gradient 3 | n = n₀ + nr2 r² + nr4 r⁴ + nr6 r⁶ + nz1 z + nz2 z² + nz3 z³ | `REVOLVED` |
| Gradient 4 | n = n₀ + nx1 x + nx2 x² + ny1 y + ny2 y² + nz1 z + nz2 z² | `SEPARABLE` |
| Gradient 5 | n_ref = n₀ + nr2 r² + nr4 r⁴ + nz1 z + nz2 z² + nz3 z³ + nz4 z⁴ | `REVOLVED`, dispersion |
| Gradient 7 | n = n₀ + α (R − ρ) + β (R − ρ)², ρ = sgn(R) √(r² + (R − z)²) | `SPHERICAL` |
| Gradient 9 | n = n₀ (1 − A r²/2), n₀ = B + C/λ², √A = K₀ + K₁/λ² + K₂/λ⁴ | `selfoc_profile` |
| Gradient 10 | n = n₀ + Σ nyi |y|^i, i from 1 to 6 | `FOLDED` |
| Gradient 12 | n = n₀ + Σ cxi x^i + cyi y^i + czi z^i, i from 1 to 20 | `SEPARABLE` |
| GRADIUM | n_ref = Σ n_i ((z + Δz)/z_max)^i, i from 0 to 11 | `gradium_profile`, dispersion |

The polynomials continue beyond the faces of the medium. Where n² is negative, n² and its gradient are still those of
the formula: a ray turns back before it gets there, and an integrator needs the formula without a kink.
`gradients` evaluates profiles in kernels.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import comb, copysign, inf, isinf
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

REVOLVED, SEPARABLE, FOLDED, SPHERICAL = range(4)
"""Kinds of profiles."""

INDEX, INDEX_SQUARED, REFERENCE_INDEX = range(3)
"""Quantities that a polynomial gives."""

MATERIAL_HEADER = 5
"""Numbers of a material before its coefficients: λ² − λ_ref² and λ², in µm², and the numbers of terms, of coefficients
of each strength and of coefficients of each resonance."""


class GradientProfile(NamedTuple):
    """An index profile at one wavelength.

    Attributes
    ----------
    kind : int
        REVOLVED, SEPARABLE, FOLDED or SPHERICAL.
    quantity : int
        INDEX, INDEX_SQUARED or REFERENCE_INDEX.
    counts : (3,) int
        Numbers of coefficients. REVOLVED: powers of r², of z, and 0. SEPARABLE and FOLDED: powers of x, y and z.
        SPHERICAL: powers of t, 0 and 0.
    numbers : (n,) float64
        Coefficients, from the power 0 up. REVOLVED: row by row, r² down and z across. SEPARABLE and FOLDED: of x, then
        of y, then of z. SPHERICAL: R, mm, then the coefficients.
    material : (m,) float64
        Of REFERENCE_INDEX: `MATERIAL_HEADER` numbers, strengths and resonances; otherwise empty.
    """

    kind: int
    quantity: int
    counts: tuple[int, int, int]
    numbers: Array
    material: Array


class GradientMaterial(NamedTuple):
    """Dispersion of a gradient-index material, generalised from Sellmeier's formula.

    n² = n_ref² + (λ² − λ_ref²) Σ K_i / (λ² − L_i), where K_i = Σ K_ij n_ref^(j−1) and L_i = Σ L_ij n_ref^(j−1)
    (OpticStudio's Gradient 5 and its file SGRIN.DAT).

    Attributes
    ----------
    strengths : (terms, k) float64
        K_ij.
    resonances_um2 : (terms, l) float64
        L_ij.
    reference_nm : float
        λ_ref.
    """

    strengths: Array
    resonances_um2: Array
    reference_nm: float


_NO_MATERIAL = np.zeros(0)

SMOOTH = 1e-6
"""Slope of a spherical profile at its centre, over the sum of the magnitudes of its terms, below which the profile
counts as smooth there. The kink turns a ray by at most about this fraction of what the profile turns rays by, and
coefficients with seven digits have one of this size."""


def kink_per_mm(profile: GradientProfile) -> float:
    """Return the slope of the index at the centre of a spherical profile, 1/mm; 0 if it is rounding, or without one.

    Parameters
    ----------
    profile : GradientProfile
    """
    if profile.kind != SPHERICAL:
        return 0.0
    slope = polynomial.polyder(profile.numbers[1:])
    with np.errstate(over="ignore", invalid="ignore"):
        terms = slope * np.power(profile.numbers[0], np.arange(len(slope)))
    kink = float(terms.sum())
    return 0.0 if abs(kink) <= SMOOTH * float(np.abs(terms).sum()) else kink


def revolved_profile(coefficients: ArrayLike, quantity: int = INDEX) -> GradientProfile:
    """Return the profile Σ c_ij r^(2i) z^j.

    Parameters
    ----------
    coefficients : (powers of r², powers of z) array_like
        c_ij, in mm^−(2i + j).
    quantity : int
        INDEX or INDEX_SQUARED.
    """
    table = np.atleast_2d(np.asarray(coefficients, np.float64))
    return GradientProfile(REVOLVED, quantity, (table.shape[0], table.shape[1], 0), table.ravel(), _NO_MATERIAL)


def radial_and_axial_profile(
    index: float, radial: Sequence[float] = (), axial: Sequence[float] = ()
) -> GradientProfile:  # fmt: skip
    """Return the profile n = n₀ + c₁ r² + c₂ r⁴ + ... + d₁ z + d₂ z² + ...

    Parameters
    ----------
    index : float
        n₀, at the vertex.
    radial : sequence of float
        c, in mm⁻², mm⁻⁴, ...
    axial : sequence of float
        d, in mm⁻¹, mm⁻², ...
    """
    table = np.zeros((1 + len(radial), 1 + len(axial)))
    table[0, 0], table[1:, 0], table[0, 1:] = index, radial, axial
    return revolved_profile(table)


def radial_square_profile(index: float, coefficients: Sequence[float]) -> GradientProfile:
    """Return the profile n² = n₀² (1 + c₁ r² + c₂ r⁴ + ...), with c in mm⁻², mm⁻⁴, ..."""
    return revolved_profile(index * index * np.array([[1.0], *([c] for c in coefficients)]), INDEX_SQUARED)


def separable_profile(
    x: Sequence[float], y: Sequence[float], z: Sequence[float], *, folded: bool = False
) -> GradientProfile:
    """Return the profile n = Σ a_i x^i + Σ b_i y^i + Σ d_i z^i, each from the power 0 up.

    Parameters
    ----------
    x, y, z : sequences of float
        Coefficients of the powers 0, 1, 2, ..., in mm^−i. The index at the vertex is the sum of the first ones.
    folded : bool
        Take |y| in place of y. Unless the odd coefficients are 0, rays that cross y = 0 meet a kink of the index, and
        no number of equal steps traces these accurately.
    """
    numbers = np.concatenate([np.asarray(each, np.float64).reshape(-1) for each in (x, y, z)])
    return GradientProfile(FOLDED if folded else SEPARABLE, INDEX, (len(x), len(y), len(z)), numbers, _NO_MATERIAL)


def spherical_profile(radius_mm: float, coefficients: Sequence[float]) -> GradientProfile:
    """Return the profile n = Σ c_i t^i with t = R − sgn(R) √(r² + (R − z)²).

    Parameters
    ----------
    radius_mm : float
        R of the sphere of constant index through the vertex; inf gives the axial profile Σ c_i z^i.
    coefficients : sequence of float
        c_i from the power 0 up, in mm^−i; c₀ is the index at the vertex.
    """
    if isinf(radius_mm):
        return revolved_profile([list(coefficients)])
    numbers = np.array([radius_mm, *coefficients], np.float64)
    return GradientProfile(SPHERICAL, INDEX, (len(coefficients), 0, 0), numbers, _NO_MATERIAL)


def selfoc_profile(
    index: Sequence[float], gradient_constant: Sequence[float], wavelength_nm: float
) -> GradientProfile:  # fmt: skip
    """Return the profile of a SELFOC rod, n = n₀ (1 − A r²/2).

    Parameters
    ----------
    index : (2,) float
        B and C of n₀ = B + C/λ², λ in µm.
    gradient_constant : (3,) float
        K₀, K₁ and K₂ of √A = K₀ + K₁/λ² + K₂/λ⁴, in mm⁻¹.
    wavelength_nm : float
    """
    per_um2 = (1e-3 * wavelength_nm) ** -2
    n0, root = (float(polynomial.polyval(per_um2, each)) for each in (index, gradient_constant))
    return radial_and_axial_profile(n0, [-0.5 * n0 * root * root])


def gradium_profile(coefficients: Sequence[float], length_mm: float, offset_mm: float) -> GradientProfile:
    """Return the profile n = Σ n_i ((z + Δz)/z_max)^i of a lens cut from an axial blank.

    The polynomial is expanded about the vertex in exact arithmetic, then rounded.

    Parameters
    ----------
    coefficients : sequence of float
        n_i from the power 0 up.
    length_mm : float
        Length z_max of the blank.
    offset_mm : float
        Position Δz of the lens's vertex in the blank.
    """
    given = [Fraction(n) / Fraction(length_mm) ** i for i, n in enumerate(coefficients)]
    offset = Fraction(offset_mm)
    powers = range(len(given))
    about = [
        sum((comb(i, j) * given[i] * offset ** (i - j) for i in powers[j:]), start=Fraction(0)) for j in powers
    ]  # fmt: skip
    return revolved_profile([[_rounded(each) for each in about]])


def _rounded(value: Fraction) -> float:
    """Return the nearest float64, infinite beyond its range."""
    try:
        return float(value)
    except OverflowError:
        return inf if value > 0 else -inf


def at_wavelength(profile: GradientProfile, material: GradientMaterial, wavelength_nm: float) -> GradientProfile:
    """Return a profile of the reference index as it is at a wavelength.

    Parameters
    ----------
    profile : GradientProfile
        Of the index at the material's reference wavelength.
    material : GradientMaterial
    wavelength_nm : float
    """
    square, reference = (1e-3 * wavelength_nm) ** 2, (1e-3 * material.reference_nm) ** 2
    strengths, resonances = (np.asarray(each, np.float64) for each in (material.strengths, material.resonances_um2))
    header = [square - reference, square, len(strengths), strengths.shape[1], resonances.shape[1]]
    numbers = np.concatenate([header, strengths.ravel(), resonances.ravel()])
    return profile._replace(quantity=REFERENCE_INDEX, material=numbers)


def paraxial_at(profile: GradientProfile, z: ArrayLike) -> tuple[Array, Array, Array, Array]:
    """Return n², ½ ∂n²/∂z, ½ ∂²n²/∂x² and ½ ∂²n²/∂y² on the axis.

    With dσ = ds/n, a paraxial ray follows d²x/dσ² = ½ ∂²n²/∂x² x. Terms linear in x, y or |y| are left out.

    Parameters
    ----------
    profile : GradientProfile
    z : (n,) array_like, mm

    Returns
    -------
    tuple of four (n,) float64
        1, mm⁻¹, mm⁻² and mm⁻².
    """
    at = np.atleast_1d(np.asarray(z, np.float64))
    value, by_z, xx, yy = _polynomial_on_axis(profile, at)
    squared, half_rate = _squared(profile, value)
    return squared, half_rate * by_z, half_rate * xx, half_rate * yy


def _polynomial_on_axis(profile: GradientProfile, z: Array) -> tuple[Array, Array, Array, Array]:
    """Return v, ∂v/∂z, ∂²v/∂x² and ∂²v/∂y²."""
    first, second, _ = profile.counts
    if profile.kind == REVOLVED:
        table = profile.numbers.reshape(first, second)
        across = np.asarray(2.0 * polynomial.polyval(z, table[1]) if first > 1 else np.zeros_like(z), np.float64)
        return _valued(table[0], z), _valued(polynomial.polyder(table[0]), z), across, across
    if profile.kind == SPHERICAL:
        radius, coefficients = profile.numbers[0], profile.numbers[1:]
        sign = copysign(1.0, radius)
        from_centre = np.abs(radius - z)
        t = radius - sign * from_centre
        slope = polynomial.polyder(coefficients)
        rate = _valued(slope, t)
        # The slope over its distance from the centre, without the difference of equal numbers there.
        if kink_per_mm(profile) == 0.0:
            across = _valued(polynomial.polydiv(slope, [-radius, 1.0])[0], t)
        else:
            across = -sign * rate / from_centre
        return _valued(coefficients, t), sign * rate * np.sign(radius - z), across, across
    of_x, of_y, of_z = np.split(profile.numbers, [first, first + second])
    along = of_z if len(of_z) else np.zeros(1)
    value = _valued(along, z) + of_x[:1].sum() + of_y[:1].sum()
    by_z = _valued(polynomial.polyder(along), z)
    xx, yy = (np.full_like(z, 2.0 * each[2:3].sum()) for each in (of_x, of_y))
    return value, by_z, xx, yy


def _valued(coefficients: ArrayLike, x: Array) -> Array:
    """Return the value of a polynomial, lowest power first."""
    return np.asarray(polynomial.polyval(x, np.asarray(coefficients, np.float64)), np.float64)


def _squared(profile: GradientProfile, value: Array) -> tuple[Array, Array]:
    """Return n² and ½ dn²/dv of values v of the polynomial."""
    if profile.quantity == INDEX_SQUARED:
        return value, np.full_like(value, 0.5)
    squared, half_rate = value * value, value
    if profile.quantity == INDEX:
        return squared, half_rate
    factor, square = profile.material[:2]
    terms, of_strength, of_resonance = (int(count) for count in profile.material[2:MATERIAL_HEADER])
    strengths, resonances = np.split(profile.material[MATERIAL_HEADER:], [terms * of_strength])
    strengths, resonances = strengths.reshape(terms, of_strength), resonances.reshape(terms, of_resonance)
    for strength, resonance in zip(strengths, resonances, strict=True):
        k, k_rate = (polynomial.polyval(value, each) for each in (strength, polynomial.polyder(strength)))
        pole, pole_rate = (polynomial.polyval(value, each) for each in (resonance, polynomial.polyder(resonance)))
        per = 1.0 / (square - pole)
        squared = squared + factor * per * k
        half_rate = half_rate + 0.5 * factor * per * (k_rate + k * pole_rate * per)
    return squared, half_rate
