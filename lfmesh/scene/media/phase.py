"""Phase functions of scattering, by their kind and parameters."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, Index, NonNegative, Positive

SphereIndex = Annotated[float, Field(strict=True, gt=0, le=20)]


class _PhaseFunction(Model):
    @property
    def gives_size(self) -> bool:
        """True where it is that of spheres of a given size, which also decides how much they scatter."""
        return False

    @property
    def depends_on_surroundings(self) -> bool:
        """True where it changes with the refractive index of the medium that the scatterers are in."""
        return False


class IsotropicPhase(_PhaseFunction):
    """Light is scattered alike in all directions."""

    kind: Literal["isotropic"] = "isotropic"
    """Kind of phase function."""


class HenyeyGreensteinPhase(_PhaseFunction):
    """Henyey and Greenstein's phase function, by its mean cosine."""

    kind: Literal["henyey_greenstein"] = "henyey_greenstein"
    """Kind of phase function."""
    g: Annotated[float, Field(strict=True, gt=-1, lt=1)]
    """Mean cosine of the scattering angle (no unit), between -1, all thrown back, and 1, all straight on."""


class RayleighPhase(_PhaseFunction):
    """Spheres far smaller than the wavelength, in unpolarised light."""

    kind: Literal["rayleigh"] = "rayleigh"
    """Kind of phase function."""


class MiePhase(_PhaseFunction):
    """Homogeneous spheres of one size or of log-normally distributed sizes (Mie), in unpolarised light."""

    kind: Literal["mie"] = "mie"
    """Kind of phase function."""
    diameter_um: Positive
    """Diameter of the spheres, or the median of their diameters, in µm."""
    index: SphereIndex
    """Refractive index of the spheres."""
    extinction: NonNegative = 0.0
    """Extinction coefficient k of the spheres: their index is n + ik (no unit)."""
    surrounding_index: Index | None = None
    """Refractive index around the spheres: 1.333 of water. Omitted: that of the air or liquid they are in."""
    sigma: Annotated[float, Field(strict=True, ge=0, le=1)] = 0.0
    """Standard deviation of the natural logarithm of the diameter (no unit); 0: all have the same."""

    @property
    def gives_size(self) -> bool:
        """True: it is that of spheres of a given size, which also decides how much they scatter."""
        return True

    @property
    def depends_on_surroundings(self) -> bool:
        """True where `surrounding_index` does not say what the spheres are in."""
        return self.surrounding_index is None

    def faults(self) -> Iterator[Fault]:
        """Yield spheres that are not there."""
        if self.index == self.surrounding_index and not self.extinction:
            yield Fault(("index",), self.index, "is that of what is round the spheres, so that they scatter nothing")


class TabulatedPhase(_PhaseFunction):
    """A phase function from a file."""

    kind: Literal["table"] = "table"
    """Kind of phase function."""
    file: FilePath
    """CSV file, relative to the scene file, with angle_deg, from 0 (straight on) to 180, and value, in any unit. Linear
    in the cosine of the angle between its rows."""


Phase = Annotated[
    IsotropicPhase | HenyeyGreensteinPhase | RayleighPhase | MiePhase | TabulatedPhase, Field(discriminator="kind")
]
"""A phase function, by its kind."""
