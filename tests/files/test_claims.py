"""Two renders or saves into one folder: the second is refused while the first runs, and only then."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import PIL.Image
import pytest

import lfmesh as lf
from lfmesh.cli import main
from lfmesh.errors import FileError
from lfmesh.files import run
from lfmesh.files.checkpoint import CHECKPOINT
from lfmesh.files.claims import CLAIM, refuse_claimed
from lfmesh.files.folder import STAGING
from tests.files.conftest import PLENOPTIC

Build = Callable[..., lf.Image]

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")


@contextmanager
def working_elsewhere(work: Callable[[Callable[..., None]], object]) -> Iterator[int]:
    """Yield the number of a process that has come to where its work calls what it is given; it is killed at the end."""
    ready, tell = os.pipe()

    def stay(*_: object, **__: object) -> None:
        os.write(tell, b"x")
        signal.pause()

    child = os.fork()
    if child == 0:
        try:
            work(stay)
        finally:
            os._exit(1)
    os.close(tell)
    try:
        assert os.read(ready, 1) == b"x"
        yield child
    finally:
        os.close(ready)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def rendering_elsewhere(folder: Path) -> AbstractContextManager[int]:
    """Yield the number of a process that renders into a folder; it is killed at the end."""

    def work(stay: Callable[[], None]) -> None:
        with run.rendering(folder):
            stay()

    return working_elsewhere(work)


def saving_elsewhere(image: lf.Image, folder: Path) -> AbstractContextManager[int]:
    """Yield the number of a process that is about to write the first picture of a run; it is killed at the end."""

    def work(stay: Callable[..., None]) -> None:
        PIL.Image.Image.save = stay  # type: ignore[method-assign]
        lf.save(image, folder)

    return working_elsewhere(work)


def test_a_folder_into_which_another_process_renders_is_refused_with_its_number(
    image_of: Build, tmp_path: Path
) -> None:
    folder, image = tmp_path / "run", image_of()
    with rendering_elsewhere(folder) as process:
        for act in (lambda: run.prepare(folder), lambda: run.save(image, folder), run.rendering(folder).__enter__):
            with pytest.raises(FileError, match=rf"process {process} on .* is rendering into it"):
                act()
        assert [path.name for path in folder.iterdir()] == [CLAIM]
    # It was killed: the folder is free, and nothing is left of the claim.
    run.save(image, folder)
    assert run.open_run(folder).seconds == image.seconds
    assert not [path for path in folder.iterdir() if path.name.startswith(STAGING)]


def test_the_run_that_is_to_be_replaced_is_readable_meanwhile_and_takes_no_additions(
    image_of: Build, tmp_path: Path
) -> None:
    folder = run.save(image_of(), tmp_path)
    with rendering_elsewhere(folder):
        assert run.open_run(folder).seconds == 7.0
        with pytest.raises(FileError, match="is rendering into it"), run.added(folder):
            pass


def test_a_save_is_refused_while_another_process_saves_into_the_folder(image_of: Build, tmp_path: Path) -> None:
    folder, image = tmp_path / "run", image_of()
    with saving_elsewhere(image, folder) as process:
        for act in (lambda: lf.save(image, folder), run.rendering(folder).__enter__):
            with pytest.raises(FileError, match=rf"process {process} on .* is rendering into it or saving"):
                act()
    # It was killed: nothing of it keeps others out, or stays.
    lf.save(image, folder)
    assert lf.open_run(folder).seconds == image.seconds
    assert not [path for path in folder.iterdir() if path.name.startswith(STAGING)]


def test_a_pipe_in_place_of_a_folder_is_refused_and_not_waited_for(image_of: Build, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "run")
    for act in (lambda: lf.save(image_of(), tmp_path / "run"), lambda: lf.open_run(tmp_path / "run")):
        with pytest.raises(FileError, match="is a file"):
            act()
    refuse_claimed(tmp_path / "run")


@pytest.mark.parametrize("arguments", [["render", "scene.toml", "-o", "run"], ["render", "--resume", "run"]])
def test_a_render_that_runs_is_not_said_to_be_cut_short(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(PLENOPTIC)
    with rendering_elsewhere(Path("run")) as process:
        (tmp_path / "run" / CHECKPOINT).write_bytes(b"of the render that runs")
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert f"process {process} on " in said
        assert "cut short" not in said
        assert (tmp_path / "run" / CHECKPOINT).read_bytes() == b"of the render that runs"


def test_a_render_saves_into_the_folder_that_it_has_claimed_itself(image_of: Build, tmp_path: Path) -> None:
    with run.rendering(tmp_path / "run"):
        run.save(image_of(), tmp_path / "run")
        with pytest.raises(FileError, match="already"), run.rendering(tmp_path / "run"):
            pass
    assert not (tmp_path / "run" / CLAIM).exists()
    assert run.open_run(tmp_path / "run").seconds == 7.0


def test_a_render_that_fails_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), run.rendering(tmp_path / "new" / "run"):
        raise ZeroDivisionError
    assert not (tmp_path / "new").exists()
