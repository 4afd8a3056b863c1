"""New scenes: a camera of the library with another lens, or with a mesh in front of it."""

import shutil
import tomllib
from pathlib import Path

import pytest

from lfmesh.assets import asset_path
from lfmesh.errors import SceneError
from lfmesh.scene import FirstOrder, loads, solved
from lfmesh.scene.camera_library import camera_names, library_camera
from lfmesh.scene.first_order.compute import facts_of_solved
from lfmesh.scene.new_scene import new_scene


def facts_of(text: str, folder: Path) -> FirstOrder:
    return facts_of_solved(solved(loads(text, folder)))


def test_without_lens_and_target_it_is_the_librarys_text(tmp_path: Path) -> None:
    for name in camera_names():
        assert new_scene(name, tmp_path) == library_camera(name).text


@pytest.mark.parametrize("name", ["ng_2005_handheld", "raytrix_r12", "auburn_piv"])
def test_another_lens_keeps_the_plane_in_focus_and_the_f_number_at_the_array(name: str, tmp_path: Path) -> None:
    published = facts_of(library_camera(name).text, tmp_path)
    text = new_scene(name, tmp_path, lens="lib:double_gauss_100mm")
    found = facts_of(text, tmp_path)
    assert found.efl_mm == pytest.approx(100.0, rel=1e-3)
    # Numbers are written with six digits.
    assert found.object_distance_mm == pytest.approx(published.object_distance_mm, rel=1e-4)
    assert found.working_f_number == pytest.approx(published.working_f_number, rel=1e-5)
    assert found.kind == published.kind
    assert "# The lens is lib:double_gauss_100mm: figures of the source that depend on the lens do not hold.\n" in text


def test_another_lens_changes_the_lens_alone(tmp_path: Path) -> None:
    before = tomllib.loads(library_camera("ng_2005_handheld").text)
    after = tomllib.loads(new_scene("ng_2005_handheld", tmp_path, lens="lib:tessar_50mm"))
    lens = after["camera"].pop("lens")
    assert lens.keys() == {"file", "f_number"}
    assert lens["file"] == "lib:tessar_50mm"
    del before["camera"]["lens"]
    assert after == before


def test_a_mesh_stands_in_the_plane_in_focus_under_a_lamp(tmp_path: Path) -> None:
    for name in camera_names():
        text = new_scene(name, tmp_path, target=asset_path("meshes/bracket.stl"))
        scene = loads(text, tmp_path)
        (target,), (lamp,) = scene.targets, scene.lights
        assert not scene.particles
        assert (target.units, target.anchor) == ("mm", "centre")
        assert target.position_mm[:2] == (0.0, 0.0)
        assert -target.position_mm[2] == pytest.approx(facts_of(text, tmp_path).object_distance_mm, rel=1e-5)
        assert target.position_mm[2] < lamp.position_mm[2] < 0.0
        assert scene.camera == loads(library_camera(name).text, tmp_path).camera


def test_files_are_named_from_the_folder_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "scenes").mkdir()
    shutil.copy(asset_path("meshes/bracket.stl"), tmp_path / "parts" / "a part.stl")
    shutil.copy(asset_path("lenses/cooke_triplet_50mm.toml"), tmp_path / "parts")
    text = new_scene(
        "ng_2005_handheld",
        tmp_path / "scenes",
        lens=str(tmp_path / "parts" / "cooke_triplet_50mm.toml"),
        target=tmp_path / "parts" / "a part.stl",
    )
    data = tomllib.loads(text)
    assert data["camera"]["lens"]["file"] == "../parts/cooke_triplet_50mm.toml"
    assert data["targets"][0]["file"] == "../parts/a part.stl"


def test_formats_with_units_and_materials_keep_them(tmp_path: Path) -> None:
    data = tomllib.loads(new_scene("ng_2005_handheld", tmp_path, target=asset_path("meshes/board.glb")))
    assert data["targets"][0].keys() == {"name", "file", "anchor", "position_mm", "rotation_deg"}


def test_a_lens_or_mesh_that_does_not_fit_is_named_with_its_option(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"--lens lib:tesar_50mm: .*did you mean 'tessar_50mm'"):
        new_scene("ng_2005_handheld", tmp_path, lens="lib:tesar_50mm")
    with pytest.raises(SceneError, match=r"--target missing\.stl: .*missing\.stl"):
        new_scene("ng_2005_handheld", tmp_path, target=Path("missing.stl"))
    (tmp_path / "part.iges").write_text("")
    with pytest.raises(SceneError, match=r"--target .*part\.iges: .*STEP"):
        new_scene("ng_2005_handheld", tmp_path, target=tmp_path / "part.iges")


def test_an_unknown_camera_is_answered_with_the_valid_names(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as raised:
        new_scene("raytrix_r21", tmp_path)
    assert "no camera 'raytrix_r21' (did you mean 'raytrix_r12'?)" in str(raised.value)
    assert ", ".join(camera_names()) in str(raised.value)
