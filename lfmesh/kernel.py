"""The decorators of every compiled kernel, so that all of them share one set of numba options."""

import gc
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numba
from numba import types
from numba.core import event
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


class _CollectorAtRest(event.Listener):  # type: ignore[misc]
    """Keep the garbage collector off while a kernel is compiled.

    Numba makes objects by the million and few cycles; to search them again and again took a sixth of the time.
    """

    def __init__(self) -> None:
        self.depth = 0
        self.was_on = False

    def on_start(self, event: event.Event) -> None:
        """Begin a kernel, or one that it calls; numba's lock lets one thread in at a time."""
        if self.depth == 0:
            self.was_on = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, event: event.Event) -> None:
        """End it."""
        self.depth -= 1
        if self.depth == 0 and self.was_on:
            gc.enable()


event.register("numba:compile", _CollectorAtRest())

SHORTENED = ((0, 68),)
"""Releases of numba, by their first two numbers, that `compiling` was tested with."""


def _compile_sooner() -> dict[str, Any]:
    """Make numba do less, where it is one of these releases; return options for what only kernels call."""
    if numba.version_info.short not in SHORTENED:
        return {}
    from lfmesh.compiling import LinkedCompiler, remember_what_operators_give

    remember_what_operators_give()
    return {"pipeline_class": LinkedCompiler}


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
    # Said outright, as numba would take it from whichever caller comes first.
    "forceinline": False,
}

_CALLED_BY_KERNELS = {
    **_OPTIONS,
    **_compile_sooner(),
    # Its code becomes part of the caller's, which is what is kept.
    "cache": False,
    "no_cpython_wrapper": True,
}


def kernel(function: F) -> F:
    """Compile with numba: cached on disk, without the GIL, without allocation."""
    return _compiled(function, **_CALLED_BY_KERNELS)


def inlined(function: F) -> F:
    """Compile as `kernel` does, and let LLVM copy the code into every caller: for the steps that every event takes.

    A call that is none of these puts every array of every table it takes on the stack.
    """
    return _compiled(function, **_CALLED_BY_KERNELS | {"forceinline": True})


def pasted(function: F) -> F:
    """Paste the source into every caller before that is compiled, which takes the longer the more callers there are.

    For what returns a record, which a call would copy, and for the bodies of loops that must stay as tight as they are.
    """
    return cast(F, numba.njit(**_OPTIONS, inline="always")(function))


def _compiled(function: F, **called: Any) -> F:
    """Compile a kernel in two ways: for Python, kept on disk, and, with the options `called`, for other kernels.

    The latter once for whole numbers of any size, named constants among them. Numba by itself compiles a called
    function anew for every constant it is called with: each station, each slot of the book. LLVM carries constants
    into what it inlines without that, and a fresh install starts in half the time.
    """
    dispatcher, step = numba.njit(**_OPTIONS)(function), numba.njit(**called)(function)

    def get_call_template(arguments: Sequence[types.Type], keywords: dict[str, types.Type]) -> Any:
        return step.get_call_template([_plain(a) for a in arguments], {name: _plain(a) for name, a in keywords.items()})

    dispatcher.get_call_template = get_call_template
    dispatcher.get_overload = step.get_overload
    return cast(F, dispatcher)


def _plain(argument: types.Type) -> types.Type:
    """Return the type that an argument is passed as: whole numbers, but for the unsigned of hashes, as 64 bits."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument
