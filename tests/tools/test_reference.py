"""tools/reference finds a single bit that differs."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
CHEAP = "paraxial lens"


@pytest.fixture
def reference(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    return importlib.import_module("reference")


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / "tools" / "reference.py"), *map(str, arguments)]
    return subprocess.run(command, env=own, capture_output=True, text=True)


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


def test_a_saved_tree_is_compared_bit_by_bit(tmp_path: Path) -> None:
    saved = tmp_path / "before.json"
    assert run("--save", saved, "--only", CHEAP).returncode == 0
    same = run(saved, "--only", CHEAP)
    assert (same.returncode, same.stdout) == (0, f"1 of 1 reference renders have the bits of {saved}\n")
    digests = json.loads(saved.read_text())
    assert len(set(digests[CHEAP].values())) == 4
    digests[CHEAP]["upper"] = "other"
    saved.write_text(json.dumps(digests))
    changed = run(saved, "--only", CHEAP)
    assert changed.returncode == 1
    assert changed.stdout.splitlines() == [
        f"{CHEAP}: upper",
        f"0 of 1 reference renders have the bits of {saved}",
    ]


@pytest.mark.parametrize(("arguments", "word"), [((), "name what"), (("HEAD", "--only", "nothing"), '"nothing"')])
def test_a_mistake_is_one_line(arguments: tuple[str, ...], word: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("tools/reference: ")
    assert word in line
