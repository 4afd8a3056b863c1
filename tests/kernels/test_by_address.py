"""Named tuples that kernels receive by their address: every field is what Python has, and nothing else changes."""

import gc
import sys
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from lfmesh.kernels.by_address import by_address
from lfmesh.kernels.decorators import inlined, kernel
from lfmesh.kernels.private.tables import Table

RECORD = np.dtype([("x", "f8"), ("n", "i4"), ("v", "f8", (3,))])


class Inner(NamedTuple):
    """Without a mark of its own."""

    grid: NDArray[np.float64]
    size: float
    more: Any = None


@by_address
class Outer(NamedTuple):
    """All kinds of fields."""

    flag: bool
    number: int
    key: np.uint64
    line: NDArray[np.float64]
    inner: Inner
    nothing: Any
    block: NDArray[np.float32]
    rows: NDArray[np.void]
    real: float
    last: bool


class Plain(NamedTuple):
    """A tuple that numba passes field by field."""

    line: NDArray[np.float64]
    scale: float


@by_address
class Marked(NamedTuple):
    """The same by its address."""

    line: NDArray[np.float64]
    scale: float


def outer(seed: int) -> Outer:
    draw = np.random.default_rng(seed)
    grid = draw.random((4, 6))
    rows = np.zeros(3, RECORD)
    rows["x"], rows["n"], rows["v"] = draw.random(3), draw.integers(0, 99, 3), draw.random((3, 3))
    return Outer(
        bool(draw.integers(2)), int(draw.integers(-9, 9)), np.uint64(draw.integers(1 << 62)) << np.uint64(1),
        draw.random(9)[::2], Inner(grid[1:, ::2], float(draw.random())), None,
        draw.random((2, 3, 4, 5)).astype(np.float32), rows, float(draw.random()), bool(draw.integers(2)),
    )  # fmt: skip


@kernel
def _inner_sum(inner: Inner) -> float:
    found = inner.size
    for i in range(inner.grid.shape[0]):
        for j in range(inner.grid.shape[1]):
            found += (i + 10 * j) * inner.grid[i, j]
    return found


@kernel
def read(table: Outer, found: NDArray[np.float64], keys: NDArray[np.uint64]) -> None:
    """Write all fields of a table, or sums that tell them apart, to `found`."""
    found[0], found[1], found[2], found[3] = table.flag, table.number, table.real, table.last
    for i in range(len(table.line)):
        found[4] += (1 + i) * table.line[i]
    found[5] = _inner_sum(table.inner)
    found[6] = table.block[1, 2, 3, 4] + 10.0 * table.block[0, 1, 0, 2]
    row = table.rows[2]
    found[7], found[8], found[9] = row.x, row.n, row.v[1]
    found[10], found[11] = table.block.size, table.inner.grid.shape[1]
    keys[0] = table.key


@pytest.mark.parametrize("seed", range(8))
def test_a_kernel_reads_what_python_has(seed: int) -> None:
    table = outer(seed)
    found, keys = np.zeros(12), np.zeros(1, np.uint64)
    read(table, found, keys)
    i, j = np.indices(table.inner.grid.shape)
    expected = [
        table.flag, table.number, table.real, table.last, (np.arange(1, 6) * table.line).sum(),
        table.inner.size + ((i + 10 * j) * table.inner.grid).sum(),
        float(table.block[1, 2, 3, 4]) + 10.0 * float(table.block[0, 1, 0, 2]),
        table.rows["x"][2], table.rows["n"][2], table.rows["v"][2, 1], table.block.size, 3,
    ]  # fmt: skip
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert keys[0] == table.key
    assert len(read.signatures) == 1


@kernel
def _add_to(row: Any, table: Marked, by: float) -> None:
    row.x += by
    table.line[1] += by * table.scale


@kernel
def add(rows: NDArray[np.void], table: Marked) -> None:
    """Write to a record and to an array of a table, and read both again after each call."""
    for _ in range(3):
        _add_to(rows[0], table, 1.0)
        rows[1].x += rows[0].x * table.line[1]


def test_what_a_kernel_writes_is_seen_at_once() -> None:
    rows, table = np.zeros(2, RECORD), Marked(np.zeros(2), 2.0)
    add(rows, table)
    assert table.line.tolist() == [0.0, 6.0]
    assert rows["x"].tolist() == [3.0, 1.0 * 2.0 + 2.0 * 4.0 + 3.0 * 6.0]


@inlined
def _size_of(inner: Any) -> float:
    return 0.0 if inner is None else inner.size


@kernel
def _size(inner: Inner) -> float:
    return inner.size + _size_of(inner.more)


@kernel
def both_sizes(first: Outer, second: Outer) -> float:
    """Call the same function with tables of one class that are of two types."""
    return 100.0 * _size(first.inner) + _size(second.inner)


def test_tables_of_one_class_with_other_fields_are_told_apart() -> None:
    short = outer(0)
    short = short._replace(inner=Inner(np.zeros((1, 1)), 1.0))
    long = short._replace(inner=Inner(np.zeros((1, 1)), 2.0, Inner(np.zeros((1, 1)), 5.0)))
    assert both_sizes(short, long) == 107.0
    assert both_sizes(long, short) == 701.0


@inlined
def _scaled(table: Any, i: int) -> float:
    return table.line[i] * table.scale


@kernel
def total(table: Any) -> float:
    found = 0.0
    for i in range(len(table.line)):
        found += _scaled(table, i)
    return found


def test_a_table_has_the_bits_of_the_tuple_that_is_passed_field_by_field() -> None:
    line = np.random.default_rng(0).random(1000)
    assert total(Marked(line, 0.3)) == total(Plain(line, 0.3))
    assert isinstance(numba.typeof(Marked(line, 0.3)), Table)
    assert not isinstance(numba.typeof(Plain(line, 0.3)), Table)


CONSTANT = Marked(np.array([1.0, 2.0]), 3.0)


@kernel
def of_constant(line: NDArray[np.float64]) -> float:
    return total(CONSTANT) + line[0]


def test_a_constant_of_a_module_is_a_tuple_as_any_other() -> None:
    assert of_constant(np.ones(1)) == 10.0


def test_functions_that_count_references_leave_those_of_a_table_alone() -> None:
    table = Marked(np.array([1.0, 2.0]), 3.0)
    function = numba.njit(lambda table: table.line.sum() + table.line[::-1].copy()[0])
    assert function(table) == 5.0
    gc.collect()
    before = sys.getrefcount(table.line)
    for _ in range(5):
        assert function(table) == 5.0
    after = sys.getrefcount(table.line)
    assert after == before


def test_a_field_that_has_no_place_in_a_table_is_named() -> None:
    with pytest.raises(TypeError, match="is unicode_type"):
        kernel(lambda table: table.scale)(Marked("text", 3.0))  # type: ignore[arg-type]
