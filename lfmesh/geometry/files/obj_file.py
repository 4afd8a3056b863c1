"""OBJ files with their material files: facets by material, with texture coordinates, normals and vertex colours.

Facets count vertices from 1, or backwards from the last preceding one. A texture coordinate or normal that does not
exist is dropped from the facet.
"""

import re
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import MeshError
from lfmesh.geometry.files import mtl_file
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.mtl_file import MtlMaterial, without_comment
from lfmesh.geometry.files.pictures import Pictures, companion_name
from lfmesh.geometry.files.piece import REPEAT, Notes, Piece
from lfmesh.geometry.files.polygons import cut
from lfmesh.geometry.files.text_numbers import numbers, table
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh
from lfmesh.regular_file import read_text
from lfmesh.scene.inputs import STAMPED_FILES, file_stamp

KINDS = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}
"""Names of the quantities that the numbers of a corner refer to, by line key."""

_CODES = {
    key: number for number, key in enumerate((*KINDS, "f", "fo", "usemtl", "mtllib", "l", "p", "curv", "surf"), 1)
}
"""Numbers of the line keys that are read."""

LEFT_OUT = {"l": "lines", "p": "points", "curv": "free-form curves", "surf": "free-form surfaces"}
"""Names of ignored elements, by line key."""

NO_PLACE = "{} facets have no texture coordinates: they have their plain colour"

_NONE = -(2**62)
"""Index of a missing texture coordinate or normal."""


def read(path: Path, alpha: bool, notes: Notes) -> list[Piece]:
    """Return the pieces of an OBJ file in its own unit, one per material, in the order of first use.

    Parameters
    ----------
    path : Path
    alpha : bool
        Read the alpha of pictures and the opacity of materials, too.
    notes : Notes

    Raises
    ------
    MeshError
        A facet refers to a missing vertex, or a file is outside the folder.
    ValueError
        The file is broken otherwise.
    """
    obj = _Obj(path, _lines(path))
    for key, what in LEFT_OUT.items():
        notes.count(len(obj.numbers(key)), f"its {{}} {what} are left out")
    materials = _Materials.read(path, obj.values("mtllib"), notes)
    pictures = Pictures(path, alpha, notes)
    colours = obj.colours(notes)
    by_material: dict[str, list[_Facets]] = {}
    for name, lines in obj.stretches():
        by_material.setdefault(name, []).append(obj.facets(lines))
    wrong = {"vt": 0, "vn": 0}
    made = []
    for name, parts in by_material.items():
        facets = _Facets.joined(parts)
        for key, column in (("vt", 1), ("vn", 2)):
            wrong[key] += _take_back(facets, column, len(obj.tables[key]))
        if len(facets.counts):
            material = materials.called(name, notes)
            made += _pieces(obj, facets, material, pictures, colours)
    notes.count(wrong["vt"], "{} facets name missing texture coordinates: they have none")
    notes.count(wrong["vn"], "{} facets name missing normals: they have none")
    return made


def companions(path: Path) -> list[str]:
    """Return the material and picture files that an OBJ file refers to, relative to its folder."""
    notes = Notes()
    try:
        materials = _Materials.read(path, list(_library_lines(path, file_stamp(path))), notes)
    except (ValueError, MeshError):
        return []
    maps = [each.picture for each in materials.defined.values() if each.picture is not None]
    return [*materials.libraries, *(name for each in maps for name in each.names)]


@lru_cache(maxsize=STAMPED_FILES)
def _library_lines(path: Path, _: tuple[object, ...]) -> tuple[str, ...]:
    """Return the contents of a file's mtllib lines, cached by the file's stamp: every build and render needs them."""
    return tuple(_Obj(path, _lines(path)).values("mtllib"))


def _lines(path: Path) -> list[str]:
    text = read_text(path, errors="replace").replace("\r\n", "\n").replace("\r", "\n").replace("\t", " ")
    # A line that ends in a backslash continues on the next one.
    text = re.sub(r"\\ *\n", " ", text) if "\\" in text else text
    return [line.strip() for line in text.split("\n")]


@dataclass
class _Facets:
    """Facets of an OBJ file: indices of their corners in the file's tables, from 0, and number of corners of each.

    `_NONE` stands for a missing texture coordinate or normal.
    """

    corners: Index  # (k, 3)
    counts: Index  # (p,)

    @staticmethod
    def joined(parts: list["_Facets"]) -> "_Facets":
        return _Facets(
            np.concatenate([part.corners for part in parts]), np.concatenate([part.counts for part in parts])
        )


@dataclass
class _Materials:
    """Materials that an OBJ file may use, by name."""

    path: Path
    defined: dict[str, MtlMaterial] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)
    missing: bool = False

    @staticmethod
    def read(path: Path, given: list[str], notes: Notes) -> "_Materials":
        made = _Materials(path)
        for line in dict.fromkeys(each for each in given if each):
            for names in _library_names(path, line):
                name = companion_name(path, names, "material file")
                if name is None:
                    made.missing = True
                    shown = without_comment(names[0])[:100]
                    notes.add(f"its material file {shown} is missing: its facets have the scene's material")
                    continue
                made.libraries.append(name)
                content = read_text(path.parent / name, errors="replace")
                folder = PurePosixPath(name).parent.as_posix()
                for each in mtl_file.read(content, "" if folder == "." else folder, notes):
                    made.defined.setdefault(each.name, each)
                    for picture in each.picture.names if each.picture is not None else ():
                        check_companion(path, picture, "picture")
        return made

    def called(self, name: str, notes: Notes) -> MtlMaterial | None:
        """Return the material named in a usemtl line; None, with a note, if there is none.

        A name may contain "#" and may be followed by a comment, so the full text is tried first.
        """
        if not name:
            return None
        bare = without_comment(name)
        for each in (name, bare):
            if each in self.defined:
                return self.defined[each]
        alike = [each for each in self.defined.values() if without_comment(each.name) == bare]
        if len(alike) == 1:
            return alike[0]
        if not self.missing:
            notes.add(f"its material {bare[:60]} is not defined: its facets have the scene's material")
        return None


def _library_names(path: Path, line: str) -> list[list[str]]:
    """Return the possible names of each material file in an mtllib line: one name with spaces, or several."""
    whole = [each.replace("\\", "/") for each in dict.fromkeys((line, without_comment(line))) if each]
    if any("\0" not in name and (path.parent / name).is_file() for name in whole) or len(whole[-1].split()) == 1:
        return [whole]
    return [[name] for name in whole[-1].split()]


@dataclass
class _Obj:
    """Lines of an OBJ file, and its tables."""

    path: Path
    lines: list[str]

    @cached_property
    def codes(self) -> NDArray[np.int8]:
        """Number of each line's key; 0 for others."""
        of = _CODES.get
        return np.fromiter((of(line.partition(" ")[0], 0) for line in self.lines), np.int8, len(self.lines))

    def numbers(self, key: str) -> Index:
        """Return the indices of the lines with a key."""
        return np.flatnonzero(self.codes == _CODES[key])

    def values(self, key: str) -> list[str]:
        """Return the text after a key in each of its lines."""
        return [self.lines[number][len(key) :].strip() for number in self.numbers(key).tolist()]

    @cached_property
    def tables(self) -> dict[str, Array]:
        """Numbers of vertices (n, 3 or more), texture coordinates (n, 2), and normals (n, 3)."""
        made = {}
        for key, least in (("v", 3), ("vt", 1), ("vn", 3)):
            rows = _without_comments(self.values(key))
            made[key], counts = table(rows, least)
            if key == "vt":
                # A picture may be one-dimensional.
                made[key] = np.column_stack([made[key], np.zeros(len(rows))])[:, :2]
                made[key][counts == 1, 1] = 0.0
        return made

    def stretches(self) -> list[tuple[str, Index]]:
        """Return the material and the facet lines of each stretch with one material."""
        marks = self.numbers("usemtl")
        facets = np.flatnonzero((self.codes == _CODES["f"]) | (self.codes == _CODES["fo"]))
        parts = np.split(facets, np.searchsorted(facets, marks))
        return [each for each in zip(["", *self.values("usemtl")], parts, strict=True) if len(each[1])]

    def colours(self, notes: Notes) -> Array | None:
        """Return the colours (n, 3) that follow the vertices' coordinates, if any."""
        vertices = self.tables["v"]
        if vertices.shape[1] < 6:
            return None
        given = vertices[:, 3:6]
        known = np.asarray(~np.isnan(given).any(axis=1))
        if not known.any() or (given[known] < 0.0).any() or (given[known] > 1.0).any():
            notes.add("its vertex colours are left out: they are not numbers from 0 to 1")
            return None
        return np.where(known[:, None], given, 1.0)

    def facets(self, lines: Index) -> _Facets:
        """Return the facets on some lines."""
        rows = _without_comments([self.lines[number].partition(" ")[2] for number in lines.tolist()])
        counts = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
        corners = _corners("\n".join(rows), int(counts.sum()))
        relative = (corners < 0) & (corners != _NONE)
        if relative.any():
            for column, key in enumerate(KINDS):
                before = np.repeat(np.searchsorted(self.numbers(key), lines), counts)
                back = relative[:, column]
                # An index too far back stays below 0.
                corners[back, column] += before[back] + 1
        given = corners != _NONE
        corners[given] -= 1
        self._check_vertices(corners[:, 0], counts, lines, rows)
        return _Facets(corners, counts)

    def _check_vertices(self, vertex: Index, counts: Index, lines: Index, rows: list[str]) -> None:
        """Raise at the first facet with a missing vertex."""
        count = len(self.tables["v"])
        wrong = (vertex < 0) | (vertex >= count)
        if not wrong.any():
            return
        first = int(wrong.argmax())
        row = int(np.searchsorted(np.cumsum(counts), first, side="right"))
        number = rows[row].split()[first - int(counts[:row].sum())].partition("/")[0]
        counted = f"there are {count:,}, counted from 1, or back from -1" if count else "there is none"
        raise MeshError(f"{self.path}: line {lines[row] + 1}: a facet names vertex {number[:30]}, but {counted}")


def _without_comments(rows: list[str]) -> list[str]:
    return [row.partition("#")[0] for row in rows] if any("#" in row for row in rows) else rows


def _corners(text: str, count: int) -> Index:
    """Return the indices (count, 3) of corners such as 3, 3/1, 3//2 and 3/1/2, with `_NONE` for missing ones."""
    made = np.full((count, 3), _NONE)
    if "/" not in text:
        made[:, 0] = numbers(text, np.int64)
        return made
    text = re.sub(r"/+(?=\s|$)", "", text).replace("//", f"/{_NONE}/")
    slashes = np.frombuffer(text.encode("ascii", "replace"), np.uint8)
    space = (slashes == ord(" ")) | (slashes == ord("\n")) | (slashes == ord("\t"))
    starts = np.flatnonzero(~space & np.concatenate([[True], space[:-1]]))
    given = 1 + np.add.reduceat((slashes == ord("/")).astype(np.int64), starts)
    values = numbers(text.replace("/", " "), np.int64)
    if len(starts) != count or given.max() > 3 or len(values) != given.sum():
        raise ValueError("a corner of a facet has none of the forms 1, 1/1, 1//1 and 1/1/1")
    made[np.arange(3) < given[:, None]] = values
    return made


def _take_back(facets: _Facets, column: int, count: int) -> int:
    """Drop texture coordinates or normals from facets if any corner's is missing or does not exist.

    Returns
    -------
    int
        Number of facets that refer to one that does not exist.
    """
    corner = facets.corners[:, column]
    given = corner != _NONE
    absent = given & ((corner < 0) | (corner >= count))
    owner = np.repeat(np.arange(len(facets.counts)), facets.counts)
    partly = np.zeros(len(facets.counts), bool)
    partly[owner[absent | ~given]] = True
    corner[partly[owner]] = _NONE
    return len(np.unique(owner[absent]))


def _pieces(
    obj: _Obj, facets: _Facets, material: MtlMaterial | None, pictures: Pictures, colours: Array | None
) -> list[Piece]:  # fmt: skip
    """Return the pieces of facets with one material, separated by having texture coordinates and normals or not."""
    vertices = np.ascontiguousarray(obj.tables["v"][:, :3])
    done = cut(vertices, facets.corners[:, 0], facets.counts)
    pictures.notes.count(done.short, done.in_words)
    triangles = done.corners
    channels = 4 if pictures.alpha else 3
    factor, picture, given, called = np.ones(channels), None, None, ""
    if material is not None:
        factor, called = np.append(material.colour, material.opacity)[:channels], material.name
        if (given := material.picture) is not None:
            picture = pictures.of_file(list(given.names))
    first = facets.corners[triangles[:, 0]] != _NONE
    made = []
    for with_uv, with_normals in product((False, True), repeat=2):
        own = triangles[(first[:, 1] == with_uv) & (first[:, 2] == with_normals)]
        if not len(own):
            continue
        used, faces = _used(facets.corners[own, 0], len(vertices))
        normals = obj.tables["vn"][facets.corners[own, 2], :3] if with_normals else None
        uv = obj.tables["vt"][facets.corners[own, 1]] if with_uv else None
        if uv is None and picture is not None:
            pictures.notes.count(len(own), NO_PLACE)
        if uv is not None and given is not None:
            uv = uv * given.scale + given.offset
        mesh = Mesh(vertices[used], faces, normals)
        wrap = ("clamp", "clamp") if given is not None and given.clamped else REPEAT
        own_colours = colours[facets.corners[own, 0]] if colours is not None else None
        shown = picture if with_uv else None
        made.append(Piece(mesh, uv, None, own_colours, called, picture=shown, factor=factor, wrap=wrap))
    return made


def _used(corners: Index, count: int) -> tuple[Index, Index]:
    """Return the vertices used by some corners, ascending, and the corners' indices among them."""
    if corners.size * 8 < count:
        used, numbers = np.unique(corners, return_inverse=True)
        return used, numbers.reshape(corners.shape)
    there = np.zeros(count, bool)
    there[corners] = True
    return np.flatnonzero(there), (np.cumsum(there) - 1)[corners]
