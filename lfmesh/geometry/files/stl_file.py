"""STL files, binary and text: facets only."""

import re
from pathlib import Path

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files.piece import Notes, Piece
from lfmesh.geometry.files.text_numbers import numbers
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.regular_file import read_bytes, without_mark

HEADER, RECORD = 84, 50
"""Bytes before the facets, and bytes per facet."""

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_COMMENT = re.compile(rb"(?:#|//)[^\n\r]*")


def read(path: Path, notes: Notes) -> list[Piece]:
    """Return the facets of an STL file in its own unit, as one piece.

    Raises
    ------
    MeshError
        The file is truncated.
    ValueError
        It is broken otherwise.
    """
    content = read_bytes(path)
    corners = _binary(path, content, notes)
    if corners is None:
        corners = _text(without_mark(content))
    if corners is None:
        return []
    return [Piece(Mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)))]


def _binary(path: Path, content: bytes, notes: Notes) -> Array | None:
    """Return the corners (m, 3, 3) of a binary file; None for other files."""
    if len(content) < HEADER:
        return None
    count = int.from_bytes(content[80:84], "little")
    whole = len(content) == HEADER + RECORD * count
    if not whole and (without_mark(content).lstrip()[:5].lower() == b"solid" and b"vertex" in content.lower()):
        return None
    if not whole and len(content) < HEADER + RECORD * count:
        held = (len(content) - HEADER) // RECORD
        raise MeshError(
            f"{path}: broken, or cut short: its header counts {count} facets, but the file has room for {held}"
        )
    facets = np.frombuffer(content, FACET, count, HEADER)
    if b"COLOR=" in content[:80] and facets["attribute"].any():
        notes.add("the colours of its facets are left out")
    return facets["corners"].astype(np.float64)


def _text(content: bytes) -> Array | None:
    """Return the corners (m, 3, 3) of a text file; None if it has none."""
    if b"vertex" not in content or b"FACET" in content:
        content = content.lower()
    if b"#" in content or b"//" in content:
        content = _COMMENT.sub(b"", content)
    parts = _without_titles(content).split(b"vertex")
    facets = content.count(b"endfacet")
    if len(parts) == 1:
        return None
    if len(parts) - 1 != 3 * facets:
        raise ValueError(
            f"cut short: it has {facets:,} whole facets and {len(parts) - 1:,} corners; each facet has three"
        )
    # Corners usually have one line each.
    rows = [part.partition(b"\n")[0] for part in parts[1:]]
    try:
        values = numbers(b"\n".join(rows))
    except ValueError:
        values = numbers(b"\n".join([b" ".join(part.split(None, 3)[:3]) for part in parts[1:]]))
    if len(values) != 9 * facets:
        raise ValueError("a corner does not have three numbers")
    return values.reshape(-1, 3, 3)


def _without_titles(content: bytes) -> bytes:
    """Return a text without the lines that begin and end bodies: their names may be any words."""
    kept, at = [], 0
    while (start := content.find(b"solid", at)) >= 0:
        kept.append(content[at:start].removesuffix(b"end"))
        ends = [end for end in (content.find(b"\n", start), content.find(b"\r", start)) if end >= 0]
        at = min(ends, default=len(content))
    return b"".join([*kept, content[at:]])
