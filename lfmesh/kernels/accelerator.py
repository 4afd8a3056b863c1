"""Faster compilation by numba's private classes, with numba alone as the fallback.

The modules of `private/` build on classes that any release of numba may change. Each is probed at its first use. If a
probe fails, or a kernel fails to compile that numba alone compiles, the private classes are left unused for the rest of
the process, with one warning. Kernels give the same bits either way. Set the environment variable LFMESH_PLAIN_NUMBA to
anything but 0 to leave them unused without a warning.
"""

import os
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numba

PLAIN = "LFMESH_PLAIN_NUMBA"

_faults: list[str] = []
"""Reasons to leave the private classes unused."""


def private(part: str) -> ModuleType | None:
    """Return a module of `private/`, or None if these are unused.

    Parameters
    ----------
    part : str
        Its name: "pipeline", "tables" or "listening".
    """
    if os.environ.get(PLAIN, "0") not in ("", "0"):
        return None
    return None if _faults else _probed(part)


@cache
def _probed(part: str) -> ModuleType | None:
    try:
        module = import_module(f"{__package__}.private.{part}")
        module.probe()
    except Exception as error:
        leave_alone(error)
        return None
    return module


def leave_alone(error: Exception) -> None:
    """Use numba alone from now on, with one warning.

    Parameters
    ----------
    error : Exception
        Error that showed that numba is not as expected.
    """
    # Imported here, as an import at the top would recompile all kernels whenever an exception is added.
    from lfmesh.errors import PlainNumbaWarning

    if not _faults:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        message = (
            f"numba {numba.__version__} differs from the expected one ({reason}): plain numba compiles the kernels, so "
            "the first render of an installation takes up to three times as long; pictures stay the same"
        )
        warnings.warn(PlainNumbaWarning(message), stacklevel=2)
    _faults.append(str(error))


class KernelCompiler:
    """The `pipeline_class` of `njit`: the compiler of `private/`, or numba's own if that fails.

    Parameters
    ----------
    *state
        Arguments that numba gives to a compiler.
    """

    def __init__(self, *state: Any) -> None:
        self._state = state

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        """Compile a function and the functions that it calls."""
        from numba.core.compiler import Compiler  # numba's default compiler

        pipeline = private("pipeline")
        if pipeline is None:
            return Compiler(*self._state).compile_extra(function)
        try:
            return pipeline.KernelCompiler(*self._state).compile_extra(function)
        except Exception as error:
            # A kernel that is itself wrong raises here too.
            compiled = Compiler(*self._state).compile_extra(function)
            leave_alone(error)
            return compiled
