"""A cluster whose workers are missing, read other files or run another program, or whose scheduler dies, gives no value
that is wrong and ends with words; finished work is kept."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import PIL.Image
import pytest

import lfmesh as lf
from lfmesh import cluster, provenance
from lfmesh.study.sweeps.study_folder import logged
from lfmesh.transport.render.on_cluster import render_on_cluster
from tests.processor_time import HANGS_S
from tests.study.studies import PLANE, SHIFT, shifted, small_scene

distributed = pytest.importorskip("distributed")
Client = distributed.Client

PACKAGE = Path(lf.__file__).parent
ITS_FOLDER = Path("/proc/self/cwd")
"""The folder that a process works in: one name, and for each process another place."""


def test_a_dask_that_cannot_be_imported_is_told_from_one_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = ImportError("cannot import name 'Client' from 'distributed'")

    class Finder:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "distributed":
                raise broken

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
    for name in [name for name in sys.modules if name.split(".")[0] == "distributed"]:
        monkeypatch.delitem(sys.modules, name)
    why = "--dask needs dask.distributed, which cannot be imported: cannot import name 'Client'"
    with pytest.raises(lf.LfmeshError, match=why), cluster.connected("local", 1):
        pass
    broken = ModuleNotFoundError("No module named 'distributed'", name="distributed")
    with (
        pytest.raises(lf.LfmeshError, match=r"--dask needs dask\.distributed: pip install"),
        cluster.connected("local", 1),
    ):
        pass


def started(*words: str, folder: Path | None = None, sources: Path = PACKAGE.parent) -> subprocess.Popen[bytes]:
    """Start a program of dask in a folder, with lfmesh from there, if it has one, or from some sources."""
    return subprocess.Popen(
        [sys.executable, "-m", *words, "--no-dashboard"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=folder, env=os.environ | {"PYTHONPATH": str(sources)},
    )  # fmt: skip


@contextmanager
def joined(address: str, *workers: dict[str, Any]) -> Iterator[None]:
    """Start workers of one thread each, and wait until all have joined the scheduler."""
    words = "distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1"
    processes = [started(*words, **each) for each in workers]
    try:
        with Client(address) as client:
            client.wait_for_workers(len(workers), timeout=HANGS_S)
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler of its own process, without workers, and the address that it listens at."""
    facts = tmp_path / "scheduler.json"
    process = started("distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(facts))
    try:
        with Client(scheduler_file=str(facts), timeout=HANGS_S) as client:
            address = client.scheduler.address
        yield process, address
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("command", ["render", "study"])
def test_a_scheduler_without_workers_is_waited_for_with_words_and_an_end(
    command: str, scheduler: tuple[Any, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(cluster, "SAID_SECONDS", 0.5)
    monkeypatch.setattr(cluster, "ENDS_SECONDS", 3.0)
    run = {
        "render": lambda: render_on_cluster(small_scene(), scheduler[1]),
        "study": lambda: shifted(1, ("chief_rays",)).run(tmp_path, dask=scheduler[1]),
    }[command]
    with (
        pytest.warns(cluster.ClusterWarning, match="no worker has joined the scheduler: waiting for up to 3 s"),
        pytest.raises(lf.LfmeshError, match="no worker has joined the scheduler; finished work is kept"),
    ):
        run()


def impatient_client(address: str, timeout: str) -> Any:
    return Client(address, timeout="3s")


def test_a_study_whose_scheduler_dies_ends_and_keeps_what_is_finished(
    scheduler: tuple[Any, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the client no longer looks for it, here after 3 s in place of 10."""
    monkeypatch.setattr(distributed, "Client", impatient_client)
    process, address = scheduler
    worker = started("distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1")

    def kill(progress: Any) -> None:
        if progress.done:
            process.kill()

    try:
        with pytest.raises(lf.LfmeshError, match="the scheduler is gone; finished work is kept"):
            shifted(8, ("chief_rays",)).run(tmp_path / "out", dask=address, progress=kill)
    finally:
        worker.kill()
        worker.wait()
    done = [line["point"] for line in logged(tmp_path / "out") if line["event"] == "done"]
    assert 0 < len(done) < 9
    shifted(8, ("chief_rays",)).run(tmp_path / "out", workers=0)
    begun = [line["point"] for line in logged(tmp_path / "out") if line["event"] == "begun"]
    assert all(begun.count(point) == 1 for point in done)


def test_units_whose_only_worker_is_killed_are_computed_by_the_next(scheduler: tuple[Any, str], tmp_path: Path) -> None:
    """With the reference pictures, which went with it, and the same table as without a cluster."""
    _, address = scheduler
    words = "distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1", "--no-nanny"
    workers = [started(*words)]

    def replace(progress: Any) -> None:
        if progress.done and len(workers) == 1:
            workers[0].kill()
            workers[0].wait()
            workers.append(started(*words))

    try:
        table = shifted(6).run(tmp_path / "out", dask=address, progress=replace)
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()
    assert len(workers) == 2
    assert not table.failed
    shifted(6).run(tmp_path / "here", workers=0)
    assert (tmp_path / "out" / "table.csv").read_text() == (tmp_path / "here" / "table.csv").read_text()


@pytest.mark.long
@pytest.mark.skipif(not ITS_FOLDER.is_dir(), reason="needs a name that is another place for each process")
def test_a_worker_that_reads_another_texture_gives_no_value(
    scheduler: tuple[Any, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its points fail and say why; those of the other worker, and all of two good ones, are those of this process."""
    ours, theirs = (tmp_path / name for name in ("ours", "theirs"))
    for folder, grey in ((ours, 60), (theirs, 250)):
        folder.mkdir()
        PIL.Image.new("L", (4, 4), grey).save(folder / "chart.png")
    monkeypatch.chdir(ours)
    material = PLANE["material"] | {"texture": str(ITS_FOLDER / "chart.png")}
    axes = [{"path": SHIFT, "range": (-0.1, 0.1), "count": 7}]
    # Beside the scene there is no file of that name, which would serve as well.
    scene = small_scene().changed({"targets": [PLANE | {"material": material}]}).in_folder(tmp_path / "scene")
    study = lf.Study(scene, axes=axes, metrics=["light"])
    study.run(tmp_path / "here", workers=0)
    whole = (tmp_path / "here" / "table.csv").read_text()
    _, address = scheduler
    with joined(address, {"folder": ours}, {"folder": theirs}):
        table = study.run(tmp_path / "out", dask=address)
    assert table.failed
    assert all("chart.png has changed" in row.fault for row in table.failed)
    bad = {str(row.point.number) for row in table.failed}
    lines = (tmp_path / "out" / "table.csv").read_text().splitlines()
    assert [line for line in lines if line.split(",")[0] not in bad] == [
        line for line in whole.splitlines() if line.split(",")[0] not in bad
    ]
    with joined(address, {"folder": ours}, {"folder": ours}):
        study.run(tmp_path / "out", dask=address)
    assert (tmp_path / "out" / "table.csv").read_text() == whole


def test_a_worker_with_other_sources_is_refused_though_its_version_is_the_same(
    scheduler: tuple[Any, str], tmp_path: Path
) -> None:
    """By a study and by a render, before anything is traced, in a line that names both."""
    shutil.copytree(PACKAGE, tmp_path / "lfmesh", ignore=shutil.ignore_patterns("__pycache__"))
    with (tmp_path / "lfmesh" / "kernels" / "__init__.py").open("a") as file:
        file.write("# Another program.\n")
    _, address = scheduler
    said = rf"worker tcp.* runs another program: sources \w+, here {provenance.program()['sources']}$"
    with joined(address, {}, {"sources": tmp_path, "folder": tmp_path}):
        with pytest.raises(lf.LfmeshError, match=said):
            shifted(2, ("chief_rays",)).run(tmp_path / "out", dask=address)
        with pytest.raises(lf.LfmeshError, match=said):
            render_on_cluster(small_scene(), address)
