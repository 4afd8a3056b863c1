"""What a user names is read if it is a regular file; pipes, sockets and devices never make anything wait."""

import ast
import os
import signal
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import pytest

import lfmesh
from lfmesh.cli import main
from lfmesh.errors import LfmeshError
from lfmesh.geometry.files.mesh_file import load_mesh
from lfmesh.geometry.voxels import read_voxels
from lfmesh.regular_file import open_text, read_bytes, read_text, why_no_file
from lfmesh.scene import loads
from tests.cameras import bench_camera

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")

PACKAGE = Path(lfmesh.__file__).parent

ENDINGS = ["toml", "zmx", "seq", "png", "exr", "csv", "npz", "stl", "ies", "run"]

COMMANDS = [
    *["check {}.toml", "draw {}.toml -o o.svg", "render {}.toml -o out", "frames {}.toml -o out"],
    *["compare {}.toml -o out", "view {}.toml --screenshot o.png", "accuracy {}.toml -o out"],
    *["lens sheet {}.toml -o o.pdf", "lens convert {}.toml o.zmx", "lens convert {}.zmx o.toml"],
    *["lens convert {}.seq o.toml", "camera-model {}.toml -o o.exr"],
    *["study {}.toml -o out", "study {}.toml --template assembly -o o.toml", "dataset {}.toml -o out"],
    "optimise {}.toml -o out",
    *["matrix {}.toml --counts 2 2 2 --size-mm 1 1 1 -o o.npz", "matrix scene.toml --grid {}.npz -o o.npz"],
    *["fit {}.png scene.toml -o out", "fit {}.exr scene.toml -o out", "fit {}.run scene.toml -o out"],
    *["fit {}.png {}.toml -o out", "fit white.png scene.toml -o out --corners {}.csv"],
    "fit white.png scene.toml -o out --board {}.png --square-mm 5 --grid 3 3",
    *["render --resume {}.run", "render --merge {}.run -o out"],
    *["white {}.run", "decode {}.run", "refocus {}.run --distance-mm 500", "depth {}.run", "expose {}.run"],
    *["export {}.run --format hci -o out", "view {}.run --screenshot o.png"],
]
"""With every input that a command has in turn; {} is what is no file."""

SPHERE = '[[targets]]\nshape = {{ kind = "sphere", radius_mm = 1.0 }}\n'
LAMP = '[[lights]]\nkind = "point"\nposition_mm = [0.0, 9.0, -9.0]\npower_w = 1.0\n'
FIELDS = {
    '[[targets]]\nfile = "{}.stl"\nunits = "mm"\nposition_mm = [0.0, 0.0, -540.0]': "targets[0].file",
    SPHERE + 'material.texture = "{}.png"': "targets[0].material.texture",
    SPHERE + 'material.spectrum.file = "{}.csv"': "material.spectrum.file",
    LAMP + 'profile = "{}.ies"': "lights[0].profile",
    '[[media]]\nbounds = {{ file = "{}.stl", units = "mm" }}\nabsorption_per_mm = 0.1': "media[0].bounds.file",
    '[[media]]\ngrid.file = "{}.npz"': "media[0].grid.file",
    '[[camera.sensor.bands]]\nname = "r"\nresponse = "{}.csv"': "response",
}


class Waited(BaseException):
    """Something waited for what is no file."""


@pytest.fixture(autouse=True)
def _alarmed() -> Iterator[None]:
    def ring(_: int, __: FrameType | None) -> None:
        raise Waited

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with pipes, sockets, devices and folders under every ending, beside a scene and a white image."""
    folder = tmp_path_factory.mktemp("i")
    kept = []
    for ending in ENDINGS:
        os.mkfifo(folder / f"pipe.{ending}")
        (folder / f"device.{ending}").symlink_to("/dev/zero")
        (folder / f"terminal.{ending}").symlink_to("/dev/tty")
        (folder / f"folder.{ending}").mkdir()
        bound = socket.socket(socket.AF_UNIX)
        here = Path.cwd()
        os.chdir(folder)
        bound.bind(f"socket.{ending}")  # a short name: a socket's has 107 characters at most
        os.chdir(here)
        kept.append(bound)
    (folder / "scene.toml").write_text(bench_camera(4, 4))
    (folder / "white.png").write_bytes((PACKAGE.parent / "assets" / "pictures" / "near.png").read_bytes())
    yield folder
    for bound in kept:
        bound.close()


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize("words", COMMANDS)
def test_a_command_refuses_what_is_no_file_in_one_line(
    words: str, kind: str, place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(place)
    before = set(place.iterdir())
    assert main(words.format(kind, kind).split()) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert f"{kind}." in line
    assert not out
    assert set(place.iterdir()) == before


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize("lens", ["zmx", "seq", "toml"])
def test_a_scene_refuses_a_lens_that_is_no_file(lens: str, kind: str, place: Path) -> None:
    start = bench_camera(4, 4).index("surfaces = [")
    text = bench_camera(4, 4)
    end = text.index("[camera.mla]")
    with pytest.raises(LfmeshError, match=rf"camera\.lens\.file = \"{kind}\.{lens}\"") as refused:
        loads(f'{text[:start]}file = "{kind}.{lens}"\n{text[end:]}', place)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
@pytest.mark.parametrize("field", FIELDS)
def test_a_scene_refuses_a_file_of_its_own_that_is_none(field: str, kind: str, place: Path) -> None:
    with pytest.raises(LfmeshError) as refused:
        loads(f"{bench_camera(4, 4)}{field.format(kind)}\n", place)
    assert FIELDS[field] in str(refused.value)
    assert "is a folder" in str(refused.value) or "is not a regular file but a" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("kind", ["pipe", "device", "socket", "folder"])
def test_python_refuses_what_is_no_file(kind: str, place: Path, tmp_path: Path) -> None:
    calls = [
        lambda: lfmesh.load(place / f"{kind}.toml"),
        lambda: lfmesh.open_run(place / f"{kind}.run"),
        lambda: lfmesh.open_projection_matrix(place / f"{kind}.npz"),
        lambda: load_mesh(place / f"{kind}.stl", "mm"),
        lambda: read_voxels(place / f"{kind}.npz"),
    ]
    for call in calls:
        with pytest.raises(LfmeshError) as refused:
            call()
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["report.json", "manifest.json", "raw.exr", "scene.toml", "checkpoint.npz"])
def test_a_run_with_a_pipe_for_a_file_is_refused(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    for words in (
        f"decode {tmp_path}",
        f"render --resume {tmp_path}",
        f"view {tmp_path} --screenshot {tmp_path}/o.png",
    ):
        assert main(words.format(tmp_path).split()) == 2


def test_what_is_no_file_is_named() -> None:
    assert why_no_file(Path("/dev/null")) == "is not a regular file but a device"


def test_a_pipe_that_takes_the_place_of_a_file_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if it came between the look at the path and its opening."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file").write_text("text")
    seen = (tmp_path / "file").stat()
    monkeypatch.setattr("lfmesh.regular_file.os.stat", lambda _: seen)
    with pytest.raises(OSError, match="it is not a regular file but a pipe"):
        read_bytes(tmp_path / "pipe")


def test_a_file_is_read_to_its_end(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"\xef\xbb\xbfa\r\n" * 300_000)
    assert read_bytes(tmp_path / "file") == b"\xef\xbb\xbfa\r\n" * 300_000
    assert read_text(tmp_path / "file", "utf-8-sig").startswith("a\n")
    with open_text(tmp_path / "file", "latin-1", newline="") as file:
        assert file.readline().endswith("a\r\n")


def test_a_scene_comes_through_standard_input_where_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(bench_camera(4, 4))
    with (tmp_path / "scene.toml").open("rb") as file:
        assert lfmesh.load(f"/dev/fd/{file.fileno()}") is not None


def test_a_pipe_that_is_written_to_is_refused_too(tmp_path: Path) -> None:
    """A scene's other files are looked for beside it, and a pipe is beside nothing."""
    os.mkfifo(tmp_path / "scene.toml")
    reader = os.open(tmp_path / "scene.toml", os.O_RDONLY | os.O_NONBLOCK)
    threading.Thread(target=(tmp_path / "scene.toml").write_text, args=(bench_camera(4, 4),), daemon=True).start()
    with pytest.raises(LfmeshError, match="not a regular file but a pipe"):
        lfmesh.load(tmp_path / "scene.toml")
    os.close(reader)


OWN = {
    "regular_file.py",
    *["cli/lens.py", "optics/cie.py", "optics/rgb_spectra.py"],  # tables that come with lfmesh
    *["kernels/cache.py", "view/browser/page.py", "view/browser/sessions.py", "view/output/html.py"],  # our own files
    *[
        "geometry/files/cad_file.py",
        "geometry/files/cad_child.py",
        "geometry/files/step_surfaces.py",
    ],  # what our own process wrote, or was looked at before
    *["accuracy/lens_accuracy.py"],  # /proc
}


def test_every_file_is_read_by_way_of_the_check() -> None:
    reading = [
        f"{path}: {ast.unparse(call)}"
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.relative_to(PACKAGE).as_posix() not in OWN
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and _reads(call)
    ]
    assert not reading


def _reads(call: ast.Call) -> bool:
    """Whether a call reads a file by its path."""
    name = ast.unparse(call.func)
    modes = [a.value for a in call.args if isinstance(a, ast.Constant)]
    opens = name.endswith(".open") and name != "os.open" and bool({"r", "rb"} & set(modes))
    arrays = name in ("np.load", "np.loadtxt", "np.genfromtxt") and "BytesIO" not in ast.unparse(call.args[0])
    arrays = arrays and ast.unparse(call.args[0]).endswith(("path", ")"))
    return name == "open" or name.endswith((".read_text", ".read_bytes")) or opens or arrays
