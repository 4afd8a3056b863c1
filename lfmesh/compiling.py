"""How kernels are compiled, so that a fresh install's first render starts soon.

By itself numba makes machine code of every function that a kernel calls, and optimises it again in every caller. The
compilers of this file keep what only kernels call as LLVM's intermediate code; a kernel that Python calls takes all of
it in, is optimised once, and alone is translated. What an operator gives for which types is asked once. Neither changes
what a kernel computes.

Compilers like these are given to `njit` as its `pipeline_class` and work on what is compiled with them alone. Nothing
of numba is exchanged. An option of `njit` upstream that says "called by compiled code only" would make `StepCompiler`
needless, and a memory of successful answers in `BaseContext.resolve_function_type`, which remembers failures already,
`_RememberedFunction`.
"""

import gc
from collections.abc import Hashable, Iterator
from contextlib import contextmanager
from operator import setitem
from typing import Any

import llvmlite.binding as llvm
from numba import types
from numba.core import config
from numba.core.cgutils import normalize_ir_text
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, PassManager, register_pass
from numba.core.dispatcher import Dispatcher
from numba.core.typed_passes import NativeLowering
from numba.extending import models, register_model


class IntermediateLibrary(CodeLibrary):  # type: ignore[misc]
    """The code of a function that only kernels call: neither optimised nor made machine code."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.modules: list[bytes] = []
        """LLVM modules, as bitcode."""
        self.linked: dict[CodeLibrary, None] = {}
        """What its code calls, in order."""

    def add_ir_module(self, ir_module: Any) -> None:
        """Keep a module."""
        prefer_wide_registers(ir_module)
        module = llvm.parse_assembly(normalize_ir_text(str(ir_module)))
        module.verify()
        self.modules.append(module.as_bitcode())

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Keep what the function calls."""
        self.linked[library] = None

    def finalize(self) -> None:
        """Do nothing: the code is finished in the kernels that take it in."""

    def get_function(self, name: str) -> Any:
        """Return a function by name."""
        return self._merged().get_function(name)

    def get_llvm_str(self) -> str:
        """Return the code as text."""
        return str(self._merged())

    def get_asm_str(self) -> str:
        """Return the machine code as text."""
        raise NotImplementedError(f"{self.name} is compiled in its callers only")

    def _merged(self) -> Any:
        return merged(self.modules)


class KernelLibrary(JITCodeLibrary):  # type: ignore[misc]
    """The machine code of a kernel that Python calls, with all that the kernel calls taken in."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.taken: dict[IntermediateLibrary, None] = {}

    def add_ir_module(self, ir_module: Any) -> None:
        """Add a module."""
        prefer_wide_registers(ir_module)
        super().add_ir_module(ir_module)

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Take in what the kernel calls, and what that calls."""
        if not isinstance(library, IntermediateLibrary):
            super().add_linking_library(library)
        elif library not in self.taken:
            self.taken[library] = None
            for called in library.linked:
                self.add_linking_library(called)

    def finalize(self) -> None:
        """Link, optimise and translate."""
        if self.taken:
            self.add_llvm_module(merged([module for library in self.taken for module in library.modules]))
        super().finalize()


def prefer_wide_registers(ir_module: Any) -> None:
    """Let LLVM use 512-bit registers where the processor has them: by itself it keeps to 256 on many.

    The blocks of the sequential engine are a third quicker for it. NUMBA_CPU_FEATURES, if set, has the last word.
    """
    if config.CPU_FEATURES is None:
        for function in ir_module.functions:
            if not function.is_declaration:
                # Past the check of llvmlite's own `add`, which knows no attribute that has a value.
                set.add(function.attributes, '"prefer-vector-width"="512"')


def merged(modules: list[bytes]) -> Any:
    """Return LLVM modules as one, whose functions may go where nothing calls them any longer."""
    first, *others = map(llvm.parse_bitcode, modules)
    for other in others:
        first.link_in(other)
    for function in first.functions:
        if not function.is_declaration:
            function.linkage = "linkonce_odr"
    return first


class _RememberedFunction(types.Function):  # type: ignore[misc]
    """The type of a built-in function, +, [], <, abs, ..., which remembers the signatures that were found for it.

    By itself numba asks all that `+` may mean, for text and for sets too, at each of a kernel's thousands of sums. Kept
    is only what numba itself carries out; what it would compile for the purpose depends on the options of the caller.
    """

    def __init__(self, templates: Any) -> None:
        super().__init__(templates)
        self.known: dict[Hashable, Any] = {}

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        key = tuple(args)
        if key in self.known and not kws:
            return self.known[key]
        # What numba asks on the way, as `[]` of `+`, is remembered too.
        signature = super().get_call_type(_contexts.get(context, context), args, kws)
        if signature is not None and not kws and self.get_impl_key(signature) == self.typing_key:
            self.known[key] = signature
        return signature


# As every function has: no value at all.
register_model(_RememberedFunction)(models.OpaqueModel)


STEPS: dict[Dispatcher, Dispatcher] = {}
"""What kernels call in place of the kernel that Python calls."""


class _KernelContext:
    """A typing context of numba's in which built-in functions remember their signatures, and kernels call steps."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.remembered: dict[types.Function, _RememberedFunction] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def resolve_value_type(self, value: Any) -> types.Type:
        """Return the type of a constant; a function that numba has learned more of since has another."""
        if isinstance(value, Dispatcher):
            value = STEPS.get(value, value)
        found = self.context.resolve_value_type(value)
        if type(found) is not types.Function:
            return found
        if found not in self.remembered:
            self.remembered[found] = _RememberedFunction(found.templates)
        return self.remembered[found]

    def resolve_function_type(self, function: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call, None where there is none."""
        if isinstance(function, _RememberedFunction) and not kws and tuple(args) in function.known:
            return function.known[tuple(args)]
        if isinstance(function, types.Dispatcher):
            args, kws = tuple(map(passed_as, args)), {name: passed_as(each) for name, each in dict(kws).items()}
        return self.context.resolve_function_type(function, args, kws)

    def resolve_setitem(self, target: types.Type, index: types.Type, value: types.Type) -> Any:
        """Return the signature of target[index] = value."""
        return self.resolve_function_type(self.resolve_value_type(setitem), (target, index, value), {})


def passed_as(argument: types.Type) -> types.Type:
    """Return the type that an argument is passed as: whole numbers, but for the unsigned of hashes, as 64 bits."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument


_contexts: dict[Any, _KernelContext] = {}


@register_pass(mutates_CFG=False, analysis_only=False)
class _MakeCallable(LoweringPass):  # type: ignore[misc]
    """Tell numba of code that has no address yet, so that kernels can call it."""

    _name = "make_callable"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        """Give the code a key, by which the callers' compiler finds it; Python never calls it."""
        # Dispatchers take built-in functions only. The methods of two objects are never equal.
        key = list[None]().append
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=key)
        return True


class KernelCompiler(CompilerBase):  # type: ignore[misc]
    """The compiler of kernels that Python calls."""

    library: type[CodeLibrary] = KernelLibrary

    def __init__(self, typingctx: Any, *others: Any) -> None:
        context = _contexts.setdefault(typingctx, _KernelContext(typingctx))
        super().__init__(context, *others)
        self.state.targetctx = self.state.targetctx.subtarget(typing_context=context)

    def compile_extra(self, func: Any) -> Any:
        """Compile a function, and what it calls."""
        with gc_paused():
            return super().compile_extra(func)

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, which are to leave the code in a library of ours."""
        state = self.state
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return [DefaultPassBuilder.define_nopython_pipeline(state)]


class StepCompiler(KernelCompiler):
    """The compiler of what only kernels call."""

    library = IntermediateLibrary

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, which end with the intermediate code."""
        (manager,) = super().define_pipelines()
        self.state.flags.no_compile = True
        manager.add_pass_after(_MakeCallable, NativeLowering)
        manager.finalize()
        return [manager]


@contextmanager
def gc_paused() -> Iterator[None]:
    """Keep the garbage collector off, if it was on.

    Numba makes objects by the million and few cycles; to search them again and again took a sixth of the time.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()
