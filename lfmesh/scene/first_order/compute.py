"""Compute the figures of the first-order report from the paraxial lens."""

import math
from collections.abc import Iterator
from dataclasses import replace

from lfmesh.scene.advice import warnings
from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.first_order.conjugates import along_images, along_shifts
from lfmesh.scene.first_order.cover import cover_shift_mm
from lfmesh.scene.first_order.field_of_view import FieldOfView
from lfmesh.scene.first_order.focused import focused_lenslets, middle_of, sensor_over_focal_length
from lfmesh.scene.first_order.kick_error import KickError, kick_error
from lfmesh.scene.first_order.lenslet_waves import error_on_true_faces
from lfmesh.scene.first_order.lenslets import lenslet_sections, lenslet_to_sensor_mm, micro_image
from lfmesh.scene.first_order.paraxial import Paraxial, quotient
from lfmesh.scene.first_order.relay import Relay, relay_of
from lfmesh.scene.first_order.report import CONVENTIONAL, GALILEAN, KEPLERIAN, STANDARD, AtWavelength, FirstOrder
from lfmesh.scene.first_order.solve import image_plane_mm, solved
from lfmesh.scene.scene import Scene

AIRY_RING = 1.2196698912665045
"""First zero of the Bessel function J₁ over π."""


def first_order(scene: Scene) -> FirstOrder:
    """Solve a scene and compute its first-order report.

    The micro-image pitch follows from the chief rays. A lenslet's principal points lie `D` behind the exit pupil and
    (seen from the medium around it) `d` before the sensor. A ray from the centre of the pupil through them lands
    (D + d)/D times the lenslet's offset from the axis. The front principal point of a plano-convex lenslet is its apex,
    seen through the plate if the flat face faces the lens.

    The refocus range ends where the shift between neighbouring views is one lenslet. Views a pixel apart are
    δu = pixel · D/d apart on the exit pupil. An image point ε behind the array shifts by δu · ε/(D + ε) between them.
    Equating that to ± one pitch p gives ε = ± (p d / pixel) / (1 ∓ p/δu). For a distant pupil this is the result of
    R. Ng et al. ("Light field photography with a hand-held plenoptic camera", Stanford CTSR 2005-02): P × P pixels per
    lenslet refocus exactly within the depth of field of an f-number P times higher.

    The Airy disks (`airy_disk_mm`) are for the scene's longest wavelength. The lens's follows from its working
    f-number, a lenslet's from its reduced distance to the sensor over its pitch or clear diameter. (A square lenslet
    has its first dark lines 2 λ N apart; the circle as wide as the pitch represents it.)

    Raises
    ------
    SceneError
        As in `solved`.
    """
    ready = solved(scene)
    return with_warnings(ready, without_warnings(ready))


def with_warnings(scene: Scene, facts: FirstOrder) -> FirstOrder:
    """Return the report of a solved scene with its warnings added."""
    return replace(facts, warnings=warnings(scene, facts))


def without_warnings(scene: Scene) -> FirstOrder:
    """Return the report of a solved scene without its warnings, which take longest."""
    facts = facts_of_solved(scene)
    return replace(facts, kick_error=_kick_error(scene, facts))


def facts_of_solved(scene: Scene) -> FirstOrder:
    """Return the report of a solved scene without the slow parts: warnings and picture errors."""
    camera, wavelength = scene.camera, scene.primary_nm
    lens = Paraxial.of(camera.lens, wavelength)
    stop_radius = camera.lens.surfaces[lens.stop].semi_diameter_mm or math.nan
    entrance_z, entrance_diameter = lens.entrance_pupil(stop_radius)
    exit_z, exit_diameter = lens.exit_pupil(stop_radius)
    relay = relay_of(camera, wavelength)
    plane = image_plane_mm(camera, wavelength)

    def cone(image_mm: float) -> float:
        own = abs(lens.chief_height_mm(image_mm)) / (2.0 * stop_radius)
        return own if relay is None else max(own, relay.f_number)

    f_number = cone(plane)
    # Distance from the exit pupil over its diameter: with 1 / (2 n' u') the f-number, 1 / (2 u').
    ratio = lens.image_index * f_number
    per_pupil = quotient(lens.from_stop.d / lens.image_index, lens.chief_height_mm(plane))
    micro = micro_image(camera, wavelength, per_pupil, ratio) if relay is None else None
    focused = focused_lenslets(camera, wavelength, lens, quotient(1.0, ratio), per_pupil) if relay is None else ()
    standard = micro is not None and not focused
    image, sample = plane, camera.mla.pitch_mm if camera.mla is not None and standard else camera.sensor.pixel_mm
    kind = STANDARD if standard else CONVENTIONAL
    if focused:
        middle = middle_of(focused)
        image, sample = plane - middle.main_image_mm, sample * abs(middle.virtual_depth)
        kind = KEPLERIAN if middle.main_image_mm > 0.0 else GALILEAN
    if relay is not None:
        sample /= abs(relay.magnification)
    distance = lens.object_mm(image)
    magnification = lens.magnification_onto(image)
    near, far, refocused = _refocus_range(camera, wavelength, lens, ratio, relay)
    if focused:
        near, far = min(at.near_mm for at in focused), max(at.far_mm for at in focused)
        refocused = ()
    across = (
        Paraxial.of(camera.lens, wavelength, section_x=True) if camera.lens.number_off_revolution is not None else lens
    )
    field = FieldOfView.of(camera, (across, lens), (plane, image), stop_radius, relay)
    longest = scene.reach_nm[1]
    airy = airy_disk_mm(longest, cone(image))
    # A lenslet diffracts at its clear aperture, but its micro-images are a pitch apart.
    clear = (camera.mla.clear_diameter_mm or camera.mla.pitch_mm) if camera.mla else math.nan
    own = micro[0] * camera.mla.pitch_mm / clear if micro and camera.mla else None
    fresnel = clear / (4e-6 * longest * own) if own else None
    facts = FirstOrder(
        wavelength_nm=wavelength,
        efl_mm=lens.efl_mm,
        bfl_mm=lens.bfl_mm,
        ffl_mm=lens.ffl_mm,
        front_principal_plane_z_mm=lens.front_principal_mm,
        rear_principal_plane_z_mm=lens.rear_principal_mm,
        entrance_pupil_z_mm=entrance_z,
        entrance_pupil_diameter_mm=entrance_diameter,
        exit_pupil_z_mm=exit_z,
        exit_pupil_diameter_mm=exit_diameter,
        kind=kind,
        object_distance_mm=distance,
        image_z_mm=lens.length_mm + image,
        lenslets_z_mm=lens.length_mm + plane if micro else None,
        magnification=magnification,
        working_f_number=f_number,
        microlens_f_number=micro[0] if micro else None,
        micro_image_pitch_px=micro[1] if micro else None,
        micro_image_diameter_px=micro[2] if micro else None,
        object_sampling_mm=_on_object(sample, magnification),
        field_of_view_mm=field.size_mm(-distance),
        field=field,
        airy_wavelength_nm=longest,
        airy_disk_mm=airy,
        airy_disk_samples=airy / sample,
        microlens_airy_disk_px=airy_disk_mm(longest, own) / camera.sensor.pixel_mm if own else None,
        microlens_fresnel_number=fresnel,
        kick_error=None,
        near_mm=near,
        far_mm=far,
        view_spacing_mm=quotient(entrance_diameter, micro[2]) if micro and standard and f_number else None,
        views_across=micro[2] if micro and standard and f_number else None,
        refocused_mm=refocused,
        cover_shift_mm=cover_shift_mm(camera, wavelength) if camera.sensor.cover is not None else None,
        by_wavelength=tuple(_by_wavelength(scene, lens, distance)),
        focused=focused,
        relay_magnification=None if relay is None else relay.magnification,
        lenslet_sections=tuple(lenslet_sections(camera, wavelength, lens, ratio if relay is None else None)),
        object_index=lens.indices[0],
        image_index=lens.image_index,
        poses=tuple(_pose_lines(camera)),
    )
    if across is not lens:
        facts = replace(facts, efl_x_mm=across.efl_mm, image_x_shift_mm=across.image_mm(distance) - image)
    return facts


def _kick_error(scene: Scene, facts: FirstOrder) -> KickError | None:
    """Return picture errors with and without diffraction; None beyond the tables, and if these do not apply.

    They do not apply to round apertures, phases and gradients.

    True faces are used if the lenslets' diffraction is traced, or a warning says that it is not.
    """
    camera, mla, fresnel = scene.camera, scene.camera.mla, facts.microlens_fresnel_number
    pitch, diameter = facts.micro_image_pitch_px, facts.micro_image_diameter_px
    if mla is None or mla.clear_diameter_mm is not None or mla.phases or mla.gradient is not None:
        return None
    if not fresnel or pitch is None or diameter is None:
        return None
    beyond, width = sensor_over_focal_length(camera, facts.wavelength_nm), abs(quotient(diameter, pitch))
    if not beyond or not 0.0 < width < math.inf:
        return None
    pixels = max(1, round(mla.pitch_mm / camera.sensor.pixel_mm))
    error = kick_error(fresnel, beyond, layout=mla.layout, in_focus=not facts.focused, width=width, pixels=pixels)
    if error is None or not (scene.transport.diffraction == "lenslets" or (facts.microlens_airy_disk_px or 0.0) > 1.0):
        return error
    white = error_on_true_faces(camera, scene.reach_nm[1], facts.image_index * facts.working_f_number)
    return error if white is None else error._replace(white_with=white, true_faces=True)


def airy_disk_mm(wavelength_nm: float, f_number: float) -> float:
    """Return the diameter of the first dark ring around the image of a point: 2.44 λ N.

    The first zero of J₁ is at 1.2197 π, so the ring has the radius 1.22 λ N (Born and Wolf, Principles of Optics,
    section 8.5.2). N = 1 / (2 n' sin θ') is the f-number of the converging cone, and λ the wavelength in air.
    """
    return 2.0 * AIRY_RING * wavelength_nm * 1e-6 * f_number


def _refocus_depth_mm(camera: Camera, wavelength_nm: float, ratio: float) -> float:
    """Return the depth of the refocus range on each side of the image plane, for a distant pupil.

    Without an array, the blur within it is at most a pixel: the pupil's diameter replaces the view spacing.
    """
    pixel = camera.sensor.pixel_mm
    if camera.mla is None:
        return pixel * ratio
    return camera.mla.pitch_mm * lenslet_to_sensor_mm(camera, wavelength_nm) / pixel


def _refocus_range(
    camera: Camera, wavelength_nm: float, lens: Paraxial, ratio: float, relay: Relay | None
) -> tuple[float, float, tuple[tuple[float, float, float], ...]]:
    """Return the ends of the refocus range, and the depth of field of photographs in it, in mm.

    The plane of lenslets or sensor is shifted by up to `_refocus_depth_mm`. `ratio` is the exit pupil's distance over
    its diameter. The plane that a relay images is sharp to a pixel of its own image: by all rods if their images join,
    otherwise by a single one.
    """
    plane = image_plane_mm(camera, wavelength_nm)
    shifts = along_shifts(lens, plane)
    if relay is not None:
        rods = lens.image_index * (relay.f_number if relay.joins(camera) else relay.lenslet_f_number)
        if rods >= ratio:
            ratio, shifts = rods, along_images(lens, plane)
        depth = camera.sensor.pixel_mm / abs(relay.magnification) * ratio
        return *shifts.between_mm(-depth, depth), ()
    depth = abs(_refocus_depth_mm(camera, wavelength_nm, ratio))
    near, far = shifts.between_mm(-depth, depth)
    if camera.mla is None:
        return near, far, ()
    sharp = camera.mla.pitch_mm * ratio
    # The farthest photograph is one of infinity, not of image points in front of infinity's image.
    farthest, nearest = shifts.real(-depth, depth) or (-depth, depth)
    planes = (near, nearest), (shifts.object_mm(0.0), 0.0), (far, farthest)
    return near, far, tuple((plane, *shifts.between_mm(at - sharp, at + sharp)) for plane, at in planes)


def _by_wavelength(scene: Scene, primary: Paraxial, distance_mm: float) -> Iterator[AtWavelength]:
    """Yield the lens at each wavelength of a scene that has several."""
    wavelengths_nm = scene.wavelengths_nm
    if len(wavelengths_nm) < 2:
        return
    image = primary.image_mm(distance_mm)
    for wavelength in wavelengths_nm:
        lens = Paraxial.of(scene.camera.lens, wavelength)
        yield AtWavelength(wavelength, lens.efl_mm, lens.bfl_mm, lens.image_mm(distance_mm) - image)


def _on_object(size_mm: float, magnification: float) -> float:
    return quotient(size_mm, abs(magnification))


def _pose_lines(camera: Camera) -> Iterator[str]:
    """Yield the pose of every lens element, array or sensor that is out of place."""
    posed = []
    for element in camera.lens.elements:
        first, last = element.surfaces[0], element.surfaces[-1]
        which = f"surfaces {first} to {last}" if last > first else f"surface {first}"
        posed.append((which, element.pose, f"the vertex of surface {first}"))
    if camera.mla is not None:
        posed.append(("the array", camera.mla.pose, "its centre"))
    posed.append(("the sensor", camera.sensor.pose, "its centre"))
    for which, pose, centre in posed:
        if any(pose.shift_mm) or any(pose.tilt_deg):
            shift, tilt = (" ".join(f"{x:g}" for x in each) for each in (pose.shift_mm, pose.tilt_deg))
            yield f"{which}: shift {shift} mm, tilt {tilt} degrees about {centre}"
