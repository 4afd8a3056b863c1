"""Operations that let loops over blocks of rays compile to branch-free vector code.

Numba compiles `a if c else b` to a branch, which LLVM turns back into masks and masked stores: half as many
instructions again. Numba also lacks a fused multiply-add. If LLVM were free to contract products, the last digit would
depend on inlining, so the code names the products to fuse.
"""

from collections.abc import Callable
from typing import Any

from llvmlite.ir.instructions import Instruction
from numba import types
from numba.extending import intrinsic

_F64, _BOOL = types.float64, types.boolean


def _fused(context: Any, a: Any, b: Any, c: Any) -> Any:
    return _F64(_F64, _F64, _F64), lambda _, builder, signature, given: builder.fma(*given)


def _select(context: Any, condition: Any, a: Any, b: Any) -> Any:
    return _F64(_BOOL, _F64, _F64), _select_frozen


def _select_frozen(context: Any, builder: Any, signature: Any, given: Any) -> Any:
    """Emit a selection that LLVM cannot turn into a masked store.

    LLVM turns `a[i] = b if c else a[i]` into a masked store, which takes a dozen cycles on AMD processors without
    AVX-512: more than half of the time of a block of rays. "freeze" hides that the second number is `a[i]`, and emits
    no code.
    """
    condition, a, b = given
    frozen = Instruction(builder.block, b.type, "freeze", [b])
    builder._insert(frozen)
    return builder.select(condition, a, frozen)


def _both(context: Any, a: Any, b: Any) -> Any:
    return _BOOL(_BOOL, _BOOL), lambda _, builder, signature, given: builder.and_(*given)


fused: Callable[[float, float, float], float] = intrinsic(_fused)
"""Return a b + c, rounded once."""

select: Callable[[bool, float, float], float] = intrinsic(_select)
"""Return the first number if the condition holds, else the second; both are evaluated."""

both: Callable[[bool, bool], bool] = intrinsic(_both)
"""Tell whether two conditions hold; both are evaluated."""
