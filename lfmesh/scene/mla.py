"""The microlens array: plano-convex (or plano-concave) lenslets on one plate."""

import math
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from lfmesh.optics.glass import Medium
from lfmesh.scene.coatings import UNCOATED
from lfmesh.scene.finishes import POLISHED, AnyFinish, both_given
from lfmesh.scene.literals import at_least
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.own_glass import Glass
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import Index, NonNegative, Number, OneOrMore, Pair, Positive, Text, Whole


class ArrayForm(Model):
    """Manufacturing error of the array; each is an rms over lenslets, drawn from `seed`."""

    pitch_error: Number = Field(default=0.0, gt=-0.5, lt=0.5)
    """Relative error of the pitch, the same over the whole array (no unit)."""
    decenter_mm: NonNegative = 0.0
    """Rms shift of a lenslet's axis in each of x and y, in mm."""
    radius_error: NonNegative = Field(default=0.0, lt=0.5)
    """Rms relative error of a lenslet's radius of curvature (no unit)."""
    seed: Whole = 0
    """Which array of this quality: the random errors follow from it alone."""

    @property
    def is_perfect(self) -> bool:
        """Whether every lenslet is as designed."""
        return not (self.pitch_error or self.decenter_mm or self.radius_error)


class MicrolensArray(Model):
    """A plate with one curved and one flat face."""

    layout: Literal["square", "hexagonal"] = "square"
    """"square", or "hexagonal": rows pitch · √3/2 apart, every second one shifted by half a pitch."""
    count: Pair
    """Number of lenslets: columns, rows."""
    pitch_mm: Positive
    """Distance between the centres of neighbouring lenslets, in mm."""
    focal_length_mm: OneOrMore | None = None
    """Focal length of a lenslet in air, in mm; a list of up to 3 makes a multi-focus array. Or give
    `radius_mm`."""
    radius_mm: OneOrMore | None = None
    """Radius of the curved face, in mm: positive converges, whichever way the face looks; a list as above."""
    index: Index | None = None
    """Refractive index of the plate. Or give `glass`."""
    glass: Glass | None = None
    """Glass of the plate: of the catalogue, like "SCHOTT/N-BK7", or by its dispersion, like { nd = 1.5168,
    vd = 64.17 }."""
    thickness_mm: Positive
    """From the apex of the curved face to the flat face, in mm."""
    curved_coating: Text = UNCOATED
    """Name of the coating of the curved face, or "none": bare."""
    flat_coating: Text = UNCOATED
    """Name of the coating of the flat face, or "none": bare."""
    curved_finish: AnyFinish = POLISHED
    """Finish of the curved face: "polished", "diffuse" or { kind = "ground", roughness = 0.1 }."""
    flat_finish: AnyFinish = POLISHED
    """Finish of the flat face."""
    curved_side: Literal["lens", "sensor"] = "lens"
    """Which way the curved face looks."""
    distance_mm: Positive | None = None
    """From the last lens vertex to the array's face nearest the lens (the apexes where the curved face looks
    there), in mm. Omitted: solved from `focus_mm`."""
    pose: Pose = Field(default_factory=Pose)
    """Installation error, about the array's centre."""
    form: ArrayForm = Field(default_factory=ArrayForm)
    """Manufacturing error."""

    @property
    def medium(self) -> Medium:
        """What the plate is made of: an index or the name of a glass."""
        return self.index if self.index is not None else self.glass or 1.0

    @property
    def types(self) -> int:
        """How many kinds of lenslet the array has."""
        return len(self.radius_mm or self.focal_length_mm or ())

    @property
    def row_pitch_mm(self) -> float:
        """Distance between rows of lenslets, in mm."""
        return self.pitch_mm * (math.sqrt(3) / 2 if self.layout == "hexagonal" else 1.0)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the array, in mm."""
        return self.count[0] * self.pitch_mm, self.count[1] * self.row_pitch_mm

    @property
    def corner_mm(self) -> float:
        """From a lenslet's axis to the farthest corner of its cell, in mm."""
        return self.pitch_mm / math.sqrt(3.0 if self.layout == "hexagonal" else 2.0)

    def cap_fault(self, radius_mm: float, scale: float = 1.0) -> str | None:
        """Return why a face of this radius cannot be cut into the plate, and what can; None if it can.

        Parameters
        ----------
        radius_mm : float
        scale : float
            What the user gives, over the radius.
        """
        if abs(radius_mm) < self.corner_mm:
            return (
                f"a sphere of radius {abs(radius_mm):.6g} mm does not reach the corner of its cell, "
                f"{self.corner_mm:.6g} mm from the axis: {self._least(radius_mm, scale)} or a smaller pitch_mm"
            )
        depth = abs(radius_mm) - math.sqrt(radius_mm**2 - self.corner_mm**2)
        if radius_mm > 0 and depth > self.thickness_mm:
            return (
                f"the curved face is {depth:.6g} mm deep at the corner of its cell, more than "
                f"thickness_mm = {self.thickness_mm:g}: a plate of {at_least(depth)} mm or more, or "
                f"{self._least(radius_mm, scale)}"
            )
        return None

    def _least(self, radius_mm: float, scale: float) -> str:
        """Return in words the smallest radius of this sign, or what it follows from by `scale`, that a face can have.

        Of a cap as deep as the plate, R = (corner² + t²) / 2t, if that is less than half a sphere.
        """
        corner, thickness = self.corner_mm, self.thickness_mm
        least = (corner**2 + thickness**2) / (2 * thickness) if radius_mm > 0 and thickness < corner else corner
        # As much as the rounding of the sagitta of a deep cap.
        words = at_least(abs(scale) * least * (1 + 1e-9))
        return f"give {words} or more" if radius_mm * scale > 0 else f"give -{words} or less"

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between the fields."""
        yield from both_given(self.curved_coating, self.curved_finish, "curved_finish")
        yield from both_given(self.flat_coating, self.flat_finish, "flat_finish")
        if self.radius_mm is not None and self.focal_length_mm is not None:
            yield Fault(("focal_length_mm",), list(self.focal_length_mm), "radius_mm is given too; give one of them")
        elif self.radius_mm is None and self.focal_length_mm is None:
            yield Fault(("focal_length_mm",), None, "missing: give focal_length_mm or radius_mm")
        for radius in self.radius_mm or ():
            if why := self.cap_fault(radius):
                yield Fault(("radius_mm",), radius, why)
        yield from self._medium_faults()

    def _medium_faults(self) -> Iterator[Fault]:
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the plate's index, or glass")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        elif self.index == 1:
            yield Fault(("index",), self.index, "must be above 1: a plate of air bends no light")
