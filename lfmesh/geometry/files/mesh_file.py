"""Meshes from files: STL, OBJ, PLY, OFF, GLB, glTF, STEP and 3MF, in mm, with their colours and vertex normals.

Each format has its own reader. It returns pieces in the file's unit and notes each difference between file and pieces;
the notes become warnings. STEP and 3MF files are first converted to meshes by `cad_file`.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import LensFileWarning, MeshError, warn_caller
from lfmesh.geometry.files import cad_file, obj_file, off_file, ply_file, stl_file
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.gltf_buffers import names_of
from lfmesh.geometry.files.gltf_left_out import left_out
from lfmesh.geometry.files.gltf_looks import check_material
from lfmesh.geometry.files.gltf_nodes import Node, check_document, node_called, nodes_of, not_read, primitives_of
from lfmesh.geometry.files.gltf_primitives import load_primitives
from lfmesh.geometry.files.pictures import companion_name
from lfmesh.geometry.files.piece import Notes, Piece
from lfmesh.geometry.surfaces.optical_face import Told
from lfmesh.regular_file import read_bytes, why_no_file
from lfmesh.scene.inputs import file_stamp

MM_PER_UNIT = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4, "foot": 304.8}
"""Units of length for a target."""

UNIT_OF_FORMAT = {".glb": "m", ".gltf": "m"}
"""glTF 2.0, section 3.4: all linear distances are metres."""

FARTHEST_MM = 1e15
"""Largest coordinate, the same as in a scene file."""

MOST_ENTRIES = 10**9
"""Most entries of a glTF accessor: more than memory holds, and more than a mesh needs."""

DOCUMENTS = 4
"""Number of glTF files with cached JSON, most recently used."""

GLB_VERSION = 2
"""Container version of glTF 2.0 (section 4.4.2)."""

ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Endings of files that this process reads itself."""

NODE_ENDINGS = (*UNIT_OF_FORMAT, *cad_file.ENDINGS)
"""Endings of files with named bodies."""


def load_mesh(
    path: Path,
    units: str | None = None,
    alpha: bool = False,
    node: str | int | None = None,
    tolerance_mm: float | None = None,
) -> list[Piece]:
    """Read a mesh file.

    Parameters
    ----------
    path : Path
        STL, OBJ (with MTL), PLY, OFF, GLB, glTF, STEP or 3MF.
    units : str, optional
        Unit of length, a key of `MM_PER_UNIT`. Required for STL, OBJ, PLY and OFF. The other formats fix their unit;
        giving a different one is an error.
    alpha : bool
        Read the alpha of pictures and colours, too.
    node : str or int, optional
        In a GLB or glTF file: name or number of the node to read, without its children, placed as in the file's scene.
        In a STEP or 3MF file: the body.
    tolerance_mm : float, optional
        In a STEP file: largest distance of a facet from its surface. Default: 3e-4 of the size of the largest body.

    Returns
    -------
    list of Piece
        One per material and instance, placed as in the file's scene; at least one facet in all.

    Raises
    ------
    MeshError
        The file is missing, of an unknown format, broken or empty, has a non-finite coordinate, or its unit is unknown
        or contradicted.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in (*ENDINGS, *cad_file.ENDINGS):
        valid = ", ".join((*ENDINGS, *cad_file.ENDINGS))
        raise MeshError(f"{path}: not a supported kind of mesh file; valid are {valid}")
    if not path.is_file():
        raise MeshError(f"{path}: the mesh file {why_no_file(path)}")
    if node is not None and ending not in NODE_ENDINGS:
        raise MeshError(f"{path}: node = {node!r}: only {', '.join(NODE_ENDINGS)} files have nodes; omit it")
    notes = Notes()
    if ending in cad_file.ENDINGS:
        if units is not None:
            raise MeshError(f"{path}: units = {units!r}: the file names its own; omit units")
        pieces = _read_cad(path, ending, alpha, node, tolerance_mm, notes)
    else:
        pieces = _read(path, ending, units, alpha, node, notes)
    facets = sum(len(piece.mesh.faces) for piece in pieces)
    if facets == 0:
        left = f" ({'; '.join(notes.texts)[:200]})" if notes.texts else ""
        raise MeshError(f"{path}: holds no facets: empty, cut short, or not a {ending[1:].upper()} file{left}")
    channels = 4 if alpha else 3
    pieces = [_without_colours_beside_picture(piece.with_channels(channels), notes) for piece in pieces]
    for piece in pieces:
        # Check the extremes first, which are NaN if any coordinate is. Vertices without a facet may have any value.
        least, largest = piece.mesh.vertices.min(initial=0.0), piece.mesh.vertices.max(initial=0.0)
        if not (least >= -FARTHEST_MM and largest <= FARTHEST_MM):
            corners = piece.mesh.vertices[piece.mesh.faces]
            bad = int((~np.isfinite(corners)).any(axis=(1, 2)).sum())
            if bad:
                have = "has" if bad == 1 else "have"
                raise MeshError(f"{path}: {bad} of {facets} facets {have} a corner that is not finite")
            if np.abs(corners).max(initial=0.0) > FARTHEST_MM:
                raise MeshError(f"{path}: has a corner farther than {FARTHEST_MM:g} mm from the origin of its frame")
        if piece.uv is not None and not np.isfinite(piece.uv).all():
            raise MeshError(f"{path}: has a texture coordinate that is not finite")
    warn_caller(LensFileWarning(f"{path}: {text}") for text in notes.texts)
    return pieces


def _without_colours_beside_picture(piece: Piece, notes: Notes) -> Piece:
    """Drop vertex colours that vary over a piece with a picture."""
    if piece.picture is not None and piece.colours is not None and (piece.colours != piece.colours[:1, :1]).any():
        notes.count(len(piece.colours), "the vertex colours of {} facets with a picture are left out")
        return replace(piece, colours=None)
    return piece


def companions(path: Path) -> list[str]:
    """Return the existing files that a mesh file refers to, relative to its folder: materials, pictures, buffers.

    Missing files are reported when the mesh is read.
    """
    names: list[str] = []
    ending = path.suffix.lower()
    if ending == ".obj":
        names += obj_file.companions(path)
    elif ending == ".gltf":
        try:
            document = _document(path, file_stamp(path))
            uris = [entry.get("uri", "") for key in ("buffers", "images") for entry in document.get(key, [])]
        except (ValueError, AttributeError, TypeError, RecursionError, MeshError):
            return []
        for uri in uris:
            if uri and not uri.startswith("data:"):
                names += names_of(uri)
    elif ending == ".ply":
        names += ply_file.pictures_of(path)
    return [name for name in dict.fromkeys(names) if "\0" not in name and (path.parent / name).is_file()]


def _read(path: Path, ending: str, units: str | None, alpha: bool, node: str | int | None, notes: Notes) -> list[Piece]:
    unit = _agreed(path, UNIT_OF_FORMAT.get(ending), units)
    document = gltf_document(path) if ending in UNIT_OF_FORMAT else None
    try:
        if document is not None:
            stamp = file_stamp(path)
            found = _nodes_by_key(path, stamp).get(node) if node is not None else None
            return _placed_nodes(path, document, _nodes(path, stamp) if found is None else (found,), node, alpha, notes)
        if ending == ".stl":
            pieces = stl_file.read(path, notes)
        elif ending == ".off":
            pieces = off_file.read(path, notes)
        else:
            pieces = (obj_file if ending == ".obj" else ply_file).read(path, alpha, notes)
        return [piece.placed(np.eye(4), MM_PER_UNIT[unit]) for piece in pieces]
    except MeshError:
        raise
    except Exception as error:  # a broken file may raise anything inside numpy
        reason = _shortened(f"{error}".splitlines()[0] if str(error) else type(error).__name__)
        raise MeshError(f"{path}: broken, or not a {ending[1:].upper()} file ({reason})") from None


def _read_cad(
    path: Path, ending: str, alpha: bool, node: str | int | None, tolerance_mm: float | None, notes: Notes
) -> list[Piece]:  # fmt: skip
    """Return the pieces of a STEP or 3MF file, checked by its own process."""
    if ending == ".3mf":
        return cad_file.pieces_of_3mf(path, node, alpha, notes)
    with cad_file.step_as_glb(path, tolerance_mm) as glb:
        document = cad_file.named_by_body(gltf_document(glb))
        return _placed_nodes(glb, document, nodes_of(glb, document), node, alpha, notes)


def surfaces_of_step(path: Path, node: str | int | None, tolerance_mm: float | None) -> list[Told]:
    """Return the surfaces that faces of a STEP file, or of one of its bodies, may lie on.

    Parameters
    ----------
    path : Path
    node : str or int, optional
        The body. Default: all.
    tolerance_mm : float, optional
        Same as for its mesh, so that the file is opened once.

    Raises
    ------
    MeshError
        As for `load_mesh`.
    """
    with cad_file.step_as_glb(path, tolerance_mm) as glb:
        document = cad_file.named_by_body(gltf_document(glb))
        nodes = nodes_of(glb, document)
        taken = nodes if node is None else [node_called(glb, nodes, node)]
        return cad_file.surfaces_of_nodes(path, document, [(each.to_scene, each.entry) for each in taken])


def _placed_nodes(
    path: Path, document: dict[str, Any], nodes: Sequence[Node], key: str | int | None, alpha: bool, notes: Notes
) -> list[Piece]:
    """Return the pieces of a glTF file, or of one of its nodes, in mm."""
    taken = nodes if key is None else [node_called(path, nodes, key)]
    parts = {node.number: primitives_of(path, document, node) for node in taken}
    for node in taken:
        for what in not_read(path, document, node):
            notes.add(f"{node.place}: {what} and has no facets; left out")
        if key is None:
            # For a node named in a scene, this was reported when the scene was read.
            for words in left_out(document, node, parts[node.number]):
                notes.add(f"{node.place}: {words}")
    made = load_primitives(path, document, (part for each in parts.values() for part in each), alpha, notes)
    scale = MM_PER_UNIT[UNIT_OF_FORMAT[".glb"]]
    return [made[part].placed(node.to_scene, scale) for node in taken for part in parts[node.number] if part in made]


def _agreed(path: Path, own: str | None, units: str | None) -> str:
    """Return the unit on which the file and the user agree."""
    valid = ", ".join(MM_PER_UNIT)
    if units is not None and units not in MM_PER_UNIT:
        raise MeshError(f"{path}: units = {units!r} is not known; valid are {valid}")
    if own is None:
        if units is None:
            raise MeshError(f"{path}: the format carries no unit; give units, one of {valid}")
        return units
    if units not in (None, own):
        raise MeshError(f"{path}: units = {units!r} contradicts the file, which is in {own}; omit units")
    return own


def _shortened(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:197]}..."


def gltf_document(path: Path) -> dict[str, Any]:
    """Return the JSON of a glTF or GLB file (glTF 2.0, section 4.4: in GLB, the first chunk after the 12-byte header).

    Raises
    ------
    MeshError
        It is broken, refers to missing files, or requires an unsupported extension.
    """
    document = _document(path, file_stamp(path))
    _check_companions(path, document)
    return document


@lru_cache(maxsize=DOCUMENTS)
def _document(path: Path, _: tuple[object, ...]) -> dict[str, Any]:
    """Return the JSON of a file, read-only and cached by the file's stamp."""
    ending = path.suffix.lower()
    content = read_bytes(path)
    try:
        if ending == ".glb":
            version = int.from_bytes(content[4:8], "little")
            if content[:4] == b"glTF" and version != GLB_VERSION:
                raise MeshError(f"{path}: is GLB of version {version}; valid is {GLB_VERSION}: export it as glTF 2.0")
            if content[:4] != b"glTF" or content[16:20] != b"JSON":
                raise ValueError("it has no GLB header")
            content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
        document = json.loads(content)
        if not isinstance(document, dict):
            raise ValueError("its JSON is not an object")
    except (ValueError, RecursionError) as error:
        reason = _shortened(f"{type(error).__name__}: {error}".splitlines()[0])
        raise MeshError(f"{path}: broken, or not a {ending[1:].upper()} file ({reason})") from None
    _check_gltf(path, document)
    return document


@lru_cache(maxsize=DOCUMENTS)
def _nodes(path: Path, stamp: tuple[object, ...]) -> tuple[Node, ...]:
    """Return the nodes of a glTF file's scene, cached by the file's stamp."""
    return tuple(nodes_of(path, _document(path, stamp)))


@lru_cache(maxsize=DOCUMENTS)
def _nodes_by_key(path: Path, stamp: tuple[object, ...]) -> dict[str | int, Node]:
    """Return the same nodes by number, and by name if unique."""
    nodes = _nodes(path, stamp)
    return {node.number: node for node in nodes} | {node.name: node for node in nodes if node.name is not None}


def _check_companions(path: Path, document: dict[str, Any]) -> None:
    """Raise on missing buffers, and on files outside the folder."""
    for key, kind in (("buffers", "buffer"), ("images", "picture")):
        for entry in _objects(document, key):
            uri = entry.get("uri")
            if not isinstance(uri, str) or uri.startswith("data:"):
                continue
            name = names_of(uri)[0]
            check_companion(path, name, kind)
            if companion_name(path, names_of(uri), kind) is None and kind == "buffer":
                raise MeshError(f"{path}: its {kind} {name} is missing; put it beside the mesh")


def _check_gltf(path: Path, document: dict[str, Any]) -> None:
    """Raise on tables larger than memory, and on invalid materials."""
    check_document(path, document)
    for accessor in _objects(document, "accessors"):
        count = accessor.get("count")
        if not isinstance(count, int) or not 0 <= count <= MOST_ENTRIES:
            raise MeshError(f"{path}: broken: an accessor counts {_shortened(repr(count))} entries")
    for number, material in enumerate(_objects(document, "materials")):
        check_material(path, f"materials[{number}]", material)


def _objects(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = document.get(key, [])
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
