"""A state of its own for each open page: camera, rays, filter, history and light field are not shared between tabs.

trame keeps one state for all that are connected to a server. Here a websocket that is opened gets a trame server to
itself, with a page of its own; what it draws stands once in memory, see `subject`. The page ends with its connection:
one that is left or reloaded, or whose browser does not answer any more, takes nothing.
"""

import asyncio
import gc
import traceback
from collections.abc import Callable
from typing import Any, Protocol

import trame_client.module
import trame_server
from aiohttp import web
from trame_server.protocol import CoreServer
from trame_vtk.modules import vtk
from wslink.backends.aiohttp import AioHttpWsHandler, create_webserver

from lfmesh.errors import LfmeshError
from lfmesh.view.browser.guard import Handler
from lfmesh.view.browser.replies import OWN_MISTAKE

WEBSOCKET = "/ws"

MOST_PAGES = 8
"""Open pages that have a state; each has a 3D view."""

MOST_SOCKETS = 64
"""Open websockets, those of pages that say only that there are too many included."""

COLLECT_SECONDS = 1.0
"""After so long the memory of a closed page is free."""

FULL = f"lfmesh serves {MOST_PAGES} pages at a time, which are open. Close one of them, then load this one again."


class Shown(Protocol):
    """What fills a page."""

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

    async def answer(self, request: web.Request, port: int) -> web.StreamResponse:
        """Answer on a websocket until it is closed."""
        CoreServer.bind_server(self.server)
        protocol, site = CoreServer(), create_webserver({})
        self._handler = AioHttpWsHandler(protocol, site)
        protocol.set_server(site)
        protocol.port_callback(port)
        return await self._handler.handleWsRequest(request)

    async def disconnect(self) -> None:
        """Close the websocket."""
        if self._handler is not None:
            await self._handler.disconnectClients()

    def close(self) -> None:
        """Give up what the session holds."""
        if self.shown is not None:
            self.shown.close()
        vtk.HELPERS_PER_SERVER.pop(self.server.name, None)


class Sessions:
    """Gives each websocket a page.

    Parameters
    ----------
    fill : callable
        Fills a trame server's page.
    refuse : callable
        Fills it with words alone: why there is no page.
    """

    def __init__(self, fill: Callable[[Any], Shown], refuse: Callable[[Any, str], None]) -> None:
        self._fill, self._refuse = fill, refuse
        self._number, self._collects = 0, False
        self._open: set[_Session] = set()
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
        if request.path != WEBSOCKET:
            return await handler(request)
        if len(self._open) >= MOST_SOCKETS:
            return web.Response(status=503, text=FULL + "\n")
        session, self._ready = self._ready or self._next(), None
        self._open.add(session)
        try:
            return await session.answer(request, self._host.port)
        finally:
            self._open.discard(session)
            session.close()
            if session.shown is not None:
                self._collect_later()

    async def close(self) -> None:
        """Close all pages."""
        for session in list(self._open):
            await session.disconnect()
        if self._ready is not None:
            self._ready.close()

    def _collect_later(self) -> None:
        """Free the memory of closed pages, of several at once: page and server hold each other, some 80 MB."""
        if not self._collects:
            self._collects = True
            asyncio.get_running_loop().call_later(COLLECT_SECONDS, self._collect)

    def _collect(self) -> None:
        self._collects = False
        gc.collect()

    def _next(self) -> _Session:
        """Return a session with a page, or with words where there are too many or it cannot be made."""
        if sum(session.shown is not None for session in self._open) >= MOST_PAGES:
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
