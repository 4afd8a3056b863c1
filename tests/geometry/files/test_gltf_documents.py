"""glTF files that many targets take their parts from: read once, and again when they change."""

import os
from pathlib import Path

import numpy as np
import pytest

from lfmesh.errors import MeshError
from lfmesh.geometry.files import mesh_file
from lfmesh.geometry.files.mesh_file import load_mesh
from tests.glb import QUAD, SPLIT, Glb


def write(path: Path, shift: float) -> Path:
    glb = Glb()
    mesh = glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT)]})
    for number in range(3):
        glb.node(f"part {number}", mesh=mesh, translation=[shift + number, 0.0, 0.0])
    glb.write(path)
    os.utime(path, (1e9, 1e9))
    return path


def middle(path: Path, part: int) -> float:
    (piece,) = load_mesh(path, node=f"part {part}")
    return float(np.mean(piece.mesh.vertices[:, 0]))


def test_a_file_is_parsed_once_for_all_of_its_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "parts.glb", 0.0)
    parsed = []
    loads = mesh_file.json.loads
    monkeypatch.setattr(mesh_file.json, "loads", lambda text: parsed.append(path) or loads(text))
    assert [middle(path, part) for part in range(3)] == [0.0, 1000.0, 2000.0]
    assert len(parsed) == 1


@pytest.mark.parametrize("aged", [False, True])
def test_a_file_that_has_changed_is_parsed_again(tmp_path: Path, aged: bool) -> None:
    """Even within one tick of the file system's clock, with the size unchanged."""
    for shift in (1.0, 2.0):
        path = write(tmp_path / "parts.glb", shift)
        if not aged:
            os.utime(path)
        assert middle(path, 1) == 1000.0 * (1.0 + shift)


def test_a_buffer_that_has_gone_is_told_though_its_document_is_known(tmp_path: Path) -> None:
    path = tmp_path / "part.gltf"
    glb = Glb()
    glb.node("part", mesh=glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT)]}))
    buffer = tmp_path / "part.bin"
    buffer.write_bytes(glb.data)
    tree = glb.tree | {"buffers": [{"byteLength": len(glb.data), "uri": buffer.name}]}
    path.write_text(mesh_file.json.dumps(tree))
    assert load_mesh(path)
    buffer.unlink()
    with pytest.raises(MeshError, match=r"part\.bin is missing"):
        load_mesh(path)


def test_words_of_an_extension_that_is_not_read_are_its_own(tmp_path: Path) -> None:
    """EXT_meshopt_compression has a mode that is a text, and others have attributes that are lists."""
    glb = Glb()
    glb.node("part", mesh=glb.add("meshes", {"primitives": [glb.primitive(QUAD, SPLIT)]}))
    words = {"EXT_meshopt_compression": {"mode": "TRIANGLES"}, "KHR_techniques_webgl": {"attributes": ["normal"]}}
    glb.tree["bufferViews"][0]["extensions"] = words
    glb.write(tmp_path / "part.glb")
    assert load_mesh(tmp_path / "part.glb")
    glb.tree["extensionsRequired"] = ["EXT_meshopt_compression"]
    glb.write(tmp_path / "part.glb")
    with pytest.raises(MeshError, match="requires the extension 'EXT_meshopt_compression', which is not read"):
        load_mesh(tmp_path / "part.glb")


def test_a_file_of_the_first_version_is_refused_by_its_version(tmp_path: Path) -> None:
    (tmp_path / "old.gltf").write_text('{"asset": {"version": "1.0"}, "nodes": {"part": {}}}')
    with pytest.raises(MeshError, match=r"old\.gltf: is glTF of version 1\.0; valid is 2: export it as glTF 2\.0"):
        load_mesh(tmp_path / "old.gltf")
