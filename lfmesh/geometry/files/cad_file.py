"""STEP and 3MF files: bodies in mm, and the surfaces of a STEP body's faces.

Both formats can demand unlimited time and memory, and the large library that reads STEP may crash on a broken file.
`cad_child` therefore opens each file in a separate process with resource limits. Results are cached until the file
changes.
"""

import io
import json
import math
import os
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfmesh.errors import LensFileWarning, MeshError
from lfmesh.geometry.files import cad_child, step_surfaces
from lfmesh.geometry.files.piece import Notes, Piece
from lfmesh.geometry.meshes.mesh import Array, Mesh
from lfmesh.geometry.objects.texture import srgb_to_linear
from lfmesh.geometry.surfaces.optical_face import Told
from lfmesh.scene.inputs import file_stamp

STEP_ENDINGS = (".step", ".stp")
ENDINGS = (*STEP_ENDINGS, ".3mf")
"""Endings of files that state their own unit."""

MOST_BYTES = 2**28
"""Largest file."""

MOST_SECONDS, SECONDS_PER_MEBIBYTE = 25, 10
"""CPU time for opening a file: a constant, plus seconds per MiB."""

SECONDS = "LFMESH_CAD_SECONDS"
"""Environment variable that overrides the CPU time."""

WAITING = 60
"""Wall time over CPU time beyond which the process counts as stuck."""

COARSER = ((1.0, 0.6), (10.0, 0.2), (100.0, 0.2))
"""Factors on the tolerance, tried in turn for a STEP file, and the share of the CPU time for each."""

MOST_MEBIBYTES, MOST_OUTPUT_MEBIBYTES = 1536, 128
"""Memory of the process that opens a file, and size of its output."""

MM_PER_METRE = 1e3
"""glTF 2.0, section 3.4: all linear distances are metres."""

LONGEST_REASON = 200
"""Most characters of an error message of that process, which may quote the file."""

OUT_OF_TIME, ENDED_BY_SYSTEM = -24, -9
"""Exit codes of a process ended by SIGXCPU (out of CPU time) and by SIGKILL (out of memory)."""

STRETCHED = 1e-12
"""Deviation of a body's frame from a rotation that counts as rounding."""


@contextmanager
def step_as_glb(path: Path, tolerance_mm: float | None) -> Iterator[Path]:
    """Yield a temporary GLB file with the bodies of a STEP file.

    Parameters
    ----------
    path : Path
    tolerance_mm : float, optional
        Largest distance of a facet from its surface. Default: 3e-4 of the size of the largest body.

    Raises
    ------
    MeshError
        The file is broken, opening it exceeds the limits, or the library for it is not installed. The message names the
        STEP file even if the error is in the GLB file.
    """
    content, doubt = _opened(path.resolve(), file_stamp(path), tolerance_mm, most_seconds(path))
    if doubt:
        warnings.warn(f"{path}: {doubt}", LensFileWarning, stacklevel=2)
    with tempfile.TemporaryDirectory() as folder:
        glb = Path(folder) / "solid.glb"
        glb.write_bytes(content)
        try:
            yield glb
        except MeshError as error:
            raise MeshError(str(error).replace(str(glb), str(path))) from None


@lru_cache(maxsize=8)
def _opened(path: Path, stamp: tuple[object, ...], tolerance_mm: float | None, seconds: int) -> tuple[bytes, str]:
    """Return the output of `cad_child` for a file with this stamp, and a warning or "".

    If the facets of a STEP file exceed their share of the CPU time (s), they are made coarser.
    """
    is_step = path.suffix.lower() in STEP_ENDINGS
    if is_step and find_spec("cascadio") is None:
        raise MeshError(f"{path}: STEP files need cascadio: pip install 'lfmesh[cad]', or save it as STL or GLB")
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise MeshError(f"{path}: has {size / 2**20:.0f} MiB; the limit is {MOST_BYTES // 2**20} MiB")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        for factor, share in COARSER if is_step else ((1.0, 1.0),):
            own = math.ceil(share * seconds)
            done = _child(cad_child.__file__, path, out, own, repr(tolerance_mm or 0.0), repr(factor))
            if done.returncode == 0 and out.is_file():
                return out.read_bytes(), _coarser_in_words(factor, tolerance_mm, seconds)
            if done.returncode != OUT_OF_TIME:
                break
    raise MeshError(f"{path}: {_reason(path, done.returncode, done.stderr, seconds)}")


def _coarser_in_words(factor: float, tolerance_mm: float | None, seconds: int) -> str:
    """Return a warning that facets are coarser than requested by a factor; "" if it is 1."""
    if factor == 1.0:
        return ""
    asked = f"tolerance_mm = {tolerance_mm:g}" if tolerance_mm else "usual"
    return (
        f"making its facets took more than {math.ceil(COARSER[0][1] * seconds)} s of processor time, so they are "
        f"coarser and lie up to {factor:g} times as far off its surfaces as {asked}. Set the environment variable "
        f"{SECONDS} to more than {seconds}, or give a larger tolerance_mm"
    )


def most_seconds(path: Path) -> int:
    """Return the CPU time allowed for opening a file, s: from its size, or from the environment.

    Raises
    ------
    MeshError
        The environment variable is not a whole number above 0.
    """
    given = os.environ.get(SECONDS, "").strip()
    if not given:
        return MOST_SECONDS + SECONDS_PER_MEBIBYTE * path.stat().st_size // 2**20
    if not (given.isdecimal() and int(given) > 0):
        raise MeshError(f"{path}: {SECONDS} = {given[:30]!r}: it must be a whole number of seconds above 0")
    return int(given)


def _child(program: str, path: Path, out: Path, seconds: int, *options: str) -> subprocess.CompletedProcess[bytes]:
    """Run a program on a file, in a separate process with resource limits."""
    limits = [str(number) for number in (MOST_MEBIBYTES, MOST_OUTPUT_MEBIBYTES, seconds)]
    # Not by -m, which would load the package; its compiled parts count as memory.
    command = [sys.executable, "-P", program, str(path), str(out), *options, *limits]
    # If the system cannot limit CPU time, limit wall time instead.
    wait = WAITING * seconds if find_spec("resource") is not None else seconds
    try:
        return subprocess.run(command, capture_output=True, timeout=wait, check=False)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, OUT_OF_TIME, b"", b"")


def _way_out(path: Path) -> str:
    """Return advice on a file that exceeds the limits."""
    if path.suffix.lower() in STEP_ENDINGS:
        return "give a larger tolerance_mm, or save its bodies as STL or GLB"
    return "save it with fewer facets"


def _reason(path: Path, code: int, errors: bytes, seconds: int) -> str:
    """Return the reason why the child failed on a file, from its output or exit code.

    Parameters
    ----------
    path : Path
    code : int
        Exit code.
    errors : bytes
        Standard error.
    seconds : int
        CPU time limit.
    """
    lines = errors.decode("utf-8", errors="replace").splitlines()
    said = next((line.removeprefix("unusable: ") for line in lines if line.startswith("unusable: ")), None)
    if said == "memory" or any("bad_alloc" in line or "MemoryError" in line for line in lines):
        return f"opening it took more than the limit of {MOST_MEBIBYTES} MiB; {_way_out(path)}"
    if said is not None:
        return said[:LONGEST_REASON]
    if any("File too large" in line for line in lines) or code == -25:
        return f"has more facets than fit into {MOST_OUTPUT_MEBIBYTES} MiB; {_way_out(path)}"
    if code == ENDED_BY_SYSTEM:
        return f"the system ended the program that opened it, most likely because memory ran out; {_way_out(path)}"
    if code == OUT_OF_TIME:
        coarser = ", with coarser facets as well" if path.suffix.lower() in STEP_ENDINGS else ""
        return (
            f"opening it took more than {seconds} s of processor time{coarser}; set the environment variable {SECONDS} "
            f"to more, or {_way_out(path)}"
        )
    if code < 0:
        # OpenCASCADE may crash for want of memory as well as on an unexpected file.
        return f"broken, or needs more than the limit of {MOST_MEBIBYTES} MiB; {_way_out(path)}"
    last = lines[-1][:LONGEST_REASON] if lines else f"ended with {code}"
    return f"broken, or of a kind that cannot be read (the program that opened it: {last})"


def named_by_body(document: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of a STEP file's GLB with nodes named after their bodies instead of their places.

    A place in an assembly is often just a number, while the body has the name that its designer gave it.
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

    OpenCASCADE reports planes and spheres. The others are read from the file's own entities without knowing their body,
    so each is put into the frame of every requested body.

    Parameters
    ----------
    path : Path
        The STEP file.
    document : dict
        JSON of the GLB file made from it.
    nodes : list of ((4, 4) float64, dict)
        Transform to the scene, m, and entry of each requested node.
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
    """Return a face reported by OpenCASCADE in the format of `step_surfaces`, if it is a plane or sphere."""
    if not isinstance(told, dict) or told.get("type") not in ("plane", "sphere"):
        return None
    is_plane = told["type"] == "plane"
    at = [MM_PER_METRE * each for each in told["origin" if is_plane else "center"]]
    if is_plane:
        return {"kind": "plane", "at": at, "axis": told["normal"]}
    return {"kind": "sphere", "at": at, "radius": MM_PER_METRE * told["radius"]}


@lru_cache(maxsize=8)
def _own_surfaces(path: Path, stamp: tuple[object, ...]) -> list[dict[str, Any]]:
    """Return the surfaces that `step_surfaces` reads from a file; none if it exceeds the limits."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        done = _child(step_surfaces.__file__, path, out, most_seconds(path))
        if done.returncode or not out.is_file():
            return []
        surfaces: list[dict[str, Any]] = json.loads(out.read_text())
        return surfaces


def pieces_of_3mf(path: Path, key: str | int | None, alpha: bool, notes: Notes) -> list[Piece]:
    """Return a 3MF file, or one of its bodies, as pieces in mm.

    Parameters
    ----------
    path : Path
    key : str or int, optional
        A body's unique name, or its number from 0.
    alpha : bool
        Add an alpha to colours.
    notes : Notes

    Raises
    ------
    MeshError
        The file cannot be read, or has no such body.
    """
    content, _ = _opened(path.resolve(), file_stamp(path), None, most_seconds(path))
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        names = [str(name) for name in arrays["names"]]
        for text in arrays["notes"]:
            notes.add(str(text))
        made = [_piece_of_3mf(arrays, number, alpha) for number in range(len(names))]
    if key is None:
        return made
    chosen = [number for number, name in enumerate(names) if key == (name if isinstance(key, str) else number)]
    if len(chosen) != 1:
        known = ", ".join(repr(name) if names.count(name) == 1 else str(k) for k, name in enumerate(names[:10]))
        raise MeshError(f"{path}: has no body {key!r} of its own; valid are {known or 'none: it is empty'}")
    return [made[chosen[0]]]


def _piece_of_3mf(arrays: Mapping[str, NDArray[Any]], number: int, alpha: bool) -> Piece:
    """Return a body of a 3MF file; facets without a colour get the scene's."""
    mesh = Mesh(arrays[f"vertices_{number}"], arrays[f"faces_{number}"])
    channels = 4 if alpha else 3
    if f"colours_{number}" not in arrays:
        return Piece(mesh, factor=np.ones(channels))
    coded = np.nan_to_num(arrays[f"colours_{number}"], nan=1.0)
    colours = np.ones((*coded.shape[:2], channels))
    colours[..., :3] = srgb_to_linear(coded)
    return Piece(mesh, factor=np.ones(channels), colours=colours)
