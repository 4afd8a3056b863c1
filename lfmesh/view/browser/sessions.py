"""A state of its own for each open page: camera, rays, filter, history and light field are not shared between tabs.

trame keeps one state for all that are connected to a server. Here a websocket that is opened gets a trame server to
itself, with a page of its own; what it draws stands once in memory, see `subject`. When the connection closes, the page
waits for its tab a while: a tab that is loaded again finds it as it was left. Then, or where others need the room, what
it held is given up.
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
"""Open pages that have a state; each has a 3D view."""

WAIT_SECONDS = 60.0
"""So long a page whose connection has closed waits for its tab to be loaded again."""

MOST_SOCKETS = 64
"""Open websockets, those of pages that say only that there are too many included."""

COLLECT_SECONDS = 1.0
"""After so long the memory of a closed page is free."""

START, NAMES_ITS_TAB = "/index.html", '<script src="lfmesh/tab.js"></script>'
"""trame's page that starts its client, and what is put before the client's own scripts."""

_TAB = re.compile(r"[0-9a-f]{32}")

FULL = f"lfmesh serves {MOST_PAGES} pages at a time, which are open. Close one of them, then load this one again."


class Shown(Protocol):
    """Content of a page."""

    def close(self) -> None:
        """Give up what it holds."""


class _Session:
    """A trame server of one connection.

    Parameters
    ----------
    number : int
        Of all sessions so far.
    fill : callable
        Fills the server's page.
    """

    def __init__(self, number: int, fill: Callable[[Any], Shown | None]) -> None:
        # trame keeps what it knows of 3D views by the server's name.
        self.server = trame_server.Server(f"lfmesh {number}")
        self.server.client_type = "vue3"
        self.shown = fill(self.server)
        self.server.enable_module(trame_client.module)
        self._handler: AioHttpWsHandler | None = None
        self._waits: asyncio.TimerHandle | None = None

    async def answer(self, request: web.Request, port: int) -> web.StreamResponse:
        """Answer on a websocket until it is closed."""
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
        """Wait no more: the tab is there again."""
        if self._waits is not None:
            self._waits.cancel()

    async def disconnect(self) -> None:
        """Close the websocket."""
        if self._handler is not None:
            await self._handler.disconnectClients()

    def close(self) -> None:
        """Give up what the session holds."""
        # The timer would hold the page until it has run out.
        self.stay()
        if self.shown is not None:
            self.shown.close()
        vtk.HELPERS_PER_SERVER.pop(self.server.name, None)


class Sessions:
    """Gives each websocket a page, and a tab that is loaded again the page that it had.

    Parameters
    ----------
    fill : callable
        Fills a trame server's page.
    refuse : callable
        Fills it with words alone: why there is no page.
    """

    def __init__(self, fill: Callable[[Any], Shown], refuse: Callable[[Any, str], None]) -> None:
        self._fill, self._refuse = fill, refuse
        self._number, self._collects, self._ends = 0, False, False
        self._open: set[_Session] = set()
        self._left: dict[str, _Session] = {}
        # The first page stands ready: what is wrong with it is found before the server starts.
        self._ready: _Session | None = self._new()

    def add_files(self, host: Any) -> None:
        """Let the server that sends files send those that pages need."""
        assert self._ready is not None
        host.serve.update(self._ready.server.serve)
        self._host = host

    @web.middleware
    async def answer(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a websocket by a page of its own, and any other request as it was: a middleware of aiohttp."""
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
        """Let a page wait for its tab, in place of an older one of the same: a tab's copy has its name."""
        self._drop(tab, self._left.get(tab))
        self._left[tab] = session
        session.wait(lambda: self._drop(tab, session))

    def _drop(self, tab: str, session: _Session | None) -> None:
        """Give up a page, if it still waits for its tab."""
        if session is not None and self._left.get(tab) is session:
            del self._left[tab]
            self._give_up(session)

    def _give_up(self, session: _Session) -> None:
        session.close()
        if session.shown is not None:
            self._collect_later()

    def _collect_later(self) -> None:
        """Free the memory of closed pages, of several at once: page and server hold each other, some 65 MB."""
        if not self._collects:
            self._collects = True
            asyncio.get_running_loop().call_later(COLLECT_SECONDS, self._collect)

    def _collect(self) -> None:
        self._collects = False
        gc.collect()
        _give_back()

    def _next(self) -> _Session:
        """Return a session with a page, or with words where there are too many or it cannot be made."""
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
    """Give memory that is free back to the system; glibc keeps pages' pieces of it, which are large in sum."""
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


@cache
def _start_page() -> str:
    """Return trame's start page with the script that names the tab before its own."""
    page = (Path(vue3.www) / "index.html").read_text(encoding="utf-8")
    return page.replace("<script", f"{NAMES_ITS_TAB}<script", 1)
