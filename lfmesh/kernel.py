"""The decorators of every compiled kernel, so that all of them share one set of numba options."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

from lfmesh.compiling import STEPS, KernelCompiler, StepCompiler
from lfmesh.kernel_cache import named_by_sources, remove_older_versions

F = TypeVar("F", bound=Callable[..., Any])

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
    "pipeline_class": KernelCompiler,
}

_CALLED_BY_KERNELS = {
    **_OPTIONS,
    "pipeline_class": StepCompiler,
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
    return cast(F, _kept(function, inline="always"))


def _compiled(function: F, **called: Any) -> F:
    """Compile a kernel in two ways: for Python, kept on disk, and, with the options `called`, for other kernels.

    The latter once for whole numbers of any size, named constants among them. Numba by itself compiles a called
    function anew for every constant it is called with: each station, each slot of the book. LLVM carries constants
    into what it inlines without that, and a fresh install starts in half the time.
    """
    dispatcher = _kept(function)
    STEPS[dispatcher] = numba.njit(**called)(function)
    return cast(F, dispatcher)


def _kept(function: Callable[..., Any], **options: Any) -> Any:
    """Compile for Python, and keep the code on disk until a source of it changes."""
    with named_by_sources(function):
        dispatcher = numba.njit(**_OPTIONS, **options)(function)
    dispatcher.__qualname__ = function.__qualname__
    remove_older_versions(dispatcher.stats.cache_path, function)
    return dispatcher
