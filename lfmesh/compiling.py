"""What keeps a fresh install's first start short: numba, without what it does again and again.

What an operator gives for which types is asked once, and code that only kernels call is made machine code in them
alone. Neither changes a kernel's result. Both reach into numba, and are meant for the releases that `kernel` names.
"""

from functools import wraps
from typing import Any

from numba import _dynfunc, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.typed_passes import NativeLowering


def remember_what_operators_give() -> None:
    """Let numba remember the signatures that it found for built-in functions: +, [], <, abs, ...

    By itself it asks all that `+` may mean, for text and for sets too, at each of a kernel's thousands of sums. Kept is
    only what numba itself carries out; what it would compile for the purpose depends on the options of the caller.
    """
    ask = types.Function.get_call_type
    known: dict[tuple[Any, ...], Any] = {}

    @wraps(ask)
    def get_call_type(function: types.Function, context: Any, args: Any, kws: Any) -> Any:
        if kws:
            return ask(function, context, args, kws)
        key = (context, function, tuple(args))
        if key in known:
            return known[key]
        signature = ask(function, context, args, kws)
        if function.get_impl_key(signature) == function.typing_key:
            known[key] = signature
        return signature

    types.Function.get_call_type = get_call_type


class _LinkedCode(JITCodeLibrary):  # type: ignore[misc]
    """Code that becomes part of its callers': simplified, but neither optimised nor made machine code by itself."""

    def _optimize_final_module(self) -> None:
        manager, builder = self._codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        manager.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


@register_pass(mutates_CFG=True, analysis_only=False)
class _LinkedLowering(NativeLowering):  # type: ignore[misc]
    """Lower to code that is linked into callers'."""

    _name = "linked_lowering"

    def run_pass(self, state: Any) -> bool:
        """Lower as numba does, but for the address of the code, which it has none of."""
        state.library = library = _LinkedCode(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state.cr
        # What callers know the code by. Python never calls it.
        name = lowered.fndesc.qualname.rpartition(".")[2]
        function = _dynfunc.make_function(lowered.fndesc.lookup_module(), name, "", 0, lowered.env, (library,))
        state.targetctx.insert_user_function(function, lowered.fndesc, [library])
        state.cr = lowered._replace(cfunc=function)
        return True


class LinkedCompiler(CompilerBase):  # type: ignore[misc]
    """Numba's compiler, for what only kernels call.

    By itself it optimises and translates such a function whole, though its code is copied into every caller's.
    """

    def define_pipelines(self) -> list[PassManager]:
        """Return numba's passes, with the lowering exchanged."""
        manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [(_LinkedLowering if one is NativeLowering else one, why) for one, why in manager.passes]
        manager.finalize()
        return [manager]
