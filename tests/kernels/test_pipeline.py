"""Compiling made shorter by numba's own means, and nothing changed for whoever else uses numba."""

import operator
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest
from numba import types
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

from lfmesh.kernels.private.typing_context import KernelContext
from tests.instances import instances

ROOT = Path(__file__).resolve().parents[2]

ARRAY = types.Array(types.float64, 2, "C")
RECORD = numba.from_dtype(np.dtype([("x", float), ("n", np.int32)]))
OPERANDS = [
    types.float64,
    types.float32,
    types.int64,
    types.uint64,
    types.boolean,
    types.literal(2),
    types.UniTuple(types.int64, 2),
    types.unicode_type,
    ARRAY,
    RECORD,
]
OPERATORS = [operator.add, operator.mul, operator.truediv, operator.lt, operator.eq, operator.getitem, operator.and_]
LIKE_OTHERS = [operator.mul, operator.lt, operator.and_]
"""The suite has an operator of numbers, one whose results are floating, and one of arrays, tuples and records."""


def answer(context: Any, which: Any, args: tuple[types.Type, ...]) -> Any:
    try:
        return context.resolve_function_type(context.resolve_value_type(which), args, {})
    except TypingError:
        return None


@pytest.mark.parametrize("which", instances(OPERATORS, long=LIKE_OTHERS), ids=lambda which: which.__name__)
def test_what_is_remembered_is_what_numba_answers_anew(which: Any) -> None:
    cpu_target.typing_context.refresh()
    remembering = KernelContext(cpu_target.typing_context)
    answers = {}
    for _ in range(2):
        for left in OPERANDS:
            for right in OPERANDS:
                answers[left, right] = answer(remembering, which, (left, right))
    assert len(set(map(str, answers.values()))) > 2
    assert remembering.resolve_value_type(which).known
    for args, given in answers.items():
        assert given == answer(cpu_target.typing_context, which, args), args


def printed(folder: Path, program: str) -> list[str]:
    """Run a program in a process of its own; return the lines that it prints."""
    file = folder / "program.py"
    file.write_text(program)
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, str(file)], env=own, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


LEARNING = """
import operator
import numba
from numba import types
from numba.extending import overload
from lfmesh.kernels.decorators import kernel

assert kernel(lambda a, b: a + b)(1, 2) == 3
try:
    kernel(lambda a, b: a + b)(1, "2")
except numba.TypingError:
    print("no sum")


@overload(operator.add)
def add_text(a, b):
    if isinstance(a, types.Integer) and isinstance(b, types.UnicodeType):
        return lambda a, b: a + len(b)


print(kernel(lambda a, b: a + b)(1, "2"))
"""


def test_what_numba_is_told_later_counts(tmp_path: Path) -> None:
    assert printed(tmp_path, LEARNING) == ["no sum", "2"]


KERNELS = """
from numba.core.registry import cpu_target

from lfmesh.kernels.decorators import inlined, kernel


@inlined
def halved(x):
    return 0.5 * min(x, 8.0)


@kernel
def doubled(x):
    # Called before it is compiled for itself, and calls what others call.
    return 4.0 * halved(x)


@kernel
def quartered(x):
    return 0.25 * doubled(halved(x))


print(quartered(4.0))
engine = cpu_target.target_context.codegen()._engine
print(sum(("halved" in name or "doubled" in name) and "NumbaEnv" not in name for name in engine._defined_symbols))
print(doubled(4.0))
"""


def test_code_that_only_kernels_call_is_not_translated_by_itself(tmp_path: Path) -> None:
    assert printed(tmp_path, KERNELS) == ["1.0", "0", "8.0"]


BESIDE = """
import sys

import numba
import numpy as np


def total(values):
    found = 0.0
    for i in range(len(values)):
        found += values[i] * values[i]
    return found


def state():
    # What every module and class of numba has by each of its names.
    found = {}
    for place, module in sorted(sys.modules.items()):
        if place.split(".")[0] not in ("numba", "llvmlite"):
            continue
        for name, value in vars(module).items():
            if callable(value) or place == "numba.core.config":
                found[place, name] = value
            if isinstance(value, type):
                found.update({(place, name, own): each for own, each in vars(value).items() if callable(each)})
    return found


def is_wide(function):
    function(np.ones(3))
    return "prefer-vector-width" in "".join(function.inspect_llvm().values())


numba.njit(total)(np.ones(3))
before = state()

from lfmesh.kernels.decorators import kernel
import lfmesh.transport.render.render

print(is_wide(kernel(total)), is_wide(numba.njit(total)))


@kernel
def twice(x):
    return min(2.0 * x, 8.0)


@numba.njit
def four_times(x):
    return twice(twice(x))


print(four_times(1.5))
after = state()
print(len(before) > 1000, [name for name, value in before.items() if after[name] is not value])
"""


def test_nothing_changes_for_other_programs(tmp_path: Path) -> None:
    assert printed(tmp_path, BESIDE) == ["True False", "6.0", "True []"]


SCALED = """
define void @scaled(double* noalias %x, double* noalias %y) WIDTH {
entry:
  br label %loop
loop:
  %i = phi i64 [0, %entry], [%next, %loop]
  %from = getelementptr double, double* %x, i64 %i
  %to = getelementptr double, double* %y, i64 %i
  %value = load double, double* %from
  %twice = fmul double %value, 2.0
  store double %twice, double* %to
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, 1024
  br i1 %more, label %loop, label %done
done:
  ret void
}
"""


@pytest.mark.parametrize(("width", "wide"), [('"prefer-vector-width"="512"', True), ("", False)])
def test_kernels_use_the_widest_registers(width: str, wide: bool) -> None:
    """On a processor that LLVM by itself keeps to registers of 256 bits; the attribute is that of `libraries`."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple("x86_64-unknown-linux-gnu").create_target_machine(cpu="skylake-avx512", opt=3)
    module = llvm.parse_assembly(SCALED.replace("WIDTH", width))
    module.triple = "x86_64-unknown-linux-gnu"
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=3))
    builder.getModulePassManager().run(module, builder)
    text = machine.emit_assembly(module)
    assert "ymm" in text or "zmm" in text
    assert ("zmm" in text) == wide
