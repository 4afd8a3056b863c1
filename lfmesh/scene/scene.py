"""The whole scene: what a scene file holds, and what a script builds."""

import hashlib
import json
import os
import re
from collections.abc import Iterator, Mapping
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr

from lfmesh.errors import GlassError, SceneError
from lfmesh.notebook import Shown
from lfmesh.optics.glass import Medium as GlassOrAir
from lfmesh.optics.glass import absorption_per_mm, catalogue_name, refractive_index
from lfmesh.optics.metals import metal_index
from lfmesh.scene.camera.bands import Centroids, Passband, passband, preset
from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.lens import FILE_CHOICES
from lfmesh.scene.inputs import digest_of, file_stamp, files_of, found
from lfmesh.scene.light.lights import Light
from lfmesh.scene.light.particles import Particles
from lfmesh.scene.light.spectra import Spectrum, curve_of
from lfmesh.scene.literals import counted
from lfmesh.scene.materials.coatings import Coating, name_fault, unknown_fault
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.materials.glass_in_air import in_its_air
from lfmesh.scene.media.media import Medium
from lfmesh.scene.model import Fault, Location, Model, dead_end
from lfmesh.scene.objects.gltf_keys import GltfLights, GltfTargets, or_table
from lfmesh.scene.objects.tank import Tank
from lfmesh.scene.objects.targets import Target
from lfmesh.scene.quantities import Text
from lfmesh.scene.settings.transport import PRIMARY_NM, Transport

# Mean, squared deviation and the replicate under way, in float64, and two counts of hits, with what merging and writing
# need on top.
FILM_BYTES = 48
LENSLET_BYTES = 32

NEEDS_BANDS = "needs camera.sensor.bands: a spectrum of light has power by the nm, and single wavelengths have no width"


def _number(things: tuple[object, ...], name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


class Scene(Model, Shown):
    """A camera, what stands in front of it, and how to trace it.

    Two scenes are equal when all their fields are; the folder that relative paths start from does not count.
    """

    schema_version: Literal[1] = 1
    """Version of this format."""
    name: Text = ""
    """Name of the scene."""
    camera: Camera
    """Lens, microlens array and sensor."""
    targets: tuple[Target, ...] = Field(default=(), json_schema_extra=or_table(GltfTargets))
    """Bodies in front of the camera; also { file = "scene.glb" }: every object of a glTF file."""
    tanks: tuple[Tank, ...] = ()
    """Boxes of windows and liquid in front of the camera."""
    lights: tuple[Light, ...] = Field(default=(), json_schema_extra=or_table(GltfLights))
    """Lamps; also { file = "scene.glb" }: every light of a glTF file."""
    media: tuple[Medium, ...] = ()
    """Media in front of the camera that absorb, scatter or emit: flames, fog, smoke."""
    particles: tuple[Particles, ...] = ()
    """Points in front of the camera that shine, or scatter the light of a sheet."""
    coatings: dict[str, Coating] = Field(default_factory=dict)
    """Coatings by the names that surfaces give."""
    transport: Transport = Field(default_factory=Transport)
    """Settings of a render."""

    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _digests: dict[str, str] = PrivateAttr(default_factory=dict)
    # Table of the lens as the scene file has it, where that names a lens file, whose other choices may be asked for.
    _lens_table: dict[str, Any] | None = PrivateAttr(default=None)
    _found: dict[str, tuple[Path, tuple[object, ...]]] = PrivateAttr(default_factory=dict)
    _digest: str = PrivateAttr(default="")

    def __repr__(self) -> str:
        camera = self.camera
        name = f"{self.name!r}, " if self.name else ""
        mla = f"{camera.mla.count[0]} × {camera.mla.count[1]} lenslets, " if camera.mla is not None else ""
        width, height = camera.sensor.pixels
        return (
            f"<Scene: {name}{mla}{width} × {height} pixels, {_number(self.targets, 'target')}, "
            f"{_number(self.lights, 'light')}>"
        )

    @property
    def folder(self) -> Path:
        """Folder that relative paths start from: the scene file's; for a scripted scene the current one."""
        return self._folder

    def resolve(self, path: str | Path) -> Path:
        """Return the path of a texture or mesh of this scene as one that can be opened.

        Parameters
        ----------
        path : str or Path
            As the scene gives it.

        Returns
        -------
        Path

        Raises
        ------
        FileError
            The scene is that of a run, and the file is not the one that it was rendered with.
        """
        name, place = str(path), self._folder / path
        if name not in self._digests:
            return place
        known = self._found.get(name)
        if known is None or file_stamp(known[0]) != known[1]:
            file = found(place, self._digests[name], self._folder)
            known = self._found[name] = file, file_stamp(file)
        return known[0]

    @property
    def passbands(self) -> tuple[Passband, ...]:
        """The bands of the sensor with their responses; none where the channels are single wavelengths.

        Raises
        ------
        FileError
            The file of a response cannot be used.
        """
        bands = self.camera.sensor.bands
        if bands is None:
            return ()
        if isinstance(bands, str):
            return preset(bands)
        return tuple(
            passband(band, self.resolve(band.response) if band.response is not None else None) for band in bands
        )

    @property
    def channels(self) -> int:
        """Number of channels of the image."""
        bands = self.camera.sensor.bands
        if bands is None:
            return len(self.transport.wavelengths_nm)
        return len(preset(bands)) if isinstance(bands, str) else len(bands)

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the bands; none where the channels are single wavelengths."""
        return tuple(band.name for band in self.passbands)

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Wavelength of each channel, nm; of bands their `Centroids`."""
        bands = self.passbands
        return Centroids.of(bands) if bands else self.transport.wavelengths_nm

    @property
    def primary_nm(self) -> float:
        """The wavelength of first-order optics, nm: of single ones the middle, of bands the centroid of the first."""
        if self.camera.sensor.bands is not None:
            return self.wavelengths_nm[0]
        known = sorted(self.transport.wavelengths_nm)
        return known[len(known) // 2]

    @property
    def reach_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength that the sensor detects, nm."""
        ends = [end for band in self.passbands for end in band.response.ends_nm] or self.transport.wavelengths_nm
        return min(ends), max(ends)

    def at_line(self, wavelength_nm: float) -> "Scene":
        """Return the scene at a single wavelength, in place of its wavelengths or bands.

        Spectra of light have no power at a single one. What they stand for shines with an even spectrum instead, and
        a surface with a temperature or a spectrum of radiance with 1 W/(m² sr).

        Parameters
        ----------
        wavelength_nm : float

        Returns
        -------
        Scene
        """
        changes: dict[str, Any] = {"camera.sensor.bands": None, "transport.wavelengths_nm": (wavelength_nm,)}
        for i, target in enumerate(self.targets):
            material = target.material
            if material.temperature_k is not None or isinstance(material.radiance_w_m2_sr, Spectrum):
                changes |= {f"targets[{i}].material.{key}": None for key in ("temperature_k", "spectrum")}
                changes[f"targets[{i}].material.radiance_w_m2_sr"] = 1.0
            elif material.spectrum is not None:
                changes[f"targets[{i}].material.spectrum"] = None
        changes |= {f"lights[{i}].spectrum": None for i in range(len(self.lights))}
        for i, medium in enumerate(self.media):
            if medium.temperature_k is not None or isinstance(medium.emission_w_mm3_sr, Spectrum):
                changes |= {f"media[{i}].{key}": None for key in ("temperature_k", "spectrum")}
                changes[f"media[{i}].emission_w_mm3_sr"] = 1.0
            elif medium.spectrum is not None:
                changes[f"media[{i}].spectrum"] = None
        changes |= {f"particles[{i}].spectrum": None for i in range(len(self.particles))}
        return self.changed(changes)

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 by path of the files that a run was rendered with; empty where any contents will do."""
        return dict(self._digests)

    def in_folder(self, folder: str | Path) -> "Scene":
        """Return the same scene with its relative paths starting from `folder`.

        Parameters
        ----------
        folder : str or Path

        Returns
        -------
        Scene
        """
        copy = self.model_copy()
        copy._folder = Path(folder).resolve()
        copy._found = {}
        return copy

    def with_digests(self, digests: dict[str, str]) -> "Scene":
        """Return the same scene, whose files must have these SHA-256, by their paths.

        Parameters
        ----------
        digests : dict of str
            SHA-256, in hexadecimal digits, by path.

        Returns
        -------
        Scene
        """
        copy = self.model_copy()
        copy._digests, copy._found = dict(digests), {}
        return copy

    def pinned(self) -> "Scene":
        """Return the same scene, whose files have to stay what they are now, as they are read more than once.

        Files that have digests already keep them.

        Returns
        -------
        Scene
        """
        names = dict.fromkeys(name for _, name in files_of(self) if name not in self._digests)
        there = {name: path for name in names if (path := self.resolve(name)).is_file()}
        return self.with_digests(self._digests | {name: digest_of(path) for name, path in there.items()})

    def changed(self, values: dict[str, Any], *, solves: bool = False) -> "Scene":
        """Return a copy with some values replaced, checked like a file.

        Parameters
        ----------
        values : dict
            New value by path, such as {"camera.mla.pitch_mm": 0.1, "targets[0].position_mm": [0, 0, -400]};
            None takes an optional value out.
        solves : bool
            They are what follows from the scene itself, so that its lens stays the one of its file.

        Returns
        -------
        Scene

        Raises
        ------
        SceneError
            A path leads nowhere, or the changed scene is not valid.
        """
        # What no path leads through stays the model that it is, and is not checked again.
        data = _opened(self)
        table = self._lens_table
        chosen = {("camera", "lens", key) for key in FILE_CHOICES}
        if table is not None and any(steps_of(path)[:3] in chosen for path in values):
            # The lens file is read again, when the scene is solved.
            data["camera"] = _opened(data["camera"]) | {"lens": dict(table)}
        for path, value in values.items():
            steps = steps_of(path)
            place: Any = data
            for i, step in enumerate(steps):
                reason = dead_end(place, step, steps[:i])
                if reason is not None:
                    raise SceneError(f"Scene.{path}: {reason}")
                if i == len(steps) - 1:
                    place[step] = value
                else:
                    missing = isinstance(place, dict) and place.get(step) is None
                    place[step] = {} if missing else _opened(place[step])
                    place = place[step]
        scene = Scene(**data)
        scene._folder, scene._digests = self._folder, dict(self._digests)
        scene._lens_table = table if solves else _changed_table(table, values)
        return scene

    def camera_alone(self, values: dict[str, Any] | None = None) -> "Scene":
        """Return a copy with nothing before the camera: no targets, lights, media, particles and tanks.

        Parameters
        ----------
        values : dict, optional
            What else is replaced, as in `changed`.

        Returns
        -------
        Scene
        """
        empty: dict[str, Any] = dict.fromkeys(("targets", "lights", "media", "particles", "tanks"), ())
        return self.changed(empty | (values or {}))

    def dump_toml(self) -> str:
        """Return the scene as TOML that loads to an equal scene; defaults are left out.

        Returns
        -------
        str
        """
        from lfmesh.scene import toml

        return toml.dump(self)

    def to_json(self) -> str:
        """Return the scene as JSON, with the keys and values of the TOML file.

        Returns
        -------
        str
        """
        from lfmesh.scene import toml

        return json.dumps(toml.table(self), ensure_ascii=False)

    @property
    def digest(self) -> str:
        """SHA-256 of all fields, defaults included, as canonical JSON; the contents of files do not enter."""
        # A scene does not change, and is asked for it dozens of times while it is rendered.
        if not self._digest:
            text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
            self._digest = hashlib.sha256(text.encode()).hexdigest()
        return self._digest

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> "Scene":
        """Return a copy with some fields replaced, which are not checked; `changed` checks them."""
        copy = super().model_copy(update=update, deep=deep)
        if update:
            copy._digest = ""
        return copy

    def __eq__(self, other: object) -> bool:
        return self.__dict__ == other.__dict__ if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)

    def faults(self) -> Iterator[Fault]:
        """Yield what only the whole scene shows: glasses at its wavelengths, lenslet radii, memory."""
        glasses = list(self._glass_faults())
        yield from glasses
        if not glasses:
            yield from self._lenslet_faults()
        yield from self._coating_faults()
        yield from self._body_faults()
        yield from self._band_faults()
        yield from self._spectrum_faults()
        yield from self._absorption_faults() if not glasses else ()
        yield from self._polarisation_faults()
        yield from self._diffraction_faults()
        yield from self._memory_faults()

    @property
    def all_coatings(self) -> dict[str, Coating]:
        """The scene's coatings and those that the lens brings, by name."""
        return {**self.camera.lens.coatings, **self.coatings}

    def coating_uses(self) -> Iterator[tuple[Location, str]]:
        """Yield where surfaces give the name of a coating, and the name.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root.
        coating : str
        """
        for i, surface in enumerate(self.camera.lens.surfaces):
            where: Location = ("camera", "lens", "surfaces", i)
            yield (*where, "coating"), surface.coating
            if surface.refractor is not None:
                yield (*where, "refractor", "coating"), surface.refractor.coating
        if self.camera.mla is not None:
            yield ("camera", "mla", "curved_coating"), self.camera.mla.curved_coating
            yield ("camera", "mla", "flat_coating"), self.camera.mla.flat_coating
        if self.camera.sensor.cover is not None:
            yield ("camera", "sensor", "cover", "coating"), self.camera.sensor.cover.coating
        for i, target in enumerate(self.targets):
            if target.refractor is not None:
                yield ("targets", i, "refractor", "coating"), target.refractor.coating

    def bodies(self) -> tuple[tuple[str, int], ...]:
        """Return the names of all bodies of glass and liquid, and their numbers among targets, tanks' bodies last.

        Returns
        -------
        tuple of (str, int)
        """
        found = []
        for i, target in enumerate(self.targets):
            if target.refractor is not None:
                found += [(f"targets[{i}]", i), *([(target.name, i)] if target.name is not None else [])]
        for k, tank in enumerate(self.tanks):
            first = len(self.targets) + 2 * k
            found += [(f"{tank.called(k)} wall", first), (f"{tank.called(k)} liquid", first + 1)]
        return tuple(found)

    def body_named(self, name: str) -> int:
        """Return the number of a body of glass or liquid among the targets, where tanks' bodies come last.

        Parameters
        ----------
        name : str
            Such as "prism" or "tanks[0] liquid".

        Returns
        -------
        int

        Raises
        ------
        SceneError
            There is no such body, or more than one.
        """
        bodies = self.bodies()
        numbers = [number for own, number in bodies if own == name]
        if len(numbers) == 1:
            return numbers[0]
        known = ", ".join(f'"{own}"' for own in {number: own for own, number in bodies}.values())
        if numbers:
            raise SceneError(f"{len(numbers)} bodies have this name; give each its own")
        raise SceneError(f"no body of glass or liquid has this name; there {f'are {known}' if known else 'is none'}")

    def _body_faults(self) -> Iterator[Fault]:
        """Yield media in bodies that are not there."""
        for i, medium in enumerate(self.media):
            if medium.inside is not None:
                try:
                    self.body_named(medium.inside)
                except SceneError as error:
                    yield Fault(("media", i, "inside"), medium.inside, str(error))

    def _checked_nm(self) -> tuple[float, ...]:
        """Wavelengths at which glasses are looked for before anything is built; none if they stand in a file."""
        bands = self.camera.sensor.bands
        if isinstance(bands, tuple) and any(band.response is not None for band in bands):
            return ()
        return self.transport.wavelengths_nm if bands is None else self.reach_nm

    def _spectrum_faults(self) -> Iterator[Fault]:
        """Yield densities by wavelength that have no bands to be integrated over, and tables that are too short."""
        in_bands = self.camera.sensor.bands is not None
        uses: list[tuple[Location, Any, bool]] = []
        for i, target in enumerate(self.targets):
            material = target.material
            where: Location = ("targets", i, "material")
            uses.append(((*where, "reflectance"), material.reflectance, False))
            uses += [((*where, key), getattr(material, key), True) for key in ("radiance_w_m2_sr", "spectrum")]
            if material.temperature_k is not None and not in_bands:
                yield Fault((*where, "temperature_k"), material.temperature_k, NEEDS_BANDS)
            if target.refractor is not None:
                where = ("targets", i, "refractor", "absorption_per_mm")
                uses.append((where, target.refractor.absorption_per_mm, False))
        for i, tank in enumerate(self.tanks):
            uses += [
                (("tanks", i, key, "absorption_per_mm"), getattr(tank, key).absorption_per_mm, False)
                for key in ("wall", "liquid")
            ]
        uses += [(("lights", i, "spectrum"), light.spectrum, True) for i, light in enumerate(self.lights)]
        for i, medium in enumerate(self.media):
            where = ("media", i)
            uses += [((*where, key), getattr(medium, key), False) for key in ("absorption_per_mm", "scattering_per_mm")]
            uses += [((*where, key), getattr(medium, key), True) for key in ("emission_w_mm3_sr", "spectrum")]
            if medium.temperature_k is not None and not in_bands:
                yield Fault((*where, "temperature_k"), medium.temperature_k, NEEDS_BANDS)
        uses += [(("particles", i, "spectrum"), group.spectrum, True) for i, group in enumerate(self.particles)]
        for where, spectrum, is_density in uses:
            if not isinstance(spectrum, Spectrum):
                continue
            if is_density and not in_bands:
                yield Fault(where, None, NEEDS_BANDS)
            elif spectrum.file is None and self._checked_nm():
                try:
                    curve_of(spectrum, self.reach_nm, self, "spectrum")
                except SceneError as error:
                    yield Fault(where, None, str(error).removeprefix("spectrum: "))

    def _band_faults(self) -> Iterator[Fault]:
        """Yield wavelengths beside bands, of which one set must be left out."""
        wavelengths_nm = self.transport.wavelengths_nm
        if self.camera.sensor.bands is not None and wavelengths_nm != (PRIMARY_NM,):
            yield Fault(
                ("transport", "wavelengths_nm"),
                list(wavelengths_nm),
                "camera.sensor.bands is given too; give one of them",
            )

    def rough_in_camera(self) -> list[Location]:
        """Return where lens and array are given a finish that scatters light.

        Returns
        -------
        list of tuple
            Keys from the scene's root.
        """
        return [where for where, finish in self.finishes() if finish.is_rough and where[0] == "camera"]

    def finishes(self) -> Iterator[tuple[Location, Finish]]:
        """Yield where surfaces give a finish, and the finish.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root.
        finish : Finish
        """
        for i, surface in enumerate(self.camera.lens.surfaces):
            where: Location = ("camera", "lens", "surfaces", i)
            yield (*where, "finish"), surface.finish
            if surface.refractor is not None:
                yield (*where, "refractor", "finish"), surface.refractor.finish
        if self.camera.mla is not None:
            yield ("camera", "mla", "curved_finish"), self.camera.mla.curved_finish
            yield ("camera", "mla", "flat_finish"), self.camera.mla.flat_finish
        for i, target in enumerate(self.targets):
            if target.refractor is not None:
                yield ("targets", i, "refractor", "finish"), target.refractor.finish

    def _coating_faults(self) -> Iterator[Fault]:
        of_lens = self.camera.lens.coatings
        for beginning, coatings in (((), self.coatings), (("camera", "lens"), of_lens)):
            for name, coating in coatings.items():
                where: Location = (*beginning, "coatings", name)
                if why := name_fault(name):
                    yield Fault(where, None, why)
                for i, layer in enumerate(coating.layers or ()):
                    for wavelength in self._checked_nm() if layer.glass is not None else ():
                        try:
                            layer.index_at(wavelength)
                        except GlassError as error:
                            yield Fault((*where, "layers", i, "glass"), None, str(error))
                            break
        for name, coating in self.coatings.items():
            if of_lens.get(name, coating) != coating:
                yield Fault(("coatings", name), None, "the lens has another coating of this name; take another one")
        for where, name in self.coating_uses():
            if why := unknown_fault(name, tuple(self.all_coatings)):
                yield Fault(where, name, why)

    def _polarisation_faults(self) -> Iterator[Fault]:
        """Yield what asks for polarised light where there is none, or has no known phases where there is."""
        if not self.transport.polarisation:
            states: list[tuple[Location, Any]] = [
                (("lights", i, "polarisation"), light.state) for i, light in enumerate(self.lights)
            ]
            for where, value in ((("camera", "polariser_deg"), self.camera.polariser_deg), *states):
                if value is not None:
                    yield Fault(where, value, "needs transport.polarisation = true")
            return
        for where, name in self.coating_uses():
            coating = self.all_coatings.get(name)
            if coating is not None and coating.layers is None:
                yield Fault(
                    where,
                    name,
                    f"transport.polarisation needs the phases of this coating, which its {coating.kind} does not tell; "
                    "give it layers",
                )
        for where, finish in self.finishes():
            if finish.is_rough:
                yield Fault(
                    where, finish.kind, "transport.polarisation follows light at polished faces only; polish it"
                )
        for i, surface in enumerate(self.camera.lens.surfaces):
            if surface.paraxial:
                yield Fault(
                    ("camera", "lens", "surfaces", i, "paraxial"),
                    True,
                    "transport.polarisation follows light at real interfaces only; give the lens radii and glass",
                )
        for i, target in enumerate(self.targets):
            if target.material.gloss is not None:
                yield Fault(
                    ("targets", i, "material", "gloss"),
                    None,
                    "transport.polarisation knows matt targets and glass, which a gloss is neither of; leave it out",
                )
        if self.camera.sensor.cover is not None:
            yield Fault(
                ("camera", "sensor", "cover"), None, "transport.polarisation stops at the array; leave the cover out"
            )
        if self.camera.sensor.reflectance > 0.0:
            yield Fault(
                ("camera", "sensor", "reflectance"),
                self.camera.sensor.reflectance,
                "transport.polarisation needs the phases of what is reflected, which a share does not tell; leave "
                "reflectance out",
            )

    def _diffraction_faults(self) -> Iterator[Fault]:
        """Yield what keeps the diffraction of lenslets or stop from being followed."""
        where, chosen, mla = ("transport", "diffraction"), self.transport.diffraction, self.camera.mla
        if chosen == "none":
            return
        if chosen == "stop":
            if mla is not None:
                why = 'makes pictures behind an array worse, where light is spread at the lenslets: take "lenslets"'
                yield Fault(where, chosen, why)
            elif self.transport.split != "transmit" or self.transport.engine == "mesh":
                why = 'is followed along the image path alone: take split = "transmit", and another engine than "mesh"'
                yield Fault(where, chosen, why)
        elif mla is None:
            yield Fault(where, chosen, 'needs camera.mla; without an array take "stop"')
        elif mla.curved_finish.is_rough or mla.flat_finish.is_rough:
            yield Fault(where, chosen, 'needs an array that is polished; take "none" with a rough finish')
        if self.transport.polarisation:
            yield Fault(where, chosen, 'is not followed for polarised light; take "none" with transport.polarisation')

    def _glass_faults(self) -> Iterator[Fault]:
        media: list[tuple[Location, GlassOrAir]] = [
            (("camera", "lens", "surfaces", i, "glass"), surface.medium)
            for i, surface in enumerate(self.camera.lens.surfaces)
        ]
        for place, outside in ((("camera",), self.camera), (("camera", "lens"), self.camera.lens)):
            if outside.object_medium is not None:
                media.append(((*place, "object_medium", "glass"), outside.object_medium.medium))
        for i, surface in enumerate(self.camera.lens.surfaces):
            if surface.refractor is not None:
                media.append((("camera", "lens", "surfaces", i, "refractor", "glass"), surface.refractor.medium))
        for i, target in enumerate(self.targets):
            if target.refractor is not None:
                media.append((("targets", i, "refractor", "glass"), target.refractor.medium))
        for i, tank in enumerate(self.tanks):
            media += [(("tanks", i, "wall", "glass"), tank.wall.medium)]
            media += [(("tanks", i, "liquid", "glass"), tank.liquid.medium)]
        if self.camera.mla is not None:
            media.append((("camera", "mla", "glass"), self.camera.mla.medium))
        if self.camera.sensor.cover is not None:
            media.append((("camera", "sensor", "cover", "glass"), self.camera.sensor.cover.medium))
        for i, target in enumerate(self.targets):
            gloss = target.material.gloss
            for wavelength in self._checked_nm() if gloss is not None and gloss.metal is not None else ():
                try:
                    metal_index(gloss.metal or "" if gloss is not None else "", wavelength)
                except GlassError as error:
                    yield Fault(("targets", i, "material", "gloss", "metal"), None, str(error))
                    break
        for where, medium in media:
            for wavelength in self._checked_nm():
                try:
                    refractive_index(medium, wavelength)
                except GlassError as error:
                    yield Fault(where, None, str(error))
                    break

    def _absorption_faults(self) -> Iterator[Fault]:
        """Yield glasses of the camera whose internal transmittance is asked for and not known."""
        if not self.camera.absorption:
            return
        media: list[tuple[Location, GlassOrAir]] = [
            (("camera", "lens", "surfaces", i, "glass"), surface.medium)
            for i, surface in enumerate(self.camera.lens.surfaces)
        ]
        for i, surface in enumerate(self.camera.lens.surfaces):
            if surface.refractor is not None:
                media.append((("camera", "lens", "surfaces", i, "refractor", "glass"), surface.refractor.medium))
        if self.camera.mla is not None:
            media.append((("camera", "mla", "glass"), self.camera.mla.medium))
        if self.camera.sensor.cover is not None:
            media.append((("camera", "sensor", "cover", "glass"), self.camera.sensor.cover.medium))
        named = [(where, name) for where, medium in media if (name := catalogue_name(medium)) is not None]
        if not named and self.camera.lens.file is None:
            yield Fault(
                ("camera", "absorption"), True,
                "neither lens, array nor cover has a glass of the catalogue; give such a glass by name, or leave "
                "absorption out",
            )  # fmt: skip
        for where, glass in named:
            for wavelength in self._checked_nm():
                try:
                    absorption_per_mm(glass, wavelength)
                except GlassError as error:
                    yield Fault(where, glass, f"camera.absorption: {error}; leave it out, or take another glass")
                    break

    def _lenslet_faults(self) -> Iterator[Fault]:
        mla = self.camera.mla
        if mla is None:
            return
        if not self._checked_nm():
            return
        placed = in_its_air(self).camera.mla
        n = refractive_index(placed.medium if placed is not None else mla.medium, self.primary_nm)
        if not n > 1.0:
            medium = "index" if mla.index is not None else "glass"
            yield Fault(
                ("camera", "mla", medium), getattr(mla, medium),
                f"has the index {n:.6g} beside the air; it must be above 1 to bend light as lenslets do",
            )  # fmt: skip
            return
        for kind, focal_length in enumerate(mla.focal_length_mm or ()):
            radius = focal_length * (n - 1)
            if why := mla.cap_fault(radius, 1 / (n - 1), kind):
                yield Fault(
                    ("camera", "mla", "focal_length_mm"),
                    focal_length,
                    f"makes radius_mm = {radius:.6g} with index {n:.6g}; {why}",
                )

    def _memory_faults(self) -> Iterator[Fault]:
        sensor, mla = self.camera.sensor, self.camera.mla
        channels = self.channels
        film = FILM_BYTES * sensor.pixels[0] * sensor.pixels[1] * channels
        if film > _physical_memory():
            yield Fault(
                ("camera", "sensor", "pixels"),
                list(sensor.pixels),
                f"with {counted(channels, 'channel')} the film takes {_gigabytes(film)} of "
                f"memory, and this machine has {_gigabytes(_physical_memory())}",
            )
        lenslets = LENSLET_BYTES * mla.count[0] * mla.count[1] if mla is not None else 0
        if mla is not None and lenslets > _physical_memory():
            yield Fault(
                ("camera", "mla", "count"),
                list(mla.count),
                f"the lenslets take {_gigabytes(lenslets)} of memory, and this machine has "
                f"{_gigabytes(_physical_memory())}",
            )


_NUMBER = re.compile(r"[0-9]{1,18}")
"""Of an entry in a path; no list is longer."""


@lru_cache(maxsize=4096)
def steps_of(path: str) -> tuple[str | int, ...]:
    """Return the keys and numbers of a path such as "targets[0].position_mm"."""
    return tuple(int(s) if _NUMBER.fullmatch(s) else s for s in path.replace("]", "").replace("[", ".").split("."))


def _changed_table(table: dict[str, Any] | None, values: dict[str, Any]) -> dict[str, Any] | None:
    """Return the table of a lens with a file after changes by path; None where they reach what the file holds."""
    table = None if table is None else dict(table)
    for path, value in values.items():
        steps = steps_of(path)
        if table is None or steps[:2] != ("camera", "lens")[: len(steps)]:
            continue
        if len(steps) != 3:
            return None
        table |= {str(steps[2]): value}
    return table


def _opened(value: Any) -> Any:
    """Return a model as a table of its fields, a tuple as a list, a table as a copy; what they hold stays as it is.

    Left out is a default that follows from other fields: with those it changes.
    """
    if isinstance(value, Model):
        fields = type(value).model_fields.items()
        return {
            key: getattr(value, key)
            for key, field in fields
            if key in value.model_fields_set or not field.default_factory_takes_validated_data
        }
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value


@cache
def _physical_memory() -> int:
    """Bytes of memory in this machine."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        # Windows has no sysconf: refuse only what no machine holds.
        return 2**44


def _gigabytes(size: float) -> str:
    return f"{size / 1e9:.3g} GB"
