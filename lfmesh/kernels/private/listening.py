"""Notification of compilations, from numba's events."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event

from lfmesh.kernels.private.expected import require


@contextmanager
def told_of_kernels(tell: Callable[[], None]) -> Iterator[None]:
    """Call a function whenever numba starts or ends compiling a kernel within the block.

    Parameters
    ----------
    tell : callable
    """

    class Told(event.Listener):  # type: ignore[misc]
        def on_start(self, _: event.Event) -> None:
            tell()

        def on_end(self, _: event.Event) -> None:
            tell()

    with event.install_listener("numba:compile", Told()):
        yield


def probe() -> None:
    """Raise an error if numba has no such events."""
    require(event, "install_listener", "Listener")
