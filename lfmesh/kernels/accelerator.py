"""Numba's private classes as an accelerator of compiling: used while they are as expected, else numba alone compiles.

The modules of `private/` build on classes that a release of numba may change. When one is first used, its `probe` tells
whether numba is as it expects. Where it is not, or where numba alone compiles a kernel that cannot be compiled with
them, they are left alone for the rest of the process, with one warning. Kernels give the same bits either way. The
environment variable LFMESH_PLAIN_NUMBA, set to anything but 0, leaves them alone without a warning.
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
"""Reasons to leave the private classes alone."""


def private(part: str) -> ModuleType | None:
    """Return a module of `private/`; None where numba's private classes are left alone.

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
    """Use numba alone from now on, and warn of it once.

    Parameters
    ----------
    error : Exception
        By which numba was found not to be as expected.
    """
    # At the top it would be a source of every kernel, and a new exception would compile all of them again.
    from lfmesh.errors import PlainNumbaWarning

    if not _faults:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        message = (
            f"numba {numba.__version__} is not as lfmesh expects ({reason}): numba alone compiles the kernels, so that "
            "the first render of an installation waits up to three times as long; pictures stay the same"
        )
        warnings.warn(PlainNumbaWarning(message), stacklevel=2)
    _faults.append(str(error))


class KernelCompiler:
    """The compiler that `njit` gets as its `pipeline_class`: numba's private classes, or numba's own where they fail.

    Parameters
    ----------
    *state
        What numba gives to a compiler.
    """

    def __init__(self, *state: Any) -> None:
        self._state = state

    def compile_extra(self, function: Callable[..., Any]) -> Any:
        """Compile a function and the functions that it calls."""
        from numba.core.compiler import Compiler  # which plain numba compiles by without being given it

        pipeline = private("pipeline")
        if pipeline is None:
            return Compiler(*self._state).compile_extra(function)
        try:
            return pipeline.KernelCompiler(*self._state).compile_extra(function)
        except Exception as error:
            # A kernel with a mistake of its own fails here as well.
            compiled = Compiler(*self._state).compile_extra(function)
            leave_alone(error)
            return compiled
