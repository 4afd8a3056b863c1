"""What a command says that was stopped, by Ctrl-C or SIGTERM, is true: whether there is something to go on from."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.cli import main
from lfmesh.transport.packets.stacks import Stacks
from lfmesh.transport.render.tally import Tally
from tests.cameras import bench_camera
from tests.processor_time import HANGS_S

SCENE = f"{bench_camera(8, 8)}[transport]\nsamples = 4\nreplicates = 4\n"
STUDY = (
    'scene = "scene.toml"\nmetrics = ["light"]\n[[axes]]\npath = "camera.mla.pose.shift_mm[0]"\nvalues = [0.1, 0.2]\n'
)
DATASET = 'scene = "scene.toml"\n[[random]]\npath = "camera.mla.pose.shift_mm[0]"\nvalues = [0.1, 0.2]\n'

MATRIX = "matrix scene.toml --counts 2 2 2 --size-mm 4 4 4 --position-mm 0 0 -540 -o m.npz"
COMMANDS = {
    MATRIX: ("lfmesh.files.matrix.computed", "block", "m.npz.parts"),
    "study study.toml -o out --workers 0": ("lfmesh.study.sweeps.study.here", "unit", "out"),
    "dataset data.toml -o out --count 2 --workers 0": ("lfmesh.study.datasets.dataset.here", "item", "out"),
}
"""What yields the parts of their work, what these are called, and where they are kept."""

SIGNALS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture
def _files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("lfmesh.lightfield.volumes.projector.RAYS_AT_ONCE", 400)
    for name, text in (("scene.toml", SCENE), ("study.toml", STUDY), ("data.toml", DATASET)):
        (tmp_path / name).write_text(text)
    # A shell ignores Ctrl-C for what it runs in the background, these tests perhaps.
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, usual)


def stop_after(parts: int, number: signal.Signals, place: str, patch: pytest.MonkeyPatch) -> None:
    """Send a signal when some parts of the work are done."""
    module, name = place.rsplit(".", 1)
    usual = getattr(__import__(module, fromlist=[name]), name)

    def cut(*given: Any) -> Iterator[Any]:
        computed = usual(*given)
        for _ in range(parts):
            yield next(computed)
        os.kill(os.getpid(), number)
        yield from computed

    patch.setattr(place, cut)


@pytest.mark.usefixtures("_files")
# Each command with a signal of its own, and the quickest with all of them.
@pytest.mark.parametrize(
    ("words", "number"),
    [
        pytest.param(words, number, marks=[pytest.mark.long] if longer else [])
        for i, words in enumerate(COMMANDS)
        for j, number in enumerate(SIGNALS)
        for longer in [i != j and "study" not in words]
    ],
)
def test_what_is_finished_is_said_and_gone_on_from(
    words: str, number: signal.Signals, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    place, part, folder = COMMANDS[words]
    for done, said in (
        (0, f"Stopped: none of its {part}s is finished; the same command begins with the first.\n"),
        (1, f"Stopped: 1 {part} kept in {folder}; the same command continues.\n"),
    ):
        with monkeypatch.context() as patch:
            stop_after(done, number, place, patch)
            assert main(words.split()) == SIGNALS[number]
        assert capsys.readouterr().err.endswith(said)
    assert main(words.split()) == 0


AT_AN_IMPORT = """
import os, signal, sys
class Pressed:
    def find_spec(name, *_):
        if name == "cyclopts":
            os.kill(os.getpid(), signal.SIGINT)
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Pressed)
import lfmesh.cli
"""


def test_ctrl_c_while_the_program_starts_is_no_traceback() -> None:
    done = subprocess.run(
        [sys.executable, "-c", AT_AN_IMPORT], capture_output=True, text=True, timeout=HANGS_S, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


@pytest.mark.usefixtures("_files")
@pytest.mark.parametrize("number", SIGNALS)
def test_one_signal_ends_a_render_whose_packets_have_no_end(
    number: signal.Signals, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the second replicate on no packet moves on; finished work is kept."""
    usual, started = Stacks.take, Tally.restart
    stuck, until = threading.Event(), time.monotonic() + HANGS_S

    def restart(tally: Tally, replicate: int) -> None:
        if replicate == 1:
            stuck.set()
        started(tally, replicate)

    def take(stacks: Stacks, station: int, count: int) -> NDArray[np.void]:
        if not stuck.is_set():
            return usual(stacks, station, count)
        if not sent:
            sent.append(number)
            os.kill(os.getpid(), number)
        assert time.monotonic() < until, "the signal has not ended the render"
        return usual(stacks, station, 0)

    sent: list[int] = []
    monkeypatch.setattr("lfmesh.transport.engine.MOST_EVENTS_EACH", 1 << 60)
    monkeypatch.setattr(Stacks, "take", take)
    monkeypatch.setattr(Tally, "restart", restart)
    assert main(["render", "scene.toml", "-o", "out"]) == SIGNALS[number]
    assert time.monotonic() < until
    assert "interrupted after 1 of 4 replicates" in " ".join(capsys.readouterr().err.split())


@pytest.mark.usefixtures("_files")
@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_that_comes_while_an_object_is_destroyed_ends_the_command(
    number: signal.Signals, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python drops the exception of its handler there, as in callbacks of the garbage collector."""

    class Destroyed:
        def __del__(self) -> None:
            os.kill(os.getpid(), number)
            sum(range(1000))

    until = time.monotonic() + HANGS_S

    def restart(tally: Tally, replicate: int) -> None:
        Destroyed()
        while time.monotonic() < until:
            time.sleep(0.01)

    monkeypatch.setattr(Tally, "restart", restart)
    assert main(["render", "scene.toml", "-o", "out"]) == SIGNALS[number]
    assert time.monotonic() < until
    assert "Traceback" not in capsys.readouterr().err
