"""The decorator of every compiled kernel, so that all of them share one set of numba options."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.codegen import get_host_cpu_features

F = TypeVar("F", bound=Callable[..., Any])


def _use_whole_vector_registers() -> None:
    """Let LLVM use 512-bit registers where the processor has them: by itself it keeps to 256.

    The blocks of the sequential engine are a third quicker for it. NUMBA_CPU_FEATURES, if set, is left as it is.
    """
    if numba.config.CPU_FEATURES is None and numba.config.CPU_NAME is None:
        features = get_host_cpu_features()
        if "+avx512f" in features.split(","):
            numba.config.CPU_FEATURES = f"{features},-prefer-256-bit"


_use_whole_vector_registers()

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
