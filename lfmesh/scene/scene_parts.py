"""Parts of a scene, and the channels, bands, bodies, coatings, finishes and files that follow from them."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, PrivateAttr

from lfmesh.errors import SceneError
from lfmesh.optics.glass import Medium as GlassOrAir
from lfmesh.optics.gradient_range import GlassRegion
from lfmesh.scene.camera.bands import Centroids, Passband, passband, preset
from lfmesh.scene.camera.camera import Camera
from lfmesh.scene.camera.gradient import Gradient
from lfmesh.scene.camera.gradient_regions import cell_regions, lens_region
from lfmesh.scene.camera.phase import Phase
from lfmesh.scene.inputs import file_stamp, found
from lfmesh.scene.light.lights import Light
from lfmesh.scene.light.particles import Particles
from lfmesh.scene.materials.coatings import Coating
from lfmesh.scene.materials.finishes import Finish
from lfmesh.scene.materials.own_glass import in_air
from lfmesh.scene.media.media import Medium
from lfmesh.scene.model import Location, Model
from lfmesh.scene.motion import Exposure, is_moving
from lfmesh.scene.objects.gltf_keys import GltfLights, GltfTargets, or_table
from lfmesh.scene.objects.tank import Tank
from lfmesh.scene.objects.targets import Target
from lfmesh.scene.quantities import Text
from lfmesh.scene.settings.transport import Transport


class SceneParts(Model):
    """Fields of a scene, and the parts that follow from them."""

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
    """Media in front of the camera that absorb, scatter, emit or bend light: flames, fog, smoke, flows."""
    particles: tuple[Particles, ...] = ()
    """Points in front of the camera that shine, or scatter the light of a sheet."""
    coatings: dict[str, Coating] = Field(default_factory=dict)
    """Coatings by the names that surfaces give."""
    exposure: Exposure | None = None
    """Time during which pixels collect light, for motion and rolling shutters. Omitted: everything stands still."""
    transport: Transport = Field(default_factory=Transport)
    """Settings of a render."""

    # Name of the file that the scene was read from.
    _title: str = PrivateAttr(default="")
    _folder: Path = PrivateAttr(default_factory=Path.cwd)
    _digests: dict[str, str] = PrivateAttr(default_factory=dict)
    # Lens table of a scene file that names a lens file, kept in case that file must be read with other choices.
    _lens_table: dict[str, Any] | None = PrivateAttr(default=None)
    _found: dict[str, tuple[Path, tuple[object, ...]]] = PrivateAttr(default_factory=dict)
    _digest: str = PrivateAttr(default="")

    @property
    def folder(self) -> Path:
        """Folder that relative paths start from: the scene file's, or the current one for a scripted scene."""
        return self._folder

    def resolve(self, path: str | Path) -> Path:
        """Return the full path of a texture or mesh of this scene.

        Parameters
        ----------
        path : str or Path
            Path that the scene gives.

        Returns
        -------
        Path

        Raises
        ------
        FileError
            The file is not the one that the scene's run was rendered with.
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
        """The sensor's bands with their responses; none if the channels are single wavelengths.

        Raises
        ------
        FileError
            A response file cannot be used.
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
        """Names of the bands; none if the channels are single wavelengths."""
        return tuple(band.name for band in self.passbands)

    @property
    def wavelengths_nm(self) -> tuple[float, ...]:
        """Wavelength of each channel, nm; for bands, their `Centroids`."""
        bands = self.passbands
        return Centroids.of(bands) if bands else self.transport.wavelengths_nm

    @property
    def primary_nm(self) -> float:
        """Wavelength of first-order optics, nm: the middle wavelength, or the centroid of the first band."""
        if self.camera.sensor.bands is not None:
            return self.wavelengths_nm[0]
        known = sorted(self.transport.wavelengths_nm)
        return known[len(known) // 2]

    @property
    def reach_nm(self) -> tuple[float, float]:
        """Shortest and longest wavelength that the sensor detects, nm."""
        ends = [end for band in self.passbands for end in band.response.ends_nm] or self.transport.wavelengths_nm
        return min(ends), max(ends)

    @property
    def all_coatings(self) -> dict[str, Coating]:
        """Coatings of the scene and of its lens, by name."""
        return {**self.camera.lens.coatings, **self.coatings}

    def things_with_motion(self) -> Iterator[tuple[Location, Any]]:
        """Yield the location of each motion, and the object or the camera that has it.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root.
        thing : Camera, Target, Tank, Light or Medium
        """
        if self.camera.motion is not None:
            yield ("camera", "motion"), self.camera
        for key in ("targets", "tanks", "lights", "media"):
            for i, thing in enumerate(getattr(self, key)):
                if thing.motion is not None:
                    yield (key, i, "motion"), thing

    @property
    def moves(self) -> bool:
        """True if anything moves during the exposure: an object, the camera or particles."""
        streaks = any(group.frame_time_s is not None for group in self.particles)
        return streaks or any(is_moving(thing) for _, thing in self.things_with_motion())

    def coating_uses(self) -> Iterator[tuple[Location, str]]:
        """Yield the location and name of each coating that a surface uses.

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
        """Return the names of all bodies of glass and liquid with their numbers among the targets; tanks come last.

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
        """Return the number of a body of glass or liquid among the targets; bodies of tanks come last.

        Parameters
        ----------
        name : str
            Name such as "prism" or "tanks[0] liquid".

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

    def phases(self) -> Iterator[tuple[Location, Phase, GlassOrAir, GlassOrAir]]:
        """Yield the location of each phase, the phase, and the media on both sides, in the camera's air.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root.
        phase : Phase
        before, behind : Medium
        """
        camera = self.camera
        lens, mla, air = camera.lens, camera.mla, camera.air
        media = [in_air(each, air).medium for each in lens.surfaces]
        if camera.image_medium is not None and media:
            media[lens.last_interface :] = [in_air(camera.image_medium, air).medium] * (
                len(media) - lens.last_interface
            )
        outside = camera.object_medium or lens.object_medium
        before = in_air(outside, air).medium if outside is not None else None
        for i, surface in enumerate(lens.surfaces):
            behind = before if i == 0 and surface.is_plain_stop else media[i]
            if surface.phase is not None:
                yield ("camera", "lens", "surfaces", i, "phase"), surface.phase, before, behind
            before = behind
        if mla is not None:
            plate = in_air(mla, air).medium
            for key, phase in mla.phases.items():
                yield ("camera", "mla", key), phase, before, plate

    def gradients(self) -> Iterator[tuple[Location, Gradient, float]]:
        """Yield the location of each gradient-index glass, the glass, and its length between two vertices in mm.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root.
        gradient : Gradient
        length_mm : float
        """
        for i, surface in enumerate(self.camera.lens.surfaces):
            if surface.gradient is not None:
                where = ("camera", "lens", "surfaces", i, "gradient")
                yield where, surface.gradient, surface.thickness_mm or 0.0
        mla = self.camera.mla
        if mla is not None and mla.gradient is not None:
            yield ("camera", "mla", "gradient"), mla.gradient, mla.thickness_mm

    def gradient_regions(self) -> Iterator[tuple[Location, Gradient, GlassRegion]]:
        """Yield the location of each gradient-index glass, the glass, and the region that it fills.

        Yields
        ------
        location : tuple of str and int
            Keys from the scene's root; the same several times for an array with several types of lenslets.
        gradient : Gradient
        region : GlassRegion
        """
        lens, mla = self.camera.lens, self.camera.mla
        for where, gradient, _ in self.gradients():
            if isinstance(where[-2], int):
                yield where, gradient, lens_region(lens, where[-2])
            elif mla is not None:
                yield from ((where, gradient, region) for region in cell_regions(mla))

    def rough_in_camera(self) -> list[Location]:
        """Return the locations of finishes that scatter light on the lens and array.

        Returns
        -------
        list of tuple
            Keys from the scene's root.
        """
        return [where for where, finish in self.finishes() if finish.is_rough and where[0] == "camera"]

    def finishes(self) -> Iterator[tuple[Location, Finish]]:
        """Yield the location of each surface's finish, and the finish.

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
