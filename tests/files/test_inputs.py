"""A run holds what its scene reads: moved, it renders again without its sources; a user's file is never lost."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
import trimesh

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import FileError
from lfmesh.files import inputs, run
from lfmesh.files.folder import MANIFEST, manifest_of
from lfmesh.geometry.files.mesh_file import companions, load_mesh
from lfmesh.scene.inputs import files_of
from tests.study.studies import small_scene

Build = Callable[..., lf.Image]


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """Return a folder with a mesh, a mesh with material and picture, and a texture."""
    folder = tmp_path / "project"
    (folder / "parts").mkdir(parents=True)
    trimesh.creation.icosphere(1, 3.0).export(folder / "parts/ball.stl")
    PIL.Image.new("RGB", (4, 4), (200, 30, 30)).save(folder / "chart.png")
    (folder / "wood").mkdir()
    PIL.Image.new("RGB", (4, 4), (90, 60, 30)).save(folder / "wood/oak.png")
    (folder / "board.mtl").write_text("newmtl oak\nKd 1 1 1\nmap_Kd wood/oak.png\n")
    (folder / "board.obj").write_text(
        "mtllib board.mtl\nv 0 0 0\nv 9 0 0\nv 0 9 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl oak\nf 1/1 2/2 3/3\n"
    )
    return folder


@pytest.fixture
def scene_of(scene: lf.Scene, project: Path) -> lf.Scene:
    """Return a scene with all of them."""
    targets = [
        {**scene.targets[0].model_dump(), "material": {"texture": "chart.png"}},
        {"file": "board.obj", "units": "mm", "position_mm": [0.0, 0.0, -400.0]},
        {"refractor": {"file": "parts/ball.stl", "units": "mm", "index": 1.5}, "position_mm": [0.0, 20.0, -400.0]},
    ]
    return scene.changed({"targets": targets}).in_folder(project)


def test_the_files_of_a_scene_are_found_wherever_it_names_them(scene_of: lf.Scene) -> None:
    assert list(files_of(scene_of)) == [
        ("targets[0].material.texture", "chart.png"),
        ("targets[1].file", "board.obj"),
        ("targets[2].refractor.file", "parts/ball.stl"),
    ]


def test_files_that_mesh_files_read_are_found(project: Path) -> None:
    assert companions(project / "board.obj") == ["board.mtl", "wood/oak.png"]
    assert companions(project / "parts/ball.stl") == []
    (project / "b c.bin").write_bytes(b"")
    document = {"buffers": [{"uri": "b%20c.bin"}, {"uri": "data:,"}], "images": [{"uri": "chart.png"}, {}]}
    (project / "part.gltf").write_text(json.dumps(document))
    assert companions(project / "part.gltf") == ["b c.bin", "chart.png"]


def test_a_run_that_was_moved_opens_and_its_scene_reads_the_same(
    image_of: Build, scene_of: lf.Scene, project: Path, tmp_path: Path
) -> None:
    run.save(image_of(scene_of), tmp_path / "run")
    shutil.move(tmp_path / "run", tmp_path / "elsewhere" / "moved")
    shutil.rmtree(project)
    moved = tmp_path / "elsewhere/moved"
    back, again = run.open_run(moved).scene, lf.load(moved / run.SCENE)
    assert back == again
    for scene in (back, again):
        (mesh,) = load_mesh(scene.resolve(scene.targets[1].file or ""), "mm")
        assert mesh.picture is not None
        np.testing.assert_allclose(mesh.picture[0, 0] > 0.0, True)
        assert all(scene.resolve(name).is_file() for _, name in files_of(scene))
    # What is made of it does not copy anything again.
    run.save(image_of(back), tmp_path / "second")
    assert sorted(manifest_of(moved) or {}) == sorted(manifest_of(tmp_path / "second") or {})
    run.save(image_of(back), moved)
    assert run.open_run(moved).scene == back


def test_equal_names_of_different_files_stay_apart(image_of: Build, scene: lf.Scene, tmp_path: Path) -> None:
    names = []
    for name, grey in (("a", 10), ("b", 20), ("c", 10)):
        (tmp_path / name).mkdir()
        PIL.Image.new("L", (2, 2), grey).save(tmp_path / name / "chart.png")
        names.append(f"{name}/chart.png")
    plane = scene.targets[0].model_dump()
    targets = [{**plane, "material": {"texture": name}} for name in names]
    run.save(image_of(scene.changed({"targets": targets}).in_folder(tmp_path)), tmp_path / "run")
    again = lf.load(tmp_path / "run" / run.SCENE)
    pictures = [again.resolve(name).read_bytes() for _, name in files_of(again)]
    assert pictures == [(tmp_path / name).read_bytes() for name in names]
    assert len(list((tmp_path / "run/inputs").iterdir())) == 2


def test_what_is_too_large_to_copy_is_looked_for_and_named(
    image_of: Build, scene_of: lf.Scene, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inputs, "LIMIT_BYTES", (project / "chart.png").stat().st_size + 400)
    run.save(image_of(scene_of), tmp_path / "run")
    assert {path.name for path in (tmp_path / "run/inputs").rglob("*.*")} == {
        "chart.png", "board.obj", "board.mtl", "oak.png"
    }  # fmt: skip
    back = run.open_run(tmp_path / "run").scene
    glass = back.targets[2].refractor
    assert glass is not None
    assert back.resolve(glass.file).samefile(project / "parts/ball.stl")

    # Moved, the run looks beside itself.
    (tmp_path / "deep/er").mkdir(parents=True)
    shutil.move(tmp_path / "run", tmp_path / "deep/er/run")
    back = run.open_run(tmp_path / "deep/er/run").scene
    with pytest.raises(FileError, match=r"ball\.stl is missing, but the run began with it") as caught:
        back.resolve(glass.file)
    assert "\n" not in str(caught.value)
    shutil.copy(project / "parts/ball.stl", tmp_path / "deep/er/ball.stl")
    assert back.resolve(glass.file) == tmp_path / "deep/er/ball.stl"

    trimesh.creation.icosphere(1, 4.0).export(tmp_path / "deep/er/ball.stl")
    back = run.open_run(tmp_path / "deep/er/run").scene
    with pytest.raises(FileError, match=r"ball\.stl has changed since the run began"):
        back.resolve(glass.file)


def test_a_copy_that_was_changed_is_named(image_of: Build, scene_of: lf.Scene, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run.save(image_of(scene_of), folder)
    PIL.Image.new("L", (9, 9)).save(folder / "inputs/chart.png")
    scene = run.open_run(folder).scene
    with pytest.raises(FileError, match=r"chart\.png has changed"):
        scene.resolve(scene.targets[0].material.texture or "")


def test_commands_work_on_a_run_that_was_moved_and_never_replace_a_users_scene(
    scene: lf.Scene, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    shining = {"reflectance": 0.0, "radiance_w_m2_sr": 1.0, "texture": "chart.png"}
    given = scene.changed({"targets[0].material": shining, "transport.samples": 16, "transport.split": "transmit"})
    (project / "scene.toml").write_text(given.dump_toml())
    assert main(["render", "project/scene.toml", "-o", "run"]) == 0
    pixels = run.pixels_digest(tmp_path / "run")
    (tmp_path / "away").mkdir()
    shutil.move("run", "away/moved")
    shutil.rmtree(project)
    for words in (["white", "away/moved"], ["decode", "away/moved"], ["refocus", "away/moved", "--distance-mm", "480"],
                  ["depth", "away/moved", "--samples", "4"], ["render", "away/moved/scene.toml", "-o", "again"],
                  ["render", "away/moved/scene.toml", "-o", "away/moved"]):  # fmt: skip
        assert main(words) == 0, capsys.readouterr().err
    assert run.pixels_digest(tmp_path / "away/moved") == run.pixels_digest(tmp_path / "again") == pixels
    assert not (tmp_path / "away/moved/white.exr").exists()

    mine = (tmp_path / "again/scene.toml").read_text().replace("samples = 16", "samples = 24")
    (tmp_path / "again/scene.toml").write_text(mine)
    capsys.readouterr()
    assert main(["render", "again/scene.toml", "-o", "again"]) == 2
    said = capsys.readouterr().err
    assert "again/scene.toml was edited" in said
    assert said.count("\n") == 1
    assert (tmp_path / "again/scene.toml").read_text() == mine
    assert run.pixels_digest(tmp_path / "again") == pixels
    assert main(["render", "again/scene.toml", "-o", "other"]) == 0


@pytest.mark.parametrize("manifest", [True, False])
def test_a_scene_file_that_was_edited_is_not_replaced(image_of: Build, tmp_path: Path, manifest: bool) -> None:
    run.save(image_of(), tmp_path)
    if not manifest:
        report = json.loads((tmp_path / run.REPORT).read_text())
        report["files"] = list(manifest_of(tmp_path) or {})
        (tmp_path / run.REPORT).write_text(json.dumps(report))
        (tmp_path / MANIFEST).unlink()
        os.utime(tmp_path / run.REPORT, (1e9, 1e9))
        os.utime(tmp_path / run.SCENE, (1e9, 1e9))
    run.prepare(tmp_path)
    mine = (tmp_path / run.SCENE).read_text() + "# my work\n"
    (tmp_path / run.SCENE).write_text(mine)
    with pytest.raises(FileError, match=r"scene\.toml was edited since .* copy it elsewhere"):
        run.prepare(tmp_path)
    assert (tmp_path / run.SCENE).read_text() == mine
    # A render that is done is not lost either.
    for number in ("", "1"):
        run.save(image_of(seconds=9.0), tmp_path)
        assert run.open_run(tmp_path).seconds == 9.0
        assert (tmp_path / f"scene.edited{number}.toml").read_text() == mine
        assert (tmp_path / run.SCENE).read_text() != mine
        run.prepare(tmp_path)
        (tmp_path / run.SCENE).write_text(mine)


def test_white_says_that_an_edited_scene_file_is_not_the_one_it_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lf.save(lf.render(small_scene(samples=4)), tmp_path)
    assert main(["white", str(tmp_path)]) == 0
    assert "edited" not in capsys.readouterr().err
    scene = tmp_path / run.SCENE
    scene.write_text(scene.read_text() + "# my work\n")
    assert main(["white", str(tmp_path)]) == 0
    assert "scene.toml was edited since it was rendered; the white image is of the camera of raw.exr" in " ".join(
        capsys.readouterr().err.split()
    )


def test_a_copied_input_that_was_edited_stays_when_the_run_goes(
    image_of: Build, scene_of: lf.Scene, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run.save(image_of(scene_of), folder)
    (folder / "inputs/chart.png").write_bytes(b"mine")
    with pytest.raises(FileError, match=r"inputs/chart\.png was edited"):
        run.prepare(folder)
    run.save(image_of(), folder)
    assert (folder / "inputs/chart.png").read_bytes() == b"mine"
    assert {path.name for path in (folder / "inputs").iterdir()} == {"chart.png"}
