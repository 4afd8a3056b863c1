"""Keys that take targets, lights and the camera's place from a glTF file, as Blender writes it."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ValidationError

from lfmesh.scene.model import Fault, Model, fault_lines
from lfmesh.scene.motion import Motion
from lfmesh.scene.quantities import FilePath, NodeKey, Positive, Vector

ENDINGS = (".glb", ".gltf")


class GltfFile(Model):
    """A glTF file that provides a part of the scene."""

    file: FilePath
    """GLB or glTF file, relative to the scene file, in the world's axes; its unit is m."""

    def faults(self) -> Iterator[Fault]:
        """Yield a file of another kind."""
        if Path(self.file).suffix.lower() not in ENDINGS:
            yield Fault(("file",), self.file, "must end in .glb or .gltf; other mesh files belong in [[targets]]")


class GltfTargets(GltfFile):
    """All objects of a glTF file as targets, with their names, materials and places."""

    elsewhere: ClassVar[Mapping[str, str]] = {
        "units": "a glTF file is in m; if the numbers in this one are mm, give scale = 0.001",
        **dict.fromkeys(
            ("material", "materials", "node"),
            'for one object of the file write [[targets]] with file = "...", node = "..." and material = { ... }',
        ),
    }

    scale: Positive | None = None
    """Factor on the coordinates of the file, in addition to its unit. Use 0.001 if its numbers are in millimetres.
    Omitted: 1."""
    anchor: Literal["origin", "centre", "base"] | None = None
    """Point of the whole that `position_mm` places: origin of the file, or centre or base of the box round all its
    objects, as for a target. Omitted: "origin"."""
    position_mm: Vector = (0.0, 0.0, 0.0)
    """Position of the file's own origin, or of the `anchor`, in mm."""
    rotation_deg: Vector = (0.0, 0.0, 0.0)
    """Rotations of the whole about x, then y, then z, in degrees."""
    motion: Motion | None = None
    """Motion of the whole during the exposure, about its position; needs `[exposure]`. Omitted: it stands still."""


class GltfLights(GltfFile):
    """All lights of a glTF file (KHR_lights_punctual)."""

    lighting: Literal["standard", "unitless", "raw"] = "standard"
    """Unit of the file's intensities, by the lighting modes of Blender's exporter. "standard": candela and lux as in
    glTF, at 683 lm/W; "unitless": W/sr and W/m²; "raw": W into all directions and W/m²."""


class GltfPose(GltfFile):
    """The place of a glTF file's camera, with its origin at the entrance pupil."""

    camera: NodeKey | None = None
    """Name or number of the camera's node. Omitted: the only camera of the file."""


class GltfKeys(Model):
    """Parts of a scene taken from glTF files."""

    targets: GltfTargets | None = None
    """Replaces the list of targets."""
    lights: GltfLights | None = None
    """Replaces the list of lights."""
    pose: GltfPose | None = None
    """Replaces the camera's pose."""


def take_keys(data: dict[str, Any], folder: Path) -> tuple[GltfKeys | None, list[str]]:
    """Remove the tables that name a glTF file from a scene's tables.

    Parameters
    ----------
    data : dict
        Tables of the scene file, changed in place.
    folder : Path
        Folder that relative paths start from.

    Returns
    -------
    keys : GltfKeys or None
        None if there are none or one is faulty.
    faults : list of str
        One line per fault.
    """
    camera = data.get("camera")
    places: dict[str, tuple[str, Any]] = {
        "targets": ("targets", data),
        "lights": ("lights", data),
        "pose": ("camera.pose", camera),
    }
    given = {
        key: holder.pop(key)
        for key, (_, holder) in places.items()
        if isinstance(holder, dict) and isinstance(holder.get(key), dict) and "file" in holder[key]
    }
    if not given:
        return None, []
    try:
        return GltfKeys.model_validate(given, context={"folder": folder}), []
    except ValidationError as error:
        lines = fault_lines(error, given)
        return None, [f"camera.{line}" if line.startswith("pose") else line for line in lines]


def _in_one_piece(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a JSON Schema with its definitions in place of the references to them."""
    definitions = schema.pop("$defs", {})

    def resolved(part: Any) -> Any:
        if isinstance(part, list):
            return [resolved(each) for each in part]
        if not isinstance(part, dict):
            return part
        whole = dict(part)
        if "$ref" in whole:
            whole = definitions[whole.pop("$ref").rpartition("/")[2]] | whole
        return {key: resolved(value) for key, value in whole.items()}

    return {key: resolved(value) for key, value in schema.items()}


def or_table(model: type[Model]) -> Callable[[dict[str, Any]], None]:
    """Return a change to a field's JSON Schema that also allows the table of `model`."""

    def widen(schema: dict[str, Any]) -> None:
        told = {key: schema.pop(key) for key in ("title", "description", "default") if key in schema}
        own, table = dict(schema), _in_one_piece(model.model_json_schema())
        schema.clear()
        schema.update(told | {"anyOf": [own, table]})

    return widen
