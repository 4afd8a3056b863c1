"""tools/reference finds a single bit that differs."""

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
CHEAP = "paraxial lens"


class Ran(NamedTuple):
    """What a call of the tool has returned and printed."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("reference")


@pytest.fixture
def run(reference: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """Call the tool as its command line does; it renders in processes of its own."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))

    def called(*arguments: object) -> Ran:
        monkeypatch.setattr(sys, "argv", ["tools/reference", *map(str, arguments)])
        try:
            code = reference.main()
        except SystemExit as end:
            code = end.code
        return Ran(code, *capsys.readouterr())

    return called


def test_there_are_forty_scenes_or_more_and_all_are_valid(reference: Any) -> None:
    assert len(reference.cases()) >= 40
    for request in reference.requests(reference.cases()):
        scene = reference.lf.Scene(**json.loads(json.dumps(request["tables"])))
        assert scene.transport.threads == 1
        assert np.prod(scene.camera.sensor.pixels) <= 200
        assert scene.transport.samples == 8


def test_a_digest_tells_single_bits_and_shapes(reference: Any) -> None:
    numbers = np.random.default_rng(0).random((3, 2, 1))
    other = numbers.copy()
    other[1, 1, 0] = np.nextafter(other[1, 1, 0], 2.0)
    assert reference.digest(numbers) == reference.digest(numbers.copy())
    assert len({reference.digest(each) for each in (numbers, other, numbers.reshape(2, 3, 1), -0.0, 0.0)}) == 5


def test_a_saved_tree_is_compared_bit_by_bit(run: Callable[..., Ran], tmp_path: Path) -> None:
    saved = tmp_path / "before.json"
    assert run("--save", saved, "--only", CHEAP).returncode == 0
    digests = json.loads(saved.read_text())
    assert len(set(digests[CHEAP].values())) == 4
    digests[CHEAP]["upper"] = "other"
    saved.write_text(json.dumps(digests))
    changed = run(saved, "--only", CHEAP)
    # All others have the bits that were saved.
    assert changed.returncode == 1
    assert changed.stdout.splitlines() == [
        f"{CHEAP}: upper",
        f"0 of 1 reference renders have the bits of {saved}",
    ]


@pytest.mark.parametrize(("arguments", "word"), [((), "name what"), (("HEAD", "--only", "nothing"), '"nothing"')])
def test_a_mistake_is_one_line(run: Callable[..., Ran], arguments: tuple[str, ...], word: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("tools/reference: ")
    assert word in line
