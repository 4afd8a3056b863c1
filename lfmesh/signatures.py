"""Signatures that name the keywords which a function takes as ``**options``, for help and completion."""

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, get_args, get_type_hints

Function = TypeVar("Function", bound=Callable[..., Any])


def with_keywords(**defaults: Any) -> Callable[[Function], Function]:
    """Give a function whose last parameter is ``**options: Unpack[Options]`` a signature that lists the options.

    Parameters
    ----------
    **defaults
        Of the options; those that are not named are None if left out.
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
