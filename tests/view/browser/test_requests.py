"""Requests as bytes to a server on loopback: whatever stands in a header, a stranger gets 403; pages stay few."""

import asyncio
import gc
import logging
import weakref
from collections.abc import Awaitable, Callable

import pytest

pytest.importorskip("trame_server", reason="the extra browser is not installed")

from aiohttp import web

from lfmesh.view.browser import sessions
from lfmesh.view.browser.guard import REFUSED, Guard

UPGRADE = (
    b"Upgrade: websocket", b"Connection: Upgrade", b"Sec-WebSocket-Version: 13",
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)  # fmt: skip

HERE = b"Host: 127.0.0.1:%d"


class Site:
    """A server of pages that show nothing, and those of them that are in memory."""

    def __init__(self) -> None:
        self.guard = Guard("127.0.0.1")
        self.pages: weakref.WeakSet[Empty] = weakref.WeakSet()
        self.sessions = sessions.Sessions(self._fill, lambda _server, _words: None)
        self.port = 0

    def _fill(self, _server: object) -> "Empty":
        self.pages.add(page := Empty())
        return page

    @property
    def cookie(self) -> bytes:
        return f"Cookie: lfmesh-{self.port}={self.guard.token}".encode()

    async def ask(self, *headers: bytes, path: bytes = b"/index.html") -> tuple[int, str]:
        """Return status and body of the answer to a request of these header lines, `%d` the port."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        lines = [b"GET %b HTTP/1.1" % path, *(line.replace(b"%d", b"%d" % self.port) for line in headers)]
        writer.write(b"\r\n".join([*lines, b"Connection: close", b"", b""]))
        answer = await reader.read()
        writer.close()
        head, _, body = answer.partition(b"\r\n\r\n")
        return int(head.split()[1]), body.decode()

    async def websocket(self, tab: str) -> tuple[bytes, asyncio.StreamWriter]:
        """Open a websocket as a tab does; return the line of its status, and what closes it."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        lines = [b"GET /ws?tab=%b HTTP/1.1" % tab.encode(), HERE % self.port, self.cookie, *UPGRADE, b"", b""]
        writer.write(b"\r\n".join(lines))
        return (await reader.readuntil(b"\r\n\r\n")).splitlines()[0], writer

    async def settled(self) -> int:
        """Return how many pages are in memory once the server has seen what happened."""
        for _ in range(100):
            await asyncio.sleep(0.01)
            if not self.sessions._open:
                break
        gc.collect()
        return len(self.pages)


class Empty:
    """A page that shows nothing."""

    def close(self) -> None:
        """Give up nothing."""


def served(visit: Callable[[Site], Awaitable[None]]) -> None:
    """Run a server for a visit."""

    async def run() -> None:
        site = Site()
        app = web.Application(middlewares=[site.guard.answer, site.sessions.answer])
        site.sessions._host = site
        runner = web.AppRunner(app)
        await runner.setup()
        await (listening := web.TCPSite(runner, "127.0.0.1", 0)).start()
        site.port = listening._server.sockets[0].getsockname()[1]  # type: ignore[union-attr]
        try:
            await visit(site)
        finally:
            await site.sessions.close()
            await runner.cleanup()

    asyncio.run(run())


ODD = [
    (HERE, b"Cookie: lfmesh-%d=\xff\xfe"),
    (HERE, b"Cookie: lfmesh-%d=\xc3\xa9"),
    (HERE, b"Cookie: \xff=\xff; lfmesh-%d=\xed\xa0\x80"),
    (HERE, b"Origin: http://\xff\xfe"),
    (HERE, b"Origin: http://[bad"),
    (HERE, b"Origin: http://[::1"),
    (HERE, b"Origin: http://\xe2\x84\x80.example"),
    (b"Host: \xff\xfe",),
    (b"Host: 127.0.0.1:\xff",),
    (b"Host: [bad",),
    (b"Host: 127.0.0.1:%d; script-src *",),
    (b"Host: ",),
    (HERE, b"Sec-WebSocket-Key: \xff", b"Sec-WebSocket-Version: 13", b"Upgrade: websocket"),
]


@pytest.mark.parametrize("with_token", [False, True])
def test_headers_that_are_no_addresses_are_refused_without_a_traceback(
    with_token: bool, caplog: pytest.LogCaptureFixture
) -> None:
    async def visit(site: Site) -> None:
        for headers in ODD:
            # The token is no help, unless the cookie itself is what is odd.
            path = b"/ws?token=" + site.guard.token.encode() if with_token else b"/ws"
            if with_token and any(line.startswith(b"Cookie") for line in headers):
                continue
            status, said = await site.ask(*headers, path=path)
            assert (status, said[: len(REFUSED)]) == (403, REFUSED), headers

    with caplog.at_level(logging.WARNING):
        served(visit)
    assert not caplog.records


def test_a_cookie_of_another_program_that_is_not_ascii_does_not_keep_the_user_out() -> None:
    async def visit(site: Site) -> None:
        assert (await site.ask(HERE, site.cookie + b"; other=\xff\xc3\xa9"))[0] == 200

    served(visit)


def test_tabs_that_leave_at_once_hold_no_more_pages_than_may_be_open() -> None:
    """Two hundred tabs, each loaded once and closed, within the time that a page waits for its tab."""

    async def visit(site: Site) -> None:
        for number in range(200):
            status, writer = await site.websocket(f"{number:032x}")
            assert status.split()[1] == b"101"
            writer.close()
            await writer.wait_closed()
            while site.sessions._open:
                await asyncio.sleep(0.001)
        assert await site.settled() <= sessions.MOST_PAGES

    served(visit)


def test_tabs_that_stay_open_are_bounded_and_free_what_they_held() -> None:
    async def visit(site: Site) -> None:
        opened = [await site.websocket(f"{number:032x}") for number in range(sessions.MOST_SOCKETS + 8)]
        statuses = [status.split()[1] for status, _ in opened]
        assert statuses == [b"101"] * sessions.MOST_SOCKETS + [b"503"] * 8
        assert len(site.pages) == sessions.MOST_PAGES
        for _, writer in opened:
            writer.close()
        assert await site.settled() <= sessions.MOST_PAGES
        while site.sessions._left:
            site.sessions._drop(*next(iter(site.sessions._left.items())))
        assert await site.settled() == 0

    served(visit)
