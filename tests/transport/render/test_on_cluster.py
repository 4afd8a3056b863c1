"""A render on the workers of a cluster has the bits of one in a single process, whatever happens to a worker."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed import Client, LocalCluster

import lfmesh as lf
from lfmesh import provenance
from lfmesh.errors import LfmeshError
from lfmesh.transport.render.on_cluster import render_on_cluster
from tests.cameras import close_up_camera

PLANE = {
    "shape": {"kind": "plane", "width_mm": 7.0, "height_mm": 6.0},
    "position_mm": [0, 0, -60.0],
    "material": {"reflectance": 0.8, "radiance_w_m2_sr": 100.0, "texture": "chart.png"},
}


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> lf.Scene:
    import PIL.Image

    folder = tmp_path_factory.mktemp("scene")
    pixels = np.random.default_rng(3).integers(0, 255, (8, 8, 3)).astype(np.uint8)
    PIL.Image.fromarray(pixels).save(folder / "chart.png")
    transport = {"replicates": 3, "samples": 24, "target_error": 0.05}
    scene = lf.Scene(camera=close_up_camera(20, 16), targets=[PLANE], transport=transport)
    return scene.in_folder(folder).pinned()


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster


def test_a_cluster_has_the_same_bits(cluster: Any, scene: lf.Scene) -> None:
    reports: list[lf.Progress] = []
    image = render_on_cluster(scene, cluster.scheduler_address, progress=reports.append)
    whole = lf.render(scene)
    for name in ("mean", "stderr", "hits"):
        assert getattr(image, name).tobytes() == getattr(whole, name).tobytes()
    assert image.ledger == whole.ledger
    assert [report.replicate for report in reports if report.stage == "tracing"] == [1, 2, 3]


def test_a_cluster_of_another_program_is_refused(
    cluster: Any, scene: lf.Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = provenance.program()
    monkeypatch.setattr(provenance, "program", lambda: own | {"embreex": "0.1"})
    with pytest.raises(LfmeshError, match=rf"worker tcp.* runs another program: embreex {own['embreex']}, here 0\.1"):
        render_on_cluster(scene, cluster.scheduler_address)


def test_a_worker_that_dies_costs_its_pieces_alone(cluster: Any, scene: lf.Scene) -> None:
    killed = []
    longer = scene.changed({"transport.replicates": 6, "transport.samples": 6 * 256})

    def kill_one(_: lf.Progress) -> None:
        if not killed:
            with Client(cluster) as client:
                killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    image = render_on_cluster(longer, cluster.scheduler_address, progress=kill_one)
    assert killed
    assert image.mean.tobytes() == lf.render(longer).mean.tobytes()


def test_a_file_that_has_changed_is_refused(cluster: Any, scene: lf.Scene) -> None:
    """A picture is read more than once, and every time it must be the one that was meant."""
    path = scene.resolve("chart.png")
    before = path.read_bytes()
    try:
        Path(path).write_bytes(before + b" ")
        with pytest.raises(LfmeshError, match=r"chart\.png"):
            render_on_cluster(scene, cluster.scheduler_address)
    finally:
        Path(path).write_bytes(before)


def test_no_scheduler_is_one_line(scene: lf.Scene) -> None:
    with pytest.raises(LfmeshError, match="no scheduler answers"):
        render_on_cluster(scene, "nonsense://nowhere")
