"""A saved scene file loads to the same scene from wherever it is."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

import lfmesh as lf

SCENE = """\
schema_version = 1
name = "a box on a table"
camera.focus_mm = 500.0
camera.lens = { file = "lib:double_gauss_50mm" }
camera.sensor = { pixels = [4, 4], pixel_mm = 0.5 }
[[targets]]
file = "meshes/box.stl"
units = "mm"
position_mm = [0.0, 0.0, -500.0]
material = { radiance_w_m2_sr = 1.0, reflectance = 0.0 }
[transport]
samples = 4
"""


@pytest.fixture
def scene(tmp_path: Path) -> lf.Scene:
    folder = tmp_path / "first" / "meshes"
    folder.mkdir(parents=True)
    trimesh.creation.box((20.0, 20.0, 20.0)).export(folder / "box.stl")
    return lf.loads(SCENE, tmp_path / "first")


def test_a_saved_scene_loads_elsewhere_to_the_same_picture(scene: lf.Scene, tmp_path: Path) -> None:
    (tmp_path / "second").mkdir()
    saved = lf.save(scene.changed({"camera.focus_mm": 450.0}), tmp_path / "second" / "scene.toml")
    again = lf.load(saved)
    assert again.camera.focus_mm == 450.0
    assert again.name == scene.name
    assert np.array_equal(lf.render(again).mean, lf.render(scene.changed({"camera.focus_mm": 450.0})).mean)
    assert again == lf.load(lf.save(again, tmp_path / "second" / "copy.toml"))


def test_a_scene_file_with_another_ending_is_refused_in_one_line(scene: lf.Scene, tmp_path: Path) -> None:
    with pytest.raises(lf.FileError, match=r"scene\.json: a scene file must end in \.toml"):
        lf.save(scene, tmp_path / "scene.json")
    with pytest.raises(lf.FileError, match=r"none/scene\.toml cannot be written: No such file or directory"):
        lf.save(scene, tmp_path / "none" / "scene.toml")
    assert [path.name for path in tmp_path.iterdir()] == ["first"]
