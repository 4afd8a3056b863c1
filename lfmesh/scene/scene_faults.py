"""Faults that concern several parts of a scene: glasses at its wavelengths, lenslet radii, coatings, memory."""

from collections.abc import Iterator
from typing import Any

from lfmesh.errors import GlassError, SceneError
from lfmesh.optics.glass import AIR, absorption_per_mm, catalogue_name, refractive_index
from lfmesh.optics.glass import Medium as GlassOrAir
from lfmesh.optics.metals import metal_index
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.lenslet_depth import cell_corner_mm
from lfmesh.scene.camera.mla import MicrolensArray
from lfmesh.scene.camera.surface import Surface
from lfmesh.scene.gradient_faults import gradient_faults, index_faults
from lfmesh.scene.light.spectra import Spectrum, curve_of
from lfmesh.scene.literals import counted
from lfmesh.scene.materials.coatings import name_fault, unknown_fault
from lfmesh.scene.materials.own_glass import in_air
from lfmesh.scene.memory import physical_memory_bytes
from lfmesh.scene.model import Fault, Location
from lfmesh.scene.motion_faults import motion_faults
from lfmesh.scene.quantities import LARGEST
from lfmesh.scene.scene_parts import SceneParts
from lfmesh.scene.settings.transport import PRIMARY_NM

# Bytes per pixel and channel: mean, squared deviation and current replicate in float64, two hit counts, and room for
# merging and writing.
FILM_BYTES = 48
LENSLET_BYTES = 32

NEEDS_BANDS = "needs camera.sensor.bands: a light's spectrum is power per nm, and single wavelengths have no width"


def scene_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield the faults that concern several parts of a scene.

    Parameters
    ----------
    scene : SceneParts
    """
    glasses = [*_glass_faults(scene), *index_faults(scene, _checked_nm(scene))]
    yield from glasses
    if not glasses:
        yield from _lenslet_faults(scene)
    yield from _coating_faults(scene)
    yield from _body_faults(scene)
    yield from _band_faults(scene)
    yield from _spectrum_faults(scene)
    yield from _absorption_faults(scene) if not glasses else ()
    yield from _polarisation_faults(scene)
    yield from _diffraction_faults(scene)
    yield from _phase_faults(scene) if not glasses else ()
    yield from gradient_faults(scene)
    yield from motion_faults(scene)
    yield from _memory_faults(scene)


def _body_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield media inside bodies that do not exist."""
    for i, medium in enumerate(scene.media):
        if medium.inside is not None:
            try:
                scene.body_named(medium.inside)
            except SceneError as error:
                yield Fault(("media", i, "inside"), medium.inside, str(error))


def _checked_nm(scene: SceneParts) -> tuple[float, ...]:
    """Wavelengths for checking glasses before anything is built; none if they are in a file."""
    bands = scene.camera.sensor.bands
    if isinstance(bands, tuple) and any(band.response is not None for band in bands):
        return ()
    return scene.transport.wavelengths_nm if bands is None else scene.reach_nm


def _spectrum_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield spectral densities without bands to integrate over, and tables that are too short."""
    in_bands = scene.camera.sensor.bands is not None
    uses: list[tuple[Location, Any, bool]] = []
    for i, target in enumerate(scene.targets):
        material = target.material
        where: Location = ("targets", i, "material")
        uses.append(((*where, "reflectance"), material.reflectance, False))
        uses += [((*where, key), getattr(material, key), True) for key in ("radiance_w_m2_sr", "spectrum")]
        if material.temperature_k is not None and not in_bands:
            yield Fault((*where, "temperature_k"), material.temperature_k, NEEDS_BANDS)
        if target.refractor is not None:
            where = ("targets", i, "refractor", "absorption_per_mm")
            uses.append((where, target.refractor.absorption_per_mm, False))
    for i, tank in enumerate(scene.tanks):
        uses += [
            (("tanks", i, key, "absorption_per_mm"), getattr(tank, key).absorption_per_mm, False)
            for key in ("wall", "liquid")
        ]
    uses += [(("lights", i, "spectrum"), light.spectrum, True) for i, light in enumerate(scene.lights)]
    for i, medium in enumerate(scene.media):
        where = ("media", i)
        uses += [((*where, key), getattr(medium, key), False) for key in ("absorption_per_mm", "scattering_per_mm")]
        uses += [((*where, key), getattr(medium, key), True) for key in ("emission_w_mm3_sr", "spectrum")]
        # The temperature of air that absorbs nothing sets its index alone; a grid may hold its pressure.
        bends_alone = medium.absorption_per_mm == 0.0 and (medium.pressure_kpa is not None or medium.grid is not None)
        if medium.temperature_k is not None and not in_bands and not bends_alone:
            yield Fault((*where, "temperature_k"), medium.temperature_k, NEEDS_BANDS)
    uses += [(("particles", i, "spectrum"), group.spectrum, True) for i, group in enumerate(scene.particles)]
    for where, spectrum, is_density in uses:
        if not isinstance(spectrum, Spectrum):
            continue
        if is_density and not in_bands:
            yield Fault(where, None, NEEDS_BANDS)
        elif spectrum.file is None and _checked_nm(scene):
            try:
                curve_of(spectrum, scene.reach_nm, scene, "spectrum")
            except SceneError as error:
                yield Fault(where, None, str(error).removeprefix("spectrum: "))


def _band_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield single wavelengths given together with bands."""
    wavelengths_nm = scene.transport.wavelengths_nm
    if scene.camera.sensor.bands is not None and wavelengths_nm != (PRIMARY_NM,):
        yield Fault(
            ("transport", "wavelengths_nm"),
            list(wavelengths_nm),
            "camera.sensor.bands is given too; give one of them",
        )


def _coating_faults(scene: SceneParts) -> Iterator[Fault]:
    of_lens = scene.camera.lens.coatings
    for beginning, coatings in (((), scene.coatings), (("camera", "lens"), of_lens)):
        for name, coating in coatings.items():
            where: Location = (*beginning, "coatings", name)
            if why := name_fault(name):
                yield Fault(where, None, why)
            for i, layer in enumerate(coating.layers or ()):
                for wavelength in _checked_nm(scene) if layer.glass is not None else ():
                    try:
                        layer.index_at(wavelength)
                    except GlassError as error:
                        yield Fault((*where, "layers", i, "glass"), None, str(error))
                        break
    for name, coating in scene.coatings.items():
        if of_lens.get(name, coating) != coating:
            yield Fault(("coatings", name), None, "the lens has another coating of this name; use another name")
    for where, name in scene.coating_uses():
        if why := unknown_fault(name, tuple(scene.all_coatings)):
            yield Fault(where, name, why)


def _polarisation_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield parts that need polarised light in a scene without it, and parts of unknown phase in a scene with it."""
    if not scene.transport.polarisation:
        states: list[tuple[Location, Any]] = [
            (("lights", i, "polarisation"), light.state) for i, light in enumerate(scene.lights)
        ]
        for where, value in ((("camera", "polariser_deg"), scene.camera.polariser_deg), *states):
            if value is not None:
                yield Fault(where, value, "needs transport.polarisation = true")
        return
    for where, name in scene.coating_uses():
        coating = scene.all_coatings.get(name)
        if coating is not None and coating.layers is None:
            yield Fault(
                where,
                name,
                f"transport.polarisation needs the phases of this coating, which {coating.kind} does not give; give "
                "layers",
            )
    for where, finish in scene.finishes():
        if finish.is_rough:
            yield Fault(where, finish.kind, "transport.polarisation handles polished faces only; omit the finish")
    for i, surface in enumerate(scene.camera.lens.surfaces):
        if surface.paraxial:
            yield Fault(
                ("camera", "lens", "surfaces", i, "paraxial"),
                True,
                "transport.polarisation handles real interfaces only; give the lens radii and glass",
            )
    for i, target in enumerate(scene.targets):
        if target.material.gloss is not None:
            yield Fault(
                ("targets", i, "material", "gloss"),
                None,
                "transport.polarisation handles matt targets and glass, but no gloss; omit it",
            )
    if scene.camera.sensor.cover is not None:
        yield Fault(("camera", "sensor", "cover"), None, "transport.polarisation ends at the array; omit the cover")
    if scene.camera.sensor.reflectance > 0.0:
        yield Fault(
            ("camera", "sensor", "reflectance"),
            scene.camera.sensor.reflectance,
            "transport.polarisation needs the phases of the reflected light, which a share does not give; omit "
            "reflectance",
        )


def _phase_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield phases that the settings of a render rule out, and efficiencies unknown at a wavelength of the scene."""
    if scene.transport.polarisation:
        why = "omit it: transport.polarisation needs the phases of both polarised waves, which a scalar phase lacks"
    elif scene.transport.surface != "exact":
        why = 'needs transport.surface = "exact": facets have no exact place on the surface for a phase'
    else:
        why = ""
    for where, phase, before, behind in scene.phases():
        if why:
            yield Fault(where, None, why)
            continue
        for key, coefficient, largest in phase.terms_rad(_radius_mm(scene, where)):
            if not largest <= LARGEST:
                why_large = f"makes a phase of more than {LARGEST:g} rad inside the clear aperture"
                yield Fault((*where, *key), coefficient, why_large)
        for wavelength in _checked_nm(scene):
            try:
                shares = phase.orders_of(wavelength, before, behind)
            except (GlassError, SceneError) as error:
                yield Fault((*where, "efficiency"), None, str(error).removeprefix("efficiency: "))
                break
            if not all(share >= 0.0 for _, share in shares):
                yield Fault(
                    (*where, "efficiency"), "blaze",
                    "needs different media on both sides, as a profile in one medium shifts no phase",
                )  # fmt: skip
                break


def _radius_mm(scene: SceneParts, where: Location) -> float:
    """Return the clear radius of the face of a phase; 0 if it is solved later."""
    number, mla = where[-2], scene.camera.mla
    if isinstance(number, int):
        return scene.camera.lens.aperture_mm(number) or 0.0
    return cell_corner_mm(mla.pitch_mm, mla.layout, None) if mla is not None else 0.0


def _diffraction_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield parts that rule out tracing the diffraction of lenslets or stop."""
    where, chosen, mla = ("transport", "diffraction"), scene.transport.diffraction, scene.camera.mla
    if chosen == "none":
        return
    if chosen == "stop":
        if mla is not None:
            why = 'worsens pictures behind an array, because the lenslets spread the light: give "lenslets"'
            yield Fault(where, chosen, why)
        elif scene.transport.split != "transmit" or scene.transport.engine == "mesh":
            why = 'works along the image path only: give split = "transmit" and an engine other than "mesh"'
            yield Fault(where, chosen, why)
    elif mla is None:
        yield Fault(where, chosen, 'needs camera.mla; without an array give "stop"')
    elif mla.curved_finish.is_rough or mla.flat_finish.is_rough:
        yield Fault(where, chosen, 'needs a polished array; give "none" with a rough finish')
    if scene.transport.polarisation:
        yield Fault(where, chosen, 'is not traced for polarised light; give "none" with transport.polarisation')


def _glass_faults(scene: SceneParts) -> Iterator[Fault]:
    media: list[tuple[Location, GlassOrAir]] = [
        (("camera", "lens", "surfaces", i, _medium_key(surface)), surface.medium)
        for i, surface in enumerate(scene.camera.lens.surfaces)
    ]
    for place, outside in ((("camera",), scene.camera), (("camera", "lens"), scene.camera.lens)):
        if outside.object_medium is not None:
            media.append(((*place, "object_medium", "glass"), outside.object_medium.medium))
    if scene.camera.image_medium is not None:
        media.append((("camera", "image_medium", "glass"), scene.camera.image_medium.medium))
    for i, surface in enumerate(scene.camera.lens.surfaces):
        if surface.refractor is not None:
            media.append((("camera", "lens", "surfaces", i, "refractor", "glass"), surface.refractor.medium))
    for i, target in enumerate(scene.targets):
        if target.refractor is not None:
            media.append((("targets", i, "refractor", "glass"), target.refractor.medium))
    for i, tank in enumerate(scene.tanks):
        media += [(("tanks", i, "wall", "glass"), tank.wall.medium)]
        media += [(("tanks", i, "liquid", "glass"), tank.liquid.medium)]
    if scene.camera.mla is not None:
        media.append((("camera", "mla", _medium_key(scene.camera.mla)), scene.camera.mla.medium))
    if scene.camera.sensor.cover is not None:
        media.append((("camera", "sensor", "cover", "glass"), scene.camera.sensor.cover.medium))
    for i, target in enumerate(scene.targets):
        gloss = target.material.gloss
        for wavelength in _checked_nm(scene) if gloss is not None and gloss.metal is not None else ():
            try:
                metal_index(gloss.metal or "" if gloss is not None else "", wavelength)
            except GlassError as error:
                yield Fault(("targets", i, "material", "gloss", "metal"), None, str(error))
                break
    for where, medium in media:
        for wavelength in _checked_nm(scene) if not isinstance(medium, Gradient) else ():
            try:
                refractive_index(medium, wavelength)
            except GlassError as error:
                yield Fault(where, None, str(error))
                break


def _medium_key(part: Surface | MicrolensArray) -> str:
    return "glass" if part.gradient is None else "gradient"


def _absorption_faults(scene: SceneParts) -> Iterator[Fault]:
    """Yield glasses of the camera without the required internal transmittance."""
    if not scene.camera.absorption:
        return
    media: list[tuple[Location, GlassOrAir]] = [
        (("camera", "lens", "surfaces", i, "glass"), surface.medium)
        # The medium behind the last one is clear.
        for i, surface in enumerate(scene.camera.lens.surfaces[: scene.camera.lens.last_interface])
    ]
    for i, surface in enumerate(scene.camera.lens.surfaces):
        if surface.refractor is not None:
            media.append((("camera", "lens", "surfaces", i, "refractor", "glass"), surface.refractor.medium))
    if scene.camera.mla is not None:
        media.append((("camera", "mla", "glass"), scene.camera.mla.medium))
    if scene.camera.sensor.cover is not None:
        media.append((("camera", "sensor", "cover", "glass"), scene.camera.sensor.cover.medium))
    named = [(where, name) for where, medium in media if (name := catalogue_name(medium)) is not None]
    if not named and scene.camera.lens.file is None:
        yield Fault(
            ("camera", "absorption"), True,
            "neither lens, array nor cover has a glass of the catalogue; give such a glass by name, or omit "
            "absorption",
        )  # fmt: skip
    for where, glass in named:
        for wavelength in _checked_nm(scene):
            try:
                absorption_per_mm(glass, wavelength)
            except GlassError as error:
                yield Fault(where, glass, f"camera.absorption: {error}; omit it, or use another glass")
                break


def _medium_behind_lens(scene: SceneParts) -> GlassOrAir:
    """Return the medium behind the lens, in the camera's air."""
    camera = scene.camera
    surfaces = camera.lens.surfaces
    behind = camera.image_medium or (surfaces[-1] if surfaces else None)
    return in_air(behind, camera.air).medium if behind is not None else None


def _lenslet_faults(scene: SceneParts) -> Iterator[Fault]:
    mla = scene.camera.mla
    if mla is None:
        return
    if not _checked_nm(scene):
        return
    plate, behind = in_air(mla, scene.camera.air).medium, _medium_behind_lens(scene)
    for wavelength in dict.fromkeys((scene.primary_nm, *_checked_nm(scene))):
        n, outside = (refractive_index(each, wavelength) for each in (plate, behind))
        # The ratio of two numbers that differ in the last digit can be 1.
        if mla.bends_by_shape_alone and not n / outside > 1.0:
            medium = "index" if mla.index is not None else "glass"
            beside = "the air" if outside == AIR else "the medium behind the lens"
            at = f" at {wavelength:g} nm" if wavelength != scene.primary_nm else ""
            yield Fault(
                ("camera", "mla", medium), getattr(mla, medium),
                f"has the index {n:.6g} beside {beside}{at}; lenslets need an index above {outside:.6g}",
            )  # fmt: skip
            return
    n = refractive_index(plate, scene.primary_nm)
    for kind, focal_length in enumerate(mla.focal_length_mm or ()):
        radius = focal_length * (n - 1)
        if why := mla.cap_fault(radius, 1 / (n - 1), kind):
            yield Fault(
                ("camera", "mla", "focal_length_mm"),
                focal_length,
                f"makes radius_mm = {radius:.6g} with index {n:.6g}; {why}",
            )


def _memory_faults(scene: SceneParts) -> Iterator[Fault]:
    sensor, mla = scene.camera.sensor, scene.camera.mla
    channels = scene.channels
    film = FILM_BYTES * sensor.pixels[0] * sensor.pixels[1] * channels
    if film > physical_memory_bytes():
        yield Fault(
            ("camera", "sensor", "pixels"),
            list(sensor.pixels),
            f"with {counted(channels, 'channel')} the film takes {_gigabytes(film)} of "
            f"memory, but this machine has {_gigabytes(physical_memory_bytes())}",
        )
    lenslets = LENSLET_BYTES * mla.count[0] * mla.count[1] if mla is not None else 0
    if mla is not None and lenslets > physical_memory_bytes():
        yield Fault(
            ("camera", "mla", "count"),
            list(mla.count),
            f"the lenslets take {_gigabytes(lenslets)} of memory, but this machine has "
            f"{_gigabytes(physical_memory_bytes())}",
        )


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.3g} GB"
