"""lfmesh white, decode and refocus: what they write, what they say, what they refuse."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.files.field import open_field
from lfmesh.scene import Scene
from lfmesh.transport.render.tracer import Tracer


@pytest.fixture
def folder(camera: Callable[..., Scene], image_of: Callable[..., lf.Image], tmp_path: Path) -> Path:
    """A run folder, its image made by hand."""
    scene = camera()
    mean = np.random.default_rng(1).uniform(1.0, 2.0, scene.camera.sensor.pixels[::-1])
    return lf.save(image_of(scene, mean, 0.1 * mean), tmp_path / "run")


def test_white_then_decode_then_refocus(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["white", str(folder), "--samples", "8", "--replicates", "2"]) == 0
    said = capsys.readouterr().out
    assert "168 of 168 micro-images have a chief ray, 10.084" in said
    assert "pixels off on average" in said
    calibration = json.loads((folder / "calibration.json").read_text())["fields"]
    assert np.shape(calibration["centres_px"]["value"]) == (12, 14, 2)

    assert main(["decode", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "10 × 10 views of 14 × 12 samples, in W/(m² sr)" in said
    field = open_field(folder)
    assert field is not None
    assert "sharply from {:.4g} mm to {:.4g} mm".format(*field.model.refocus_range_mm) in " ".join(said.split())
    assert field.unit == "W/(m² sr)"

    assert main(["refocus", str(folder), "--distance-mm", "480", "620", "--f-number", "8"]) == 0
    assert {"refocused_480mm.exr", "refocused_480mm.png", "refocused_620mm.exr"} <= {p.name for p in folder.iterdir()}
    assert capsys.readouterr().err == ""

    more = ["--stack", "300:800:100", "--all-in-focus", "--distance-mm", "480", "--method", "fourier"]
    assert main(["refocus", str(folder), *more]) == 0
    made = {"stack.exr", "stack.png", "all_in_focus.exr", "refocused_480mm.exr", "refocused_480mm_fourier.exr"}
    assert made <= {path.name for path in folder.iterdir()}


def test_render_makes_the_white_image_where_asked(camera: Callable[..., Scene], tmp_path: Path) -> None:
    target = {"shape": {"kind": "plane", "width_mm": 50.0, "height_mm": 50.0}, "position_mm": (0.0, 0.0, -500.0)}
    glowing = {**target, "material": {"reflectance": 0.0, "radiance_w_m2_sr": 2.0}}
    scene = camera().changed({"targets": [glowing], "transport.samples": 8, "transport.replicates": 2})
    (tmp_path / "scene.toml").write_text(scene.dump_toml())
    assert main(["render", str(tmp_path / "scene.toml"), "-o", str(tmp_path / "run"), "--white"]) == 0
    white = lf.open_white(tmp_path / "run")
    assert white is not None
    field = lf.decode(lf.open_run(tmp_path / "run"), white=white)
    assert np.nanmean(field.data[4:6, 4:6]) == pytest.approx(2.0, rel=0.1)


def test_white_beside_a_render_is_refused_before_anything_is_traced_where_nothing_can_be_decoded(
    camera: Callable[..., Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of arrays with lenslets on both faces, of cylinders, of no array: by a render, one that goes on, and a merge."""
    monkeypatch.chdir(tmp_path)
    plain = camera().changed({"transport.samples": 1, "transport.replicates": 2})
    mla = plain.camera.mla
    assert mla is not None
    two_sided = {"count": mla.count, "pitch_mm": mla.pitch_mm, "index": mla.index, "thickness_mm": mla.thickness_mm}
    arrays = {
        "camera.mla.back": two_sided | {"radius_mm": 0.5, "back": {"radius_mm": 0.6}},
        "camera.mla.cylinder_axis": mla.model_copy(update={"cylinder_axis": "x"}),
        "camera.mla is missing": None,
    }
    for words, array in arrays.items():
        Path("scene.toml").write_text(plain.changed({"camera.mla": array}).dump_toml())
        assert main(["render", "scene.toml", "-o", "run", "--white"]) == 2
        assert words in capsys.readouterr().err
        assert not Path("run").exists()
    for number in (1, 2):
        assert main(["render", "scene.toml", "-o", f"part{number}", "--shard", f"{number}/2"]) == 0
    assert main(["render", "--merge", "part1", "part2", "-o", "run", "--white"]) == 2
    assert words in capsys.readouterr().err
    assert not Path("run/raw.exr").exists()
    usual = Tracer.traced

    def cut(self: Tracer, pool: Any, replicate: int, *rest: Any) -> Any:
        if replicate == 1:
            raise KeyboardInterrupt
        return usual(self, pool, replicate, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(Tracer, "traced", cut)
        assert main(["render", "scene.toml", "-o", "cut"]) == 130
    capsys.readouterr()
    assert main(["render", "--resume", "cut", "--white"]) == 2
    assert words in capsys.readouterr().err
    assert not lf.open_run("cut").complete


def test_refocus_needs_no_decode_before(folder: Path) -> None:
    assert main(["refocus", str(folder), "--distance-mm", "480"]) == 0
    assert (folder / "refocused_480mm.png").is_file()
    assert not (folder / "lightfield.exr").exists()


def test_centres_may_come_from_the_white_image_and_white_may_be_left_out(folder: Path) -> None:
    assert main(["white", str(folder), "--samples", "8", "--replicates", "2"]) == 0
    assert main(["decode", str(folder), "--no-white"]) == 0
    traced = open_field(folder)
    assert main(["decode", str(folder), "--no-white", "--centres", "white-image", "--views", "4"]) == 0
    found = open_field(folder)
    assert traced is not None
    assert found is not None
    assert (traced.unit, found.unit) == ("W per pixel", "W per pixel")
    assert (traced.views, found.views) == ((10, 10), (4, 4))
    assert not np.array_equal(traced.data[3:7, 3:7], found.data)


def test_a_plane_beyond_the_range_is_noted(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["refocus", str(folder), "--distance-mm", "200"]) == 0
    assert "Note: 200 mm lies beyond the range" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "fault"),
    [
        (["refocus"], "nothing to focus on"),
        (["refocus", "--distance-mm", "480", "--all-in-focus"], "needs --stack FIRST"),
        (["refocus", "--stack", "300:800"], "give three numbers"),
        (["refocus", "--stack", "450:550:0"], "--stack 450:550:0: STEP = 0: must not be 0"),
        (["refocus", "--stack", "450:550:-0.0"], "STEP = -0: must not be 0"),
        (["refocus", "--stack", "800:300:20"], "the steps must lead"),
        (["refocus", "--stack", "-300:800:20"], "the steps must lead"),
        (["refocus", "--stack", "300:800:0.001"], "1000 at most"),
        (["refocus", "--stack", "300:nan:20"], "give three numbers"),
        (["refocus", "--distance-mm", "20"], "must lie before the front focal point"),
        (["refocus", "--distance-mm", "480", "--f-number", "1"], "f_number = 1"),
        (["decode", "--views", "0"], "views = 0"),
        (["decode", "--centres", "white-image"], "has no white.exr; make it with lfmesh white"),
        (["decode", "--centres", "guessed"], "guessed"),
    ],
)
def test_wrong_options_are_told_in_one_message_and_nothing_is_written(
    folder: Path, capsys: pytest.CaptureFixture[str], words: list[str], fault: str
) -> None:
    before = {path.name for path in folder.iterdir()}
    assert main([words[0], str(folder), *words[1:]]) == 2
    assert fault in " ".join(capsys.readouterr().err.split())
    assert {path.name for path in folder.iterdir()} == before


def spoilt(folder: Path, how: str, camera: Callable[..., Scene], image_of: Callable[..., lf.Image]) -> None:
    if how == "incomplete":
        (folder / "report.json").unlink()
    elif how == "truncated":
        raw = (folder / "raw.exr").read_bytes()
        (folder / "raw.exr").write_bytes(raw[: len(raw) // 2])
    elif how == "foreign":
        report = json.loads((folder / "report.json").read_text())
        (folder / "report.json").write_text(json.dumps({**report, "format": 99}))
    elif how == "conventional":
        scene = camera().changed({"camera.mla": None})
        lf.save(image_of(scene, np.ones(scene.camera.sensor.pixels[::-1])), folder)


@pytest.mark.parametrize("command", [["white"], ["decode"], ["refocus", "--distance-mm", "480"]])
@pytest.mark.parametrize(
    ("how", "fault"),
    [
        ("incomplete", "not a complete run: report.json missing"),
        ("truncated", "truncated"),
        ("foreign", "run format 99"),
        ("conventional", "conventional camera"),
    ],
)
def test_a_bad_run_folder_gets_one_clear_line(
    folder: Path, camera: Callable[..., Scene], image_of: Callable[..., lf.Image], capsys: pytest.CaptureFixture[str],
    command: list[str], how: str, fault: str,
) -> None:  # fmt: skip
    spoilt(folder, how, camera, image_of)
    capsys.readouterr()
    before = {path.name for path in folder.iterdir()}
    assert main([command[0], str(folder), *command[1:]]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("lfmesh: ")
    assert fault in line
    assert {path.name for path in folder.iterdir()} == before
