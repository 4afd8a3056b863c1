"""Compiling made shorter: numba remembers what it was told, and code that only kernels call is not translated."""

import operator
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba import types
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

from lfmesh.kernel import SHORTENED

ROOT = Path(__file__).resolve().parents[1]

shortened = pytest.mark.skipif(
    numba.version_info.short not in SHORTENED, reason="this release of numba is left to compile as it does"
)

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


def answer(ask: Any, function: types.Function, args: tuple[types.Type, ...]) -> Any:
    try:
        return ask(function, cpu_target.typing_context, args, {})
    except TypingError:
        return None


@shortened
@pytest.mark.parametrize("which", OPERATORS, ids=lambda which: which.__name__)
def test_what_is_remembered_is_what_numba_answers_anew(which: Any) -> None:
    cpu_target.typing_context.refresh()
    function = cpu_target.typing_context.resolve_value_type(which)
    remembered = types.Function.get_call_type
    answers = {}
    for _ in range(2):
        for left in OPERANDS:
            for right in OPERANDS:
                answers[left, right] = answer(remembered, function, (left, right))
    assert len(set(map(str, answers.values()))) > 2
    for args, given in answers.items():
        assert given == answer(remembered.__wrapped__, function, args), args


def printed(folder: Path, program: str) -> list[str]:
    """Run a program in a process of its own; return the lines that it prints."""
    file = folder / "program.py"
    file.write_text(program)
    own = os.environ | {"PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, str(file)], env=own, capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


LEARNING = """
import operator
import numba
from numba import types
from numba.extending import overload
import lfmesh.kernel

add = numba.njit(lambda a, b: a + b)
assert add(1, 2) == 3
try:
    add(1, "2")
except numba.TypingError:
    print("no sum")


@overload(operator.add)
def add_text(a, b):
    if isinstance(a, types.Integer) and isinstance(b, types.UnicodeType):
        return lambda a, b: a + len(b)


print(numba.njit(lambda a, b: a + b)(1, "2"))
"""


def test_what_numba_is_told_later_counts(tmp_path: Path) -> None:
    assert printed(tmp_path, LEARNING) == ["no sum", "2"]


KERNELS = """
import sys

import numba
from numba.core.registry import cpu_target

{before}
from lfmesh.kernel import kernel


@kernel
def halved(x):
    return 0.5 * x


@kernel
def quartered(x):
    return 0.5 * halved(x)


print(quartered(4.0))
print("lfmesh.compiling" in sys.modules)
engine = cpu_target.target_context.codegen()._engine
print(sum("halved" in name and "NumbaEnv" not in name for name in engine._defined_symbols))
"""


@shortened
def test_code_that_only_kernels_call_is_not_translated_by_itself(tmp_path: Path) -> None:
    assert printed(tmp_path, KERNELS.format(before="")) == ["1.0", "True", "0"]


def test_another_release_of_numba_is_left_alone(tmp_path: Path) -> None:
    other = "numba.version_info = numba.version_info._replace(short=(99, 0))"
    assert printed(tmp_path, KERNELS.format(before=other)) == ["1.0", "False", "1"]
