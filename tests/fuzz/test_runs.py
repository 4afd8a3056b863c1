"""Run folders with bits flipped at random are never read as if they were whole."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import lfmesh as lf
from lfmesh.errors import FileError
from lfmesh.files import run

FILES = ("raw.exr", "report.json", "manifest.json")

flips = st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 7)), min_size=1, max_size=4)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, lf.Image]:
    from lfmesh.scene import loads, solved
    from tests.cameras import bench_camera

    folder = tmp_path_factory.mktemp("whole")
    scene = solved(loads(bench_camera(4, 4)))
    mean = np.random.default_rng(5).uniform(1.0, 2.0, (40, 40, 1)) * 1e-12
    ledger = lf.Ledger(unit="m² sr", emitted=1.0, absorbed={"stop": 1.0})
    image = lf.Image(mean, 0.1 * mean, scene, ledger, seconds=7.0, replicates=8, samples=64.0, engine="mesh engine")
    run.save(image, folder)
    return folder, run.open_run(folder)


def is_the_same_or_refused(whole: tuple[Path, lf.Image], name: str, flips: list[tuple[float, int]], cut: float) -> None:
    folder, image = whole
    copy = folder.parent / "copy"
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(folder, copy)
    content = bytearray((copy / name).read_bytes())
    for share, bit in flips:
        # Most headers stand at the start.
        content[min(int(share**3 * len(content)), len(content) - 1)] ^= 1 << bit
    (copy / name).write_bytes(bytes(content[: max(1, int(cut * len(content)))]))
    refusal, back = "", None
    try:
        back = run.open_run(copy)
    except FileError as error:
        refusal = str(error)
    if back is None:
        assert str(copy) in refusal
        assert len(refusal.splitlines()) == 1
    else:
        np.testing.assert_array_equal(back.mean, image.mean)
        assert back.ledger == image.ledger
        assert back.scene == image.scene


cuts = st.one_of(st.just(1.0), st.just(1.0), st.floats(0.0, 1.0))
unhurried = settings(
    deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@settings(unhurried, max_examples=100)
@given(st.sampled_from(FILES), flips, cuts)
def test_a_run_with_flipped_bits_is_refused_or_the_same(
    whole: tuple[Path, lf.Image], name: str, flips: list[tuple[float, int]], cut: float
) -> None:
    is_the_same_or_refused(whole, name, flips, cut)


@pytest.mark.long
@settings(unhurried, max_examples=2_000)
@given(st.sampled_from(FILES), flips, cuts)
def test_many_runs_with_flipped_bits_are_refused_or_the_same(
    whole: tuple[Path, lf.Image], name: str, flips: list[tuple[float, int]], cut: float
) -> None:
    is_the_same_or_refused(whole, name, flips, cut)
