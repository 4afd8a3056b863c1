"""Where a command line went wrong, the way on is named."""

import re
from pathlib import Path

import pytest

from lfmesh.cli import main
from lfmesh.cli.export import _found
from lfmesh.errors import LfmeshError, SceneError
from lfmesh.scene import loads
from lfmesh.study.fits.board_files import read_corners
from tests.cameras import bench_camera


@pytest.mark.parametrize(
    ("line", "command"),
    [("rendr", "lfmesh"), ("render s.toml -o run --sampls 3", "lfmesh render"), ("export run", "lfmesh export")],
)
def test_an_error_in_arguments_points_to_the_commands_help(
    line: str, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    assert capsys.readouterr().err.endswith(f"\nSee: {command} --help\n")


@pytest.mark.parametrize("file", ["part.igs", "part.IGES"])
def test_files_of_cad_that_are_not_read_name_the_way_in(file: str, tmp_path: Path) -> None:
    (tmp_path / file).touch()
    with pytest.raises(SceneError, match="STL or GLB"):
        loads(f'{bench_camera(4, 4)}[[targets]]\nfile = "{file}"\n', tmp_path)


def test_the_depth_of_the_run_is_found_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "depth.exr").touch()
    assert _found(Path("depth.exr"), Path("run")) == Path("run/depth.exr")
    (tmp_path / "depth.exr").touch()
    assert _found(Path("depth.exr"), Path("run")) == Path("depth.exr")
    assert _found(Path("gone.exr"), Path("run")) == Path("gone.exr")


KINDS = {
    "scene.toml": bench_camera(4, 4),
    "lens.toml": "surfaces = [{ radius_mm = 20.0, semi_diameter_mm = 4.0, stop = true }]\n",
    "study.toml": 'scene = "scene.toml"\nmetrics = ["light"]\n',
    "data.toml": 'scene = "scene.toml"\nrandom = []\n',
}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("check lens.toml", "lens.toml: is a lens file, but a scene file is needed: .*camera.lens"),
        ("check study.toml", "study.toml: is a study file, .*: lfmesh study takes it"),
        ("check data.toml", "data.toml: is a dataset file, .*: lfmesh dataset takes it"),
        ("study scene.toml -o out", "scene.toml: is a scene file, but a study file is needed: .*--template assembly"),
        ("study data.toml -o out", "is a dataset file"),
        ("dataset scene.toml -o out", "scene.toml: is a scene file, but a dataset file is needed"),
        ("lens convert scene.toml out.zmx", "scene.toml: is a scene file, but a lens file is needed"),
    ],
)
def test_a_file_of_another_kind_is_named_with_what_takes_it(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, content in KINDS.items():
        (tmp_path / name).write_text(content)
    assert main(words.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert re.search(said, line)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("check {}", "/dev/zero: cannot be read: it is not a regular file but a device"),
        ("study {} -o out", "/dev/zero: cannot be read: it is not a regular file but a device"),
        (
            "fit scene.toml scene.toml -o out --corners {}",
            "/dev/zero: the list of corners cannot be read: it is not a regular file but a device",
        ),
    ],
)
def test_a_file_that_never_ends_is_refused(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not Path("/dev/zero").exists():
        pytest.skip("there is no /dev/zero")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(KINDS["scene.toml"])
    assert main(words.format("/dev/zero").split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_a_list_of_corners_that_is_no_file_is_refused() -> None:
    with pytest.raises(LfmeshError, match="Is a directory"):
        read_corners(Path(__file__).parent)


@pytest.mark.parametrize(
    ("words", "said"),
    [("study study.toml -o out --workers -1", "workers = -1"), ("dataset data.toml -o out --count 0", "count = 0")],
)
def test_a_number_of_processes_or_items_that_makes_no_sense_is_refused(
    words: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(KINDS["scene.toml"])
    axis = '[[axes]]\npath = "camera.mla.pose.shift_mm[0]"\nvalues = [0.01]\n'
    (tmp_path / "study.toml").write_text('scene = "scene.toml"\nmetrics = ["light"]\n' + axis)
    draw = '[[random]]\npath = "camera.mla.pose.shift_mm[0]"\nvalues = [0.01]\n'
    (tmp_path / "data.toml").write_text('scene = "scene.toml"\n' + draw)
    assert main(words.split()) == 2
    assert capsys.readouterr().err.startswith(f"lfmesh: {said}: must be")
    assert not (tmp_path / "out").exists()
