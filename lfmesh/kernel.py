"""The decorator of every compiled kernel, so that all of them share one set of numba options."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = {
    "cache": True,
    "nogil": True,
    # IEEE division, no exception. Fast-math stays off: the tracer promises float64 rounding, and contraction and
    # reassociation would make a result depend on how LLVM happened to vectorise a loop.
    "error_model": "numpy",
    # No reference counting: kernels allocate nothing, and counting every array that a table holds at every call cost
    # three quarters of the time.
    "_nrt": False,
}


def kernel(function: F) -> F:
    """Compile with numba: cached on disk, without the GIL, without allocation."""
    return cast(F, numba.njit(**_OPTIONS)(function))


def inlined(function: F) -> F:
    """Compile as `kernel` does, and copy the body into every caller: for the few steps that every event takes."""
    return cast(F, numba.njit(**_OPTIONS, inline="always")(function))


def vectorised(function: F) -> F:
    """Compile as `kernel` does, with products and sums contracted: for loops over whole blocks, which have no tail.

    Every ray goes through the same vector instructions wherever in its block it stands, so contraction, which makes
    them a fifth quicker, does not make a result depend on its place.
    """
    return cast(F, numba.njit(**_OPTIONS, fastmath={"contract"})(function))
