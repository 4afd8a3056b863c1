"""Light sources besides emitting targets, all in the world frame."""

from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Positive, Vector
from lfmesh.scene.spectra import Shape


class _Shines(Model):
    spectrum: Shape | None = None
    """How its power is spread by wavelength, in any unit: an illuminant's name such as "D65", a table
    { wavelengths_nm = [...], values = [...] }, a CSV file with the columns wavelength_nm and value, or
    { blackbody_k = ... }; evenly if omitted. Needs bands."""


class PointLight(_Shines):
    """A point that shines alike in every direction."""

    kind: Literal["point"] = "point"
    """Which light this is."""
    position_mm: Vector
    """Where it stands, in mm."""
    power_w: Positive
    """Power into all directions together, in W: at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""


class _Directed(_Shines):
    direction: Vector
    """Where the light goes; of any length but 0."""

    def faults(self) -> Iterator[Fault]:
        """Yield a direction without direction."""
        if not any(self.direction):
            yield Fault(("direction",), list(self.direction), "must not be the zero vector")


class DirectionalLight(_Directed):
    """Parallel light from far away."""

    kind: Literal["directional"] = "directional"
    """Which light this is."""
    irradiance_w_m2: Positive
    """On a plane square to the direction, in W/m²: at each wavelength of `transport.wavelengths_nm`, or with bands over
    the whole range of wavelengths from the first band's beginning to the last one's end."""


class DiskLight(_Directed):
    """A disk that shines to one side by Lambert's law."""

    kind: Literal["disk"] = "disk"
    """Which light this is."""
    position_mm: Vector
    """Its centre, in mm."""
    radius_mm: Positive
    """Its radius, in mm."""
    power_w: Positive
    """Power into its half space, in W: at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""


Light = Annotated[PointLight | DirectionalLight | DiskLight, Field(discriminator="kind")]
