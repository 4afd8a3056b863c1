"""Phase functions of scattering, by kind and parameters."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, Index, NonNegative, Positive

SphereIndex = Annotated[float, Field(strict=True, gt=0, le=20)]


class _PhaseFunction(Model):
    @property
    def gives_size(self) -> bool:
        """True for spheres of a given size, which also determines the amount of scattering."""
        return False

    @property
    def depends_on_surroundings(self) -> bool:
        """True if it changes with the refractive index around the scatterers."""
        return False


class IsotropicPhase(_PhaseFunction):
    """Light is scattered evenly in all directions."""

    kind: Literal["isotropic"] = "isotropic"
    """Kind of phase function."""


class HenyeyGreensteinPhase(_PhaseFunction):
    """The Henyey-Greenstein phase function, by its mean cosine."""

    kind: Literal["henyey_greenstein"] = "henyey_greenstein"
    """Kind of phase function."""
    g: Annotated[float, Field(strict=True, gt=-1, lt=1)]
    """Mean cosine of the scattering angle (no unit), between -1, all backward, and 1, all forward."""


class RayleighPhase(_PhaseFunction):
    """Spheres much smaller than the wavelength, in unpolarised light."""

    kind: Literal["rayleigh"] = "rayleigh"
    """Kind of phase function."""


class MiePhase(_PhaseFunction):
    """Homogeneous spheres of one size or of log-normally distributed sizes (Mie), in unpolarised light."""

    kind: Literal["mie"] = "mie"
    """Kind of phase function."""
    diameter_um: Positive
    """Diameter of the spheres, or their median diameter, in µm."""
    index: SphereIndex
    """Refractive index of the spheres."""
    extinction: NonNegative = 0.0
    """Extinction coefficient k of the spheres: their index is n + ik (no unit)."""
    surrounding_index: Index | None = None
    """Refractive index around the spheres: 1.333 for water. Omitted: that of the air or liquid they are in."""
    sigma: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.0
    """Standard deviation of the natural logarithm of the diameter (no unit); 0: all have the same."""

    @property
    def gives_size(self) -> bool:
        """Always True."""
        return True

    @property
    def depends_on_surroundings(self) -> bool:
        """True if `surrounding_index` is omitted."""
        return self.surrounding_index is None

    def faults(self) -> Iterator[Fault]:
        """Yield spheres that match their surroundings and scatter nothing."""
        if self.index == self.surrounding_index and not self.extinction:
            yield Fault(("index",), self.index, "equals the index of the surroundings, so the spheres scatter nothing")


class TabulatedPhase(_PhaseFunction):
    """A phase function from a file."""

    kind: Literal["table"] = "table"
    """Kind of phase function."""
    file: FilePath
    """CSV file, relative to the scene file, with angle_deg, from 0 (forward) to 180, and value, in any unit.
    Interpolated linearly in the cosine of the angle."""


Phase = Annotated[
    IsotropicPhase | HenyeyGreensteinPhase | RayleighPhase | MiePhase | TabulatedPhase, Field(discriminator="kind")
]
"""A phase function, by its kind."""
