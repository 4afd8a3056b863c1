"""Scenes as glTF files, e.g. from Blender: objects as targets, lights, and the pose of a camera.

glTF's axes are the world's (right-handed, y up, cameras look along -z); its metres become mm. Each object becomes a
target that names its node; its mesh stays in the file until the scene is built.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import LensFileWarning, MeshError, SceneError
from lfmesh.geometry.files.gltf_left_out import left_out, left_out_of_scene
from lfmesh.geometry.files.gltf_nodes import Node, node_called, nodes_of, not_read, primitives_of
from lfmesh.geometry.files.mesh_file import MM_PER_UNIT, gltf_document, load_mesh
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.mesh import Array, facet_normals
from lfmesh.geometry.objects.targets import origin_mm
from lfmesh.imports.gltf_lights import light_of
from lfmesh.imports.report import Report, Verdict
from lfmesh.scene import Pose, Scene, Target
from lfmesh.scene.light.lights import Light
from lfmesh.scene.objects.gltf_keys import GltfKeys, GltfTargets

MOST_OBJECTS = 10_000
"""Most objects in one file; each is a target with its own mesh."""

MOST_FACETS = 200_000_000
"""Most facets of all objects in one file, counting instances: about 30 GB of meshes."""


@dataclass(frozen=True)
class GltfScene:
    """Tree of a glTF file, and the report on the parts requested.

    Attributes
    ----------
    path : Path
    document : dict
        JSON of the file.
    nodes : list of Node
        Nodes of its scene.
    report : Report
        One entry per part, added when the targets, lights or pose are requested.
    """

    path: Path
    document: dict[str, Any]
    nodes: list[Node]
    report: Report

    def targets(self, file: str, placed: GltfTargets | None = None) -> tuple[Target, ...]:
        """Return one target for each node with a mesh.

        Parameters
        ----------
        file : str
            Name for the file in the targets.
        placed : GltfTargets, optional
            Scale and place of the whole. Default: as the file has it.

        Raises
        ------
        MeshError
            The file has no objects, too many, or a broken one.
        """
        self._whole_file()
        place = {} if placed is None else self._place_of(placed)
        made = []
        facets = 0
        for node in self.nodes:
            parts = primitives_of(self.path, self.document, node)
            for what in not_read(self.path, self.document, node):
                self._enter(node.place, Verdict.APPROXIMATED, f"{what} and has no facets; left out")
            if not parts:
                continue
            facets += sum(self._facets(*part) for part in parts)
            for what in left_out(self.document, node, parts):
                self._enter(node.place, Verdict.APPROXIMATED, what)
            self._enter(node.place, Verdict.TAKEN, "a target")
            made.append(Target(name=_name(node), file=file, node=node.key, **place))
        if not made:
            raise MeshError(f"{self.path}: holds no object with facets in its scene")
        if len(made) > MOST_OBJECTS or facets > MOST_FACETS:
            raise MeshError(
                f"{self.path}: holds {len(made)} objects with {facets} facets; the limits are {MOST_OBJECTS} objects "
                f"and {MOST_FACETS} facets"
            )
        return tuple(made)

    def _place_of(self, placed: GltfTargets) -> dict[str, Any]:
        """Return scale, position and rotation of each target about the file's origin, for an anchor of the whole.

        Raises
        ------
        MeshError
            The anchor is of the box round all objects, and the file has no facets.
        """
        whole = Target(**placed.model_dump(exclude_defaults=True))
        if whole.anchor not in (None, "origin"):
            with warnings.catch_warnings():
                # The targets give these warnings when they are made.
                warnings.simplefilter("ignore", LensFileWarning)
                pieces = load_mesh(self.path)
            meshes = [(piece.mesh, facet_normals(piece.mesh)[1] > 0.0) for piece in pieces]
            corners = np.concatenate([mesh.vertices[np.unique(mesh.faces[solid])] for mesh, solid in meshes])
            if len(corners):
                corners = corners * (1.0 if whole.scale is None else whole.scale)
                whole = whole.model_copy(update={"position_mm": origin_mm(whole, corners)})
        place = whole.model_dump(include={"scale", "position_mm", "rotation_deg"}, exclude_defaults=True)
        if placed.motion is not None:
            place["motion"] = placed.motion.about(placed.position_mm)
        return place

    def lights(self, lighting: str, scene: Scene) -> tuple[Light, ...]:
        """Return the punctual lights.

        Parameters
        ----------
        lighting : str
            Meaning of the intensities, see `scene.gltf_keys.GltfLights`.
        scene : Scene
            Its wavelengths or bands determine the spectra of coloured lights.

        Raises
        ------
        MeshError
            The file has no lights, or a broken one.
        """
        made = []
        for node in self.nodes:
            if (number := _extension(node.entry, "KHR_lights_punctual").get("light")) is not None:
                known = _extension(self.document, "KHR_lights_punctual").get("lights", [])
                if not (isinstance(known, list) and isinstance(number, int) and 0 <= number < len(known)):
                    raise MeshError(
                        f"{self.path}: broken: {node.place} names light {repr(number)[:60]}, which is missing"
                    )
                light, how = light_of(f"{self.path}: {node.place}", node, known[number], lighting, scene)
                for each in how:
                    self._enter(node.place, Verdict.APPROXIMATED, each)
                if light is not None:
                    made.append(light)
        if not made:
            raise MeshError(f"{self.path}: holds no light that shines (KHR_lights_punctual); export punctual lights")
        return tuple(made)

    def pose(self, camera: str | int | None, pupil_z_mm: float) -> Pose:
        """Return the pose that puts a camera's entrance pupil at a camera of the file.

        Parameters
        ----------
        camera : str or int, optional
            Node of the camera; optional if there is only one.
        pupil_z_mm : float
            Position of the entrance pupil, from the first vertex towards the sensor.

        Raises
        ------
        MeshError
            The file has no such camera, or several and none is named, or its orientation is undefined.
        """
        cameras = [node for node in self.nodes if "camera" in node.entry]
        if not cameras:
            raise MeshError(f"{self.path}: holds no camera in its scene; export cameras, or omit the key")
        if camera is None and len(cameras) > 1:
            raise MeshError(
                f"{self.path}: holds {len(cameras)} cameras; give camera, one of "
                f"{', '.join(repr(each.key) for each in cameras[:10])}"
            )
        node = cameras[0] if camera is None else node_called(self.path, cameras, camera)
        turn = _turn(f"{self.path}: {node.place}", node.to_scene[:3, :3])
        shift = node.to_scene[:3, 3] * MM_PER_UNIT["m"] - turn @ [0.0, 0.0, pupil_z_mm]
        self._enter(node.place, Verdict.TAKEN, f"the camera, its entrance pupil {pupil_z_mm:.6g} mm from its vertex")
        return Pose(shift_mm=tuple(map(float, shift)), tilt_deg=_tilt_deg(turn))

    def _enter(self, place: str, verdict: Verdict, how: str) -> None:
        self.report.add(0, place, verdict, how)

    def _whole_file(self) -> None:
        """Report the parts outside the nodes that are not imported."""
        for key, why in (
            ("animations", "objects keep the places of their nodes"),
            ("skins", "meshes with bones keep their rest pose"),
        ):
            if self.document.get(key):
                self._enter(key, Verdict.APPROXIMATED, f"left out; {why}")
        for place, words in left_out_of_scene(self.document, self.nodes):
            self._enter(place, Verdict.APPROXIMATED, words)

    def _facets(self, mesh: int, number: int) -> int:
        """Return the number of facets that the file declares for a primitive."""
        primitive = self.document["meshes"][mesh]["primitives"][number]
        accessors = self.document.get("accessors", [])
        try:
            which = primitive.get("indices", primitive["attributes"]["POSITION"])
            return int(accessors[which]["count"]) // 3
        except (KeyError, IndexError, TypeError, ValueError):
            raise MeshError(f"{self.path}: broken: meshes[{mesh}].primitives[{number}] names no vertices") from None


def read_gltf(path: str | Path) -> GltfScene:
    """Read the tree of a GLB or glTF file without its meshes.

    Raises
    ------
    MeshError
        The file cannot be read, is broken, or requires unsupported features.
    """
    path = Path(path)
    try:
        document = gltf_document(path)
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from None
    return GltfScene(path, document, nodes_of(path, document), Report(path))


def with_gltf(scene: Scene, keys: GltfKeys) -> Scene:
    """Return a scene with targets, lights and camera pose from glTF files replacing its own.

    One LensFileWarning per file lists inexact conversions.

    Parameters
    ----------
    scene : Scene
    keys : GltfKeys
        Parts to import and their files, relative to the scene's folder.

    Raises
    ------
    LfmeshError
        A file cannot be read or lacks a requested part.
    """
    opened: dict[str, GltfScene] = {}

    def of(key: str, file: str) -> GltfScene:
        if file not in opened:
            opened[file] = _named(key, file, lambda: read_gltf(scene.resolve(file)))
        return opened[file]

    changes: dict[str, Any] = {}
    if (taken := keys.targets) is not None:
        held = of("targets", taken.file)
        changes["targets"] = _named("targets", taken.file, lambda: held.targets(taken.file, taken))
    if (shone := keys.lights) is not None:
        lamps = of("lights", shone.file)
        changes["lights"] = _named("lights", shone.file, lambda: lamps.lights(shone.lighting, scene))
    if (stood := keys.pose) is not None:
        pupil = solved_camera(scene).facts.entrance_pupil_z_mm
        if not np.isfinite(pupil):
            raise SceneError(
                f'camera.pose.file = "{stood.file}": the entrance pupil lies at infinity, so no camera can be placed '
                "there; give shift_mm and tilt_deg"
            )
        place = of("camera.pose", stood.file)
        changes["camera.pose"] = _named("camera.pose", stood.file, lambda: place.pose(stood.camera, pupil))
    made = scene.changed(changes)
    for each in opened.values():
        each.report.warn()
    return made


def _named(key: str, file: str, read: Any) -> Any:
    """Return the result of `read`; its errors name the scene's key."""
    try:
        return read()
    except MeshError as error:
        raise SceneError(f'{key}.file = "{file}": {error}') from None


def _name(node: Node) -> str:
    """Return the name of a target; nodes with equal names are distinguished by number."""
    own = node.entry.get("name")
    if node.name is not None:
        return node.name
    return f"nodes[{node.number}]" + (f" {own[:60]}" if isinstance(own, str) and own[:60].isprintable() and own else "")


def _extension(entry: dict[str, Any], name: str) -> dict[str, Any]:
    held = entry.get("extensions", {})
    found = held.get(name, {}) if isinstance(held, dict) else {}
    return found if isinstance(found, dict) else {}


def _turn(where: str, linear: Array) -> Array:
    """Return the rotation of a camera node's frame, ignoring its scale (glTF 2.0, section 3.10.1)."""
    lengths = np.linalg.norm(linear, axis=0)
    if not (lengths > 0.0).all():
        raise MeshError(f"{where}: a camera whose scale is 0 has no direction")
    turn = linear / lengths
    if not np.allclose(turn.T @ turn, np.eye(3), rtol=0.0, atol=SKEW) or np.linalg.det(turn) < 0.0:
        raise MeshError(f"{where}: the camera is mirrored or skewed by the nodes above it; apply their scale")
    u, _, v = np.linalg.svd(turn)
    return np.asarray(u @ v)


SKEW = 1e-3
"""Largest cosine between a camera's axes that count as perpendicular; the nearest rotation is used."""


def _tilt_deg(turn: Array) -> tuple[float, float, float]:
    """Return a rotation as angles about the fixed axes x, then y, then z, in degrees."""
    across = float(np.hypot(turn[0, 0], turn[1, 0]))
    y = np.arctan2(-turn[2, 0], across)
    z = np.arctan2(turn[1, 0], turn[0, 0])
    # Find the rotation about x after removing z, which also works for a camera that looks along the x axis.
    about_z = np.array([-np.sin(z), np.cos(z), 0.0])
    x = np.arctan2(-about_z @ turn[:, 2], about_z @ turn[:, 1])
    return tuple(float(each) for each in np.rad2deg([x, y, z]))  # type: ignore[return-value]
