"""The whole scene, read from a scene file or built by a script."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from lfmesh.errors import SceneError
from lfmesh.notebook import Shown
from lfmesh.optics.gladstone_dale import air_density
from lfmesh.scene.camera.file_choices import FILE_CHOICES
from lfmesh.scene.changes import changed_table, opened, steps_of
from lfmesh.scene.inputs import digest_of, files_of
from lfmesh.scene.light.spectra import Spectrum
from lfmesh.scene.model import Fault, dead_end, format_path
from lfmesh.scene.scene_faults import scene_faults
from lfmesh.scene.scene_parts import SceneParts


def _number(things: tuple[object, ...], name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


class Scene(SceneParts, Shown):
    """A camera, the objects in front of it, and the settings of a render.

    Two scenes are equal if all their fields are; the folder of relative paths does not count.
    """

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
    def title(self) -> str:
        """Name in reports: the scene's own, else that of its file without the ending; "" for a scripted scene."""
        return self.name or self._title

    def titled(self, title: str) -> "Scene":
        """Return the same scene with a title, which counts unless it has a name.

        Parameters
        ----------
        title : str

        Returns
        -------
        Scene
        """
        copy = self.model_copy()
        copy._title = title
        return copy

    def at_line(self, wavelength_nm: float) -> "Scene":
        """Return the scene at a single wavelength, in place of its wavelengths or bands.

        A spectrum has no power at a single wavelength, so every spectrum is replaced by an even one. Surfaces and
        media with a temperature or a spectral radiance emit 1 W/(m² sr) or 1 W/(mm³ sr) instead. Air keeps its index.

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
            is_hot = medium.temperature_k is not None
            if medium.temperature_k is not None and medium.pressure_kpa is not None:
                density = float(air_density(medium.temperature_k, medium.pressure_kpa))
                changes |= {f"media[{i}].{key}": None for key in ("temperature_k", "pressure_kpa")}
                changes[f"media[{i}].density_kg_m3"] = density
                is_hot = medium.absorption_per_mm != 0.0
            if is_hot or isinstance(medium.emission_w_mm3_sr, Spectrum):
                changes |= {f"media[{i}].{key}": None for key in ("temperature_k", "spectrum")}
                changes[f"media[{i}].emission_w_mm3_sr"] = 1.0
            elif medium.spectrum is not None:
                changes[f"media[{i}].spectrum"] = None
        changes |= {f"particles[{i}].spectrum": None for i in range(len(self.particles))}
        return self.changed(changes)

    @property
    def digests(self) -> dict[str, str]:
        """SHA-256 of the files that a run was rendered with, by path; empty if any contents are accepted."""
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
        """Return the same scene, with the SHA-256 that each of its files must have.

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
        """Return the same scene with its files pinned to their present contents.

        Files that already have a digest keep it.

        Returns
        -------
        Scene
        """
        names = dict.fromkeys(name for _, name in files_of(self) if name not in self._digests)
        there = {name: path for name in names if (path := self.resolve(name)).is_file()}
        return self.with_digests(self._digests | {name: digest_of(path) for name, path in there.items()})

    def changed(self, values: dict[str, Any], *, solves: bool = False) -> "Scene":
        """Return a copy with some values replaced, validated like a file.

        Parameters
        ----------
        values : dict
            New value by path, such as {"camera.mla.pitch_mm": 0.1, "targets[0].position_mm": [0, 0, -400]}.
            None removes an optional value.
        solves : bool
            True if the values follow from the scene itself, which keeps its lens file.

        Returns
        -------
        Scene

        Raises
        ------
        SceneError
            A path leads nowhere, or the changed scene is not valid.
        """
        # Values off every path stay the models that they are, and are not checked again.
        data = opened(self)
        table = self._lens_table
        chosen = {("camera", "lens", key) for key in FILE_CHOICES}
        if table is not None and any(steps_of(path)[:3] in chosen for path in values):
            # The lens file is read again when the scene is solved.
            data["camera"] = opened(data["camera"]) | {"lens": dict(table)}
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
                    place[step] = {} if missing else opened(place[step])
                    place = place[step]
        scene = Scene(**data)
        scene._folder, scene._digests, scene._title = self._folder, dict(self._digests), self._title
        scene._lens_table = table if solves else changed_table(table, values)
        return scene

    def still(self) -> "Scene":
        """Return the scene as given, that at t = 0: a copy without exposure and motions.

        Returns
        -------
        Scene
        """
        if self.exposure is None:
            return self
        moving = {format_path(where): None for where, _ in self.things_with_motion()}
        streaks = {f"particles[{i}].frame_time_s": None for i in range(len(self.particles))}
        return self.changed({"exposure": None} | moving | streaks)

    def camera_alone(self, values: dict[str, Any] | None = None) -> "Scene":
        """Return a still copy with an empty object space: no targets, lights, media, particles or tanks.

        Parameters
        ----------
        values : dict, optional
            Other values to replace, as in `changed`.

        Returns
        -------
        Scene
        """
        empty: dict[str, Any] = dict.fromkeys(("targets", "lights", "media", "particles", "tanks"), ())
        if self.exposure is not None:
            empty |= {"exposure": None, "camera.motion": None}
        return self.changed(empty | (values or {}))

    def dump_toml(self) -> str:
        """Return the scene as TOML that loads to an equal scene, without defaults.

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
        """SHA-256 of all fields, defaults included, as canonical JSON; contents of files are excluded."""
        # A scene does not change, and a render asks for its digest dozens of times.
        if not self._digest:
            text = json.dumps(self.model_dump(mode="json"), sort_keys=True, separators=(",", ":"))
            self._digest = hashlib.sha256(text.encode()).hexdigest()
        return self._digest

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> "Scene":
        """Return a copy with some fields replaced without checks; `changed` checks them."""
        copy = super().model_copy(update=update, deep=deep)
        if update:
            copy._digest = ""
        return copy

    def __eq__(self, other: object) -> bool:
        return self.__dict__ == other.__dict__ if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)

    def faults(self) -> Iterator[Fault]:
        """Yield faults that concern several parts of the scene."""
        yield from scene_faults(self)
