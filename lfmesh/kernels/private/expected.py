"""Expectations of numba's private classes, by name."""

from typing import Any


def require(owner: Any, *names: str) -> None:
    """Raise AttributeError unless a class or module of numba has attributes of some names."""
    missing = [name for name in names if not hasattr(owner, name)]
    if missing:
        raise AttributeError(f"{owner.__name__} has no {', '.join(missing)}")


def require_call(caller: Any, name: str) -> None:
    """Raise AttributeError unless the code of a function of numba uses a name: a hook that is never called is none."""
    if name not in caller.__code__.co_names:
        raise AttributeError(f"{caller.__qualname__} does not call {name}")
