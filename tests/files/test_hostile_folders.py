"""Folders that came from elsewhere: whatever lies in them, opening them changes nothing outside."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import run, shares
from lfmesh.files.folder import JOURNAL, MANIFEST, STAGING, made_inside, recover, write_inside
from lfmesh.study.datasets import dataset_item
from lfmesh.study.sweeps.study_folder import LOG, append_event
from tests.processor_time import HANGS_S

Build = Callable[..., lf.Image]

pytestmark = pytest.mark.skipif(os.name != "posix", reason="links and pipes need rights elsewhere")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """Somebody's own folder, beside the one that is opened."""
    folder = tmp_path / "outside"
    (folder / "inputs").mkdir(parents=True)
    for name in ("thesis.txt", "raw.exr", "inputs/thesis.txt", MANIFEST):
        (folder / name).write_text(f"my own {name}")
    return folder


def held_in(folder: Path) -> dict[str, str | None]:
    """Return the content of all files below a folder, and the names of its folders."""
    return {
        path.relative_to(folder).as_posix(): path.read_text() if path.is_file() else None for path in folder.rglob("*")
    }


def decide(folder: Path, **journal: Any) -> None:
    """Put a journal into a folder."""
    whole = {"staging": f"{STAGING}x", "files": [], "removed": [], "moved": {}} | journal
    (folder / JOURNAL).write_text(json.dumps(whole))


def stage(folder: Path, *names: str) -> None:
    for name in names:
        path = folder / f"{STAGING}x" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("hostile")


def overwrites_through_inputs(folder: Path, outside: Path) -> None:
    (folder / "inputs").symlink_to(outside)
    stage(folder, "inputs/thesis.txt")
    decide(folder, files=["inputs/thesis.txt"])


def removes_through_inputs(folder: Path, outside: Path) -> None:
    (folder / "inputs").symlink_to(outside, target_is_directory=True)
    decide(folder, removed=["inputs/thesis.txt"])


def renames_through_inputs(folder: Path, outside: Path) -> None:
    (folder / "inputs").symlink_to(outside)
    stage(folder, "inputs/thesis.txt")
    decide(folder, moved={"inputs/thesis.txt": "inputs/other.txt"})


def overwrites_below_inputs(folder: Path, outside: Path) -> None:
    (folder / "inputs").mkdir()
    (folder / "inputs/mesh").symlink_to(outside)
    stage(folder, "inputs/mesh/thesis.txt")
    decide(folder, files=["inputs/mesh/thesis.txt"])


def takes_files_through_staging(folder: Path, outside: Path) -> None:
    (folder / f"{STAGING}x").symlink_to(outside)
    decide(folder, files=["thesis.txt", "raw.exr"])


def takes_files_below_staging(folder: Path, outside: Path) -> None:
    (folder / f"{STAGING}x").mkdir()
    (folder / f"{STAGING}x/inputs").symlink_to(outside)
    decide(folder, files=["inputs/thesis.txt"])


def leaves_a_link_in_place_of_a_file(folder: Path, outside: Path) -> None:
    (folder / f"{STAGING}x").mkdir()
    (folder / f"{STAGING}x/report.json").symlink_to(outside / "thesis.txt")
    decide(folder, files=["report.json"])


def hides_the_journal_behind_a_link(folder: Path, outside: Path) -> None:
    decide(folder, removed=["mine.txt"])
    (folder / JOURNAL).rename(folder.parent / "journal")
    (folder / JOURNAL).symlink_to(folder.parent / "journal")


HOSTILE = [
    overwrites_through_inputs,
    removes_through_inputs,
    renames_through_inputs,
    overwrites_below_inputs,
    takes_files_through_staging,
    takes_files_below_staging,
    leaves_a_link_in_place_of_a_file,
    hides_the_journal_behind_a_link,
]
UNUSUAL = {
    "a number of files": '{"staging": ".lfmesh-x", "files": 3, "removed": [], "moved": {}}',
    "no JSON object": "[]",
    "deep": "[" * 100_000,
    "NUL in a name": '{"staging": ".lfmesh-x", "files": ["a\\u0000b"], "removed": [], "moved": {}}',
    "half a surrogate": '{"staging": ".lfmesh-x", "files": [], "removed": ["\\ud800"], "moved": {}}',
    "NUL in staging": '{"staging": ".lfmesh-\\u0000", "files": ["a"], "removed": [], "moved": {}}',
    "deep staging": '{"staging": ".lfmesh-x/../../outside", "files": ["a"], "removed": [], "moved": {}}',
    "names of names": '{"staging": ".lfmesh-x", "files": [["a"]], "removed": [], "moved": {"a": []}}',
}


@pytest.mark.parametrize("build", HOSTILE, ids=lambda build: build.__name__)
@pytest.mark.parametrize("act", [run.open_run, recover, run.prepare, run.open_white], ids=lambda act: act.__name__)
def test_a_journal_over_links_changes_nothing(
    build: Callable[[Path, Path], None], act: Callable[[Path], object], tmp_path: Path, outside: Path
) -> None:
    folder, before = tmp_path / "run", held_in(outside)
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    build(folder, outside)
    there = held_in(folder)
    with pytest.raises(FileError) as told:
        act(folder)
    assert str(folder) in str(told.value)
    assert "\n" not in str(told.value)
    assert held_in(outside) == before
    assert held_in(folder) == there


@pytest.mark.parametrize("journal", UNUSUAL)
def test_an_unusual_journal_is_refused_in_one_line(journal: str, tmp_path: Path, outside: Path) -> None:
    folder, before = tmp_path / "run", held_in(outside)
    folder.mkdir()
    (folder / JOURNAL).write_text(UNUSUAL[journal])
    with pytest.raises(FileError, match=r"damaged|outside") as told:
        run.open_run(folder)
    assert "\n" not in str(told.value)
    assert held_in(outside) == before


def test_a_journal_without_links_is_finished_in_a_folder_that_is_reached_through_one(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "run").symlink_to(tmp_path / "disk")
    (tmp_path / "disk/old.txt").write_text("old")
    stage(tmp_path / "disk", "raw.exr", "inputs/mesh/a.obj")
    decide(tmp_path / "disk", files=["raw.exr", "inputs/mesh/a.obj"], removed=["old.txt"])
    recover(tmp_path / "run")
    assert held_in(tmp_path / "disk") == {
        "raw.exr": "hostile", "inputs": None, "inputs/mesh": None, "inputs/mesh/a.obj": "hostile",
    }  # fmt: skip


def test_a_save_does_not_go_through_a_link_in_an_older_run(image_of: Build, tmp_path: Path, outside: Path) -> None:
    """The older run stays; the place for the copies of inputs is refused before anything is rendered."""
    project, folder = tmp_path / "project", tmp_path / "run"
    project.mkdir()
    (project / "thesis.txt").write_bytes(b"a texture")
    scene = image_of().scene.changed({"targets[0].material.texture": "thesis.txt"}).in_folder(project)
    run.save(image_of(scene), folder)
    shutil.rmtree(folder / "inputs")
    (folder / "inputs").symlink_to(outside)
    before, report = held_in(outside), (folder / run.REPORT).read_bytes()
    (folder / MANIFEST).unlink()
    with pytest.raises(FileError, match="inputs is a link"):
        run.save(image_of(scene, seconds=9.0), folder)
    with pytest.raises(FileError, match="inputs is a link"):
        run.prepare(folder)
    assert held_in(outside) == before
    assert (folder / run.REPORT).read_bytes() == report
    assert not [path for path in folder.iterdir() if path.name.startswith(STAGING)]


@pytest.mark.parametrize("irregular", ["pipe", "link", "link to nothing"])
def test_staging_that_is_no_file_or_folder_is_left_alone(
    irregular: str, image_of: Build, tmp_path: Path, outside: Path
) -> None:
    """A pipe without a writer would be waited for for ever."""
    folder, before = run.save(image_of(), tmp_path / "run"), held_in(outside)
    place = folder / f"{STAGING}x"
    if irregular == "pipe":
        os.mkfifo(place)
    else:
        place.symlink_to(outside / ("thesis.txt" if irregular == "link" else "nothing"))
    child = os.fork()
    if child == 0:
        import signal

        signal.alarm(int(HANGS_S))
        run.open_run(folder)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    assert held_in(outside) == before


@pytest.mark.parametrize("name", ["units", "items", shares.PIECES])
def test_folders_of_studies_data_sets_and_shares_are_no_links(name: str, tmp_path: Path, outside: Path) -> None:
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / name).symlink_to(outside)
    decide(outside, removed=["thesis.txt"])
    before = held_in(outside)
    with pytest.raises(FileError, match=f"{name} is a link"):
        made_inside(tmp_path / "study", name)
    assert held_in(outside) == before


def test_a_log_that_is_a_link_or_a_pipe_is_not_written(tmp_path: Path, outside: Path) -> None:
    before = held_in(outside)
    (tmp_path / LOG).symlink_to(outside / "thesis.txt")
    append_event(tmp_path, "started")
    assert held_in(outside) == before
    (tmp_path / LOG).unlink()
    os.mkfifo(tmp_path / LOG)
    append_event(tmp_path, "started")
    (tmp_path / LOG).unlink()
    append_event(tmp_path, "started")
    assert "started" in (tmp_path / LOG).read_text()


@pytest.mark.parametrize("kind", ["link", "pipe"])
def test_a_table_takes_the_place_of_a_link_or_a_pipe(kind: str, tmp_path: Path, outside: Path) -> None:
    before, table = held_in(outside), tmp_path / "table.csv"
    if kind == "link":
        table.symlink_to(outside / "thesis.txt")
    else:
        os.mkfifo(table)
    write_inside(tmp_path, table.name, "1,2\n")
    assert held_in(outside) == before
    assert table.read_text() == "1,2\n"
    assert not table.is_symlink()


def test_an_item_of_a_data_set_that_is_a_link_is_not_taken(tmp_path: Path, outside: Path) -> None:
    (tmp_path / "000001").symlink_to(outside)
    with pytest.raises(FileError, match="000001 is a link"):
        dataset_item.facts_of(tmp_path / "000001", "digest")


def test_a_link_that_takes_the_place_of_a_folder_meanwhile_is_not_followed(
    tmp_path: Path, outside: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look at a folder and the move into it, somebody swaps the folder for a link."""
    folder, before = tmp_path / "run", held_in(outside)
    (folder / "inputs").mkdir(parents=True)
    stage(folder, "inputs/thesis.txt")
    decide(folder, files=["inputs/thesis.txt"])
    move = os.replace

    def swap(*arguments: Any, **handles: Any) -> None:
        (folder / "inputs").rename(folder / "aside")
        (folder / "inputs").symlink_to(outside)
        move(*arguments, **handles)

    monkeypatch.setattr(os, "replace", swap)
    recover(folder)
    assert held_in(outside) == before
