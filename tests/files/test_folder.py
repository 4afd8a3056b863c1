"""A run folder survives its writer: killed at any step, a change is there whole or not at all, and leaves nothing."""

import fcntl
import json
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lfmesh
import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import checkpoint, image_file, run
from lfmesh.files.checkpoint import CHECKPOINT, Checkpoints
from lfmesh.files.exports import export
from lfmesh.files.folder import JOURNAL, MANIFEST, STAGING, manifest_of, recover, saved, staged
from lfmesh.transport.render.tally import Layout

Build = Callable[..., lf.Image]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")

TOUCHES = {"open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.chmod", "tempfile.mkstemp", "fcntl.flock"}
"""What Python reports before it touches files."""

KILLED = 9


def in_child(folder: Path, act: Callable[[], object], step: Callable[[int], object]) -> int:
    """Do something in a child, which calls `step` with a count before it touches the folder; return its exit code."""
    child = os.fork()
    if child == 0:
        try:
            steps, looking = 0, True

            def look(event: str, arguments: tuple[object, ...]) -> None:
                nonlocal steps, looking
                # A name may be relative to an open folder; but modules are opened for imports too.
                if looking and event in TOUCHES and (event != "open" or str(folder) in str(arguments[0])):
                    looking = False
                    step(steps)
                    steps, looking = steps + 1, True

            sys.addaudithook(look)
            act()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(step: int, folder: Path, act: Callable[[], object]) -> bool:
    """Do something in a child that ends at a step; return whether it came that far."""
    code = in_child(folder, act, lambda steps: os._exit(KILLED) if steps == step else None)
    assert code in (0, KILLED)
    return code == KILLED


def files_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def assert_nothing_but_a_whole_run(folder: Path) -> None:
    """Every file is in the manifest, and as it was saved."""
    manifest = manifest_of(folder)
    assert manifest is not None
    assert files_in(folder) == {*manifest, MANIFEST}
    assert all(entry.fits(folder / name) for name, entry in manifest.items())
    assert not [path for path in folder.iterdir() if path.name.startswith(STAGING)]


def kill_at_every_step(folder: Path, act: Callable[[], object], least: int = 20) -> Iterator[int]:
    """Yield with the folder as each kill would leave it, from the first step to the last; at the end it is changed.

    A kill leaves what the system knows of the files, and no lock: that is what a copy of the folder holds which the
    process itself makes at that step.
    """
    kept = folder.with_name("at each step")

    def keep(step: int) -> None:
        (kept / f"{step}").mkdir(parents=True)
        if folder.exists():
            shutil.copytree(folder, kept / f"{step}" / "folder")

    assert in_child(folder, act, keep) == 0
    changed = folder.rename(kept / "changed")
    steps = len(list(kept.iterdir())) - 1
    assert steps > least
    for step in range(steps):
        if (kept / f"{step}" / "folder").exists():
            (kept / f"{step}" / "folder").rename(folder)
        yield step
        shutil.rmtree(folder, ignore_errors=True)
    changed.rename(folder)


@pytest.fixture
def textured(image_of: Build, tmp_path: Path) -> Build:
    """Build images of a scene that reads two files, one of which changes."""
    (tmp_path / "project").mkdir()

    def build(contents: bytes, **changes: Any) -> lf.Image:
        (tmp_path / "project" / "chart.png").write_bytes(contents)
        scene = image_of().scene.changed({"targets[0].material.texture": "chart.png"}).in_folder(tmp_path / "project")
        return image_of(scene, **changes)

    return build


def test_a_save_killed_at_any_step_leaves_the_old_run_or_the_new(
    textured: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "run"
    # Pictures are written before the steps that matter, and take the time.
    monkeypatch.setattr(run, "write_preview", lambda path, *_: [path.write_bytes(b"picture"), 1.0][1])
    monkeypatch.setattr(run, "write_linear16", lambda *_: ([], 1.0))
    old, new = textured(b"old", seconds=7.0), textured(b"new", seconds=9.0)
    (tmp_path / "project/chart.png").write_bytes(b"old")
    run.save(old, folder)
    with run.added(folder) as staging:
        (staging / "white.png").write_bytes(b"of the old run")
    (tmp_path / "project/chart.png").write_bytes(b"new")
    found = []
    for _ in kill_at_every_step(folder, lambda: run.save(new, folder)):
        found.append(run.open_run(folder).seconds)
        assert_nothing_but_a_whole_run(folder)
        assert (folder / "inputs/chart.png").read_bytes() == (b"old" if found[-1] == 7.0 else b"new")
        assert (folder / "white.png").exists() == (found[-1] == 7.0)
    # Once decided it stays so.
    assert found == sorted(found)
    assert set(found) == {7.0, 9.0}


def test_a_first_save_killed_at_any_step_leaves_a_folder_to_render_into(
    textured: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, image = tmp_path / "run", textured(b"new")
    monkeypatch.setattr(run, "write_preview", lambda path, *_: [path.write_bytes(b"picture"), 1.0][1])
    monkeypatch.setattr(run, "write_linear16", lambda *_: ([], 1.0))

    opened = []
    for _ in kill_at_every_step(folder, lambda: run.save(image, folder)):
        run.prepare(folder)
        if (folder / run.RAW).exists():
            assert run.open_run(folder).seconds == image.seconds
            assert_nothing_but_a_whole_run(folder)
            opened.append(True)
        else:
            with pytest.raises(FileError, match=r"does not exist|not a complete run"):
                run.open_run(folder)
            assert not folder.exists() or not list(folder.iterdir())
            opened.append(False)
    assert opened == sorted(opened)
    assert set(opened) == {False, True}


def test_what_is_added_killed_at_any_step_is_there_entirely_or_not(image_of: Build, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    run.save(image_of(), folder)
    with run.added(folder) as staging:
        (staging / "exposed.png").write_bytes(b"old")
        (staging / "exposed.json").write_bytes(b"old")

    def add() -> None:
        with run.added(folder) as staging:
            (staging / "exposed.png").write_bytes(b"new")
            (staging / "exposed.json").write_bytes(b"new")

    found = []
    for _ in kill_at_every_step(folder, add):
        run.report_of(folder)
        assert_nothing_but_a_whole_run(folder)
        one, other = ((folder / name).read_bytes() for name in ("exposed.png", "exposed.json"))
        assert one == other
        found.append(one)
    assert found == sorted(found, reverse=True)
    assert set(found) == {b"old", b"new"}


def test_a_recovery_killed_at_any_step_is_finished_by_the_next(image_of: Build, tmp_path: Path) -> None:
    """The journal is read again and again until all of it is done."""
    folder = tmp_path / "run"
    run.save(image_of(), folder)

    def add() -> None:
        with run.added(folder) as staging:
            (staging / "exposed.png").write_bytes(b"new")
            (staging / "exposed.json").write_bytes(b"new")

    # Killed as soon as it is decided.
    assert in_child(folder, add, lambda _: os._exit(KILLED) if (folder / JOURNAL).exists() else None) == KILLED
    for step in range(100):
        if not killed_at(step, folder, lambda: recover(folder)):
            break
    assert step > 5
    assert_nothing_but_a_whole_run(folder)
    assert saved(folder, "exposed.json") is not None


def test_a_checkpoint_killed_at_any_step_is_the_old_one_or_the_new(tmp_path: Path) -> None:
    folder, state = tmp_path / "run", Layout((4, 3, 1), (2, 5), 3, blind=True).state()

    def keep(replicates: int) -> None:
        state.first.means[0].count = replicates
        Checkpoints(folder, {"scene_toml": "", "scene_folder": "."})(state, last=True)

    def kept() -> int:
        recover(folder)
        assert files_in(folder) == {CHECKPOINT}
        with np.load(folder / CHECKPOINT) as arrays:
            return int(arrays["first.means.0.count"])

    keep(1)
    # Moving it into its place is the last step.
    for _ in kill_at_every_step(folder, lambda: keep(2), least=5):
        assert kept() == 1
    assert kept() == 2


def test_an_export_killed_at_any_step_is_there_entirely_or_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    home.mkdir()

    def write(staging: Path, _: object) -> dict[str, Any]:
        (staging / "view.png").write_bytes(b"picture")
        return {"files": ["view.png"]}

    monkeypatch.setitem(export._FIELD_WRITERS, "views", write)
    field = object.__new__(lf.LightField)
    object.__setattr__(field, "data", np.zeros((1, 1, 2, 2, 1)))
    for _ in kill_at_every_step(home, lambda: export.export_field(field, home / "out", "views"), least=5):
        assert not (home / "out").exists() or files_in(home / "out") == {"view.png", export.NOTE}
        export.export_field(field, home / "next", "views")
        assert not [path for path in home.iterdir() if path.name.startswith(STAGING)]
    assert files_in(home / "out") == {"view.png", export.NOTE}


def test_staging_of_live_processes_stays_and_that_of_dead_ones_goes(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    with staged(tmp_path) as alive:
        dead = tmp_path / f"{STAGING}1-of-a-dead-process"
        dead.mkdir()
        (dead / "raw.exr").write_bytes(b"half")
        run.open_run(tmp_path)
        assert not dead.exists()
        assert alive.exists()
    assert not alive.exists()


def test_two_who_add_at_once_both_stay_in_the_manifest(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    with run.added(tmp_path) as first:
        (first / "exposed.png").write_bytes(b"1")
        with run.added(tmp_path) as second:
            (second / "depth.png").write_bytes(b"2")
    assert saved(tmp_path, "exposed.png") is not None
    assert saved(tmp_path, "depth.png") is not None
    assert_nothing_but_a_whole_run(tmp_path)


def test_a_reader_waits_for_a_change_that_is_being_made(image_of: Build, tmp_path: Path) -> None:
    """A journal under a lock is another process's, which will finish it: nobody takes its files away."""
    run.save(image_of(), tmp_path)
    handle = os.open(tmp_path, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        (tmp_path / JOURNAL).write_text('{"staging": ".lfmesh-x", "files": [], "removed": ["raw.exr"], "moved": {}}')
        ready, tell = os.pipe()
        child = os.fork()
        if child == 0:
            # The lock is the parent's alone only once no other handle of it is open.
            os.close(handle)
            os.write(tell, b"x")
            recover(tmp_path)
            os._exit(0)
        os.read(ready, 1)
        time.sleep(0.1)
        assert os.waitpid(child, os.WNOHANG) == (0, 0)
        assert (tmp_path / "raw.exr").exists()
        (tmp_path / JOURNAL).unlink()
        os.close(ready)
        os.close(tell)
    finally:
        os.close(handle)
    os.waitpid(child, 0)
    run.open_run(tmp_path)


def test_a_file_that_the_manifest_does_not_name_is_no_part_of_the_run(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path / "run")
    run.save(image_of(), tmp_path / "other")
    (tmp_path / "other/raw.exr").rename(tmp_path / "run/white.exr")
    assert run.open_white(tmp_path / "run") is None


@pytest.mark.parametrize(
    ("journal", "message"),
    [
        ("{", "damaged"),
        ('{"staging": ".lfmesh-x", "files": ["../x"], "removed": [], "moved": {}}', "outside"),
        ('{"staging": "..", "files": [], "removed": [], "moved": {}}', "outside"),
        ('{"staging": ".lfmesh-x", "files": [], "removed": ["inputs/../../x"], "moved": {}}', "outside"),
        ('{"staging": ".lfmesh-x", "files": [], "removed": [], "moved": {"a": "/x"}}', "outside"),
    ],
)
def test_a_journal_that_is_none_of_ours_is_refused(tmp_path: Path, journal: str, message: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "x").write_text("mine")
    (tmp_path / "run" / JOURNAL).write_text(journal)
    with pytest.raises(FileError, match=message):
        run.open_run(tmp_path / "run")
    assert (tmp_path / "x").read_text() == "mine"


def test_a_run_of_before_there_were_manifests_opens_and_gets_one(image_of: Build, tmp_path: Path) -> None:
    run.save(image_of(), tmp_path)
    (tmp_path / MANIFEST).unlink()
    report = json.loads((tmp_path / run.REPORT).read_text())
    report["files"] = sorted(files_in(tmp_path))
    (tmp_path / run.REPORT).write_text(json.dumps(report))
    os.utime(tmp_path / run.SCENE)
    assert run.open_run(tmp_path).seconds == 7.0
    with run.added(tmp_path) as staging:
        (staging / "exposed.png").write_bytes(b"new")
    assert_nothing_but_a_whole_run(tmp_path)
    assert saved(tmp_path, run.RAW) is not None


@pytest.mark.parametrize("manifest", ["{", "[]", '{"format": 1, "files": {"raw.exr": 3}}'])
def test_a_damaged_manifest_is_told_in_one_line(image_of: Build, tmp_path: Path, manifest: str) -> None:
    run.save(image_of(), tmp_path)
    (tmp_path / MANIFEST).write_text(manifest)
    with pytest.raises(FileError, match=r"manifest\.json is damaged; render the scene again$"):
        run.open_run(tmp_path)
    run.save(image_of(seconds=9.0), tmp_path)
    assert run.open_run(tmp_path).seconds == 9.0


@pytest.mark.parametrize("file", [MANIFEST, CHECKPOINT])
def test_another_version_is_told_in_one_line(image_of: Build, tmp_path: Path, file: str) -> None:
    run.save(image_of(), tmp_path)
    if file == MANIFEST:
        text = (tmp_path / MANIFEST).read_text().replace('"format": 1', '"format": 7')
        (tmp_path / MANIFEST).write_text(text)
    else:
        facts = json.dumps({"format": 7, "lfmesh_version": "9.9"})
        np.savez(tmp_path / CHECKPOINT, facts=np.array(facts))
    told = r"7.*this lfmesh " + re.escape(lfmesh.__version__) if file == MANIFEST else "by an older lfmesh"
    with pytest.raises(FileError, match=told) as caught:
        run.open_run(tmp_path) if file == MANIFEST else checkpoint.read(tmp_path, image_file.scene_from)
    assert "\n" not in str(caught.value)
