"""The microlens array: spherical, aspheric or cylindrical lenslets on one or both faces of a plate."""

import math
from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from lfmesh.optics.glass import Medium
from lfmesh.scene.camera.back_face import BackFace
from lfmesh.scene.camera.gradient import AnyGradient, Gradient
from lfmesh.scene.camera.gradient_faults import BESIDE_GRADIENT, gradient_beside, rough_beside_gradient
from lfmesh.scene.camera.lenslet_depth import cell_corner_mm, highest_and_deepest_mm, profile_words
from lfmesh.scene.camera.per_type import ConicPerType, RadiusPerType, TermsPerType
from lfmesh.scene.camera.phase import AnyPhase, Phase
from lfmesh.scene.literals import at_least, counted
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.finishes import POLISHED, AnyFinish, both_given, rough_phase
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import (
    Index,
    NonNegative,
    Number,
    OneOrMore,
    Pair,
    Positive,
    Text,
    Whole,
)


class ArrayForm(Model):
    """Manufacturing errors of the array; rms values over lenslets, drawn from `seed`."""

    pitch_error: Number = Field(default=0.0, gt=-0.5, lt=0.5)
    """Relative error of the pitch, the same over the whole array (no unit)."""
    decenter_mm: NonNegative = 0.0
    """Rms shift of a lenslet's axis in each of x and y, in mm."""
    radius_error: NonNegative = Field(default=0.0, lt=0.5)
    """Rms relative error of a lenslet's radius of curvature (no unit)."""
    seed: Whole = 0
    """Random seed: identifies one array of this quality."""


class MicrolensArray(Model):
    """A plate with one curved face; the other one is flat or curved. With a phase or gradient, both may be flat."""

    layout: Literal["square", "hexagonal"] = "square"
    """Grid of the lenslets; "hexagonal": rows pitch · √3/2 apart, every second one shifted by half a pitch."""
    count: Pair
    """Number of lenslets: columns, rows."""
    pitch_mm: Positive
    """Distance between the centres of neighbouring lenslets, in mm."""
    focal_length_mm: OneOrMore | None = None
    """Focal length of a lenslet in air, in mm, whatever medium it is immersed in; a list of up to 3 makes a multi-focus
    array. Or give `radius_mm`. It is that of the curved face alone, without phases."""
    radius_mm: RadiusPerType | None = None
    """Radius of the curved face, in mm: positive converges, whichever way the face looks; a list: one per type. Or give
    `focal_length_mm`. Omitted beside `curved_phase` or `gradient`: inf, flat."""
    conic: ConicPerType = (0.0,)
    """Conic constant of the lenslets: 0 sphere, −1 paraboloid, below −1 hyperboloid; a list: one per type."""
    asphere_mm: TermsPerType = ((),)
    """Even aspheric coefficients of r⁴, r⁶, ..., in mm⁻³, mm⁻⁵, ..., positive into the glass; a list of lists: one per
    type."""
    cylinder_axis: Literal["x", "y"] | None = None
    """Axis of cylindrical lenslets: "y" along the columns, "x" along the rows of a square layout, as in a lenticular
    sheet. Omitted: surfaces of revolution."""
    clear_diameter_mm: Positive | None = None
    """Diameter of round clear apertures in an opaque mask on the curved face, in mm, at most the pitch. Each is centred
    in its cell. Omitted: the whole cell is clear."""
    index: Index | None = None
    """Refractive index of the plate. Or give `glass`."""
    glass: Glass | None = None
    """Glass of the plate: a catalogue name such as "SCHOTT/N-BK7", or a dispersion such as { nd = 1.5168,
    vd = 64.17 }."""
    gradient: AnyGradient | None = None
    """Gradient-index glass of the plate, about the axis of each lenslet, such as { kind = "radial_n2", index = 1.6,
    coefficients = [-0.09] }. z is 0 at the apex of the face towards the lens. Replaces `index` and `glass`; needs
    `radius_mm`, or flat faces. Omitted: a homogeneous plate."""
    walls: Literal["absorb", "clear"] = "absorb"
    """Walls between the cells of a plate with a `gradient`: "absorb" light, as between rods, or "clear": let it pass
    into the next cell. The glass of both cells must then be the same at their wall."""
    thickness_mm: Positive
    """Thickness from the apex of the curved face to the flat face, or to the apexes of `back`, in mm."""
    curved_coating: Text = UNCOATED
    """Name of the coating of the curved face, or "none": bare."""
    flat_coating: Text = UNCOATED
    """Name of the coating of the flat face, or of `back`; "none": bare."""
    curved_finish: AnyFinish = POLISHED
    """Finish of the curved face: "polished", "diffuse" or { kind = "ground", roughness = 0.1 }."""
    flat_finish: AnyFinish = POLISHED
    """Finish of the flat face, or of `back`: as `curved_finish`."""
    curved_phase: AnyPhase | None = None
    """Phase of the curved face, about the apex of each lenslet, in x and y of the array. Without `radius_mm` and
    `focal_length_mm` the face is flat: a metalens array. Omitted: none."""
    flat_phase: AnyPhase | None = None
    """Phase of the flat face, or of `back`: as `curved_phase`. Omitted: none."""
    curved_side: Literal["lens", "sensor"] = "lens"
    """Side of the curved face: towards the lens, or towards the sensor."""
    back: BackFace | None = None
    """Lenslets on the other face too, one behind each lenslet of the curved face, such as { radius_mm = 0.5 }. The
    curved face then needs `radius_mm`. Omitted: the other face is flat."""
    distance_mm: Positive | None = None
    """Distance from the last lens vertex to the array's face nearest the lens, in mm. If that is the curved face, the
    distance ends at the apexes. Omitted: solved from `focus_mm`."""
    pose: Pose = Field(default_factory=Pose)
    """Installation error: a motion about the array's centre."""
    form: ArrayForm = Field(default_factory=ArrayForm)
    """Manufacturing errors of pitch, centres and radii."""

    @property
    def medium(self) -> Medium:
        """Material of the plate: an index, a glass or a gradient."""
        return self.index if self.index is not None else self.gradient or self.glass or 1.0

    @property
    def types(self) -> int:
        """Number of lenslet types."""
        return len(self.radius_mm or self.focal_length_mm or self.radii_mm)

    @property
    def radii_mm(self) -> tuple[float, ...]:
        """Known radii of the curved face, by type: `radius_mm`, or inf for a flat face with a phase or gradient."""
        if self.radius_mm is None and self.focal_length_mm is None and self._may_be_flat:
            return (math.inf,)
        return self.radius_mm or ()

    @property
    def _may_be_flat(self) -> bool:
        return self.curved_phase is not None or self.gradient is not None

    @property
    def phases(self) -> dict[str, Phase]:
        """Phases of the faces, by key."""
        given = {"curved_phase": self.curved_phase, "flat_phase": self.flat_phase}
        return {key: phase for key, phase in given.items() if phase is not None}

    @property
    def row_pitch_mm(self) -> float:
        """Distance between rows of lenslets."""
        return self.pitch_mm * (math.sqrt(3) / 2 if self.layout == "hexagonal" else 1.0)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the array."""
        return self.count[0] * self.pitch_mm, self.count[1] * self.row_pitch_mm

    @property
    def corner_mm(self) -> float:
        """Distance from a lenslet's axis, or a cylinder's line of apexes, to the farthest corner of its cell."""
        return cell_corner_mm(self.pitch_mm, self.layout, self.cylinder_axis)

    @property
    def has_back(self) -> bool:
        """True if both faces have lenslets."""
        return self.back is not None and not self.back.is_flat

    @property
    def both_faces_act(self) -> bool:
        """True if the optics of a lenslet need both faces: lenslets on both, a phase or a gradient."""
        return self.has_back or bool(self.phases) or self.gradient is not None

    @property
    def bends_by_shape_alone(self) -> bool:
        """True if the lenslets have power by the shape of their glass alone, without a phase or gradient."""
        return not self.phases and self.gradient is None

    @property
    def main_section(self) -> Literal["x", "y"]:
        """Section with the power of the curved face, or the larger power of a gradient; phases are not considered."""
        if self.cylinder_axis is not None:
            return "y" if self.cylinder_axis == "x" else "x"
        in_x, in_y = self.gradient.curvatures if self.gradient is not None else (0.0, 0.0)
        return "y" if abs(in_y) > abs(in_x) else "x"

    @property
    def frame_side(self) -> Literal["lens", "sensor"]:
        """Side with the origin of the array's frame: that of the curved face, or the sensor's if both turn light."""
        return "sensor" if self.turns_twice else self.curved_side

    @property
    def turns_twice(self) -> bool:
        """True if light also depends on the cells of the opposite face: lenslets, a phase or a gradient-index plate."""
        return self.has_back or self.flat_phase is not None or self.gradient is not None

    def profile_of(self, kind: int) -> tuple[float, tuple[float, ...]]:
        """Return the conic constant and the even terms of a lenslet type.

        Parameters
        ----------
        kind : int
            Lenslet type, from 0.

        Returns
        -------
        conic : float
        terms_mm : tuple of float
            Coefficients of r⁴, r⁶, ...
        """
        conic = self.conic[kind if len(self.conic) > 1 else 0]
        return conic, self.asphere_mm[kind if len(self.asphere_mm) > 1 else 0]

    @property
    def profile_words(self) -> str:
        """Shape of non-spherical lenslets, such as "aspheres" or "cylinders along y", else ""."""
        return profile_words(self.conic, self.asphere_mm, self.cylinder_axis)

    def cap_fault(self, radius_mm: float, scale: float = 1.0, kind: int = 0) -> str | None:
        """Return why a face of this radius cannot be cut into the plate and what can, or None if it can.

        Parameters
        ----------
        radius_mm : float
        scale : float
            Ratio of the user's value to the radius.
        kind : int
            Lenslet type, for conic constant and terms.

        Returns
        -------
        str or None
        """
        if kind < self.types and (self.profile_of(kind)[0] or any(self.profile_of(kind)[1])):
            return self._profile_fault(radius_mm, *self.profile_of(kind))
        if math.isinf(radius_mm):
            return None
        if abs(radius_mm) < self.corner_mm:
            return (
                f"a sphere of radius {abs(radius_mm):.6g} mm does not reach the corner of its cell, "
                f"{self.corner_mm:.6g} mm from the axis: give a pitch_mm below {self.pitch_mm:g}, or here "
                f"{self._least(radius_mm, scale)}"
            )
        depth = abs(radius_mm) - math.sqrt(radius_mm**2 - self.corner_mm**2)
        if radius_mm > 0 and depth > self.thickness_mm:
            return (
                f"the curved face is {depth:.6g} mm deep at the corner of its cell, more than "
                f"thickness_mm = {self.thickness_mm:g}: give a plate of {at_least(depth)} mm or more, or here "
                f"{self._least(radius_mm, scale)}"
            )
        return None

    def _profile_fault(self, radius_mm: float, conic: float, terms: tuple[float, ...]) -> str | None:
        """Return why a conic with even terms cannot be cut into the plate, or None if it can."""
        corner = self.corner_mm
        if (1 + conic) * corner**2 >= radius_mm**2:
            return (
                f"with conic = {conic:g} and a radius of {abs(radius_mm):.6g} mm the lenslets end "
                f"{abs(radius_mm) / math.sqrt(1 + conic):.6g} mm from the axis, before the corner of their cells, "
                f"{corner:.6g} mm from it: give a larger radius or a smaller pitch_mm"
            )
        high, deep = highest_and_deepest_mm(radius_mm, conic, terms, corner)
        if not deep <= self.thickness_mm:
            return (
                f"with conic and asphere_mm the curved face is up to {deep:.6g} mm deep in its cell, more than "
                f"thickness_mm = {self.thickness_mm:g}: give a thicker plate, a larger radius or smaller coefficients"
            )
        if not high <= self.pitch_mm:
            return (
                f"with conic and asphere_mm the curved face rises up to {high:.6g} mm over its apexes, more than "
                f"pitch_mm = {self.pitch_mm:g}: give a larger radius or smaller coefficients"
            )
        return None

    def _profile_faults(self) -> Iterator[Fault]:
        """Yield faults of the lenslet profiles."""
        for key, given in (("conic", self.conic), ("asphere_mm", self.asphere_mm)):
            if len(given) > 1 and len(given) != self.types:
                types = counted(self.types, "lenslet type")
                why = f"{len(given)} are given for {types}; give one for each, or one for all"
                yield Fault((key,), list(given), why)
        if self.cylinder_axis is not None and self.layout != "square":
            yield Fault(("cylinder_axis",), self.cylinder_axis, 'cylinders need layout = "square"')

    def _mask_faults(self) -> Iterator[Fault]:
        """Yield faults of the clear apertures."""
        clear = self.clear_diameter_mm
        if clear is not None and self.cylinder_axis is not None:
            yield Fault(("clear_diameter_mm",), clear, "cylinders have no round apertures: omit it")
        elif clear is not None and clear > self.pitch_mm:
            yield Fault(("clear_diameter_mm",), clear, f"at most pitch_mm = {self.pitch_mm:g}: wider circles overlap")

    def _least(self, radius_mm: float, scale: float) -> str:
        """Describe the smallest radius of this sign that a face can have, times `scale`.

        R = (corner² + t²) / 2t of a cap as deep as the plate, if that is less than a hemisphere.
        """
        corner, thickness = self.corner_mm, self.thickness_mm
        least = (corner**2 + thickness**2) / (2 * thickness) if radius_mm > 0 and thickness < corner else corner
        # Allows for rounding of the sagitta of a deep cap.
        words = at_least(abs(scale) * least * (1 + 1e-9))
        return f"{words} or more" if radius_mm * scale > 0 else f"-{words} or less"

    def faults(self) -> Iterator[Fault]:
        """Yield faults between fields."""
        yield from both_given(self.curved_coating, self.curved_finish, "curved_finish")
        yield from both_given(self.flat_coating, self.flat_finish, "flat_finish")
        yield from rough_phase(self.curved_phase, self.curved_finish, "curved_phase")
        yield from rough_phase(self.flat_phase, self.flat_finish, "flat_phase")
        if self.radius_mm is not None and self.focal_length_mm is not None:
            yield Fault(("focal_length_mm",), list(self.focal_length_mm), "radius_mm is given too; give one of them")
        elif not self.radii_mm and self.focal_length_mm is None:
            yield Fault(
                ("focal_length_mm",), None, "missing: give focal_length_mm, radius_mm, curved_phase or gradient"
            )
        if not self._may_be_flat and math.inf in self.radii_mm:
            yield Fault(
                ("radius_mm",), math.inf, "a flat face bends no light: give a radius, or curved_phase or gradient too"
            )
        shapes = list(self._profile_faults())
        for kind, radius in enumerate(self.radii_mm if not shapes else ()):
            if why := self.cap_fault(radius, kind=kind):
                shapes.append(Fault(("radius_mm",), radius, why))
        yield from shapes
        yield from self._mask_faults()
        if self.back is not None:
            yield from self._back_faults(self.back, sound=not shapes)
        yield from self._medium_faults()
        yield from self._gradient_faults()

    def _back_faults(self, back: BackFace, *, sound: bool) -> Iterator[Fault]:
        """Yield faults of the second face; `sound` is True if the shape of the first has none."""
        if self.focal_length_mm is not None and not back.is_flat:
            why = "with camera.mla.back a focal length does not determine the radius of each face: give radius_mm"
            yield Fault(("focal_length_mm",), list(self.focal_length_mm), why)
        depth = None
        if sound and self.radii_mm:
            corner = self.corner_mm
            each = [highest_and_deepest_mm(r, *self.profile_of(k), corner)[1] for k, r in enumerate(self.radii_mm)]
            depth = max(each)
        yield from back.faults_in(self.layout, self.pitch_mm, self.thickness_mm, depth)

    def _gradient_faults(self) -> Iterator[Fault]:
        """Yield keys that exclude a gradient, and walls without one."""
        if self.gradient is None:
            if self.walls != "absorb":
                yield Fault(("walls",), self.walls, "omit it: only a plate with a gradient has walls between its cells")
            return
        yield from gradient_beside(self.gradient, self.index, self.glass)
        if self.focal_length_mm is not None:
            why = "with a gradient the whole plate has the focal length: give radius_mm, or omit it for a flat face"
            yield Fault(("focal_length_mm",), list(self.focal_length_mm), why)
        for key, finish in (("curved_finish", self.curved_finish), ("flat_finish", self.flat_finish)):
            yield from rough_beside_gradient(finish, (key,))
        for key in self.phases:
            yield Fault((key,), None, BESIDE_GRADIENT)
        if self.walls == "clear" and (differ := self._different_cells(self.gradient)):
            why = f'{differ}, so that neighbouring cells differ at their wall, where light is not divided; use "absorb"'
            yield Fault(("walls",), self.walls, why)
        if self.back is not None and any(self.back.decenter_mm):
            why = "with a gradient the cells of both faces lie opposite each other: omit it"
            yield Fault(("back", "decenter_mm"), list(self.back.decenter_mm), why)

    def _different_cells(self, gradient: Gradient) -> str:
        """Return why the glass on both sides of a wall is not the same, or ""."""
        if not (gradient.of_revolution if self.layout == "hexagonal" else gradient.symmetric):
            return "the gradient is not symmetric about the walls"
        if self.types > 1:
            return f"there are {self.types} types of lenslets"
        errors = {"decenter_mm": self.form.decenter_mm, "radius_error": self.form.radius_error}
        return next((f"form.{key} = {error:g} varies from cell to cell" for key, error in errors.items() if error), "")

    def _medium_faults(self) -> Iterator[Fault]:
        if self.gradient is not None:
            return
        if self.index is None and self.glass is None:
            yield Fault(("index",), None, "missing: give the plate's index, glass or gradient")
        elif self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        elif self.index == 1 and (self.bends_by_shape_alone or self.focal_length_mm is not None):
            yield Fault(("index",), self.index, "must be above 1: a plate of air bends no light without a phase")
