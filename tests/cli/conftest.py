"""Signals as in a process of its own: what a server or an event loop in another test made of them is put aside."""

import signal
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True)
def own_signals() -> Iterator[None]:
    """Give SIGTERM and SIGHUP their defaults, and wake no event loop by them."""
    usual = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGTERM, signal.SIGHUP)}
    woken = signal.set_wakeup_fd(-1)
    yield
    signal.set_wakeup_fd(woken)
    for number, handler in usual.items():
        signal.signal(number, handler)
