"""A surface of the main lens: its shape, its aperture, and the medium behind it."""

import math
from collections.abc import Iterator
from itertools import zip_longest
from typing import get_args

import numpy as np
from pydantic import Field

from lfmesh.optics.bounds import ACROSS, SAG, Range, profile_range
from lfmesh.optics.glass import AIR, Medium
from lfmesh.scene.camera.forms import Form, Heights, reach_of_conic_mm
from lfmesh.scene.camera.gradient import AnyGradient
from lfmesh.scene.camera.gradient_faults import gradient_beside
from lfmesh.scene.camera.outer_zone import OuterZone
from lfmesh.scene.camera.phase import AnyPhase
from lfmesh.scene.camera.qbfs import EvenForm, Qbfs
from lfmesh.scene.camera.qcon import MOST_ASPHERE_TERMS, Qcon, within_floats
from lfmesh.scene.camera.sections import Biconic, Toroid
from lfmesh.scene.literals import at_most
from lfmesh.scene.materials.coatings import UNCOATED
from lfmesh.scene.materials.finishes import POLISHED, AnyFinish, both_given, rough_phase
from lfmesh.scene.materials.own_glass import Glass
from lfmesh.scene.model import Fault, Model
from lfmesh.scene.objects.refractor import MeshFace, Refractor
from lfmesh.scene.quantities import (
    LARGEST,
    Coefficient,
    Flag,
    FocalLength,
    Index,
    NonNegative,
    Number,
    Positive,
    Radius,
    Text,
)


class Surface(Model):
    """An interface and the medium behind it; flat and without glass on either side, a pure stop."""

    radius_mm: Radius = math.inf
    """Radius of curvature at the vertex, in mm: positive when the centre lies towards the sensor; inf is
    flat."""
    thickness_mm: NonNegative | None = None
    """Distance from this vertex to the next, in mm. Omitted: at the last surface only."""
    index: Index | None = None
    """Refractive index behind the surface; behind the last one, of the medium up to the sensor. Or give `glass`.
    Omitted: air; for a flat stop as the first surface, the lens's object medium."""
    glass: Glass | None = None
    """Glass behind the surface: a catalogue name such as "SCHOTT/N-BK7", or a dispersion such as { nd = 1.5168, vd =
    64.17 }."""
    gradient: AnyGradient | None = None
    """Gradient-index glass behind the surface, up to the next one, such as { kind = "radial_n2", index = 1.6,
    coefficients = [-0.09] }. Replaces `index` and `glass`. Omitted: homogeneous."""
    semi_diameter_mm: Positive | None = None
    """Radius of the clear aperture, in mm. Omit it at a stop that `stop_semi_diameter_mm`, `f_number` or `epd_mm`
    sizes. If a stop is marked, the other surfaces may omit it too. They then pass the whole beam of every image point
    with a margin of 5 %, unless the surface ends or meets its neighbour first. Omitted: as wide as the beams by
    paraxial rays."""
    stop: Flag = False
    """True for the aperture stop."""
    coating: Text = UNCOATED
    """Name of a coating of the scene or of the lens, or "none": bare."""
    finish: AnyFinish = POLISHED
    """Finish: "polished", "diffuse" or { kind = "ground", roughness = 0.1 }."""
    conic: Number = 0.0
    """Conic constant: 0 sphere, −1 paraboloid, below −1 hyperboloid, above −1 ellipsoid."""
    asphere_mm: tuple[Coefficient, ...] = Field(default=(), max_length=MOST_ASPHERE_TERMS)
    """Even aspheric coefficients of r⁴, r⁶, r⁸, ..., in mm⁻³, mm⁻⁵, ...; for a toroid, of y⁴, y⁶, .... The sag is in
    mm."""
    odd_asphere_mm: tuple[Coefficient, ...] = Field(default=(), max_length=MOST_ASPHERE_TERMS)
    """Odd aspheric coefficients of r³, r⁵, r⁷, ..., in mm⁻², mm⁻⁴, ..., in addition to the even ones. There is no term
    in r: it would be a cone, without a normal at the vertex."""
    qcon: Qcon | None = None
    """Forbes' strong asphere, such as { norm_radius_mm = 5.0, coefficients_mm = [0.1, -0.02] }. Replaces `asphere_mm`,
    or adds to it."""
    qbfs: Qbfs | None = None
    """Forbes' mild asphere, with the keys of `qcon`, without `asphere_mm` and `qcon`. It is a deviation along the
    normal of the best-fit sphere `radius_mm`, or of its `conic`. The radius at the vertex differs from `radius_mm`."""

    biconic: Biconic | None = None
    """Radius and conic constant of the section x–z, such as { radius_x_mm = 40.0, conic_x = -1.0 }. `radius_mm` and
    `conic` then describe the section y–z."""
    toroid: Toroid | None = None
    """Circle in the section x–z, such as { radius_x_mm = 40.0 }: the section y–z turns about a line parallel to y.
    `radius_mm`, `conic` and `asphere_mm` (of y⁴, y⁶, ...) then describe the section y–z. An infinite radius extrudes it
    along x into a cylinder."""
    outer_zone: OuterZone | None = None
    """Zone with a shape of its own outside a border, such as { border_mm = 1.25, radius_mm = 3.2 }. `radius_mm`,
    `conic` and `asphere_mm` then describe the zone inside. Omitted: one shape."""

    phase: AnyPhase | None = None
    """Phase of a diffractive surface, such as { kind = "radial", coefficients_rad = [-120.0], radius_mm = 5.0 }. It
    turns light in addition to refraction, also on a flat surface with the same medium on both sides. Omitted: none."""

    paraxial: Flag = False
    """Ideal thin lens in place of an interface: flat, in air, without reflections. Needs `focal_length_mm`."""
    focal_length_mm: FocalLength | None = None
    """Focal length of a `paraxial` surface, in mm: positive converges, negative diverges; inf does not bend light."""

    refractor: Refractor | None = None
    """A whole element in place of a surface: a mesh, with the lens's axis along the mesh's z axis. The only other keys
    are `thickness_mm`, the distance from its last vertex to the next surface, and `semi_diameter_mm`."""
    mesh: MeshFace | None = None
    """Mesh that gives the surface its real shape; radius and asphere are its best fit, for first-order optics."""

    @property
    def medium(self) -> Medium:
        """Material behind the surface: an index, a glass, a gradient, or None for air."""
        if self.index is not None:
            return None if self.index == AIR else self.index
        return self.gradient if self.gradient is not None else self.glass

    @property
    def is_flat(self) -> bool:
        """True if the surface is flat everywhere, whatever its form."""
        bare = self.curvature_per_mm == self.curvature_x_per_mm == 0 and not any(a for _, a in self.powers_mm)
        return bare and (self.form is None or self.form.is_flat(self))

    @property
    def is_plain_stop(self) -> bool:
        """True for a flat stop without a given medium and without a phase."""
        given = (self.index, self.glass, self.gradient, self.mesh, self.refractor, self.phase)
        return self.stop and self.is_flat and not self.paraxial and all(each is None for each in given)

    @property
    def curvature_per_mm(self) -> float:
        """Curvature at the vertex; 0 for a flat surface."""
        return 0.0 if math.isinf(self.vertex_radius_mm) else 1.0 / self.vertex_radius_mm

    @property
    def vertex_radius_mm(self) -> float:
        """Radius of curvature at the vertex; differs from `radius_mm` only with `qbfs`."""
        form = self._qbfs_form
        return self.radius_mm if form is None else form.radius_mm

    @property
    def vertex_conic(self) -> float:
        """Conic constant of the base conic, without `terms_mm`."""
        form = self._qbfs_form
        return self.conic if form is None else form.conic

    @property
    def _qbfs_form(self) -> EvenForm | None:
        if self.qbfs is None:
            return None
        return self.qbfs.even_form(1.0 / self.radius_mm, self.conic, self.semi_diameter_mm)

    @property
    def terms_mm(self) -> tuple[float, ...]:
        """Coefficients of r⁴, r⁶, ... of the total departure from the conic, in mm⁻³, mm⁻⁵, ..."""
        form = self._qbfs_form
        if form is not None:
            return form.asphere_mm
        if self.qcon is None:
            return self.asphere_mm
        return tuple(a + b for a, b in zip_longest(self.asphere_mm, self.qcon.asphere_mm, fillvalue=0.0))

    @property
    def terms_key(self) -> str:
        """Key that `terms_mm` come from."""
        return "qbfs" if self.qbfs is not None else "asphere_mm" if self.qcon is None else "qcon"

    @property
    def thin_lens_power_per_mm(self) -> float:
        """Power of a `paraxial` surface, 1/mm, else 0."""
        return 0.0 if self.focal_length_mm is None else 1.0 / self.focal_length_mm

    def added_power_per_mm(self, wavelength_nm: float, *, section_x: bool = False) -> float:
        """Return the power that adds to that of refraction: of a `paraxial` surface or of a phase, else 0.

        Parameters
        ----------
        wavelength_nm : float
        section_x : bool
            Return it for the section x–z in place of y–z.

        Returns
        -------
        float
            1/mm.
        """
        power = self.thin_lens_power_per_mm
        return power if self.phase is None else power + self.phase.power_per_mm(wavelength_nm, section_x)

    @property
    def curvature_x_per_mm(self) -> float:
        """Curvature at the vertex in the section x–z."""
        form = self.form
        return self.curvature_per_mm if form is None else form.curvature_x_per_mm(self)

    @property
    def forms(self) -> dict[str, Form]:
        """Shapes without rotational symmetry, by key; a valid surface has at most one."""
        return {key: form for key in _FORMS if (form := getattr(self, key)) is not None}

    @property
    def form(self) -> Form | None:
        """Shape without rotational symmetry."""
        return next(iter(self.forms.values()), None)

    @property
    def section_key(self) -> str | None:
        """Key of `form`, or None for a surface of revolution."""
        return next(iter(self.forms), None)

    @property
    def asymmetric_key(self) -> str | None:
        """Key of `form`, or "phase" or "gradient" for one without rotational symmetry, or None."""
        if self.section_key is not None:
            return self.section_key
        parts = {"phase": self.phase, "gradient": self.gradient}
        return next((key for key, part in parts.items() if part is not None and not part.of_revolution), None)

    @property
    def is_symmetric(self) -> bool:
        """True if shape, phase and gradient are symmetric about x and about y."""
        return all(each is None or each.symmetric for each in (self.form, self.phase, self.gradient))

    @property
    def reach_mm(self) -> float:
        """Largest height that the surface reaches at every azimuth; inf if it never ends."""
        form = self.form
        return reach_of_conic_mm(self.vertex_radius_mm, self.vertex_conic) if form is None else form.reach_mm(self)

    def sag_at_mm(self, x_mm: Heights, y_mm: Heights) -> Heights:
        """Return z of the surface above its vertex plane at a point.

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
        """Return the sag at a height from the axis; for a biconic or toroid, in the y–z section.

        Beyond the border of an `outer_zone`, it is that of the zone.

        ISO 10110-12: c r² / (1 + √(1 − (1 + k) c² r²)) + Σ A_j r^(2j+4) + Σ B_j r^(2j+3), with `terms_mm` and
        `odd_asphere_mm`.

        Parameters
        ----------
        height_mm : float or array

        Returns
        -------
        float or array
            mm.
        """
        if self.outer_zone is not None:
            return self.outer_zone.profile_mm(self, height_mm)
        c, r2 = self.curvature_per_mm, height_mm * height_mm
        root = np.sqrt(np.maximum(0.0, 1 - (1 + self.vertex_conic) * c * c * r2))
        terms = (_term_mm(a, height_mm, power) for power, a in self.powers_mm)
        return c * r2 / (1 + root) + sum(terms)

    @property
    def powers_mm(self) -> tuple[tuple[int, float], ...]:
        """Powers of r added to the conic, with their coefficients."""
        even = ((2 * j + 4, a) for j, a in enumerate(self.terms_mm))
        return (*even, *((2 * j + 3, a) for j, a in enumerate(self.odd_asphere_mm)))

    def profile_ranges(self, height_mm: Range) -> tuple[Range, Range]:
        """Return bounds of `sag_mm` between heights, in mm, and of its slope divided by the height, in 1/mm.

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
        """Yield faults of this surface on its own."""
        if self.refractor is not None:
            yield from self._element_faults()
            return
        if self.paraxial or self.focal_length_mm is not None:
            yield from self._thin_lens_faults()
        elif self.qbfs is not None:
            yield from self._qbfs_faults(self.qbfs)
        for key, form in self.forms.items():
            yield from self._form_faults(key, form)
        if self.outer_zone is not None and self.section_key == "outer_zone":
            yield from self.outer_zone.faults_on(self)
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
            yield Fault(("qcon", "norm_radius_mm"), self.qcon.norm_radius_mm, "its powers leave the range of float64")
        if self.index is not None and self.glass is not None:
            yield Fault(("glass",), self.glass, f"index = {self.index:g} is given too; give one of them")
        yield from gradient_beside(self.gradient, self.index, self.glass)
        if self.gradient is not None and self.mesh is not None:
            yield Fault(
                ("gradient",), None, "omit it: rays through gradient glass begin on an exact surface, not a mesh"
            )
        yield from both_given(self.coating, self.finish, "finish")
        yield from rough_phase(self.phase, self.finish, "phase")
        if self.phase is not None and self.mesh is not None:
            yield Fault(("phase",), None, "omit it: a phase needs an exact surface, which a mesh does not have")

    def _qbfs_faults(self, qbfs: Qbfs) -> Iterator[Fault]:
        """Yield keys that exclude `qbfs`, and the reason if it has no even form."""
        rho, omit = qbfs.norm_radius_mm, "omit it: the terms of qbfs describe the whole deviation from a conic"
        own = {"asphere_mm": self.asphere_mm, "odd_asphere_mm": self.odd_asphere_mm}
        for key, value in own.items():
            if value:
                yield Fault((key,), value, omit)
        if self.qcon is not None:
            yield Fault(("qcon",), None, omit)
        if self.semi_diameter_mm is None:
            yield Fault(("semi_diameter_mm",), None, f"missing: qbfs needs one, at most {rho:g} mm")
        elif self.semi_diameter_mm > rho:
            yield Fault(("semi_diameter_mm",), self.semi_diameter_mm, f"qbfs ends at norm_radius_mm = {rho:g}")
        form = self._qbfs_form
        if form is None:
            yield Fault(
                ("qbfs",), None,
                f"with {self._shape_in_words()} its conic, or the conic at its vertex, ends inside semi_diameter_mm = "
                f"{min(self.semi_diameter_mm or rho, rho):g}; give a longer radius or smaller coefficients",
            )  # fmt: skip
        elif not form.error_mm <= (most := qbfs.largest_error_mm):
            yield Fault(
                ("qbfs",), None,
                f"{MOST_ASPHERE_TERMS} even terms give its sag with an error of {form.error_mm:.2g} mm, above the "
                f"limit of {most:g} mm; give a longer radius, fewer or smaller coefficients",
            )  # fmt: skip

    def _shape_in_words(self) -> str:
        """Return the keys that determine the end of the surface, with their values."""
        y = f"radius_mm = {self.radius_mm:g} and conic = {self.conic:g}"
        return y if self.form is None else f"{y}, {self.form.in_words()}"

    def _form_faults(self, key: str, form: Form) -> Iterator[Fault]:
        """Yield keys that exclude a shape without rotational symmetry."""
        if key != self.section_key:
            yield Fault((key,), None, f"{self.section_key} is given too; give one of them")
        for name, value in self._given_beside():
            if name in form.without:
                what = f"an {key}" if key.startswith("o") else f"a {key}"
                why = f"{what} has no such terms" if isinstance(value, tuple) else f"it does not go with {what}"
                yield Fault((name,), value, f"omit it: {why}")

    def _given_beside(self, *allowed: str) -> Iterator[tuple[str, object]]:
        """Yield given keys other than the allowed ones, with their values; None for tables."""
        for key, of in type(self).model_fields.items():
            given = getattr(self, key)
            if key not in allowed and given != of.get_default(call_default_factory=True):
                shown = given.kind if key == "finish" else given
                yield key, None if isinstance(shown, Model) else shown

    def _rim_mm(self) -> float:
        """Return the largest contribution of a Forbes term to the sag at the rim of the clear aperture."""
        at = self.semi_diameter_mm or (self.qcon.norm_radius_mm if self.qcon is not None else 0.0)
        return max(abs(_term_mm(a, at, 2 * j + 4)) for j, a in enumerate(self.terms_mm))

    def _thin_lens_faults(self) -> Iterator[Fault]:
        """Yield faults of a thin lens, complete or not."""
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
            beside = f"; give the {key} of the refractor" if key in ("coating", "finish") else ""
            yield Fault((key,), given, f"omit it: the refractor is a whole element{beside}")
        for key in ("shape", "box_mm"):
            given = getattr(self.refractor, key, None)
            if given is not None:
                yield Fault(("refractor", key), given, "only for a refractor in front of the camera; give file")
        if self.refractor is not None and self.refractor.absorption_per_mm != 0.0:
            yield Fault(
                ("refractor", "absorption_per_mm"), None,
                "only for a refractor in front of the camera; camera.absorption = true uses the catalogue's values",
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
"""Keys of a surface that hold a `Form`, such as "biconic"."""


def _term_mm(coefficient: float, height_mm: Heights, power: int) -> Heights:
    """Return one term of an asphere's sag, infinite on overflow."""
    with np.errstate(over="ignore"):
        return coefficient * np.abs(height_mm if coefficient else 0.0 * height_mm) ** power
