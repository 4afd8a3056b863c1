"""Gradient-index glass of lenses and of the array's plate: its index at every point, and its dispersion.

The formulas also give the index of media that bend light, which may be below that of air. That of glass may not.
"""

from collections.abc import Iterator
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lfmesh.errors import GlassError
from lfmesh.optics.glass import D_LINE_NM
from lfmesh.optics.gradient_paraxial import index_on_axis
from lfmesh.optics.gradient_range import GlassRegion, IndexRange, depth_range, index_range
from lfmesh.optics.gradient_shapes import (
    GradientMaterial,
    GradientProfile,
    at_wavelength,
    gradium_profile,
    kink_per_mm,
    radial_and_axial_profile,
    radial_square_profile,
    selfoc_profile,
    separable_profile,
    spherical_profile,
)
from lfmesh.scene.literals import at_least, at_most
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Coefficient, FieldNumber, Number, Positive, Radius

__all__ = [
    "AnyGradient",
    "AxialGradient",
    "Gradient",
    "GradientDispersion",
    "GradiumGradient",
    "RadialGradient",
    "RadialSquareGradient",
    "SelfocGradient",
    "SphericalGradient",
    "XyzGradient",
]

MOST_TERMS = 30
"""Maximum number of coefficients of a list."""

MOST_DISPERSION_TERMS = 8
"""Maximum number of terms of the dispersion, and of coefficients of each."""

LOWEST, HIGHEST = 1.0, 10.0
"""Bounds of the index."""

ROUNDING = 1e-8
"""Relative rounding of the smallest and largest index of a region."""

Coefficients = Annotated[tuple[Coefficient, ...], Field(max_length=MOST_TERMS)]
GivenCoefficients = Annotated[tuple[Coefficient, ...], Field(min_length=1, max_length=MOST_TERMS)]
Series = Annotated[tuple[Coefficient, ...], Field(min_length=1, max_length=MOST_DISPERSION_TERMS)]


class GradientDispersion(Model):
    """Dispersion n² = n_ref² + (λ² − λ_ref²) Σ K_i / (λ² − L_i), with K_i and L_i polynomials of n_ref."""

    reference_nm: Positive
    """Wavelength λ_ref at which the gradient's numbers hold, in nm."""
    strengths: tuple[Series, ...] = Field(min_length=1, max_length=MOST_DISPERSION_TERMS)
    """For each term i, the coefficients of K_i in 1, n_ref, n_ref², ... (no unit)."""
    resonances_um2: tuple[Series, ...] = Field(min_length=1, max_length=MOST_DISPERSION_TERMS)
    """For each term i, the coefficients of L_i in 1, n_ref, n_ref², ..., in µm²."""

    @property
    def material(self) -> GradientMaterial:
        """The numbers, with zeros for coefficients that are not given."""
        return GradientMaterial(_filled(self.strengths), _filled(self.resonances_um2), self.reference_nm)

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if len(self.strengths) != len(self.resonances_um2):
            yield Fault(
                ("resonances_um2",), None,
                f"has {len(self.resonances_um2)} terms, but strengths has {len(self.strengths)}; give equally many",
            )  # fmt: skip


class Gradient(Model):
    """Properties that gradient-index glass of every kind has.

    x, y and z are those of the surface in front of the glass, from its vertex.
    """

    def profile(self, wavelength_nm: float) -> GradientProfile:
        """Return the index profile at a wavelength.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        GradientProfile
            Its frame is that of the surface in front.
        """
        return _profile(self, float(wavelength_nm))

    def index_at(self, wavelength_nm: float) -> float:
        """Return the refractive index at the vertex of the surface in front.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        float

        Raises
        ------
        GlassError
            It is not between 1 and 10.
        """
        return self.index_on_axis(wavelength_nm, 0.0)

    def index_on_axis(self, wavelength_nm: float, z_mm: float) -> float:
        """Return the refractive index on the axis.

        Parameters
        ----------
        wavelength_nm : float
        z_mm : float
            Distance from the vertex of the surface in front.

        Returns
        -------
        float

        Raises
        ------
        GlassError
            It is not between 1 and 10.
        """
        index = index_on_axis(self.profile(wavelength_nm), z_mm)
        # The root of a square may lie a rounding error below 1.
        if not LOWEST * (1.0 - 1e-15) <= index <= HIGHEST:
            raise GlassError(
                f"gradient at {wavelength_nm:g} nm: index {index:g} on the axis at z = {z_mm:g} mm; it must lie "
                f"between {LOWEST:g} and {HIGHEST:g}"
            )
        return index

    def index_range(self, wavelength_nm: float, region: GlassRegion) -> IndexRange:
        """Return the smallest and largest index over all of a region.

        Parameters
        ----------
        wavelength_nm : float
        region : GlassRegion

        Returns
        -------
        IndexRange

        Raises
        ------
        GlassError
            A term of the formula is too large to be evaluated.
        """
        return _index_range(self, float(wavelength_nm), region)

    def check_within(self, wavelength_nm: float, region: GlassRegion) -> None:
        """Refuse an index that leaves the range from 1 to 10 anywhere in a region.

        Parameters
        ----------
        wavelength_nm : float
        region : GlassRegion

        Raises
        ------
        GlassError
        """
        valid = f"it must lie between {LOWEST:g} and {HIGHEST:g} in all of the glass"
        try:
            found = self.index_range(wavelength_nm, region)
        except GlassError as error:
            raise GlassError(f"gradient at {wavelength_nm:g} nm: {error}; {valid}") from None
        for each in found:
            if not LOWEST * (1.0 - ROUNDING) <= each.value <= HIGHEST * (1.0 + ROUNDING):
                raise GlassError(f"gradient at {wavelength_nm:g} nm: {each.in_words()}; {valid}")

    def beyond(self, region: GlassRegion) -> str:
        """Return how far a region reaches beyond the glass that the formula describes, and what to give, or "".

        Parameters
        ----------
        region : GlassRegion

        Returns
        -------
        str
        """
        return ""

    def check_region(self, region: GlassRegion) -> None:
        """Refuse a region for which the formula is not made.

        Parameters
        ----------
        region : GlassRegion

        Raises
        ------
        GlassError
        """

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        raise NotImplementedError

    @property
    def catalogue_name(self) -> str | None:
        """None: the catalogue has no gradient-index glass."""
        return None

    @property
    def of_revolution(self) -> bool:
        """True if the index depends on z and the distance from the axis alone."""
        return True

    @property
    def symmetric(self) -> bool:
        """True if the index is symmetric about x and about y."""
        return self.of_revolution

    @property
    def curvatures(self) -> tuple[float, float]:
        """Second derivatives by x and by y at the vertex, up to a common factor."""
        return 1.0, 1.0

    @property
    def turns_axis(self) -> bool:
        """True if light along the axis is turned away from it."""
        return False

    def in_words(self) -> str:
        """Return the kind, and the index at the vertex for the d line.

        Returns
        -------
        str
        """
        kind = str(getattr(self, "kind", ""))
        try:
            return f"gradient {kind}, n = {self.index_at(D_LINE_NM):.6g} at the vertex"
        except GlassError:
            return f"gradient {kind}"


class DispersiveGradient(Gradient):
    """Keys of gradients whose numbers hold at one wavelength."""

    dispersion: GradientDispersion | None = None
    """Dispersion, such as that of a material of Zemax's SGRIN.DAT. Omitted: the same index at all wavelengths."""

    def profile(self, wavelength_nm: float) -> GradientProfile:
        """Return the index profile at a wavelength.

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        GradientProfile
            Its frame is that of the surface in front.
        """
        profile = super().profile(wavelength_nm)
        return profile if self.dispersion is None else at_wavelength(profile, self.dispersion.material, wavelength_nm)


class RadialSquareGradient(Gradient):
    """Powers of the distance r from the axis in n²: n² = index² (1 + c₁ r² + c₂ r⁴ + ...)."""

    kind: Literal["radial_n2"] = "radial_n2"
    """Kind of gradient."""
    index: FieldNumber
    """Refractive index on the axis."""
    coefficients: GivenCoefficients
    """Coefficients c of r², r⁴, ..., in mm⁻², mm⁻⁴, ...; a negative first one converges."""

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return radial_square_profile(self.index, self.coefficients)


class RadialGradient(DispersiveGradient):
    """Powers of the distance r from the axis: n = index + c₁ r² + c₂ r⁴ + ... + d₁ z + d₂ z² + ..."""

    kind: Literal["radial_n"] = "radial_n"
    """Kind of gradient."""
    index: FieldNumber
    """Refractive index at the vertex."""
    coefficients: GivenCoefficients
    """Coefficients c of r², r⁴, ..., in mm⁻², mm⁻⁴, ...; a negative first one converges."""
    axial_coefficients: Coefficients = ()
    """Coefficients d of z, z², ..., in mm⁻¹, mm⁻², .... Omitted: the index is constant along z."""

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return radial_and_axial_profile(self.index, self.coefficients, self.axial_coefficients)


class AxialGradient(DispersiveGradient):
    """Powers of the depth z: n = index + c₁ z + c₂ z² + ..."""

    kind: Literal["axial"] = "axial"
    """Kind of gradient."""
    index: FieldNumber
    """Refractive index at the vertex."""
    coefficients: GivenCoefficients
    """Coefficients c of z, z², ..., in mm⁻¹, mm⁻², ..."""

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return radial_and_axial_profile(self.index, (), self.coefficients)


class SphericalGradient(DispersiveGradient):
    """Spheres of constant index: n = index + c₁ t + c₂ t² + ..., with t = R − sgn(R) √(r² + (R − z)²)."""

    kind: Literal["spherical"] = "spherical"
    """Kind of gradient."""
    index: FieldNumber
    """Refractive index at the vertex."""
    coefficients: GivenCoefficients
    """Coefficients c of t, t², ..., in mm⁻¹, mm⁻², .... On the axis t is z."""
    radius_mm: Radius
    """Radius R of the sphere of constant index through the vertex, in mm: positive when the centre lies towards the
    sensor."""

    def check_region(self, region: GlassRegion) -> None:
        """Refuse glass around a centre at which the index has a kink.

        Parameters
        ----------
        region : GlassRegion

        Raises
        ------
        GlassError
        """
        axis = (np.zeros(1),) * 2
        (low,), (high,) = region.depths(axis)
        kink = kink_per_mm(self.profile(D_LINE_NM))
        if kink != 0.0 and region.radii_mm[0] == 0.0 and low <= self.radius_mm <= high:
            raise GlassError(
                f"the index has a kink at the centre of its spheres, z = {self.radius_mm:g} mm on the axis, where its "
                f"slope is {kink:.3g} per mm; give coefficients with a slope of 0 there"
            )

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return spherical_profile(self.radius_mm, (self.index, *self.coefficients))


class XyzGradient(DispersiveGradient):
    """Powers of x, of y and of z: n = index + Σ a_i x^i + Σ b_i y^i + Σ c_i z^i, with i from 1."""

    kind: Literal["xyz"] = "xyz"
    """Kind of gradient."""
    index: FieldNumber
    """Refractive index at the vertex."""
    x_coefficients: Coefficients = ()
    """Coefficients a of x, x², ..., in mm⁻¹, mm⁻², .... Omitted: the index is constant along x."""
    y_coefficients: Coefficients = ()
    """Coefficients b of y, y², ..., in mm⁻¹, mm⁻², .... Omitted: the index is constant along y."""
    z_coefficients: Coefficients = ()
    """Coefficients c of z, z², ..., in mm⁻¹, mm⁻², .... Omitted: the index is constant along z."""

    @property
    def of_revolution(self) -> bool:
        """True if the index depends on z alone, or has r² as its only other term."""
        x, y = (_without_zeros(each) for each in (self.x_coefficients, self.y_coefficients))
        return x == y and (not x or (len(x) == 2 and x[0] == 0.0))

    @property
    def symmetric(self) -> bool:
        """True if all powers of x and y are even."""
        return not any((*self.x_coefficients[::2], *self.y_coefficients[::2]))

    @property
    def curvatures(self) -> tuple[float, float]:
        """Second derivatives by x and by y at the vertex, up to a common factor."""
        return sum(self.x_coefficients[1:2]), sum(self.y_coefficients[1:2])

    @property
    def turns_axis(self) -> bool:
        """True if there are terms in x or y."""
        return any((*self.x_coefficients[:1], *self.y_coefficients[:1]))

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return separable_profile(
            (0.0, *self.x_coefficients), (0.0, *self.y_coefficients), (self.index, *self.z_coefficients)
        )

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        if not (self.x_coefficients or self.y_coefficients or self.z_coefficients):
            yield Fault(("x_coefficients",), None, "missing: give the coefficients of x, y or z")


class SelfocGradient(Gradient):
    """Rod as SELFOC lenses are listed: n = n₀ (1 − A r²/2), with n₀ = B + C/λ², √A = K₀ + K₁/λ² + K₂/λ⁴, λ in µm."""

    kind: Literal["selfoc"] = "selfoc"
    """Kind of gradient."""
    index: tuple[Number, Number]
    """B and C of the index n₀ on the axis (no unit, and µm²)."""
    gradient_constant_per_mm: tuple[Coefficient, Coefficient, Coefficient]
    """K₀, K₁ and K₂ of the gradient constant √A, in mm⁻¹, mm⁻¹ µm² and mm⁻¹ µm⁴."""

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return selfoc_profile(self.index, self.gradient_constant_per_mm, wavelength_nm)


class GradiumGradient(DispersiveGradient):
    """Lens cut from an axial blank of GRADIUM glass: n = Σ n_i ((z + offset) / blank)^i, with i from 0."""

    kind: Literal["gradium"] = "gradium"
    """Kind of gradient."""
    coefficients: GivenCoefficients
    """Coefficients n of the powers 0, 1, 2, ... of the relative depth in the blank (no unit)."""
    blank_mm: Positive
    """Length of the blank, in mm."""
    offset_mm: Number = 0.0
    """Depth of the vertex of the surface in front in the blank, in mm. The blank should contain all of the glass;
    `check` warns where it does not."""

    def beyond(self, region: GlassRegion) -> str:
        """Return how far the glass reaches beyond the blank, and what to give, or "".

        Parameters
        ----------
        region : GlassRegion

        Returns
        -------
        str
        """
        low, high = depth_range(region)
        rounding = ROUNDING * self.blank_mm
        first, last = self.offset_mm + low, self.offset_mm + high
        if first >= -rounding and last <= self.blank_mm + rounding:
            return ""
        room = self.blank_mm - (high - low)
        valid = f"blank_mm = {at_least(high - low)} or more"
        if room > 0.0:
            valid = f"offset_mm from {at_least(0.0 - low)} to {at_most(room - low)}"
        return (
            f"the glass reaches from {first:.6g} to {last:.6g} mm in a blank of {self.blank_mm:g} mm. The formula is "
            f"continued outside the blank, as in OpticStudio, but there is no such glass; give {valid}"
        )

    def _shape(self, wavelength_nm: float) -> GradientProfile:
        return gradium_profile(self.coefficients, self.blank_mm, self.offset_mm)


AnyGradient = Annotated[
    RadialSquareGradient
    | RadialGradient
    | AxialGradient
    | SphericalGradient
    | XyzGradient
    | SelfocGradient
    | GradiumGradient,
    Field(discriminator="kind"),
]
"""Gradient-index glass, by its kind."""


@lru_cache(maxsize=256)
def _profile(gradient: Gradient, wavelength_nm: float) -> GradientProfile:
    """Return the profile without dispersion."""
    # Numbers beyond float64 are refused by the range of the index.
    with np.errstate(over="ignore", invalid="ignore"):
        return gradient._shape(wavelength_nm)


@lru_cache(maxsize=256)
def _index_range(gradient: Gradient, wavelength_nm: float, region: GlassRegion) -> IndexRange:
    """Return the range of the index; cached, as a study asks for the same glass thousands of times."""
    return index_range(gradient.profile(wavelength_nm), region)


def _filled(rows: tuple[tuple[float, ...], ...]) -> NDArray[np.float64]:
    """Return rows of different lengths as an array, with zeros at their ends."""
    filled = np.zeros((len(rows), max(map(len, rows))))
    for i, row in enumerate(rows):
        filled[i, : len(row)] = row
    return filled


def _without_zeros(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return coefficients without the zeros at their end."""
    count = max((i + 1 for i, each in enumerate(coefficients) if each), default=0)
    return coefficients[:count]
