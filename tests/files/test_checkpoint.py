"""Renders that are cut short go on to the same bits, or say in one line why they cannot."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh import provenance
from lfmesh.cli import main
from lfmesh.errors import FileError
from lfmesh.files import checkpoint, image_file, run
from lfmesh.files.checkpoint import CHECKPOINT, Checkpoints
from lfmesh.files.folder import STAGING
from lfmesh.files.sealed import read_sealed, write_sealed
from lfmesh.transport.render.tally import Layout
from lfmesh.transport.render.tracer import Tracer
from tests.cameras import as_text, close_up_camera

SCENE = as_text(
    camera=close_up_camera(20, 16),
    targets=[
        {
            "shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0},
            "position_mm": [0.0, 0.0, -60.0],
            "material": {"reflectance": 0.0, "radiance_w_m2_sr": 100.0, "texture": "chart.png"},
        }
    ],
    transport={"samples": 32, "replicates": 4, "split": "transmit"},
)

Interrupt = Callable[[int | None], None]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene and its texture, in which commands run."""
    (tmp_path / "scene.toml").write_text(SCENE)
    PIL.Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8) * 3 + 50).save(tmp_path / "chart.png")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def interrupt(monkeypatch: pytest.MonkeyPatch) -> Interrupt:
    """Press Ctrl-C in a replicate, counted from 0 over both stages; None: no more."""
    original, when = Tracer.traced, None

    def traced(self: Tracer, pool: Any, replicate: int, *rest: Any) -> Any:
        if replicate == when:
            raise KeyboardInterrupt
        return original(self, pool, replicate, *rest)

    def press(replicate: int | None) -> None:
        nonlocal when
        when = replicate

    monkeypatch.setattr(Tracer, "traced", traced)
    return press


def bits(folder: Path) -> dict[str, Any]:
    """Return everything of a run but the time that it took."""
    image = run.open_run(folder)
    report = json.loads((folder / run.REPORT).read_text())
    same = ("ledger", "refinement", "blind", "noise", "complete", "replicates_finished", "samples_per_pixel")
    return {"pixels": run.pixels_digest(folder), "hits": image.hits.sum() if image.hits is not None else None,
            **{name: report[name] for name in same}}  # fmt: skip


@pytest.mark.parametrize(
    ("options", "at"),
    [
        ((), 3), (("--target-error", "0.01", "--max-samples", "256"), 4), (("--method", "forward"), 2),
        pytest.param((), 1, marks=pytest.mark.long),
        pytest.param(("--target-error", "0.01", "--max-samples", "256"), 2, marks=pytest.mark.long),
        pytest.param(("--target-error", "0.01", "--max-samples", "256"), 6, marks=pytest.mark.long),
    ],
)  # fmt: skip
def test_a_run_ended_by_ctrl_c_goes_on_to_the_same_bits(
    folder: Path, interrupt: Interrupt, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], at: int
) -> None:
    assert main(["render", "scene.toml", "-o", "whole", *options]) == 0
    assert not (folder / "whole" / CHECKPOINT).exists()
    interrupt(at)
    assert main(["render", "scene.toml", "-o", "run", *options]) == 130
    assert "lfmesh render --resume run" in capsys.readouterr().out
    assert not run.open_run(folder / "run").complete
    assert (folder / "run" / CHECKPOINT).exists()
    # Another number of threads, and once more Ctrl-C before anything is added.
    assert main(["render", "--resume", "run", "--threads", "2"]) == 130
    interrupt(None)
    assert main(["render", "--resume", "run", "--threads", "2"]) == 0
    assert bits(folder / "run") == bits(folder / "whole")
    assert run.open_run(folder / "run").complete
    assert not (folder / "run" / CHECKPOINT).exists()


def test_a_run_ended_in_its_first_replicate_goes_on_to_the_same_bits(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--samples", "1024", "--replicates", "1")
    assert main(["render", "scene.toml", "-o", "whole", *options]) == 0
    original = Tracer.traced

    def traced(self: Tracer, *arguments: Any) -> Any:
        chunks = original(self, *arguments)
        yield next(chunks)
        raise KeyboardInterrupt

    monkeypatch.setattr(Tracer, "traced", traced)
    assert main(["render", "scene.toml", "-o", "run", *options]) == 130
    assert "lfmesh render --resume run" in capsys.readouterr().out
    assert [each.name for each in (folder / "run").iterdir()] == [CHECKPOINT]
    monkeypatch.setattr(Tracer, "traced", original)
    assert main(["render", "--resume", "run"]) == 0
    assert bits(folder / "run") == bits(folder / "whole")


def test_a_run_that_is_complete_says_so_and_stays_as_it_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    before = (folder / "run/report.json").read_bytes()
    capsys.readouterr()
    assert main(["render", "--resume", "run"]) == 0
    assert capsys.readouterr().out == "run is complete: there is nothing to continue.\n"
    assert (folder / "run/report.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["scene.toml", "--resume", "run"], "omit a scene"),
        (["--resume", "run", "-o", "other"], "omit --out"),
        (["--resume", "run", "--samples", "64", "--seed", "3"], "omit --samples, --seed"),
        (["--resume", "none"], "none is not a run folder"),
        (["--resume", "scene.toml"], "it is a file"),
        (["--resume", "empty"], "empty has no checkpoint to continue from"),
        (["scene.toml"], "render needs --out"),
        (["-o", "run"], "render needs a scene file"),
    ],
)
def test_what_does_not_go_with_resume_is_refused_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    (folder / "empty").mkdir()
    assert main(["render", *arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


@pytest.fixture
def cut_short(folder: Path, interrupt: Interrupt) -> Path:
    """Return the run of a render that was cut short after two replicates."""
    interrupt(2)
    assert main(["render", "scene.toml", "-o", "run"]) == 130
    interrupt(None)
    return folder / "run"


def refusal(capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    assert main(["render", "--resume", "run"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_damaged_checkpoint_is_refused_in_one_line(cut_short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = cut_short / CHECKPOINT
    contents = path.read_bytes()
    with np.load(path) as arrays:
        place = contents.index(arrays["first.means.0.mean"].tobytes())
    for damaged in (contents[: len(contents) // 2], b"", b"text", contents[:place] + b"\0\1" + contents[place + 2 :]):
        path.write_bytes(damaged)
        assert "is damaged; start again with" in refusal(capsys)
    path.write_bytes(contents)
    assert main(["render", "--resume", "run"]) == 0


def test_the_checkpoint_of_another_version_is_refused_in_one_line(
    cut_short: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written = provenance.program()
    monkeypatch.setattr(provenance, "program", lambda: written | {"lfmesh": "99.0", "numba": "0.1"})
    said = refusal(capsys)
    assert f"lfmesh {written['lfmesh']}, here 99.0" in said
    assert f"numba {written['numba']}, here 0.1" in said
    assert "numpy" not in said


def test_a_state_that_does_not_fit_its_scene_is_refused_in_one_line(
    cut_short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts, arrays = read_sealed(cut_short / CHECKPOINT, checkpoint.FORMAT)
    with (cut_short / CHECKPOINT).open("wb") as file:
        write_sealed(file, checkpoint.FORMAT, facts, arrays | {"first.means.0.mean": np.zeros((3, 3, 1))})
    assert "saved state belongs to another render: first.means.0.mean has another size" in refusal(capsys)


def test_a_file_that_changed_or_went_since_is_named_in_one_line(
    cut_short: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The copy that the run has will do.
    original = (folder / "chart.png").read_bytes()
    PIL.Image.new("L", (8, 8)).save(folder / "chart.png")
    copy = cut_short / "inputs/chart.png"
    kept = copy.read_bytes()
    # That of the incomplete run is not ours to replace when it is edited; nor is it there in a run that was killed.
    copy.write_bytes(b"edited")
    assert "inputs/chart.png was edited" in refusal(capsys)
    shutil.rmtree(cut_short / "inputs")
    assert "chart.png has changed since the run began" in refusal(capsys)
    (folder / "chart.png").unlink()
    assert "chart.png is missing, but the run began with it" in refusal(capsys)
    copy.parent.mkdir()
    copy.write_bytes(kept)
    assert main(["render", "--resume", "run"]) == 0
    (folder / "chart.png").write_bytes(original)
    assert main(["render", "scene.toml", "-o", "whole"]) == 0
    assert bits(folder / "run") == bits(folder / "whole")


def test_a_file_that_changes_while_it_is_rendered_does_not_pass_for_what_was_rendered(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Tracer.traced

    def traced(self: Tracer, pool: Any, replicate: int, *rest: Any) -> Any:
        if replicate == 2:
            PIL.Image.new("L", (8, 8)).save(folder / "chart.png")
        return original(self, pool, replicate, *rest)

    monkeypatch.setattr(Tracer, "traced", traced)
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    assert not (folder / "run/inputs").exists()
    scene = run.open_run(folder / "run").scene
    with pytest.raises(FileError, match=r"chart\.png has changed since the run began"):
        scene.resolve(scene.targets[0].material.texture or "")


def test_a_render_that_was_cut_short_begins_anew_only_where_that_is_asked_for(
    cut_short: Path, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["render", "scene.toml", "-o", "run", "--seed", "5"]) == 2
    said = capsys.readouterr().err
    assert "continue it with lfmesh render --resume run, or start again with --restart" in said
    assert said.count("\n") == 1
    assert main(["render", "--resume", "run"]) == 0
    assert lf.open_run("run").scene.transport.seed == 0


def test_a_damaged_checkpoint_does_not_stand_in_the_way_of_a_restart(cut_short: Path) -> None:
    (cut_short / CHECKPOINT).write_bytes(b"damaged")
    assert main(["render", "scene.toml", "-o", "run", "--seed", "5", "--restart"]) == 0
    assert not (cut_short / CHECKPOINT).exists()
    assert lf.open_run("run").scene.transport.seed == 5


def test_what_reads_a_run_that_was_killed_says_that_it_can_go_on(
    cut_short: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (run.RAW, run.REPORT):
        (cut_short / name).unlink()
    capsys.readouterr()
    assert main(["decode", "run"]) == 2
    assert "lfmesh render --resume run continues it" in capsys.readouterr().err
    (cut_short / CHECKPOINT).unlink()
    assert main(["decode", "run"]) == 2
    assert "render it again" in capsys.readouterr().err


def test_an_edited_checkpoint_is_refused(cut_short: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Any number of any array, with the zip's checksums made right: a count, a mean that is no number."""
    path = cut_short / CHECKPOINT
    with np.load(path) as file:
        arrays = dict(file)
    for name in arrays.keys() - {"facts"}:
        if arrays[name].size:
            edited = arrays[name].copy()
            edited.flat[edited.size // 2] = np.nan if edited.dtype.kind == "f" else edited.flat[edited.size // 2] + 1
            np.savez(path, **arrays | {name: edited})
            with pytest.raises(FileError, match="is damaged"):
                checkpoint.read(cut_short, image_file.scene_from)
    digest, facts = arrays["facts"]
    np.savez(path, **arrays | {"facts": np.array([digest, facts.replace("60.0", "61.0", 1)])})
    assert "is damaged" in refusal(capsys)


def test_checkpoints_take_a_hundredth_of_the_time_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that a checkpoint moves on by a second, and a replicate by four."""
    now = 0.0
    state = Layout((4, 3, 1), (2, 5), 3).state()
    monkeypatch.setattr(checkpoint.time, "monotonic", lambda: now)
    written: list[float] = []

    def write(*_: object) -> None:
        nonlocal now
        written.append(now)
        now += 1.0

    monkeypatch.setattr(Checkpoints, "_write", write)
    keep = Checkpoints(tmp_path, {})
    for _ in range(250):
        now += 4.0
        keep(state, last=False)
    assert written[0] == 12.0
    assert 8 <= len(written) <= 10
    assert len(written) <= 0.0101 * now
    keep(state, last=True)
    assert written[-1] == now - 1.0


def test_a_full_disk_does_not_end_a_render(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoint, "SECONDS", 0.0)
    monkeypatch.setattr(checkpoint, "write_sealed", full)
    assert main(["render", "scene.toml", "-o", "run"]) == 0
    said = " ".join(capsys.readouterr().err.split())
    assert "Note: run/lfmesh-checkpoint.npz cannot be written: No space left on device; the render continues" in said
    assert not [path for path in (folder / "run").iterdir() if path.name.startswith(STAGING)]
    assert run.open_run(folder / "run").complete
