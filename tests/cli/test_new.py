"""lfmesh new: the scenes that it writes, the library that it lists, and its refusals."""

from pathlib import Path

import pytest

from lfmesh.assets import asset_path
from lfmesh.cli import main
from lfmesh.scene import load, load_lens
from lfmesh.scene.camera_library import camera_names, library_camera


def said(capsys: pytest.CaptureFixture[str]) -> str:
    done = capsys.readouterr()
    return " ".join((done.out + done.err).split())


def test_the_list_has_every_camera_with_its_source(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "--list"]) == 0
    out = said(capsys)
    places = [
        out.index(f"{name}: {library_camera(name).title} {library_camera(name).source}") for name in camera_names()
    ]
    assert places == sorted(places)
    assert {path.stem for path in asset_path("cameras").iterdir()} == set(camera_names())


@pytest.mark.parametrize("name", camera_names())
def test_the_written_file_is_commented_loads_and_passes_check(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.toml"
    assert main(["new", str(scene), "--camera", name]) == 0
    assert f"lfmesh check {scene}".replace(" ", "") in said(capsys).replace(" ", "")
    assert scene.read_text(encoding="utf-8") == library_camera(name).text
    assert main(["check", str(scene)]) == 0
    assert "effective focal length" in said(capsys)


def test_lens_and_target_are_in_the_written_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.stl").write_bytes(asset_path("meshes/bracket.stl").read_bytes())
    words = ["--camera", "ng_2005_handheld", "--lens", "lib:double_gauss_100mm", "--target", "part.stl"]
    assert main(["new", "scene.toml", *words]) == 0
    scene = load("scene.toml")
    assert scene.camera.lens.name == load_lens("lib:double_gauss_100mm").name
    assert [target.name for target in scene.targets] == ["part"]


def test_a_file_that_is_there_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text("mine")
    assert main(["new", str(scene), "--camera", "ng_2005_handheld"]) == 2
    assert "scene.toml is there already: move it, or give another name" in said(capsys)
    assert scene.read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--camera", "ng_2005"], "no camera 'ng_2005'"),
        (["--camera", "ng_2005"], "there are: auburn_piv, levoy_2006_microscope, lytro_illum, ng_2005_handheld, "),
        ([], "--camera: missing; there are: auburn_piv, "),
        (["--camera", "raytrix_r12", "--lens", "missing.zmx"], "--lens missing.zmx: "),
        (["--camera", "raytrix_r12", "--target", "missing.stl"], "--target missing.stl: "),
    ],
)
def test_mistakes_are_one_message_and_nothing_is_written(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "scene.toml", *words]) == 2
    assert message in said(capsys)
    assert not list(tmp_path.iterdir())


def test_a_scene_must_be_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "--camera", "ng_2005_handheld"]) == 2
    assert "scene: missing; give the scene file to write, such as scene.toml" in said(capsys)
