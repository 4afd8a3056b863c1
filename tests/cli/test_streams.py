"""Streams that are closed, full or without UTF-8 cost no result and end in no traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lfmesh
from lfmesh.cli import main
from lfmesh.errors import FileError
from tests.cameras import bench_camera
from tests.processor_time import HANGS_S

posix = pytest.mark.skipif(os.name != "posix", reason="shells and devices of POSIX")


def shell(folder: Path, command: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command line, in which $LFMESH is the program, in a shell."""
    return subprocess.run(
        ["sh", "-c", command.replace("$LFMESH", f"'{sys.executable}' -m lfmesh")],
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        timeout=HANGS_S,
        env={**os.environ, "PYTHONPATH": str(Path(lfmesh.__file__).parents[1]), **environment},
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "scene.toml").write_text(bench_camera(4, 4))
    return tmp_path


@posix
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_output_that_cannot_be_written_is_said_in_one_line(folder: Path) -> None:
    done = shell(folder, "$LFMESH schema > /dev/full")
    assert done.returncode == 2
    assert done.stderr.startswith("lfmesh: standard output: cannot be written")
    assert done.stderr.count("\n") == 1


@posix
@pytest.mark.parametrize("closed", [">&-", ">&- 2>&- <&-"])
def test_closed_streams_lead_nowhere(folder: Path, closed: str) -> None:
    done = shell(folder, f"$LFMESH schema {closed}")
    assert done.returncode == 0
    assert done.stderr == ""
    assert shell(folder, f"$LFMESH check gone.toml {closed}").returncode == 2


@posix
@pytest.mark.parametrize("command", ["check scene.toml", "check µ.toml", "--help"])
def test_what_a_stream_cannot_show_is_escaped(folder: Path, command: str) -> None:
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii:strict"}
    done = shell(folder, f"$LFMESH {command}", **plain)
    assert done.returncode == (2 if "µ" in command else 0)
    assert "Traceback" not in done.stderr
    assert (done.stdout + done.stderr).isascii()
    if command == "check scene.toml":
        assert r"\xd7" in done.stdout


def test_a_light_field_is_saved_before_anything_is_printed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from lfmesh.cli import lightfield
    from lfmesh.files import field

    done: list[str] = []

    def unprintable(_: object) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(lightfield, "_decoded", lambda *_: object())
    monkeypatch.setattr(lightfield, "_field_in_words", unprintable)
    monkeypatch.setattr(field, "save_field", lambda *_: done.append("saved") or [])
    monkeypatch.setattr("lfmesh.cli.application._give_up_output", lambda: None)
    assert main(["decode", str(folder)]) == 2
    assert done == ["saved"]
    assert "No space left" in capsys.readouterr().err


@posix
def test_a_run_folder_whose_name_is_no_text_is_refused_before_tracing(folder: Path) -> None:
    from lfmesh.files import run

    place = folder / os.fsdecode(b"run-\xff")
    with pytest.raises(FileError, match=r"run-\\xff cannot be written: its path is not UTF-8"):
        run.prepare(place)
    with pytest.raises(FileError, match="must not contain a NUL"):
        run.prepare(folder / "run\0")
    assert [path.name for path in folder.iterdir()] == ["scene.toml"]
