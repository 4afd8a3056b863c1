"""Light sources besides emitting targets, all in the world frame.

Properties describe every lamp alike: region, heading, angular spread and emission law.
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
from lfmesh.scene.motion import Motion
from lfmesh.scene.quantities import FilePath, NonNegative, Number, Positive, Vector, no_direction

Array = NDArray[np.float64]

HalfAngle = Annotated[float, Field(strict=True, gt=0, le=180)]

Emission = Literal["even", "cone", "lambert", "sine", "profile"]
"""Angular law of a lamp's intensity: even in all directions or in a cone, by the cosine or sine of the angle from its
axis, or tabulated."""


class LinearPolarisation(Model):
    """A field along a line.

    Its angle starts from the world's x axis, projected perpendicular to the ray (the y axis for a ray along x).
    """

    kind: Literal["linear"] = "linear"
    """Kind of polarisation."""
    angle_deg: Number
    """Angle of the field from the world's x axis, in degrees, counter-clockwise as seen by the receiver of the
    light."""

    @property
    def stokes(self) -> tuple[float, float, float]:
        """Q, U and V over I."""
        angle = math.radians(2.0 * self.angle_deg)
        return math.cos(angle), math.sin(angle), 0.0


class CircularPolarisation(Model):
    """A field that rotates."""

    kind: Literal["circular"] = "circular"
    """Kind of polarisation."""
    handedness: Literal["right", "left"] = "right"
    """Sense of rotation of the field: "right" is counter-clockwise as seen by the receiver (IEEE, IAU). "left":
    clockwise."""

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
    motion: Motion | None = None
    """Motion during the exposure; needs `[exposure]`. Omitted: it stands still."""

    law: ClassVar[Emission] = "even"

    @property
    def emission(self) -> Emission:
        """Angular law of the intensity."""
        return self.law if self.ies is None else "profile"

    @property
    def strength(self) -> float:
        """Power in W; of parallel light, irradiance in W/m²."""
        return cast(_InOnePlace, self).power_w

    @property
    def region(self) -> Region | None:
        """Emitting region; None for parallel light."""
        return None

    @property
    def place_in_words(self) -> str:
        """Position and size, as keys and values of a scene file."""
        return f"position_mm = {list(cast(_InOnePlace, self).position_mm)}"

    @property
    def axes(self) -> Array:
        """Unit axes, (3, 3) float64: two across the lamp, at a profile's horizontal angles 0 and 90, then its own."""
        return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])

    @property
    def heading(self) -> Array | None:
        """Central direction of the light, a unit vector (3,) float64; None if there is none."""
        return None

    @property
    def spread_deg(self) -> float:
        """Largest angle of the light from the heading, before a profile is read."""
        return 180.0

    @property
    def even_deg(self) -> float:
        """Half angle of the even part of a cone."""
        return self.spread_deg

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return None

    @property
    def state(self) -> "Polarisation | None":
        """Polarisation, or None for unpolarised light."""
        return None


class PointLight(_Shines):
    """A point that emits evenly in all directions, or by an angular profile."""

    kind: Literal["point"] = "point"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    power_w: Positive
    """Power into all directions together, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with
    bands to the whole range from the start of the first band to the end of the last."""
    polarisation: Polarisation | None = None
    """State of complete polarisation. Needs `transport.polarisation`. Omitted: unpolarised."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: angular shape of the intensity, scaled to `power_w`. Its
    vertical angles start at -y, down; its horizontal ones run from +x towards -z. Omitted: even."""
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
        """Yield a rotation without a profile to rotate."""
        if self.profile is None and any(self.rotation_deg):
            yield Fault(("rotation_deg",), list(self.rotation_deg), "turns a profile, but none is given; omit it")


class _Directed(_Shines):
    direction: Vector
    """Direction of the light; of any length from 1e-100 to 1e100."""

    @property
    def heading(self) -> Array:
        """Unit vector along `direction`, (3,) float64."""
        return np.array(self.direction) / np.linalg.norm(self.direction)

    @property
    def axes(self) -> Array:
        """Axes, (3, 3) float64, from `turns.axes_along`."""
        return axes_along(self.heading, 0.0)

    def faults(self) -> Iterator[Fault]:
        """Yield a vector that gives no direction."""
        if why := no_direction(self.direction):
            yield Fault(("direction",), list(self.direction), why)


class DirectionalLight(_Directed):
    """Parallel light from far away."""

    kind: Literal["directional"] = "directional"
    """Kind of light."""
    irradiance_w_m2: Positive
    """Irradiance of a plane perpendicular to the direction, in W/m². It applies at each wavelength of
    `transport.wavelengths_nm`, or with bands to the whole range from the start of the first band to the end of the
    last."""
    polarisation: Polarisation | None = None
    """State of complete polarisation. Needs `transport.polarisation`. Omitted: unpolarised."""

    @property
    def strength(self) -> float:
        """Irradiance, W/m²."""
        return self.irradiance_w_m2

    @property
    def spread_deg(self) -> float:
        """Zero: all light travels along the direction."""
        return 0.0

    @property
    def state(self) -> Polarisation | None:
        """State of polarisation."""
        return self.polarisation


class DiskLight(_Directed):
    """A disk that emits to one side by Lambert's law."""

    kind: Literal["disk"] = "disk"
    """Kind of light."""
    position_mm: Vector
    """Centre, in mm."""
    radius_mm: Positive
    """Radius, in mm."""
    power_w: Positive
    """Power into its half space, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with bands to
    the whole range from the start of the first band to the end of the last."""

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
        """90, a half space."""
        return 90.0


class RectangleLight(_Directed):
    """A rectangle that emits to one side by Lambert's law, such as an LED panel, or by an angular profile."""

    kind: Literal["rectangle"] = "rectangle"
    """Kind of light."""
    position_mm: Vector
    """Centre, in mm."""
    width_mm: Positive
    """Extent along the world's x axis, projected perpendicular to `direction`, in mm; `turn_deg` turns it. For a
    `direction` along x it lies along y."""
    height_mm: Positive
    """Extent perpendicular to the width, in mm."""
    turn_deg: Number = 0.0
    """Turn of rectangle and profile about `direction`, in degrees, counter-clockwise as seen from behind the lamp,
    looking along `direction`."""
    power_w: Positive
    """Power into all directions together, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with
    bands to the whole range from the start of the first band to the end of the last."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: angular shape of the intensity, scaled to `power_w`, the
    same at each point. Its vertical angles start at `direction`, its horizontal ones at the width's axis. Omitted:
    Lambert's law."""

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
        """90, a half space; 180 with a profile."""
        return 90.0 if self.profile is None else 180.0

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return self.profile


class LineLight(_Shines):
    """A thin straight tube: each part of it emits by the sine of the angle from its axis."""

    kind: Literal["line"] = "line"
    """Kind of light."""
    start_mm: Vector
    """One end, in mm."""
    end_mm: Vector
    """The other end, in mm."""
    power_w: Positive
    """Power into all directions together, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with
    bands to the whole range from the start of the first band to the end of the last."""

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
        """Axes, (3, 3) float64: two perpendicular to the tube, then along it."""
        way = np.array(self._way_mm)
        return axes_along(way / np.linalg.norm(way), 0.0)

    def faults(self) -> Iterator[Fault]:
        """Yield coincident ends, which define no axis."""
        if not any(self._way_mm):
            yield Fault(("end_mm",), list(self.end_mm), "must differ from start_mm: a line has two ends")
        elif why := no_direction(self._way_mm):
            yield Fault(("end_mm",), list(self.end_mm), f"end_mm - start_mm {why}")


class SpotLight(_Directed):
    """A point that emits into a cone, evenly up to a soft edge, or by an angular profile."""

    kind: Literal["spot"] = "spot"
    """Kind of light."""
    position_mm: Vector
    """Position, in mm."""
    half_angle_deg: HalfAngle | None = None
    """Angle between the cone's axis and its outer edge, in degrees, up to 180. Or give `profile`."""
    edge_deg: NonNegative = 0.0
    """Width of the soft edge inside the cone, in degrees; 0 is a sharp edge. The intensity falls to zero across it,
    linearly in the cosine of the angle from the axis."""
    power_w: Positive
    """Power into the cone, in W. It applies at each wavelength of `transport.wavelengths_nm`, or with bands to the
    whole range from the start of the first band to the end of the last."""
    profile: FilePath | None = None
    """IES file (LM-63, type C), relative to the scene file: angular shape of the intensity, scaled to `power_w`. Its
    vertical angles start at `direction`. Its horizontal ones start towards +x (+y for a `direction` along x) and run
    counter-clockwise as seen from behind the lamp, looking along `direction`. Or give `half_angle_deg`."""
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
        """Half angle of the cone; 180 with a profile."""
        return 180.0 if self.half_angle_deg is None else self.half_angle_deg

    @property
    def even_deg(self) -> float:
        """Half angle of the cone inside its soft edge."""
        return self.spread_deg - self.edge_deg

    @property
    def ies(self) -> str | None:
        """File of the angular profile."""
        return self.profile

    def faults(self) -> Iterator[Fault]:
        """Yield a cone that is missing, given twice, or narrower than its soft edge."""
        yield from super().faults()
        if self.profile is None:
            if self.half_angle_deg is None:
                yield Fault(("half_angle_deg",), None, "missing: give the half angle of the cone, or profile")
            elif self.edge_deg > self.half_angle_deg:
                yield Fault(("edge_deg",), self.edge_deg, f"must be at most half_angle_deg = {self.half_angle_deg:g}")
            if self.turn_deg:
                yield Fault(("turn_deg",), self.turn_deg, "turns a profile, but none is given; omit it")
        else:
            if self.half_angle_deg is not None:
                yield Fault(("half_angle_deg",), self.half_angle_deg, "a profile is given too; give one of them")
            if self.edge_deg:
                yield Fault(("edge_deg",), self.edge_deg, "softens a cone, but a profile is given; omit it")


Light = Annotated[
    PointLight | DirectionalLight | DiskLight | RectangleLight | LineLight | SpotLight, Field(discriminator="kind")
]
