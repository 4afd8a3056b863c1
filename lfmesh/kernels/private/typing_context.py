"""Typing of calls in kernels: signatures of built-in functions are cached, and kernels call kernels' own versions."""

from collections.abc import Callable, Hashable
from operator import getitem, setitem
from typing import Any

from numba import types
from numba.core.dispatcher import Dispatcher
from numba.core.typing.context import Context
from numba.extending import models, register_model

from lfmesh.kernels.private.expected import require

callee_of: dict[Dispatcher, Callable[[], Dispatcher]] = {}
"""For each kernel that Python calls, what gives the version of it that other kernels call."""


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


class KernelContext:
    """Numba's typing context, with cached signatures of built-ins, and with calls of kernels sent to `callee_of`."""

    def __init__(self, context: Any) -> None:
        self.context = context
        self.cached: dict[types.Function, _CachedFunction] = {}

    def __getattr__(self, name: str) -> Any:
        return getattr(self.context, name)

    def resolve_value_type(self, value: Any) -> types.Type:
        """Return the type of a constant; a function's type changes when numba registers further overloads of it."""
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
            The same by keyword.
        """
        if function is getitem:
            # Of all functions, a[i] alone is looked up by numba as it stands, not by its type.
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
    """Return the type that an argument is passed as: signed integers of any size as 64 bits, all others as they are."""
    argument = types.unliteral(argument)
    return types.int64 if argument in types.signed_domain else argument


_contexts: dict[Any, KernelContext] = {}


def kernel_context(context: Any) -> KernelContext:
    """Return the typing context of kernels on top of one of numba's, one for each."""
    return _contexts.setdefault(context, KernelContext(context))


def probe() -> None:
    """Raise AttributeError where numba's types of functions do not have what is overridden or called here."""
    require(types.Function, "get_call_type", "get_impl_key")
    require(Context, "resolve_value_type", "resolve_function_type", "resolve_setitem")
    require(types, "signed_domain", "unliteral")
