"""The node tree of a glTF file: the nodes of its scene, their transforms, and the meshes of each.

glTF 2.0, section 3.5: nodes form a strict tree. A node's matrix, or its translation, rotation and scale, places it in
its parent. `gltf_primitives` reads the facets.
"""

import reprlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.meshes.mesh import Array

MOST_NODES = 100_000
"""Most nodes in a file."""

LONGEST_NAME = 100
"""Most characters of a node's name; nodes with a longer one are known by number."""

TAKEN_EXTENSIONS = ("KHR_lights_punctual", "KHR_texture_transform", "KHR_mesh_quantization")
"""Extensions that a file may require."""

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives with facets (glTF 2.0, section 3.7.2.1)."""

MODES = {0: "points", 1: "lines", 2: "a line loop", 3: "a line strip"}
"""Modes of primitives without facets."""


@dataclass(frozen=True)
class Node:
    """A node of a glTF file's scene.

    Attributes
    ----------
    number : int
        Number in the file, from 0.
    name : str or None
        None if it has none, or shares it with another node of the scene.
    to_scene : (4, 4) float64
        Transform from its frame to the scene's, m.
    entry : dict
        JSON of the node.
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
        """Place in the file with the node's name, for messages."""
        return f"nodes[{self.number}]" + (f" ({self.name})" if self.name is not None else "")


def nodes_of(path: Path, document: dict[str, Any]) -> list[Node]:
    """Return the nodes of a file's scene, in file order.

    Raises
    ------
    MeshError
        The tree has a loop or a node with two parents, a number is out of range, or a transform is invalid.
    """
    entries = entries_of(path, document, "nodes")
    if len(entries) > MOST_NODES:
        raise MeshError(f"{path}: has {len(entries)} nodes; the limit is {MOST_NODES}")
    if "scenes" not in document:
        return []
    scenes = entries_of(path, document, "scenes")
    scene = scenes[number_below(path, "scene", document.get("scene", 0), len(scenes))]
    if not isinstance(scene.get("nodes", []), list):
        raise MeshError(f"{path}: broken: its scene's nodes are not a list")
    waiting: list[tuple[int, Array]] = [
        (number_below(path, "a node of its scene", child, len(entries)), np.eye(4)) for child in scene.get("nodes", [])
    ]
    found: dict[int, Array] = {}
    while waiting:
        number, parent = waiting.pop()
        if number in found:
            raise MeshError(f"{path}: broken: nodes[{number}] occurs twice in its node tree, as in a loop")
        entry = entries[number]
        found[number] = parent @ _own_matrix(path, number, entry)
        waiting += [
            (number_below(path, f"a child of nodes[{number}]", child, len(entries)), found[number])
            for child in entry.get("children", [])
        ]
    names = {number: _own_name(entries[number]) for number in found}
    often = Counter(names.values())
    return [
        Node(number, name if (name := names[number]) and often[name] == 1 else None, matrix, entries[number])
        for number, matrix in sorted(found.items())
    ]


def _own_name(entry: dict[str, Any]) -> str | None:
    """Return the name of a node if it is usable as a key."""
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
    meshes = entries_of(path, document, "meshes")
    mesh = number_below(path, f"{node.place}.mesh", node.entry["mesh"], len(meshes))
    return [
        (mesh, number)
        for number, primitive in enumerate(entries_of(path, meshes[mesh], "primitives"))
        if primitive.get("mode", TRIANGLES) in (TRIANGLES, STRIP, FAN)
    ]


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
        for number, primitive in enumerate(entries_of(path, mesh, "primitives")):
            if (mode := primitive.get("mode", TRIANGLES)) not in (TRIANGLES, STRIP, FAN):
                yield f"primitive {number} is {MODES.get(mode, f'of mode {mode!r}')}"


def check_document(path: Path, document: dict[str, Any]) -> None:
    """Raise if the document has another version, a part of the wrong type, or requires an unsupported extension.

    Raises
    ------
    MeshError
        The message names the part.
    """
    asset = document.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if isinstance(version, str) and version.partition(".")[0] in ("0", "1"):
        raise MeshError(f"{path}: is glTF of version {version[:LONGEST_NAME]}; valid is 2: export it as glTF 2.0")
    for key in _LISTS_OF_OBJECTS:
        entries_of(path, document, key)
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
                if key == "extensions":
                    if any(not isinstance(each, dict) for each in item.values()):
                        raise MeshError(f"{path}: broken: {place[-LONGEST_NAME:]} holds an entry that is not an object")
                    # Other extensions define their own keys.
                    item = {name: each for name, each in item.items() if name in TAKEN_EXTENSIONS}
                if key != "extras":
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
"""Types of the values of keys, wherever they occur."""


def _own_matrix(path: Path, number: int, entry: dict[str, Any]) -> Array:
    """Return the matrix (4, 4) from a node's frame to its parent's."""
    where = f"nodes[{number}]"
    if "matrix" in entry:
        matrix = finite_numbers(path, f"{where}.matrix", entry["matrix"], 16).reshape(4, 4).T
        if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise MeshError(f"{path}: {where}.matrix is not affine: its last row must be 0, 0, 0, 1")
        return matrix
    made = np.eye(4)
    made[:3, 3] = finite_numbers(path, f"{where}.translation", entry.get("translation", [0.0] * 3), 3)
    turn = finite_numbers(path, f"{where}.rotation", entry.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4)
    if not (length := float(np.linalg.norm(turn))):
        raise MeshError(f"{path}: {where}.rotation is zero; valid is a unit quaternion x, y, z, w")
    x, y, z, w = turn / length
    turned = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    made[:3, :3] = np.array(turned) * finite_numbers(path, f"{where}.scale", entry.get("scale", [1.0] * 3), 3)
    return made


def finite_numbers(path: Path, where: str, values: Any, count: int) -> Array:
    """Return numbers of the document.

    Parameters
    ----------
    path : Path
        The file, for messages.
    where : str
        Their place in it.
    values : list
    count : int
        How many there must be.

    Raises
    ------
    MeshError
        They are none.
    """
    fine = isinstance(values, list | tuple) and len(values) == count
    if fine and all(isinstance(v, int | float) and not isinstance(v, bool) and abs(v) <= 1e15 for v in values):
        return np.array(values, dtype=np.float64)
    raise MeshError(f"{path}: {where} is {repr(values)[:LONGEST_NAME]}; valid are {count} finite numbers")


def number_below(path: Path, where: str, value: Any, count: int) -> int:
    """Return the number of an entry of a list.

    Parameters
    ----------
    path : Path
        The file, for messages.
    where : str
        The number's place in it.
    value : int
    count : int
        Entries of the list.

    Raises
    ------
    MeshError
        There is no such entry.
    """
    if isinstance(value, int) and not isinstance(value, bool) and 0 <= value < count:
        return value
    raise MeshError(f"{path}: broken: {where} is {repr(value)[:LONGEST_NAME]}, but there are {count}, counted from 0")


def entries_of(path: Path, holder: dict[str, Any], key: str) -> list[dict[str, Any]]:
    """Return a list of objects of the document; empty where it has none.

    Parameters
    ----------
    path : Path
        The file, for messages.
    holder : dict
        A part of its JSON.
    key : str

    Raises
    ------
    MeshError
        It is no list of objects.
    """
    entries = holder.get(key, [])
    if isinstance(entries, list) and set(map(type, entries)) <= {dict}:
        return entries
    raise MeshError(f"{path}: broken: {key} is not a list of objects")
