"""Compilers of kernels that shorten the first render of a fresh install.

Numba alone makes machine code of every function that a kernel calls and optimises it again in every caller. These
compilers keep functions that only kernels call as LLVM's intermediate code. A kernel that Python calls links all of
them in, and only the whole is optimised and translated, once. The result type of an operator is looked up once per
combination of operand types, and passes that kernels do not need are left out. None of this changes the results of a
kernel.

The compilers act only on functions that `njit` compiles with them as its `pipeline_class`; no part of numba is
replaced. `CalleeCompiler` would be unnecessary if `njit` had an option "called by compiled code only", and
`_CachedFunction` if `BaseContext.resolve_function_type`, which caches failures, also cached successes.
"""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numba
from llvmlite import ir
from numba.core import typed_passes, untyped_passes
from numba.core.codegen import CodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags, StateDict
from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
from numba.core.cpu import CPUContext, CPUTargetOptions
from numba.core.dispatcher import Dispatcher

from lfmesh.kernels.private import libraries, typing_context
from lfmesh.kernels.private.expected import require, require_call
from lfmesh.kernels.private.libraries import IntermediateLibrary, KernelLibrary
from lfmesh.kernels.private.typing_context import callee_of, kernel_context


@cache
def _sizes_by(target: Any) -> Callable[[ir.Type], int]:
    """Return a function that gives the size of an LLVM type, cached because LLVM compiles a module to answer."""
    return cache(target.get_abi_sizeof)


@register_pass(mutates_CFG=False, analysis_only=False)
class _MakeCallable(LoweringPass):  # type: ignore[misc]
    """Registration of code without an address, so that kernels can call it."""

    _name = "make_callable"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Register the code under a unique key for the callers' compiler; Python never calls it."""
        # Dispatchers accept only built-in functions, and bound methods of different objects are never equal.
        key = list[None]().append
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


PASSES = (
    untyped_passes.TranslateByteCode,
    untyped_passes.FixupArgs,
    untyped_passes.IRProcessing,
    untyped_passes.RewriteSemanticConstants,
    untyped_passes.GenericRewrites,
    untyped_passes.InlineInlinables,
    untyped_passes.ReconstructSSA,
    untyped_passes.DeadBranchPrune,
    typed_passes.NopythonTypeInference,
    typed_passes.PreLowerStripPhis,
    typed_passes.NoPythonSupportedFeatureValidation,
    typed_passes.IRLegalization,
    typed_passes.AnnotateTypes,
    typed_passes.NativeLowering,
    typed_passes.NoPythonBackend,
)
"""Numba's passes for code without closures, `with`, `raise`, `literally` and arithmetic on whole arrays.

Each pass left out saves its time for every function.
"""


PASSES_LEFT_OUT = {
    untyped_passes.WithLifting,
    untyped_passes.RewriteDynamicRaises,
    untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.FindLiterallyCalls,
    untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass,
    untyped_passes.InlineClosureLikes,
    typed_passes.InlineOverloads,
    typed_passes.NopythonRewrites,
    typed_passes.DumpParforDiagnostics,
}


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """Compiler of kernels that Python calls."""

    library: type[CodeLibrary] = KernelLibrary

    def __init__(self, typingctx: Any, *others: Any) -> None:
        context = kernel_context(typingctx)
        super().__init__(context, *others)
        target = self.state.targetctx
        self.state.targetctx = target.subtarget(typing_context=context, get_abi_sizeof=_sizes_by(target))

    def compile_extra(self, func: Any) -> Any:
        """Compile a function and the functions that it calls."""
        with gc_paused():
            return super().compile_extra(func)

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, set up to write into this compiler's kind of library."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        manager = PassManager("kernel")
        for each in PASSES:
            manager.add_pass(each, each.__name__)
        manager.finalize()
        return [manager]


class CalleeCompiler(KernelCompiler):
    """Compiler of functions that only kernels call."""

    library = IntermediateLibrary

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes up to the intermediate code."""
        (manager,) = super().define_pipelines()
        self.state.flags.no_compile = True
        manager.add_pass_after(_MakeCallable, typed_passes.NativeLowering)
        manager.finalize()
        return [manager]


def add_callee(dispatcher: Dispatcher, function: Callable[..., Any], **options: Any) -> None:
    """Let other kernels call a version of a kernel compiled for them, at its first call.

    Parameters
    ----------
    dispatcher : Dispatcher
        The kernel for calls from Python.
    function : callable
    **options
        Options of `numba.njit`.
    """
    callee_of[dispatcher] = cache(lambda: numba.njit(pipeline_class=CalleeCompiler, **options)(function))


@contextmanager
def gc_paused() -> Iterator[None]:
    """Pause the garbage collector if it is on.

    Numba makes millions of objects and few reference cycles; repeated collections took a sixth of the time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def probe() -> None:
    """Raise an error if numba is not as these compilers expect."""
    libraries.probe()
    typing_context.probe()
    require(CompilerBase, "compile_extra", "define_pipelines")
    require_call(CompilerBase._compile_core, "define_pipelines")
    require(PassManager, "add_pass", "add_pass_after", "finalize")
    require(CPUContext, "subtarget", "get_abi_sizeof", "insert_user_function")
    require(Flags, "no_compile")
    require(CPUTargetOptions, "no_cpython_wrapper")
    unknown = _numbas_passes() - {*PASSES, *PASSES_LEFT_OUT}
    if unknown:
        raise AttributeError(f"passes that are not known: {', '.join(sorted(each.__name__ for each in unknown))}")


def _numbas_passes() -> set[type]:
    """Return numba's own passes, to find new ones that kernels may need."""
    state = StateDict(func_ir=None, flags=Flags())
    return {each for each, _ in DefaultPassBuilder.define_nopython_pipeline(state).passes}
