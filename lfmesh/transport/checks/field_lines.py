"""Deflection by media that bend light, in words: in pixels and lenslets of the picture, with the errors of the grid."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from lfmesh.geometry import frame
from lfmesh.optics.index_field_path import INSIDE, deflections, entries, traced
from lfmesh.optics.index_fields import LEAPFROG, field_table
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.literals import counted
from lfmesh.transport.checks.media_places import lines_of_sight
from lfmesh.transport.tables.bending_fields import FieldMedium
from lfmesh.transport.tables.field_lines import corners_in_camera, from_world, near_end_mm


def field_lines(media: Sequence[FieldMedium], scene: Scene, facts: FirstOrder) -> list[str]:
    """Describe the deflection by each medium that bends light, and how rays are traced through it.

    Parameters
    ----------
    media : sequence of FieldMedium
    scene : Scene
        Solved.
    facts : FirstOrder
    """
    return [line for each in media for line in _lines(each, scene, facts)]


def _lines(each: FieldMedium, scene: Scene, facts: FirstOrder) -> Iterator[str]:
    probe, seen = each.probe, seen_deflection(each, scene, facts)
    if not probe.deflection > 0.0:
        yield f"{each.medium.name}: its index is uniform, so it refracts light at its faces alone"
        return
    yield f"{each.medium.name}: bends light by up to {_angle(probe.deflection)}, seen from the camera by {_angle(seen)}"
    near_mm = near_end_mm(each, scene)
    for name, distance_mm in (("far background", math.inf), ("plane in focus", facts.object_distance_mm)):
        if distance_mm > near_mm and (shift := picture_shift(seen, near_mm, distance_mm, scene, facts)):
            yield f"  {name:<20} moves by up to {shift}"
    yield f"  integration          {_steps(each)}, wrong by {_share(probe.integration_error)} of the deflection"
    if not each.medium.formulas:
        yield f"  error of the grid    {_share(probe.grid_error)} of the deflection"
    if probe.trapped:
        yield f"Note: {each.medium.name} traps light: {counted(probe.trapped, 'probe ray')} did not leave it"


def seen_deflection(each: FieldMedium, scene: Scene, facts: FirstOrder) -> float:
    """Return the largest deflection of chief rays by a medium, rad; for a formula, that of probe rays.

    Parameters
    ----------
    each : FieldMedium
    scene : Scene
        Solved.
    facts : FirstOrder
    """
    if each.medium.formulas:
        return each.probe.deflection
    start, way = lines_of_sight(corners_in_camera(each, scene), facts)
    to_own = frame.inverse(frame.compose(from_world(scene), each.medium.to_world))
    table = field_table([each.field])
    strongest = int(np.argmax(np.abs(each.field.scales)))
    rays = entries(table, strongest, frame.points(to_own, start), frame.directions(to_own, way))
    rays = rays[~np.isnan(rays[:, 0])]
    faces, ends = traced(table, strongest, rays)
    out = faces != INSIDE
    return float(deflections(rays[out], ends[out]).max(initial=0.0))


def picture_shift(angle: float, near_mm: float, distance_mm: float, scene: Scene, facts: FirstOrder) -> str:
    """Return the largest shift of the picture of a background by a deflection, in pixels and lenslets.

    A ray from the camera that turns by the angle where it enters the field meets the background beside its place by the
    angle times the distance from the field. "" if the camera's field of view has no width.

    Parameters
    ----------
    angle : float, rad
    near_mm, distance_mm : float
        Distances of the near end of the field, and of the background, before the first vertex; the latter may be inf.
    scene : Scene
        Solved.
    facts : FirstOrder
    """
    sensor, mla = scene.camera.sensor, scene.camera.mla
    shifts = []
    for axis in range(2):
        # The width of the field of view belongs to the smaller one of sensor and array.
        size = sensor.size_mm[axis] if mla is None else min(sensor.size_mm[axis], mla.size_mm[axis])
        wide = abs(facts.field.slope[axis]) if math.isinf(distance_mm) else facts.field.size_mm(-distance_mm)[axis]
        across = angle * (1.0 if math.isinf(distance_mm) else distance_mm - near_mm)
        if wide > 0.0 and math.isfinite(wide):
            shifts.append(across / wide * size)
    if not shifts:
        return ""
    pixels = f"{max(shifts) / sensor.pixel_mm:.3g} pixels"
    return pixels if mla is None else f"{pixels}, {max(shifts) / mla.pitch_mm:.3g} lenslets"


def _steps(each: FieldMedium) -> str:
    scheme = "leapfrog" if each.probe.scheme == LEAPFROG else "Runge-Kutta"
    size = f"{each.field.step_cells:g} voxels" if not each.medium.formulas else f"{each.field.spacing_mm[0]:.3g} mm"
    return f"{scheme} steps of {size}"


def _angle(angle: float) -> str:
    return f"{1e3 * angle:.3g} mrad"


def _share(error: float) -> str:
    return f"{100.0 * error:.3g} %"
