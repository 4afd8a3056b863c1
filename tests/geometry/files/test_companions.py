"""Files that a mesh file names: found by reading it once for each state of its contents."""

from pathlib import Path

import pytest

from lfmesh.geometry.files import mesh_file, obj_file, ply_file
from lfmesh.geometry.files.mesh_file import companions

OBJ = "mtllib {}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
PLY = "ply\nformat ascii 1.0\ncomment TextureFile {}\nelement vertex 0\nproperty float x\nend_header\n"
GLTF = '{{"asset": {{"version": "2.0"}}, "images": [{{"uri": "{}"}}]}}'
READERS = {"obj": obj_file, "ply": ply_file, "gltf": mesh_file}


@pytest.mark.parametrize(("ending", "content"), [("obj", OBJ), ("ply", PLY), ("gltf", GLTF)])
def test_a_file_that_stays_as_it_is_is_read_once(
    ending: str, content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / f"body.{ending}"
    for name in ("a.mtl", "b.mtl"):
        (tmp_path / name).write_text("newmtl one\n")
        file.write_text(content.format(name))
        assert companions(file) == [name]
    reader = READERS[ending]
    called = "read_text" if ending == "obj" else "read_bytes"
    read = []
    whole = getattr(reader, called)
    monkeypatch.setattr(reader, called, lambda path, **given: read.append(path.name) or whole(path, **given))
    assert companions(file) == ["b.mtl"]
    assert file.name not in read


def test_pictures_of_a_material_file_that_changes_are_found_anew(tmp_path: Path) -> None:
    (tmp_path / "body.obj").write_text(OBJ.format("a.mtl"))
    for name in ("oak.png", "elm.png"):
        (tmp_path / name).write_bytes(b"")
        (tmp_path / "a.mtl").write_text(f"newmtl one\nmap_Kd {name}\n")
        assert companions(tmp_path / "body.obj") == ["a.mtl", name]
