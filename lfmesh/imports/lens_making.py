"""Conversion of a lens file's prescription to a lens.

Other programs' files also hold planes without effect, apertures implied by the fields, or a pupil instead of a stop.
These become clear apertures and a stop, sized by paraxial optics where necessary.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from lfmesh.errors import GlassError, SceneError
from lfmesh.imports.clear_apertures import apertures_mm, stop_radius_mm, without_crossings
from lfmesh.imports.conditions import Conditions, FieldPoint
from lfmesh.imports.decentres import START, Place, gaps, straightened
from lfmesh.imports.file_words import file_fault
from lfmesh.imports.glasses import Medium, glass_code, model_glass, named_glass, unlike
from lfmesh.imports.gradient_keys import OWN_RADIUS
from lfmesh.imports.prescription import FAR_MM, FileSurface, KeptSurfaces, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.imports.surface_coatings import lens_coatings
from lfmesh.optics.glass import AIR, D_LINE_NM, glass_name, refractive_index
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lens import FileChoices, Lens, Surface
from lfmesh.scene.first_order.paraxial import Paraxial
from lfmesh.scene.literals import literal, plain
from lfmesh.scene.materials.matter import Matter
from lfmesh.scene.quantities import LARGEST

OFF_MM = 1e-9
"""Largest deviation of a surface after its r² term was rewritten."""

MOST_LISTED = 20
"""Most configurations with listed focal lengths."""

_MOST_DIGITS = 17


def refuse_choices(path: Path, choices: FileChoices, configurations: bool = False) -> None:
    """Raise a SceneError for choices that the lens file's format does not offer.

    Parameters
    ----------
    path : Path
    choices : FileChoices
    configurations : bool
        Whether the format supports several.
    """
    for key, given in (("coating_file", choices.coating_file), ("gradient_files", choices.gradient_files)):
        if given:
            raise SceneError(f"{path}: {key} = {literal(given)}: only for .zmx files; omit it")
    if not configurations and choices.configuration not in (None, 1):
        raise SceneError(f"{path}: configuration = {choices.configuration}: the file has one configuration")


def note_focal_lengths(report: Report, count: int, report_of: Callable[[int], Report]) -> None:
    """Note the focal lengths of a file's configurations if there are several.

    Parameters
    ----------
    report : Report
    count : int
        Number of configurations.
    report_of : callable
        Returns the report of a configuration, from 1.
    """
    lengths = []
    for k in range(1, min(count, MOST_LISTED) + 1 if count > 1 else 1):
        try:
            lengths.append(f"{k}: {report_of(k).focal_length_mm:.6g} mm")
        except SceneError:
            lengths.append(f"{k}: not supported")
    if count > MOST_LISTED:
        lengths.append(f"and {count - MOST_LISTED} more")
    if lengths:
        report.notes.append(f"focal lengths of the configurations: {', '.join(lengths)}")


def lens_of(prescription: Prescription, report: Report, glasses: Mapping[str, str | float] | None = None) -> Lens:
    """Return the lens of a file.

    Parameters
    ----------
    prescription : Prescription
    report : Report
        Receives approximations and notes.
    glasses : mapping, optional
        Catalogue glass or index by name in the file, instead of a search.

    Raises
    ------
    SceneError
        Unsupported lines affect the image; the message lists all of them.
    """
    if len(prescription.surfaces) < 3:
        report.raise_refusals()
        raise SceneError(f"{report.path}: holds no lens: {_count(prescription)} between the object and the image")
    for surface in prescription.surfaces:
        surface.take_square()
    media = _media(prescription, report, glasses or {})
    made = _merged(prescription, media, report)
    report.raise_refusals()
    bends = [here != before for before, here in pairwise([media[0], *made.media])]
    if not any(bends) and all(surface.focal_length is None and surface.phase is None for surface in made.kept):
        raise SceneError(f"{report.path}: holds no lens: all of its surfaces have the same medium on both sides")
    stop = _stop_of(made.kept)
    unit = prescription.unit_mm
    made.thin_powers = [_thin_powers(i, made, prescription, report) for i in range(len(made.kept))]
    try:
        paraxial = Paraxial(
            curvatures=tuple(surface.vertex_curvature / unit for surface in made.kept),
            gaps_mm=tuple(made.gaps_mm),
            indices=tuple(refractive_index(medium, prescription.primary_nm) for medium in (media[0], *made.media)),
            stop=stop,
            thin_powers=tuple(power for power, _ in made.thin_powers),
            gradients=made.gradient_gaps(prescription.primary_nm),
        )
    except GlassError as error:
        raise SceneError(f"{report.path}: {error}") from None
    kind, value = prescription.pupil
    if kind == "image_slope":
        prescription.pupil = kind, value = "working_f_number", 0.5 / (paraxial.image_index * value)
    # Both f-numbers agree for an object at infinity.
    of_infinity = kind == "f_number" or (kind == "working_f_number" and math.isinf(made.object_mm))
    f_number = value if of_infinity else None
    stop_mm = stop_radius_mm(prescription, made, paraxial, report)
    apertures = apertures_mm(prescription, made, paraxial, stop_mm, report)
    report.raise_refusals()
    _note_telecentric(prescription, paraxial, stop_mm, report)
    for surface, aperture in zip(made.kept, apertures, strict=True):
        if surface.rewritten is None:
            continue
        # A scene may open the stop to the size that the file draws.
        aperture = max(aperture, unit * (surface.extent or 0.0))
        if not (off := surface.rewritten.error_at(aperture / unit) * unit) <= OFF_MM:
            raise SceneError(
                f"{report.path}: line {surface.line}: {surface.text}: rewriting its term in r² leaves an error of "
                f"{plain(off, 1)} mm at {aperture:g} mm from the axis; the limit is {OFF_MM:g} mm"
            )
    coatings, names = lens_coatings(made.kept, [media[0], *made.media], prescription, report)
    # Forbes' mild terms end at their radius, so an f-number cannot set the aperture.
    f_number = None if made.kept[stop].forbes else f_number
    surfaces = []
    for i, surface in enumerate(made.kept):
        given: dict[str, object] = {
            "thickness_mm": made.gaps_mm[i] if i < len(made.gaps_mm) else None,
            "semi_diameter_mm": None if i == stop and f_number is not None else apertures[i],
            "stop": i == stop,
            "coating": names[i],
        }
        # Behind a leading stop a scene assumes the object medium unless it names air.
        air: dict[str, object] = {"index": AIR} if i == 0 and media[0] is not None and made.media[0] is None else {}
        values = given | _shape(surface, unit) | (air or _medium_keys(made.media[i]))
        surfaces.append({key: value for key, value in values.items() if value is not None})
    _refuse_faulty(surfaces, made, report)
    surfaces = without_crossings(surfaces, made, report)
    report.raise_refusals()
    try:
        lens = Lens(
            name=prescription.name or None,
            source=prescription.source or None,
            surfaces=tuple(Surface(**values) for values in surfaces),
            f_number=f_number,
            coatings=coatings,
            elements=tuple(made.elements),
            object_medium=None if media[0] is None else Matter(**_medium_keys(media[0])),
        )
    except SceneError as error:
        raise SceneError(f"{report.path}: {file_fault(str(error), made.kept)}") from None
    _note(prescription, made, paraxial, report)
    return lens


def _refuse_faulty(surfaces: list[dict[str, object]], made: KeptSurfaces, report: Report) -> None:
    """Raise if a scene cannot have a surface, in terms of the file."""
    for i, values in enumerate(surfaces):
        try:
            Surface(**values)
        except SceneError as error:
            raise SceneError(f"{report.path}: {file_fault(str(error), made.kept, i)}") from None


def _shape(surface: FileSurface, unit: float) -> dict[str, object]:
    """Return the scene keys for the shape of a surface."""
    coefficients = [a * unit ** (-2 * j - 3) for j, a in enumerate(surface.asphere)]
    odd = [a * unit ** (-2 * j - 2) for j, a in enumerate(surface.odd)]
    for terms in (coefficients, odd):
        while terms and terms[-1] == 0.0:
            terms.pop()
    values: dict[str, object] = {
        "radius_mm": shortest_radius(surface.curvature / unit),
        "phase": surface.phase,
        "paraxial": surface.focal_length is not None,
        "focal_length_mm": None if surface.focal_length is None else surface.focal_length * unit,
        "conic": surface.conic,
        "asphere_mm": tuple(coefficients),
        "odd_asphere_mm": tuple(odd),
    }
    if surface.section is not None:
        across: dict[str, float] = {"radius_x_mm": shortest_radius(surface.curvature_x / unit)}
        values[surface.section] = across | ({"conic_x": surface.conic_x} if surface.section == "biconic" else {})
    if surface.outer_zone is not None:
        border, curvature, conic, terms = surface.outer_zone
        values["outer_zone"] = {
            "border_mm": border * unit,
            "radius_mm": shortest_radius(curvature / unit),
            "conic": conic,
            "asphere_mm": tuple(a * unit ** (-2 * j - 3) for j, a in enumerate(terms)),
        }
    if surface.forbes is not None:
        kind, norm_radius, terms = surface.forbes
        scaled = tuple(term * unit for term in terms)
        values[kind] = {"norm_radius_mm": norm_radius * unit, "coefficients_mm": scaled}
    return values


def _medium_keys(medium: Medium | None) -> dict[str, object]:
    key = "index" if isinstance(medium, float) else "gradient" if isinstance(medium, Gradient) else "glass"
    return {key: medium}


def shortest_radius(curvature: float) -> float:
    """Return the radius with the fewest digits that gives exactly this curvature.

    A curvature of 0, or of a radius beyond the largest in a scene, gives inf.
    """
    if curvature == 0 or abs(curvature) < 1e-300:
        return math.inf
    radius = 1.0 / curvature
    if abs(radius) > LARGEST:
        return math.inf
    for digits in range(1, _MOST_DIGITS):
        rounded = float(f"{radius:.{digits}g}")
        if rounded and 1.0 / rounded == curvature:
            return rounded
    return radius


def _thin_powers(number: int, made: KeptSurfaces, prescription: Prescription, report: Report) -> tuple[float, float]:
    """Return the power of a thin lens or a phase in the sections y–z and x–z, 1/mm; 0 for other surfaces."""
    surface = made.kept[number]
    if surface.phase is None:
        power = 0.0 if surface.focal_length is None else 1.0 / surface.focal_length / prescription.unit_mm
        return power, power
    try:
        alone, nm = Surface(phase=surface.phase), prescription.primary_nm
    except SceneError as error:
        raise SceneError(f"{report.path}: {file_fault(str(error), made.kept, number)}") from None
    return alone.added_power_per_mm(nm), alone.added_power_per_mm(nm, section_x=True)


def _count(prescription: Prescription) -> str:
    number = max(0, len(prescription.surfaces) - 2)
    return f"{number} surface{'' if number == 1 else 's'}"


def _media(prescription: Prescription, report: Report, glasses: Mapping[str, str | float]) -> list[Medium | None]:
    """Return the medium behind each surface; None is air."""
    media: list[Medium | None] = []
    for surface in prescription.surfaces:
        if surface.is_break:
            media.append(media[-1] if media else None)
            continue
        stated = None if surface.stated_index is None else (surface.stated_index, surface.stated_abbe)
        model = surface.model if surface.glass is None else glass_code(surface.glass, stated)
        medium: Medium | None = None
        at, text = surface.glass_line or (surface.line, surface.text)
        try:
            if surface.gradient is not None:
                medium = _gradient(surface, prescription.unit_mm)
                # Refused with its line if glass cannot have the index.
                refractive_index(medium, prescription.primary_nm)
            elif surface.glass is not None and surface.glass in glasses:
                given = glasses[surface.glass]
                medium = given if isinstance(given, str) else float(given)
                report.add(at, text, Verdict.APPROXIMATED, f"{surface.glass}: {given} as asked for")
            elif surface.glass in prescription.indices:
                medium = prescription.indices[surface.glass]
            elif model is not None:
                medium = model_glass(*model, prescription.wavelengths_nm)
                if model[1]:
                    report.add(at, text, Verdict.APPROXIMATED, "the normal glass of its nd and Vd")
            elif surface.glass is not None:
                found, doubt = named_glass(surface.glass, prescription.makers, stated)
                medium = glass_name(found)
                for how in filter(None, (doubt, unlike(found, stated[0]) if stated is not None else "")):
                    report.add(at, text, Verdict.APPROXIMATED, how)
        except GlassError as error:
            report.refuse(at, text, str(error))
        media.append(None if medium == AIR else medium)
    first = prescription.surfaces[0]
    if first.gradient is not None:
        report.refuse(first.line, first.text, "an object in gradient-index glass is not supported")
    return media


def _gradient(surface: FileSurface, unit: float) -> Gradient | None:
    """Return the gradient-index glass behind a surface; GlassError if a scene cannot have it."""
    keys = surface.gradient or {}
    if keys.get("radius_mm", math.inf) is OWN_RADIUS:
        keys = keys | {"radius_mm": shortest_radius(surface.curvature / unit)}
    try:
        return Surface(gradient=keys).gradient
    except SceneError as error:
        raise GlassError(file_fault(str(error), [])) from None


def _merged(prescription: Prescription, media: list[Medium | None], report: Report) -> KeptSurfaces:
    """Drop surfaces that neither refract nor stop light, and merge the distances beside them."""
    unit = prescription.unit_mm
    distances = [surface.thickness * unit for surface in prescription.surfaces]
    made = KeptSurfaces([], [], [], distances[0], 0.0)
    for surface, name in ((prescription.surfaces[0], "object"), (prescription.surfaces[-1], "image")):
        if surface.curvature or any(surface.asphere) or any(surface.odd) or surface.forbes:
            how = f"the {name} is curved in the file; here it is flat"
            report.add(surface.line, surface.text or name, Verdict.APPROXIMATED, how)
        if surface.phase is not None:
            report.add(
                surface.line, surface.text or name, Verdict.APPROXIMATED, f"the {name} has a phase; it is left out"
            )
    inner = prescription.surfaces[1:-1]
    for surface in inner:
        if surface.focal_length is not None and not surface.focal_length * surface.focal_length > 0:
            report.refuse(surface.line, surface.text, "a paraxial lens without a focal length other than 0")
    stops = [surface for surface in prescription.surfaces if surface.stop]
    usable = [surface for surface in inner if surface.stop]
    for surface in stops:
        if not usable or surface is not usable[0]:
            which = "the first of several stops" if usable else "the first surface"
            report.add(surface.line, surface.text, Verdict.APPROXIMATED, f"not the stop here: {which} is")
    if inner and not usable:
        inner[0].stop = True
    for surface in usable[1:]:
        surface.stop = False
    _move_stop(prescription, media, report)
    before = media[0]
    left_out = []
    numbers = []
    for i, surface in enumerate(inner, 1):
        acts = any(each is not None for each in (surface.focal_length, surface.phase, surface.gradient))
        if surface.stop or surface.aperture is not None or media[i] != before or acts:
            numbers.append(i)
            made.kept.append(surface)
            made.media.append(media[i])
            made.gaps_mm.append(distances[i])
        else:
            if not surface.is_break:
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
        _stand_off_axis(prescription, made, numbers, report)
    if abs(made.object_mm) >= FAR_MM:
        made.object_mm = math.inf
    # Behind a mirror, already refused, light travels backwards.
    forward = not report.of(Verdict.REFUSED)
    for surface, distance in zip(made.kept, made.gaps_mm, strict=False):
        if forward and distance < -1e-12 * unit:
            report.refuse(
                surface.line,
                surface.text,
                f"the next surface lies {-distance:.6g} mm in front of this one; a distance below 0 is supported only "
                "to a plane without effect",
            )
    made.gaps_mm = [max(0.0, distance) for distance in made.gaps_mm]
    return made


def _move_stop(prescription: Prescription, media: list[Medium | None], report: Report) -> None:
    """Make a surface the stop in place of a plane at its vertex, through which it bulges.

    Sequential programs use such planes; as bodies, the plane and the surface would cross.
    """
    surfaces = prescription.surfaces
    k = next(k for k, surface in enumerate(surfaces) if surface.stop)
    plane = surfaces[k]
    thin = plane.focal_length is not None or plane.phase is not None
    if plane.vertex_curvature or thin or any(plane.asphere) or media[k] != media[k - 1]:
        return
    after = k + 1
    while after < len(surfaces) - 1 and surfaces[after].is_break and not surfaces[after].thickness:
        after += 1
    between = surfaces[k:after]
    sides = []
    if not any(surface.thickness for surface in between) and surfaces[after].vertex_curvature < 0.0:
        sides.append((after, between))
    if not surfaces[k - 1].thickness and surfaces[k - 1].vertex_curvature > 0.0:
        sides.append((k - 1, [plane]))
    for number, passed in sides:
        surface = surfaces[number]
        moved = any(each.before or each.after or each.returns_to is not None for each in (surface, *passed))
        if moved or not 0 < number < len(surfaces) - 1 or media[number] == media[number - 1]:
            continue
        size = plane.aperture or (plane.extent if prescription.pupil[0] == "stop" else None)
        surface.aperture = min(filter(None, (size, surface.aperture)), default=None)
        surface.stop, plane.stop, plane.aperture = True, False, None
        how = f"this plane lies at the vertex of surface {number}, which bulges through it and becomes the stop"
        report.add(plane.line, plane.text, Verdict.APPROXIMATED, how)
        return


def _stop_of(kept: list[FileSurface]) -> int:
    return next(i for i, surface in enumerate(kept) if surface.stop)


def _stand_off_axis(prescription: Prescription, made: KeptSurfaces, numbers: list[int], report: Report) -> None:
    """Lay out the kept surfaces along the axis, and put surfaces moved off it into elements."""
    surfaces = prescription.surfaces
    moved = [each for each in surfaces if each.before or each.after or each.returns_to is not None]
    if not moved:
        return
    if moved[0] is surfaces[0]:
        report.refuse(surfaces[0].line, surfaces[0].text, "an object off the axis is not supported")
    for number in (*numbers, len(surfaces) - 1):
        if surfaces[number].returns_to is not None:
            why = (
                "a surface that returns to another one's place must be empty: in air or in one glass, without aperture"
            )
            report.refuse(surfaces[number].line, surfaces[number].text, why)
    places, sums = _frames(surfaces, prescription.unit_mm)
    image = places[-1]
    if not image.on_axis(float(np.linalg.norm(image.vertex))):
        aside, tilt = np.hypot(*image.vertex[:2]), math.degrees(image.turn.magnitude())
        report.refuse(
            moved[-1].line,
            moved[-1].text,
            f"the axis is not restored: the image lies {aside:.4g} mm off it, tilted by {tilt:.4g} degrees; return to "
            "the axis of the object after tilted and decentred groups",
        )
        return
    vertices, made.elements = straightened(
        [places[number - 1] for number in numbers], [sums[number - 1] for number in numbers]
    )
    made.gaps_mm = gaps(vertices)
    made.object_mm = prescription.surfaces[0].thickness * prescription.unit_mm + vertices[0]
    made.image_mm = float(image.vertex[2]) - vertices[-1]


def _frames(surfaces: list[FileSurface], unit: float) -> tuple[list[Place], list[float]]:
    """Return the frames of the surfaces after the object, and the summed thicknesses up to each, mm."""
    frames, sums = list[Place](), list[float]()
    place, total = START, 0.0
    for surface in surfaces[1:]:
        place = place.moved(surface.before) if surface.before else place
        frames.append(place)
        sums.append(total)
        place = place.moved(surface.after) if surface.after else place
        if surface.returns_to is not None:
            place, total = frames[surface.returns_to - 1], sums[surface.returns_to - 1]
        place, total = place.along(surface.thickness), total + surface.thickness * unit
    return [Place(frame.vertex * unit, frame.turn) for frame in frames], sums


def _note_telecentric(prescription: Prescription, paraxial: Paraxial, stop_mm: float, report: Report) -> None:
    """Report whether the stop makes the lens telecentric in object space, if the file asks for it."""
    if prescription.telecentric is None:
        return
    place_mm, _ = paraxial.entrance_pupil(stop_mm)
    if math.isinf(place_mm):
        report.add(*prescription.telecentric, Verdict.TAKEN, "telecentric in object space: the stop makes it so")
    else:
        how = (
            "the file asks for chief rays parallel to the axis in object space; here they pass the stop, with an "
            f"entrance pupil {place_mm:.6g} mm behind the first surface"
        )
        report.add(*prescription.telecentric, Verdict.APPROXIMATED, how)


def _note(prescription: Prescription, made: KeptSurfaces, paraxial: Paraxial, report: Report) -> None:
    """Note the file's conditions of use."""
    scale = 1.0 if prescription.field_kind == "angle" else prescription.unit_mm
    report.conditions = Conditions(
        wavelengths_nm=tuple(prescription.wavelengths_nm) or (D_LINE_NM,),
        primary=min(prescription.primary, max(0, len(prescription.wavelengths_nm) - 1)),
        field_kind=prescription.field_kind,
        fields=tuple(replace(point, x=point.x * scale, y=point.y * scale) for point in prescription.fields)
        or (FieldPoint(),),
        object_mm=made.object_mm,
        image_mm=made.image_mm,
    )
    lines = ", ".join(f"{line:.10g}" for line in prescription.wavelengths_nm)
    if lines:
        report.notes.append(
            f"transport.wavelengths_nm = [{lines}]; first-order figures at {prescription.primary_nm:.10g}"
        )
    far = "inf" if math.isinf(made.object_mm) else f"{made.object_mm:.10g}"
    report.notes.append(f"object: {far} mm before the first surface (camera.focus_mm)")
    report.notes.append(f"image: {made.image_mm:.10g} mm behind the last surface (camera.sensor.distance_mm)")
    if paraxial.image_index != AIR:
        report.notes.append(
            f"the image stands in the medium behind the last surface: index {paraxial.image_index:.10g}"
        )
    phases = [f"{i} ({surface.phase['kind']})" for i, surface in enumerate(made.kept) if surface.phase is not None]
    gradients = [f"{i} ({each.gradient['kind']})" for i, each in enumerate(made.kept) if each.gradient is not None]
    for noun, listed in (("phases", phases), ("gradients", gradients)):
        if listed:
            which = f"surface{'s' if len(listed) > 1 else ''} {', '.join(listed)}"
            report.notes.append(f"{noun}: {len(listed)}, of {which}")
    points = ", ".join(f"{math.hypot(point.x, point.y):g}" for point in prescription.fields)
    if points:
        unit = "degrees" if prescription.field_kind == "angle" else f"file units on the {prescription.field_kind}"
        report.notes.append(f"fields: {points} {unit}")
    report.focal_length_mm = paraxial.efl_mm
    report.notes.append(f"focal length {paraxial.efl_mm:.10g} mm, back focal length {paraxial.bfl_mm:.10g} mm")
