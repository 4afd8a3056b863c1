"""Light sources besides emitting targets, all in the world frame.

Each lamp says what others ask of it as properties: the region it shines from, where it is headed, how wide its light
spreads, by which law. Nothing else needs to know which lamp it is.
"""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from lfmesh.scene.light.region import Region
from lfmesh.scene.light.spectra import Shape
from lfmesh.scene.light.turns import axes_along, rotation
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.quantities import FilePath, NonNegative, Number, Positive, Vector, no_direction

Array = NDArray[np.float64]

HalfAngle = Annotated[float, Field(strict=True, gt=0, le=180)]

Emission = Literal["even", "cone", "lambert", "sine", "profile"]
"""Laws of a lamp's intensity: the same in every direction or in a cone, by the cosine or the sine of the angle from its
axis, or by a table."""


class LinearPolarisation(Model):
    """A field along a line.

    Its angle starts from the part of the world's x axis that is square to the ray (of the y axis, for a ray along x).
    """

    kind: Literal["linear"] = "linear"
    """Kind of polarisation."""
    angle_deg: Number
    """Angle of the field from the world's x axis, in degrees, counter-clockwise as the receiver of the light sees
    it."""

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
    """Sense of rotation of the field: "right" is counter-clockwise as the receiver of the light sees it (IEEE, IAU).
    "left": clockwise."""

    @property
    def stokes(self) -> tuple[float, float, float]:
        """Q, U and V over I."""
        return 0.0, 0.0, 1.0 if self.handedness == "right" else -1.0


Polarisation = Annotated[LinearPolarisation | CircularPolarisation, Field(discriminator="kind")]


class _InOnePlace(Protocol):
    """Fields of most lamps."""

    power_w: float
    position_mm: Vector


class _Shines(Model):
    spectrum: Shape | None = None
    """Spectrum of the power, in any unit: an illuminant's name such as "D65", a table, a CSV file or { blackbody_k =
    ... }. A table is { wavelengths_nm = [...], values = [...] }; a CSV file has the columns wavelength_nm and value.
    Needs bands. Omitted: the same at all wavelengths."""

    law: ClassVar[Emission] = "even"

    @property
    def emission(self) -> Emission:
        """Law by which the intensity depends on the direction."""
        return self.law if self.ies is None else "profile"

    @property
    def strength(self) -> float:
        """Power in W; of parallel light, irradiance in W/m²."""
        return cast(_InOnePlace, self).power_w

    @property
    def region(self) -> Region | None:
        """Region that it shines from; None for parallel light, which comes from no place."""
        return None

    @property
    def place_in_words(self) -> str:
        """Key and value of its place, as in a scene file, and its size."""
        return f"position_mm = {list(cast(_InOnePlace, self).position_mm)}"

    @property
    def axes(self) -> Array:
        """Unit axes, (3, 3) float64: two across the lamp, at a profile's horizontal angles 0 and 90, and its own."""
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])

    @property
    def heading(self) -> Array | None:
        """Unit direction about which the light goes, (3,) float64; None where no direction is preferred."""
        return None

    @property
    def spread_deg(self) -> float:
        """Angle from the heading beyond which nothing shines, before a profile is read."""
        return 180.0

    @property
    def even_deg(self) -> float:
        """Angle from the heading up to which a cone shines evenly."""
        return self.spread_deg

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return None

    @property
    def state(self) -> "Polarisation | None":
        """State of polarisation; None for unpolarised light."""
        return None


class PointLight(_Shines):
    """A point that shines alike in every direction, or by an angular profile."""

    kind: Literal["point"] = "point"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    power_w: Positive
    """Power into all directions together, in W. It holds at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""
    polarisation: Polarisation | None = None
    """State of complete polarisation. Needs `transport.polarisation`. Omitted: unpolarised."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: shape of the intensity over the directions, scaled to
    `power_w`. Its vertical angles start at -y, down, its horizontal ones at +x, towards -z. Omitted: even."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations of the profile about x, then y, then z, in degrees."""

    @property
    def region(self) -> Region:
        """The point."""
        return Region(np.array(self.position_mm))

    @property
    def axes(self) -> Array:
        """Axes of the profile, (3, 3) float64."""
        axes = super().axes
        return np.asarray(axes @ rotation(self.rotation_deg).T) if any(self.rotation_deg) else axes

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return self.profile

    @property
    def state(self) -> Polarisation | None:
        """State of polarisation."""
        return self.polarisation

    def faults(self) -> Iterator[Fault]:
        """Yield a rotation of what looks alike from all sides."""
        if self.profile is None and any(self.rotation_deg):
            yield Fault(("rotation_deg",), list(self.rotation_deg), "turns a profile, and none is given; omit it")


class _Directed(_Shines):
    direction: Vector
    """Direction of the light; of any length from 1e-100 to 1e100."""

    @property
    def heading(self) -> Array:
        """Unit vector along `direction`, (3,) float64."""
        return np.array(self.direction) / np.linalg.norm(self.direction)

    @property
    def axes(self) -> Array:
        """Axes, (3, 3) float64, as `turns.axes_along` has them."""
        return axes_along(self.heading, 0.0)

    def faults(self) -> Iterator[Fault]:
        """Yield a direction without direction."""
        if why := no_direction(self.direction):
            yield Fault(("direction",), list(self.direction), why)


class DirectionalLight(_Directed):
    """Parallel light from far away."""

    kind: Literal["directional"] = "directional"
    """Kind of light."""
    irradiance_w_m2: Positive
    """Irradiance of a plane square to the direction, in W/m². It holds at each wavelength of
    `transport.wavelengths_nm`, or with bands over the whole range of wavelengths from the first band's beginning to the
    last one's end."""
    polarisation: Polarisation | None = None
    """State of complete polarisation. Needs `transport.polarisation`. Omitted: unpolarised."""

    @property
    def strength(self) -> float:
        """Irradiance, W/m²."""
        return self.irradiance_w_m2

    @property
    def spread_deg(self) -> float:
        """All light goes along the direction."""
        return 0.0

    @property
    def state(self) -> Polarisation | None:
        """State of polarisation."""
        return self.polarisation


class DiskLight(_Directed):
    """A disk that shines to one side by Lambert's law."""

    kind: Literal["disk"] = "disk"
    """Kind of light."""
    position_mm: Vector
    """Centre, in mm."""
    radius_mm: Positive
    """Radius, in mm."""
    power_w: Positive
    """Power into its half space, in W. It holds at each wavelength of `transport.wavelengths_nm`, or with bands over
    the whole range of wavelengths from the first band's beginning to the last one's end."""

    law: ClassVar[Emission] = "lambert"

    @property
    def region(self) -> Region:
        """The disk."""
        return Region(np.array(self.position_mm), self.radius_mm * self.axes[:2], "round")

    @property
    def place_in_words(self) -> str:
        """Its centre and radius."""
        return f"{super().place_in_words} with radius_mm = {self.radius_mm:g}"

    @property
    def spread_deg(self) -> float:
        """A half space."""
        return 90.0


class RectangleLight(_Directed):
    """A rectangle that shines to one side by Lambert's law, such as an LED panel, or by an angular profile."""

    kind: Literal["rectangle"] = "rectangle"
    """Kind of light."""
    position_mm: Vector
    """Centre, in mm."""
    width_mm: Positive
    """Extent along the part of the world's x axis that is square to `direction`, in mm; `turn_deg` turns it. Where
    `direction` is along x, it lies along y."""
    height_mm: Positive
    """Extent square to the width, in mm."""
    turn_deg: Number = 0.0
    """Turn of rectangle and profile about `direction`, in degrees, counter-clockwise as seen from behind the lamp. The
    eye there looks along `direction`."""
    power_w: Positive
    """Power into all directions together, in W. It holds at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: shape of the intensity over the directions, scaled to
    `power_w`. It is the same from each point. Its vertical angles start at `direction`, its horizontal ones at the
    width's axis. Omitted: Lambert's law."""

    law: ClassVar[Emission] = "lambert"

    @property
    def region(self) -> Region:
        """The rectangle."""
        return Region(np.array(self.position_mm), self.axes[:2] * [[0.5 * self.width_mm], [0.5 * self.height_mm]])

    @property
    def place_in_words(self) -> str:
        """Its centre and extents."""
        return f"{super().place_in_words} with width_mm = {self.width_mm:g} and height_mm = {self.height_mm:g}"

    @property
    def axes(self) -> Array:
        """Axes, (3, 3) float64: along the width, along the height, and the direction."""
        return axes_along(self.heading, self.turn_deg)

    @property
    def spread_deg(self) -> float:
        """A half space, or what a profile says."""
        return 90.0 if self.profile is None else 180.0

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return self.profile


class LineLight(_Shines):
    """A thin straight tube: each part of it shines by the sine of the angle from its axis."""

    kind: Literal["line"] = "line"
    """Kind of light."""
    start_mm: Vector
    """One end, in mm."""
    end_mm: Vector
    """The other end, in mm."""
    power_w: Positive
    """Power into all directions together, in W. It holds at each wavelength of `transport.wavelengths_nm`, or with
    bands over the whole range of wavelengths from the first band's beginning to the last one's end."""

    law: ClassVar[Emission] = "sine"

    @property
    def _way_mm(self) -> tuple[float, float, float]:
        (a, b, c), (x, y, z) = self.start_mm, self.end_mm
        return x - a, y - b, z - c

    @property
    def region(self) -> Region:
        """The line between its ends."""
        half = 0.5 * np.array(self._way_mm)
        return Region(np.array(self.start_mm) + half, np.array([half, np.zeros(3)]))

    @property
    def place_in_words(self) -> str:
        """Its ends."""
        return f"start_mm = {list(self.start_mm)} to end_mm = {list(self.end_mm)}"

    @property
    def axes(self) -> Array:
        """Axes, (3, 3) float64: two square to the tube, and the tube's own."""
        way = np.array(self._way_mm)
        return axes_along(way / np.linalg.norm(way), 0.0)

    def faults(self) -> Iterator[Fault]:
        """Yield ends in the same place, which tell no axis."""
        if not any(self._way_mm):
            yield Fault(("end_mm",), list(self.end_mm), "the same place as start_mm; a line has two ends")
        elif why := no_direction(self._way_mm):
            yield Fault(("end_mm",), list(self.end_mm), f"end_mm - start_mm {why}")


class SpotLight(_Directed):
    """A point that shines into a cone, evenly but for a soft edge, or by an angular profile."""

    kind: Literal["spot"] = "spot"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    half_angle_deg: HalfAngle | None = None
    """Angle between the cone's axis and its outer edge, in degrees, up to 180. Or give `profile`."""
    edge_deg: NonNegative = 0.0
    """Width of the soft edge inside the cone, in degrees; 0 is a sharp edge. The intensity falls to zero there,
    linearly in the cosine of the angle from the axis."""
    power_w: Positive
    """Power into the cone, in W. It holds at each wavelength of `transport.wavelengths_nm`, or with bands over the
    whole range of wavelengths from the first band's beginning to the last one's end."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: shape of the intensity over the directions, scaled to
    `power_w`. Its vertical angles start at `direction`, its horizontal ones at the side of +x (+y where `direction` is
    along x), counter-clockwise as seen from behind the lamp, by an eye that looks along `direction`. Or give
    `half_angle_deg`."""
    turn_deg: Number = 0.0
    """Turn of the profile about `direction`, counter-clockwise as seen from behind the lamp, in degrees."""

    law: ClassVar[Emission] = "cone"

    @property
    def region(self) -> Region:
        """The point."""
        return Region(np.array(self.position_mm))

    @property
    def axes(self) -> Array:
        """Axes of the profile, (3, 3) float64."""
        return axes_along(self.heading, self.turn_deg)

    @property
    def spread_deg(self) -> float:
        """The half angle of the cone, or what a profile says."""
        return 180.0 if self.half_angle_deg is None else self.half_angle_deg

    @property
    def even_deg(self) -> float:
        """The half angle of the cone inside its soft edge."""
        return self.spread_deg - self.edge_deg

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return self.profile

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


Light = Annotated[
    PointLight | DirectionalLight | DiskLight | RectangleLight | LineLight | SpotLight, Field(discriminator="kind")
]
