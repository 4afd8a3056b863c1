"""Warnings about scenes that are valid but likely to disappoint."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lfmesh.errors import DiffractionWarning, MissedLightWarning, PictureWarning, in_order
from lfmesh.scene.camera.lenslet_optics import sections
from lfmesh.scene.distance import length_in_words, reach_in_words
from lfmesh.scene.first_order import axial_beam
from lfmesh.scene.first_order.beam_bounds import CLOSE, Beam
from lfmesh.scene.first_order.focused import in_focus_distance_mm
from lfmesh.scene.first_order.meridional import beam_mm
from lfmesh.scene.first_order.paraxial import Paraxial, quotient
from lfmesh.scene.first_order.phase_lines import least_period_mm
from lfmesh.scene.first_order.relay import relay_of
from lfmesh.scene.first_order.solve import focus_wished_mm
from lfmesh.scene.gradient_advice import gradient_warnings
from lfmesh.scene.light.particles import shining_particles
from lfmesh.scene.literals import percent
from lfmesh.scene.model import format_path
from lfmesh.scene.motion import at_begin
from lfmesh.scene.objects.shapes import Box, Cylinder, Disk, Plane, Sphere
from lfmesh.scene.objects.targets import Target
from lfmesh.scene.relay_advice import relay_warnings
from lfmesh.scene.scene import Scene
from lfmesh.scene.section_advice import section_warnings

if TYPE_CHECKING:
    from lfmesh.scene.first_order.report import FirstOrder

# Smaller fractions are ordinary tolerances of a design and raise no warning.
_F_NUMBER_TOLERANCE = 0.1
_TOUCHING_TOLERANCE = 0.02
# Magnitude of a Qcon polynomial at the clear aperture; within the norm radius it stays below 1.
_GROWTH = 1.5
# About the width of an atom, in nm.
_THINNEST_LAYER_NM = 0.2
# Smallest period of a phase, in wavelengths, that scalar theory describes.
_FEWEST_WAVES = 2.0
# Fraction of the focus distance, or of 100 focal lengths where the focus is farther.
_FOCUS_TOLERANCE = 1e-3


def warnings(scene: Scene, facts: "FirstOrder") -> tuple[str, ...]:
    """Return the warnings about a scene, given its first-order facts."""
    return (
        *(str(each) for each in doubtful(scene, facts)),
        *_focus(scene, facts),
        *_stop_in_image(scene, facts),
        *_covering(facts),
        *section_warnings(scene, facts),
        *relay_warnings(scene, facts),
        *gradient_warnings(scene),
        *(_apertures(scene, facts) if facts.working_f_number else ()),
        *_beyond_norm(scene),
        *_thin_layers(scene),
        *_micro_images(scene, facts),
        *_coverage(scene),
        *_targets(scene, facts),
        *_light(scene),
        *_rough_camera(scene),
        *_samples(scene),
        *_spreads(scene),
    )


def _samples(scene: Scene) -> Iterator[str]:
    """Warn if the samples do not divide evenly among the replicates."""
    transport = scene.transport
    if transport.samples % transport.replicates:
        yield (
            f"samples = {transport.samples} is not a multiple of {transport.replicates} replicates: rounded up to "
            f"{transport.samples_each * transport.replicates}"
        )


def _spreads(scene: Scene) -> Iterator[str]:
    """Warn of the time that point spreads of particles take if diffraction is on."""
    chosen = scene.transport.diffraction
    if chosen == "none" or not scene.particles:
        return
    count = sum(len(shining_particles(group, scene)[0]) for group in scene.particles)
    channels = f" at {scene.channels} wavelengths each" if scene.channels > 1 else ""
    yield (
        f'transport.diffraction = "{chosen}": {count:,} particle{"s" if count != 1 else ""} are pictured by point '
        f"spreads{channels}, which take some seconds each"
    )


def _rough_camera(scene: Scene) -> Iterator[str]:
    """Warn of the noise that rough surfaces in the camera cause."""
    rough = [format_path(where) for where in scene.rough_in_camera()]
    if not rough:
        return
    yield f"{rough[0]} scatters light, so rays are not aimed through the camera, and the picture needs many samples"
    if scene.lights:
        yield f"{rough[0]} also scatters light of lamps, which is traced from the lamps and needs many samples"


def doubtful(scene: Scene, facts: "FirstOrder") -> tuple[PictureWarning, ...]:
    """Return the warnings about errors in a picture of a solved scene, most important first."""
    waves = *_diffraction(scene, facts), *_fine_phases(scene)
    return in_order([*_forward_in_fog(scene), *_scattered_particles(scene), *waves])


def _fine_phases(scene: Scene) -> Iterator[PictureWarning]:
    """Warn of diffractive faces with periods of few wavelengths, beyond scalar theory."""
    for where, phase, _, _ in scene.phases():
        waves = 1e6 * least_period_mm(scene, where, phase) / scene.primary_nm
        if waves < _FEWEST_WAVES:
            yield DiffractionWarning(
                f"{format_path(where)}: its smallest period is {waves:.3g} wavelengths. Below {_FEWEST_WAVES:g} the "
                "shares of its orders depend on angle and polarisation, which is not traced"
            )


def _forward_in_fog(scene: Scene) -> Iterator[PictureWarning]:
    """Warn of unbounded scattering media, for which the forward method finds too little light."""
    for number, medium in enumerate(scene.media):
        everywhere = medium.scattering_per_mm != 0.0 and medium.bounds is None and medium.grid is None
        if everywhere and scene.transport.method == "forward":
            yield MissedLightWarning(
                f"{medium.name or f'media[{number}]'} scatters light right before the lens, where the forward method "
                'rarely finds it, so the picture may be too dark by more than its error says; use method = "adjoint"'
            )


def _scattered_particles(scene: Scene) -> Iterator[PictureWarning]:
    """Warn of media and surfaces that scatter the light of particles, which is then found only in part."""
    if not scene.particles:
        return
    media = [each.name or f"media[{i}]" for i, each in enumerate(scene.media) if each.scattering_per_mm != 0.0]
    rough = [format_path(where) for where, finish in scene.finishes() if finish.is_rough and where[0] != "camera"]
    for name in (*media, *rough):
        yield MissedLightWarning(
            f"{name} scatters light: the picture has only a part of the particles' light that it scatters"
        )


def _focus(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    given, distance = scene.camera.focus_mm or math.inf, facts.object_distance_mm
    focus = focus_wished_mm(scene.camera, scene.primary_nm)
    plane = "array" if scene.camera.mla is not None else "sensor"
    # A relay with an intermediate image has a negative focal length too, but its rear focal point lies behind it.
    if facts.efl_x_mm is not None and math.isinf(facts.efl_mm):
        # A cylinder without power in y: it has no plane in focus there.
        return
    if facts.efl_mm < 0 and facts.bfl_mm < 0:
        yield f"the lens diverges (focal length {facts.efl_mm:.4g} mm): it forms no real image of an object"
    elif distance < 0:
        yield from _beyond_infinity(facts, plane)
    elif focus is not None and 0.0 < facts.efl_mm < math.inf and focus <= -facts.ffl_mm:
        yield (
            f"focus_mm = {given:g} is inside the focal length: the front focal point lies "
            f"{-facts.ffl_mm:.4g} mm before the lens"
        )
    elif focus is not None and abs(quotient(1, focus) - quotient(1, distance)) > _FOCUS_TOLERANCE * max(
        quotient(1, focus), quotient(0.01, abs(facts.efl_mm))
    ):
        beyond = given - focus if focus < math.inf else 0.0
        if facts.focused:
            yield _refocus_lenslets(scene, facts, focus)
            return
        yield (
            f"focus_mm = {given:g}, but the distances given focus on {length_in_words(distance + beyond)}; omit "
            f"{'mla' if scene.camera.mla is not None else 'sensor'}.distance_mm to have it solved"
        )


def _beyond_infinity(facts: "FirstOrder", plane: str) -> Iterator[str]:
    """Warn that the array or sensor lies at no real image, and report the distances that are still sharp."""
    sharp = "sharp range" if facts.microlens_f_number is None or facts.focused else "refocus range"
    reach = f"{sharp}: {reach_in_words(facts.near_mm, facts.far_mm)}"
    if math.isinf(facts.efl_mm):
        yield f"the lens is afocal: only converging light has its image on the {plane}; {reach}"
        return
    inside = facts.rear_principal_plane_z_mm + facts.image_index * facts.efl_mm - facts.image_z_mm
    if inside > 0.0:
        where = f"{inside:.4g} mm inside the focal length: the camera is focused beyond infinity"
    else:
        where = "where the lens images no object in front of it"
    yield f"the {plane} stands {where}; {reach}"


def _stop_in_image(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    """Warn of a stop imaged onto the array or sensor: it limits the field, not the light."""
    if facts.working_f_number == 0.0:
        plane = "array" if scene.camera.mla is not None else "sensor"
        yield (
            f"the stop is imaged onto the {plane}: it limits the field, not the cone of light, and there is neither an "
            "f-number nor a micro-image; mark another surface as the stop"
        )


def _refocus_lenslets(scene: Scene, facts: "FirstOrder", focus_mm: float) -> str:
    """Return advice on the position of a focused camera's array that puts the plane at `focus_mm` in focus."""
    camera = scene.camera
    distance = in_focus_distance_mm(camera, scene.primary_nm, facts.focused, focus_mm)
    found = (
        f"focus_mm = {camera.focus_mm:g}, but the lenslets are focused on {length_in_words(facts.object_distance_mm)}"
    )
    if camera.focus_from == "first_vertex" and 0.0 < distance < math.inf:
        return f"{found}; give mla.distance_mm = {distance:.6g}"
    return f"{found}; give mla.distance_mm, and omit focus_mm"


def _covering(facts: "FirstOrder") -> Iterator[str]:
    """Warn of lenslets of a focused camera that leave gaps in the plane they are focused on."""
    for at in facts.focused:
        if abs(at.virtual_depth) < at.covering_depth:
            which = f"lenslets of focal length {at.focal_length_mm:.4g} mm" if len(facts.focused) > 1 else "lenslets"
            yield (
                f"{which} leave gaps in the plane they are focused on: its virtual depth is "
                f"{abs(at.virtual_depth):.3g}, and full coverage needs {at.covering_depth:.3g} or more"
            )


def _apertures(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    """Compare the axial beam that the stop passes with every clear aperture, by real rays."""
    camera, wavelength = scene.camera, scene.primary_nm
    surfaces = camera.lens.surfaces
    lens = Paraxial.of(camera.lens, wavelength)
    distance = facts.object_distance_mm
    radius = surfaces[lens.stop].semi_diameter_mm or math.nan
    marginal = lens.marginal_ray(distance, radius)
    paraxial = lens.heights_mm(marginal)
    beam = Beam(paraxial, paraxial)
    clears = [surface.semi_diameter_mm or math.inf for surface in surfaces]
    if not camera.lens.has_meshes and math.isfinite(marginal.height_mm) and marginal.height_mm:
        try:
            if camera.lens.number_off_revolution is None:
                beam = beam_mm(camera.lens, wavelength, distance, marginal.height_mm, clears)
            else:
                beam = axial_beam.beam_mm(camera.lens, wavelength, distance, clears)
        except (OverflowError, ValueError):
            # With coefficients this large no real ray can be traced.
            return
    for number, (found, proven) in enumerate(zip(beam.found_mm, beam.proven_mm, strict=True)):
        clear = clears[number]
        if math.isinf(found):
            behind_gradient = number > 0 and surfaces[number - 1].gradient is not None
            why = "miss it, turn back in the gradient-index glass before it" if behind_gradient else "miss it"
            yield (
                f"rays of the stop's axial beam end at surfaces[{number}], because they {why} or are totally "
                "reflected; that surface limits the light, not the stop"
            )
        elif number != lens.stop and abs(found) > clear * (1 + CLOSE):
            yield (
                f"the stop is larger than a clear aperture: its axial beam is {2 * abs(found):.4g} mm wide "
                f"on surfaces[{number}], whose clear aperture is {2 * clear:.4g} mm; that surface limits the "
                "light, not the stop"
            )
        elif number != lens.stop and abs(proven) > clear * (1 + CLOSE):
            yield (
                f"surfaces[{number}] may limit the light, not the stop: rays of the axial beam fill "
                f"{2 * abs(found):.4g} mm of its clear aperture of {2 * clear:.4g} mm, but some may lie farther out"
            )
    if camera.lens.has_meshes:
        yield "the lens has surfaces that are meshes: clear apertures were compared with the paraxial axial beam only"
    elif any(any(each.pose.shift_mm) or any(each.pose.tilt_deg) for each in camera.lens.elements):
        yield "the lens has posed elements: clear apertures were compared with the axial beam of the prescription only"
    elif camera.lens.has_gradients:
        yield (
            "the lens has gradient-index glass: clear apertures were compared with traced rays of the axial beam, "
            "without proof for the rays between these"
        )
    if not beam.found_mm:
        yield "the stop is larger than the glass and limits no light: no ray along the axis reaches its edge"


def _beyond_norm(scene: Scene) -> Iterator[str]:
    """Warn of strong aspheres with a clear aperture beyond the norm radius, where their polynomials grow."""
    for number, surface in enumerate(scene.camera.lens.surfaces):
        rim = surface.semi_diameter_mm
        if surface.qcon is None or rim is None or not rim > surface.qcon.norm_radius_mm:
            continue
        growth = surface.qcon.growth(rim)
        if growth > _GROWTH:
            yield (
                f"surfaces[{number}] is clear up to {rim:g} mm, and its qcon has norm_radius_mm = "
                f"{surface.qcon.norm_radius_mm:g}: beyond it the polynomials grow, to {growth:.3g} times at the "
                "rim"
            )


def _thin_layers(scene: Scene) -> Iterator[str]:
    """Warn of impossibly thin layers, such as thicknesses given in micrometres."""
    for name, coating in scene.all_coatings.items():
        for number, layer in enumerate(coating.layers or ()):
            if layer.thickness_nm < _THINNEST_LAYER_NM:
                yield (
                    f"coatings.{name}.layers[{number}].thickness_nm = {layer.thickness_nm:g}: thinner than an atom; if "
                    f"that is in µm, give {1e3 * layer.thickness_nm:g}"
                )


def _micro_images(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    diameter, pitch, microlens = (
        facts.micro_image_diameter_px,
        facts.micro_image_pitch_px,
        facts.microlens_f_number,
    )
    mla = scene.camera.mla
    if mla is None or diameter is None or pitch is None or microlens is None or facts.working_f_number == 0.0:
        return
    if abs(quotient(facts.working_f_number, microlens) - 1) > _F_NUMBER_TOLERANCE:
        yield (
            f"the f-numbers do not match: the lens works at f/{facts.working_f_number:.3g}, the "
            f"microlenses at f/{microlens:.3g}{_matching(scene, facts, microlens)}"
        )
    if pitch <= 0:
        yield "the lens's exit pupil lies between array and sensor: the micro-images coincide and show no directions"
        return
    if diameter > pitch * (1 + _TOUCHING_TOLERANCE):
        yield (
            f"micro-images overlap: they are {diameter:.4g} pixels wide and {pitch:.4g} apart; stop the lens "
            f"down to f/{facts.working_f_number * diameter / pitch:.3g}"
        )
    lit = diameter + _pupil_blur_px(scene, facts)
    if lit < pitch * (1 - _F_NUMBER_TOLERANCE):
        cell = mla.row_pitch_mm / mla.pitch_mm * pitch**2
        yield (
            f"micro-images leave gaps: they are {lit:.4g} pixels wide and {pitch:.4g} apart; "
            f"{1 - math.pi / 4 * lit**2 / cell:.0%} of the pixels stay dark"
        )
    if pitch < 2:
        yield f"micro-images are {pitch:.3g} pixels apart: too few to distinguish directions"


def _matching(scene: Scene, facts: "FirstOrder", microlens: float) -> str:
    """Return the stop, and the focal length of lenslets of one type and section, that make the f-numbers match."""
    camera, mla = scene.camera, scene.camera.mla
    ratio = quotient(facts.working_f_number, microlens)
    if mla is None or not 0.0 < ratio < math.inf:
        return ""
    # The cone of light is as wide as the stop.
    radius = ratio * (camera.lens.surfaces[Paraxial.of(camera.lens, scene.primary_nm).stop].semi_diameter_mm or 0.0)
    ways = [f"camera.lens.stop_semi_diameter_mm = {radius:.4g}"]
    if not facts.focused and mla.types == 1 and not mla.both_faces_act and len(sections(mla)) == 1:
        # The f-number takes the reduced focal length in the image medium; the key takes the one in air.
        n, outside = camera.relative_index(mla.medium, scene.primary_nm), facts.image_index
        length = facts.working_f_number * mla.pitch_mm * outside * (n - 1.0) / (n * outside - 1.0)
        ways.insert(0, f"camera.mla.focal_length_mm = {length:.4g} (sensor in the focal plane)")
    return f"; they match with {' or '.join(ways)}"


def _pupil_blur_px(scene: Scene, facts: "FirstOrder") -> float:
    """Return the blur of the pupil's image behind the sharpest lenslets for it, in pixels.

    The lenslets of a standard camera image the pupil onto the sensor. Those of a focused camera image it p |1/v - d/D|
    out of focus: p is the pitch, v the virtual depth, d and D the distances from the lenslet to sensor and pupil.
    """
    mla, pitch = scene.camera.mla, facts.micro_image_pitch_px
    if mla is None or pitch is None or not facts.focused:
        return 0.0
    cell = mla.pitch_mm / scene.camera.sensor.pixel_mm
    return min(abs(cell * (1.0 + 1.0 / at.virtual_depth) - pitch) for at in facts.focused)


def _diffraction(scene: Scene, facts: "FirstOrder") -> Iterator[PictureWarning]:
    """Warn of diffraction that blurs by more than one image sample and is not traced."""
    chosen = scene.transport.diffraction
    traced = chosen == "lenslets"
    sample = "lenslets" if facts.microlens_f_number is not None and not facts.focused else "pixels"
    disks = []
    if chosen != "stop":
        advice = (
            "" if scene.camera.mla is not None else '; take transport.diffraction = "stop", with split = "transmit"'
        )
        disks.append(("lens's", facts.working_f_number, facts.airy_disk_samples, sample, advice))
    if facts.microlens_f_number is not None and facts.microlens_airy_disk_px is not None and not traced:
        error = facts.kick_error
        advice = '; take transport.diffraction = "lenslets"'
        if error is not None and error.white_with >= error.white_without:
            shares = f"off by {percent(error.white_with)} of their light instead of {percent(error.white_without)}"
            advice = f'; with transport.diffraction = "lenslets" white pictures are no nearer: {shares}'
        elif error is not None:
            edges = "" if error.edge_with is None else f", of edges {percent(error.edge_with)}"
            white = f"{percent(error.white_with)} {error.lenslets_in_words}"
            advice += f", with an error of white pictures of {white}{edges}"
        disks.append(("microlenses'", facts.microlens_f_number, facts.microlens_airy_disk_px, "pixels", advice))
    for whose, f_number, width, samples, advice in disks:
        if 1.0 < width < math.inf:
            yield DiffractionWarning(
                f"the {whose} Airy disk is {width:.3g} {samples} wide (f/{f_number:.3g}, "
                f"{facts.airy_wavelength_nm:g} nm), but this diffraction is not traced{advice}"
            )


def _coverage(scene: Scene) -> Iterator[str]:
    mla, sensor = scene.camera.mla, scene.camera.sensor
    if mla is None:
        return
    relay = relay_of(scene.camera, scene.primary_nm)
    beyond = 0.0 if relay is None else 2.0 * relay.reach_mm - mla.pitch_mm
    for side, lenslets, pixels in zip(("wide", "high"), mla.size_mm, sensor.size_mm, strict=True):
        # Rods beside the sensor add to the image at its border.
        if pixels < 0.9 * lenslets and relay is None:
            yield (
                f"the sensor is {pixels:.4g} mm {side}, the array {lenslets:.4g} mm: the outer lenslets are not "
                "recorded"
            )
        elif lenslets + beyond < 0.9 * pixels:
            yield f"the array is {lenslets:.4g} mm {side}, the sensor {pixels:.4g} mm: outer pixels stay dark"
    for axis in (0, 1):
        shift = mla.pose.shift_mm[axis] - sensor.pose.shift_mm[axis]
        lenslets, pixels = mla.size_mm[axis], sensor.size_mm[axis]
        covered = min(0.5 * pixels, shift + 0.5 * lenslets) - max(-0.5 * pixels, shift - 0.5 * lenslets)
        if covered < 0.9 * min(lenslets, pixels):
            yield (
                f"the array stands {abs(shift):.4g} mm beside the sensor along {'xy'[axis]}: it covers "
                f"{max(covered, 0.0):.4g} mm of the sensor's {pixels:.4g} mm; the other pixels see no lenslets"
            )


def _targets(scene: Scene, facts: "FirstOrder") -> Iterator[str]:
    """Judge targets by place and size; only for a camera at the origin of the world frame."""
    if any(scene.camera.pose.shift_mm) or any(scene.camera.pose.tilt_deg):
        return
    for number, target in enumerate(scene.targets):
        name = f"targets[{number}]" + (f" ({target.name})" if target.name else "")
        x, y, z = target.position_mm
        reach = _reach_mm(target)
        if reach is None:
            continue
        if z - reach > 0:
            why = f"z = {z:g} mm is behind the first vertex; objects have z < 0"
            yield at_begin(f"{name} is out of the field: {why}", target, scene.camera)
        elif _outside(x, y, z, reach, facts):
            sizes = " × ".join(f"{2 * half:.4g}" for half in half_field_mm(z, facts))
            why = f"at z = {z:g} mm the camera sees {sizes} mm around the axis"
            yield at_begin(f"{name} is out of the field: {why}", target, scene.camera)
        elif not facts.near_mm <= -z + reach or not -z - reach <= facts.far_mm:
            kind = "is sharp" if facts.focused or facts.microlens_f_number is None else "can be refocused"
            sharp = reach_in_words(facts.near_mm, facts.far_mm)
            yield at_begin(f"{name} stands at {-z:g} mm, out of the range that {kind}: {sharp}", target, scene.camera)


def _reach_mm(target: Target) -> float | None:
    """Return the radius of a ball that contains the target's shape, or None for a mesh (size unknown)."""
    match target.shape:
        case Plane(width_mm=w, height_mm=h):
            return math.hypot(w, h) / 2
        case Disk(radius_mm=r) | Sphere(radius_mm=r):
            return r
        case Box(size_mm=size):
            return math.hypot(*size) / 2
        case Cylinder(radius_mm=r, height_mm=h):
            return math.hypot(r, h / 2)
        case _:
            return None


def half_field_mm(z_mm: float, facts: "FirstOrder") -> tuple[float, float]:
    """Return half the visible width and height at a plane, in mm, including the blur at its edge."""
    width, height = facts.field.size_mm(z_mm)
    # The pupil has an extent: off the plane in focus, the edge of the field is as soft as the beam is wide.
    blur = facts.field.beam_mm(z_mm)
    return (width + blur) / 2, (height + blur) / 2


def _outside(x: float, y: float, z: float, reach: float, facts: "FirstOrder") -> bool:
    half_width, half_height = half_field_mm(z, facts)
    return abs(x) - reach > half_width or abs(y) - reach > half_height


def _light(scene: Scene) -> Iterator[str]:
    lit_itself = bool(scene.lights and scene.rough_in_camera())
    if scene.particles or lit_itself or any(medium.may_emit for medium in scene.media):
        return
    if not scene.targets and not any(medium.may_scatter for medium in scene.media):
        yield "there are no targets: the image will be black"
    elif not scene.lights and not any(target.material.emits for target in scene.targets):
        yield "nothing emits: no lights, and no target with radiance_w_m2_sr; the image will be black"
