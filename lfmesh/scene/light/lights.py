"""Light sources besides emitting targets, all in the world frame."""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field

from lfmesh.scene.light.spectra import Shape
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, NonNegative, Number, Positive, Vector, no_direction

HalfAngle = Annotated[float, Field(strict=True, gt=0, le=180)]


class LinearPolarisation(Model):
    """A field along a line.

    Its angle starts from the part of the world's x axis that is square to the ray (of the y axis, for a ray along x).
    """

    kind: Literal["linear"] = "linear"
    """Kind of polarisation."""
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
    """Kind of polarisation."""
    handedness: Literal["right", "left"] = "right"
    """"right": somebody whom the light comes to sees the field turn counter-clockwise (IEEE, IAU); "left":
    clockwise."""

    @property
    def stokes(self) -> tuple[float, float, float]:
        """Q, U and V over I."""
        return 0.0, 0.0, 1.0 if self.handedness == "right" else -1.0


Polarisation = Annotated[LinearPolarisation | CircularPolarisation, Field(discriminator="kind")]


class _Shines(Model):
    spectrum: Shape | None = None
    """Spectrum of its power, in any unit; the same at all wavelengths if omitted. An illuminant's name such as "D65",
    a table { wavelengths_nm = [...], values = [...] }, a CSV file with the columns wavelength_nm and value, or
    { blackbody_k = ... }. Needs bands."""


class PointLight(_Shines):
    """A point that shines alike in every direction, or by an angular profile."""

    kind: Literal["point"] = "point"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    power_w: Positive
    """Power into all directions together, in W: at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""
    polarisation: Polarisation | None = None
    """State of polarisation, complete; omitted, the light is unpolarised. Needs `transport.polarisation`."""
    profile: FilePath | None = None
    """An IES file (LM-63, type C), relative to the scene file: the shape of the intensity over the directions, scaled
    to `power_w`. Its vertical angles start at -y, down, its horizontal ones at +x, towards -z."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations of the profile about x, then y, then z, in degrees."""

    def faults(self) -> Iterator[Fault]:
        """Yield a rotation of what looks alike from all sides."""
        if self.profile is None and any(self.rotation_deg):
            yield Fault(("rotation_deg",), list(self.rotation_deg), "turns a profile, and none is given; omit it")


class _Directed(_Shines):
    direction: Vector
    """Direction of the light; of any length from 1e-100 to 1e100."""

    def faults(self) -> Iterator[Fault]:
        """Yield a direction without direction."""
        if why := no_direction(self.direction):
            yield Fault(("direction",), list(self.direction), why)


class DirectionalLight(_Directed):
    """Parallel light from far away."""

    kind: Literal["directional"] = "directional"
    """Kind of light."""
    irradiance_w_m2: Positive
    """On a plane square to the direction, in W/m²: at each wavelength of `transport.wavelengths_nm`, or with bands over
    the whole range of wavelengths from the first band's beginning to the last one's end."""
    polarisation: Polarisation | None = None
    """State of polarisation, complete; omitted, the light is unpolarised. Needs `transport.polarisation`."""


class DiskLight(_Directed):
    """A disk that shines to one side by Lambert's law."""

    kind: Literal["disk"] = "disk"
    """Kind of light."""
    position_mm: Vector
    """Its centre, in mm."""
    radius_mm: Positive
    """Its radius, in mm."""
    power_w: Positive
    """Power into its half space, in W: at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""


class SpotLight(_Directed):
    """A point that shines into a cone, evenly but for a soft edge, or by an angular profile."""

    kind: Literal["spot"] = "spot"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    half_angle_deg: HalfAngle | None = None
    """Angle between the cone's axis and its outer edge, in degrees, up to 180. Or give `profile`."""
    edge_deg: NonNegative = 0.0
    """Width of the soft edge inside the cone, in degrees: there the intensity falls to zero, linearly in the cosine of
    the angle from the axis. 0 is a sharp edge."""
    power_w: Positive
    """Power into the cone, in W: at each wavelength of `transport.wavelengths_nm`, or with bands over the whole range
    of wavelengths from the first band's beginning to the last one's end."""
    profile: FilePath | None = None
    """An IES file (LM-63, type C), relative to the scene file: the shape of the intensity over the directions, scaled
    to `power_w`. Its vertical angles start at `direction`, its horizontal ones at the side of +x (+y where `direction`
    is along x), counter-clockwise as seen from behind the lamp, by an eye that looks along `direction`."""
    turn_deg: Number = 0.0
    """Turn of the profile about `direction`, counter-clockwise as seen from behind the lamp, in degrees."""

    def faults(self) -> Iterator[Fault]:
        """Yield a cone that is missing, or given twice, or softer than it is wide."""
        yield from super().faults()
        if self.profile is None:
            if self.half_angle_deg is None:
                yield Fault(("half_angle_deg",), None, "missing: give the half angle of the cone, or profile")
            elif self.edge_deg > self.half_angle_deg:
                yield Fault(("edge_deg",), self.edge_deg, f"must be at most half_angle_deg = {self.half_angle_deg:g}")
            if self.turn_deg:
                yield Fault(("turn_deg",), self.turn_deg, "turns a profile, and none is given; omit it")
        else:
            if self.half_angle_deg is not None:
                yield Fault(("half_angle_deg",), self.half_angle_deg, "a profile is given too; give one of them")
            if self.edge_deg:
                yield Fault(("edge_deg",), self.edge_deg, "softens a cone, and a profile is given; omit it")


Light = Annotated[PointLight | DirectionalLight | DiskLight | SpotLight, Field(discriminator="kind")]
