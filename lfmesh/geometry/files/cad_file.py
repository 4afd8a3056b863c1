"""STEP and 3MF files: bodies in mm, and the surfaces that the faces of a STEP body lie on.

Both kinds can ask for any time and memory, and what reads STEP is a large library that may crash on a broken file. So
each is opened by `cad_child` in a process of its own, within limits; what it made is kept while the file is the same.
"""

import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from lfmesh.errors import MeshError
from lfmesh.geometry.files import cad_child, step_surfaces
from lfmesh.geometry.meshes.mesh import Array
from lfmesh.geometry.surfaces.optical_face import Told
from lfmesh.scene.inputs import file_stamp

STEP_ENDINGS = (".step", ".stp")
ENDINGS = (*STEP_ENDINGS, ".3mf")
"""Of files that name their own unit."""

MOST_BYTES = 2**28
"""Of a file."""

MOST_SECONDS = 25
"""For opening one."""

MOST_MEBIBYTES, MOST_OUTPUT_MEBIBYTES = 1536, 128
"""Memory of the process that opens a file, and the size of what it makes of it."""

MM_PER_METRE = 1e3
"""glTF 2.0, section 3.4: all linear distances are metres."""

STRETCHED = 1e-12
"""How far a body's frame may be from a rotation: rounding."""


def bodies_of_3mf(path: Path) -> list[tuple[str, Array, Array]]:
    """Return name, vertices (n, 3) in mm and facets (m, 3) of the bodies that stand in a 3MF file.

    Raises
    ------
    MeshError
        The file is broken, or opening it takes more than the limits.
    """
    with np.load(io.BytesIO(_opened(path.resolve(), file_stamp(path), None)), allow_pickle=False) as arrays:
        return [(str(name), arrays[f"vertices_{k}"], arrays[f"faces_{k}"]) for k, name in enumerate(arrays["names"])]


@contextmanager
def step_as_glb(path: Path, tolerance_mm: float | None) -> Iterator[Path]:
    """Yield a GLB file of the bodies of a STEP file, which is deleted afterwards.

    Parameters
    ----------
    path : Path
    tolerance_mm : float, optional
        How far a facet may lie off its surface; omitted, 3e-4 of the size of the largest body.

    Raises
    ------
    MeshError
        The file is broken, opening it takes more than the limits, or the library that opens it is not there. Its
        message names the STEP file, too where the GLB file is found wrong.
    """
    content = _opened(path.resolve(), file_stamp(path), tolerance_mm)
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "solid.glb"
        glb.write_bytes(content)
        try:
            yield glb
        except MeshError as error:
            raise MeshError(str(error).replace(str(glb), str(path))) from None


@lru_cache(maxsize=8)
def _opened(path: Path, stamp: tuple[object, ...], tolerance_mm: float | None) -> bytes:
    """Return what `cad_child` makes of a file that is the one with this stamp."""
    if path.suffix.lower() in STEP_ENDINGS and find_spec("cascadio") is None:
        raise MeshError(f"{path}: STEP files need cascadio: pip install 'lfmesh[cad]', or save it as STL or GLB")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise MeshError(f"{path}: has {size / 2**20:.0f} MiB; {MOST_BYTES // 2**20} MiB are the most")
    limits = [str(number) for number in (MOST_MEBIBYTES, MOST_OUTPUT_MEBIBYTES, MOST_SECONDS)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        # Not by -m: the package would be loaded, and its compiled parts count as memory.
        command = [sys.executable, "-P", cad_child.__file__, str(path), str(out), repr(tolerance_mm or 0.0), *limits]
        try:
            done = subprocess.run(command, capture_output=True, timeout=MOST_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            raise MeshError(f"{path}: opening it took more than {MOST_SECONDS} s, the most; {_way_out(path)}") from None
        if done.returncode == 0 and out.is_file():
            return out.read_bytes()
    raise MeshError(f"{path}: {_reason(path, done.returncode, done.stderr)}")


def _way_out(path: Path) -> str:
    """Return what to do about a file that asks for too much."""
    if path.suffix.lower() in STEP_ENDINGS:
        return "give a larger tolerance_mm, or save its bodies as STL or GLB"
    return "save it with fewer facets"


def _reason(path: Path, code: int, errors: bytes) -> str:
    """Return why the child failed on a file: what it says, or what its end tells.

    Parameters
    ----------
    path : Path
    code : int
        It ended with.
    errors : bytes
        It wrote.
    """
    lines = errors.decode("utf-8", errors="replace").splitlines()
    said = next((line.removeprefix("unusable: ") for line in lines if line.startswith("unusable: ")), None)
    if said == "memory" or any("bad_alloc" in line or "MemoryError" in line for line in lines):
        return f"opening it took more than {MOST_MEBIBYTES} MiB, the most; {_way_out(path)}"
    if said is not None:
        return said
    if any("File too large" in line for line in lines) or code == -25:
        return f"has more facets than fit into {MOST_OUTPUT_MEBIBYTES} MiB; {_way_out(path)}"
    if code in (-24, -9):
        return f"opening it took more than {MOST_SECONDS} s or {MOST_MEBIBYTES} MiB, the most; {_way_out(path)}"
    if code < 0:
        # OpenCASCADE may crash where it gets no memory, as it may on a file that it does not expect.
        return f"broken, or needs more than {MOST_MEBIBYTES} MiB, the most; {_way_out(path)}"
    last = lines[-1][:200] if lines else f"ended with {code}"
    return f"broken, or of a kind that cannot be read (the program that opened it: {last})"


def named_by_body(document: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of a STEP file's GLB with nodes that go by their body's name, not by that of its place.

    The place of a part in an assembly is often numbered, and the part has the name that its designer gave it.
    """
    meshes = document.get("meshes", [])
    nodes = [
        node | {"name": meshes[node["mesh"]].get("name", node.get("name", ""))} if "mesh" in node else node
        for node in document.get("nodes", [])
    ]
    names = [node.get("name") for node in nodes]
    own = document.get("nodes", [])
    return document | {
        "nodes": [new if names.count(new.get("name")) == 1 else old for new, old in zip(nodes, own, strict=True)]
    }


def surfaces_of_nodes(
    path: Path, document: dict[str, Any], nodes: list[tuple[Array, dict[str, Any]]]
) -> list[Told]:  # fmt: skip
    """Return the surfaces that faces of a STEP file may lie on.

    OpenCASCADE tells which planes and spheres its faces lie on. Others are read from the file's own entities; which
    body each belongs to is not, so that each is put into the frame of every body that is meant.

    Parameters
    ----------
    path : Path
        The STEP file.
    document : dict
        JSON of the GLB file that was made of it.
    nodes : list of ((4, 4) float64, dict)
        Place in the scene, m, and entry of the nodes that are meant.
    """
    found: list[Told] = []
    own = _own_surfaces(path.resolve(), file_stamp(path))
    for to_scene, entry in nodes:
        if "mesh" not in entry:
            continue
        place = np.column_stack([to_scene[:3, :3], MM_PER_METRE * to_scene[:3, 3]])
        if not np.allclose(place[:, :3] @ place[:, :3].T, np.eye(3), rtol=0.0, atol=STRETCHED):
            continue
        for primitive in document["meshes"][entry["mesh"]]["primitives"]:
            told = primitive.get("extensions", {}).get("TM_brep_faces", {}).get("faces", [])
            found += [Told(face, place) for each in told if (face := _face_of_kernel(each)) is not None]
        found += [Told(each, place) for each in own]
    return found


def _face_of_kernel(told: Any) -> dict[str, Any] | None:
    """Return one face that OpenCASCADE tells, as `step_surfaces` writes surfaces, if it is a plane or sphere."""
    if not isinstance(told, dict) or told.get("type") not in ("plane", "sphere"):
        return None
    is_plane = told["type"] == "plane"
    at = [MM_PER_METRE * each for each in told["origin" if is_plane else "center"]]
    if is_plane:
        return {"kind": "plane", "at": at, "axis": told["normal"]}
    return {"kind": "sphere", "at": at, "radius": MM_PER_METRE * told["radius"]}


@lru_cache(maxsize=8)
def _own_surfaces(path: Path, stamp: tuple[object, ...]) -> list[dict[str, Any]]:
    """Return the surfaces that `step_surfaces` reads from a file; none where it comes to no end within the limits."""
    limits = [str(number) for number in (MOST_MEBIBYTES, MOST_SECONDS)]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        command = [sys.executable, "-P", step_surfaces.__file__, str(path), str(out), *limits]
        try:
            done = subprocess.run(command, capture_output=True, timeout=MOST_SECONDS, check=False)
        except subprocess.TimeoutExpired:
            return []
        if done.returncode or not out.is_file():
            return []
        surfaces: list[dict[str, Any]] = json.loads(out.read_text())
        return surfaces


def placed_3mf(path: Path, key: str | int | None) -> list[tuple[Any, Array]]:
    """Return trimesh's geometries of a 3MF file, or of one of its bodies, with their transforms.

    Parameters
    ----------
    path : Path
    key : str or int, optional
        A body's name, which other bodies may not have, or its number from 0.

    Raises
    ------
    MeshError
        The file cannot be read, or has no such body.
    """
    import trimesh

    bodies = bodies_of_3mf(path)
    if key is not None:
        chosen = [body for number, body in enumerate(bodies) if key == (body[0] if isinstance(key, str) else number)]
        if len(chosen) != 1:
            names = [body[0] for body in bodies]
            known = ", ".join(repr(name) if names.count(name) == 1 else str(k) for k, name in enumerate(names[:10]))
            raise MeshError(f"{path}: has no body {key!r} of its own; valid are {known or 'none: it is empty'}")
        bodies = chosen
    return [(trimesh.Trimesh(vertices, faces, process=False), np.eye(4)) for _, vertices, faces in bodies]
