"""The node tree of a glTF file: what stands in its scene, where, and the meshes of each object.

glTF 2.0, section 3.5: nodes form a strict tree; a node's matrix, or its translation, rotation and scale, place it in
its parent. trimesh gets a copy of the document in which every primitive is a mesh of its own, named after its place in
the file and not moved: which of them an object has, and its place, are read here.
"""

import io
import json
import reprlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.regular_file import read_bytes

MOST_NODES = 100_000
"""Of one file."""

LONGEST_NAME = 100
"""Characters of a node's name by which it is called; one with a longer name has its number."""

REPEATS = 10497
WRAPS = {REPEATS: "repeat", 33071: "clamp", 33648: "mirror"}
"""Continuation of pictures outside 0..1, by glTF's numbers (glTF 2.0, section 5.27)."""
REPEAT = ("repeat", "repeat")
WRAP = "wrap"
"""Key of trimesh's metadata that holds a geometry's pair of these."""

TAKEN_EXTENSIONS = ("KHR_lights_punctual", "KHR_texture_transform")
"""That a file may require."""

FLOAT = 5126
"""Component type of an accessor of float32 (glTF 2.0, section 5.1.3)."""

TRIANGLES, STRIP = 4, 5
"""Modes of primitives that have facets and can be read (glTF 2.0, section 3.7.2.1)."""

MODES = {0: "points", 1: "lines", 2: "a line loop", 3: "a line strip", 6: "a triangle fan"}
"""Those that are not read."""


@dataclass(frozen=True)
class Node:
    """A node of a glTF file's scene.

    Attributes
    ----------
    number : int
        In the file, from 0.
    name : str or None
        Its own; None where it has none, or one that another node of the scene has, too.
    to_scene : (4, 4) float64
        From its frame to the scene's, m.
    entry : dict
        What the file says of it.
    """

    number: int
    name: str | None
    to_scene: Array
    entry: dict[str, Any]

    @property
    def key(self) -> str | int:
        """Name of the node in scene files, or its number."""
        return self.number if self.name is None else self.name

    @property
    def place(self) -> str:
        """Place in the file, with the node's name, for messages."""
        return f"nodes[{self.number}]" + (f" ({self.name})" if self.name is not None else "")


def nodes_of(path: Path, document: dict[str, Any]) -> list[Node]:
    """Return the nodes that stand in a file's scene, in the order of the file.

    Raises
    ------
    MeshError
        The tree has a loop or a node with two parents, a number names nothing, or a place is none.
    """
    entries = _list(path, document, "nodes")
    if len(entries) > MOST_NODES:
        raise MeshError(f"{path}: has {len(entries)} nodes; {MOST_NODES} are the most")
    if "scenes" not in document:
        return []
    scenes = _list(path, document, "scenes")
    scene = scenes[_number(path, "scene", document.get("scene", 0), len(scenes))]
    if not isinstance(scene.get("nodes", []), list):
        raise MeshError(f"{path}: broken: its scene's nodes are no list")
    waiting: list[tuple[int, Array]] = [
        (_number(path, "a node of its scene", child, len(entries)), np.eye(4)) for child in scene.get("nodes", [])
    ]
    found: dict[int, Array] = {}
    while waiting:
        number, parent = waiting.pop()
        if number in found:
            raise MeshError(f"{path}: broken: nodes[{number}] stands twice in its node tree, as a loop does")
        entry = entries[number]
        found[number] = parent @ _own_matrix(path, number, entry)
        waiting += [
            (_number(path, f"a child of nodes[{number}]", child, len(entries)), found[number])
            for child in entry.get("children", [])
        ]
    names = {number: _own_name(entries[number]) for number in found}
    often = Counter(names.values())
    return [
        Node(number, name if (name := names[number]) and often[name] == 1 else None, matrix, entries[number])
        for number, matrix in sorted(found.items())
    ]


def _own_name(entry: dict[str, Any]) -> str | None:
    """Return the name of a node, where it has one by which it can be called."""
    name = entry.get("name")
    return name if isinstance(name, str) and 0 < len(name) <= LONGEST_NAME and name.isprintable() else None


def node_called(path: Path, nodes: Iterable[Node], key: str | int) -> Node:
    """Return the node with a name or number.

    Parameters
    ----------
    path : Path
        The file, for messages.
    nodes : iterable of Node
    key : str or int

    Raises
    ------
    MeshError
        There is none in the file's scene.
    """
    nodes = list(nodes)
    for node in nodes:
        if key in (node.name, node.number):
            return node
    known = ", ".join(repr(node.key) for node in nodes[:10]) + (", ..." if len(nodes) > 10 else "")
    raise MeshError(f"{path}: has no node {key!r} of its own; valid are {known or 'none: its scene is empty'}")


def primitives_of(path: Path, document: dict[str, Any], node: Node) -> list[tuple[int, int]]:
    """Return mesh and number of the primitives of a node that have facets.

    Parameters
    ----------
    path : Path
        The file, for messages.
    document : dict
        Its JSON.
    node : Node

    Raises
    ------
    MeshError
        The node names a mesh that is not there.
    """
    if "mesh" not in node.entry:
        return []
    meshes = _list(path, document, "meshes")
    mesh = _number(path, f"{node.place}.mesh", node.entry["mesh"], len(meshes))
    return [
        (mesh, number)
        for number, primitive in enumerate(_list(path, meshes[mesh], "primitives"))
        if primitive.get("mode", TRIANGLES) in (TRIANGLES, STRIP)
    ]


def load_primitives(path: Path, document: dict[str, Any], wanted: Iterable[tuple[int, int]]) -> dict[Any, Any]:
    """Return trimesh's geometry of primitives, by mesh and number, with the places in the picture they are meant for.

    Parameters
    ----------
    path : Path
        The file, whose buffers and pictures are read.
    document : dict
        Its JSON.
    wanted : iterable of (int, int)
        Mesh and number of each primitive.

    Raises
    ------
    MeshError
        A place in a picture is one that cannot be taken.
    """
    import trimesh

    wanted = list(dict.fromkeys(wanted))
    meshes = [_alone(path, document, mesh, number) for mesh, number in wanted]
    left = {"nodes", "scenes", "cameras", "animations", "skins", "extensions", "extensionsUsed", "extensionsRequired"}
    flat = {key: value for key, value in document.items() if key not in left} | {
        "scene": 0,
        "scenes": [{"nodes": list(range(len(wanted)))}],
        "nodes": [{"mesh": number, "name": f"node {number}"} for number in range(len(wanted))],
        "meshes": meshes,
    }
    text = json.dumps(flat).encode()
    text += b" " * (-len(text) % 4)
    if path.suffix.lower() == ".glb":
        content = read_bytes(path)
        rest = content[20 + int.from_bytes(content[12:16], "little") :]
        length = 20 + len(text) + len(rest)
        header = b"glTF" + content[4:8] + length.to_bytes(4, "little") + len(text).to_bytes(4, "little") + b"JSON"
        text = header + text + rest
    resolver = trimesh.resolvers.FilePathResolver(path)
    scene = trimesh.load_scene(io.BytesIO(text), file_type=path.suffix.lower()[1:], resolver=resolver, process=False)
    made = {}
    for mesh, number in wanted:
        geometry = scene.geometry.get(_called(mesh, number))
        if isinstance(geometry, trimesh.Trimesh):
            base = _base_picture(document, document["meshes"][mesh]["primitives"][number])
            _place_picture(geometry, base)
            geometry.metadata[WRAP] = _wrap_of(path, document, base)
            made[mesh, number] = geometry
    return made


def _called(mesh: int, number: int) -> str:
    return f"mesh {mesh} primitive {number}"


def _alone(path: Path, document: dict[str, Any], mesh: int, number: int) -> dict[str, Any]:
    """Return a mesh of one primitive, whose places in the picture are those that its base colour asks for."""
    primitive = dict(document["meshes"][mesh]["primitives"][number])
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict):
        raise MeshError(f"{path}: broken: meshes[{mesh}].primitives[{number}] has no attributes")
    base = _base_picture(document, primitive)
    if base:
        where = f"{path}: the base colour texture of meshes[{mesh}].primitives[{number}]"
        moved = base.get("extensions", {}).get("KHR_texture_transform", {})
        if moved.get("rotation", 0.0) != 0.0:
            raise MeshError(f"{where} is turned by KHR_texture_transform; offset and scale are taken: turn its UVs")
        for key, default in (("offset", [0.0, 0.0]), ("scale", [1.0, 1.0])):
            _numbers(path, f"{key} of KHR_texture_transform", moved.get(key, default), 2)
        asked = f"TEXCOORD_{moved.get('texCoord', base.get('texCoord', 0))}"
        if asked != "TEXCOORD_0":
            if asked not in attributes:
                raise MeshError(f"{where} asks for {asked}, which the mesh does not have")
            attributes = attributes | {"TEXCOORD_0": attributes[asked]}
    _check_accessors(path, document, primitive, attributes)
    return {"name": _called(mesh, number), "primitives": [primitive | {"attributes": attributes}]}


def _check_accessors(
    path: Path, document: dict[str, Any], primitive: dict[str, Any], attributes: dict[str, Any]
) -> None:
    """Raise where a primitive's numbers are stored in a way in which trimesh takes them for others.

    It passes over `sparse`, and takes places in a picture that are `normalized` whole numbers as they stand.
    """
    accessors = _list(path, document, "accessors")
    used = {key: attributes.get(key) for key in ("POSITION", "NORMAL", "TEXCOORD_0")}
    for key, number in (used | {"indices": primitive.get("indices")}).items():
        if not isinstance(number, int) or not 0 <= number < len(accessors):
            continue
        if "sparse" in accessors[number]:
            raise MeshError(f"{path}: accessors[{number}] ({key}) is sparse, which is not read: save it in full")
        if key == "TEXCOORD_0" and accessors[number].get("componentType") != FLOAT:
            raise MeshError(
                f"{path}: accessors[{number}] ({key}) holds whole numbers; save texture coordinates as floats"
            )


def _base_picture(document: dict[str, Any], primitive: dict[str, Any]) -> dict[str, Any]:
    """Return what the file says of a primitive's base colour texture; {} where it has none."""
    try:
        base = document["materials"][primitive["material"]]["pbrMetallicRoughness"]["baseColorTexture"]
        moved = base.get("extensions", {}).get("KHR_texture_transform", {})
        return base if isinstance(moved, dict) else {}
    except (KeyError, IndexError, TypeError, AttributeError):
        return {}


def _place_picture(geometry: Any, base: dict[str, Any]) -> None:
    """Move the places in the picture of a geometry as KHR_texture_transform says: u' = offset + scale u."""
    moved = base.get("extensions", {}).get("KHR_texture_transform")
    uv = getattr(geometry.visual, "uv", None)
    if not moved or uv is None:
        return
    (left, top), (across, down) = moved.get("offset", (0.0, 0.0)), moved.get("scale", (1.0, 1.0))
    # glTF counts from the top of a picture, trimesh from its bottom.
    geometry.visual.uv = np.column_stack([left + across * uv[:, 0], 1.0 - (top + down * (1.0 - uv[:, 1]))])


def _wrap_of(path: Path, document: dict[str, Any], base: dict[str, Any]) -> tuple[str, str]:
    """Return what a base colour texture shows outside its picture, across and down."""
    textures, samplers = _list(path, document, "textures"), _list(path, document, "samplers")
    if not base:
        return REPEAT
    texture = textures[_number(path, "baseColorTexture.index", base.get("index"), len(textures))]
    if (number := texture.get("sampler")) is None:
        return REPEAT
    sampler = samplers[_number(path, "textures.sampler", number, len(samplers))]
    across, down = (sampler.get(key, REPEATS) for key in ("wrapS", "wrapT"))
    for key, mode in (("wrapS", across), ("wrapT", down)):
        if mode not in WRAPS:
            shown = reprlib.repr(mode)[:LONGEST_NAME]
            raise MeshError(
                f"{path}: broken: samplers[{number}].{key} is {shown}; valid are {', '.join(map(str, WRAPS))}"
            )
    return WRAPS[across], WRAPS[down]


def not_read(path: Path, document: dict[str, Any], node: Node) -> Iterator[str]:
    """Yield what of a node's mesh has no facets, or facets that cannot be read.

    Parameters
    ----------
    path : Path
        The file, for messages.
    document : dict
        Its JSON.
    node : Node
    """
    if "mesh" in node.entry:
        mesh = document["meshes"][node.entry["mesh"]]
        for number, primitive in enumerate(_list(path, mesh, "primitives")):
            if (mode := primitive.get("mode", TRIANGLES)) not in (TRIANGLES, STRIP):
                yield f"primitive {number} is {MODES.get(mode, f'of mode {mode!r}')}"


def check_document(path: Path, document: dict[str, Any]) -> None:
    """Raise if a part of the document is of another kind than glTF's, or an extension is required that goes unread.

    Raises
    ------
    MeshError
        Naming the part.
    """
    for key in _LISTS_OF_OBJECTS:
        _list(path, document, key)
    waiting: list[tuple[str, Any]] = [("", document)]
    while waiting:
        where, value = waiting.pop()
        if isinstance(value, list):
            waiting += [(f"{where}[{number}]", item) for number, item in enumerate(value)]
        elif isinstance(value, dict):
            for key, item in value.items():
                place = f"{where}.{key}" if where else key
                if key in _KINDS and not isinstance(item, _KINDS[key]):
                    kind = {dict: "an object", list: "a list", int: "a whole number"}[_KINDS[key]]
                    shown = reprlib.repr(item)[:LONGEST_NAME]
                    raise MeshError(f"{path}: broken: {place[-LONGEST_NAME:]} is {shown}; valid is {kind}")
                if key != "extras":
                    inside = item.values() if key == "extensions" else ()
                    if any(not isinstance(each, dict) for each in inside):
                        raise MeshError(f"{path}: broken: {place[-LONGEST_NAME:]} holds one that is no object")
                    waiting.append((place, item))
    for name in document.get("extensionsRequired", []):
        if name not in TAKEN_EXTENSIONS:
            raise MeshError(
                f"{path}: requires the extension {str(name)[:LONGEST_NAME]!r}, which is not read; valid are "
                f"{', '.join(TAKEN_EXTENSIONS)}: export without it"
            )


_LISTS_OF_OBJECTS = (
    "nodes",
    "scenes",
    "meshes",
    "materials",
    "accessors",
    "bufferViews",
    "buffers",
    "images",
    "textures",
    "samplers",
)

_KINDS: dict[str, type] = {
    "extensions": dict,
    "pbrMetallicRoughness": dict,
    "baseColorTexture": dict,
    "attributes": dict,
    "primitives": list,
    "children": list,
    "extensionsRequired": list,
    "mode": int,
    "texCoord": int,
}
"""Of the values of keys, wherever they stand."""


def _own_matrix(path: Path, number: int, entry: dict[str, Any]) -> Array:
    """Return the (4, 4) matrix from a node's frame to its parent's."""
    where = f"nodes[{number}]"
    if "matrix" in entry:
        matrix = _numbers(path, f"{where}.matrix", entry["matrix"], 16).reshape(4, 4).T
        if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise MeshError(f"{path}: {where}.matrix is no affine one: its last row must be 0, 0, 0, 1")
        return matrix
    made = np.eye(4)
    made[:3, 3] = _numbers(path, f"{where}.translation", entry.get("translation", [0.0] * 3), 3)
    turn = _numbers(path, f"{where}.rotation", entry.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4)
    if not (length := float(np.linalg.norm(turn))):
        raise MeshError(f"{path}: {where}.rotation is zero; valid is a unit quaternion x, y, z, w")
    x, y, z, w = turn / length
    turned = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    made[:3, :3] = np.array(turned) * _numbers(path, f"{where}.scale", entry.get("scale", [1.0] * 3), 3)
    return made


def _numbers(path: Path, where: str, values: Any, count: int) -> Array:
    fine = isinstance(values, list | tuple) and len(values) == count
    if fine and all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= 1e15 for v in values):
        return np.array(values, dtype=np.float64)
    raise MeshError(f"{path}: {where} is {repr(values)[:LONGEST_NAME]}; valid are {count} finite numbers")


def _number(path: Path, where: str, value: Any, count: int) -> int:
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count:
        return value
    raise MeshError(f"{path}: broken: {where} is {repr(value)[:LONGEST_NAME]}, and there are {count}, counted from 0")


def _list(path: Path, holder: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Return a list of objects of the document; empty where it has none."""
    entries = holder.get(key, [])
    if isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries):
        return entries
    raise MeshError(f"{path}: broken: {key} is no list of objects")
