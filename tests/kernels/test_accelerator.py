"""Numba's private classes: probed, left alone where they are not as expected, and never a matter of bits."""

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass

from lfmesh.errors import PlainNumbaWarning
from lfmesh.kernels import accelerator
from lfmesh.kernels.private import libraries, pipeline, tables, typing_context

ROOT = Path(__file__).resolve().parents[2]


def expected(part: ModuleType) -> list[tuple[str, Any, str]]:
    """Return what a part of numba's private classes is expected to have: the part, owners and names."""
    found: list[tuple[str, Any, str]] = []
    with pytest.MonkeyPatch.context() as patch:
        for module in (libraries, pipeline, tables, typing_context):
            patch.setattr(module, "require", lambda owner, *names: found.extend((here, owner, name) for name in names))
        here = part.__name__.rpartition(".")[2]
        part.probe()
    return found


EXPECTED = [*expected(pipeline), *expected(tables)]


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing is probed yet."""
    monkeypatch.setattr(accelerator, "_faults", [])
    monkeypatch.delenv(accelerator.PLAIN, raising=False)
    accelerator._probed.cache_clear()
    yield
    accelerator._probed.cache_clear()


def fault(part: str) -> str:
    """Return of what a part warns, once, where it is left alone; nothing is used of the other parts either."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert accelerator.private(part) is None
        assert accelerator.private("pipeline") is None
        assert accelerator.private("tables") is None
    (warning,) = caught
    assert warning.category is PlainNumbaWarning
    assert "\n" not in str(warning.message)
    return str(warning.message)


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("part", ["pipeline", "tables"])
def test_the_installed_numba_is_as_expected(part: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert accelerator.private(part) is not None


def test_much_is_expected() -> None:
    assert len(EXPECTED) > 25


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    ("part", "owner", "name"), EXPECTED, ids=[f"{own.__name__}.{name}" for _, own, name in EXPECTED]
)
def test_a_private_name_that_is_missing_leaves_numba_alone(
    part: str, owner: Any, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for each in owner.__mro__ if isinstance(owner, type) else [owner]:
        if name in vars(each):
            monkeypatch.delattr(each, name)
    assert f"{owner.__name__} has no {name}" in fault(part)


class NewPass(FunctionPass):  # type: ignore[misc]
    """A pass of a numba to come."""

    _name = "new"


def with_new_pass(state: Any) -> Any:
    manager = DefaultPassBuilder.define_untyped_pipeline(state)
    manager.passes.append((NewPass, "new"))
    return manager


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize(
    ("owner", "name", "other", "part", "words"),
    [
        (JITCodeLibrary, "finalize", lambda self: None, "pipeline", "does not call _optimize_final_module"),
        (JITCodeLibrary, "add_llvm_module", lambda self, _: None, "pipeline", "does not call _optimize_functions"),
        (CompilerBase, "_compile_core", lambda self: None, "pipeline", "does not call define_pipelines"),
        (
            DefaultPassBuilder,
            "define_nopython_pipeline",
            with_new_pass,
            "pipeline",
            "passes that are not known: NewPass",
        ),
        (libraries.IntermediateLibrary, "__abstractmethods__", frozenset({"link"}), "pipeline", "demands link"),
        (tables, "_OF_ARRAY", ["meminfo", "data"], "tables", "an array in memory is meminfo, parent"),
        (tables, "probe", None, "tables", "not callable"),
    ],
    ids=["optimise", "functions", "pipelines", "passes", "abstract", "array", "any error"],
)
def test_a_numba_that_works_otherwise_is_left_alone(
    owner: Any, name: str, other: Any, part: str, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, other)
    assert words in fault(part)


PROGRAM = """
import sys, warnings
from typing import Any, NamedTuple

import numpy as np

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel, pasted


@by_address
class Scaling(NamedTuple):
    line: Any
    factor: float
    offset: Any = None


@inlined
def scaled(table, i):
    return table.line[i] * table.factor


@pasted
def third(x):
    return x / 3.0


@kernel
def halved(x, times):
    for _ in range(times):
        x *= 0.5
    return x


@kernel
def total(table):
    found = 0.0
    for i in range(len(table.line)):
        found += third(scaled(table, i)) + halved(found, 2)
        table.line[i] = found
    return found


CHANGE

with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    table = Scaling(np.random.default_rng(0).random(100), 0.3)
    print(total(table).hex(), table.line[50].hex(), halved(3.0, 1))
    print([each.category.__name__ for each in caught])
    print("lfmesh.kernels.private.pipeline" in sys.modules, type(numba_type(table)).__name__)
"""

BROKEN = """
from lfmesh.kernels.private.libraries import KernelLibrary


def gone(self):
    raise AttributeError("'KernelLibrary' object has no attribute '_reload_init'")


KernelLibrary._optimize_final_module = gone
"""


def printed(folder: Path, change: str = "", **environment: str) -> list[str]:
    """Run the program in a process of its own, with a cache of its own; return the lines that it prints."""
    file = folder / "program.py"
    file.write_text(PROGRAM.replace("CHANGE", f"from numba import typeof as numba_type\n{change}"))
    own = {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(folder / "cache"), accelerator.PLAIN: "0", **environment}
    run = subprocess.run([sys.executable, str(file)], env=os.environ | own, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


def test_plain_numba_gives_the_same_bits(tmp_path: Path) -> None:
    """By themselves, when asked for, and where a private class fails as late as when it compiles a kernel."""
    folders = [tmp_path / name for name in ("private", "plain", "broken")]
    for folder in folders:
        folder.mkdir()
    bits, warned, used = printed(folders[0])
    assert (warned, used) == ("[]", "True Table")
    assert printed(folders[1], **{accelerator.PLAIN: "1"}) == [bits, "[]", "False NamedTuple"]
    assert printed(folders[2], BROKEN) == [bits, "['PlainNumbaWarning']", "True NamedTuple"]


MISTAKE = """
import warnings

import numba
from lfmesh.kernels.decorators import kernel

warnings.simplefilter("error")
try:
    kernel(lambda a, b: a + b)(1, "2")
except numba.TypingError as error:
    print("no sum")
"""


def test_a_kernels_own_mistake_is_not_taken_for_numbas(tmp_path: Path) -> None:
    file = tmp_path / "program.py"
    file.write_text(MISTAKE)
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, str(file)], env=own, capture_output=True, text=True)
    assert (run.stdout, run.returncode) == ("no sum\n", 0), run.stderr


RENDER = """
import hashlib
import lfmesh as lf
from lfmesh.assets import asset_path
from lfmesh.kernels.accelerator import private

small = {"camera.sensor.pixels": [6, 6], "transport.samples": 8, "transport.replicates": 2, "transport.threads": 1}
scene = lf.load(asset_path("scenes/conventional.toml")).changed(small | {"transport.split": "transmit"})
image = lf.render(scene)
assert image.mean.any()
print(private("pipeline") is None, hashlib.sha256(image.mean.tobytes() + image.error.tobytes()).hexdigest())
"""


@pytest.mark.long
def test_a_render_by_plain_numba_has_the_same_bits(tmp_path: Path) -> None:
    def rendered(**environment: str) -> list[str]:
        own = os.environ | {"PYTHONPATH": str(ROOT), accelerator.PLAIN: "0", **environment}
        done = subprocess.run([sys.executable, "-c", RENDER], env=own, capture_output=True, text=True, check=True)
        return done.stdout.split()

    was_plain, plain = rendered(**{accelerator.PLAIN: "1", "NUMBA_CACHE_DIR": str(tmp_path)})
    was_alone, usual = rendered()
    assert (was_plain, was_alone) == ("True", "False")
    assert plain == usual
