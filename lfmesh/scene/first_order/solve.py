"""Solve a scene: inline its lens file, size its stop, and find lenslet radii and distances."""

import math
from typing import Any, TypeVar

from lfmesh.errors import SceneError
from lfmesh.optics.glass import refractive_index
from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.gaps import room_mm
from lfmesh.scene.camera.lens import Lens
from lfmesh.scene.camera.lenslet_optics import lenslet_optics, main_section
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.phase_grids import refuse_small_grids, with_phase_grids
from lfmesh.scene.files import with_lens_file
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.scene.first_order.paraxial import Paraxial, Ray, gradient_gap, quotient
from lfmesh.scene.first_order.relay import relay_of, seen_size_mm
from lfmesh.scene.literals import at_least, at_most
from lfmesh.scene.materials.glass_in_air import in_its_air
from lfmesh.scene.model import Model
from lfmesh.scene.quantities import LARGEST, SMALLEST
from lfmesh.scene.scene import Scene

M = TypeVar("M", bound=Model)

BEYOND = 1e-6
"""Relative margin of an advised value inside a limit that is itself invalid."""

SPARE = 0.05
"""Relative margin of solved clear apertures over the beams that they pass."""

PLANES = 16
"""Number of equal parts of a gap of gradient-index glass between which the beams are measured."""


def solved(scene: Scene) -> Scene:
    """Return a copy of a scene with nothing left to solve.

    The lens file is inlined. Exactly one surface is the stop, with a semi-diameter in place of `f_number`, `epd_mm` and
    `stop_semi_diameter_mm`. The array has radii instead of focal lengths; array and sensor have distances.
    `camera.object_medium` becomes the lens's, `camera.image_medium` the medium behind its last surface, and every glass
    has `camera.air`. The solution is paraxial, at the primary wavelength. A solved scene is returned unchanged.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Scene

    Raises
    ------
    SceneError
        A distance is neither given nor solvable from `focus_mm`, or the result is impossible.
    """
    primary = scene.primary_nm
    lens = with_lens_file(scene.camera.lens, scene.folder)
    for i, surface in enumerate(lens.surfaces):
        if surface.refractor is not None:
            raise SceneError(
                f"camera.lens.surfaces[{i}].refractor: its faces are not measured yet; lf.first_order, lf.build and "
                "lf.render do that, or see lfmesh.geometry.lens.solved_camera"
            )
    before, behind = scene.camera.object_medium, scene.camera.image_medium
    if before is not None:
        lens = _changed(lens, object_medium=before)
    if behind is not None:
        lens = lens.looking_into(behind)
    if before is not None or behind is not None:
        outside = _changed(scene.camera, object_medium=None, image_medium=None)
        scene = scene.model_copy(update={"camera": outside})
    if lens is not scene.camera.lens:
        # The lens was read after the scene was checked: check the two together.
        scene = scene.changed({"camera.lens": lens.model_dump()}, solves=True)
    scene = with_phase_grids(in_its_air(scene))
    camera = scene.camera
    mla = _with_radii(camera.mla, primary) if camera.mla is not None else None
    camera = _changed(camera, mla=mla)
    camera = _with_distances(camera, primary)
    camera = _changed(camera, lens=_with_stop(camera, primary))
    camera = _changed(camera, lens=_with_apertures(camera, primary))
    if camera != scene.camera:
        # Check again: a larger stop, or a radius from a focal length, may make surfaces cross.
        scene = with_phase_grids(scene.changed({"camera": camera.model_dump()}, solves=True))
    refuse_small_grids(scene)
    return scene


def apparent_thickness_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the thickness of the array's plate as seen from outside, t/n; n is relative to the image medium.

    A plate with a gradient has the reduced length of its paraxial matrix in place of t/n.
    """
    mla = _array_of(camera)
    if mla.gradient is not None:
        in_x = main_section(camera, wavelength_nm) == "x"
        reduced = gradient_gap(mla.gradient, wavelength_nm, mla.thickness_mm, in_x).matrix.b
        return reduced * camera.image_index(wavelength_nm)
    return mla.thickness_mm / camera.relative_index(mla.medium, wavelength_nm)


def lenslet_focal_length_mm(camera: Camera, wavelength_nm: float) -> tuple[float, ...]:
    """Return the focal length of each lenslet type of a solved array: R / (n − 1), or that of the whole plate.

    It is in the image medium, and n relative to that. For cylinders, in the section with the power of the curved face.
    """
    mla = _array_of(camera)
    if mla.both_faces_act:
        return tuple(lenslet_optics(camera, wavelength_nm, kind).focal_length_mm for kind in range(mla.types))
    n = camera.relative_index(mla.medium, wavelength_nm)
    return tuple(radius / (n - 1) for radius in mla.radius_mm or ())


def front_principal_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the apparent distance of the front principal points behind the array's face towards the lens.

    With one curved face they are its apexes, seen t/n behind the flat face if that faces the lens. The lens focuses on
    their plane.
    """
    mla = _array_of(camera)
    if mla.both_faces_act:
        return lenslet_optics(camera, wavelength_nm).front_principal_mm
    return apparent_thickness_mm(camera, wavelength_nm) if mla.curved_side == "sensor" else 0.0


def rear_principal_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the apparent distance from the rear principal points to the array's face towards the sensor."""
    mla = _array_of(camera)
    if mla.both_faces_act:
        return lenslet_optics(camera, wavelength_nm).rear_principal_mm
    return apparent_thickness_mm(camera, wavelength_nm) if mla.curved_side == "lens" else 0.0


def image_plane_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the distance from the last vertex to the plane that the lens focuses on, in mm of the image medium."""
    if camera.mla is None:
        return (camera.sensor.distance_mm or math.nan) - cover_shift_mm(camera, wavelength_nm)
    return (camera.mla.distance_mm or math.nan) + _plane_in_array_mm(camera, wavelength_nm)


def _plane_in_array_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the distance from the array's face towards the lens to the plane that the lens focuses on.

    It is the plane of the lenslets' front principal points, or the plane before them that they relay to the sensor.
    """
    relay = relay_of(camera, wavelength_nm)
    return front_principal_mm(camera, wavelength_nm) if relay is None else -relay.before_mm


def _array_of(camera: Camera) -> MicrolensArray:
    assert camera.mla is not None
    return camera.mla


def _with_radii(mla: MicrolensArray, wavelength_nm: float) -> MicrolensArray:
    if mla.focal_length_mm is None:
        return mla if mla.radius_mm is not None else _changed(mla, radius_mm=mla.radii_mm)
    n = refractive_index(mla.medium, wavelength_nm)
    return _changed(mla, radius_mm=tuple(f * (n - 1) for f in mla.focal_length_mm), focal_length_mm=None)


def _with_distances(camera: Camera, wavelength_nm: float) -> Camera:
    mla, sensor = camera.mla, camera.sensor
    if mla is None:
        if sensor.distance_mm is None:
            distance = _focused_image_mm(camera, "camera.sensor.distance_mm", wavelength_nm)
            sensor = _changed(sensor, distance_mm=distance + cover_shift_mm(camera, wavelength_nm))
        return _changed(camera, sensor=sensor)
    if mla.distance_mm is None:
        distance = _focused_image_mm(camera, "camera.mla.distance_mm", wavelength_nm)
        distance -= _plane_in_array_mm(camera, wavelength_nm)
        if not math.isfinite(distance):
            raise SceneError(
                "camera.mla.distance_mm: missing, and cannot be solved because the lenslets are afocal, with "
                "principal points at infinity; give it"
            )
        if distance <= 0:
            raise SceneError(
                f"camera.focus_mm = {camera.focus_mm:g}: the image would lie inside the lens; focus nearer "
                "or give camera.mla.distance_mm"
            )
        mla = _changed(mla, distance_mm=distance)
    if sensor.distance_mm is None:
        behind = _focal_plane_mm(camera, wavelength_nm) + cover_shift_mm(camera, wavelength_nm)
        sensor = _changed(sensor, distance_mm=behind)
    return _changed(camera, mla=mla, sensor=sensor)


def _focused_image_mm(camera: Camera, omitted: str, wavelength_nm: float) -> float:
    """Return the image distance of `focus_mm`, which must be real."""
    if camera.focus_mm is None:
        raise SceneError(f"{omitted}: missing; give it, or give camera.focus_mm to have it solved")
    lens = Paraxial.of(camera.lens, wavelength_nm)
    if camera.focus_from == "sensor":
        return _image_by_track_mm(camera, lens, wavelength_nm)
    image = lens.image_mm(camera.focus_mm)
    if math.isinf(image) or image <= 0:
        nearest = -lens.ffl_mm
        if lens.efl_mm > 0 and camera.focus_mm <= nearest < math.inf:
            wish = (
                f"the front focal point lies {nearest:.6g} mm before the lens; give "
                f"{at_least(nearest * (1 + BEYOND))} or more"
            )
        else:
            where = "at infinity" if math.isinf(image) else f"{-image:.6g} mm before the last vertex"
            wish = (
                f"the lens, whose focal length is {lens.efl_mm:.6g} mm, images this plane {where}; focus nearer, or "
                "use a converging lens"
            )
        raise SceneError(f"camera.focus_mm = {camera.focus_mm:g}: no real image behind the lens; {wish}")
    return image


def _image_by_track_mm(camera: Camera, lens: Paraxial, wavelength_nm: float) -> float:
    """Return the image distance of an object `focus_mm` before the sensor.

    The distances x and x' from the focal points satisfy x x' = n n' f² (Newton), with 1/f the power and n, n' the
    indices before and behind the lens. Of the two solutions for a given sum x + x', the object's distance is the larger
    one.
    """
    assert camera.focus_mm is not None
    rest = -lens.ffl_mm + lens.length_mm + lens.bfl_mm + _behind_image_mm(camera, wavelength_nm)
    focal = abs(lens.efl_mm)
    if not math.isfinite(rest) or not math.isfinite(focal):
        raise SceneError(f"camera.focus_mm = {camera.focus_mm:g}: the lens is afocal; give the distances instead")
    if math.isinf(camera.focus_mm):
        image = lens.bfl_mm
    else:
        indices = lens.indices[0] * lens.image_index
        both, least = camera.focus_mm - rest, 2 * math.sqrt(indices) * focal
        if both < least:
            raise SceneError(
                f"camera.focus_mm = {camera.focus_mm:g}: no plane this far before the sensor is imaged onto it; give "
                f"{at_least(rest + least)} or more"
            )
        image = lens.bfl_mm + 2 * indices * focal**2 / (both + math.sqrt(both**2 - least**2))
    if image <= 0:
        raise SceneError(f"camera.focus_mm = {camera.focus_mm:g}: the image would lie inside the lens; focus nearer")
    return image


def _behind_image_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the distance from the plane that the lens focuses on to the sensor.

    The distance behind the lens need not be known.
    """
    mla = camera.mla
    shift = cover_shift_mm(camera, wavelength_nm)
    if mla is None:
        return shift
    behind = camera.sensor.distance_mm
    if behind is None:
        behind = _focal_plane_mm(camera, wavelength_nm) + shift
    return mla.thickness_mm - _plane_in_array_mm(camera, wavelength_nm) + behind


def focus_wished_mm(camera: Camera, wavelength_nm: float) -> float | None:
    """Return the distance before the first vertex of the object plane that `focus_mm` names, for a solved camera."""
    if camera.focus_mm is None or camera.focus_from == "first_vertex":
        return camera.focus_mm
    lens = Paraxial.of(camera.lens, wavelength_nm)
    return (
        camera.focus_mm
        - lens.length_mm
        - image_plane_mm(camera, wavelength_nm)
        - _behind_image_mm(camera, wavelength_nm)
    )


def _focal_plane_mm(camera: Camera, wavelength_nm: float) -> float:
    """Return the distance from the array's rear face to the focal plane of the first lenslet type."""
    mla, focal_length = _array_of(camera), lenslet_focal_length_mm(camera, wavelength_nm)[0]
    inside = rear_principal_mm(camera, wavelength_nm)
    if not 0 < focal_length - inside < math.inf:
        if not 0 < focal_length < math.inf:
            raise SceneError(
                f"camera.mla: the first lenslet type diverges (focal length {focal_length:.4g} mm), and has no focal "
                "plane for the sensor: give camera.sensor.distance_mm too, or converging lenslets"
            )
        why = (
            "the two faces focus light inside their plate or before it; give a thinner plate or larger radii"
            if mla.both_faces_act and mla.gradient is None
            else "the plate focuses light within itself or before it; give a thinner plate or a weaker gradient"
            if mla.gradient is not None
            else f"the lenslets' focal length of {focal_length:.6g} mm ends inside their plate; give "
            f"thickness_mm at most {at_most(mla.thickness_mm * focal_length / inside * (1 - BEYOND))}"
        )
        raise SceneError(f"camera.sensor.distance_mm: missing, and there is no focal plane for the sensor: {why}")
    return focal_length - inside


def _with_stop(camera: Camera, wavelength_nm: float) -> Lens:
    """Mark the stop, if none is marked, and size it."""
    lens = camera.lens
    number = lens.stop_index
    if number is None:
        number = _limiting_surface(camera, wavelength_nm)
    radius = lens.surfaces[number].semi_diameter_mm
    if lens.stop_semi_diameter_mm is not None:
        radius = lens.stop_semi_diameter_mm
    elif lens.f_number is not None:
        surfaces = _with_surface(lens, number, stop=True)
        paraxial = Paraxial.of(_changed(lens, surfaces=surfaces), wavelength_nm)
        # The collimated marginal ray enters at half the entrance pupil's diameter.
        radius = abs(paraxial.to_stop.a) * abs(paraxial.efl_mm) / (2 * lens.f_number)
        if not 0 < radius < math.inf:
            raise SceneError(
                f"camera.lens.f_number = {lens.f_number:g}: an afocal or telecentric lens has none; give "
                "stop_semi_diameter_mm"
            )
    elif lens.epd_mm is not None:
        surfaces = _with_surface(lens, number, stop=True)
        radius = abs(Paraxial.of(_changed(lens, surfaces=surfaces), wavelength_nm).to_stop.a) * lens.epd_mm / 2
        if not radius >= SMALLEST:
            raise SceneError(
                f"camera.lens.epd_mm = {lens.epd_mm:g}: the entrance pupil lies at infinity, without a diameter; give "
                "stop_semi_diameter_mm"
            )
    surfaces = _with_surface(lens, number, stop=True, semi_diameter_mm=radius)
    return _changed(lens, surfaces=surfaces, stop_semi_diameter_mm=None, f_number=None, epd_mm=None)


def _with_apertures(camera: Camera, wavelength_nm: float) -> Lens:
    """Give surfaces without a clear aperture the one that passes the beams of the whole picture, with `SPARE`.

    It is the sum of the heights of the marginal ray and the corner's chief ray.
    """
    lens = camera.lens
    omitted = [i for i, s in enumerate(lens.surfaces) if s.semi_diameter_mm is None and s.refractor is None]
    if not omitted:
        return lens
    for i, surface in enumerate(lens.surfaces):
        turning = {
            "phase": surface.phase is not None and any(surface.phase.gradient_rad_mm),
            "gradient": surface.gradient is not None and surface.gradient.turns_axis,
        }
        for key in (key for key, turns in turning.items() if turns):
            raise SceneError(
                f"camera.lens.surfaces[{omitted[0]}].semi_diameter_mm: missing, and the {key} of surfaces[{i}] turns "
                "light on the axis, so the beams are not known from paraxial rays; give it"
            )
    image = image_plane_mm(camera, wavelength_nm)
    object_mm = Paraxial.of(lens, wavelength_nm).object_mm(image)
    sections = (False,) if lens.number_off_revolution is None else (False, True)
    beams = [_beam_mm(camera, wavelength_nm, object_mm, image, section_x=section) for section in sections]
    for i in omitted:
        surface = lens.surfaces[i]
        wished = (1 + SPARE) * max(beam[i] for beam in beams)
        if not SMALLEST <= wished <= LARGEST:
            raise SceneError(
                f"camera.lens.surfaces[{i}].semi_diameter_mm: missing, and the beams through this surface would be "
                f"{2 * wished:.4g} mm wide; give it"
            )
        wished = min(wished, surface.reach_mm * (1 - SPARE))
        for k in (i - 1, i):
            if 0 <= k < len(lens.surfaces) - 1:
                wished = min(wished, _room_mm(lens, k, wished))
        lens = _changed(lens, surfaces=_with_surface(lens, i, semi_diameter_mm=wished))
    return lens


def _beam_mm(camera: Camera, wavelength_nm: float, object_mm: float, image: float, *, section_x: bool) -> list[float]:
    """Return the largest height of the whole picture's beams at each surface, by paraxial rays.

    Both faces of gradient-index glass are as high as the beams between them, where rays bend outwards and back.
    """
    lens, paraxial = camera.lens, Paraxial.of(camera.lens, wavelength_nm, section_x=section_x)
    radius = lens.surfaces[paraxial.stop].semi_diameter_mm or math.nan
    marginal = paraxial.rays_behind(paraxial.marginal_ray(object_mm, radius))
    behind, reduced = paraxial.from_stop(Ray(0.0, 1.0)), image / paraxial.image_index
    width, height = seen_size_mm(camera, relay_of(camera, wavelength_nm))
    slope = quotient(0.5 * math.hypot(width, height), abs(behind.height_mm + reduced * behind.angle))
    chief = paraxial.rays_behind(Ray(-slope * paraxial.to_stop.b, slope * paraxial.to_stop.a))
    beam = [abs(edge.height_mm) + abs(axis.height_mm) for edge, axis in zip(marginal, chief, strict=True)]
    for number, surface in enumerate(lens.surfaces[:-1]):
        if surface.gradient is None:
            continue
        for k in range(1, PLANES):
            length = (surface.thickness_mm or 0.0) * k / PLANES
            part = gradient_gap(surface.gradient, wavelength_nm, length, section_x).matrix
            height = abs(part(marginal[number]).height_mm) + abs(part(chief[number]).height_mm)
            beam[number : number + 2] = [max(each, height) for each in beam[number : number + 2]]
    return beam


def _room_mm(lens: Lens, number: int, widest_mm: float) -> float:
    """Return the largest height with a clear gap from surface `number` to the next, at most `widest_mm`."""
    front, back = lens.surfaces[number], lens.surfaces[number + 1]
    if front.refractor is not None or back.refractor is not None:
        return widest_mm
    inside = min(front.reach_mm, back.reach_mm, front.semi_diameter_mm or math.inf, back.semi_diameter_mm or math.inf)
    most = min(widest_mm, inside)
    room = room_mm(front, back, most)
    return room * (1 - SPARE) if room < most else widest_mm


def _limiting_surface(camera: Camera, wavelength_nm: float) -> int:
    """Return the surface that the growing axial beam of the focused object fills first."""
    paraxial = Paraxial.of(camera.lens, wavelength_nm)
    object_mm = paraxial.object_mm(image_plane_mm(camera, wavelength_nm))
    heights = paraxial.heights_mm(paraxial.axial_ray(object_mm))
    filling = [
        abs(height) / (surface.semi_diameter_mm or math.inf)
        for height, surface in zip(heights, camera.lens.surfaces, strict=True)
    ]
    return filling.index(max(filling))


def _with_surface(lens: Lens, number: int, **values: Any) -> tuple[Any, ...]:
    surfaces = list(lens.surfaces)
    surfaces[number] = surfaces[number].model_copy(update=values)
    return tuple(surfaces)


def _changed(model: M, **values: Any) -> M:
    return model.model_copy(update=values)
