"""Separate state for each open page: tabs do not share camera, rays, filter, history or light field.

trame keeps one state per server, so each websocket gets its own trame server and page. Data that all pages draw are in
memory once, see `subject`. When a connection closes, its page waits for a while, so that a reloaded tab finds it
unchanged; if others need the room, it is discarded earlier.
"""

import asyncio
import ctypes
import gc
import re
import traceback
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import trame_client.module
import trame_server
from aiohttp import web
from trame_client.module import vue3
from trame_server.protocol import CoreServer
from trame_vtk.modules import vtk
from wslink.backends.aiohttp import AioHttpWsHandler, create_webserver

from lfmesh.errors import LfmeshError
from lfmesh.view.browser.guard import Handler
from lfmesh.view.browser.replies import OWN_MISTAKE

WEBSOCKET = "/ws"

MOST_PAGES = 8
"""Open pages with state; each has a 3D view."""

WAIT_SECONDS = 60.0
"""Time for which the page of a closed connection waits for its tab to reload."""

MOST_SOCKETS = 64
"""Open websockets, including pages that only report that there are too many."""

COLLECT_SECONDS = 1.0
"""Delay before the memory of a closed page is freed."""

START, NAMES_ITS_TAB = "/index.html", '<script src="lfmesh/tab.js"></script>'
"""trame's page that starts its client, and the script inserted before the client's own."""

_TAB = re.compile(r"[0-9a-f]{32}")

FULL = f"lfmesh serves {MOST_PAGES} pages at a time, and all of them are open. Close one, then reload this one."


class Shown(Protocol):
    """Content of a page."""

    def close(self) -> None:
        """Release its resources."""


class _Session:
    """Trame server of one connection.

    Parameters
    ----------
    number : int
        Serial number of the session.
    fill : callable
        Fills the server's page.
    """

    def __init__(self, number: int, fill: Callable[[Any], Shown | None]) -> None:
        # trame identifies 3D views by the server's name.
        self.server = trame_server.Server(f"lfmesh {number}")
        self.server.client_type = "vue3"
        self.shown = fill(self.server)
        self.server.enable_module(trame_client.module)
        self._handler: AioHttpWsHandler | None = None
        self._waits: asyncio.TimerHandle | None = None

    async def answer(self, request: web.Request, port: int) -> web.StreamResponse:
        """Serve a websocket until it closes."""
        if self._handler is None:
            self._handler = self._begin(port)
        return await self._handler.handleWsRequest(request)

    def _begin(self, port: int) -> AioHttpWsHandler:
        CoreServer.bind_server(self.server)
        protocol, site = CoreServer(), create_webserver({})
        handler = AioHttpWsHandler(protocol, site)
        protocol.set_server(site)
        protocol.port_callback(port)
        return handler

    def wait(self, give_up: Callable[[], None]) -> None:
        """Wait for the tab, and give up after a while."""
        self._waits = asyncio.get_running_loop().call_later(WAIT_SECONDS, give_up)

    def stay(self) -> None:
        """Stop waiting: the tab is back."""
        if self._waits is not None:
            self._waits.cancel()

    async def disconnect(self) -> None:
        """Close the websocket."""
        if self._handler is not None:
            await self._handler.disconnectClients()

    def close(self) -> None:
        """Release the session's resources."""
        # Otherwise the timer would hold the page until it runs out.
        self.stay()
        if self.shown is not None:
            self.shown.close()
        vtk.HELPERS_PER_SERVER.pop(self.server.name, None)


class Sessions:
    """Pages of a server: each websocket gets its own, each reloaded tab its former one.

    Parameters
    ----------
    fill : callable
        Fills a trame server's page.
    refuse : callable
        Fills it with only the reason why there is no page.
    """

    def __init__(self, fill: Callable[[Any], Shown], refuse: Callable[[Any, str], None]) -> None:
        self._fill, self._refuse = fill, refuse
        self._number, self._collects, self._ends = 0, False, False
        self._open: set[_Session] = set()
        self._left: dict[str, _Session] = {}
        # Prepare the first page in advance, to find its faults before the server starts.
        self._ready: _Session | None = self._new()

    def add_files(self, host: Any) -> None:
        """Let the file server send the files that pages need."""
        assert self._ready is not None
        host.serve.update(self._ready.server.serve)
        self._host = host

    @web.middleware
    async def answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a websocket with its own page, and any other request as before: aiohttp middleware."""
        if request.path == START:
            return web.Response(text=_start_page(), content_type="text/html")
        if request.path != WEBSOCKET:
            return await handler(request)
        if request.headers.get("Upgrade", "").lower() != "websocket":
            return web.Response(status=426, headers={"Upgrade": "websocket"}, text=f"{WEBSOCKET}: websockets only.\n")
        if len(self._open) >= MOST_SOCKETS:
            return web.Response(status=503, text=FULL + "\n")
        tab = request.query.get("tab", "")
        session = self._left.pop(tab, None)
        if session is not None:
            session.stay()
        else:
            session, self._ready = self._ready or self._next(), None
        self._open.add(session)
        try:
            return await session.answer(request, self._host.port)
        finally:
            self._open.discard(session)
            if session.shown is not None and _TAB.fullmatch(tab) and not self._ends:
                self._keep(tab, session)
            else:
                self._give_up(session)

    async def close(self) -> None:
        """Close all pages."""
        self._ends = True
        for session in list(self._open):
            await session.disconnect()
        for session in self._left.values():
            session.close()
        if self._ready is not None:
            self._ready.close()

    def _keep(self, tab: str, session: _Session) -> None:
        """Keep a page for its tab, replacing an older one: duplicated tabs share a name."""
        self._drop(tab, self._left.get(tab))
        self._left[tab] = session
        session.wait(lambda: self._drop(tab, session))

    def _drop(self, tab: str, session: _Session | None) -> None:
        """Discard a page if it still waits for its tab."""
        if session is not None and self._left.get(tab) is session:
            del self._left[tab]
            self._give_up(session)

    def _give_up(self, session: _Session) -> None:
        session.close()
        if session.shown is not None:
            self._collect_later()

    def _collect_later(self) -> None:
        """Schedule freeing the memory of closed pages together: page and server refer to each other, about 65 MB."""
        if not self._collects:
            self._collects = True
            asyncio.get_running_loop().call_later(COLLECT_SECONDS, self._collect)

    def _collect(self) -> None:
        self._collects = False
        gc.collect()
        _give_back()

    def _next(self) -> _Session:
        """Return a session with a page, or with a message if there are too many or it cannot be made."""
        shown = sum(session.shown is not None for session in self._open)
        if self._left and shown + len(self._left) >= MOST_PAGES:
            self._drop(*next(iter(self._left.items())))
        if shown >= MOST_PAGES:
            return self._that_says(FULL)
        try:
            return self._new()
        except LfmeshError as fault:
            return self._that_says(str(fault))
        except Exception:
            traceback.print_exc()
            return self._that_says(OWN_MISTAKE)

    def _new(self) -> _Session:
        self._number += 1
        return _Session(self._number, self._fill)

    def _that_says(self, words: str) -> _Session:
        self._number += 1
        return _Session(self._number, lambda server: self._refuse(server, words))


def _give_back() -> None:
    """Return free memory to the system; glibc would keep many small pieces of pages."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


@cache
def _start_page() -> str:
    """Return trame's start page, with the script that names the tab inserted before its own."""
    page = (Path(vue3.www) / "index.html").read_text(encoding="utf-8")
    return page.replace("<script", f"{NAMES_ITS_TAB}<script", 1)
