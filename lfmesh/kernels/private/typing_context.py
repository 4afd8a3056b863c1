"""Typing of calls in kernels, with cached signatures of built-ins and separate kernel versions for other kernels."""

from collections.abc import Callable, Hashable
from operator import getitem, setitem
from typing import Any

from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.typing.context import Context
from numba.extending import models, register_model

from lfmesh.kernels.private.expected import require

callee_of: dict[Dispatcher, Callable[[], Dispatcher]] = {}
"""For each kernel that Python calls, a function that returns the version that other kernels call."""


class _CachedFunction(types.Function):  # type: ignore[misc]
    """Type of a built-in function (+, [], <, abs, ...) that caches the signatures found for it.

    Numba alone tries every meaning of `+`, strings and sets included, at each of a kernel's thousands of sums. Only
    signatures that numba implements itself are cached. Numba may compile others for the purpose, and these depend on
    the caller's options.
    """

    def __init__(self, templates: Any) -> None:
        super().__init__(templates)
        self.known: dict[Hashable, Any] = {}

    def get_call_type(self, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call."""
        key = tuple(args)
        if key in self.known and not kws:
            return self.known[key]
        # This context also caches signatures that numba looks up on the way, such as `[]` within `+`.
        signature = super().get_call_type(_contexts.get(context, context), args, kws)
        if signature is not None and not kws and self.get_impl_key(signature) == self.typing_key:
            self.known[key] = signature
        return signature


# Functions have no value at run time.
register_model(_CachedFunction)(models.OpaqueModel)


class KernelContext:
    """Numba's typing context, with cached signatures of built-ins and calls of kernels redirected to `callee_of`."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.cached: dict[types.Function, _CachedFunction] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def resolve_value_type(self, value: Any) -> types.Type:
        """Return the type of a constant; that of a function changes when numba registers further overloads."""
        if isinstance(value, Dispatcher) and value in callee_of:
            value = callee_of[value]()
        found = self.context.resolve_value_type(value)
        if type(found) is not types.Function:
            return found
        if found not in self.cached:
            self.cached[found] = _CachedFunction(found.templates)
        return self.cached[found]

    def resolve_function_type(self, function: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call, or None.

        Parameters
        ----------
        function : numba type
        args : tuple of numba types
        kws : dict
            By keyword.
        """
        if function is getitem:
            # Of all functions, numba looks up only a[i] by the function itself rather than by its type.
            function = self.resolve_value_type(getitem)
        if isinstance(function, _CachedFunction) and not kws and tuple(args) in function.known:
            return function.known[tuple(args)]
        if isinstance(function, types.Dispatcher):
            args, kws = tuple(map(passed_as, args)), {name: passed_as(each) for name, each in dict(kws).items()}
        return self.context.resolve_function_type(function, args, kws)

    def resolve_setitem(self, target: types.Type, index: types.Type, value: types.Type) -> Any:
        """Return the signature of target[index] = value.

        Parameters
        ----------
        target, index, value : numba types
        """
        return self.resolve_function_type(self.resolve_value_type(setitem), (target, index, value), {})


def passed_as(argument: types.Type) -> types.Type:
    """Return the type used to pass an argument: 64 bits for signed integers of any size, else unchanged."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument


_contexts: dict[Any, KernelContext] = {}


def kernel_context(context: Any) -> KernelContext:
    """Return the kernels' typing context on top of one of numba's; the same object at each call."""
    return _contexts.setdefault(context, KernelContext(context))


def probe() -> None:
    """Raise AttributeError if numba's function types lack the methods overridden or called here."""
    require(types.Function, "get_call_type", "get_impl_key")
    require(Context, "resolve_value_type", "resolve_function_type", "resolve_setitem")
    require(types, "signed_domain", "unliteral")
