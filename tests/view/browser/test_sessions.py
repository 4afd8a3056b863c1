"""Pages that cannot be made are words, and the server goes on; pages that are left wait for their tab, a while."""

import asyncio
import os
import platform
import selectors
from pathlib import Path
from typing import Any

import pytest

from lfmesh.errors import LfmeshError
from lfmesh.view.browser.replies import OWN_MISTAKE

pytest.importorskip("trame_server")


FILE = "lens.toml: cannot be read"


@pytest.mark.parametrize(("fault", "words"), [(LfmeshError(FILE), FILE), (KeyError(1), OWN_MISTAKE)])
def test_a_later_page_that_fails_says_why(
    fault: Exception, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first one fails where the server is started; a later one must not end as an error 500."""
    from lfmesh.view.browser.sessions import Sessions

    class Empty:
        def close(self) -> None:
            pass

    made: list[Any] = []
    said: list[str] = []

    def fill(server: Any) -> Empty:
        made.append(server)
        if len(made) > 1:
            raise fault
        return Empty()

    def refuse(server: Any, words: str) -> None:
        said.append(words)

    sessions = Sessions(fill, refuse)
    failed = sessions._next()
    assert failed.shown is None
    assert said == [words]
    assert ("KeyError" in capsys.readouterr().err) == isinstance(fault, KeyError)
    with pytest.raises(type(fault)):
        Sessions(fill, refuse)


class Shown:
    """A page that tells whether it is closed."""

    def __init__(self) -> None:
        self.closed = False

    def close(self) -> None:
        self.closed = True


class Clock(asyncio.SelectorEventLoop):
    """An event loop that does not wait: its clock goes on to the next timer, however busy the machine is."""

    def __init__(self) -> None:
        super().__init__(selector := selectors.DefaultSelector())
        self._now, select = 0.0, selector.select

        def at_once(timeout: float | None = None) -> list[Any]:
            self._now += timeout or 0.0
            return select(0.0)

        selector.select = at_once  # type: ignore[method-assign, assignment]

    def time(self) -> float:
        return self._now


def names(count: int) -> list[str]:
    return [f"{number:032x}" for number in range(count)]


def test_pages_that_are_left_are_given_up_after_a_while() -> None:
    from lfmesh.view.browser import sessions

    half = sessions.WAIT_SECONDS / 2

    async def leave() -> tuple[bool, bool, bool, bool]:
        all_pages = sessions.Sessions(lambda _server: Shown(), lambda _server, _words: None)
        left, returned = all_pages._next(), all_pages._next()
        for name, session in zip(names(2), (left, returned), strict=True):
            all_pages._keep(name, session)
        at_once = left.shown.closed  # type: ignore[union-attr]
        await asyncio.sleep(half)
        all_pages._left.pop(names(2)[1]).stay()
        await asyncio.sleep(half / 2)
        all_pages._keep(names(2)[1], returned)
        await asyncio.sleep(half)
        found = at_once, left.shown.closed, returned.shown.closed  # type: ignore[union-attr]
        await all_pages.close()
        return *found, returned.shown.closed  # type: ignore[union-attr]

    with asyncio.Runner(loop_factory=Clock) as runner:
        assert runner.run(leave()) == (False, True, False, True)


def test_pages_that_are_left_make_room_the_oldest_first() -> None:
    from lfmesh.view.browser import sessions

    async def leave() -> tuple[list[bool], int]:
        all_pages = sessions.Sessions(lambda _server: Shown(), lambda _server, _words: None)
        left = [all_pages._next() for _ in range(sessions.MOST_PAGES)]
        for name, session in zip(names(len(left)), left, strict=True):
            all_pages._keep(name, session)
        for _ in range(2):
            all_pages._open.add(all_pages._next())
        found = [session.shown.closed for session in left]  # type: ignore[union-attr]
        kept = len(all_pages._left)
        for session in all_pages._left.values():
            session.stay()
        return found, kept

    with asyncio.Runner(loop_factory=Clock) as runner:
        closed, kept = runner.run(leave())
    assert closed == [True, True] + [False] * (sessions.MOST_PAGES - 2)
    assert kept == sessions.MOST_PAGES - 2


class Large(Shown):
    """A page of 50 MB in small pieces, among which lie others that stay: a part of those of each page, as in C."""

    def __init__(self, stay: list[bytearray]) -> None:
        super().__init__()
        self.own, self.pieces = self, []
        for number in range(12_500):
            self.pieces.append(bytearray(4000))
            if number % 100 == 0:
                stay.append(bytearray(4000))


@pytest.mark.skipif(
    platform.libc_ver()[0] != "glibc", reason="other libraries give memory back by themselves, or never"
)
def test_the_memory_of_closed_pages_goes_back_to_the_system() -> None:
    from lfmesh.view.browser import sessions

    stay: list[bytearray] = []

    async def leave() -> tuple[float, float]:
        all_pages = sessions.Sessions(lambda _server: Large(stay), lambda _server, _words: None)
        page = all_pages._next()
        held = memory_mb()
        all_pages._give_up(page)
        del page
        await asyncio.sleep(2.0 * sessions.COLLECT_SECONDS)
        return held, memory_mb()

    with asyncio.Runner(loop_factory=Clock) as runner:
        held, left = runner.run(leave())
    assert held - left > 40.0


def memory_mb() -> float:
    """Return the memory that this process has of the system."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
