"""Compilers of kernels that shorten the first render of a fresh install.

By itself numba makes machine code of every function that a kernel calls, and optimises it again in every caller. The
compilers of this file keep functions that only kernels call as LLVM's intermediate code. A kernel that Python calls
links all of that in, and only the whole is optimised and translated, once. The result type of an operator is looked up
once for each combination of operand types, and passes for what kernels do not contain are left out. None of that
changes what a kernel computes.

These compilers are given to `njit` as its `pipeline_class` and act on nothing but the functions compiled with them; no
part of numba is replaced. With an upstream option of `njit` that says "called by compiled code only", `StepCompiler`
would not be needed; nor would `_CachedFunction`, if `BaseContext.resolve_function_type`, which caches failures, cached
successful results as well.
"""

import gc
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from functools import cache
from operator import getitem, setitem
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import types
from numba.core import config, typed_passes, untyped_passes
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import CompilerBase
from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.extending import models, register_model

from lfmesh.by_address import promise_unchanged


class IntermediateLibrary(CodeLibrary):  # type: ignore[misc]
    """Code of a function that only kernels call: neither optimised nor translated to machine code."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.modules: list[bytes] = []
        """LLVM modules, as bitcode."""
        self.linked: dict[CodeLibrary, None] = {}
        """Libraries that its code calls, in order."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Add a module of intermediate code, with linkage that lets LLVM drop functions that are no longer called."""
        prefer_wide_registers(ir_module)
        module = llvm.parse_assembly(normalize_ir_text(str(ir_module)))
        module.verify()
        for function in module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        self.modules.append(module.as_bitcode())

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Note a library that the function calls."""
        self.linked[library] = None

    def finalize(self) -> None:
        """Do nothing: the code is finished in the kernels that link it in."""

    def get_function(self, name: str) -> Any:
        """Return a function by name."""
        return self._get_module_for_linking().get_function(name)

    def get_llvm_str(self) -> str:
        """Return the code as text."""
        return str(self._get_module_for_linking())

    def get_asm_str(self) -> str:
        """Return the machine code as text."""
        raise NotImplementedError(f"{self.name} is compiled in its callers only")

    def _get_module_for_linking(self) -> Any:
        """Return the code, a copy of it for every caller, by numba's name for that."""
        first, *others = map(llvm.parse_bitcode, self.modules)
        for other in others:
            first.link_in(other)
        return first


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Machine code of a kernel that Python calls, with all functions that it calls linked in."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.linked: dict[CodeLibrary, None] = {}
        """Libraries that its code calls, each before those that it calls itself."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Add a module."""
        prefer_wide_registers(ir_module)
        super().add_ir_module(ir_module)

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Note a library that the kernel calls, and the libraries that this one calls."""
        if library not in self.linked:
            self.linked[library] = None
            for called in library.linked if isinstance(library, IntermediateLibrary) else ():
                self.add_linking_library(called)

    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave functions as they are, by numba's name for optimising them one by one: that is done with the whole."""
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        """Link all of it, and optimise it once, by numba's name for that.

        By itself numba optimises twice, the first time to bring reference counts together, and kernels count none.
        """
        for library in self.linked:
            self._reload_init.update(library._reload_init)
            # Intermediate code is read anew for every kernel, so that there is none to preserve.
            preserve = not isinstance(library, IntermediateLibrary)
            self._final_module.link_in(library._get_module_for_linking(), preserve=preserve)
        passes, settings = self._codegen._module_pass_manager()
        passes.run(self._final_module, settings)


def prefer_wide_registers(ir_module: Any) -> None:
    """Let LLVM use 512-bit registers where the processor has them: by default it uses 256 bits on many processors.

    The blocks of the sequential engine run a third faster with it. NUMBA_CPU_FEATURES, if set, takes precedence.
    """
    if config.CPU_FEATURES is None:
        for function in ir_module.functions:
            if not function.is_declaration:
                # `set.add`, as llvmlite's own `add` refuses attributes that have a value.
                set.add(function.attributes, '"prefer-vector-width"="512"')
    for function in ir_module.functions:
        promise_unchanged(function)


class _CachedFunction(types.Function):  # type: ignore[misc]
    """Type of a built-in function (+, [], <, abs, ...) that caches the signatures found for it.

    By itself numba tries every meaning of `+`, those for strings and sets included, at each of a kernel's thousands of
    sums. Only signatures that numba implements itself are cached; those of functions that it would compile for the
    purpose depend on the options of the caller.
    """

    def __init__(self, templates: Any) -> None:
        super().__init__(templates)
        self.known: dict[Hashable, Any] = {}

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        key = tuple(args)
        if key in self.known and not kws:
            return self.known[key]
        # Signatures that numba looks up on the way, such as `[]` within `+`, are cached as well.
        signature = super().get_call_type(_contexts.get(context, context), args, kws)
        if signature is not None and not kws and self.get_impl_key(signature) == self.typing_key:
            self.known[key] = signature
        return signature


# Functions have no value at run time.
register_model(_CachedFunction)(models.OpaqueModel)


STEPS: dict[Dispatcher, Dispatcher] = {}
"""For each kernel that Python calls, the version of it that other kernels call."""


class _KernelContext:
    """Numba's typing context, with cached signatures of built-ins, and with calls of kernels sent to `STEPS`."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.cached: dict[types.Function, _CachedFunction] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def resolve_value_type(self, value: Any) -> types.Type:
        """Return the type of a constant; a function's type changes when numba registers further overloads of it."""
        if isinstance(value, Dispatcher):
            value = STEPS.get(value, value)
        found = self.context.resolve_value_type(value)
        if type(found) is not types.Function:
            return found
        if found not in self.cached:
            self.cached[found] = _CachedFunction(found.templates)
        return self.cached[found]

    def resolve_function_type(self, function: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call, or None."""
        if function is getitem:
            # Of all functions, a[i] alone is looked up by numba as it stands, not by its type.
            function = self.resolve_value_type(getitem)
        if isinstance(function, _CachedFunction) and not kws and tuple(args) in function.known:
            return function.known[tuple(args)]
        if isinstance(function, types.Dispatcher):
            args, kws = tuple(map(passed_as, args)), {name: passed_as(each) for name, each in dict(kws).items()}
        return self.context.resolve_function_type(function, args, kws)

    def resolve_setitem(self, target: types.Type, index: types.Type, value: types.Type) -> Any:
        """Return the signature of target[index] = value."""
        return self.resolve_function_type(self.resolve_value_type(setitem), (target, index, value), {})


def passed_as(argument: types.Type) -> types.Type:
    """Return the type that an argument is passed as: signed integers of any size as 64 bits, all others as they are."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument


_contexts: dict[Any, _KernelContext] = {}


@cache
def _sizes_by(target: Any) -> Callable[[ir.Type], int]:
    """Return the function that gives the size of a type of LLVM, cached: LLVM compiles a module to answer."""
    return cache(target.get_abi_sizeof)


@register_pass(mutates_CFG=False, analysis_only=False)
class _MakeCallable(LoweringPass):  # type: ignore[misc]
    """Register code that has no address yet, so that kernels can call it."""

    _name = "make_callable"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Register the code under a unique key by which the callers' compiler finds it; Python never calls it."""
        # Dispatchers accept built-in functions only, and the bound methods of two objects are never equal.
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
"""Numba's passes that kernels need, which have no closures, `with`, `raise`, `literally` or arithmetic of whole arrays;
each pass left out saves its time for every function."""


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """The compiler of kernels that Python calls."""

    library: type[CodeLibrary] = KernelLibrary

    def __init__(self, typingctx: Any, *others: Any) -> None:
        context = _contexts.setdefault(typingctx, _KernelContext(typingctx))
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


class StepCompiler(KernelCompiler):
    """The compiler of functions that only kernels call."""

    library = IntermediateLibrary

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, stopped after the intermediate code."""
        (manager,) = super().define_pipelines()
        self.state.flags.no_compile = True
        manager.add_pass_after(_MakeCallable, typed_passes.NativeLowering)
        manager.finalize()
        return [manager]


@contextmanager
def gc_paused() -> Iterator[None]:
    """Pause the garbage collector, if it was on.

    Numba makes millions of objects and few reference cycles; collecting again and again took a sixth of the time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
