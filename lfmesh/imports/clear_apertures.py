"""Clear apertures of an imported lens: from the file, or by paraxial rays from its pupil and fields."""

import math
from dataclasses import replace
from itertools import pairwise

from lfmesh.errors import SceneError
from lfmesh.imports.prescription import FileSurface, KeptSurfaces, Prescription
from lfmesh.imports.report import Report, Verdict
from lfmesh.scene.camera.gaps import room_mm
from lfmesh.scene.camera.lens import Surface
from lfmesh.scene.first_order.paraxial import Paraxial, Ray

MARGIN = 0.05
"""Relative margin of a computed clear aperture over the paraxial beams."""

BESIDE_AXIS = 1.0 / 256.0
"""Fraction of a clear aperture within which crossing surfaces cross beside the axis, so that no aperture would help."""


def stop_radius_mm(prescription: Prescription, made: KeptSurfaces, paraxial: Paraxial, report: Report) -> float:
    """Return the radius of the stop for the file's pupil, by paraxial rays at its primary wavelength.

    Parameters
    ----------
    prescription : Prescription
    made : KeptSurfaces
    paraxial : Paraxial
        Paraxial system of the kept surfaces.
    report : Report
        Names the file in errors.

    Raises
    ------
    SceneError
        The pupil gives no stop of finite size.
    """
    kind, value = prescription.pupil
    unit = prescription.unit_mm
    stop = made.kept[paraxial.stop]
    object_mm = made.object_mm
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
        # The ray's angle is reduced, as the numerical aperture is: n' sin u'.
        behind = paraxial.image_index
        radius = at_stop / angle * behind * math.tan(math.asin(min(value / behind, 0.999))) if angle else math.inf
    elif kind == "object_na":
        if math.isinf(object_mm):
            raise SceneError(f"{report.path}: an object-space aperture needs an object at a finite distance")
        sine = min(value / paraxial.indices[0], 0.999)
        radius = abs(paraxial.to_stop(Ray(object_mm, paraxial.indices[0])).height_mm) * math.tan(math.asin(sine))
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


def apertures_mm(
    prescription: Prescription, made: KeptSurfaces, paraxial: Paraxial, stop_mm: float, report: Report
) -> list[float]:
    """Return the clear radius of every surface: from the file, or as its fields need.

    Parameters
    ----------
    prescription : Prescription
    made : KeptSurfaces
    paraxial : Paraxial
        Paraxial system of the kept surfaces.
    stop_mm : float
        Radius of the stop.
    report : Report
        Receives the computed apertures.
    """
    unit = prescription.unit_mm
    given = [surface.aperture or surface.extent for surface in made.kept]
    needed = _needed_mm(prescription, made, paraxial, stop_mm)
    if any(surface.section or surface.phase or surface.gradient for surface in made.kept):
        in_x = replace(
            paraxial,
            curvatures=tuple((s.curvature_x if s.section else s.vertex_curvature) / unit for s in made.kept),
            thin_powers=tuple(power for _, power in made.thin_powers),
            gradients=made.gradient_gaps(prescription.primary_nm, section_x=True),
        )
        across = _needed_mm(prescription, made, in_x, stop_mm)
        needed = [max(sizes) for sizes in zip(needed, across, strict=True)]
    axial = paraxial.heights_mm(paraxial.marginal_ray(made.object_mm, stop_mm))
    apertures, computed = [], []
    for i, (surface, size) in enumerate(zip(made.kept, given, strict=True)):
        reach = unit * min(_reach(surface.curvature, surface.conic), _reach(surface.curvature_x, surface.conic_x))
        if i == paraxial.stop:
            apertures.append(stop_mm)
        elif size:
            apertures.append(size * unit)
        else:
            apertures.append(min(needed[i] * (1 + MARGIN), 0.999 * reach))
            computed.append(str(i))
        if i != paraxial.stop and apertures[-1] > reach:
            _end_at(reach, apertures[-1], abs(axial[i]), surface, report)
            apertures[-1] = reach
        end = surface.forbes[1] * unit if surface.forbes and surface.forbes[0] == "qbfs" else math.inf
        if apertures[-1] > end:
            how = f"clear aperture of surface {i}: {end:.6g} mm, where its terms end, not {apertures[-1]:.6g} mm"
            report.add(surface.line, surface.text, Verdict.APPROXIMATED, how)
            apertures[-1] = end
    if computed:
        report.notes.append(
            f"clear aperture of surface{'s' if len(computed) > 1 else ''} {', '.join(computed)}: from the fields by "
            f"paraxial marginal and chief rays, with {MARGIN:.0%} to spare"
        )
    return apertures


def _end_at(reach: float, size: float, beam: float, surface: FileSurface, report: Report) -> None:
    """Report that a surface ends inside its clear aperture; refuse it if it ends inside the axial beam."""
    if beam < reach:
        how = f"semi-diameter {size:.6g} mm: reduced to {reach:.6g} mm, where the surface ends"
        report.add(surface.line, surface.text, Verdict.APPROXIMATED, how)
    else:
        why = f"the surface ends {reach:.6g} mm from the axis, within the beam of {beam:.6g} mm radius"
        report.refuse(surface.line, surface.text, why)


def _reach(curvature: float, conic: float) -> float:
    """Return the largest height of a conic."""
    return 1.0 / abs(curvature) / math.sqrt(1 + conic) if curvature and conic > -1 else math.inf


def _needed_mm(prescription: Prescription, made: KeptSurfaces, paraxial: Paraxial, stop_mm: float) -> list[float]:
    """Return, for each surface, the largest height of the beams of all fields."""
    object_mm = made.object_mm
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
    """Return the chief ray of a field point, at the first vertex."""
    unit, index = prescription.unit_mm, paraxial.indices[0]
    if prescription.field_kind == "angle":
        slope = math.tan(math.radians(min(size, 89.0)))
        return Ray(0.0 if math.isinf(pupil_mm) else -slope * pupil_mm, index * slope)
    height = size * unit
    if prescription.field_kind == "image":
        scale = index * paraxial.efl_mm if math.isinf(object_mm) else paraxial.magnification(object_mm)
        if math.isinf(object_mm):
            slope = height / scale if scale else 0.0
            return Ray(0.0 if math.isinf(pupil_mm) else -slope * pupil_mm, index * slope)
        height = height / scale if scale else 0.0
    if math.isinf(object_mm) or math.isinf(pupil_mm) or object_mm + pupil_mm == 0:
        return Ray(height, 0.0)
    # The object point is below the axis, so that the ray rises through the pupil, as for a positive field angle.
    slope = height / (object_mm + pupil_mm)
    return Ray(-slope * pupil_mm, index * slope)


def without_crossings(surfaces: list[dict[str, object]], made: KeptSurfaces, report: Report) -> list[dict[str, object]]:
    """Shrink drawn or computed apertures inside which neighbouring surfaces would cross.

    Parameters
    ----------
    surfaces : list of dict
        Scene keys of each surface.
    made : KeptSurfaces
    report : Report
        Receives the reduced apertures.
    """
    shaped = [Surface(**values) for values in surfaces]
    for i, (front, back) in enumerate(pairwise(shaped)):
        # Neither drawn nor computed apertures stop light.
        free = [k for k in (i, i + 1) if not (made.kept[k].aperture or shaped[k].stop)]
        sizes = [s.semi_diameter_mm for s in (front, back) if s.semi_diameter_mm is not None]
        if not free or not sizes:
            continue
        radius = _radius_of_contact(front, back, min(sizes))
        if radius == 0.0:
            first, second = made.kept[i : i + 2]
            why = f"it crosses the next surface, line {second.line}, off the axis; {front.thickness_mm:g} mm apart"
            report.refuse(first.line, first.text, why)
        elif radius < min(sizes):
            for k in free:
                surfaces[k] = {**surfaces[k], "semi_diameter_mm": min(radius, shaped[k].semi_diameter_mm or radius)}
            how = (
                f"clear aperture of surface{'s' if len(free) > 1 else ''} {', '.join(map(str, free))}: {radius:.6g} "
                f"mm, where surfaces {i} and {i + 1} meet"
            )
            drawn = [made.kept[k] for k in free if made.kept[k].extent]
            for surface in drawn:
                report.add(surface.line, surface.text, Verdict.APPROXIMATED, f"{how}, inside the drawn size")
            if not drawn:
                report.notes.append(how)
    return surfaces


def _radius_of_contact(front: Surface, back: Surface, most: float) -> float:
    """Return the height, at most `most`, within which two neighbours do not cross."""
    most = min(most, front.reach_mm, back.reach_mm)
    room = room_mm(front, back, most)
    return math.inf if room == most else room if room > BESIDE_AXIS * most else 0.0
