"""A cluster without workers, or whose scheduler dies, is waited for with words and an end; what is finished is kept."""

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import lfmesh as lf
from lfmesh import cluster
from lfmesh.study.sweeps.study_folder import logged
from lfmesh.transport.render.on_cluster import render_on_cluster
from tests.processor_time import HANGS_S
from tests.study.studies import shifted, small_scene

pytest.importorskip("distributed")


def started(*words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", *words, "--no-dashboard"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """A scheduler of its own process, without workers, and the address that it listens at."""
    from distributed import Client

    facts = tmp_path / "scheduler.json"
    process = started("distributed.cli.dask_scheduler", "--port", "0", "--scheduler-file", str(facts))
    try:
        with Client(scheduler_file=str(facts), timeout=HANGS_S) as client:
            address = client.scheduler.address
        yield process, address
    finally:
        process.kill()
        process.wait()


def test_a_scheduler_without_workers_is_waited_for_with_words_and_an_end(
    scheduler: tuple[Any, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "SAID_SECONDS", 0.5)
    monkeypatch.setattr(cluster, "ENDS_SECONDS", 3.0)
    with (
        pytest.warns(cluster.ClusterWarning, match="no worker has joined the scheduler: waiting for up to 3 s"),
        pytest.raises(lf.LfmeshError, match="no worker has joined the scheduler; what is finished is kept"),
    ):
        render_on_cluster(small_scene(), scheduler[1])


def test_a_study_whose_scheduler_dies_ends_and_keeps_what_is_finished(
    scheduler: tuple[Any, str], tmp_path: Path
) -> None:
    process, address = scheduler
    worker = started("distributed.cli.dask_worker", address, "--nworkers", "1", "--nthreads", "1")

    def kill(progress: Any) -> None:
        if progress.done:
            process.kill()

    try:
        with pytest.raises(lf.LfmeshError, match="the scheduler is gone; what is finished is kept"):
            shifted(8, ("chief_rays",)).run(tmp_path / "out", dask=address, progress=kill)
    finally:
        worker.kill()
        worker.wait()
    done = [line["point"] for line in logged(tmp_path / "out") if line["event"] == "done"]
    assert 0 < len(done) < 9
    shifted(8, ("chief_rays",)).run(tmp_path / "out", workers=0)
    begun = [line["point"] for line in logged(tmp_path / "out") if line["event"] == "begun"]
    assert all(begun.count(point) == 1 for point in done)
