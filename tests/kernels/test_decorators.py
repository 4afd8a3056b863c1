"""Compiled kernels: once for all constants, kept between processes, wherever they may be kept."""

import json
import os
import subprocess
import sys
from enum import IntEnum
from pathlib import Path
from typing import Any

import numba
import pytest

import lfmesh.geometry.surfaces.surface
import lfmesh.kernels.decorators
from lfmesh.kernels import cache
from lfmesh.kernels.cache import KEPT, digest, remove_older_versions
from lfmesh.scene.camera import lens, qcon
from tests.processor_time import HANGS_S

ROOT = Path(__file__).resolve().parents[2]

MODULE = """
import json

from numba.core import event

from lfmesh.kernels.decorators import kernel


@kernel
def scaled(x: float, number: int) -> float:
    return x * number


@kernel
def twice_and_thrice(x: float) -> float:
    return scaled(x, 2) + scaled(x, 3)


if __name__ == "__main__":
    with event.install_recorder("numba:compile") as recorder:
        value = twice_and_thrice(1.5)
    begun = [e.data["dispatcher"].py_func for _, e in recorder.buffer if e.is_start]
    print(json.dumps({
        "value": value,
        "compiled": begun.count(scaled.py_func),
        "cached": sum(twice_and_thrice.stats.cache_hits.values()),
    }))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A program with kernels of its own, which nobody has compiled yet."""
    file = tmp_path / "own" / "program.py"
    file.parent.mkdir()
    file.write_text(MODULE)
    return file


def started(program: Path, **environment: str) -> subprocess.Popen[str]:
    own = {"PYTHONPATH": str(ROOT), **environment}
    return subprocess.Popen([sys.executable, str(program)], env=os.environ | own, stdout=subprocess.PIPE, text=True)


def outcome(process: subprocess.Popen[str]) -> dict[str, Any]:
    printed, _ = process.communicate(timeout=HANGS_S)
    assert process.returncode == 0
    return json.loads(printed)


def test_a_kernel_is_compiled_once_for_all_constants_and_kept(program: Path) -> None:
    assert outcome(started(program)) == {"value": 7.5, "compiled": 1, "cached": 0}
    assert outcome(started(program)) == {"value": 7.5, "compiled": 0, "cached": 1}


def test_where_the_package_cannot_be_written_kernels_are_kept_with_the_user(program: Path, tmp_path: Path) -> None:
    # A file where the folder of compiled code should be stops the superuser too.
    (program.parent / "__pycache__").touch()
    kept = {"XDG_CACHE_HOME": str(tmp_path / "user"), "NUMBA_CACHE_DIR": ""}
    assert outcome(started(program, **kept))["cached"] == 0
    assert list((tmp_path / "user").rglob("*.nbi"))
    assert outcome(started(program, **kept))["cached"] == 1


CALLED = """
from lfmesh.kernels.decorators import kernel
from numbers_of_ours import FACTOR


@kernel
def scaled(x):
    return FACTOR * x
"""

CALLING = """
from called import scaled
from lfmesh.kernels.decorators import kernel


@kernel
def scaled_twice(x):
    return scaled(scaled(x))


print(scaled_twice(1.0), sum(scaled_twice.stats.cache_hits.values()))
"""


def test_code_from_other_files_counts(tmp_path: Path) -> None:
    """A kernel is made from what it calls, and from constants that others set, of which numba takes no notice."""
    for name, text in {"called": CALLED, "numbers_of_ours": "FACTOR = 2.0\n", "calling": CALLING}.items():
        (tmp_path / f"{name}.py").write_text(text)

    def run() -> str:
        return started(tmp_path / "calling.py").communicate(timeout=HANGS_S)[0].strip()

    assert [run(), run()] == ["4.0 0", "4.0 1"]
    (tmp_path / "called.py").write_text(CALLED.replace("FACTOR * x", "FACTOR * x + 1.0"))
    assert run() == "7.0 0"
    (tmp_path / "numbers_of_ours.py").write_text("FACTOR = 3.0\n")
    assert [run(), run()] == ["13.0 0", "13.0 1"]


def test_of_the_scenes_models_only_constants_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new key of a scene file compiles no kernel again; a constant that a kernel may have taken does."""

    def fresh() -> str:
        digest.cache_clear()
        return digest(sys.modules["lfmesh.geometry.surfaces.surface"])

    before = fresh()
    with monkeypatch.context() as changed:
        changed.setattr(lens, "Surface", type("Surface", (), {}))
        assert fresh() == before
        changed.setattr(qcon, "MOST_ASPHERE_TERMS", qcon.MOST_ASPHERE_TERMS + 1)
        assert fresh() != before
    assert fresh() == before


def test_a_class_that_moves_compiles_all_kernels_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba's index of a kernel names the classes of its arguments by their files, and cannot be read without them."""
    (tmp_path / "geometry").mkdir()
    one, other = (tmp_path / "geometry" / name for name in ("one.py", "other.py"))

    def fresh(here: str) -> str:
        one.write_text(here)
        other.write_text("x = 1\n" if "class" in here else "class Lattice:\n    pitch = 1.0\n")
        cache._places_of_classes.cache_clear()
        digest.cache_clear()
        return digest(lfmesh.kernels.decorators)

    monkeypatch.setattr(cache, "HERE", f"{tmp_path}{os.sep}")
    before = fresh("class Lattice:\n    pitch = 1.0\n")
    assert fresh("class Lattice:\n    pitch = 2.0\n") == before
    assert fresh("y = 2\n") != before
    monkeypatch.undo()
    cache._places_of_classes.cache_clear()
    digest.cache_clear()


def test_no_model_of_the_scene_defines_a_kernel_or_an_enumeration() -> None:
    """Their digest leaves out everything but constants."""
    for name, module in sorted(sys.modules.items()):
        if name.startswith("lfmesh.scene"):
            own = [value for value in vars(module).values() if getattr(value, "__module__", None) == name]
            assert not [value for value in own if isinstance(value, numba.core.registry.CPUDispatcher)], name
            assert not [value for value in own if isinstance(value, type) and issubclass(value, IntEnum)], name


def test_older_versions_do_not_pile_up(tmp_path: Path) -> None:
    now = digest(lfmesh.kernels.decorators)
    ours, versions = "decorators.cached_njit-3.py311", [f"{number:012x}" for number in range(KEPT + 2)]
    names = [f"decorators.{version}.cached_njit-{line}.py311" for line, version in enumerate(versions)]
    stay = {
        f"decorators.{now}.cached_njit-3.py311.nbi",
        "decorators.000000000000.other-3.py311.nbi",
        "decorators.other-3.py311.nbi",
    }
    for age, name in enumerate(names):
        stay |= {f"{name}.nbi", f"{name}.1.nbc"} if age < KEPT else set()
        for file in (tmp_path / f"{name}.nbi", tmp_path / f"{name}.1.nbc"):
            file.touch()
            os.utime(file, (1e9 - age, 1e9 - age))
    for name in (*stay, f"{ours}.nbi", f"{ours}.1.nbc"):
        (tmp_path / name).touch(exist_ok=True)
    remove_older_versions(str(tmp_path), lfmesh.kernels.decorators.cached_njit)
    assert {file.name for file in tmp_path.iterdir()} == stay


COMPILING = """
import gc

import numba
from numba.core import event
from program import twice_and_thrice

on_meanwhile = []


class Watch(event.Listener):
    def on_start(self, event):
        pass

    def on_end(self, event):
        on_meanwhile.append(gc.isenabled())


event.register("numba:run_pass", Watch())
for on, number in ((True, 1.5), (False, 1)):
    gc.enable() if on else gc.disable()
    twice_and_thrice(number)
    assert gc.isenabled() == on
print(set(on_meanwhile))
gc.enable()
on_meanwhile.clear()
numba.njit(lambda x: x + 1.0)(1.0)
print(set(on_meanwhile))
"""


def test_kernels_are_compiled_without_the_garbage_collector_and_leave_it_as_it_was(program: Path) -> None:
    own = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(program.parent)])}
    run = subprocess.run([sys.executable, "-c", COMPILING], env=own, capture_output=True, text=True, check=True)
    assert run.stdout == "{False}\n{True}\n"


def test_two_processes_may_compile_at_once(program: Path) -> None:
    for process in [started(program), started(program)]:
        assert outcome(process)["value"] == 7.5
    assert outcome(started(program))["cached"] == 1


RENDER = """
import hashlib
import lfmesh as lf
from lfmesh.assets import asset_path

settings = {"camera.sensor.pixels": (60, 60), "transport.split": "transmit", "transport.samples": 8}
image = lf.render(lf.load(asset_path("scenes/emitting_plane.toml")).changed(settings))
print(image.engine.split(":")[0], hashlib.sha256(image.mean.tobytes() + image.stderr.tobytes()).hexdigest())
"""


@pytest.mark.long
def test_kernels_from_the_cache_give_the_bits_of_those_just_compiled(tmp_path: Path) -> None:
    """Bit by bit: that is why nothing is contracted, for what LLVM contracts depends on what it has just inlined."""
    fresh = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    runs = [
        subprocess.run([sys.executable, "-c", RENDER], env=fresh, capture_output=True, text=True, check=True, cwd=ROOT)
        for _ in range(2)
    ]
    assert runs[0].stdout.startswith("sequential")
    assert runs[0].stdout == runs[1].stdout
