"""Commands that are killed at moments drawn by chance: what is found then is whole, and a render goes on from there."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import lfmesh
from lfmesh.errors import FileError
from lfmesh.files import exr, run
from lfmesh.files.checkpoint import CHECKPOINT
from lfmesh.files.depth import ESTIMATE, FIGURE, PIXELS, VIEWS
from lfmesh.files.exports.export import NOTE
from lfmesh.files.exposed import COUNTS, FACTS, PREVIEW
from lfmesh.files.field import FIELD, open_field
from lfmesh.files.field import VIEWS as FIELD_VIEWS
from lfmesh.files.folder import MANIFEST, STAGING, manifest_of
from tests.cameras import bench_camera
from tests.processor_time import HANGS_S

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")

SCENE = f"""{bench_camera(8, 6)}[[targets]]
shape = {{ kind = "plane", width_mm = 100.0, height_mm = 100.0 }}
position_mm = [0.0, 0.0, -500.0]
[targets.material]
reflectance = 0.0
radiance_w_m2_sr = 1.0
texture = "chart.png"
[transport]
samples = 64
replicates = 8
split = "transmit"
"""

ZYGOTE = """
import json, os, sys
import lfmesh.cli, lfmesh.files.checkpoint, lfmesh.files.depth, lfmesh.files.exposed, lfmesh.files.exports.export
import lfmesh.files.photographs, lfmesh.lightfield.calibration.centres, lfmesh.lightfield.calibration.white
import lfmesh.lightfield.photographs.depth_truth, lfmesh.lightfield.photographs.refocus, lfmesh.lightfield.views.decode
import lfmesh.transport.render.render, matplotlib.figure, trimesh
lfmesh.files.checkpoint.SECONDS, lfmesh.files.checkpoint.SHARE = 0.0, 1e9
for line in sys.stdin:
    child = os.fork()
    if child == 0:
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(quiet, stream)
        os._exit(lfmesh.cli.main(json.loads(line)))
    print(child, flush=True)
    sys.stdin.readline()
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""
"""Has everything imported, and forks a child for each command: nothing that has threads runs in it."""


class Commands:
    """Runs commands in processes of their own, and kills them."""

    def __init__(self, folder: Path) -> None:
        self._zygote = subprocess.Popen(
            [sys.executable, "-c", ZYGOTE], cwd=folder, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": str(Path(lfmesh.__file__).parents[1])},
        )  # fmt: skip

    def run(self, *arguments: str, kill_after: float | None = None) -> int:
        """Run a command, and return its exit code: -9 if it was killed."""
        assert self._zygote.stdin is not None
        assert self._zygote.stdout is not None
        print(json.dumps(arguments), file=self._zygote.stdin, flush=True)
        child = int(self._zygote.stdout.readline())
        if kill_after is not None:
            time.sleep(kill_after)
            # Nobody has waited for it yet: no other process has its number.
            os.kill(child, signal.SIGKILL)
        print(file=self._zygote.stdin, flush=True)
        return int(self._zygote.stdout.readline())

    def close(self) -> None:
        assert self._zygote.stdin is not None
        self._zygote.stdin.close()
        self._zygote.wait(timeout=HANGS_S)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    import PIL.Image

    folder = tmp_path_factory.mktemp("project")
    (folder / "scene.toml").write_text(SCENE)
    squares = np.kron(np.indices((8, 8)).sum(axis=0) % 2 * 155 + 100, np.ones((8, 8))).astype(np.uint8)
    PIL.Image.fromarray(squares).save(folder / "chart.png")
    return folder


@pytest.fixture(scope="module")
def commands(project: Path) -> Iterator[Commands]:
    started = Commands(project)
    yield started
    started.close()


RENDER = ("render", "scene.toml", "-o", "run", "--seed", "1", "--threads", "1")

CASES: dict[str, tuple[str, ...]] = {
    "render": RENDER,
    "render over": RENDER,
    "white": ("white", "run", "--samples", "64"),
    "decode": ("decode", "run"),
    "refocus": ("refocus", "run", "--distance-mm", "480"),
    "depth": ("depth", "run", "--samples", "4"),
    "export": ("export", "run", "--format", "views", "-o", "out"),
    "expose": ("expose", "run"),
}

ADDED = {
    "white": {run.WHITE, run.WHITE_PREVIEW, run.CALIBRATION},
    "decode": {FIELD, FIELD_VIEWS},
    "refocus": {"refocused_480mm.exr", "refocused_480mm.png"},
    "expose": {COUNTS, FACTS, PREVIEW},
}
DEPTH = ({VIEWS, PIXELS}, {ESTIMATE, FIGURE})
"""Added in two changes."""


@pytest.fixture(scope="module")
def before(commands: Commands, project: Path) -> Path:
    """Return a run that is to be changed, and was rendered, whitened and decoded; kernels are compiled by then."""
    assert commands.run("render", "scene.toml", "-o", "before", "--seed", "0", "--samples", "32", "--white") == 0
    assert commands.run("decode", "before") == 0
    return project / "before"


@pytest.fixture(scope="module")
def whole(commands: Commands, before: Path, project: Path) -> str:
    """Return the hash of the pixels of the render that is killed in the tests."""
    assert commands.run(*RENDER) == 0
    return run.pixels_digest(project / "run")


def begin(case: str, before: Path, project: Path) -> None:
    for name in ("run", "out"):
        shutil.rmtree(project / name, ignore_errors=True)
    if case != "render":
        shutil.copytree(before, project / "run")
    if case in ("white", "decode"):
        # Only of what they make themselves may something appear: the old run as lf.save made it.
        image = run.open_run(before)
        shutil.rmtree(project / "run")
        run.save(image, project / "run")


def judge(case: str, before: Path, whole: str, project: Path) -> bool:
    """Hold what a killed command has left against what may be there; return whether its change is."""
    folder, old = project / "run", set() if case == "render" else set(manifest_of(before) or {})
    assert not [path.name for path in project.iterdir() if path.name.startswith(STAGING)] or case == "export"
    if case == "render":
        run.prepare(folder)
        if not (folder / run.RAW).exists():
            with pytest.raises(FileError, match=r"does not exist|not a complete run"):
                run.open_run(folder)
            left = {path.name for path in folder.iterdir()} if folder.exists() else set()
            assert left <= {CHECKPOINT}
            return False
    run.open_run(folder)
    manifest = manifest_of(folder)
    assert manifest is not None
    files = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert files - {CHECKPOINT} == {*manifest, MANIFEST}
    assert CHECKPOINT not in files or case.startswith("render")
    assert all(entry.fits(folder / name) for name, entry in manifest.items())
    assert {path.name for path in folder.iterdir()} >= {"inputs"}
    if case.startswith("render"):
        new = run.pixels_digest(folder) == whole
        assert new or (case != "render" and run.pixels_digest(folder) == run.pixels_digest(before))
        assert new == (run.WHITE not in files) if case != "render" else new
        return new
    assert run.pixels_digest(folder) == run.pixels_digest(before)
    if case == "export":
        return judged_export(project)
    if case in ("white", "decode"):
        old -= ADDED["white"] | ADDED["decode"]
    groups = DEPTH if case == "depth" else (ADDED[case],)
    there = [group <= manifest.keys() for group in groups]
    assert set(manifest) == old.union(*(group for group, is_there in zip(groups, there, strict=True) if is_there))
    assert there == sorted(there, reverse=True)
    read = {
        run.WHITE: lambda: run.open_white(folder), FIELD: lambda: open_field(folder),
        ESTIMATE: lambda: exr.read_map(folder / ESTIMATE, ("Z",)),
    }  # fmt: skip
    for name, opened in read.items():
        assert name not in manifest or opened() is not None
    return all(there)


def judged_export(project: Path) -> bool:
    out = project / "out"
    if not out.exists():
        return False
    facts = json.loads((out / NOTE).read_text())
    assert {path.name for path in out.iterdir()} == {*facts["files"], NOTE}
    return True


def kill_and_judge(case: str, kills: int, commands: Commands, before: Path, whole: str, project: Path) -> list[bool]:
    draw = np.random.default_rng(int.from_bytes(hashlib.sha256(case.encode()).digest()[:4]))
    begin(case, before, project)
    began = time.monotonic()
    assert commands.run(*CASES[case]) == 0
    takes = time.monotonic() - began
    assert judge(case, before, whole, project)
    found = []
    for _ in range(kills):
        begin(case, before, project)
        code = commands.run(*CASES[case], kill_after=draw.uniform(0.0, takes))
        assert code in (-signal.SIGKILL, 0)
        found.append(judge(case, before, whole, project))
        assert code != 0 or found[-1]
    # The same command, once more to its end, clears what the last one left; a render has to be told so.
    if case == "export" and (project / "out").exists():
        shutil.rmtree(project / "out")
    again = ["--restart"] if CASES[case][0] == "render" else []
    assert commands.run(*CASES[case], *again) == 0
    assert judge(case, before, whole, project)
    assert not [path.name for path in project.iterdir() if path.name.startswith(STAGING)]
    return found


@pytest.mark.parametrize("case", ["render over", "export", "expose"])
def test_a_killed_command_leaves_what_was_or_what_was_to_be(
    case: str, commands: Commands, before: Path, whole: str, project: Path
) -> None:
    kill_and_judge(case, 1, commands, before, whole, project)


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_many_killed_commands_leave_what_was_or_what_was_to_be(
    case: str, commands: Commands, before: Path, whole: str, project: Path
) -> None:
    """Eight cases with 25 kills each: 200 in all."""
    found = kill_and_judge(case, 25, commands, before, whole, project)
    assert not all(found)


def resume_after_kills(moments: int, seed: int, commands: Commands, whole: str, project: Path) -> None:
    """Kill renders, and what goes on with them, until so many kills have left a checkpoint to go on from."""
    draw = np.random.default_rng(seed)
    folder, left = project / "run", 0
    shutil.rmtree(folder, ignore_errors=True)
    began = time.monotonic()
    assert commands.run(*RENDER) == 0
    takes = time.monotonic() - began
    for _ in range(10 * moments):
        shutil.rmtree(folder, ignore_errors=True)
        again = RENDER
        while commands.run(*again, kill_after=draw.uniform(0.3, 1.0) * takes) == -signal.SIGKILL:
            kept = (folder / CHECKPOINT).exists()
            left += kept
            again = ("render", "--resume", "run", "--threads", "2") if kept else RENDER
        image = run.open_run(folder)
        assert image.complete
        assert json.loads((folder / run.REPORT).read_text())["complete"] is True
        assert run.pixels_digest(folder) == whole
        assert not (folder / CHECKPOINT).exists()
        if left >= moments:
            return
    pytest.fail(f"only {left} of {moments} kills hit a render between its first checkpoint and its end")


def test_a_killed_render_goes_on_to_the_same_bits(commands: Commands, before: Path, whole: str, project: Path) -> None:
    resume_after_kills(1, 1, commands, whole, project)


@pytest.mark.long
def test_ten_killed_renders_go_on_to_the_same_bits(commands: Commands, before: Path, whole: str, project: Path) -> None:
    resume_after_kills(10, 2, commands, whole, project)
