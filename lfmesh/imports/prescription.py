"""A prescription as lens files hold it, with object and image, and the lens that it makes.

Files of other programs describe more than glass: planes without effect, apertures that follow from the fields, a pupil
in place of a stop. Here that becomes surfaces with clear apertures and a stop, by paraxial optics where the file leaves
a size open.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.coatings import lens_coatings
from lfmesh.imports.glasses import Medium, model_glass, named_glass, unlike
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.square_terms import SquareTerm, without_square
from lfmesh.optics.glass import AIR, D_LINE_NM, glass_name, refractive_index
from lfmesh.scene.camera.lens import Lens, Surface
from lfmesh.scene.camera.sections import AZIMUTHS
from lfmesh.scene.first_order.paraxial import Paraxial, Ray

MARGIN = 0.05
"""Share by which a clear aperture that follows from the fields is larger than the paraxial rays need."""

FAR_MM = 1e9
"""Distance of the object from which it counts as infinite; files write 1e10 to 1e14."""

OFF_MM = 1e-9
"""How far a surface may lie off after its term in r² was rewritten."""

_MOST_DIGITS = 17


@dataclass
class FileSurface:
    """A surface as the file has it, lengths in the file's unit."""

    line: int
    """Where it starts in the file, from 1."""
    text: str = ""
    curvature: float = 0.0
    thickness: float = 0.0
    glass: str | None = None
    glass_line: tuple[int, str] | None = None
    """Where the glass stands, if not on the surface's own line."""
    model: tuple[float, float] | None = None
    """nd and Vd in place of a name."""
    stated_index: float | None = None
    """nd that the file gives beside the name."""
    conic: float = 0.0
    asphere: list[float] = field(default_factory=list)
    """Coefficients of r⁴, r⁶, ..."""
    odd: list[float] = field(default_factory=list)
    """Coefficients of r³, r⁵, ..."""
    square: float = 0.0
    """Coefficient of r², beside the curvature."""
    rewritten: SquareTerm | None = None
    """What the surface was before that term was put into the others."""
    section: str | None = None
    """"biconic" or "toroid", where the section x–z is another one: the other shape is that of y–z."""
    curvature_x: float = 0.0
    conic_x: float = 0.0
    aperture: float | None = None
    """Radius beyond which the file's program stops light."""
    extent: float | None = None
    """Radius that rays of the file's fields fill: what its program computed and draws."""
    stop: bool = False
    coating: tuple[int, str, str] | None = None
    """Line, text and name of its coating."""
    focal_length: float | None = None
    """Of a thin lens in the surface's place; NaN: not given."""

    def take_square(self) -> None:
        """Put a term in r² into the curvature, the conic constant and the other terms."""
        if self.square:
            self.rewritten = SquareTerm(self.curvature, self.conic, self.square)
            self.curvature, self.conic, self.asphere = without_square(
                self.curvature, self.conic, self.asphere, self.square
            )
            self.square = 0.0


@dataclass(frozen=True)
class FieldPoint:
    """A field point of the file: where it is, and how far its beam fills the pupil upwards and downwards."""

    x: float = 0.0
    y: float = 0.0
    upper: float = 1.0
    lower: float = 1.0


@dataclass
class Prescription:
    """Content of a lens file, from the object to the image.

    Attributes
    ----------
    unit_mm : float
        Length of the file's unit.
    pupil : tuple of str and float
        What sets the aperture: "epd", "f_number" (of the object at infinity), "working_f_number", "object_na",
        "image_na", each with its value, or "stop" for the stop surface's own size.
    field_kind : str
        "angle" in degrees, "object" or "image": heights.
    makers : list of str
        Glass catalogues that the file uses, the first first.
    indices : dict
        Index, or glass, by name of the materials that the file defines itself.
    coating_file : str, optional
        Name of the file, beside this one, that defines coatings.
    """

    surfaces: list[FileSurface] = field(default_factory=list)
    name: str | None = None
    source: str | None = None
    unit_mm: float = 1.0
    pupil: tuple[str, float] = ("stop", 0.0)
    wavelengths_nm: list[float] = field(default_factory=list)
    primary: int = 0
    field_kind: str = "angle"
    fields: list[FieldPoint] = field(default_factory=list)
    makers: list[str] = field(default_factory=list)
    indices: dict[str, Medium] = field(default_factory=dict)
    coating_file: str | None = None

    @property
    def primary_nm(self) -> float:
        """Wavelength of first-order figures; the d line where the file gives none."""
        lines = self.wavelengths_nm
        return lines[min(self.primary, len(lines) - 1)] if lines else D_LINE_NM


@dataclass
class _Made:
    """The surfaces that matter, in mm, with the gaps after merging."""

    kept: list[FileSurface]
    media: list[Medium | None]
    gaps_mm: list[float]
    object_mm: float
    image_mm: float


def lens_of(prescription: Prescription, report: Report, glasses: Mapping[str, str | float] | None = None) -> Lens:
    """Return the lens of a file.

    Parameters
    ----------
    prescription : Prescription
    report : Report
        Gets what was approximated, and notes.
    glasses : mapping, optional
        Catalogue glass or index by the name that the file uses, in place of looking the name up.

    Raises
    ------
    SceneError
        The file has lines that change the image and cannot be taken; all of them are named.
    """
    if len(prescription.surfaces) < 3:
        report.raise_refusals()
        raise SceneError(f"{report.path}: holds no lens: {_count(prescription)} between the object and the image")
    for surface in prescription.surfaces:
        surface.take_square()
    media = _media(prescription, report, glasses or {})
    made = _merged(prescription, media, report)
    report.raise_refusals()
    if not made.kept:
        raise SceneError(f"{report.path}: holds no lens: all of its surfaces have the same medium on both sides")
    stop = _stop_of(made.kept)
    unit = prescription.unit_mm
    try:
        paraxial = Paraxial(
            curvatures=tuple(surface.curvature / unit for surface in made.kept),
            gaps_mm=tuple(made.gaps_mm),
            indices=(AIR, *(refractive_index(medium, prescription.primary_nm) for medium in made.media)),
            stop=stop,
            thin_powers=tuple(_thin_power(surface) / unit for surface in made.kept),
        )
    except GlassError as error:
        raise SceneError(f"{report.path}: {error}") from None
    kind, value = prescription.pupil
    # Both f-numbers are the same for an object at infinity.
    of_infinity = kind == "f_number" or (kind == "working_f_number" and _is_far(made.object_mm))
    f_number = value if of_infinity else None
    stop_mm = _stop_radius_mm(prescription, made, paraxial, report)
    radii = [shortest_radius(surface.curvature / unit) for surface in made.kept]
    apertures = _apertures_mm(prescription, made, paraxial, stop_mm, report)
    for surface, aperture in zip(made.kept, apertures, strict=True):
        if surface.rewritten is None:
            continue
        # A scene may open the stop as far as the file draws the surface.
        aperture = max(aperture, unit * (surface.extent or 0.0))
        if not (off := surface.rewritten.error_at(aperture / unit) * unit) <= OFF_MM:
            raise SceneError(
                f"{report.path}: line {surface.line}: {surface.text}: its term in r² can be written without it to "
                f"{off:.1g} mm only, {aperture:g} mm from the axis; {OFF_MM:g} mm is the limit"
            )
    coatings, names = lens_coatings(made.kept, made.media, prescription.primary_nm, prescription.coating_file, report)
    surfaces = []
    for i, (surface, medium) in enumerate(zip(made.kept, made.media, strict=True)):
        size = None if i == stop and f_number is not None else apertures[i]
        coefficients = [a * unit ** (-2 * j - 3) for j, a in enumerate(surface.asphere)]
        odd = [a * unit ** (-2 * j - 2) for j, a in enumerate(surface.odd)]
        for terms in (coefficients, odd):
            while terms and terms[-1] == 0.0:
                terms.pop()
        values: dict[str, object] = {
            "radius_mm": radii[i],
            "thickness_mm": made.gaps_mm[i] if i < len(made.gaps_mm) else None,
            "glass": None if isinstance(medium, float) else medium,
            "index": medium if isinstance(medium, float) else None,
            "semi_diameter_mm": size,
            "stop": i == stop,
            "paraxial": surface.focal_length is not None,
            "focal_length_mm": None if surface.focal_length is None else surface.focal_length * unit,
            "conic": surface.conic,
            "asphere_mm": tuple(coefficients),
            "odd_asphere_mm": tuple(odd),
            "coating": names[i],
        }
        if surface.section is not None:
            across: dict[str, float] = {"radius_x_mm": shortest_radius(surface.curvature_x / unit)}
            values[surface.section] = across | ({"conic_x": surface.conic_x} if surface.section == "biconic" else {})
        surfaces.append({key: value for key, value in values.items() if value is not None})
    try:
        surfaces = _without_crossings(surfaces, made, report)
        lens = Lens(
            name=prescription.name or None,
            source=prescription.source or None,
            surfaces=tuple(Surface(**values) for values in surfaces),
            f_number=f_number,
            coatings=coatings,
        )
    except SceneError as error:
        raise SceneError(f"{report.path}: as a lens of this program: {error}") from None
    _note(prescription, made, paraxial, report)
    return lens


def shortest_radius(curvature: float) -> float:
    """Return the radius of a curvature with the fewest digits that has exactly this curvature; inf for 0."""
    if curvature == 0 or abs(curvature) < 1e-300:
        return math.inf
    radius = 1.0 / curvature
    for digits in range(1, _MOST_DIGITS):
        rounded = float(f"{radius:.{digits}g}")
        if rounded and 1.0 / rounded == curvature:
            return rounded
    return radius


def _thin_power(surface: FileSurface) -> float:
    """Return the power of a thin lens, in the reciprocal of the file's unit; 0 for other surfaces."""
    return 0.0 if surface.focal_length is None else 1.0 / surface.focal_length


def _count(prescription: Prescription) -> str:
    number = max(0, len(prescription.surfaces) - 2)
    return f"{number} surface{'' if number == 1 else 's'}"


def _media(prescription: Prescription, report: Report, glasses: Mapping[str, str | float]) -> list[Medium | None]:
    """Return what follows each surface; None is air."""
    media: list[Medium | None] = []
    for surface in prescription.surfaces:
        medium: Medium | None = None
        at, text = surface.glass_line or (surface.line, surface.text)
        try:
            if surface.glass is not None and surface.glass in glasses:
                given = glasses[surface.glass]
                medium = given if isinstance(given, str) else float(given)
                report.add(at, text, Verdict.APPROXIMATED, f"{surface.glass}: {given} as asked for")
            elif surface.glass in prescription.indices:
                medium = prescription.indices[surface.glass]
            elif surface.glass is not None:
                found, doubt = named_glass(surface.glass, prescription.makers)
                medium = glass_name(found)
                doubts = [doubt, unlike(found, surface.stated_index) if surface.stated_index is not None else ""]
                for how in filter(None, doubts):
                    report.add(at, text, Verdict.APPROXIMATED, how)
            elif surface.model is not None:
                medium = model_glass(*surface.model, prescription.wavelengths_nm)
                if surface.model[1]:
                    how = "the normal glass of its nd and Vd"
                    report.add(at, text, Verdict.APPROXIMATED, how)
        except GlassError as error:
            report.refuse(at, text, str(error))
        media.append(None if medium == AIR else medium)
    return media


def _merged(prescription: Prescription, media: list[Medium | None], report: Report) -> _Made:
    """Leave out surfaces that neither bend nor stop light, and join the distances beside them."""
    unit = prescription.unit_mm
    distances = [surface.thickness * unit for surface in prescription.surfaces]
    made = _Made([], [], [], distances[0], 0.0)
    if media[0] is not None:
        report.refuse(prescription.surfaces[0].line, "object", "it stands in a medium; the lens must start in air")
    inner = prescription.surfaces[1:-1]
    for surface in inner:
        if surface.focal_length is not None and not surface.focal_length * surface.focal_length > 0:
            report.refuse(surface.line, surface.text, "a paraxial lens without its focal length, PARM 1")
    if inner and not any(surface.stop for surface in inner):
        inner[0].stop = True
    before: Medium | None = None
    left_out = []
    for i, surface in enumerate(inner, 1):
        kept = surface.stop or surface.aperture is not None or media[i] != before or surface.focal_length is not None
        if kept:
            made.kept.append(surface)
            made.media.append(media[i])
            made.gaps_mm.append(distances[i])
        else:
            left_out.append(str(i))
            if made.gaps_mm:
                made.gaps_mm[-1] += distances[i]
            else:
                made.object_mm += distances[i]
        before = media[i]
    if left_out:
        report.notes.append(
            f"surface{'s' if len(left_out) > 1 else ''} {', '.join(left_out)} of the file: the same medium on both "
            "sides and no aperture; left out"
        )
    if made.kept:
        made.image_mm = made.gaps_mm.pop()
    # Behind a mirror, which is refused already, light goes back.
    forward = not report.of(Verdict.REFUSED)
    for surface, distance in zip(made.kept, made.gaps_mm, strict=False):
        if forward and distance < -1e-12 * unit:
            report.refuse(
                surface.line,
                surface.text,
                f"the next surface stands {-distance:.6g} mm before this one; light must go on",
            )
    made.gaps_mm = [max(0.0, distance) for distance in made.gaps_mm]
    return made


def _stop_of(kept: list[FileSurface]) -> int:
    return next(i for i, surface in enumerate(kept) if surface.stop)


def _is_far(distance_mm: float) -> bool:
    return abs(distance_mm) >= FAR_MM


def _object_mm(made: _Made) -> float:
    return math.inf if _is_far(made.object_mm) else made.object_mm


def _stop_radius_mm(prescription: Prescription, made: _Made, paraxial: Paraxial, report: Report) -> float:
    """Return the radius of the stop that the file's pupil makes, by paraxial rays at its primary wavelength."""
    kind, value = prescription.pupil
    unit = prescription.unit_mm
    stop = made.kept[paraxial.stop]
    object_mm = _object_mm(made)
    ray = paraxial.axial_ray(object_mm)
    at_stop = abs(paraxial.to_stop(ray).height_mm)
    angle = abs(paraxial.whole(ray).angle)
    if kind == "epd":
        radius = 0.5 * value * unit * abs(paraxial.to_stop.a)
    elif kind == "f_number":
        radius = 0.5 * abs(paraxial.efl_mm) / value * abs(paraxial.to_stop.a)
    elif kind == "working_f_number":
        radius = at_stop / angle / (2.0 * value) if angle else math.inf
    elif kind == "image_na":
        radius = at_stop / angle * math.tan(math.asin(min(value, 0.999))) if angle else math.inf
    elif kind == "object_na":
        if math.isinf(object_mm):
            raise SceneError(f"{report.path}: an aperture of the object's side needs an object at a finite distance")
        radius = abs(paraxial.to_stop(Ray(object_mm, 1.0)).height_mm) * math.tan(math.asin(min(value, 0.999)))
    else:
        size = stop.aperture or stop.extent
        if not size:
            raise SceneError(f"{report.path}: line {stop.line}: neither a pupil nor the stop's own size is given")
        radius = size * unit
    if not 0 < radius < math.inf:
        raise SceneError(f"{report.path}: its {kind.replace('_', ' ')} of {value:g} makes no stop of finite size")
    if stop.aperture is not None:
        radius = min(radius, stop.aperture * unit)
    return radius


def _apertures_mm(
    prescription: Prescription, made: _Made, paraxial: Paraxial, stop_mm: float, report: Report
) -> list[float]:
    """Return the clear radius of every surface: the file's, or what its fields need."""
    unit = prescription.unit_mm
    given = [surface.aperture or surface.extent for surface in made.kept]
    needed = _needed_mm(prescription, made, paraxial, stop_mm)
    if any(surface.section for surface in made.kept):
        curvatures = tuple((s.curvature_x if s.section else s.curvature) / unit for s in made.kept)
        across = _needed_mm(prescription, made, replace(paraxial, curvatures=curvatures), stop_mm)
        needed = [max(sizes) for sizes in zip(needed, across, strict=True)]
    apertures, computed = [], []
    for i, (surface, size) in enumerate(zip(made.kept, given, strict=True)):
        if i == paraxial.stop:
            apertures.append(stop_mm)
        elif size:
            apertures.append(size * unit)
        else:
            reach = unit * min(_reach(surface.curvature, surface.conic), _reach(surface.curvature_x, surface.conic_x))
            apertures.append(min(needed[i] * (1 + MARGIN), 0.999 * reach))
            computed.append(str(i))
    if computed:
        report.notes.append(
            f"clear aperture of surface{'s' if len(computed) > 1 else ''} {', '.join(computed)}: from the fields by "
            f"paraxial marginal and chief rays, with {MARGIN:.0%} to spare"
        )
    return apertures


def _reach(curvature: float, conic: float) -> float:
    """Return the height at which a conic ends."""
    return 1.0 / abs(curvature) / math.sqrt(1 + conic) if curvature and conic > -1 else math.inf


def _needed_mm(prescription: Prescription, made: _Made, paraxial: Paraxial, stop_mm: float) -> list[float]:
    """Return the height up to which the beams of all fields fill each surface."""
    object_mm = _object_mm(made)
    marginal = paraxial.heights_mm(paraxial.marginal_ray(object_mm, stop_mm))
    pupil_mm, _ = paraxial.entrance_pupil(stop_mm)
    most = [abs(height) for height in marginal]
    for point in prescription.fields:
        size = math.hypot(point.x, point.y)
        chief = paraxial.heights_mm(_chief_ray(prescription, paraxial, size, object_mm, pupil_mm))
        for i, (axis, edge) in enumerate(zip(chief, marginal, strict=True)):
            most[i] = max(most[i], abs(axis + point.upper * edge), abs(axis - point.lower * edge))
    return most


def _chief_ray(prescription: Prescription, paraxial: Paraxial, size: float, object_mm: float, pupil_mm: float) -> Ray:
    """Return the ray of a field point through the middle of the entrance pupil, at the first vertex."""
    unit = prescription.unit_mm
    if prescription.field_kind == "angle":
        slope = math.tan(math.radians(min(size, 89.0)))
        return Ray(0.0, slope) if math.isinf(pupil_mm) else Ray(-slope * pupil_mm, slope)
    height = size * unit
    if prescription.field_kind == "image":
        scale = paraxial.efl_mm if math.isinf(object_mm) else paraxial.magnification(object_mm)
        if math.isinf(object_mm):
            slope = height / scale if scale else 0.0
            return Ray(0.0, slope) if math.isinf(pupil_mm) else Ray(-slope * pupil_mm, slope)
        height = height / scale if scale else 0.0
    if math.isinf(object_mm) or math.isinf(pupil_mm) or object_mm + pupil_mm == 0:
        return Ray(height, 0.0)
    # The object stands below the axis, so that the ray climbs through the pupil, as a positive field angle does.
    slope = height / (object_mm + pupil_mm)
    return Ray(-slope * pupil_mm, slope)


def _without_crossings(surfaces: list[dict[str, object]], made: _Made, report: Report) -> list[dict[str, object]]:
    """Shrink apertures that are drawn or followed from the fields where neighbours would cross inside them."""
    shaped = [Surface(**values) for values in surfaces]
    for i, (front, back) in enumerate(pairwise(shaped)):
        # What the file's program draws stops no light, and neither does what follows from the fields.
        free = [k for k in (i, i + 1) if not (made.kept[k].aperture or shaped[k].stop)]
        sizes = [s.semi_diameter_mm for s in (front, back) if s.semi_diameter_mm is not None]
        if not free or not sizes:
            continue
        radius = _radius_of_contact(front, back, min(sizes))
        if radius < min(sizes):
            for k in free:
                surfaces[k] = {**surfaces[k], "semi_diameter_mm": min(radius, shaped[k].semi_diameter_mm or radius)}
            how = (
                f"clear aperture of surfaces {', '.join(map(str, free))}: {radius:.6g} mm, where surfaces {i} and "
                f"{i + 1} meet"
            )
            drawn = [made.kept[k] for k in free if made.kept[k].extent]
            for surface in drawn:
                report.add(surface.line, surface.text, Verdict.APPROXIMATED, f"{how}, within what the file draws")
            if not drawn:
                report.notes.append(how)
    return surfaces


def _radius_of_contact(front: Surface, back: Surface, most: float) -> float:
    """Return the height, at most `most`, up to which two neighbours do not cross."""
    most = min(most, front.reach_mm, back.reach_mm)
    for k in range(1, 257):
        height = most * k / 256
        if max(a - b for a, b in zip(*(s.sags_mm(height, AZIMUTHS) for s in (front, back)), strict=True)) > (
            front.thickness_mm or 0.0
        ):
            return most * (k - 1) / 256
    return math.inf


def _note(prescription: Prescription, made: _Made, paraxial: Paraxial, report: Report) -> None:
    """Note what the file says beside the lens."""
    lines = ", ".join(f"{line:.10g}" for line in prescription.wavelengths_nm)
    if lines:
        report.notes.append(
            f"transport.wavelengths_nm = [{lines}]; first-order figures at {prescription.primary_nm:.10g}"
        )
    far = "inf" if _is_far(made.object_mm) else f"{made.object_mm:.10g}"
    report.notes.append(f"object: {far} mm before the first surface (camera.focus_mm)")
    report.notes.append(f"image: {made.image_mm:.10g} mm behind the last surface (camera.sensor.distance_mm)")
    points = ", ".join(f"{math.hypot(point.x, point.y):g}" for point in prescription.fields)
    if points:
        unit = "degrees" if prescription.field_kind == "angle" else f"file units on the {prescription.field_kind}"
        report.notes.append(f"fields: {points} {unit}")
    report.focal_length_mm = paraxial.efl_mm
    report.notes.append(f"focal length {paraxial.efl_mm:.10g} mm, back focal length {paraxial.bfl_mm:.10g} mm")
