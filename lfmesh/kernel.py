"""The decorator of every compiled kernel, so that all of them share one set of numba options."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba
from numba import types
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
    # IEEE division, no exception. Fast-math stays off, contraction too: the tracer promises float64 rounding, and what
    # LLVM contracts depends on what it inlined, so that a kernel from the cache would differ from one just compiled.
    "error_model": "numpy",
    # No reference counting: kernels allocate nothing, and counting every array that a table holds at every call cost
    # three quarters of the time.
    "_nrt": False,
    # Nothing asks for a kernel's address in C; the wrapper would be compiled with every one of them.
    "no_cfunc_wrapper": True,
}


def kernel(function: F) -> F:
    """Compile with numba: cached on disk, without the GIL, without allocation."""
    return _compiled(function)


def inlined(function: F) -> F:
    """Compile as `kernel` does, and copy the body into every caller: for the few steps that every event takes."""
    return _compiled(function, inline="always")


def _compiled(function: F, **more: Any) -> F:
    """Compile a kernel once for whole numbers of any size, named constants among them.

    Numba by itself compiles a called function anew for every constant it is called with: each station, each slot of
    the book. LLVM carries constants into what it inlines without that, and a fresh install starts in half the time.
    """
    dispatcher = numba.njit(**_OPTIONS, **more)(function)
    resolved = dispatcher.get_call_template

    def get_call_template(arguments: Sequence[types.Type], keywords: dict[str, types.Type]) -> Any:
        return resolved([_plain(a) for a in arguments], {name: _plain(a) for name, a in keywords.items()})

    dispatcher.get_call_template = get_call_template
    return cast(F, dispatcher)


def _plain(argument: types.Type) -> types.Type:
    """Return the type that an argument is passed as: whole numbers, but for the unsigned of hashes, as 64 bits."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument
