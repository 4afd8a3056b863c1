"""The first-order report of a camera in words: cardinal points, pupils, micro-images, sampling, refocus range."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any

from lfmesh.notebook import Shown
from lfmesh.optics.glass import AIR
from lfmesh.scene.distance import reach_in_words
from lfmesh.scene.first_order.field_of_view import FieldOfView
from lfmesh.scene.first_order.focused import FocusedLenslets, middle_of
from lfmesh.scene.first_order.kick_error import KickError
from lfmesh.scene.first_order.lenslets import LensletSection
from lfmesh.scene.first_order.paraxial import quotient
from lfmesh.scene.literals import percent

CONVENTIONAL, STANDARD = "conventional", "standard plenoptic"
KEPLERIAN, GALILEAN = "focused plenoptic, Keplerian", "focused plenoptic, Galilean"


@dataclass(frozen=True)
class AtWavelength:
    """Paraxial properties of the lens at one wavelength, or at the centroid of a band."""

    wavelength_nm: float
    efl_mm: float
    bfl_mm: float
    image_shift_mm: float
    """Distance of the image of the plane in focus behind that at the primary wavelength."""


@dataclass(frozen=True)
class FirstOrder(Shown):
    """Paraxial properties of a camera at its primary wavelength.

    All z are from the first lens vertex. Pupils (telecentric lenses) and objects at infinity are inf. Properties of a
    microlens array are None without one.
    """

    wavelength_nm: float
    """The primary wavelength."""
    efl_mm: float
    """Effective focal length: 1 over the power. Times the index of a medium, it is the focal length on that side."""
    bfl_mm: float
    """Distance from the last vertex to the rear focal point."""
    ffl_mm: float
    """Distance from the first vertex to the front focal point; negative before the lens."""
    front_principal_plane_z_mm: float
    """z of the object-side principal plane."""
    rear_principal_plane_z_mm: float
    """z of the image-side principal plane."""
    entrance_pupil_z_mm: float
    """z of the image of the stop by the surfaces before it."""
    entrance_pupil_diameter_mm: float
    """Diameter of the entrance pupil."""
    exit_pupil_z_mm: float
    """z of the image of the stop by the surfaces behind it."""
    exit_pupil_diameter_mm: float
    """Diameter of the exit pupil."""
    kind: str
    """Kind of camera: "conventional"; "standard plenoptic" (1.0), with lenslets that image the pupil onto the sensor;
    "focused plenoptic, Keplerian" or "focused plenoptic, Galilean" (2.0), with lenslets that image the main image."""
    object_distance_mm: float
    """Distance of the plane in focus before the first vertex. It is imaged onto the array's apexes (standard), by the
    lenslets of the middle focal length onto the sensor (focused), or by the lens onto the sensor (conventional) or the
    plane that the lenslets relay to it."""
    image_z_mm: float
    """z of this plane's image by the lens: the apexes as seen by the lens (standard), before or behind them (focused),
    the sensor (conventional), or the plane that the lenslets relay to the sensor."""
    lenslets_z_mm: float | None
    """z of the apexes, as seen through the plate if its flat face faces the lens."""
    magnification: float
    """Transverse magnification between these two planes; negative for an inverted image."""
    working_f_number: float
    """Image-side f-number, 1 / (2 n' u') of the paraxial marginal ray that meets the axis at the lenslets or sensor; n'
    is the image index."""
    microlens_f_number: float | None
    """Reduced distance from the lenslet to the sensor over the pitch: f/p in the microlens focal plane, in air."""
    micro_image_pitch_px: float | None
    """Distance of neighbouring micro-images on the sensor, in pixels."""
    micro_image_diameter_px: float | None
    """Diameter of a micro-image, the image of the exit pupil, in pixels."""
    object_sampling_mm: float
    """Size on the plane in focus of a lenslet (standard), of a pixel (conventional), or of a pixel through the lenslets
    (focused)."""
    field_of_view_mm: tuple[float, float]
    """Width and height of the plane in focus that array and sensor see. Through a single relaying lenslet it is the
    sensor's size over both magnifications; many see about the size that sensor and array share, whatever the
    magnification of each."""
    field: FieldOfView
    """Field of view at any distance, and the angles of view for distant objects."""
    airy_wavelength_nm: float
    """Longest wavelength of the scene; the Airy disks are given for it, as they are largest there."""
    airy_disk_mm: float
    """Diameter of the first dark ring of the lens's Airy pattern for the plane in focus. Rays are traced by geometric
    optics, without it."""
    airy_disk_samples: float
    """The same in lenslet pitches (standard), in pixels (conventional), or in pixels as imaged by the lenslets
    (focused)."""
    microlens_airy_disk_px: float | None
    """Diameter of a lenslet's Airy disk on the sensor, in pixels."""
    microlens_fresnel_number: float | None
    """Square of half a lenslet's width, over the wavelength times the distance from the sensor (no unit). Below about
    10, diffraction blurs much of the micro-image."""
    kick_error: KickError | None
    """Errors of pictures of extended light with and without the lenslets' diffraction. None if unknown: beyond the
    tables, for round apertures, cylinders and phases. The errors of edges are unknown for hexagons."""
    near_mm: float
    """Nearest object distance that can be refocused sharply (standard), that is within the depth of field
    (conventional), or that any lenslet type images sharply to a pixel (focused). inf, with `far_mm`, if no real object
    is sharp."""
    far_mm: float
    """Farthest such distance; may be inf."""
    view_spacing_mm: float | None = None
    """Distance on the entrance pupil of neighbouring views, a pixel of a micro-image apart: their stereo baseline.
    Standard plenoptic cameras only."""
    views_across: float | None = None
    """Number of views across the diameter of the pupil; standard plenoptic cameras only."""
    refocused_mm: tuple[tuple[float, float, float], ...] = ()
    """Refocused planes, each with the nearest and farthest distance that is sharp to a lenslet in a photograph of all
    views: the near end of the refocus range, the plane in focus, the far end. Both distances are inf if no real object
    is sharp."""
    cover_shift_mm: float | None = None
    """Shift of the image away from the lens by the sensor's cover, t (1 - n'/n): negative for a cover of lower index
    than the image medium. None without a cover. The sensor stays where the scene puts it; the other figures are for the
    plane behind the cover."""
    by_wavelength: tuple[AtWavelength, ...] = ()
    """The lens at each wavelength or band, if there are several."""
    efl_x_mm: float | None = None
    """Effective focal length in the x–z section, if a biconic or toroid makes it differ. All other figures are for the
    y–z section."""
    object_index: float = 1.0
    """Refractive index of the medium before the lens."""
    image_index: float = 1.0
    """Refractive index of the medium between the lens and the sensor."""
    image_x_shift_mm: float | None = None
    """Distance behind the image plane of the image of the plane in focus in the x–z section."""
    focused: tuple[FocusedLenslets, ...] = ()
    """Lenslets of a focused plenoptic camera, by type."""
    relay_magnification: float | None = None
    """Magnification at which every lenslet images the plane at `image_z_mm` upright onto the sensor, as gradient-index
    rods can, or a single rod either way; None for other arrays. The camera then counts as conventional, with the
    lenslets as a part of its lens. The images of several lenslets join only at a magnification of 1."""
    lenslet_sections: tuple[LensletSection, ...] = ()
    """Lenslets by section, if they are cylinders, have two faces, a phase or a gradient; otherwise empty. The lenslet
    figures above are for the section with the power of the curved face."""
    poses: tuple[str, ...] = ()
    """Lens elements, array and sensor with a pose, one line each; all figures ignore the poses."""
    warnings: tuple[str, ...] = ()
    """Warnings of likely disappointments, in plain words."""

    def __repr__(self) -> str:
        lens = f"f = {self.efl_mm:.5g} mm, f/{self.working_f_number:.3g}"
        span = f"in focus {_mm(self.object_distance_mm)}, sharp from {_mm(self.near_mm)} to {_mm(self.far_mm)}"
        number = len(self.warnings)
        return f"<FirstOrder: {lens}, {span}, {number or 'no'} warning{'' if number == 1 else 's'}>"

    def rows(self) -> list[tuple[str, str]]:
        """Return the report without warnings, as pairs of property name and value with unit.

        Returns
        -------
        list of (str, str)
        """
        mla, standard = self.microlens_f_number is not None, self.kind == STANDARD
        rows = [
            ("camera", self.kind),
            ("wavelength", f"{self.wavelength_nm:g} nm"),
            *self._media_in_words(),
            ("effective focal length", _mm(self.efl_mm)),
            ("back focal length", f"{_mm(self.bfl_mm)} behind the last vertex"),
            ("front focal length", f"{_mm(self.ffl_mm)} from the first vertex"),
            (
                "principal planes",
                f"z = {_mm(self.front_principal_plane_z_mm)}, z = {_mm(self.rear_principal_plane_z_mm)}",
            ),
            ("entrance pupil", _pupil(self.entrance_pupil_z_mm, self.entrance_pupil_diameter_mm)),
            ("exit pupil", _pupil(self.exit_pupil_z_mm, self.exit_pupil_diameter_mm)),
            ("plane in focus", f"{_mm(self.object_distance_mm)} before the first vertex"),
            ("image plane", f"z = {_mm(self.image_z_mm)}" + self._lenslets_in_words()),
            ("magnification", f"{self.magnification:.6g}"),
            ("working f-number", f"{self.working_f_number:.4g}"),
        ]
        if self.cover_shift_mm is not None:
            way = "away from" if self.cover_shift_mm >= 0.0 else "towards"
            rows.append(("sensor's cover", f"moves the image {_um(abs(self.cover_shift_mm))} {way} the lens"))
        if self.relay_magnification is not None:
            whole, way = self.magnification * self.relay_magnification, "upright"
            if self.relay_magnification < 0.0:
                way = "inverted"
            words = (
                f"relay the image plane {way} to the sensor, magnification {self.relay_magnification:.6g}; "
                f"{whole:.6g} from the plane in focus"
            )
            rows += [("lenslets", words), *map(_section_row, self.lenslet_sections)]
        if mla:
            rows += [
                ("microlens f-number", f"{self.microlens_f_number:.4g}"),
                ("micro-image pitch", _pixels(self.micro_image_pitch_px, 6)),
                ("micro-image diameter", _pixels(self.micro_image_diameter_px, 4)),
            ]
            rows += [_section_row(at) for at in self.lenslet_sections]
            rows += [row for at in self.focused for row in _focused_rows(at, len(self.focused) > 1)]
        rows += [
            ("object sampling", f"{_mm(self.object_sampling_mm)} per {'lenslet' if standard else 'pixel'}"),
            ("field of view", self._field_in_words()),
            (
                "Airy disk, lens",
                f"{_um(self.airy_disk_mm)}, {self.airy_disk_samples:.3g} {'lenslets' if standard else 'pixels'}, "
                f"at {self.airy_wavelength_nm:g} nm",
            ),
            *([("Airy disk, lenslet", self._lenslet_disk)] if mla else []),
            *self._waves_in_words(),
            ("refocus range" if standard else "depth of field", reach_in_words(self.near_mm, self.far_mm, digits=6)),
        ]
        if self.view_spacing_mm is not None:
            rows.append(("views", f"{self._view_step} apart on the entrance pupil, {self.views_across:.3g} across"))
        rows += [
            ("depth of field", f"{reach_in_words(near, far, digits=6)} when refocused to {_mm(plane)}")
            for plane, near, far in self.refocused_mm
            if plane > 0.0 and math.isfinite(near)
        ]
        rows += [
            (
                f"at {at.wavelength_nm:.6g} nm",
                f"effective focal length {_mm(at.efl_mm)}, back {_mm(at.bfl_mm)}, "
                f"image {1e3 * at.image_shift_mm:+.4g} µm",
            )
            for at in self.by_wavelength
        ]
        if self.efl_x_mm is not None and self.image_x_shift_mm is not None:
            shift = f"image {1e3 * self.image_x_shift_mm:+.4g} µm"
            rows.append(("section x–z", f"effective focal length {_mm(self.efl_x_mm)}, {shift}"))
            rows.append(("", "the figures above are for the section y–z"))
        rows += [("posed element", text) for text in self.poses]
        if self.poses:
            rows.append(("", "the figures above are for the camera without poses"))
        return rows

    def _field_in_words(self) -> str:
        """Return the field of view on the plane in focus, or its angles if that is at infinity."""
        if math.isfinite(self.object_distance_mm):
            width, height = self.field_of_view_mm
            return f"{_mm(width)} × {_mm(height)}"
        if not math.isfinite(self.field.slope[1]):
            return "without bounds"
        return " × ".join(f"{angle:.4g}°" for angle in self.field.angles_deg)

    def _media_in_words(self) -> Iterator[tuple[str, str]]:
        """Yield the media before and behind the lens that are not air, and the focal length on their side."""
        for name, index in (("object medium", self.object_index), ("image medium", self.image_index)):
            if index != AIR:
                yield name, f"index {index:.6g}: {_mm(index * self.efl_mm)} is the focal length on its side"

    def _lenslets_in_words(self) -> str:
        """Return the position of a focused camera's lenslets."""
        return f", lenslets at z = {_mm(self.lenslets_z_mm or math.nan)}" if self.focused else ""

    @property
    def _view_step(self) -> str:
        """Distance of neighbouring views in words, as an angle if the pupil is at infinity."""
        if self.view_spacing_mm is not None and math.isfinite(self.view_spacing_mm):
            return _mm(self.view_spacing_mm)
        # By the optical invariant, the cone before the lens is the one behind it times the magnification.
        lenslets = self.working_f_number * self.object_index * (self.views_across or math.nan)
        return f"{math.degrees(quotient(abs(self.magnification), lenslets)):.4g}°"

    @property
    def _lenslet_disk(self) -> str:
        """Diffraction at the lenslets, in words."""
        return f"{self.microlens_airy_disk_px:.3g} pixels, Fresnel number {self.microlens_fresnel_number:.3g}"

    def _waves_in_words(self) -> Iterator[tuple[str, str]]:
        """Yield the effect of the lenslets' diffraction, and the recommended setting."""
        if self.microlens_fresnel_number is None:
            return
        error = self.kick_error
        if error is None:
            yield "diffraction, lenslets", "no table of errors for such lenslets: compare with lf.point_spread"
        else:
            better = error.white_with < error.white_without
            edges = "" if error.edge_with is None else f", edges in focus {percent(error.edge_with)}"
            without = "" if error.edge_without is None else f", edges in focus {percent(error.edge_without)}"
            yield (
                "diffraction, lenslets",
                f"untraced, white pictures are off by {percent(error.white_without)} of their light{without}; with "
                f'transport.diffraction = "lenslets" by {percent(error.white_with)} {error.lenslets_in_words}{edges}'
                f"{'' if better else ': no nearer'}",
            )
        lit = self.views_across if self.views_across is not None else math.nan
        if not self.focused and self.views_across is None:
            return
        where = f"a point at the ends of the refocus range lights {lit:.3g} lenslets across"
        if self.focused:
            where = f"a point in focus lights {middle_of(self.focused).seen_by:.3g} lenslets"
        yield "diffraction, points", f"{where}, whose waves interfere: compute it by lf.point_spread"

    def lines(self) -> list[str]:
        """Return the report, one line per property, followed by its warnings as notes.

        Returns
        -------
        list of str
        """
        return [f"{name:<23}{value}" for name, value in self.rows()] + [f"Note: {text}" for text in self.warnings]

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, as plain values.

        Returns
        -------
        dict
        """
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        names = ("by_wavelength", "focused", "lenslet_sections")
        nested = {name: tuple(asdict(at) for at in values[name]) for name in names}
        error = None if self.kick_error is None else self.kick_error._asdict()
        return values | nested | {"kick_error": error, "field": self.field._asdict()}


def _section_row(at: LensletSection) -> tuple[str, str]:
    """Return the report's row for the lenslets in one section."""
    name = f"lenslets, {at.section}–z" if at.section else "lenslets, both faces"
    if at.micro_image_pitch_px is None and math.isinf(at.focal_length_mm):
        return name, "no power: light lands on lines"
    if at.micro_image_pitch_px is None:
        return name, f"focal length {_mm(at.focal_length_mm)}, focus {_mm(at.focus_behind_mm)} behind the array"
    return (
        name,
        f"focal length {_mm(at.focal_length_mm)}, f/{at.f_number:.4g}, focus {_mm(at.focus_behind_mm)} behind the "
        "array; "
        f"micro-images {at.micro_image_diameter_px:.4g} pixels wide, {at.micro_image_pitch_px:.6g} apart",
    )


def _focused_rows(at: FocusedLenslets, several: bool) -> Iterator[tuple[str, str]]:
    """Yield the report's rows for a lenslet type of a focused camera."""
    yield (
        f"lenslets, {_mm(at.focal_length_mm)}" if several else "lenslets",
        f"in focus {_mm(at.in_focus_mm)}, sharp from {_mm(at.near_mm)} to {_mm(at.far_mm)}, "
        f"{_mm(at.sampling_mm)} per pixel",
    )
    side, beyond = ("before", "farther") if at.main_image_mm > 0.0 else ("behind", "nearer")
    yield (
        "virtual depth",
        f"{abs(at.virtual_depth):.4g}: main image {_mm(abs(at.main_image_mm))} {side} the lenslets, a point seen by "
        f"{at.seen_by:.3g}",
    )
    yield (
        "total covering",
        f"at virtual depths of {at.covering_depth:.4g} or more: {_mm(at.covering_mm)} and {beyond}",
    )


def _mm(length: float) -> str:
    return f"{length:.6g} mm" if math.isfinite(length) else "infinity"


def _pixels(count: float | None, digits: int) -> str:
    return f"{count:.{digits}g} pixels" if count is not None and math.isfinite(count) else "infinite"


def _um(length_mm: float) -> str:
    return f"{1e3 * length_mm:.4g} µm" if math.isfinite(length_mm) else "infinity"


def _pupil(z: float, diameter: float) -> str:
    return f"z = {_mm(z)}, diameter {_mm(diameter)}" if math.isfinite(z) else "at infinity (telecentric)"
