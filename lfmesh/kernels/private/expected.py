"""Checks that numba's private classes have the expected names."""

from typing import Any


def require(owner: Any, *names: str) -> None:
    """Raise AttributeError if a class or module of numba lacks one of the names."""
    missing = [name for name in names if not hasattr(owner, name)]
    if missing:
        raise AttributeError(f"{owner.__name__} has no {', '.join(missing)}")


def require_call(caller: Any, name: str) -> None:
    """Raise AttributeError if a function of numba does not use a name, such as a hook."""
    if name not in caller.__code__.co_names:
        raise AttributeError(f"{caller.__qualname__} does not call {name}")
