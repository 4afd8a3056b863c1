"""Signatures that list the keywords of ``**options``, for help and completion."""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, get_args, get_type_hints

Function = TypeVar("Function", bound=Callable[..., Any])


def with_keywords(**defaults: Any) -> Callable[[Function], Function]:
    """Give a function with ``**options: Unpack[Options]`` a signature that lists the options.

    Parameters
    ----------
    **defaults
        Defaults of the options; None for all others.
    """

    def listed(function: Function) -> Function:
        signature = inspect.signature(function)
        *named, options = signature.parameters.values()
        (kind,) = get_args(options.annotation)
        more = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=defaults.get(name), annotation=annotation)
            for name, annotation in get_type_hints(kind).items()
        ]
        function.__signature__ = signature.replace(parameters=[*named, *more])  # type: ignore[attr-defined]
        return function

    return listed
