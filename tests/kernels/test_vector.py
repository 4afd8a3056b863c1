"""Operations for loops over blocks of rays: their values, and the code that comes of them."""

import llvmlite.binding as llvm
import numpy as np
import pytest

from lfmesh.kernels.decorators import kernel
from lfmesh.kernels.vector import both, fused, select


@kernel
def kept_where_negative(values, others):
    for i in range(64):
        values[i] = select(others[i] > 0.0, others[i], values[i])


@kernel
def kept_by_a_branch(values, others):
    for i in range(64):
        if others[i] > 0.0:
            values[i] = others[i]


@kernel
def combined(values, others):
    for i in range(64):
        values[i] = fused(values[i], others[i], select(both(others[i] > 0.0, values[i] > 0.0), 1.0, np.nan))


def numbers():
    draw = np.random.default_rng(0)
    return draw.normal(size=64), draw.normal(size=64)


def assembly(loop, processor):
    """Return the code of a kernel for a processor."""
    loop(*numbers())
    # Code from the cache cannot be looked into.
    loop.recompile()
    (text,) = loop.inspect_llvm().values()
    module = llvm.parse_assembly(text)
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(module.triple)
    return target.create_target_machine(cpu=processor, opt=3).emit_assembly(module)


def test_a_selection_takes_the_first_number_where_the_condition_holds():
    values, others = numbers()
    expected = np.where(others > 0.0, others, values)
    kept_where_negative(values, others)
    np.testing.assert_array_equal(values, expected)


def test_both_and_fused_are_what_they_say():
    values, others = numbers()
    expected = np.where((others > 0.0) & (values > 0.0), values * others + 1.0, np.nan)
    combined(values, others)
    np.testing.assert_allclose(values, expected, rtol=2e-16, atol=2e-16)


@pytest.mark.skipif(llvm.get_process_triple().split("-")[0] != "x86_64", reason="masked stores of x86")
def test_a_selection_is_no_masked_store():
    """Which takes processors of AMD without AVX-512 a dozen cycles."""
    assert "vmaskmov" not in assembly(kept_where_negative, "znver3")
    assert "vmaskmov" in assembly(kept_by_a_branch, "znver3")
