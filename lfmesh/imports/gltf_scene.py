"""Scenes as glTF files, such as Blender's exporter writes: objects as targets, lights, and the place of a camera.

glTF's axes are those of the world (right-handed, y up, cameras look along -z); its metres become mm. The meshes stay in
their file: each object becomes a target that names its node, and is loaded when the scene is built.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import MeshError, SceneError
from lfmesh.geometry.files.gltf_left_out import left_out, left_out_of_scene
from lfmesh.geometry.files.gltf_nodes import Node, node_called, nodes_of, not_read, primitives_of
from lfmesh.geometry.files.mesh_file import MM_PER_UNIT, gltf_document
from lfmesh.geometry.lens.solved_camera import solved_camera
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.imports.gltf_lights import light_of
from lfmesh.imports.report import Report, Verdict
from lfmesh.scene import Pose, Scene, Target
from lfmesh.scene.light.lights import Light
from lfmesh.scene.objects.gltf_keys import GltfKeys

MOST_OBJECTS = 10_000
"""Of one file: each is a target with a mesh of its own."""

MOST_FACETS = 200_000_000
"""Of all objects of one file together, instances counted: their meshes would take some 30 GB."""


@dataclass(frozen=True)
class GltfScene:
    """A glTF file's tree, and what became of each part of it that was asked for.

    Attributes
    ----------
    path : Path
    document : dict
        The file's JSON.
    nodes : list of Node
        Those of its scene.
    report : Report
        One entry a part of the file, entered when the targets, the lights or the pose are asked for.
    """

    path: Path
    document: dict[str, Any]
    nodes: list[Node]
    report: Report

    def targets(self, file: str) -> tuple[Target, ...]:
        """Return one target for every node with a mesh.

        Parameters
        ----------
        file : str
            What the targets call the file.

        Raises
        ------
        MeshError
            The file has no objects, more than fit, or a broken one.
        """
        self._whole_file()
        placed = []
        facets = 0
        for node in self.nodes:
            parts = primitives_of(self.path, self.document, node)
            for what in not_read(self.path, self.document, node):
                self._enter(node.place, Verdict.APPROXIMATED, f"{what}, without facets that can be read; left out")
            if not parts:
                continue
            facets += sum(self._facets(*part) for part in parts)
            for what in left_out(self.document, node, parts):
                self._enter(node.place, Verdict.APPROXIMATED, what)
            self._enter(node.place, Verdict.TAKEN, "a target")
            placed.append(Target(name=_name(node), file=file, node=node.key))
        if not placed:
            raise MeshError(f"{self.path}: holds no object with facets in its scene")
        if len(placed) > MOST_OBJECTS or facets > MOST_FACETS:
            raise MeshError(
                f"{self.path}: holds {len(placed)} objects with {facets} facets; {MOST_OBJECTS} objects and "
                f"{MOST_FACETS} facets are the most"
            )
        return tuple(placed)

    def lights(self, lighting: str, scene: Scene) -> tuple[Light, ...]:
        """Return its punctual lights.

        Parameters
        ----------
        lighting : str
            What the intensities are; see `scene.gltf_keys.GltfLights`.
        scene : Scene
            Whose wavelengths or bands say how a coloured light's power is spread.

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
                        f"{self.path}: broken: {node.place} names light {repr(number)[:60]}, which is not there"
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
        """Return the pose that puts a camera's entrance pupil where one of the file stands.

        Parameters
        ----------
        camera : str or int, optional
            Its node; may be left out where there is one.
        pupil_z_mm : float
            Where the entrance pupil lies, from the first vertex towards the sensor.

        Raises
        ------
        MeshError
            The file has no such camera, or several and none is named, or it cannot tell which way it looks.
        """
        cameras = [node for node in self.nodes if "camera" in node.entry]
        if not cameras:
            raise MeshError(f"{self.path}: holds no camera in its scene; export cameras, or leave the key out")
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
        """Enter what the file holds beside its nodes and is not taken."""
        for key, why in (
            ("animations", "objects stand where their nodes are without them"),
            ("skins", "meshes with bones stand in the shape that they were made in"),
        ):
            if self.document.get(key):
                self._enter(key, Verdict.APPROXIMATED, f"left out; {why}")
        for place, words in left_out_of_scene(self.document, self.nodes):
            self._enter(place, Verdict.APPROXIMATED, words)

    def _facets(self, mesh: int, number: int) -> int:
        """Return how many facets a primitive has, by what the file says of it."""
        primitive = self.document["meshes"][mesh]["primitives"][number]
        accessors = self.document.get("accessors", [])
        try:
            which = primitive.get("indices", primitive["attributes"]["POSITION"])
            return int(accessors[which]["count"]) // 3
        except (KeyError, IndexError, TypeError, ValueError):
            raise MeshError(f"{self.path}: broken: meshes[{mesh}].primitives[{number}] names no vertices") from None


def read_gltf(path: str | Path) -> GltfScene:
    """Read the tree of a GLB or glTF file; its meshes are not loaded.

    Raises
    ------
    MeshError
        The file cannot be read, is broken, or requires what is not read.
    """
    path = Path(path)
    try:
        document = gltf_document(path)
    except OSError as error:
        raise MeshError(f"{path}: cannot be read: {error.strerror}") from None
    return GltfScene(path, document, nodes_of(path, document), Report(path))


def with_gltf(scene: Scene, keys: GltfKeys) -> Scene:
    """Return a scene with the targets, lights and camera's place of glTF files in place of its own.

    Warns of what is not exactly the file's, in one LensFileWarning a file.

    Parameters
    ----------
    scene : Scene
    keys : GltfKeys
        What is taken, and from which file, relative to the scene's folder.

    Raises
    ------
    LfmeshError
        A file cannot be read, or has not what is asked for.
    """
    opened: dict[str, GltfScene] = {}

    def of(key: str, file: str) -> GltfScene:
        if file not in opened:
            opened[file] = _named(key, file, lambda: read_gltf(scene.resolve(file)))
        return opened[file]

    changes: dict[str, Any] = {}
    if (taken := keys.targets) is not None:
        held = of("targets", taken.file)
        changes["targets"] = _named("targets", taken.file, lambda: held.targets(taken.file))
    if (shone := keys.lights) is not None:
        lamps = of("lights", shone.file)
        changes["lights"] = _named("lights", shone.file, lambda: lamps.lights(shone.lighting, scene))
    if (stood := keys.pose) is not None:
        pupil = solved_camera(scene).facts.entrance_pupil_z_mm
        if not np.isfinite(pupil):
            raise SceneError(
                f'camera.pose.file = "{stood.file}": the entrance pupil lies at infinity, so that no camera can stand '
                "in it; give shift_mm and tilt_deg"
            )
        place = of("camera.pose", stood.file)
        changes["camera.pose"] = _named("camera.pose", stood.file, lambda: place.pose(stood.camera, pupil))
    made = scene.changed(changes)
    for each in opened.values():
        each.report.warn()
    return made


def _named(key: str, file: str, read: Any) -> Any:
    """Return what `read` does; its error names the key of the scene."""
    try:
        return read()
    except MeshError as error:
        raise SceneError(f'{key}.file = "{file}": {error}') from None


def _name(node: Node) -> str:
    """Return what a target is called: a name that two nodes have is told apart by their numbers."""
    own = node.entry.get("name")
    if node.name is not None:
        return node.name
    return f"nodes[{node.number}]" + (f" {own[:60]}" if isinstance(own, str) and own[:60].isprintable() and own else "")


def _extension(entry: dict[str, Any], name: str) -> dict[str, Any]:
    held = entry.get("extensions", {})
    found = held.get(name, {}) if isinstance(held, dict) else {}
    return found if isinstance(found, dict) else {}


def _turn(where: str, linear: Array) -> Array:
    """Return the rotation of a node's frame, whose scale does not count for a camera (glTF 2.0, section 3.10.1)."""
    lengths = np.linalg.norm(linear, axis=0)
    if not (lengths > 0.0).all():
        raise MeshError(f"{where}: a camera whose scale is 0 looks nowhere")
    turn = linear / lengths
    if not np.allclose(turn.T @ turn, np.eye(3), rtol=0.0, atol=SKEW) or np.linalg.det(turn) < 0.0:
        raise MeshError(f"{where}: the camera is mirrored or skewed by the nodes above it; apply their scale")
    u, _, v = np.linalg.svd(turn)
    return np.asarray(u @ v)


SKEW = 1e-3
"""Cosine between the axes of a camera up to which they count as square: the nearest rotation is taken."""


def _tilt_deg(turn: Array) -> tuple[float, float, float]:
    """Return the rotations about x, then y, then z (fixed axes), in degrees, that make a rotation."""
    across = float(np.hypot(turn[0, 0], turn[1, 0]))
    y = np.arctan2(-turn[2, 0], across)
    z = np.arctan2(turn[1, 0], turn[0, 0])
    # What is left about x; with z taken off first, this holds where the camera looks along the x axis, too.
    about_z = np.array([-np.sin(z), np.cos(z), 0.0])
    x = np.arctan2(-about_z @ turn[:, 2], about_z @ turn[:, 1])
    return tuple(float(each) for each in np.rad2deg([x, y, z]))  # type: ignore[return-value]
