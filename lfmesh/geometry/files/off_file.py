"""OFF text files: polygons, with normals, texture coordinates and colours of vertices, and colours of facets."""

import re
from pathlib import Path

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.piece import Notes, Piece
from lfmesh.geometry.files.polygons import cut
from lfmesh.geometry.files.text_numbers import numbers, table
from lfmesh.geometry.meshes.mesh import Array, Index, Mesh
from lfmesh.regular_file import read_text

_HEADER = re.compile(r"\s*(ST)?(C)?(N)?(4)?(n)?OFF", re.IGNORECASE)


def read(path: Path, notes: Notes) -> list[Piece]:
    """Return the facets of an OFF file in its own unit, as one piece.

    Raises
    ------
    MeshError
        The file is truncated, or its header has no facet count.
    ValueError
        It is broken otherwise.
    """
    text = read_text(path, errors="replace")
    lines = [line for line in (each.partition("#")[0].strip() for each in text.splitlines()) if line]
    if not lines:
        return []
    header = _HEADER.match(lines[0])
    kinds: tuple[str | None, ...] = (None,) * 5
    if header is not None:
        kinds = header.groups()
        lines[0] = lines[0][header.end() :].strip()
    if any(kinds[3:]) or any("BINARY" in line.upper() for line in lines[:1]):
        raise ValueError("it is binary, or has more than three dimensions; save it as plain OFF")
    words: list[str] = []
    used = 0
    while len(words) < 3 and used < len(lines) and used < 4:
        words += lines[used].split()
        used += 1
    if len(words) < 2 or not (words[0].isdecimal() and words[1].isdecimal()):
        raise MeshError(
            f"{path}: its header counts no facets; the numbers of vertices, facets and edges must follow the word OFF"
        )
    vertices, facets = int(words[0]), int(words[1])
    rows = [*([" ".join(words[3:])] if len(words) > 3 else []), *lines[used:]]
    if len(rows) < vertices + facets:
        rows = _by_count(path, " ".join(rows).split(), vertices, facets)
    return _piece(path, table(rows[:vertices], 3)[0], rows[vertices : vertices + facets], kinds, notes)


def _by_count(path: Path, words: list[str], vertices: int, facets: int) -> list[str]:
    """Return the rows of vertices and facets of a file that does not have one per line."""
    rows = [" ".join(words[3 * k : 3 * k + 3]) for k in range(min(vertices, len(words) // 3))]
    at = 3 * vertices
    while at < len(words) and len(rows) < vertices + facets:
        count = int(words[at]) if words[at].isdecimal() else 0
        if at + 1 + count > len(words):
            break
        rows.append(" ".join(words[at : at + 1 + count]))
        at += 1 + count
    if len(rows) < vertices + facets:
        read = max(0, len(rows) - vertices)
        raise MeshError(f"{path}: cut short: its header counts {facets} facets, {read} could be read")
    return rows


def _piece(path: Path, values: Array, rows: list[str], kinds: tuple[str | None, ...], notes: Notes) -> list[Piece]:
    """Return the piece made from the vertices' numbers and the facets' rows."""
    places, coloured, normals = kinds[:3]
    given = np.fromiter((len(row.split()) for row in rows), np.int64, len(rows))
    flat = numbers("\n".join(rows))
    if len(flat) != given.sum() or (given == 0).any():
        raise ValueError("numbers of its facets run into one another")
    starts = np.concatenate([[0], np.cumsum(given)[:-1]]).astype(np.int64)
    counts = flat[starts].astype(np.int64) if len(rows) else np.zeros(0, np.int64)
    if ((counts < 0) | (counts + 1 > given)).any():
        raise MeshError(f"{path}: cut short or broken: a facet counts more corners than its line has")
    order = np.arange(len(flat)) - np.repeat(starts, given)
    corners = flat[(order >= 1) & (order <= np.repeat(counts, given))].astype(np.int64)
    check_corners(corners, len(values))
    triangles, polygon, short = done = cut(values[:, :3], corners, counts)
    notes.count(short, done.in_words)
    faces = corners[triangles]
    # Each vertex has its normal, then its colour, then its texture coordinates.
    normal = values[:, 3:6][faces] if normals and values.shape[1] >= 6 else None
    at = 6 if normals else 3
    colours = None
    if coloured and values.shape[1] >= at + 3:
        colours = _colours(values[:, at : at + 3], "vertex", notes)
        colours = colours[faces] if colours is not None else None
    of_facets = _colours_of_facets(flat, starts, counts, given, notes)
    if of_facets is not None:
        colours = np.repeat(of_facets[polygon][:, None], 3, axis=1)
    uv = values[:, -2:][faces] if places and values.shape[1] >= 5 else None
    return [Piece(Mesh(np.ascontiguousarray(values[:, :3]), faces, normal), uv, colours=colours)]


def check_corners(corners: Index, count: int) -> None:
    """Raise if a facet refers to a missing vertex.

    Parameters
    ----------
    corners : (k,) int64
    count : int
        Number of vertices.

    Raises
    ------
    ValueError
        The message gives the vertex.
    """
    if len(corners) and not 0 <= corners.min() <= corners.max() < count:
        wrong = corners.min() if corners.min() < 0 else corners.max()
        raise ValueError(f"a facet names vertex {wrong}, but there are {count}, counted from 0")


def _colours(given: Array, what: str, notes: Notes) -> Array | None:
    """Return colours from 0 to 1; integers above 1 are bytes."""
    known = np.asarray(np.isfinite(given).all(axis=1))
    values = np.where(known[:, None], given, 1.0)
    if (values > 1.0).any() and (values == np.round(values)).all():
        values = np.where(known[:, None], values / 255.0, 1.0)
    if not known.any() or (values < 0.0).any() or (values > 1.0).any():
        notes.add(f"its {what} colours are left out: they are not numbers from 0 to 1 or from 0 to 255")
        return None
    return values


def _colours_of_facets(flat: Array, starts: Index, counts: Index, given: Index, notes: Notes) -> Array | None:
    """Return the colours that follow the corners of facets, (p, 3); white for facets without one."""
    behind = given - counts - 1
    notes.count(int((behind == 1).sum()), "the colours of {} facets are left out: they are indices of a table")
    those = np.flatnonzero(behind >= 3)
    if not len(those):
        return None
    values = np.full((len(counts), 3), np.nan)
    values[those] = flat[(starts + counts + 1)[those][:, None] + np.arange(3)]
    return _colours(values, "facet", notes)
