"""Decorators of all compiled kernels, with one set of numba options."""

from collections.abc import Callable, Set
from functools import cache
from typing import Any, TypeVar, cast

import numba

from lfmesh.kernels.accelerator import KernelCompiler, private
from lfmesh.kernels.cache import named_by_sources, remove_older_versions

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = {
    "cache": True,
    "nogil": True,
    # IEEE division without exceptions. Neither fast-math nor contraction: the tracer promises float64 rounding, and
    # LLVM's contractions depend on inlining, so cached and newly compiled kernels would differ.
    "error_model": "numpy",
}

_UNDOCUMENTED = {
    # No reference counting: kernels allocate nothing, and counting array references at every call took three quarters
    # of the time.
    "_nrt": False,
    # No wrapper for calls from C code, as there are none.
    "no_cfunc_wrapper": True,
    # Set explicitly; numba otherwise takes the flag of the first caller compiled.
    "forceinline": False,
}
"""Options that change no result; left out if numba does not have them."""

# The code becomes part of its caller, which is cached.
_CALLED_BY_KERNELS = {"cache": False, "no_cpython_wrapper": True}


def kernel(function: F) -> F:
    """Compile with numba: cached on disk, without the GIL, without allocation."""
    return _compiled(function)


def inlined(function: F) -> F:
    """Compile like `kernel`, and let LLVM copy the code into every caller, for the steps that every event takes.

    A real call would put every array of every table on the stack.
    """
    return _compiled(function, forceinline=True)


def pasted(function: F) -> F:
    """Copy the source into every caller before compilation; compile time grows with their number.

    For functions that return a record, which a call would copy, and for the bodies of tight loops.
    """
    return cast(F, cached_njit(function, inline="always"))


def _compiled(function: F, **called: Any) -> F:
    """Compile a kernel for Python, cached on disk, and with the options `called` for other kernels.

    The version for other kernels is compiled once for all integer arguments, constants included. Numba alone recompiles
    a called function for every constant argument, such as each station or each slot of the book. LLVM propagates
    constants into inlined code anyway, and a fresh install starts in half the time.
    """
    pipeline = private("pipeline")
    if pipeline is None:
        return cast(F, cached_njit(function, **called))
    dispatcher = cached_njit(function)
    pipeline.add_callee(dispatcher, function, **_known(_OPTIONS | _UNDOCUMENTED | _CALLED_BY_KERNELS | called))
    return cast(F, dispatcher)


def cached_njit(function: Callable[..., Any], **options: Any) -> Any:
    """Compile for Python, and cache the code on disk until one of its sources changes.

    Parameters
    ----------
    function : callable
    **options
        Further options of `numba.njit`.
    """
    if private("pipeline") is not None:
        options["pipeline_class"] = KernelCompiler
    with named_by_sources(function):
        dispatcher = numba.njit(**_known(_OPTIONS | _UNDOCUMENTED | options))(function)
    dispatcher.__qualname__ = function.__qualname__
    remove_older_versions(dispatcher.stats.cache_path, function)
    return dispatcher


def _known(options: dict[str, Any]) -> dict[str, Any]:
    """Drop the undocumented options that the installed numba lacks."""
    return {name: each for name, each in options.items() if name not in _UNDOCUMENTED or name in _names_of_options()}


@cache
def _names_of_options() -> Set[str]:
    try:
        from numba.core.registry import cpu_target

        return frozenset(dir(cpu_target.options))
    except (ImportError, AttributeError):
        return frozenset()
