"""Descriptions of parts in words: prescription, pixels, materials."""

import math
from collections.abc import Set

from lfmesh.errors import LfmeshError
from lfmesh.optics.glass import Medium, medium_in_words, refractive_index
from lfmesh.optics.gradients import fields_at, gradient_table
from lfmesh.scene import Light, Surface, Target
from lfmesh.scene import Medium as SceneMedium
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.first_order.phase_lines import least_period_mm
from lfmesh.scene.light.spectra import Spectrum, spectral_in_words
from lfmesh.scene.model import Model
from lfmesh.transport.world import World
from lfmesh.view.media import shown_medium
from lfmesh.view.rays.names import label, lens_names

Rows = list[tuple[str, str]]
"""Labels and values."""


def describe(world: World, name: str) -> Rows:
    """Return the facts about a part: "lens[0]", "stop", "mount", "mla", "sensor", "targets[0]", "lights[0]".

    Raises
    ------
    LfmeshError
        No part has this name.
    """
    kind, _, number = name.rstrip("]").partition("[")
    makers = {"stop": _stop, "mla": _array, "sensor": _sensor}
    if kind in makers and not number and (kind != "mla" or world.tables.mla.present):
        return makers[kind](world)
    thin = [i for i, surface in enumerate(world.scene.camera.lens.surfaces) if surface.paraxial]
    if name in (f"surface[{i}]" for i in thin):
        return _thin_lens(world, int(number))
    if name in (f"surface[{i}]" for i in lone_diffractive(world)):
        return _lone_surface(world, int(number))
    if name == "mount":
        return [("mount", "absorbs light outside the clear apertures between the elements")]
    several = {"lens": (_element, len(world.lens_shape.elements)), "targets": (_target, len(world.targets)),
               "lights": (_light, len(world.scene.lights)),
               "particles": (_particles, len(world.scene.particles)),
               "media": (_medium_round, len(world.scene.media))}  # fmt: skip
    if kind in several and number.isdecimal() and int(number) < several[kind][1]:
        return several[kind][0](world, int(number))
    raise LfmeshError(f"unknown part {name!r}; valid are {', '.join(world.mesh_names)}")


def _thin_lens(world: World, number: int) -> Rows:
    surface = world.scene.camera.lens.surfaces[number]
    return [
        ("thin lens", f"surface {number}, f = {surface.focal_length_mm:.6g} mm"),
        ("semi-diameter", f"{surface.semi_diameter_mm:.6g} mm"),
        *_poses(world, (number, number)),
    ]


def lone_diffractive(world: World) -> list[int]:
    """Return the numbers of diffractive surfaces that bound no glass."""
    shape, surfaces = world.lens_shape, world.scene.camera.lens.surfaces
    on_glass = {k + side for k in shape.elements for side in (0, 1)}
    return [i for k, i in enumerate(shape.numbers) if k not in on_glass and surfaces[i].phase is not None]


def _lone_surface(world: World, number: int) -> Rows:
    surface = world.scene.camera.lens.surfaces[number]
    return [("surface", _surface(surface, number)), *_phases(world, {number}), *_poses(world, (number, number))]


def _phases(world: World, places: Set[str | int]) -> Rows:
    """Describe phases: kind, orders, efficiency, and the smallest period within the aperture.

    Parameters
    ----------
    world : World
    places : set of str and int
        Numbers of lens surfaces, or "mla".
    """
    rows = []
    for where, phase, _, _ in world.scene.phases():
        if where[-2] in places:
            name = f"phase of surface {where[-2]}" if where[1] == "lens" else str(where[-1])
            period = least_period_mm(world.scene, where, phase)
            smallest = f", smallest period {1e3 * period:.4g} µm" if math.isfinite(period) else ""
            rows.append((name, phase.in_words() + smallest))
    return rows


def _element(world: World, number: int) -> Rows:
    shape = world.lens_shape
    k = shape.elements[number]
    names = lens_names(world)
    surfaces = world.scene.camera.lens.surfaces
    front, back = (surfaces[shape.numbers[i]] for i in (k, k + 1))
    vertices = world.scene.camera.lens.vertices_mm
    thickness = vertices[shape.numbers[k + 1]] - vertices[shape.numbers[k]]
    return [
        ("element", f"lens[{number}], {label(names[k])} to {label(names[k + 1])}"),
        *_glass(world, shape.media[k + 1], thickness, front.semi_diameter_mm),
        ("thickness", f"{thickness:.6g} mm"),
        *(("front", words) for words in [_surface(front, shape.numbers[k])]),
        *(("back", words) for words in [_surface(back, shape.numbers[k + 1])]),
        *_phases(world, set(shape.numbers[k : k + 2])),
        *_poses(world, (shape.numbers[k], shape.numbers[k + 1])),
    ]


def _surface(surface: Surface, number: int) -> str:
    curve = "flat" if math.isinf(surface.vertex_radius_mm) else f"R {surface.vertex_radius_mm:.6g} mm"
    form = surface.form
    shape = [curve] if form is None else [f"{surface.section_key} of {form.in_words()}", f"in y {curve}"]
    words = [f"surface {number}", *shape]
    words += [f"conic {surface.vertex_conic:g}"] if surface.vertex_conic else []
    words += ["asphere " + ", ".join(f"{a:.4g}" for a in surface.terms_mm)] if any(surface.terms_mm) else []
    odd = surface.odd_asphere_mm
    words += ["odd asphere " + ", ".join(f"{a:.4g}" for a in odd)] if any(odd) else []
    words += [f"semi-diameter {surface.semi_diameter_mm:.6g} mm"] if surface.semi_diameter_mm else []
    words += [f"mesh {surface.mesh.file}"] if surface.mesh is not None else []
    return ", ".join(words)


def _poses(world: World, numbers: tuple[int, int]) -> Rows:
    """Return the poses of the elements with two given surfaces."""
    lens = world.scene.camera.lens
    which = dict.fromkeys(lens.element_of(number) for number in numbers)
    poses = [lens.elements[i].pose for i in which if i is not None]
    return [
        ("pose", f"shift {' '.join(f'{x:zg}' for x in p.shift_mm)} mm, tilt {' '.join(f'{x:zg}' for x in p.tilt_deg)}°")
        for p in poses
    ]


def _medium(world: World, medium: Medium) -> str:
    wavelength = world.scene.primary_nm
    index = f"n = {refractive_index(medium, wavelength):.6g} at {wavelength:g} nm"
    words = medium_in_words(medium)
    return index if index.startswith(words) else f"{words}, {index}"


def _glass(world: World, medium: Medium, thickness_mm: float, radius_mm: float | None) -> Rows:
    """Describe glass; gradient-index glass with its index on the axis and at the rim of its front.

    Parameters
    ----------
    world : World
    medium : Medium
    thickness_mm : float
    radius_mm : float, optional
        Distance of the rim from the axis.
    """
    if not isinstance(medium, Gradient):
        return [("glass", _medium(world, medium))]
    wavelength = world.scene.primary_nm
    radius = radius_mm or 0.0
    points = {
        "front vertex": (0.0, 0.0, 0.0),
        "rear vertex": (0.0, 0.0, thickness_mm),
        f"{radius:.4g} mm from the axis in y": (0.0, radius, 0.0),
    }
    squares = fields_at(gradient_table([medium.profile(wavelength)]), 0, list(points.values()))[:, 0]
    indices = [f"{math.sqrt(max(square, 0.0)):.6g}, {where}" for square, where in zip(squares, points, strict=True)]
    return [("gradient-index glass", medium.in_words()), (f"index at {wavelength:g} nm", "; ".join(indices))]


def _stop(world: World) -> Rows:
    lens = world.scene.camera.lens
    number = next(i for i, surface in enumerate(lens.surfaces) if surface.stop)
    radius = lens.surfaces[number].semi_diameter_mm or math.nan
    return [
        ("stop", f"surface {number}, z = {lens.vertices_mm[number]:z.6g} mm"),
        ("semi-diameter", f"{radius:.6g} mm"),
        ("working f-number", f"{world.facts.working_f_number:.4g}"),
    ]


def _array(world: World) -> Rows:
    mla = world.scene.camera.mla
    assert mla is not None
    shapes = ("focal length", mla.focal_length_mm) if mla.focal_length_mm else ("radius", mla.radii_mm)
    side = "curved side" if any(map(math.isfinite, mla.radii_mm)) else "diffractive side"
    profile = f", {mla.profile_words}" if mla.profile_words else ""
    rows = [
        ("array", f"{mla.layout}, {mla.count[0]} × {mla.count[1]} lenslets{profile}"),
        ("pitch", f"{mla.pitch_mm:g} mm"),
        (shapes[0], ", ".join(f"{value:g}" for value in shapes[1]) + " mm"),
        *_glass(world, mla.medium, mla.thickness_mm, 0.5 * mla.pitch_mm),
        ("thickness", f"{mla.thickness_mm:g} mm, {side} to the {mla.curved_side}"),
    ]
    if mla.back is not None and mla.has_back:
        profile = f", {mla.back.profile_words}" if mla.back.profile_words else ""
        rows.append(("other face", f"lenslets, radius {mla.back.radius_mm:g} mm{profile}"))
    return [*rows, *_phases(world, {"mla"})]


def _sensor(world: World) -> Rows:
    sensor = world.scene.camera.sensor
    width, height = sensor.size_mm
    rows = [
        ("sensor", f"{sensor.pixels[0]} × {sensor.pixels[1]} pixels of {1e3 * sensor.pixel_mm:g} µm"),
        ("size", f"{width:.5g} mm × {height:.5g} mm"),
    ]
    if sensor.cover is not None:
        glass = _medium(world, sensor.cover.medium)
        rows.append(("cover", f"{sensor.cover.thickness_mm:g} mm of {glass}, {sensor.cover.gap_mm:g} mm before it"))
    return rows


def _target(world: World, number: int) -> Rows:
    target = world.scene.targets[number]
    glass = target.refractor
    shape = target.shape if glass is None else glass.solid
    what = str(shape.kind if shape is not None else target.file or (glass and glass.file))
    rows = [("target", f"{target.name or f'targets[{number}]'}, {what}")]
    rows += [("position", " ".join(f"{value:zg}" for value in target.position_mm) + " mm"), *_motion(target)]
    if target.refractor is not None:
        return [*rows, ("glass", _medium(world, target.refractor.medium))]
    material = target.material
    rows += [("reflectance", spectral_in_words(material.reflectance))] if material.reflectance else []
    if material.radiance_w_m2_sr:
        per = " nm" if isinstance(material.radiance_w_m2_sr, Spectrum) else ""
        rows += [("radiance", f"{spectral_in_words(material.radiance_w_m2_sr)} W/(m² sr{per})")]
    rows += [("spectrum", spectral_in_words(material.spectrum))] if material.spectrum else []
    rows += [("temperature", f"{material.temperature_k:g} K")] if material.temperature_k else []
    if material.gloss is not None:
        boundary = material.gloss.metal or f"index {material.gloss.index:g}"
        rows += [("gloss", f"{boundary}, roughness {material.gloss.roughness:g}")]
    rows += [("opacity", str(material.opacity))] if material.opacity != 1.0 else []
    rows += [("sides", material.sides)] if material.sides != "both" else []
    return rows + ([("texture", material.texture)] if material.texture else [])


def _light(world: World, number: int) -> Rows:
    light = world.scene.lights[number]
    return [
        ("light", f"{light.kind}, lights[{number}]"),
        *_fields(light),
        *_motion(light),
        *([("spectrum", spectral_in_words(light.spectrum))] if light.spectrum is not None else []),
    ]


def _medium_round(world: World, number: int) -> Rows:
    medium, outside = world.scene.media[number], world.lens_shape.media[0]
    keys = ("absorption_per_mm", "scattering_per_mm", "emission_w_mm3_sr")
    values = [(key, getattr(medium, key)) for key in keys]
    shown = shown_medium(world, number)
    return [
        ("medium", shown.name),
        ("effect", shown.amounts),
        ("inside", medium.inside or ("air" if outside is None else _medium(world, outside))),
        *((key, spectral_in_words(value)) for key, value in values if value),
        *_index_round(medium),
        *_motion(medium),
        *([("bounds", medium.bounds.kind), *_fields(medium.bounds)] if medium.bounds is not None else []),
        *([("grid", medium.grid.file)] if medium.grid is not None else []),
    ]


def _motion(thing: Target | SceneMedium | Light) -> Rows:
    """Return the motion during the exposure, if there is one."""
    return [("motion", thing.motion.in_words)] if thing.motion is not None else []


def _index_round(medium: SceneMedium) -> Rows:
    """Return the keys that set the index of a medium."""
    if isinstance(medium.index, Gradient):
        return [("index", medium.index.in_words())]
    keys = ["index", "density_kg_m3", "gladstone_dale_m3_kg", "pressure_kpa"]
    keys += ["temperature_k"] if medium.pressure_kpa is not None else []
    return [(key, f"{value:g}") for key in keys if (value := getattr(medium, key)) is not None]


def _particles(world: World, number: int) -> Rows:
    table = next((each for each in world.particles if each.entry == number), None)
    if table is None:
        return [("particles", "none of them emits light")]
    return [("particles", f"{len(table.points):,} emitting light"), ("packets", f"{table.samples} each")]


def _fields(model: Model) -> Rows:
    """Return the non-default fields of a table, except its kind, spectrum and motion."""
    fields = model.model_dump(exclude={"kind", "spectrum", "motion"}, exclude_defaults=True)
    fields |= {key: getattr(model, key).model_dump() for key, value in fields.items() if isinstance(value, dict)}
    # A table, such as a polarisation, by its values.
    opened = {key: tuple(value.values()) if isinstance(value, dict) else value for key, value in fields.items()}
    values = {key: value if isinstance(value, tuple) else (value,) for key, value in opened.items()}
    return [
        (key, " ".join(part if isinstance(part, str) else f"{part:zg}" for part in value))
        for key, value in values.items()
    ]
