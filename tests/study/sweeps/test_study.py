"""A study's table is the same to the bit however it was computed, and nothing ends it that happens at one point."""

import json
import multiprocessing as mp
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

import lfmesh as lf
from lfmesh import provenance
from lfmesh.cli import main
from lfmesh.files import sealed
from lfmesh.scene import inputs
from lfmesh.study.metrics import centre_metrics, comparison
from lfmesh.study.sweeps import pool
from lfmesh.study.sweeps import study as studying
from lfmesh.study.sweeps.pool import Result, in_pool
from lfmesh.study.sweeps.sentences import NOT_KNOWN, in_short
from lfmesh.study.sweeps.study_folder import logged
from lfmesh.study.sweeps.unit import FORMAT, Unit, run_unit, unpacked
from tests.study.studies import PLANE, SHIFT, shifted, small_scene

ROOT = Path(lf.__file__).parents[1]


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The table of the study that all tests here compare with, computed in this process."""
    folder = tmp_path_factory.mktemp("whole")
    shifted().run(folder, workers=0)
    return (folder / "table.csv").read_text()


def events(folder: Path, event: str) -> list[tuple[int, int]]:
    return [(line["point"], line["batch"]) for line in logged(folder) if line["event"] == event]


def test_the_reference_again_differs_by_nothing(table: str) -> None:
    heading, first, *rest = (line.split(",") for line in table.splitlines())
    middle = rest[2]
    assert heading[:4] == ["point", SHIFT, "psnr_db", "psnr_db_stderr"]
    assert first[2:4] == middle[2:4] == ["nan", "nan"]
    assert first[4:] == middle[4:]


def test_a_point_has_the_light_of_its_own_render() -> None:
    found = shifted(3, ("light",))
    scene = found.plan.scene_of(found.plan.points[1])
    outcome = run_outcome(found, 1)
    image = lf.render(scene)
    per_replicate = outcome.columns["light_w_per_pixel"]
    assert per_replicate.mean() == pytest.approx(image.mean.mean(), rel=1e-12)


def run_outcome(study: lf.Study, point: int) -> Any:
    from lfmesh.study.sweeps.unit import reference_films, unpacked

    plan = study.plan
    camera, reference = (plan.camera_of(plan.points[number]) for number in (point, 0))
    unit = Unit(plan.digest, point, 0, camera, reference, plan.metrics, plan.replicates_of(0))
    return unpacked(run_unit(unit, reference_films(unit)), plan.digest, point, 0, plan.metrics)


def test_a_pool_gives_the_same_table(tmp_path: Path, table: str) -> None:
    shifted().run(tmp_path, workers=2)
    assert (tmp_path / "table.csv").read_text() == table


def test_three_shards_give_the_same_table(tmp_path: Path, table: str) -> None:
    folders = [tmp_path / name for name in "abc"]
    for number, folder in enumerate(folders, start=1):
        part = shifted().run(folder, workers=0, shard=(number, 3))
        assert 0 < len(part.failed) < len(part.rows)
        assert len(events(folder, "done")) == 2
    merged = shifted().merge(folders, tmp_path / "all")
    assert (tmp_path / "all" / "table.csv").read_text() == table
    assert not merged.failed


def test_a_dask_cluster_gives_the_same_table(tmp_path: Path, table: str) -> None:
    shifted().run(tmp_path, workers=2, dask="local")
    assert (tmp_path / "table.csv").read_text() == table


def test_batches_use_the_same_replicates(tmp_path: Path) -> None:
    """Their pseudo-values of the light are those of the whole, so that the table holds the same values."""
    scene = small_scene(replicates=8)
    axes = [{"path": SHIFT, "values": [0.05]}]
    whole = lf.Study(scene, axes=axes, metrics=["light"]).run(tmp_path / "a", workers=0)
    parts = lf.Study(scene, axes=axes, metrics=["light"], batches=2).run(tmp_path / "b", workers=0)
    for one, other in zip(whole.rows, parts.rows, strict=True):
        assert other.estimates["light_w_per_pixel"] == pytest.approx(one.estimates["light_w_per_pixel"], rel=1e-9)


def test_what_is_done_is_not_done_again(tmp_path: Path, table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stop_after(2, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        shifted().run(tmp_path, workers=0)
    monkeypatch.undo()
    assert (tmp_path / "table.csv").read_text() != table
    assert len(events(tmp_path, "done")) == 2
    shifted().run(tmp_path, workers=0)
    assert (tmp_path / "table.csv").read_text() == table
    assert Counter(events(tmp_path, "done")) == {(point, 0): 1 for point in range(6)}


def stop_after(units: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Press Ctrl-C when some units are done."""
    usual = studying.here

    def interrupted(jobs: Any) -> Any:
        for number, result in enumerate(usual(jobs)):
            if number == units:
                raise KeyboardInterrupt
            yield result

    monkeypatch.setattr(studying, "here", interrupted)


def test_a_unit_that_cannot_be_read_is_named_and_computed_again(tmp_path: Path, table: str) -> None:
    study = shifted()
    study.run(tmp_path, workers=0)
    cut, flipped = sorted((tmp_path / "units").glob("*.npz"))[1:3]
    cut.write_bytes(cut.read_bytes()[:-200])
    content = bytearray(flipped.read_bytes())
    content[len(content) // 3] ^= 0xFF
    flipped.write_bytes(content)
    study.run(tmp_path, workers=0)
    assert (tmp_path / "table.csv").read_text() == table
    assert events(tmp_path, "unreadable") == [(1, 0), (2, 0)]
    reasons = [line["reason"] for line in logged(tmp_path) if line["event"] == "unreadable"]
    assert cut.name in reasons[0]
    assert Counter(events(tmp_path, "done"))[1, 0] == 2
    assert Counter(events(tmp_path, "done"))[3, 0] == 1


def test_a_point_that_cannot_be_traced_is_named_and_the_others_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A target that reaches into the camera passes as a scene, and fails when it is built."""
    small_scene().in_folder(tmp_path)
    (tmp_path / "scene.toml").write_text(small_scene().dump_toml())
    (tmp_path / "study.toml").write_text(
        'scene = "scene.toml"\nmetrics = ["light"]\n[[axes]]\npath = "targets[0].position_mm[2]"\n'
        "values = [-61.0, 1.0]\n"
    )
    out = tmp_path / "out"
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(out), "--workers", "0"]) == 1
    printed = capsys.readouterr()
    assert "2 of 3 points are done" in printed.out
    assert "targets[0].position_mm[2] = 1 mm" in printed.err
    (failed,) = (line for line in logged(out) if line["event"] == "failed")
    assert failed["point"] == 2
    assert failed["reason"]
    assert failed["reason"] in (out / "table.csv").read_text().replace('""', '"')
    assert "could not be traced" in (out / "report.html").read_text()


CUT_SHORT = "transport.max_events"


def cut_short(**settings: Any) -> lf.Study:
    """Return a study whose second point cuts paths that carry light."""
    axes = [{"path": CUT_SHORT, "values": [6, 2]}]
    return lf.Study(small_scene(samples=8), axes=axes, metrics=["light"], **settings)


@pytest.mark.parametrize("workers", [0, 1])
def test_points_whose_pictures_may_be_wrong_are_warned_of(workers: int, tmp_path: Path) -> None:
    """As their own renders warn: once for all of them in Python, in table and report by their class and share."""
    with pytest.warns(lf.PictureWarning) as told:
        table = cut_short().run(tmp_path, workers=workers)
    (warning,) = (each.message for each in told)
    with pytest.warns(lf.CutPathsWarning) as own:
        lf.render(table.plan.scene_of(table.plan.points[2]))
    # That a picture is black the metrics themselves say.
    (cut,) = (each.message for each in own if isinstance(each.message, lf.CutPathsWarning))
    assert isinstance(warning, lf.CutPathsWarning)
    assert str(warning) == f"1 of 3 points, such as point 2: {cut}"
    assert table.warnings == (warning,)
    assert [row.warned_of for row in table.rows] == ["", "", "CutPathsWarning"]
    assert (tmp_path / "table.csv").read_text().splitlines()[-1].endswith(",CutPathsWarning")
    assert str(warning) in (tmp_path / "report.html").read_text()


def test_warnings_of_a_studys_reference_are_those_of_its_first_point(tmp_path: Path) -> None:
    axes = [{"path": CUT_SHORT, "values": [6]}]
    study = lf.Study(small_scene(samples=8, max_events=2), axes=axes, metrics=["light"])
    with pytest.warns(lf.CutPathsWarning, match="1 of 2 points, such as point 0"):
        study.run(tmp_path / "a", workers=0)
    with pytest.warns(lf.CutPathsWarning, match="1 of 2 points, such as point 0"):
        study.merge([tmp_path / "a"], tmp_path / "b")


def test_a_refused_merge_writes_nothing(tmp_path: Path) -> None:
    shifted(2, ("chief_rays",)).run(tmp_path / "one", workers=0)
    shifted(3, ("chief_rays",)).run(tmp_path / "other", workers=0)
    for second, words in (("other", "holds another study"), ("none", "holds no study")):
        with pytest.raises(lf.LfmeshError, match=words):
            shifted(2, ("chief_rays",)).merge([tmp_path / "one", tmp_path / second], tmp_path / "all")
        assert not (tmp_path / "all").exists()


TEXTURED = PLANE | {"material": {"reflectance": 0.8, "radiance_w_m2_sr": 1.0, "texture": "chart.png"}}


@pytest.mark.parametrize("in_a_table", [False, True])
def test_a_file_that_changes_while_a_study_runs_makes_points_fail_and_is_in_no_value(
    tmp_path: Path, in_a_table: bool
) -> None:
    """Files that an axis names among them; put back, the study goes on to the table of one without the change."""
    for name, grey in (("chart.png", 200), ("other.png", 90)):
        PIL.Image.new("L", (4, 4), grey).save(tmp_path / name)
    scene = small_scene().changed({"targets": [TEXTURED]}).in_folder(tmp_path)
    axes: list[dict[str, Any]] = [{"path": "targets[0].material.texture", "values": ["other.png", "chart.png"]}]
    if in_a_table:
        materials = [TEXTURED["material"] | {"texture": name} for name in axes[0]["values"]]
        axes = [{"path": "targets[0].material", "values": materials}]
    study = lf.Study(scene, axes=axes, metrics=["light"])
    study.run(tmp_path / "whole", workers=0)
    contents = {name: (tmp_path / name).read_bytes() for name in ("chart.png", "other.png")}
    for name in contents:
        PIL.Image.new("L", (4, 4), 255).save(tmp_path / name)
    out = tmp_path / "out"
    with pytest.raises(lf.LfmeshError, match=r"chart\.png has changed"):
        study.run(out, workers=0)
    (tmp_path / "chart.png").write_bytes(contents["chart.png"])
    study.run(out, workers=0)
    (failed,) = (line for line in logged(out) if line["event"] == "failed")
    assert failed["point"] == 1
    assert "other.png has changed" in failed["reason"]
    (tmp_path / "other.png").write_bytes(contents["other.png"])
    study.run(out, workers=0)
    assert (out / "table.csv").read_text() == (tmp_path / "whole" / "table.csv").read_text()
    # Changed between two runs, it is another study.
    PIL.Image.new("L", (4, 4), 255).save(tmp_path / "other.png")
    with pytest.raises(lf.LfmeshError, match="holds another study"):
        lf.Study(scene, axes=axes, metrics=["light"]).run(out, workers=0)


def test_a_unit_that_another_program_computed_is_named_and_computed_again(tmp_path: Path, table: str) -> None:
    shifted().run(tmp_path, workers=0)
    path = tmp_path / "units" / "point000002-batch000.npz"
    facts, arrays = sealed.read_sealed(path, FORMAT)
    own = provenance.program()
    with path.open("wb") as file, pytest.MonkeyPatch.context() as patch:
        patch.setattr(sealed, "program", lambda: own | {"sources": "others"})
        sealed.write_sealed(file, FORMAT, facts, arrays)
    shifted().run(tmp_path, workers=0)
    (reason,) = (line["reason"] for line in logged(tmp_path) if line["event"] == "unreadable")
    assert f"sources others, here {own['sources']}" in reason
    assert Counter(events(tmp_path, "done"))[2, 0] == 2
    assert (tmp_path / "table.csv").read_text() == table


def test_units_of_another_processor_are_taken_with_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a folder that goes on elsewhere, and of outcomes that workers of a cluster send."""
    study = shifted(3, ("chief_rays",))
    with monkeypatch.context() as patch:
        patch.setattr(sealed, "processor", lambda: "another")
        study.run(tmp_path, workers=0)
        ((unit, path),) = units(study, 1, tmp_path / "reference" / "batch000.npz")
        content, reason = pool.computed(unit, path)
    assert not reason
    with pytest.warns(sealed.ProcessorWarning, match="another kind of processor .another, here "):
        study.run(tmp_path, workers=0)
    assert content is not None
    with pytest.warns(sealed.ProcessorWarning, match="another kind of processor .another, here "):
        unpacked(content, unit.study, unit.point, unit.batch, unit.metrics)


def test_an_edited_unit_is_named_and_computed_again(tmp_path: Path, table: str) -> None:
    shifted().run(tmp_path, workers=0)
    path = tmp_path / "units" / "point000002-batch000.npz"
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **arrays | {"column.light_w_per_pixel": 2.0 * arrays["column.light_w_per_pixel"]})
    shifted().run(tmp_path, workers=0)
    assert [line["point"] for line in logged(tmp_path) if line["event"] == "unreadable"] == [2]
    assert (tmp_path / "table.csv").read_text() == table


def test_a_unit_that_another_program_planned_is_not_computed(tmp_path: Path) -> None:
    ((unit, _),) = units(shifted(1, ("chief_rays",)), 1, tmp_path)
    content, reason = pool.computed(replace(unit, program={**unit.program, "numba": "0.1"}), tmp_path)
    assert content is None
    assert f"numba 0.1, here {unit.program['numba']}" in reason


def test_another_study_does_not_go_into_the_same_folder(tmp_path: Path) -> None:
    shifted(3, ("chief_rays",)).run(tmp_path, workers=0)
    with pytest.raises(lf.LfmeshError, match="holds another study"):
        shifted(4, ("chief_rays",)).run(tmp_path, workers=0)


@pytest.mark.parametrize("name", ["lfmesh", "sources", "numba"])
def test_another_program_does_not_go_on_in_the_same_folder(tmp_path: Path, name: str) -> None:
    study = shifted(3, ("chief_rays",))
    study.run(tmp_path, workers=0)
    facts = json.loads((tmp_path / "study.json").read_text())
    facts["program"][name] = "others"
    (tmp_path / "study.json").write_text(json.dumps(facts))
    with pytest.raises(lf.LfmeshError, match=f"written by another program .{name} others, here "):
        study.run(tmp_path, workers=0)


def test_a_full_disk_ends_nothing(tmp_path: Path, table: str, monkeypatch: pytest.MonkeyPatch) -> None:
    usual = studying.StudyFolder.keep

    def full(self: Any, point: int, batch: int, content: bytes) -> None:
        if point in (2, 3):
            raise OSError(28, "No space left on device")
        usual(self, point, batch, content)

    monkeypatch.setattr(studying.StudyFolder, "keep", full)
    shifted().run(tmp_path, workers=0)
    assert events(tmp_path, "not written") == [(2, 0), (3, 0)]
    assert (tmp_path / "table.csv").read_text() == table
    monkeypatch.undo()
    shifted().run(tmp_path, workers=0)
    assert Counter(events(tmp_path, "begun"))[2, 0] == 2
    assert Counter(events(tmp_path, "begun"))[1, 0] == 1


def test_a_disk_that_has_no_room_for_the_reference_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not as an output that cannot be printed, which the errors of nameless files are taken for."""

    usual = studying.StudyFolder._write

    def full(folder: Path, name: str, content: bytes) -> None:
        if name.startswith("batch"):
            raise OSError(28, "No space left on device")
        usual(folder, name, content)

    monkeypatch.setattr(studying.StudyFolder, "_write", staticmethod(full))
    with pytest.raises(lf.LfmeshError, match=r"batch000\.npz cannot be written: No space left"):
        shifted(1).run(tmp_path, workers=0)


def units(study: lf.Study, count: int, folder: Path) -> list[tuple[Unit, Path]]:
    plan = study.plan
    reference = plan.camera_of(plan.points[0])
    return [
        (Unit(plan.digest, n, 0, plan.camera_of(plan.points[n]), reference, plan.metrics, range(4)), folder)
        for n in range(1, count + 1)
    ]


class NeverRead(type(Path())):  # type: ignore[misc]  # a path of the system that runs the test
    """A file that nobody ever comes to the end of opening."""

    def __fspath__(self) -> str:
        while True:
            time.sleep(1.0)


def test_a_worker_that_dies_does_not_end_the_study(tmp_path: Path) -> None:
    """Two processes are killed with a unit in hand: it is tried again, and given up at the second death."""
    from lfmesh.study.sweeps.unit import reference_films

    study = shifted(4, ("chief_rays",))
    path = tmp_path / "reference.npz"
    jobs = units(study, 4, path)
    path.write_bytes(reference_films(jobs[0][0]))
    # Killed while it waits for that file, twice.
    jobs[1] = (jobs[1][0], NeverRead("reference.npz"))
    results: dict[int, Result] = {}

    def kill() -> None:
        killed: set[int] = set()
        while len(killed) < pool.TRIES:
            time.sleep(0.1)
            # The first unit is done: the process has the second in hand, or a new one starts with it.
            for child in mp.active_children() if results else ():
                if child.name == "lfmesh study" and child.pid is not None and child.pid not in killed:
                    killed.add(child.pid)
                    os.kill(child.pid, signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    for result in in_pool(jobs, 1):
        results[result.unit.point] = result
    thread.join()
    assert results[2].content is None
    assert "SIGKILL" in results[2].reason
    assert results[2].deaths == pool.TRIES
    assert all(results[point].content is not None for point in (1, 3, 4))


CHILD = """
import sys
from tests.study.studies import shifted
shifted({points}).run(sys.argv[1], workers={workers})
"""


def in_a_child(folder: Path, points: int, workers: int) -> tuple[list[str], dict[str, str]]:
    """Return command and environment of a process that runs a study."""
    command = [sys.executable, "-c", CHILD.format(points=points, workers=workers), str(folder)]
    return command, {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}


def killed_and_resumed(folder: Path, points: int, workers: int, kills: int, seed: int) -> None:
    """Run a study in a process that is killed at random moments, until it ends by itself."""
    draw = np.random.default_rng(seed)
    command, environment = in_a_child(folder, points, workers)
    for _ in range(kills):
        before = len(events(folder, "done"))
        child = subprocess.Popen(command, cwd=ROOT, env=environment, start_new_session=True)
        # Somewhere in the work, and not only while Python starts.
        while child.poll() is None and len(events(folder, "begun")) == len(events(folder, "done")) == before:
            time.sleep(0.02)
        time.sleep(float(draw.uniform(0.0, 1.5)))
        if child.poll() is None:
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
    subprocess.run(command, cwd=ROOT, env=environment, check=True, timeout=600)


def check_kills(folder: Path, points: int, in_flight: int, kills: int) -> None:
    done, begun = Counter(events(folder, "done")), Counter(events(folder, "begun"))
    # What is written is written once; the log's line comes after it, and a kill may come between.
    assert set(begun) == {(point, 0) for point in range(points + 1)}
    assert all(count == 1 for count in done.values())
    assert sum(begun.values()) - (points + 1) <= in_flight * kills
    assert not [line for line in logged(folder) if line["event"] == "unreadable"]


def test_killed_at_a_random_moment_it_goes_on_to_the_same_table(tmp_path: Path, table: str) -> None:
    killed_and_resumed(tmp_path, points=5, workers=0, kills=1, seed=11)
    assert (tmp_path / "table.csv").read_text() == table
    check_kills(tmp_path, 5, in_flight=1, kills=1)


def test_workers_of_a_study_that_is_killed_end_by_themselves(tmp_path: Path) -> None:
    """The process that started them alone is killed; they hold its output open until they end."""
    command, environment = in_a_child(tmp_path, points=60, workers=2)
    child = subprocess.Popen(command, cwd=ROOT, env=environment, start_new_session=True, stdout=subprocess.PIPE)
    try:
        while child.poll() is None and not events(tmp_path, "done"):
            time.sleep(0.02)
        child.kill()
        child.communicate(timeout=120)
        assert child.returncode == -signal.SIGKILL
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)


@pytest.mark.long
def test_a_study_of_200_units_killed_twenty_times_goes_on_to_the_same_table(tmp_path: Path) -> None:
    shifted(199).run(tmp_path / "whole", workers=2)
    killed_and_resumed(tmp_path / "killed", points=199, workers=2, kills=20, seed=12)
    tables = [(tmp_path / name / "table.csv").read_text() for name in ("whole", "killed")]
    assert tables[0] == tables[1]
    check_kills(tmp_path / "killed", 199, in_flight=2, kills=20)


def test_the_log_survives_half_a_line(tmp_path: Path) -> None:
    study = shifted(3, ("chief_rays",))
    study.run(tmp_path, workers=0)
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"event": "do')
    study.run(tmp_path, workers=0)
    assert json.loads((tmp_path / "log.jsonl").read_text().splitlines()[-1])["event"] == "finished"
    assert [line["event"] for line in logged(tmp_path)].count("finished") == 2


def test_progress_counts_units_and_names_best_and_worst(tmp_path: Path) -> None:
    told: list[Any] = []
    shifted(3).run(tmp_path, workers=0, progress=told.append)
    assert [now.done for now in told] == [0, 1, 2, 3, 4]
    assert all(now.total == 4 for now in told)
    assert told[-1].best == f"{SHIFT} = 0 mm"
    assert told[-1].worst in (f"{SHIFT} = -0.1 mm", f"{SHIFT} = 0.1 mm")
    assert told[-1].seconds_left == 0.0


def test_the_time_left_knows_that_searches_trace_many_cameras(tmp_path: Path) -> None:
    told: list[Any] = []
    study = shifted(2, metrics=("chief_rays",), limits={"chief_rays_rms_px": 0.3})
    study.run(tmp_path, workers=0, progress=told.append)
    # Reference, two points, and a search to either side, each of which is elevenfold.
    assert [now.size_left for now in told] == pytest.approx([1.0, 6.0, 23.0 / 3.0, 11.0, 22.0 / 7.0, 1.0])
    now = told[3]
    assert now.seconds_left == pytest.approx(now.seconds / 3.0 * 2.0 * 11.0)


def test_scenes_are_compared_with_the_first(tmp_path: Path) -> None:
    dim = {**PLANE, "material": {"reflectance": 0.0, "radiance_w_m2_sr": 0.5}}
    scenes = [small_scene(), small_scene().changed({"targets": [dim], "name": "dim"})]
    table = lf.Study(scenes, metrics=["light"]).run(tmp_path, workers=0)
    assert table.rows[1].estimates["light_ratio"].value == pytest.approx(0.5, rel=1e-12)
    assert "dim" in (tmp_path / "table.csv").read_text()


def test_a_report_says_why_a_metric_is_not_known(tmp_path: Path) -> None:
    black = {**PLANE, "material": {"reflectance": 0.0, "radiance_w_m2_sr": 0.0}}
    scenes = [small_scene(), small_scene().changed({"targets": [black], "name": "black"})]
    table = lf.Study(scenes, metrics=["light", "noise"]).run(tmp_path, workers=0)
    said = [line for line in in_short(table) if NOT_KNOWN in line]
    assert said == ["noise is not known at 1 of 2 points (black): there is no light, or not enough of it."]


def test_a_folder_that_was_emptied_serves_another_study_in_the_same_process(tmp_path: Path) -> None:
    """Its films of the reference are its own, not those that were read from the same place before."""
    shifted(2).run(tmp_path / "one", workers=0)
    shutil.rmtree(tmp_path / "one")
    tables = []
    for name in ("one", "other"):
        scene = small_scene(seed=9)
        axes = [{"path": SHIFT, "values": [0.1]}]
        tables.append(lf.Study(scene, axes=axes, metrics=["psnr"]).run(tmp_path / name, workers=0).to_csv())
    assert tables[0] == tables[1]


def test_what_metrics_find_of_the_reference_alone_is_found_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of each of four cameras the centres of all replicates, and without one of four; of the reference no more."""
    of_cameras: Counter[float] = Counter()
    plain = comparison.estimate_centres

    def counted(white: lf.Image, scene: lf.Scene) -> lf.Calibration:
        of_cameras[white.scene.camera.mla.pose.shift_mm[0]] += 1
        return plain(white, scene)

    for module in (centre_metrics, comparison):
        monkeypatch.setattr(module, "estimate_centres", counted)
    # Its file is told by its contents throughout, however long the study takes: once it has aged, it is read again.
    monkeypatch.setattr(inputs, "FRESH_NS", 10**18)
    shifted(4, ("centres",)).run(tmp_path, workers=0)
    # The reference is also a camera of the study, which is compared with itself.
    assert sorted(of_cameras.values()) == [5, 5, 5, 5, 10]
