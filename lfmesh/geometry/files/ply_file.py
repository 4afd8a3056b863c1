"""PLY files, text and binary: polygons and triangle strips, with the properties of vertices and facets.

The reader follows "The PLY Polygon File Format" (Turk, 1994) and the property names that programs have adopted since.
"""

import re
import struct
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfmesh.geometry.files.off_file import check_corners
from lfmesh.geometry.files.pictures import Pictures
from lfmesh.geometry.files.piece import Notes, Piece
from lfmesh.geometry.files.polygons import cut
from lfmesh.geometry.files.text_numbers import numbers
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh
from lfmesh.regular_file import read_bytes, without_mark
from lfmesh.scene.inputs import STAMPED_FILES, file_stamp

KINDS = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip

FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

CORNERS = ("vertex_indices", "vertex_index")
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
PLACES = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
PLACES_OF_FACETS = "texcoord"
NORMAL = ("nx", "ny", "nz")
ALPHAS = ("alpha", "a", "diffuse_alpha")
"""Names of properties that belong together."""

MOST_ENTRIES = 2**31
"""Most rows of an element, and most numbers in a list."""

_END = re.compile(rb"^end_header[ \t]*\r?\n|^end_header[ \t]*\r", re.MULTILINE)


@dataclass
class Element:
    """An element of a PLY file: its rows, and its properties, each with one number type, or two for a list."""

    name: str
    count: int
    properties: dict[str, tuple[str, ...]]


@dataclass
class Rows:
    """Numbers of an element: (n,) per plain property; per list property, all numbers and the length of each row."""

    plain: dict[str, Array]
    lists: dict[str, tuple[Array, Index]]

    @property
    def count(self) -> int:
        """Number of rows."""
        return next((len(each) for each in (*self.plain.values(), *(counts for _, counts in self.lists.values()))), 0)

    @staticmethod
    def empty(kinds: dict[str, tuple[np.dtype, ...]]) -> "Rows":
        """Return the numbers of an element without rows."""
        none = np.zeros(0)
        return Rows(
            {key: none for key, kind in kinds.items() if len(kind) == 1},
            {key: (none, np.zeros(0, np.int64)) for key, kind in kinds.items() if len(kind) == 2},
        )


def read(path: Path, alpha: bool, notes: Notes) -> list[Piece]:
    """Return the facets of a PLY file in its own unit, as one piece.

    Parameters
    ----------
    path : Path
    alpha : bool
        Read the alpha of its colours and its picture, too.
    notes : Notes

    Raises
    ------
    ValueError
        The file is broken.
    """
    content = without_mark(read_bytes(path))
    if not content.startswith(b"ply"):
        raise ValueError("it does not begin with the word ply")
    if (end := _END.search(content)) is None:
        raise ValueError("its header has no end")
    order, elements, pictures = _header(content[: end.start()].decode("latin-1"))
    body = _body(content, end.end(), order)
    rows: dict[str, Rows] = {}
    for element in elements:
        rows[element.name], body.at = body.rows(element)
    if order == "" and body.at != len(body.raw):
        # Some programs write rows longer than the header says; line breaks then separate the rows.
        notes.add("its rows have more numbers than its header names: the excess is left out")
        body = _Body(numbers(_cut_to_header(content[end.end() :], elements)).view(np.uint8), "", 0)
        for element in elements:
            rows[element.name], body.at = body.rows(element)
    if "vertex" not in rows or not {"x", "y", "z"} <= set(rows["vertex"].plain):
        raise ValueError("its vertices have no x, y and z")
    plain = rows["vertex"].plain
    vertices = np.column_stack([plain[key] for key in "xyz"]).astype(np.float64)
    made = _piece(vertices, rows, alpha, {element.name: element for element in elements}, notes)
    if made is None:
        return []
    if pictures:
        notes.count(len(pictures) - 1, "{} of its pictures are left out")
        if made.uv is None:
            notes.add("its facets have no texture coordinates: they have their plain colour")
        else:
            light = Pictures(path, alpha, notes).of_file([pictures[0].replace("\\", "/")])
            made = replace(made, picture=light)
    return [made]


def pictures_of(path: Path) -> list[str]:
    """Return the pictures in a PLY file's header, relative to its folder."""
    return list(_pictures(path, file_stamp(path)))


@lru_cache(maxsize=STAMPED_FILES)
def _pictures(path: Path, _: tuple[object, ...]) -> tuple[str, ...]:
    """Return these names, cached by the file's stamp: every build and render needs them."""
    content = without_mark(read_bytes(path))
    end = _END.search(content)
    try:
        return tuple(_header(content[: end.start()].decode("latin-1"))[2]) if end is not None else ()
    except ValueError:
        return ()


def _header(text: str) -> tuple[str, list[Element], list[str]]:
    """Return the byte order ("" for text), the elements, and the pictures named in comments."""
    order: str | None = None
    elements: list[Element] = []
    pictures: list[str] = []
    for line in text.splitlines()[1:]:
        words = line.split()
        if not words or words[0] == "obj_info":
            continue
        if words[0] == "comment":
            if len(words) > 2 and words[1].lower() == "texturefile":
                pictures.append(line.split(None, 2)[2].strip())
        elif words[0] == "format" and len(words) > 1 and words[1] in FORMATS:
            order = FORMATS[words[1]]
        elif words[0] == "element" and len(words) > 2 and words[2].isdecimal() and int(words[2]) <= MOST_ENTRIES:
            elements.append(Element(words[1], int(words[2]), {}))
        elif words[0] == "property" and elements and len(words) > 2 and all(each in KINDS for each in _kinds(words)):
            elements[-1].properties[words[-1]] = tuple(KINDS[each] for each in _kinds(words))
        else:
            raise ValueError(f"its header has the unknown line {line[:60]!r}")
    if order is None:
        raise ValueError("its header names no format")
    return order, elements, pictures


def _kinds(words: list[str]) -> list[str]:
    return words[2:4] if words[1] == "list" and len(words) == 5 else words[1:2] if len(words) == 3 else ["?"]


class _Body:
    """The rows of a PLY file, element after element.

    Parameters
    ----------
    raw : (n,) uint8
    order : str
        Byte order in numpy's notation; "" for text, with all numbers as float64 here.
    at : int
        Start of the next element.
    """

    def __init__(self, raw: NDArray[np.uint8], order: str, at: int) -> None:
        self.raw, self.order, self.at = raw, order, at

    def kind(self, name: str) -> np.dtype:
        """Return the stored number type for one in the header."""
        return np.dtype(f"{self.order}{name}") if self.order else np.dtype(np.float64)

    def rows(self, element: Element) -> tuple[Rows, int]:
        """Return the numbers of the element that starts here, and its end."""
        kinds = {key: tuple(self.kind(each) for each in names) for key, names in element.properties.items()}
        if not element.count or not kinds:
            return Rows.empty(kinds), self.at
        lengths = self._lengths_of_first(element, kinds)
        # In most files all lists have one length, so that all rows have one size.
        table = self._table(element, kinds, lengths)
        if table is None:
            return self._uneven(element, kinds)
        made = Rows(
            {key: table[key] for key in kinds if key not in lengths},
            {key: (table[key].reshape(-1), np.full(element.count, length)) for key, length in lengths.items()},
        )
        return made, self.at + table.nbytes

    def _lengths_of_first(self, element: Element, kinds: dict[str, tuple[np.dtype, ...]]) -> dict[str, int]:
        one = Element(element.name, 1, element.properties)
        return {key: int(length[0]) for key, length in self._walk(one, kinds)[1].items()}

    def _table(
        self, element: Element, kinds: dict[str, tuple[np.dtype, ...]], lengths: dict[str, int]
    ) -> NDArray[np.void] | None:  # fmt: skip
        """Return the rows of an element, if all their lists are as long as in the first row."""
        fields: list[tuple[str, np.dtype] | tuple[str, np.dtype, tuple[int]]] = []
        for key, kind in kinds.items():
            if key in lengths:
                fields += [(f"{key}:", kind[0]), (key, kind[1], (lengths[key],))]
            else:
                fields.append((key, kind[0]))
        dtype = np.dtype(fields)
        if element.count * dtype.itemsize > len(self.raw) - self.at:
            if lengths:
                return None
            raise _short(element)
        table = np.frombuffer(self.raw, dtype, element.count, self.at)
        return table if all((table[f"{key}:"] == length).all() for key, length in lengths.items()) else None

    def _uneven(self, element: Element, kinds: dict[str, tuple[np.dtype, ...]]) -> tuple[Rows, int]:
        """Return the rows of an element with lists of different lengths, and its end."""
        starts, lengths, end = self._walk(element, kinds)
        made = Rows({}, {})
        for key, kind in kinds.items():
            if key in lengths:
                within = np.arange(lengths[key].sum()) - np.repeat(np.cumsum(lengths[key]) - lengths[key], lengths[key])
                places = np.repeat(starts[key] + kind[0].itemsize, lengths[key]) + within * kind[1].itemsize
                made.lists[key] = self._at(places, kind[1]), lengths[key]
            else:
                made.plain[key] = self._at(starts[key], kind[0])
        return made, end

    def _at(self, places: Index, kind: np.dtype) -> Array:
        """Return the numbers that start at some bytes."""
        found = np.empty((len(places), kind.itemsize), np.uint8)
        for byte in range(kind.itemsize):
            found[:, byte] = self.raw[places + byte]
        return found.view(kind)[:, 0]

    def _walk(
        self, element: Element, kinds: dict[str, tuple[np.dtype, ...]]
    ) -> tuple[dict[str, Index], dict[str, Index], int]:  # fmt: skip
        """Return the start of each property in each row, the lengths of its lists, and the end of the element."""
        steps = [(key, kind[0], kind[1].itemsize if len(kind) == 2 else 0) for key, kind in kinds.items()]
        starts: dict[str, list[int]] = {key: [] for key in kinds}
        lengths: dict[str, list[int]] = {key: [] for key, _, item in steps if item}
        read = {key: struct.Struct((self.order or "=") + _STRUCT[kind.str[1:]]).unpack_from for key, kind, _ in steps}
        raw, at, end = self.raw.data, self.at, len(self.raw)
        for _ in range(element.count):
            for key, kind, item in steps:
                starts[key].append(at)
                length = 0
                if at + kind.itemsize > end:
                    raise _short(element)
                if item:
                    length = int(read[key](raw, at)[0])
                    if length < 0 or at + length * item > end:
                        raise _short(element)
                    lengths[key].append(length)
                at += kind.itemsize + length * item
        return (
            {key: np.array(values, np.int64) for key, values in starts.items()},
            {key: np.array(values, np.int64) for key, values in lengths.items()},
            at,
        )


_STRUCT = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
"""Number types by the letters of `struct`."""


def _body(content: bytes, at: int, order: str) -> _Body:
    if order:
        return _Body(np.frombuffer(content, np.uint8), order, at)
    body = content[at:]
    if b"comment" in body or b"obj_info" in body:
        body = re.sub(rb"^[ \t]*(?:comment|obj_info)\b[^\n]*", b"", body, flags=re.MULTILINE)
    return _Body(numbers(body).view(np.uint8), "", 0)


def _cut_to_header(body: bytes, elements: list[Element]) -> bytes:
    """Return the rows of a text file, with only the numbers in its header."""
    lines = [line.split() for line in body.splitlines()]
    lines = [words for words in lines if words and words[0] not in (b"comment", b"obj_info")]
    kept: list[bytes] = []
    at = 0
    for element in elements:
        for words in lines[at : at + element.count]:
            size = 0
            for kind in element.properties.values():
                if size >= len(words):
                    raise _short(element)
                size += 1 + (int(words[size]) if len(kind) == 2 else 0)
            kept += words[:size]
        at += element.count
    return b" ".join(kept)


def _short(element: Element) -> ValueError:
    return ValueError(f"cut short: its element {element.name[:40]} has fewer rows than the {element.count:,} it counts")


def _piece(
    vertices: Array, rows: dict[str, Rows], alpha: bool, elements: dict[str, Element], notes: Notes
) -> Piece | None:  # fmt: skip
    """Return the facets of a PLY file; None if it has none."""
    lists = rows["face"].lists if "face" in rows else {}
    plain = rows["vertex"].plain
    key = next((key for key in CORNERS if key in lists), None)
    strips = rows["tristrips"].lists if "tristrips" in rows else {}
    parts: list[Index] = []
    if key is not None:
        corners, counts = lists[key][0].astype(np.int64), lists[key][1]
        check_corners(corners, len(vertices))
        cut_places = cut(vertices, corners, counts)
        notes.count(cut_places.short, cut_places.in_words)
        parts.append(corners[cut_places.corners])
    for values, counts in (strips[key] for key in CORNERS if key in strips):
        parts.append(_of_strips(values.astype(np.int64), counts, len(vertices)))
    faces = np.concatenate(parts) if parts else np.zeros((0, 3), np.int64)
    if not len(faces):
        return None
    notes.count(rows["edge"].count if "edge" in rows else 0, "its {} edges are left out")
    normals = np.column_stack([plain[each] for each in NORMAL])[faces] if set(NORMAL) <= set(plain) else None
    uv = next(
        (np.column_stack([plain[each] for each in pair])[faces] for pair in PLACES if set(pair) <= set(plain)), None
    )
    colours = _colours(plain, elements["vertex"], alpha, "vertex", notes)
    colours = colours[faces] if colours is not None else None
    if key is not None and len(parts) == 1:
        triangles, polygon, _ = cut_places
        if uv is None and PLACES_OF_FACETS in lists:
            given, counts = lists[PLACES_OF_FACETS]
            if (counts == 2 * lists[key][1]).all():
                uv = given.reshape(-1, 2)[triangles]
            else:
                notes.add("its texture coordinates are left out: they are not two numbers for each corner of a facet")
        if colours is None:
            of_facets = _colours(rows["face"].plain, elements["face"], alpha, "facet", notes)
            colours = np.repeat(of_facets[polygon][:, None], 3, axis=1) if of_facets is not None else None
    as_float = [each.astype(np.float64) if each is not None else None for each in (normals, uv)]
    return Piece(Mesh(vertices, faces, as_float[0]), as_float[1], factor=np.ones(4 if alpha else 3), colours=colours)


def _of_strips(values: Index, counts: Index, vertices: int) -> Index:
    """Return the triangles of strips, which −1 also ends; every other triangle is reversed."""
    ends = np.zeros(len(values), bool)
    ends[(np.cumsum(counts) - 1)[counts > 0]] = True
    strip = np.concatenate([[0], np.cumsum(ends | (values < 0))[:-1]])
    check_corners(values[values >= 0], vertices)
    places = np.arange(len(values))
    first = places[np.searchsorted(strip, np.arange(strip[-1] + 1))] if len(strip) else places
    start = places[: max(0, len(values) - 2)]
    whole = (
        (strip[start] == strip[start + 2]) & (values[start] >= 0) & (values[start + 1] >= 0) & (values[start + 2] >= 0)
    )
    start = start[whole]
    odd = (start - first[strip[start]]) % 2
    made = np.stack([values[start], values[start + 1 + odd], values[start + 2 - odd]], axis=-1)
    # Strips are joined by triangles without area.
    a, b, c = made.T
    return np.asarray(made[(a != b) & (b != c) & (a != c)])


def _colours(plain: dict[str, Array], element: Element, alpha: bool, what: str, notes: Notes) -> Array | None:
    """Return the colours of an element's rows, 0 to 1; integers are fractions of their type's maximum."""
    names = next((names for names in COLOURS if set(names) <= set(plain)), None)
    if names is None:
        return None
    columns: list[Array] = []
    for name in (*names, *([next((name for name in ALPHAS if name in plain), "")] if alpha else [])):
        if not name:
            columns.append(np.ones(len(columns[0])))
            continue
        kind = np.dtype(element.properties[name][0])
        most = float(np.iinfo(kind).max) if kind.kind in "iu" else 1.0
        columns.append(plain[name].astype(np.float64) / most)
    made = np.column_stack(columns)
    if not ((made >= 0.0) & (made <= 1.0)).all():
        notes.add(f"its {what} colours are left out: they are not numbers from 0 to 1")
        return None
    return made
