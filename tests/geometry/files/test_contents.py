"""What a mesh file says that it holds is what is read of it, or a warning names the difference.

`LFMESH_SAMPLE_MESHES` may name folders of mesh files, such as those of glTF-Sample-Assets or of trimesh's models.
"""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from lfmesh.errors import MeshError
from lfmesh.geometry.files.contents import Contents, counted, held
from lfmesh.geometry.files.mesh_file import ENDINGS, UNIT_OF_FORMAT, load_mesh

SAMPLES = [Path(each) for each in os.environ.get("LFMESH_SAMPLE_MESHES", "").split(os.pathsep) if each]
PROJECT = Path(__file__).resolve().parents[3]


def compared(path):
    """Return the counts of a file and of what is read of it, and the warnings; None for a file that is refused."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            pieces = load_mesh(path, None if path.suffix.lower() in UNIT_OF_FORMAT else "mm")
        except MeshError:
            return None
    return counted(path), held(pieces), said


@pytest.mark.parametrize("ending", ENDINGS)
def test_counts_are_those_of_what_was_written(tmp_path, ending):
    body = trimesh.creation.box()
    path = tmp_path / f"box{ending}"
    if ending == ".gltf":
        path.write_bytes(trimesh.Scene([body]).export(file_type="gltf", embed_buffers=True)["model.gltf"])
    else:
        body.export(path)
    told, read, _ = compared(path)
    assert told == read
    assert told.facets == 12


def test_counts_tell_materials_pictures_and_colours(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl a\nKd 1 0 0\nnewmtl b # other\nKd 0 1 0\nnewmtl unused\n")
    text = "mtllib m.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nusemtl a\nf 1 2 3\nusemtl b\nf 3 2 1\nf 1 3 2\n"
    (tmp_path / "t.obj").write_text(text)
    told, read, said = compared(tmp_path / "t.obj")
    assert told == read == Contents(3, 2, 0, 3)
    assert not said


def test_meshes_of_the_project_hold_what_they_say():
    paths = [path for path in (PROJECT / "assets").rglob("*") if path.suffix.lower() in ENDINGS]
    assert paths
    for path in paths:
        told, read, said = compared(path)
        assert told == read, path
        assert not said, path


@pytest.mark.skipif(not SAMPLES, reason="LFMESH_SAMPLE_MESHES names no folder of sample files")
def test_sample_files_hold_what_they_say_or_a_warning_tells():
    paths = [path for folder in SAMPLES for path in sorted(folder.rglob("*")) if path.suffix.lower() in ENDINGS]
    found = [(path, compared(path)) for path in paths if path.is_file()]
    silent = [path for path, each in found if each is not None and each[0] != each[1] and not each[2]]
    assert not silent
    assert np.mean([each is not None for _, each in found]) > 0.5
