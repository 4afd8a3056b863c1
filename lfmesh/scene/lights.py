"""Light sources besides emitting targets, all in the world frame."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import Number, Positive, Vector


class LinearPolarisation(Model):
    """A field along a line.

    Its angle starts from the part of the world's x axis that is square to the ray (of the y axis, for a ray along x).
    """

    kind: Literal["linear"] = "linear"
    """Which state this is."""
    angle_deg: Number
    """From the world's x axis, in degrees, counter-clockwise as seen by somebody whom the light comes to."""

    @property
    def stokes(self) -> tuple[float, float, float]:
        """Q, U and V over I."""
        angle = math.radians(2.0 * self.angle_deg)
        return math.cos(angle), math.sin(angle), 0.0


class CircularPolarisation(Model):
    """A field that turns."""

    kind: Literal["circular"] = "circular"
    """Which state this is."""
    handedness: Literal["right", "left"] = "right"
    """"right": somebody whom the light comes to sees the field turn counter-clockwise (IEEE, IAU); "left":
    clockwise."""

    @property
    def stokes(self) -> tuple[float, float, float]:
        """Q, U and V over I."""
        return 0.0, 0.0, 1.0 if self.handedness == "right" else -1.0


Polarisation = Annotated[LinearPolarisation | CircularPolarisation, Field(discriminator="kind")]


class PointLight(Model):
    """A point that shines alike in every direction."""

    kind: Literal["point"] = "point"
    """Which light this is."""
    position_mm: Vector
    """Where it stands, in mm."""
    power_w: Positive
    """Power into all directions together, in W per wavelength sample."""
    polarisation: Polarisation | None = None
    """State of polarisation, complete; omitted, the light is unpolarised. Needs `transport.polarisation`."""


class _Directed(Model):
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
    """On a plane square to the direction, in W/m² per wavelength sample."""
    polarisation: Polarisation | None = None
    """State of polarisation, complete; omitted, the light is unpolarised. Needs `transport.polarisation`."""


class DiskLight(_Directed):
    """A disk that shines to one side by Lambert's law."""

    kind: Literal["disk"] = "disk"
    """Which light this is."""
    position_mm: Vector
    """Its centre, in mm."""
    radius_mm: Positive
    """Its radius, in mm."""
    power_w: Positive
    """Power into its half space, in W per wavelength sample."""


Light = Annotated[PointLight | DirectionalLight | DiskLight, Field(discriminator="kind")]
