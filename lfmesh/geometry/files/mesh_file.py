"""Meshes from files: STL, OBJ, PLY, OFF, GLB, glTF, STEP and 3MF, in mm, with their colours and vertex normals.

trimesh reads them; `cad_file` makes meshes of STEP and 3MF files before. trimesh passes over some broken files in
silence (an STL of garbage is an empty scene to it, an OFF that is cut short a smaller mesh), so what it returns is held
against what the file says.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files import cad_file, obj_file
from lfmesh.geometry.files.companion import check_companion
from lfmesh.geometry.files.gltf_nodes import (
    REPEAT,
    WRAP,
    check_document,
    load_primitives,
    node_called,
    nodes_of,
    primitives_of,
)
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.texture import FORMATS, MOST_PIXELS, Texture, linear_light, with_alpha
from lfmesh.geometry.surfaces.optical_face import Told
from lfmesh.optics.gltf_material import GltfMaterial
from lfmesh.regular_file import read_bytes, read_text, why_no_file

MM_PER_UNIT = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4, "foot": 304.8}
"""Units of length a target may name."""

UNIT_OF_FORMAT = {".glb": "m", ".gltf": "m"}
"""glTF 2.0, section 3.4: all linear distances are metres."""

FARTHEST_MM = 1e15
"""Largest coordinate: that of a scene's own numbers."""

MOST_ENTRIES = 10**9
"""Of one accessor of a glTF file: more than memory holds, and more than a mesh needs."""

ALPHA_MODES = ("OPAQUE", "MASK", "BLEND")
"""Of a glTF material."""

ENDINGS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf")
"""Of files that trimesh reads."""

NODE_ENDINGS = (*UNIT_OF_FORMAT, *cad_file.ENDINGS)
"""Of files with bodies that have names."""


@dataclass(frozen=True)
class Piece:
    """A part of a mesh file with one material.

    Attributes
    ----------
    mesh : Mesh
        In the file's frame, mm; with corner normals only where the file itself gives them (OBJ, PLY, GLB), of whatever
        length and sense it gives.
    uv : (m, 3, 2) float64 or None
        Place in the picture of each facet's corners; (0, 0) is its bottom left; `wrap` tells what lies outside 0..1.
    picture : (h, w, 3) float32 or None
        Base colour texture, linear light; (h, w, 4) with its alpha.
    factor : (3,) float64
        Base colour, linear, that multiplies the picture; (4,) with its alpha.
    material : GltfMaterial or None
        What else a glTF file says of the surface.
    alpha_mode : str
        "OPAQUE": the alpha does not count; "MASK": the surface is there where it is at least `alpha_cutoff`; "BLEND":
        it is the surface's opacity.
    wrap : tuple of str
        Across and down, what the picture shows outside 0..1: "repeat", "mirror" (every other repeat is mirrored) or
        "clamp" (its edge goes on).
    """

    mesh: Mesh
    uv: Array | None = None
    picture: Texture | None = None
    factor: Array = field(default_factory=lambda: np.ones(3))
    material: GltfMaterial | None = None
    alpha_mode: str = "OPAQUE"
    alpha_cutoff: float = 0.5
    wrap: tuple[str, str] = REPEAT


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
        Unit of length, a key of `MM_PER_UNIT`. Needed for STL, OBJ, PLY and OFF. The other formats fix their
        unit, and naming a different one is an error: a mesh is not rescaled against its own file.
    alpha : bool
        Read the alpha of pictures and colours, too.
    node : str or int, optional
        Of a GLB or glTF file: the node, by its name or number, whose own mesh alone is read, where the file places it.
        Of a STEP or 3MF file: the body.
    tolerance_mm : float, optional
        Of a STEP file: how far a facet may lie off its surface; omitted, 3e-4 of the size of the largest body.

    Returns
    -------
    list of Piece
        One a material and instance, transforms of the file's scene applied, at least one facet in all.

    Raises
    ------
    MeshError
        The file is missing, of an unknown kind, broken or empty, holds a coordinate that is no number, or its
        unit is unknown or contradicted.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending not in (*ENDINGS, *cad_file.ENDINGS):
        valid = ", ".join((*ENDINGS, *cad_file.ENDINGS))
        raise MeshError(f"{path}: not a kind of mesh file that can be read; valid are {valid}")
    if not path.is_file():
        raise MeshError(f"{path}: the mesh file {why_no_file(path)}")
    if node is not None and ending not in NODE_ENDINGS:
        raise MeshError(f"{path}: node = {node!r}: only {', '.join(NODE_ENDINGS)} files have nodes; omit it")
    if ending in cad_file.ENDINGS:
        if units is not None:
            raise MeshError(f"{path}: units = {units!r}: the file names its own; leave units out")
        pieces = _read_cad(path, ending, alpha, node, tolerance_mm)
    else:
        pieces = _read(path, ending, units, alpha, node)
    facets = sum(len(piece.mesh.faces) for piece in pieces)
    if facets == 0:
        raise MeshError(f"{path}: holds no facets: empty, cut short, or not a {ending[1:].upper()} file")
    for piece in pieces:
        bad = int((~np.isfinite(piece.mesh.vertices[piece.mesh.faces])).any(axis=(1, 2)).sum())
        if bad:
            raise MeshError(f"{path}: {bad} of {facets} facets have a corner that is no finite number")
        if np.abs(piece.mesh.vertices[piece.mesh.faces]).max(initial=0.0) > FARTHEST_MM:
            raise MeshError(f"{path}: has a corner farther than {FARTHEST_MM:g} mm from the origin of its frame")
        if piece.uv is not None and not np.isfinite(piece.uv).all():
            raise MeshError(f"{path}: has a place in its picture that is no finite number")
    return pieces


def companions(path: Path) -> list[str]:
    """Return the other files that a mesh file reads, by their paths from its folder: materials, pictures, buffers.

    Only those that are there; a mesh that lacks one is warned of or refused when it is read.
    """
    names: list[str] = []
    ending = path.suffix.lower()
    if ending == ".obj":
        names += obj_file.companions(path)
    elif ending == ".gltf":
        try:
            document = json.loads(read_bytes(path))
            uris = [entry.get("uri", "") for key in ("buffers", "images") for entry in document.get(key, [])]
        except (ValueError, AttributeError, TypeError, RecursionError):
            return []
        names += [unquote(uri) for uri in uris if uri and not uri.startswith("data:")]
    return [name for name in dict.fromkeys(names) if (path.parent / name).is_file()]


def _read(path: Path, ending: str, units: str | None, alpha: bool, node: str | int | None) -> list[Piece]:
    unit = _agreed(path, UNIT_OF_FORMAT.get(ending), units)
    if ending == ".obj":
        obj_file.check(path)
    document = gltf_document(path) if ending in UNIT_OF_FORMAT else None
    try:
        placed = _placed(path) if document is None else _placed_nodes(path, document, node)
        pieces = _pieces(placed, MM_PER_UNIT[unit], alpha)
    except MeshError:
        raise
    except Exception as error:  # a broken file may raise anything inside trimesh's parsers
        reason = _shortened(f"{type(error).__name__}: {error}".splitlines()[0])
        raise MeshError(f"{path}: broken, or not a {ending[1:].upper()} file ({reason})") from None
    if ending == ".off":
        _check_off_count(path, sum(len(piece.mesh.faces) for piece in pieces))
    return pieces


def _read_cad(path: Path, ending: str, alpha: bool, node: str | int | None, tolerance_mm: float | None) -> list[Piece]:
    """Return the pieces of a STEP or 3MF file, whose own process has checked it."""
    if ending == ".3mf":
        return _pieces(cad_file.placed_3mf(path, node), 1.0, alpha)
    with cad_file.step_as_glb(path, tolerance_mm) as glb:
        placed = _placed_nodes(glb, cad_file.named_by_body(gltf_document(glb)), node)
        return _pieces(placed, MM_PER_UNIT[UNIT_OF_FORMAT[".glb"]], alpha)


def surfaces_of_step(path: Path, node: str | int | None, tolerance_mm: float | None) -> list[Told]:
    """Return the surfaces that faces of a STEP file, or of one of its bodies, may lie on.

    Parameters
    ----------
    path : Path
    node : str or int, optional
        The body; omitted, all.
    tolerance_mm : float, optional
        That its mesh is made with, so that the file is opened once.

    Raises
    ------
    MeshError
        As `load_mesh` does.
    """
    with cad_file.step_as_glb(path, tolerance_mm) as glb:
        document = cad_file.named_by_body(gltf_document(glb))
        nodes = nodes_of(glb, document)
        taken = nodes if node is None else [node_called(glb, nodes, node)]
        return cad_file.surfaces_of_nodes(path, document, [(each.to_scene, each.entry) for each in taken])


def _pieces(placed: list[tuple[Any, Array]], scale: float, alpha: bool) -> list[Piece]:
    # By the identity of trimesh's image, so that geometries that share a picture keep sharing it.
    pictures: dict[int, Texture] = {}
    return [_piece(geometry, transform, scale, pictures, alpha) for geometry, transform in placed]


def _placed(path: Path) -> list[tuple[Any, Array]]:
    """Return trimesh's geometries of a file with their transforms."""
    import trimesh

    scene = trimesh.load_scene(path, process=False)
    each = (scene.graph[node] for node in scene.graph.nodes_geometry)
    return [
        (scene.geometry[name], transform)
        for transform, name in each
        if isinstance(scene.geometry[name], trimesh.Trimesh)
    ]


def _placed_nodes(path: Path, document: dict[str, Any], key: str | int | None) -> list[tuple[Any, Array]]:
    """Return the geometries of a glTF file, or of one of its nodes, with their transforms."""
    nodes = nodes_of(path, document)
    taken = nodes if key is None else [node_called(path, nodes, key)]
    parts = {node.number: primitives_of(path, document, node) for node in taken}
    made = load_primitives(path, document, (part for each in parts.values() for part in each))
    return [(made[part], node.to_scene) for node in taken for part in parts[node.number] if part in made]


def _agreed(path: Path, own: str | None, units: str | None) -> str:
    """Return the unit that the file and the user agree on."""
    valid = ", ".join(MM_PER_UNIT)
    if units is not None and units not in MM_PER_UNIT:
        raise MeshError(f"{path}: units = {units!r} is not known; valid are {valid}")
    if own is None:
        if units is None:
            raise MeshError(f"{path}: the format carries no unit; give units, one of {valid}")
        return units
    if units not in (None, own):
        raise MeshError(f"{path}: units = {units!r} contradicts the file, which is in {own}; leave units out")
    return own


def _piece(geometry: Any, transform: Array, scale: float, pictures: dict[int, Texture], alpha: bool) -> Piece:
    """Return one geometry of trimesh's scene, transformed and in mm."""
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    faces = np.asarray(geometry.faces, dtype=np.int64)
    if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise ValueError(f"a facet names vertex {wrong}, and there are {len(vertices)}, counted from 0")
    # Coordinate by coordinate: a matrix product may round equal vertices differently and open their seam.
    with np.errstate(invalid="ignore"):
        moved = transform[:3, 3] + sum(vertices[:, [k]] * transform[:3, k] for k in range(3))
    mirrored = np.linalg.det(transform[:3, :3]) < 0.0
    normals = _own_normals(geometry, transform[:3, :3])
    uv = getattr(geometry.visual, "uv", None)
    corners = np.asarray(uv, dtype=np.float64)[faces][:, :, :2] if uv is not None and len(uv) else None
    if mirrored:
        faces = faces[:, ::-1]
        corners = corners[:, ::-1] if corners is not None else None
    at_corners = normals[faces] if normals is not None else None
    material = getattr(geometry.visual, "material", None)
    picture, factor = _colour(material, pictures, alpha)
    surface = _gltf_material(material, factor)
    wrap = geometry.metadata.get(WRAP, REPEAT)
    return Piece(Mesh(moved * scale, faces, at_corners), corners, picture, factor, *surface, wrap)


def _gltf_material(material: Any, factor: Array) -> tuple[GltfMaterial | None, str, float]:
    """Return what a glTF file says of a surface beside its colour, and how its alpha counts."""
    import trimesh

    if not isinstance(material, trimesh.visual.material.PBRMaterial):
        return None, "OPAQUE", 0.5
    metallic, roughness = (
        1.0 if value is None else float(value) for value in (material.metallicFactor, material.roughnessFactor)
    )
    if (image := material.metallicRoughnessTexture) is not None:
        # glTF 2.0, section 3.9.2: roughness in the green channel, metallic in the blue one, both linear.
        mean = np.asarray(image.convert("RGB"), dtype=np.float64).mean(axis=(0, 1)) / 255.0
        roughness, metallic = roughness * mean[1], metallic * mean[2]
    red, green, blue = (float(each) for each in factor[:3])
    cutoff = 0.5 if material.alphaCutoff is None else float(material.alphaCutoff)
    mode = material.alphaMode or "OPAQUE"
    return GltfMaterial((red, green, blue), float(metallic), float(roughness)), mode, cutoff


def _own_normals(geometry: Any, linear: Array) -> Array | None:
    """Return the (n, 3) vertex normals that the file gives, transformed; None where it gives none."""
    # trimesh makes normals when it is asked for some that are not there. Its cache, as trimesh's own exporters look
    # at it, tells which have come with the file.
    if "vertex_normals" not in geometry._cache:
        return None
    normals = np.asarray(geometry.vertex_normals, dtype=np.float64)
    if np.array_equal(linear, np.eye(3)):
        return normals
    # Normals stand square to what the transform makes of the tangents: the cofactors carry them, but for their
    # length. A mirror turns the cofactors' sense, and leaves the outside of the body outside.
    cofactors = np.cross(linear[[1, 2, 0]], linear[[2, 0, 1]])
    with np.errstate(invalid="ignore"):
        return np.asarray(np.copysign(1.0, np.linalg.det(linear)) * normals @ cofactors.T)


def _colour(material: Any, pictures: dict[int, Texture], alpha: bool) -> tuple[Texture | None, Array]:
    """Return the base colour picture and factor, both linear, of a material as trimesh holds it."""
    channels = 4 if alpha else 3
    import trimesh

    if isinstance(material, trimesh.visual.material.PBRMaterial):
        image, factor = material.baseColorTexture, material.baseColorFactor
        # trimesh keeps the factor as bytes.
        colour = np.ones(channels) if factor is None else np.asarray(factor, dtype=np.float64)[:channels] / 255.0
    elif isinstance(material, trimesh.visual.material.SimpleMaterial):
        # Its diffuse colour is 0.4 where the MTL gives none; what the file says stands under its own key.
        image = material.image
        colour = np.ones(channels)
        colour[:3] = material.kwargs.get("kd", np.ones(3))
    else:
        return None, np.ones(channels)
    if image is None:
        return None, colour
    if image.format is not None and image.format not in FORMATS:
        raise ValueError(f"its picture is {image.format}; valid are {', '.join(FORMATS)}")
    if image.size[0] * image.size[1] > MOST_PIXELS:
        raise ValueError(f"its picture has {image.size[0]} × {image.size[1]} pixels; {MOST_PIXELS} are the most")
    if id(image) not in pictures:
        light = linear_light(image)
        pictures[id(image)] = with_alpha(light, image) if alpha else light
    return pictures[id(image)], colour


def _shortened(text: str) -> str:
    return text if len(text) <= 200 else f"{text[:197]}..."


def gltf_document(path: Path) -> dict[str, Any]:
    """Return the JSON of a glTF or GLB file (glTF 2.0, section 4.4: after the header of 12 bytes the first chunk).

    Raises
    ------
    MeshError
        It is broken, names files that are not there, or requires an extension that would go unread.
    """
    ending = path.suffix.lower()
    content = read_bytes(path)
    try:
        if ending == ".glb":
            if content[:4] != b"glTF" or content[16:20] != b"JSON":
                raise ValueError("its header is not that of a GLB file")
            content = content[20 : 20 + int.from_bytes(content[12:16], "little")]
        document = json.loads(content)
        if not isinstance(document, dict):
            raise ValueError("its JSON is no object")
    except (ValueError, RecursionError) as error:
        reason = _shortened(f"{type(error).__name__}: {error}".splitlines()[0])
        raise MeshError(f"{path}: broken, or not a {ending[1:].upper()} file ({reason})") from None
    _check_gltf(path, document)
    return document


def _check_gltf(path: Path, document: dict[str, Any]) -> None:
    """Raise what trimesh does not look at: files that are not there or none, and tables larger than memory."""
    check_document(path, document)
    for key, kind in (("buffers", "buffer"), ("images", "picture")):
        for entry in _objects(document, key):
            uri = entry.get("uri")
            if not isinstance(uri, str) or uri.startswith("data:"):
                continue
            name = unquote(uri)
            check_companion(path, name, kind)
            if not (path.parent / name).is_file():
                raise MeshError(f"{path}: its {kind} {name} is not there; put it beside the mesh")
    for accessor in _objects(document, "accessors"):
        count = accessor.get("count")
        if not isinstance(count, int) or not 0 <= count <= MOST_ENTRIES:
            raise MeshError(f"{path}: broken: an accessor counts {_shortened(repr(count))} entries")
    for number, material in enumerate(_objects(document, "materials")):
        _check_material(path, f"materials[{number}]", material)


def _check_material(path: Path, where: str, material: dict[str, Any]) -> None:
    """Raise on a value of a material that glTF does not allow, which trimesh passes on."""
    pbr = material.get("pbrMetallicRoughness", {})
    if not isinstance(pbr, dict):
        raise MeshError(f"{path}: {where}.pbrMetallicRoughness is {_shortened(repr(pbr))}; valid is an object")
    for key in ("metallicFactor", "roughnessFactor"):
        if not _is_share(pbr.get(key, 1.0)):
            raise MeshError(f"{path}: {where}.{key} is {_shortened(repr(pbr[key]))}; valid are numbers from 0 to 1")
    colour = pbr.get("baseColorFactor", [1.0] * 4)
    if not isinstance(colour, list) or len(colour) != 4 or not all(map(_is_share, colour)):
        raise MeshError(
            f"{path}: {where}.baseColorFactor is {_shortened(repr(colour))}; valid are four numbers from 0 to 1"
        )
    mode, cutoff = material.get("alphaMode", "OPAQUE"), material.get("alphaCutoff", 0.5)
    if mode not in ALPHA_MODES:
        raise MeshError(f"{path}: {where}.alphaMode is {_shortened(repr(mode))}; valid are {', '.join(ALPHA_MODES)}")
    if isinstance(cutoff, bool) or not isinstance(cutoff, int | float) or not 0.0 <= cutoff < np.inf:
        raise MeshError(f"{path}: {where}.alphaCutoff is {_shortened(repr(cutoff))}; valid are numbers from 0")


def _is_share(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 <= value <= 1.0


def _objects(document: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = document.get(key, [])
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _check_off_count(path: Path, facets: int) -> None:
    """Raise if fewer facets were read than the file's header counts."""
    lines = (line.split("#")[0] for line in read_text(path, errors="replace").splitlines())
    numbers = [word for line in lines for word in line.split() if not word.upper().endswith("OFF")]
    try:
        promised = int(numbers[1])
    except (IndexError, ValueError):
        raise MeshError(
            f"{path}: its header counts no facets; the numbers of vertices, facets and edges must follow the word OFF"
        ) from None
    if facets < promised:
        raise MeshError(f"{path}: cut short: its header counts {promised} facets, {facets} could be read")
