"""Contents of a mesh file, counted without its reader: facets, materials, pictures and coloured facets.

The counts come straight from the file, by code that shares nothing with the readers. They expose a reader that skips
part of a file.
"""

import json
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfmesh.geometry.files.piece import Piece
from lfmesh.regular_file import read_bytes, read_text, without_mark


@dataclass(frozen=True)
class Contents:
    """Counts of a mesh file.

    Attributes
    ----------
    facets : int
        Triangles in the file's scene, once per instance; polygons count as the triangles that they are cut into.
    materials : int
        Named materials that facets use.
    pictures : int
        Pictures of these materials: base colour, and metallic and roughness.
    coloured : int
        Facets with their own or their vertices' colours.
    """

    facets: int
    materials: int = 0
    pictures: int = 0
    coloured: int = 0

    def __str__(self) -> str:
        return (
            f"{self.facets} facets, {self.materials} materials, {self.pictures} pictures, "
            f"{self.coloured} facets with vertex colours"
        )


def held(pieces: Iterable[Piece]) -> Contents:
    """Return the counts of the pieces read."""
    pieces = list(pieces)
    return Contents(
        sum(len(piece.mesh.faces) for piece in pieces),
        len({piece.called for piece in pieces if piece.called}),
        len({id(piece.picture) for piece in pieces if piece.picture is not None})
        + len({id(piece.gloss.picture) for piece in pieces if piece.gloss is not None}),
        sum(len(piece.mesh.faces) for piece in pieces if piece.colours is not None),
    )


def counted(path: Path, node: str | int | None = None) -> Contents | None:
    """Return the counts of a readable file; None for formats with facets that are not, or not only, in the file.

    Parameters
    ----------
    path : Path
    node : str or int, optional
        The requested part; only whole files are counted.
    """
    of = _BY_ENDING.get(path.suffix.lower())
    if of is None or node is not None:
        return None
    try:
        return of(path)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, OSError, RecursionError, struct.error):
        return None


def _of_obj(path: Path) -> Contents:
    facets = coloured = 0
    used: dict[str, int] = {}
    colours = False
    name = ""
    libraries: list[str] = []
    for line in read_text(path, errors="replace").replace("\\\n", " ").splitlines():
        words = line.split("#")[0].split()
        if not words:
            continue
        if words[0] == "usemtl":
            name = line.split(None, 1)[1].strip() if len(words) > 1 else ""
        elif words[0] == "mtllib":
            libraries.append(line.split(None, 1)[1].strip())
        elif words[0] == "f":
            used[name] = used.get(name, 0) + max(0, len(words) - 3)
        elif words[0] == "v" and len(words) >= 7:
            colours = True
    facets = sum(used.values())
    coloured = facets if colours else 0
    defined: dict[str, str] = {}
    for library in libraries:
        _materials(path, library, defined)
    known = [
        each for each, count in used.items() if count and (each in defined or each.split("#")[0].strip() in defined)
    ]
    pictures = {defined.get(each, defined.get(each.split("#")[0].strip(), "")) for each in known} - {""}
    return Contents(facets, len(known), len(pictures), coloured)


def _materials(path: Path, library: str, defined: dict[str, str]) -> None:
    """Add the materials of the files in an mtllib line, each with the last word of its map_Kd line."""
    for name in (library, library.split("#")[0].strip(), *library.split()):
        file = path.parent / name.replace("\\", "/")
        if not file.is_file():
            continue
        called = ""
        for line in read_text(file, errors="replace").splitlines():
            words = line.split()
            if words[:1] == ["newmtl"] and len(words) > 1:
                called = line.split(None, 1)[1].split("#")[0].strip()
                defined.setdefault(called, "")
            elif words and words[0].lower() == "map_kd" and called and len(words) > 1 and not defined[called]:
                defined[called] = words[-1]
        if name == library:
            return


def _of_stl(path: Path) -> Contents:
    content = read_bytes(path)
    if without_mark(content).lstrip()[:5].lower() == b"solid" and b"endfacet" in content.lower():
        return Contents(content.lower().count(b"endfacet"))
    return Contents(int.from_bytes(content[80:84], "little"))


def _of_off(path: Path) -> Contents:
    lines = [line.split("#")[0].split() for line in read_text(path, errors="replace").splitlines()]
    lines = [words for words in lines if words]
    first, _, rest = lines[0][0].upper().partition("OFF")
    numbers = [*([rest] if rest else []), *lines[0][1:]]
    lines = lines[1:]
    if not numbers:
        numbers, lines = lines[0], lines[1:]
    vertices, facets = int(numbers[0]), int(numbers[1])
    rows = lines[vertices : vertices + facets]
    if len(rows) != facets:
        raise ValueError
    count = sum(max(0, int(row[0]) - 2) for row in rows)
    coloured = sum(max(0, int(row[0]) - 2) for row in rows if len(row) - int(row[0]) > 3)
    return Contents(count, coloured=count if "C" in first or coloured else 0)


_SIZES = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d"}
_SIZES |= {
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}


def _of_ply(path: Path) -> Contents | None:
    content = without_mark(read_bytes(path))
    head, _, body = content.partition(b"end_header")
    body = body[body.index(b"\n") + 1 :]
    elements: list[tuple[str, int, list[list[str]]]] = []
    text = order = ""
    for words in (line.split() for line in head.decode("latin-1").splitlines()):
        if words[:1] == ["format"]:
            text = words[1]
            order = ">" if "big" in text else "<"
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    facets = 0
    rows = _ascii_rows(body, elements) if text == "ascii" else _binary_rows(body, elements, order)
    for name, counts in rows:
        if name == "face":
            facets += sum(max(0, count - 2) for count in counts)
        elif name == "tristrips":
            # Strips restart at markers among the indices, which only a reader examines.
            return None
    coloured = any("red" in kind or "diffuse_red" in kind for _, _, kinds in elements for kind in kinds)
    return Contents(facets, 0, 1 if b"TextureFile" in head else 0, facets if coloured else 0)


def _ascii_rows(body: bytes, elements: list[Any]) -> Iterator[tuple[str, list[int]]]:
    lines = [line for line in body.splitlines() if line.strip() and not line.startswith(b"comment")]
    at = 0
    for name, count, kinds in elements:
        yield name, [_ascii_count(line.split(), kinds) for line in lines[at : at + count]] if name == "face" else []
        at += count


def _ascii_count(words: list[bytes], kinds: list[list[str]]) -> int:
    at = 0
    for kind in kinds:
        if kind[0] != "list":
            at += 1
            continue
        if kind[-1].startswith("vertex_ind"):
            return int(words[at])
        at += 1 + int(words[at])
    return 0


def _binary_rows(body: bytes, elements: list[Any], order: str) -> Iterator[tuple[str, list[int]]]:
    at = 0
    for name, count, kinds in elements:
        if all(kind[0] != "list" for kind in kinds):
            at += count * sum(struct.calcsize("<" + _SIZES[kind[0]]) for kind in kinds)
            yield name, []
            continue
        counts = []
        for _ in range(count):
            for kind in kinds:
                if kind[0] != "list":
                    at += struct.calcsize("<" + _SIZES[kind[0]])
                    continue
                (number,) = struct.unpack_from(order + _SIZES[kind[1]], body, at)
                at += struct.calcsize("<" + _SIZES[kind[1]]) + number * struct.calcsize("<" + _SIZES[kind[2]])
                if kind[-1].startswith("vertex_ind"):
                    counts.append(number)
        yield name, counts


def _of_gltf(path: Path) -> Contents:
    content = read_bytes(path)
    if path.suffix.lower() == ".glb":
        content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
    document = json.loads(content)
    waiting = list(document["scenes"][document.get("scene", 0)].get("nodes", []))
    facets = coloured = 0
    used: set[int] = set()
    pictures: set[tuple[str, int]] = set()
    while waiting:
        node = document["nodes"][waiting.pop()]
        waiting += node.get("children", [])
        for primitive in document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []:
            attributes = primitive["attributes"]
            corners = document["accessors"][primitive.get("indices", attributes["POSITION"])]["count"]
            mode = primitive.get("mode", 4)
            own = corners // 3 if mode == 4 else max(0, corners - 2) if mode in (5, 6) else 0
            facets += own
            coloured += own if "COLOR_0" in attributes else 0
            if own and "material" in primitive:
                used.add(primitive["material"])
    for number in used:
        material = document["materials"][number]
        pbr = material.get("pbrMetallicRoughness", {})
        for use in {"baseColorTexture", "metallicRoughnessTexture"} & set(pbr):
            pictures.add((use, document["textures"][pbr[use]["index"]].get("source", -1)))
    return Contents(facets, len(used), len(pictures), coloured)


_BY_ENDING = {
    ".obj": _of_obj,
    ".stl": _of_stl,
    ".off": _of_off,
    ".ply": _of_ply,
    ".glb": _of_gltf,
    ".gltf": _of_gltf,
}
