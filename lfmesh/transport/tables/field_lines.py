"""Deflection by media that bend light, in words: in pixels and lenslets of the picture, with the errors of the grid."""

import math
from collections.abc import Iterator, Sequence

from lfmesh.errors import CoarseFieldWarning
from lfmesh.geometry import frame
from lfmesh.optics.index_fields import LEAPFROG
from lfmesh.scene import FirstOrder, Scene
from lfmesh.scene.literals import counted
from lfmesh.transport.tables.bending_fields import FieldMedium


def coarse_fields(media: Sequence[FieldMedium]) -> Iterator[CoarseFieldWarning]:
    """Yield a warning for each grid that is too coarse for its deflection.

    Parameters
    ----------
    media : sequence of FieldMedium
    """
    for each in media:
        if not each.medium.formulas and (why := each.probe.fault()) is not None:
            yield CoarseFieldWarning(f"{each.medium.name}: {why}")


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
    probe, angle = each.probe, each.probe.deflection
    yield f"{each.medium.name}: bends light" + ("" if angle > 0.0 else " at its faces alone: its index is uniform")
    if angle > 0.0:
        yield f"  largest deflection   {_angle_in_words(angle)}"
        pose = frame.frame(scene.camera.pose.tilt_deg, scene.camera.pose.shift_mm)
        near_mm = float((-frame.points(frame.inverse(pose), each.medium.corners_mm())[:, 2]).min())
        for name, distance_mm in (("far background", math.inf), ("plane in focus", facts.object_distance_mm)):
            if distance_mm > near_mm and (shift := picture_shift(angle, near_mm, distance_mm, scene, facts)):
                yield f"  {name:<20} moves by up to {shift}"
        yield f"  integration          {_steps_in_words(each)}, wrong by {_share(probe.integration_error)}"
        if not each.medium.formulas:
            yield f"  error of the grid    {_share(probe.grid_error)}, in the deflection"
    if probe.trapped:
        yield f"Note: {each.medium.name} traps light: {counted(probe.trapped, 'probe ray')} did not leave it"


def picture_shift(angle: float, near_mm: float, distance_mm: float, scene: Scene, facts: FirstOrder) -> str:
    """Return the largest shift of the picture of a background by a deflection, in pixels and lenslets.

    A ray from the camera that turns by the angle where it enters the field meets the background beside its place by the
    angle times the distance from the field. "" if the camera's field of view has no such width.

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


def _steps_in_words(each: FieldMedium) -> str:
    leapfrog = each.probe.scheme == LEAPFROG
    steps = f"{each.field.step_cells:g} voxels" if not each.medium.formulas else f"{each.field.spacing_mm[0]:.3g} mm"
    return f"{'leapfrog' if leapfrog else 'Runge-Kutta'} steps of {steps}"


def _angle_in_words(angle: float) -> str:
    return f"{1e3 * angle:.3g} mrad ({math.degrees(angle):.3g} degrees)"


def _share(error: float) -> str:
    return f"{100.0 * error:.2g} %"
