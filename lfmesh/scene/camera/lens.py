"""The main lens: a list of surfaces, from the object to the sensor."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import zip_longest
from typing import ClassVar, get_args

import numpy as np
from pydantic import Field

from lfmesh.optics.bounds import ACROSS, SAG, Range, profile_range
from lfmesh.optics.glass import AIR, Medium
from lfmesh.scene.camera.gaps import least_gap_mm, rim_gap_mm, touching_mm
from lfmesh.scene.camera.qbfs import EvenForm, Qbfs
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS, Qcon, within_floats
from lfmesh.scene.camera.sections import (
    Biconic,
    Form,
    Heights,
    Toroid,
    reach_of_conic_mm,
)
from lfmesh.scene.literals import at_least, at_most
from lfmesh.scene.materials.coatings import UNCOATED, Coating
from lfmesh.scene.materials.finishes import POLISHED, AnyFinish, both_given
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.objects.refractor import MeshFace, Refractor
from lfmesh.scene.pose import Pose
from lfmesh.scene.quantities import (
    LARGEST,
    Coefficient,
    Count,
    Flag,
    FocalLength,
    GlassName,
    Index,
    NonNegative,
    Number,
    Positive,
    Radius,
    Text,
    Whole,
)

MOST_TILT_DEG = 45.0
"""Angle between the axis of a posed element and that of the lens, which a pose must stay below: light that comes along
the axis of the lens then still crosses the element's surfaces in their order."""

STOP_SIZES = ("stop_semi_diameter_mm", "f_number", "epd_mm")
"""Keys that give the stop its size in place of the prescription."""


class Surface(Model):
    """An interface, and what follows it; without curvature and without glass on either side, a pure stop."""

    radius_mm: Radius = math.inf
    """Radius of curvature at the vertex, in mm: positive when the centre lies towards the sensor; inf is
    flat."""
    thickness_mm: NonNegative | None = None
    """Distance from this vertex to the next, in mm. Omitted: at the last surface only."""
    index: Index | None = None
    """Refractive index behind the surface. Or give `glass`. Omitted: air; behind a flat stop that is the first surface,
    the lens's object medium."""
    glass: Glass | None = None
    """Glass behind the surface: of the catalogue, like "SCHOTT/N-BK7", or by its dispersion, like { nd = 1.5168, vd =
    64.17 }."""
    semi_diameter_mm: Positive | None = None
    """Radius of the clear aperture, in mm. A stop may omit it whose size `stop_semi_diameter_mm`, `f_number` or
    `epd_mm` sets. Where a stop is marked, the others may, too: they then pass the whole beam of every point of the
    picture, with 5 % to spare, unless the surface ends or meets its neighbour before. Omitted: as wide as the beams by
    paraxial rays."""
    stop: Flag = False
    """Mark of the aperture stop."""
    coating: Text = UNCOATED
    """Name of a coating of the scene or of the lens, or "none": bare."""
    finish: AnyFinish = POLISHED
    """Finish: "polished", "diffuse" or { kind = "ground", roughness = 0.1 }."""
    conic: Number = 0.0
    """Conic constant: 0 sphere, −1 paraboloid, below −1 hyperboloid, above −1 ellipsoid."""
    asphere_mm: tuple[Coefficient, ...] = Field(default=(), max_length=MOST_ASPHERE_TERMS)
    """Even aspheric coefficients of r⁴, r⁶, r⁸, ..., in mm⁻³, mm⁻⁵, ...; of a toroid those of y⁴, y⁶, .... The sag is
    in mm."""
    odd_asphere_mm: tuple[Coefficient, ...] = Field(default=(), max_length=MOST_ASPHERE_TERMS)
    """Odd aspheric coefficients of r³, r⁵, r⁷, ..., in mm⁻², mm⁻⁴, ..., beside the even ones. None of r: that would be
    a cone, without a normal at the vertex."""
    qcon: Qcon | None = None
    """Forbes' strong asphere, such as { norm_radius_mm = 5.0, coefficients_mm = [0.1, -0.02] }. In place of, or beside,
    `asphere_mm`."""
    qbfs: Qbfs | None = None
    """Forbes' mild asphere, with the keys of `qcon`, without `asphere_mm` and `qcon`. It is a deviation along the
    normal of the sphere of `radius_mm`, which is then the best-fit sphere, or of its `conic`. At the vertex the surface
    has another radius."""

    biconic: Biconic | None = None
    """Radius and conic constant of the section x–z, such as { radius_x_mm = 40.0, conic_x = -1.0 }. `radius_mm` and
    `conic` are then those of the section y–z."""
    toroid: Toroid | None = None
    """Circle in the section x–z, such as { radius_x_mm = 40.0 }: the section y–z turns about a line parallel to y. The
    curve of `radius_mm`, `conic` and `asphere_mm` (of y⁴, y⁶, ...) is the section y–z. With inf it is shifted along x:
    a cylinder."""

    paraxial: Flag = False
    """Ideal thin lens in place of an interface: flat, in air, without reflections. Needs `focal_length_mm`."""
    focal_length_mm: FocalLength | None = None
    """Focal length of a `paraxial` surface, in mm: positive converges, negative diverges; inf does not bend light."""

    refractor: Refractor | None = None
    """A whole element in place of a surface: its shape is a mesh, its axis the mesh's z axis. Beside it only
    `thickness_mm`, the distance from its last vertex to the next surface, and `semi_diameter_mm` are given."""
    mesh: MeshFace | None = None
    """Mesh that gives this surface its real shape; radius and asphere are its best fit, for first-order optics."""

    @property
    def medium(self) -> Medium:
        """Material behind the surface: an index, the name of a glass, or None for air."""
        if self.index is not None:
            return None if self.index == AIR else self.index
        return self.glass

    @property
    def is_flat(self) -> bool:
        """True where the surface is flat all round, whatever its shape."""
        bare = self.curvature_per_mm == self.curvature_x_per_mm == 0 and not any(a for _, a in self.powers_mm)
        return bare and (self.form is None or self.form.is_flat(self))

    @property
    def is_plain_stop(self) -> bool:
        """True for a flat stop of which no medium is given."""
        given = (self.index, self.glass, self.mesh, self.refractor)
        return self.stop and self.is_flat and not self.paraxial and all(each is None for each in given)

    @property
    def curvature_per_mm(self) -> float:
        """Curvature at the vertex; 0 for a flat surface."""
        return 0.0 if math.isinf(self.vertex_radius_mm) else 1.0 / self.vertex_radius_mm

    @property
    def vertex_radius_mm(self) -> float:
        """Radius of curvature at the vertex: `radius_mm`, where no `qbfs` deviates from it there."""
        form = self._qbfs_form
        return self.radius_mm if form is None else form.radius_mm

    @property
    def vertex_conic(self) -> float:
        """Conic constant of the conic that `terms_mm` are added to."""
        form = self._qbfs_form
        return self.conic if form is None else form.conic

    @property
    def _qbfs_form(self) -> EvenForm | None:
        if self.qbfs is None:
            return None
        return self.qbfs.even_form(1.0 / self.radius_mm, self.conic, self.semi_diameter_mm)

    @property
    def terms_mm(self) -> tuple[float, ...]:
        """Coefficients of r⁴, r⁶, ... of all that the surface deviates from its conic by, in mm⁻³, mm⁻⁵, ..."""
        form = self._qbfs_form
        if form is not None:
            return form.asphere_mm
        if self.qcon is None:
            return self.asphere_mm
        return tuple(a + b for a, b in zip_longest(self.asphere_mm, self.qcon.asphere_mm, fillvalue=0.0))

    @property
    def terms_key(self) -> str:
        """Name of the key that `terms_mm` come from."""
        return "qbfs" if self.qbfs is not None else "asphere_mm" if self.qcon is None else "qcon"

    @property
    def thin_lens_power_per_mm(self) -> float:
        """Power of a `paraxial` surface, 1/mm; 0 for every other."""
        return 0.0 if self.focal_length_mm is None else 1.0 / self.focal_length_mm

    @property
    def curvature_x_per_mm(self) -> float:
        """Curvature at the vertex in the section x–z."""
        form = self.form
        return self.curvature_per_mm if form is None else form.curvature_x_per_mm(self)

    @property
    def forms(self) -> dict[str, Form]:
        """Shapes that are none of revolution, by their keys: one at most, or there are faults."""
        return {key: form for key in _FORMS if (form := getattr(self, key)) is not None}

    @property
    def form(self) -> Form | None:
        """Shape that is none of revolution."""
        return next(iter(self.forms.values()), None)

    @property
    def section_key(self) -> str | None:
        """Name of the key of `form`; None: the surface is one of revolution."""
        return next(iter(self.forms), None)

    @property
    def reach_mm(self) -> float:
        """Height up to which the surface exists at every azimuth; inf where it never ends."""
        form = self.form
        return reach_of_conic_mm(self.vertex_radius_mm, self.vertex_conic) if form is None else form.reach_mm(self)

    def sag_at_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z of the surface above its vertex plane at a point, all in mm.

        Parameters
        ----------
        x_mm, y_mm : float or array

        Returns
        -------
        float or array
            mm.
        """
        form = self.form
        return self.sag_mm(np.hypot(x_mm, y_mm)) if form is None else form.sag_at_mm(self, x_mm, y_mm)

    def sag_mm(self, height_mm: Heights) -> Heights:
        """Return z of the surface above its vertex plane, at a height from the axis, both in mm.

        Of a biconic or toroid it is that of the section y–z.

        The standard form of ISO 10110-12: c r² / (1 + √(1 − (1 + k) c² r²)) + Σ A_j r^(2j+4) + Σ B_j r^(2j+3), with
        `terms_mm` and `odd_asphere_mm`.

        Parameters
        ----------
        height_mm : float or array

        Returns
        -------
        float or array
            mm.
        """
        c, r2 = self.curvature_per_mm, height_mm * height_mm
        root = np.sqrt(np.maximum(0.0, 1 - (1 + self.vertex_conic) * c * c * r2))
        terms = (_term_mm(a, height_mm, power) for power, a in self.powers_mm)
        return c * r2 / (1 + root) + sum(terms)

    @property
    def powers_mm(self) -> tuple[tuple[int, float], ...]:
        """Each power of r that is added to the conic, with its coefficient."""
        even = ((2 * j + 4, a) for j, a in enumerate(self.terms_mm))
        return (*even, *((2 * j + 3, a) for j, a in enumerate(self.odd_asphere_mm)))

    def profile_ranges(self, height_mm: Range) -> tuple[Range, Range]:
        """Return bounds of `sag_mm` between heights, in mm, and of its derivative over the height, in 1/mm.

        Parameters
        ----------
        height_mm : Range
            Two arrays.

        Returns
        -------
        tuple of two Range
            mm and 1/mm.
        """
        curvature = (np.full(len(height_mm[0]), self.curvature_per_mm),) * 2
        sag, across = (
            profile_range(curvature, self.vertex_conic, self.powers_mm, height_mm, order) for order in (SAG, ACROSS)
        )
        return sag, across

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong with this surface by itself."""
        if self.refractor is not None:
            yield from self._element_faults()
            return
        if self.paraxial or self.focal_length_mm is not None:
            yield from self._thin_lens_faults()
        elif self.qbfs is not None:
            yield from self._qbfs_faults(self.qbfs)
        for key, form in self.forms.items():
            yield from self._form_faults(key, form)
        if self.semi_diameter_mm is not None and self.semi_diameter_mm > self.reach_mm * (1 + 1e-12):
            yield Fault(
                ("semi_diameter_mm",),
                self.semi_diameter_mm,
                f"with {self._shape_in_words()} the surface ends {self.reach_mm:.6g} mm from the axis; give "
                f"{at_most(self.reach_mm)} at most",
            )
        for key, coefficients, lowest in (
            ("asphere_mm", self.asphere_mm, 4),
            ("odd_asphere_mm", self.odd_asphere_mm, 3),
        ):
            for j, coefficient in enumerate(coefficients if self.semi_diameter_mm is not None else ()):
                power = lowest + 2 * j
                if not abs(_term_mm(coefficient, self.semi_diameter_mm or 0.0, power)) <= LARGEST:
                    yield Fault(
                        (key, j),
                        coefficient,
                        f"times r^{power} this makes a sag of more than {LARGEST:g} mm inside the clear aperture",
                    )
        if self.qcon is not None and not self._rim_mm() <= LARGEST:
            yield Fault(("qcon",), None, f"makes a sag of more than {LARGEST:g} mm inside the clear aperture")
        elif self.qcon is not None and not within_floats(self.qcon.asphere_mm, self.qcon.norm_radius_mm):
            yield Fault(("qcon", "norm_radius_mm"), self.qcon.norm_radius_mm, "its powers leave the range of numbers")
        if self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        yield from both_given(self.coating, self.finish, "finish")

    def _qbfs_faults(self, qbfs: Qbfs) -> Iterator[Fault]:
        """Yield what Forbes' mild asphere does not go with, and why it has no even form."""
        rho, omit = qbfs.norm_radius_mm, "omit it: qbfs deviates from a conic, by all its terms"
        own = {"asphere_mm": self.asphere_mm, "odd_asphere_mm": self.odd_asphere_mm}
        for key, value in own.items():
            if value:
                yield Fault((key,), value, omit)
        if self.qcon is not None:
            yield Fault(("qcon",), None, omit)
        if self.semi_diameter_mm is None:
            yield Fault(("semi_diameter_mm",), None, f"missing: qbfs needs one, of {rho:g} mm at most")
        elif self.semi_diameter_mm > rho:
            yield Fault(("semi_diameter_mm",), self.semi_diameter_mm, f"qbfs ends at norm_radius_mm = {rho:g}")
        form = self._qbfs_form
        if form is None:
            yield Fault(
                ("qbfs",), None,
                f"with {self._shape_in_words()} its conic, or that at its vertex, ends inside semi_diameter_mm = "
                f"{min(self.semi_diameter_mm or rho, rho):g}; give a longer radius or smaller coefficients",
            )  # fmt: skip
        elif not form.error_mm <= (most := qbfs.largest_error_mm):
            yield Fault(
                ("qbfs",), None,
                f"{MOST_ASPHERE_TERMS} even terms give its sag to {form.error_mm:.2g} mm only; {most:g} mm "
                "is the limit; give a longer radius, fewer or smaller coefficients",
            )  # fmt: skip

    def _shape_in_words(self) -> str:
        """Return the keys that say where the surface ends, with their values."""
        y = f"radius_mm = {self.radius_mm:g} and conic = {self.conic:g}"
        return y if self.form is None else f"{y}, {self.form.in_words()}"

    def _form_faults(self, key: str, form: Form) -> Iterator[Fault]:
        """Yield what a shape that is none of revolution does not go with."""
        if key != self.section_key:
            yield Fault((key,), None, f"{self.section_key} is given too; give one of them")
        for name, value in self._given_beside():
            if name in form.without:
                why = f"a {key} has no such terms" if isinstance(value, tuple) else f"it does not go with a {key}"
                yield Fault((name,), value, f"omit it: {why}")

    def _given_beside(self, *allowed: str) -> Iterator[tuple[str, object]]:
        """Yield the keys that are given beside those allowed, with their values; None for tables."""
        for key, of in type(self).model_fields.items():
            given = getattr(self, key)
            if key not in allowed and given != of.get_default(call_default_factory=True):
                shown = given.kind if key == "finish" else given
                yield key, None if isinstance(shown, Model) else shown

    def _rim_mm(self) -> float:
        """Return how far Forbes' terms move the rim of the clear aperture, or of their own."""
        at = self.semi_diameter_mm or (self.qcon.norm_radius_mm if self.qcon is not None else 0.0)
        return max(abs(_term_mm(a, at, 2 * j + 4)) for j, a in enumerate(self.terms_mm))

    def _thin_lens_faults(self) -> Iterator[Fault]:
        """Yield what is wrong with a thin lens, or with a surface that is half one."""
        if not self.paraxial:
            yield Fault(("focal_length_mm",), self.focal_length_mm, "only a thin lens has one; add paraxial = true")
            return
        if self.focal_length_mm is None:
            yield Fault(("focal_length_mm",), None, "missing: the focal length of the thin lens")
        for key, given in self._given_beside(
            "thickness_mm", "semi_diameter_mm", "stop", "paraxial", "focal_length_mm", "refractor"
        ):
            yield Fault((key,), given, "omit it: a paraxial surface is a flat thin lens in air")

    def _element_faults(self) -> Iterator[Fault]:
        for key, given in self._given_beside("thickness_mm", "semi_diameter_mm", "refractor"):
            beside = f"; the refractor has a {key} of its own" if key in ("coating", "finish") else ""
            yield Fault((key,), given, f"omit it: the refractor is a whole element{beside}")
        if self.refractor is not None and self.refractor.box_mm is not None:
            yield Fault(("refractor", "box_mm"), self.refractor.box_mm, "only in front of the camera; give file")
        if self.refractor is not None and self.refractor.absorption_per_mm != 0.0:
            yield Fault(
                ("refractor", "absorption_per_mm"), None,
                "only in front of the camera; camera.absorption = true takes that of the catalogue's glasses",
            )  # fmt: skip
        if self.refractor is not None and self.refractor.priority != 0:
            yield Fault(
                ("refractor", "priority"), self.refractor.priority, "omit it: elements of a lens do not overlap"
            )


_FORMS = tuple(
    key
    for key, of in Surface.model_fields.items()
    if any(isinstance(kind, type) and issubclass(kind, Form) for kind in get_args(of.annotation))
)
"""Keys of a surface that are shapes of their own, such as "biconic"."""


@lru_cache(maxsize=1024)
def _thickness_to_touch(front: Surface, back: Surface, apertures_mm: tuple[float, ...]) -> tuple[float, float]:
    """Return the distance of two vertices at which their surfaces touch inside an aperture, and the height there, mm.

    No more than the distance that is given, where bounds tell that they do not. Kept, as a study asks for the same pair
    at thousands of points.
    """
    radius = min(*apertures_mm, front.reach_mm, back.reach_mm)
    given = front.thickness_mm or 0.0
    of_revolution = front.section_key is None and back.section_key is None
    if of_revolution and not front.powers_mm and not back.powers_mm:
        # A conic rises or falls all the way to its rim: between these bounds nothing can cross.
        highest, lowest = max(0.0, front.sag_mm(radius)), min(0.0, back.sag_mm(radius))
        if highest - lowest <= given:
            return given, 0.0
    gap, height = least_gap_mm(front, back, 0.0, radius, -given)
    return -gap, height


def _term_mm(coefficient: float, height_mm: Heights, power: int) -> Heights:
    """Return one term of an asphere's sag, infinite where it is larger than any float."""
    with np.errstate(over="ignore"):
        return coefficient * np.abs(height_mm if coefficient else 0.0 * height_mm) ** power


class Element(Model):
    """A rigid group of neighbouring surfaces that stands off its place in the prescription."""

    surfaces: tuple[Whole, ...]
    """Numbers of the surfaces, from 0, without a gap; the stop may be among them."""
    pose: Pose = Field(default_factory=Pose)
    """Rotation of the group about the vertex of its first surface, then a shift. First-order optics, and what is
    solved from it, stay those of the lens without poses."""

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong with this group by itself."""
        if not self.surfaces:
            yield Fault(("surfaces",), [], "must name one surface or more, such as [0, 1]")
            return
        first = self.surfaces[0]
        if list(self.surfaces) != list(range(first, first + len(self.surfaces))):
            yield Fault(
                ("surfaces",), list(self.surfaces), "must be neighbouring surfaces in their order, such as [0, 1]"
            )
        x, y, _ = (math.radians(angle) for angle in self.pose.tilt_deg)
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, math.cos(x) * math.cos(y)))))
        if not tilt < MOST_TILT_DEG:
            yield Fault(
                ("pose", "tilt_deg"),
                list(self.pose.tilt_deg),
                f"inclines the axis by {tilt:.4g} degrees; it must stay below {MOST_TILT_DEG:g}",
            )


FILE_CHOICES = ("substitutes", "configuration", "coating_file")
"""Keys of a lens that choose from its file."""


@dataclass(frozen=True)
class FileChoices:
    """Choices that a lens file of another program leaves open.

    Attributes
    ----------
    substitutes : mapping
        Catalogue glass or index by the name that the file uses, in place of looking the name up.
    configuration : int, optional
        From 1; if left out, the one whose values stand in the file's surfaces.
    coating_file : str, optional
        Path of the file that defines the coatings; if left out, the one beside the lens file.
    """

    substitutes: Mapping[str, str | float] = field(default_factory=dict)
    configuration: int | None = None
    coating_file: str | None = None

    def given(self) -> list[str]:
        """Return the keys of the choices that are made."""
        return [key for key in FILE_CHOICES if getattr(self, key)]


AS_IT_STANDS = FileChoices()
"""No choices."""


_EDIT = "to change surfaces of a lens file write it as another one (lfmesh lens convert {} lens.toml), and edit that"


class Lens(Model):
    """The main lens as its prescription, or the file that holds it."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        "coating": "a surface has it: surfaces = [{ ..., coating = ... }]; " + _EDIT.format("lib:tessar_50mm")
    }

    file: Text | None = None
    """Lens file (.toml, .zmx, .seq, .len, .json, .csv), relative to the scene file, or "lib:" and a name of the
    library. A TOML file has the keys of this table (name, source, surfaces, ...); the others are of Zemax, CODE V,
    OSLO, optiland, or a table. A lens of the library comes with lfmesh. The file is read in place of `surfaces`."""
    substitutes: dict[Text, GlassName | Index] = Field(default_factory=dict)
    """Catalogue glass or index by a glass name that the file uses: { BK7 = "SCHOTT/N-BK7" }."""
    configuration: Count | None = None
    """Number of the configuration of the file, from 1. Omitted: as the file's surfaces stand."""
    coating_file: Text | None = None
    """Zemax's coating file that defines the coatings of a .zmx file, relative to the scene file. Omitted: the one
    beside the lens file."""
    name: Text | None = None
    """Name of the lens."""
    source: Text | None = None
    """Publication that the prescription is taken from."""
    surfaces: tuple[Surface, ...] = ()
    """The surfaces, from the object to the sensor; the first vertex is the origin of the camera frame. Or give
    `file`."""
    stop_semi_diameter_mm: Positive | None = None
    """Radius of the aperture stop, in mm. Or give `f_number` or `epd_mm`. Omitted: that of the prescription."""
    f_number: Positive | None = None
    """Focal length over diameter of the entrance pupil (no unit), which sets the radius of the stop."""
    epd_mm: Positive | None = None
    """Diameter of the entrance pupil, in mm, which sets the radius of the stop."""
    elements: tuple[Element, ...] = ()
    """Rigid groups of surfaces with a pose of their own: tilted and decentred elements."""
    coatings: dict[str, Coating] = Field(default_factory=dict)
    """Coatings of the lens itself, by the name that its surfaces use, in addition to the coatings of the scene."""
    object_medium: Matter | None = None
    """Medium before the first surface that the lens is designed for, such as { index = 1.333 }. A scene's
    `camera.object_medium` takes its place. Omitted: air."""

    def __hash__(self) -> int:
        values = (frozenset(value.items()) if isinstance(value, dict) else value for _, value in self)
        return hash(tuple(values))

    @property
    def file_choices(self) -> FileChoices:
        """Choices that its file leaves open."""
        return FileChoices(**{key: getattr(self, key) for key in FILE_CHOICES})

    @property
    def media(self) -> tuple[Medium, ...]:
        """Medium before the first surface, then that behind each.

        A flat stop that comes first and names no medium, not even an index of 1, is no interface: it stands in the
        object medium.
        """
        outside = self.object_medium.medium if self.object_medium is not None else None
        behind = [surface.medium for surface in self.surfaces]
        if behind and self.surfaces[0].is_plain_stop:
            behind[0] = outside
        return outside, *behind

    @property
    def stop_index(self) -> int | None:
        """Number of the surface that is the stop; None where none is marked."""
        return next((i for i, surface in enumerate(self.surfaces) if surface.stop), None)

    @property
    def vertices_mm(self) -> tuple[float, ...]:
        """Z of every surface's vertex in the camera frame, in mm."""
        z = [0.0]
        for surface in self.surfaces[:-1]:
            z.append(z[-1] + (surface.thickness_mm or 0.0))
        return tuple(z)

    def element_of(self, number: int) -> int | None:
        """Return which of `elements` surface `number` belongs to; None: to none.

        Parameters
        ----------
        number : int
            From 0, at the object's side.

        Returns
        -------
        int or None
        """
        return next((i for i, element in enumerate(self.elements) if number in element.surfaces), None)

    def is_pure_stop(self, number: int) -> bool:
        """Return whether surface `number` only stops light: marked, flat, the same medium on both sides.

        Parameters
        ----------
        number : int
            From 0, at the object's side.

        Returns
        -------
        bool
        """
        surface, media = self.surfaces[number], self.media
        return surface.stop and surface.is_flat and not surface.paraxial and media[number] == media[number + 1]

    def aperture_mm(self, number: int) -> float | None:
        """Return the clear radius of surface `number`, in mm; None where the size of the pupil decides it.

        Parameters
        ----------
        number : int
            From 0, at the object's side.

        Returns
        -------
        float or None
            mm.
        """
        surface = self.surfaces[number]
        if surface.stop and self.stop_semi_diameter_mm is not None:
            return self.stop_semi_diameter_mm
        return None if surface.stop and self.stop_size else surface.semi_diameter_mm

    @property
    def stop_size(self) -> dict[str, float]:
        """Value that sizes the stop in place of the prescription, by its key: nothing, or one entry."""
        sizes = {key: getattr(self, key) for key in STOP_SIZES}
        return {key: size for key, size in sizes.items() if size is not None}

    def faults(self) -> Iterator[Fault]:
        """Yield what is wrong between surfaces."""
        if self.file is not None:
            if self.surfaces:
                yield Fault(
                    ("file",), self.file, f"surfaces are given too; give one of them; {_EDIT.format(self.file)}"
                )
            return
        for key in FILE_CHOICES:
            if value := getattr(self, key):
                yield Fault((key,), value, "it chooses from a lens file, and no file is given")
        for name, coating in self.coatings.items():
            if coating.table is not None:
                yield Fault(("coatings", name, "table"), coating.table, "a coating with a file belongs to the scene")
        if not self.surfaces:
            yield Fault(("surfaces",), None, 'missing: give the prescription, or file = "..." with one')
            return
        if all(self.is_pure_stop(i) and surface.mesh is None for i, surface in enumerate(self.surfaces)):
            yield Fault(
                ("surfaces",),
                None,
                "nothing but a stop: a lens needs a surface with glass behind it. For a pinhole camera put a flat "
                "window before the stop, such as { thickness_mm = 1.0, index = 1.5, semi_diameter_mm = 10.0 }, "
                "{ thickness_mm = 1.0, semi_diameter_mm = 10.0 }",
            )
            return
        for i, surface in enumerate(self.surfaces):
            if self.is_pure_stop(i) and surface.mesh is None:
                given = {"coating": surface.coating} if surface.coating != UNCOATED else {}
                given |= {"finish": surface.finish.kind} if surface.finish != POLISHED else {}
                for key, value in given.items():
                    yield Fault(("surfaces", i, key), value, "omit it: a stop without glass is no interface")
        for i, (surface, medium) in enumerate(zip(self.surfaces, self.media, strict=False)):
            if surface.paraxial and medium is not None:
                what = f"surfaces[{i - 1}]" if i else "camera.object_medium"
                yield Fault(
                    ("surfaces", i, "paraxial"), True,
                    f"{what} puts {medium if isinstance(medium, str) else 'glass' if i else 'a medium'} before it; a "
                    "thin lens stands in air",
                )  # fmt: skip
        yield from self._stop_faults()
        yield from self._spacing_faults()
        yield from self._element_faults()
        last = len(self.surfaces) - 1
        if self.surfaces[last].medium is not None:
            key = "glass" if self.surfaces[last].glass is not None else "index"
            yield Fault(("surfaces", last, key), self.surfaces[last].medium, "the lens must end in air: omit this")

    def _stop_faults(self) -> Iterator[Fault]:
        stops = [i for i, surface in enumerate(self.surfaces) if surface.stop]
        if len(stops) > 1:
            yield Fault(("surfaces", stops[1], "stop"), True, f"surfaces[{stops[0]}] is the stop already; keep one")
        sizes = list(self.stop_size.items())
        for key, size in sizes[1:]:
            yield Fault((key,), size, f"{sizes[0][0]} = {sizes[0][1]:g} is given too; give one of them")
        for i, surface in enumerate(self.surfaces):
            sized = surface.stop and bool(self.stop_size)
            if sized and surface.qbfs is not None:
                yield Fault(
                    ("surfaces", i, "qbfs"), None,
                    f"ends at norm_radius_mm; size this stop by semi_diameter_mm, not {sizes[0][0]}",
                )  # fmt: skip
            solved = bool(stops) and not surface.stop and surface.mesh is None
            if surface.semi_diameter_mm is None and not sized and not solved and surface.refractor is None:
                hint = "" if stops else "; or mark the stop, which the others follow from"
                yield Fault(
                    ("surfaces", i, "semi_diameter_mm"), None, f"missing: the radius of the clear aperture{hint}"
                )

    def _element_faults(self) -> Iterator[Fault]:
        last = len(self.surfaces) - 1
        owner: dict[int, int] = {}
        for i, element in enumerate(self.elements):
            beyond = [number for number in element.surfaces if number > last]
            if beyond:
                yield Fault(
                    ("elements", i, "surfaces"),
                    list(element.surfaces),
                    f"there is no surface {beyond[0]}; the lens has surfaces 0 to {last}",
                )
            taken = [number for number in element.surfaces if number in owner]
            if taken:
                yield Fault(
                    ("elements", i, "surfaces"),
                    list(element.surfaces),
                    f"surface {taken[0]} belongs to elements[{owner[taken[0]]}] already; name it once",
                )
            owner.update((number, i) for number in element.surfaces if number not in owner)

    def _spacing_faults(self) -> Iterator[Fault]:
        last = len(self.surfaces) - 1
        for i, surface in enumerate(self.surfaces[:-1]):
            if surface.thickness_mm is None:
                yield Fault(("surfaces", i, "thickness_mm"), None, "missing: the distance to the next vertex")
            else:
                yield from self._crossing(i)
        if self.surfaces[last].thickness_mm:
            yield Fault(
                ("surfaces", last, "thickness_mm"),
                self.surfaces[last].thickness_mm,
                "omit it at the last surface: mla.distance_mm or sensor.distance_mm gives what follows",
            )

    @property
    def has_meshes(self) -> bool:
        """True if surfaces are given by mesh files, and have no exact form."""
        return any(surface.mesh is not None or surface.refractor is not None for surface in self.surfaces)

    @property
    def number_off_revolution(self) -> int | None:
        """The first surface with another section in x than in y; None where all are surfaces of revolution."""
        return next((i for i, surface in enumerate(self.surfaces) if surface.section_key is not None), None)

    def gap_mm(self, number: int, height_mm: float) -> float:
        """Return the distance along z from surface `number` to the next at a height from the axis, in mm.

        The smallest over all azimuths.

        Parameters
        ----------
        number : int
            From 0, at the object's side; not the last.
        height_mm : float

        Returns
        -------
        float
            mm; negative where the surfaces cross.
        """
        front, back = self.surfaces[number], self.surfaces[number + 1]
        return (front.thickness_mm or 0.0) + least_gap_mm(front, back, height_mm, height_mm)[0]

    def edge_mm(self, number: int) -> float:
        """Return the distance along z from the rim of surface `number` to that of the next, in mm.

        The smallest over all azimuths.

        Parameters
        ----------
        number : int
            From 0, at the object's side; not the last.

        Returns
        -------
        float
            mm; negative where the rims cross.
        """
        front, back = self.surfaces[number], self.surfaces[number + 1]
        rims = front.semi_diameter_mm or 0.0, back.semi_diameter_mm or 0.0
        return (front.thickness_mm or 0.0) + rim_gap_mm(front, back, *rims)

    def _crossing(self, number: int) -> Iterator[Fault]:
        """Compare the sags of a surface and the next over the aperture they share."""
        front, back = self.surfaces[number], self.surfaces[number + 1]
        if front.refractor is not None or back.refractor is not None:
            return
        apertures = [a for a in (self.aperture_mm(number), self.aperture_mm(number + 1)) if a is not None]
        if not apertures:
            return
        needed, height = _thickness_to_touch(front, back, tuple(apertures))
        given = front.thickness_mm or 0.0
        # Elements may touch; what rounding makes of that is no crossing.
        if needed > given + touching_mm(front):
            yield Fault(
                ("surfaces", number, "thickness_mm"),
                given,
                f"surfaces {number} and {number + 1} cross inside their clear aperture, by "
                f"{needed - given:.4g} mm at {height:.4g} mm from the axis; give {at_least(needed)} or more, or "
                "smaller semi-diameters",
            )
