"""GLB files written by hand, straight from the glTF 2.0 specification."""

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass
class Glb:
    """A glTF document that is filled piece by piece; what is missing here can be put into `tree`."""

    tree: dict[str, Any] = field(
        default_factory=lambda: {
            "asset": {"version": "2.0", "generator": "by hand"},
            "scene": 0,
            "scenes": [{"nodes": []}],
            "nodes": [],
        }
    )
    data: bytes = b""

    def add(self, key: str, entry: dict[str, Any]) -> int:
        """Put an entry into one of the document's lists; return its number."""
        self.tree.setdefault(key, []).append(entry)
        return len(self.tree[key]) - 1

    def view(self, content: bytes) -> int:
        """Put bytes into the buffer; return the number of their view."""
        entry = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(content)}
        self.data += content + b"\0" * (-len(content) % 4)
        return self.add("bufferViews", entry)

    def table(self, values: ArrayLike, kind: str) -> int:
        """Put numbers into the buffer; return the number of their accessor."""
        values = np.asarray(values)
        whole = kind == "SCALAR"
        view = self.view(values.astype("<u2" if whole else "<f4").tobytes())
        entry = {"bufferView": view, "componentType": 5123 if whole else 5126, "count": len(values), "type": kind}
        if kind == "VEC3":
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self.add("accessors", entry)

    def primitive(self, corners: ArrayLike, faces: ArrayLike, material: int | None = None, **attributes: Any) -> dict:
        """Return a primitive of triangles; `attributes` are tables of two columns, such as TEXCOORD_0, by name."""
        made: dict[str, Any] = {
            "attributes": {"POSITION": self.table(corners, "VEC3")}
            | {name: self.table(values, "VEC2") for name, values in attributes.items()},
            "indices": self.table(np.ravel(faces), "SCALAR"),
        }
        return made if material is None else made | {"material": material}

    def material(self, colour: ArrayLike = (1.0, 1.0, 1.0), picture: bytes | None = None, **more: Any) -> int:
        """Put a matt material of a colour in; return its number."""
        pbr: dict[str, Any] = {
            "baseColorFactor": [*map(float, np.asarray(colour)), 1.0],
            "metallicFactor": 0.0,
            "roughnessFactor": 1.0,
        }
        if picture is not None:
            image = self.add("images", {"bufferView": self.view(picture), "mimeType": "image/png"})
            pbr["baseColorTexture"] = {"index": self.add("textures", {"source": image})}
        return self.add("materials", {"pbrMetallicRoughness": pbr} | more)

    def node(self, name: str | None = None, parent: int | None = None, **entry: Any) -> int:
        """Put a node in, below another or in the scene itself; return its number."""
        number = self.add("nodes", ({} if name is None else {"name": name}) | entry)
        if parent is None:
            self.tree["scenes"][0]["nodes"].append(number)
        else:
            self.tree["nodes"][parent].setdefault("children", []).append(number)
        return number

    def light(self, name: str, entry: dict[str, Any], parent: int | None = None, **placed: Any) -> int:
        """Put a node with a light in; return its number."""
        held = self.tree.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {"lights": []})["lights"]
        held.append(entry)
        self.tree["extensionsUsed"] = ["KHR_lights_punctual"]
        which = {"KHR_lights_punctual": {"light": len(held) - 1}}
        return self.node(name, parent, extensions=which, **placed)

    def bytes(self) -> bytes:
        """Return the file."""
        tree = self.tree | ({"buffers": [{"byteLength": len(self.data)}]} if self.data else {})
        words = json.dumps(tree).encode()
        words += b" " * (-len(words) % 4)
        chunks = struct.pack("<I4s", len(words), b"JSON") + words
        if self.data:
            chunks += struct.pack("<I4s", len(self.data), b"BIN\0") + self.data
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def write(self, path: Path) -> Path:
        """Write the file."""
        path.write_bytes(self.bytes())
        return path


QUAD = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
"""A square of 1 m that faces +z: bottom left, bottom right, top right, top left."""
SPLIT = np.array([[0, 1, 2], [0, 2, 3]])
QUAD_UV = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
"""glTF counts from the top left of a picture."""


def turn(axis: ArrayLike, degrees: float) -> list[float]:
    """Return the quaternion x, y, z, w of a turn about an axis."""
    half = 0.5 * np.deg2rad(degrees)
    along = np.asarray(axis, float) / np.linalg.norm(axis)
    return [*(np.sin(half) * along).tolist(), float(np.cos(half))]
